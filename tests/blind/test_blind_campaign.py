"""The campaign never opens the seal, goes on where it stopped, and its figures are those counted by hand."""

from __future__ import annotations

import hashlib
import json
import math
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from blind.blind_campaign import make

from nmt_blind.campaign import frozen
from nmt_blind.campaign.baselines import FeatureClassifier, bayesian_information, least_chi_square
from nmt_blind.campaign.run import read_result, run_campaign
from nmt_blind.campaign.score import compute_scores, score_campaign
from nmt_blind.campaign.score_sheet import markdown, page, print_scores, write_sheets
from nmt_blind.campaign.scored_case import ScoredCase, effect_set, scored_case
from nmt_blind.campaign.statistics import Proportion, area_under_roc, reliability, roc_curve, threshold_for
from nmt_core.errors import BenchError


def diagnosis(verdict: str, effect: str = "", p: float = 0.9, **more: Any) -> dict[str, Any]:
    """What diagnosis.json holds, as far as scores need it."""
    rest = 1.0 - p
    probabilities = {"none": rest, "unknown": 0.0}
    if verdict in ("none", "calibration"):
        probabilities = {"none": p, "unknown": rest}
    elif verdict == "unknown":
        probabilities = {"none": rest, "unknown": p}
    ranking = [{"effect": effect, "place": "structure", "detail": "4", "probability": p, "equivalents": []}]
    return {
        "verdict": verdict,
        "ranking": ranking if effect else [],
        "probabilities": probabilities,
        "where": [{"place": "structure", "detail": "4", "share": 1.0, "p": 1.0}] if effect else [],
        "gap": {"before": 5.0, "after": 1.2, "floor": 1.0, "closed": 0.95},
        "candidates": [
            {"label": "none", "effect": "none", "chi_square": 1000.0, "parameters": 0, "rows": 1000},
            {"label": "air_drag@4", "effect": "air_drag", "chi_square": 998.0, "parameters": 1, "rows": 1000},
            {"label": "microslip@3", "effect": "microslip", "chi_square": 996.0, "parameters": 3, "rows": 1000},
        ],
        "features": {"feature:log_odds": 10.0 if verdict in ("effect", "unknown") else -3.0, "scan:air_drag": 2.0},
        **more,
    }


def fake(model: Path, bags: Sequence[Path], withheld: str) -> dict[str, Any]:
    assert model.is_file()
    assert all(bag.is_dir() for bag in bags)
    return diagnosis("none")


def failing(model: Path, bags: Sequence[Path], withheld: str) -> dict[str, Any]:
    if "0001" in str(model):
        raise BenchError("The bag has no force.")
    return diagnosis("none")


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("blind") / "sealed"
    make(folder, seed=3, count=3, sealed=True)
    return folder


@pytest.fixture
def campaign(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made, tmp_path / "campaign"))


def test_the_run_needs_no_truth(campaign: Path) -> None:
    (campaign / "truth.sealed").unlink()
    done = run_campaign(campaign, diagnose=fake)
    assert (done.cases, done.done, done.new, done.failed) == (3, 3, 3, 0)
    result = read_result(campaign / "results", "0002")
    assert result is not None
    assert result["bags"] == json.loads((campaign / "hashes.json").read_text())["bags"]["0002"]


def test_a_run_goes_on_where_it_stopped_and_a_failure_is_a_result(campaign: Path) -> None:
    run_campaign(campaign, diagnose=failing)
    assert "no force" in str(read_result(campaign / "results", "0001"))
    (campaign / "results/0002.json").unlink()
    (campaign / "results/0003.json").write_text("{ half a file")
    done = run_campaign(campaign, diagnose=fake)
    assert (done.new, done.done) == (2, 3)
    assert run_campaign(campaign, diagnose=fake, again=True).new == 3


