"""A rig file changed in place: it loads to the rig that was meant, and keeps its words."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from report import diagnosis_fixture as fixture

from nmt_core.errors import BenchError
from nmt_diagnose.effects.calibration import calibration_parameters
from nmt_diagnose.effects.effect import Candidate
from nmt_diagnose.effects.library import candidates
from nmt_diagnose.ledger.diagnosis import Verdict
from nmt_diagnose.prediction.operating_range import operating_range
from nmt_plant.devices.simulated_rig import SimulatedRig
from nmt_report.diagnosis_model import assumptions, model_text
from nmt_rig.rig import Rig, find_rig, load_rig
from nmt_rig.rig_file_edit import changed_keys, edited_rig_text


def comments(text: str) -> list[str]:
    return [line.partition("# ")[2] for line in text.splitlines() if "# " in line]


def load_text(text: str, folder: Path) -> Rig:
    path = folder / "model.yaml"
    path.write_text(text, encoding="utf-8")
    return load_rig(path)


def library_candidates(rig: Rig) -> list[Candidate]:
    """Every effect at the first and the last of its places."""
    found: dict[str, list[Candidate]] = {}
    for candidate in candidates(rig, operating_range(rig, fixture.phase_resonance().tests)):
        found.setdefault(candidate.effect.name, []).append(candidate)
    return [c for places in found.values() for c in {p.label: p for p in (places[0], places[-1])}.values()]


def with_effect(rig: Rig, candidate: Candidate) -> Rig:
    values = {p.name: 1.2345678912345 * candidate.site.scales[p.name] for p in candidate.effect.parameters}
    return candidate.effect.apply(rig, candidate.site, values)


@pytest.mark.campaign
def test_every_effect_of_the_library_can_be_written(tmp_path: Path) -> None:
    rig = load_rig("beam")
    text = find_rig("beam").read_text(encoding="utf-8")
    tried = 0
    for candidate in library_candidates(rig):
        target = with_effect(rig, candidate)
        result = edited_rig_text(text, "beam.yaml", target)
        loaded = load_text(result, tmp_path)
        changed = changed_keys(rig, target)
        assert changed, candidate.label
        assert changed_keys(loaded, target) == [], candidate.label
        assert [key for key, _, _ in changed_keys(rig, loaded)] == [key for key, _, _ in changed]
        # An effect that takes an element's place writes that one anew; all other comments stay.
        missing = set(comments(text)) - set(comments(result))
        assert missing <= ({"identified, see assumptions"} if candidate.effect.name == "microslip" else set())
        tried += 1
    assert tried > 30


@pytest.mark.parametrize("name", ["beam", "joint_resonator"])
def test_refitted_parameters_leave_every_other_line_as_it_was(name: str, tmp_path: Path) -> None:
    rig = load_rig(name)
    text = find_rig(name).read_text(encoding="utf-8")
    target = rig
    parameters = calibration_parameters(rig)
    for number, parameter in enumerate(parameters):
        target = parameter.apply(target, 0.02 * (number + 1))
    result = edited_rig_text(text, f"{name}.yaml", target)
    assert changed_keys(load_text(result, tmp_path), target) == []
    old, new = text.splitlines(), result.splitlines()
    assert len(old) == len(new)
    differing = sum(a != b for a, b in zip(old, new, strict=True))
    assert 0 < differing <= len(parameters)
    assert comments(result) == comments(text)


def test_nothing_to_change_leaves_the_text(tmp_path: Path) -> None:
    text = find_rig("beam").read_text(encoding="utf-8")
    assert edited_rig_text(text, "beam.yaml", load_rig("beam")) == text


@pytest.mark.parametrize(
    "text",
    [
        # An anchor shared by two entries: one of them must change, the other not.
        "name: a\nstructure: {kind: chain, masses_kg: [&m 1.0, *m], springs_n_m: [1000.0], "
        "ground_springs_n_m: [9.0, 0.0]}\n"
        "exciter: {kind: force, point: 1}\nsensors: [{quantity: force}, {quantity: displacement, point: 1}]\n"
        "extraction: {linear_modes: 1}\n",
        # No line end, an empty mapping, a sequence that is not indented.
        "name: a\nstructure:\n  kind: chain\n  masses_kg:\n  - 1.0\n  - 1.0\n  springs_n_m: [1000.0]\n"
        "  ground_springs_n_m: [9.0, 0.0]\npll: {}\n"
        "extraction: {linear_modes: 1}\n"
        "exciter: {kind: force, point: 1}\nsensors:\n- quantity: force\n- quantity: displacement\n  point: 1",
    ],
)
def test_unusual_forms(text: str, tmp_path: Path) -> None:
    rig = load_text(text, tmp_path)
    structure = rig.structure.model_copy(update={"masses_kg": [1.5, 1.0], "loss_factor": 1e-3})
    sensors = [rig.sensors[0], rig.sensors[1].model_copy(update={"gain": 1.25})]
    target = rig.model_copy(
        update={"structure": structure, "sensors": sensors, "pll": {"phase_offset_rad": 0.1}, "assumptions": ["a: b"]}
    )
    assert changed_keys(load_text(edited_rig_text(text, "a.yaml", target), tmp_path), target) == []


HAND_WRITTEN = """\
# A chain by hand.
name: a    # short

