"""Cases are what their seed says, their truth is sealed first and their bags say nothing of it."""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from dataclasses import replace
from pathlib import Path

import pytest
from blind.blind_campaign import SHORT, make, operating, short_rig

from nmt_blind.cases.draw import MIXTURE, SIZES, draw_cases
from nmt_blind.cases.injected_effects import INJECTED_EFFECTS, KNOWN, NEAR_TWINS, OPEN
from nmt_blind.cases.laboratory import record_backbone, record_random
from nmt_blind.cases.make import CampaignPlan, bag_hash, make_campaign
from nmt_blind.cases.operating import Operating
from nmt_blind.cases.priors import LARGEST_SHIFT, parameters
from nmt_blind.cases.rig_edits import Edit, rig_yaml, with_edits
from nmt_core.errors import BenchError
from nmt_record.bag.bag_reader import Bag
from nmt_rig.rig import Rig, load_rig

RIG = short_rig()
MODEL = RIG.model()


@pytest.mark.campaign
def test_the_same_seed_gives_the_same_files(tmp_path: Path) -> None:
    first, second = make(tmp_path / "a"), make(tmp_path / "b")
    assert (first.seal, first.trail) == (second.seal, second.trail)
    assert (tmp_path / "a/hashes.json").read_bytes() == (tmp_path / "b/hashes.json").read_bytes()
    other = make(tmp_path / "c", seed=4)
    assert other.seal != first.seal
    assert other.trail != first.trail


def test_a_campaign_goes_on_where_it_stopped(tmp_path: Path) -> None:
    whole = make(tmp_path / "a")
    (tmp_path / "a/cases/0002/bags.json").unlink()
    again = make(tmp_path / "a")
    assert (again.new, again.trail) == (1, whole.trail)
    assert make(tmp_path / "a").new == 0
    begun = make(tmp_path / "b", batch=1)
    assert (begun.seal, begun.trail, begun.new, begun.left) == (whole.seal, "", 1, 1)
    assert not (tmp_path / "b/hashes.json").exists()
    ended = make(tmp_path / "b", batch=1)
    assert (ended.trail, ended.new, ended.left) == (whole.trail, 1, 0)


def test_the_truth_is_sealed_before_any_bag(tmp_path: Path) -> None:
    seen: list[tuple[str, bool]] = []

    def on_seal(digest: str) -> None:
        stored = json.loads((tmp_path / "a/seal.json").read_text())["sha256"]
        seen.append((stored, (tmp_path / "a/cases").exists()))
        assert digest == stored

    made = make(tmp_path / "a", count=1, on_seal=on_seal)
    assert seen == [(made.seal, False)]
    assert hashlib.sha256((tmp_path / "a/truth.sealed").read_bytes()).hexdigest() == made.seal


def test_nothing_but_the_seal_tells_the_truth(tmp_path: Path) -> None:
    make(tmp_path / "a", count=1, kinds=("effect",))
    make(tmp_path / "b", count=1, kinds=("null",))
    case = json.loads((tmp_path / "a/truth.sealed").read_text())["cases"][0]
    public = json.loads((tmp_path / "a/public.json").read_text())
    assert public["cases"] == [{"case": "0001", "withheld": case["withheld"]}]
    own, plain = tmp_path / "a/cases/0001", tmp_path / "b/cases/0001"
    assert load_rig(own / "model.yaml") == MODEL
    data = b""
    for test in ("backbone", "random"):
        # Whatever is true, a run says the same of itself.
        mine, other = Bag.open(own / test), Bag.open(plain / test)
        assert mine.run_start == other.run_start
        assert mine.rig_yaml == other.rig_yaml == rig_yaml(MODEL)
        data += b"".join(path.read_bytes() for path in (own / test).iterdir())
    assert case["edits"]
    for edit in case["edits"]:
        if isinstance(edit["value"], float):
            assert repr(edit["value"]).encode() not in data