def test_a_run_takes_the_cases_that_are_made_and_one_program_for_all(
    campaign: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    noted = (campaign / "cases/0003/bags.json").read_bytes()
    (campaign / "cases/0003/bags.json").unlink()
    done = run_campaign(campaign, diagnose=fake)
    assert (done.new, done.done, done.waiting) == (2, 2, 1)
    (campaign / "cases/0003/bags.json").write_bytes(noted)
    monkeypatch.setattr(frozen, "PACKAGES", ("nmt_core",))
    with pytest.raises(BenchError, match="another version of the program"):
        run_campaign(campaign, diagnose=fake)
    assert run_campaign(campaign, diagnose=fake, again=True).new == 3
    assert score_campaign(campaign).frozen == frozen.diagnosis_digest()
    (campaign / "hashes.json").unlink()
    with pytest.raises(BenchError, match="Not all cases"):
        score_campaign(campaign, again=True)


def test_a_case_with_a_test_that_failed_is_diagnosed_from_the_others(campaign: Path) -> None:
    shutil.rmtree(campaign / "cases/0002/random")
    run_campaign(campaign, diagnose=lambda model, bags, withheld: diagnosis("none", tests=[bag.name for bag in bags]))
    result = read_result(campaign / "results", "0002")
    assert result is not None
    assert result["diagnosis"]["tests"] == ["backbone"]
    assert result["bags"]["random"] == hashlib.sha256().hexdigest()  # as `make` notes what gave no bag


def test_discarded_bags_leave_their_hashes(campaign: Path) -> None:
    run_campaign(campaign, diagnose=fake, discard_bags=True)
    assert not list(campaign.rglob("*.mcap"))
    assert len(score_campaign(campaign).cases) == 3


@pytest.mark.filterwarnings("ignore")
def test_a_run_over_a_dask_scheduler(campaign: Path) -> None:
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None, protocol="tcp", silence_logs=50
    ) as cluster:
        done = run_campaign(campaign, scheduler=cluster.scheduler_address, diagnose=fake)
    assert (done.new, done.done, done.failed) == (3, 3, 0)


def test_a_scheduler_that_does_not_answer_is_a_sentence(campaign: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    distributed = pytest.importorskip("distributed")

    def nobody(*_: Any, **__: Any) -> None:
        raise OSError("timed out")

    monkeypatch.setattr(distributed, "Client", nobody)
    with pytest.raises(BenchError, match="does not answer"):
        run_campaign(campaign, scheduler="tcp://127.0.0.1:1", diagnose=fake)


def test_a_folder_without_cases_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BenchError, match="no blind cases"):
        run_campaign(tmp_path, diagnose=fake)


def test_a_broken_seal_is_found(campaign: Path) -> None:
    run_campaign(campaign, diagnose=fake)
    path = campaign / "truth.sealed"
    path.write_text(path.read_text().replace('"shifted": true', '"shifted": false', 1))
    with pytest.raises(BenchError, match="seal is broken"):
        score_campaign(campaign)
    assert not (campaign / "opened.json").exists()