structure:
    kind: chain
    masses_kg: [+1.0, 1.e0]   # weighed
    springs_n_m: [1000.]
    ground_springs_n_m: [9., 0]
    loss_factor: 1e-3

# What is driven.
exciter: {kind: force, point: 1}
sensors:
- quantity: force      # load cell
- quantity: displacement
  point: 1

# How it is evaluated.
extraction:
    linear_modes: 1

# How it was made up.
assumptions:
- 'masses: as weighed'

# The test.
test:
    levels: "0.10, 0.20"   # N
"""


def test_comments_stay_where_they_lead_and_numbers_as_they_are_spelt(tmp_path: Path) -> None:
    rig = load_text(HAND_WRITTEN, tmp_path)
    long = "A remark that is longer than a line of a hundred characters, so that it is written over two lines, folded."
    target = rig.model_copy(
        update={
            "structure": rig.structure.model_copy(update={"loss_factor": 0.00234567890123}),
            "sensors": [*rig.sensors, rig.sensors[1].model_copy(update={"point": 2, "gain": 1.25})],
            "assumptions": [*rig.assumptions, "one more", long],
            "extraction": rig.extraction.model_copy(update={"harmonics": 9}),
        }
    )
    result = edited_rig_text(HAND_WRITTEN, "a.yaml", target)
    assert changed_keys(load_text(result, tmp_path), target) == []
    lines = HAND_WRITTEN.splitlines()
    lines[lines.index("    loss_factor: 1e-3")] = "    loss_factor: 0.002345678901"
    lines.insert(lines.index("  point: 1") + 1, "- {quantity: displacement, point: 2, gain: 1.25}")
    lines.insert(lines.index("    linear_modes: 1") + 1, "    harmonics: 9")
    added = lines.index("- 'masses: as weighed'") + 1
    split = long[:114].rindex(" ") if len(long) > 114 else len(long)
    lines[added:added] = [
        "- one more",
        "- >-",
        f"  {long[:split]}",
        *([f"  {long[split + 1 :]}"] if split < len(long) else []),
    ]
    assert result.splitlines() == lines


WRAPPED = "exciter: {kind: force,   # by hand\n          point: 1}"


@pytest.mark.parametrize(
    "text",
    [
        "# Before the document.\n---\n" + HAND_WRITTEN,
        "%YAML 1.2\n---\n" + HAND_WRITTEN + "...\n",
        HAND_WRITTEN.replace("exciter: {kind: force, point: 1}", WRAPPED),
        HAND_WRITTEN.replace("name: a", "description: |\n      two\n      lines\n\n# And so on.\nname: a"),
        HAND_WRITTEN.replace("[+1.0, 1.e0]", "\n      - 1.50   # first\n      - .5\n      # after"),
    ],
    ids=["marker", "directive", "wrapped braces", "literal text", "list of lines"],
)
def test_lines_that_nothing_changes_stay_to_the_letter(text: str, tmp_path: Path) -> None:
    rig = load_text(text, tmp_path)
    target = rig.model_copy(
        update={
            "structure": rig.structure.model_copy(update={"loss_factor": 0.25}),
            "assumptions": [*rig.assumptions, "one more"],
        }
    )
    expected = text.replace("loss_factor: 1e-3", "loss_factor: 0.25")
    expected = expected.replace("as weighed'\n", "as weighed'\n- one more\n")
    assert edited_rig_text(text, "a.yaml", target) == expected


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("name: a\nname: b\n", "name is given twice"),
        ("name: !!python/object/apply:os.system ['true']\n", "line 1"),
        (
            "a: &a [1,1,1,1,1,1]\n"
            + "".join(
                f"{k}: &{k} [*{p},*{p},*{p},*{p},*{p},*{p}]\n" for p, k in zip("abcdefg", "bcdefgh", strict=True)
            ),
            "repeats itself",
        ),
        ("name: [\n", "fix the YAML syntax"),
        ("- name\n", "must be a mapping"),
    ],
    ids=["key twice", "tag", "aliases of aliases", "syntax", "list"],
)
def test_hostile_text_is_refused_before_it_is_edited(text: str, sentence: str) -> None:
    with pytest.raises(BenchError, match=sentence):
        edited_rig_text(text, "a.yaml", load_rig("beam"))


def test_a_rig_that_no_file_may_hold() -> None:
    rig = load_rig("joint_resonator")
    joint = rig.local_elements[0].model_copy(update={"exponent": -1.05})
    target = rig.model_copy(update={"local_elements": [joint, *rig.local_elements[1:]]})
    text = find_rig("joint_resonator").read_text(encoding="utf-8")
    with pytest.raises(BenchError, match="greater than -1"):
        edited_rig_text(text, "joint_resonator.yaml", target)


def test_a_text_that_is_no_rig_file() -> None:
    with pytest.raises(BenchError, match="nothing"):
        edited_rig_text("name: x\n", "nothing", load_rig("beam"))


# -- model.yaml -------------------------------------------------------------------------------------------------------


def test_the_model_with_the_effect_says_what_was_done_and_runs(tmp_path: Path) -> None:
    rig = load_rig("beam")
    candidate = next(c for c in library_candidates(rig) if c.effect.name == "cubic_stiffness")
    slip = next(p for p in calibration_parameters(rig) if p.name.endswith("slip_force_n"))
    model = slip.apply(with_effect(rig, candidate), math.log(1.02 / slip.value) / slip.std)
    diagnosis = fixture.report(Verdict.EFFECT).diagnosis
    text = model_text(find_rig("beam").read_text(encoding="utf-8"), "beam.yaml", rig, model, diagnosis)
    loaded = load_text(text, tmp_path)
    assert loaded.assumptions[:-2] == rig.assumptions
    added, refitted = loaded.assumptions[-2:]
    assert added.startswith("Effect added by a diagnosis of bags/backbone (SHA-256 abababababab), bags/random")
    assert "cubic stiffness" in added
    assert "local_elements.1 = cubic_spring, point 1, stiffness_n_m3" in added
    assert "local_elements.joint.slip_force_n from 1 to 1.0200 ± 0.0040 N" in refitted
    old = find_rig("beam").read_text(encoding="utf-8").splitlines()
    assert max(len(line) for line in text.splitlines() if line not in old) <= 120
    # The plant simulates it.
    device = SimulatedRig(loaded)
    device.configure()
    device.start()
    assert device.read()
    device.close()


def test_overrides_are_part_of_the_new_file(tmp_path: Path) -> None:
    given = load_rig("beam", ["structure.density_kg_m3=7900", "exciter.point=4"])
    diagnosis = fixture.report(Verdict.NONE).diagnosis
    text = model_text(find_rig("beam").read_text(encoding="utf-8"), "beam.yaml", given, given, diagnosis)
    assert load_text(text, tmp_path) == given


def test_what_stays_unexplained_changes_nothing(tmp_path: Path) -> None:
    rig = load_rig("beam")
    absurd = rig.model_copy(update={"structure": rig.structure.model_copy(update={"density_kg_m3": 4000.0})})
    diagnosis = fixture.report(Verdict.UNKNOWN).diagnosis
    text = model_text(find_rig("beam").read_text(encoding="utf-8"), "beam.yaml", rig, absurd, diagnosis)
    loaded = load_text(text, tmp_path)
    assert loaded.structure == rig.structure
    assert "no effect of its library explains" in "".join(loaded.assumptions)


def test_no_change_no_assumption() -> None:
    rig = load_rig("beam")
    assert assumptions(rig, rig, fixture.report(Verdict.NONE).diagnosis) == []