@pytest.mark.parametrize(
    ("seed", "sealed", "word"),
    [(3, False, "odd"), (4, True, "even"), (3918, False, "reserved"), (-2, False, "negative")],
)
def test_seeds_of_the_wrong_kind_are_refused(tmp_path: Path, seed: int, sealed: bool, word: str) -> None:
    with pytest.raises(BenchError, match=word):
        make(tmp_path / "a", seed=seed, sealed=sealed)
    assert not (tmp_path / "a").exists()


def test_campaigns_do_not_mix(tmp_path: Path) -> None:
    make(tmp_path / "a", count=1, kinds=("null",))
    with pytest.raises(BenchError, match="do not mix"):
        make(tmp_path / "a", seed=3, count=1, sealed=True)
    with pytest.raises(BenchError, match="another campaign"):
        make(tmp_path / "a", seed=4, count=1)
    (tmp_path / "b").mkdir()
    (tmp_path / "b/note.txt").write_text("mine")
    with pytest.raises(BenchError, match="not a campaign"):
        make(tmp_path / "b")
    with pytest.raises(BenchError, match="no kind of case"):
        make(tmp_path / "c", kinds=("nul",))
    with pytest.raises(BenchError, match="at least one"):
        make(tmp_path / "c", count=0)
    with pytest.raises(BenchError, match="no blind rig"):
        make_campaign(tmp_path / "c", CampaignPlan(rig_name="bench", count=1, seed=2))


def test_the_mixture_is_as_stated_and_cases_do_not_depend_on_their_number() -> None:
    cases = draw_cases(MODEL, operating(), 200, 6)
    assert Counter(case.kind for case in cases) == {kind: 10 * share for kind, share in MIXTURE.items()}
    assert cases[:30] == draw_cases(MODEL, operating(), 30, 6)
    nulls = [case for case in cases if case.kind == "null"]
    assert sum(case.shifted for case in nulls) == len(nulls) // 2
    assert all(not case.edits for case in nulls if not case.shifted)
    singles = [case for case in cases if case.kind == "effect"]
    assert {effect.name for case in singles for effect in case.effects} == {truth.name for truth in KNOWN}
    assert {case.effects[0].size for case in singles} == set(SIZES)
    for case in cases:
        names = [effect.name for effect in case.effects]
        assert case.kind != "withheld" or case.withheld.split(",")[0] == names[0]
        assert case.kind == "withheld" or case.withheld not in names
        assert (case.kind == "open") == any(not effect.known for effect in case.effects)
        assert len(set(names)) == len(names) == {"null": 0, "compound": 2}.get(case.kind, 1)
    # A flag does not give its case away.
    flagged = [case.kind for case in cases if case.withheld]
    assert {"null", "effect", "withheld"} <= set(flagged)


def test_a_gap_is_a_share_of_the_motion_of_the_rig_that_has_it() -> None:
    own = operating()
    half = replace(own, displacement={point: 0.5 * size for point, size in own.displacement.items()})
    plain = draw_cases(MODEL, own, 300, 6, ("effect",))
    asked: list[Rig] = []

    def motion(rig: Rig) -> Operating:
        asked.append(rig)
        return half

    cases = draw_cases(MODEL, own, 300, 6, ("effect",), motion=motion)
    compared = 0
    for case, other in zip(cases, plain, strict=True):
        assert case.effects[0].value == other.effects[0].value
        gap = case.effects[0].figures.get("gap")
        if gap is not None:
            compared += case.shifted
            assert gap == pytest.approx((0.5 if case.shifted else 1.0) * other.effects[0].figures["gap"])
        else:
            assert case.name == other.name
    assert compared > 5
    # It is the shifted rig that is asked for.
    assert all(rig != MODEL for rig in asked)


@pytest.mark.parametrize(
    ("special", "general"),
    [
        ("second_friction_contact", "microslip"),
        ("viscous_damping", "power_law_damping"),
        ("air_drag", "power_law_damping"),
    ],
)
def test_an_effect_is_withheld_with_what_contains_it(special: str, general: str) -> None:
    cases = draw_cases(MODEL, operating(), 800, 8, kinds=("withheld",))
    mine = [case for case in cases if case.effects[0].name == special]
    assert mine
    assert all(general in case.withheld.split(",") for case in mine)