def test_other_bags_are_found(campaign: Path) -> None:
    bag = next((campaign / "cases/0001/backbone").glob("*.mcap"))
    data = bytearray(bag.read_bytes())
    data[len(data) // 2] ^= 1
    bag.write_bytes(data)
    run_campaign(campaign, diagnose=fake)
    with pytest.raises(BenchError, match="other bags"):
        score_campaign(campaign)


def test_a_seal_is_opened_once(campaign: Path) -> None:
    with pytest.raises(BenchError, match="no results"):
        score_campaign(campaign)
    run_campaign(campaign, diagnose=fake)
    assert score_campaign(campaign).openings == 1
    with pytest.raises(BenchError, match="opened before"):
        score_campaign(campaign)
    again = score_campaign(campaign, again=True)
    assert again.openings == 2
    assert "not a first look" in markdown(again)


def test_the_classifier_learns_from_development_cases_only(campaign: Path, tmp_path: Path) -> None:
    run_campaign(campaign, diagnose=fake)
    with pytest.raises(BenchError, match="other cases only"):
        score_campaign(campaign, train=campaign)
    other = shutil.copytree(campaign, tmp_path / "other")
    with pytest.raises(BenchError, match="Only development cases"):
        score_campaign(campaign, train=other)


def case(kind: str, said: dict[str, Any], *effects: str, sigma: float = 8.0, shifted: bool = False) -> ScoredCase:
    truth = {
        "case": "0001", "kind": kind, "shifted": shifted, "withheld": "",
        "effects": [{"name": name, "place": "structure", "sigma": sigma} for name in effects],
    }  # fmt: skip
    return scored_case(truth, {"diagnosis": said, "seconds": 2.0})


ABOUT = {"rig": "beam", "purpose": "development", "missing": (), "failed": (), "seal": "a", "trail": "b", "openings": 0}


def example() -> list[ScoredCase]:
    twin = diagnosis("effect", "low_pass")
    twin["ranking"][0]["equivalents"] = ["channel_skew"]
    return [
        case("null", diagnosis("none")),
        case("null", diagnosis("calibration"), shifted=True),
        case("null", diagnosis("effect", "air_drag")),
        case("effect", diagnosis("effect", "air_drag"), "air_drag"),
        case("effect", diagnosis("effect", "air_drag"), "microslip", sigma=16.0),
        case("effect", diagnosis("none"), "air_drag", sigma=1.0),
        case("twin", twin, "channel_skew"),
        case("open", diagnosis("unknown"), "lugre_joint"),
        case("withheld", diagnosis("effect", "air_drag"), "viscous_damping"),
        case("compound", diagnosis("effect", "air_drag + microslip"), "microslip", "air_drag", sigma=16.0),
    ]


def test_figures_are_those_counted_by_hand() -> None:
    scores = compute_scores(example(), ABOUT)
    method = scores.method
    assert (method.false_alarms.hits, method.false_alarms.of) == (1, 3)
    assert (method.detected.hits, method.detected.of) == (6, 6)
    assert (method.first.hits, method.first.of) == (2, 3)
    assert (scores.compound.hits, scores.compound.of) == (1, 1)
    assert (scores.verdict_unknown.hits, scores.verdict_unknown.of) == (1, 2)
    assert (scores.calibrated.hits, scores.calibrated.of) == (1, 1)
    assert (scores.plain_none.hits, scores.plain_none.of) == (1, 2)
    assert scores.by_strength[1.0][0].hits == 0
    assert scores.by_strength[8.0][1].hits == 2
    assert scores.closed == 0.95
    assert scores.confusion["microslip"] == {"air_drag": 1}
    assert scores.confusion["channel_skew"] == {"channel_skew": 1}
    # The false alarm scores as high as the effects, so at 1 % false alarms nothing is above it.
    assert method.detected_at_rate.hits == 0


def test_two_effects_count_as_one_answer_only_together() -> None:
    both = frozenset({"microslip", "air_drag"})
    assert effect_set("microslip@3 + air_drag@7") == both
    answer = case("compound", diagnosis("effect", "air_drag"), *both).answer
    assert not answer.first(both)
    assert not answer.among(both)
    said = diagnosis("effect", "air_drag")
    said["ranking"].append({"effect": "microslip", "probability": 0.05, "equivalents": []})
    assert case("compound", said, *both).answer.among(both)


def test_a_case_without_diagnosis_counts_against_it() -> None:
    truth = {"case": "0001", "kind": "effect", "shifted": False, "withheld": "",
             "effects": [{"name": "air_drag", "place": "structure", "sigma": 8.0}]}  # fmt: skip
    failed = scored_case(truth, {"error": "The bag has no force.", "seconds": 1.0})
    scores = compute_scores([failed], {**ABOUT, "failed": ("0001",)})
    assert (scores.method.detected.hits, scores.method.detected.of) == (0, 1)
    assert "1 / 0 / 1" in markdown(scores)


def test_least_chi_square_takes_what_bic_does_not() -> None:
    one = case("null", diagnosis("none"))
    assert least_chi_square(one).first(frozenset({"microslip"}))
    assert least_chi_square(one).alarm
    assert not bayesian_information(one).alarm
    assert bayesian_information(one).first(frozenset({"air_drag"}))


def test_the_classifier_learns_what_separates_cases() -> None:
    def development(effect: str, gain: float) -> ScoredCase:
        said = diagnosis("none", features={"scan:air_drag": gain, "scan:microslip": 50.0 - gain})
        return case("effect", said, effect)

    generator = np.random.default_rng(1)
    learned = FeatureClassifier(
        [development(name, middle + generator.normal()) for name, middle in (("air_drag", 45.0), ("microslip", 5.0))
         for _ in range(20)]
    )  # fmt: skip
    assert learned(development("air_drag", 46.0)).first(frozenset({"air_drag"}))
    assert learned(development("microslip", 4.0)).first(frozenset({"microslip"}))


def test_wilson_interval() -> None:
    # Newcombe, Stat. Med. 17 (1998) 857, table I, method 3: 15 of 148, 81 of 263, 0 of 20.
    for hits, of, low, high in ((81, 263, 0.2553, 0.3662), (15, 148, 0.0624, 0.1605), (0, 20, 0.0, 0.1611)):
        assert Proportion(hits, of).interval == pytest.approx((low, high), abs=6e-5)
    assert math.isnan(Proportion(0, 0).value)


def test_area_under_the_roc_is_that_of_its_curve() -> None:
    generator = np.random.default_rng(3)
    positive, negative = list(generator.normal(1.0, 1.0, 300).round(1)), list(generator.normal(0.0, 1.0, 200).round(1))
    false, true = roc_curve(positive, negative)
    trapezoid = float(np.sum(np.diff(false) * 0.5 * (true[1:] + true[:-1])))
    assert area_under_roc(positive, negative) == pytest.approx(trapezoid, abs=1e-12)
    limit = threshold_for(negative, 0.05)
    assert np.mean(np.array(negative) > limit) <= 0.05


@pytest.mark.parametrize("equal", [False, True])
def test_reliability_of_honest_and_of_boasting_probabilities(equal: bool) -> None:
    generator = np.random.default_rng(5)
    p = generator.random(20_000)
    right = list(generator.random(20_000) < p)
    assert reliability(list(p), right, equal=equal).error < 0.015
    boasting = reliability([0.95] * 100, [True] * 70 + [False] * 30, equal=equal)
    assert boasting.error >= 0.25 - 1e-12


def test_the_sheet_says_what_was_reached(tmp_path: Path) -> None:
    scores = compute_scores(example(), ABOUT)
    files = write_sheets(scores, tmp_path, tmp_path / "docs/results.md")
    assert [path.name for path in files] == ["score.json", "score.md", "score.html", "results.md"]
    values = json.loads(files[0].read_text())
    assert values["method"]["first"]["hits"] == 2
    text = files[1].read_text()
    assert text == files[3].read_text()
    assert "66.7 % (21–94 %, 2 of 3)" in text
    assert page(scores).count("<svg") == 4
    assert any("missed" in line for line in print_scores(scores))


def estimated(kind: str, effects: list[dict[str, Any]], said: dict[str, Any]) -> ScoredCase:
    truth = {"case": "0001", "kind": kind, "shifted": False, "withheld": "", "effects": effects}
    return scored_case(truth, {"diagnosis": said, "seconds": 1.0})


def stop(sigma: float, gap: float = 1e-3) -> dict[str, Any]:
    return {"name": "one_sided_stop", "place": "structure", "detail": "4 at 0.35", "sigma": sigma,
            "figures": {"k": 100.0, "gap": gap}}  # fmt: skip


def with_values(said: dict[str, Any], **values: tuple[float, float]) -> dict[str, Any]:
    parameters = {name.replace("__", "."): {"value": v, "std": s, "unit": ""} for name, (v, s) in values.items()}
    said["ranking"][0]["parameters"] = parameters
    return said


def test_coverage_counts_effects_with_all_their_parameters() -> None:
    right = estimated("effect", [stop(64.0)], with_values(
        diagnosis("effect", "one_sided_stop"), k=(102.0, 1.0), gap=(1.1e-3, 1e-4)))  # fmt: skip
    assert right.covered == (True,)
    off = estimated("effect", [stop(64.0)], with_values(
        diagnosis("effect", "one_sided_stop"), k=(102.0, 1.0), gap=(1.4e-3, 1e-4)))  # fmt: skip
    assert off.covered == (False,)
    assert max(e.deviation for e in off.estimates) == pytest.approx(4.0)
    # Another point is another parameter, another effect has none, and no uncertainty is none that covers.
    elsewhere = with_values(diagnosis("effect", "one_sided_stop"), k=(100.0, 1.0))
    elsewhere["ranking"][0]["detail"] = "7"
    assert estimated("effect", [stop(64.0)], elsewhere).covered == ()
    assert estimated("effect", [stop(64.0)], diagnosis("effect", "air_drag")).covered == ()
    sure = estimated("effect", [stop(64.0)], with_values(diagnosis("effect", "one_sided_stop"), k=(101.0, 0.0)))
    assert sure.covered == (False,)
    said = diagnosis("effect", "one_sided_stop + response_gain")
    said["ranking"][0]["parameters"] = {
        "one_sided_stop@4.k": {"value": 100.0, "std": 1.0},
        "one_sided_stop@4.gap": {"value": 1e-3, "std": 1e-5},
        "response_gain@x2.g": {"value": 0.05, "std": 1e-3},
    }
    gain = {"name": "response_gain", "place": "response_sensor", "detail": "x2", "sigma": 16.0, "figures": {"g": 0.02}}
    pair = estimated("compound", [stop(1024.0), gain], said)
    assert sorted(pair.covered) == [False, True]


def test_bands_go_to_the_strongest_effects() -> None:
    def found(sigma: float, k: float, named: str = "one_sided_stop") -> ScoredCase:
        said = with_values(diagnosis("effect", named), k=(k, 1.0), gap=(1e-3, 1e-4))
        return estimated("effect", [stop(sigma)], said)

    cases = [found(4096.0, 100.0), found(4096.0, 90.0), found(1024.0, 100.0), found(2.0, 100.0), found(8.0, 1.0, "x")]
    scores = compute_scores(cases, ABOUT)
    assert (scores.covered.hits, scores.covered.of) == (2, 3)
    bands = {(band.low, band.high): band for band in scores.bands}
    assert (bands[1024.0, 1e9].covered.hits, bands[1024.0, 1e9].covered.of) == (2, 3)
    assert (bands[8.0, 32.0].first.hits, bands[8.0, 32.0].first.of) == (0, 1)
    assert bands[2.0, 8.0].detected.of == 1
    assert sum(band.detected.of for band in scores.bands) == len(cases)
    assert "| from 1024 | 100.0 %" in markdown(scores)


def test_an_effect_of_unknown_strength_must_be_found_and_stands_in_no_band() -> None:
    truth = {"case": "0001", "kind": "open", "shifted": False, "withheld": "",
             "effects": [{"name": "lugre_joint", "place": "joint", "size": 1.0}]}  # fmt: skip
    scores = compute_scores([scored_case(truth, {"diagnosis": diagnosis("none"), "seconds": 1.0})], ABOUT)
    assert (scores.method.detected.hits, scores.method.detected.of) == (0, 1)
    assert not any(band.detected.of for band in scores.bands)
    assert not scores.unnamed


def test_strengths_are_counted_by_their_next_power_of_2() -> None:
    cases = [case("effect", diagnosis("effect", "air_drag"), "air_drag", sigma=sigma) for sigma in (0.2, 6.5, 9.0)]
    scores = compute_scores(cases, ABOUT)
    assert {sigma: detected.of for sigma, (detected, _) in scores.by_strength.items()} == {1.0: 1, 8.0: 2}


def test_cases_that_did_not_lock_are_counted(campaign: Path) -> None:
    path = campaign / "cases/0002/bags.json"
    bags = json.loads(path.read_text())
    bags["backbone"]["locked"] = 0
    path.write_text(json.dumps(bags))
    run_campaign(campaign, diagnose=fake)
    assert score_campaign(campaign).stalled == ("0002",)