def test_an_effect_is_withheld_with_its_near_twins() -> None:
    cases = draw_cases(MODEL, operating(), 400, 8, kinds=("withheld",))
    for case in cases:
        name = case.effects[0].name
        twins = {other for pair in NEAR_TWINS if name in pair for other in pair}
        assert twins <= set(case.withheld.split(","))


def test_air_drags_no_more_than_air_can() -> None:
    limit = 0.5 * 1.2 * 10.0 * 0.7 * 0.00527668  # ½ ρ C_d A of the beam's face
    cases = draw_cases(MODEL, operating(), 800, 6, ("effect",))
    drags = [abs(case.effects[0].value) for case in cases if case.effects[0].name == "air_drag"]
    assert max(drags) == pytest.approx(limit, rel=1e-3)
    assert min(drags) < 0.5 * limit


def test_shifts_stay_within_their_priors() -> None:
    priors = parameters(MODEL)
    assert ("structure", "youngs_modulus_pa") in priors
    for case in draw_cases(MODEL, operating(), 20, 6, ("null",)):
        for edit in case.edits:
            value, std = priors[edit.path]
            assert abs(edit.value / value - 1.0) < 1.05 * LARGEST_SHIFT * std * (1.0 + std)


@pytest.mark.parametrize("truth", [*KNOWN, *OPEN], ids=lambda truth: truth.name)
def test_every_truth_is_a_rig_file(truth: object) -> None:
    chosen = INJECTED_EFFECTS[truth.name]  # type: ignore[attr-defined]
    for spot in chosen.spots(MODEL):
        value = chosen.value(MODEL, operating(), spot, 0.5)
        rig = with_edits(MODEL, chosen.edits(MODEL, operating(), spot, value))
        assert rig != MODEL
        assert chosen.place_at(MODEL, spot)


def test_twins_are_known_truths() -> None:
    known = {truth.name for truth in KNOWN}
    assert all(set(pair) <= known for pair in NEAR_TWINS)


def test_keys_at_their_defaults_reproduce_the_plain_rig_bit_for_bit(tmp_path: Path) -> None:
    absent = with_edits(
        MODEL,
        (
            Edit(("structure", "loss_factor"), 0.0),
            Edit(("structure", "added_masses"), {"point": 4, "mass_kg": 0.0}, "append"),
            Edit(("exciter", "force_factor_linear_per_m"), 0.0),
            Edit(("exciter", "source_resistance_ohm"), 0.0),
            Edit(("sensors", 1, "mass_kg"), 0.0),
            Edit(("sensors", 2, "dead_zone"), 0.0),
            Edit(("clock_error",), 0.0),
            Edit(("drift", "stiffness_per_s"), 0.0),
            Edit(("pll",), {"phase_offset_rad": 0.0}, "merge"),
        ),
    )
    assert absent != MODEL
    for name, rig in (("plain", MODEL), ("absent", absent)):
        record_backbone(tmp_path / name / "backbone", rig, MODEL, SHORT, 5)
        record_random(tmp_path / name / "random", rig, MODEL, SHORT, 5)
    for test in ("backbone", "random"):
        assert bag_hash(tmp_path / "plain" / test) == bag_hash(tmp_path / "absent" / test)


def test_the_two_tests_of_a_case_have_noise_of_their_own(tmp_path: Path) -> None:
    from nmt_record.windows.segments import read_signals

    record_backbone(tmp_path / "backbone", MODEL, MODEL, SHORT, 5)
    record_random(tmp_path / "random", MODEL, MODEL, SHORT, 5)
    # The first samples come before any motion: they are noise alone.
    first = [read_signals(Bag.open(tmp_path / test), 0, 40).channels["x6"] for test in ("backbone", "random")]
    assert abs(float(first[0] @ first[1])) < 0.6 * float((first[0] @ first[0] * (first[1] @ first[1])) ** 0.5)
