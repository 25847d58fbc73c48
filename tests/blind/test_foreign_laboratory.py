"""Cases of another laboratory: how answers are classed, what is run again and what is not, what a user reads."""

from __future__ import annotations

import csv
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from nmt_bench.cli import main
from nmt_blind.campaign.explain import explain_foreign
from nmt_blind.campaign.foreign_case import ForeignTruth, contradictions, judge, read_cases, read_truth
from nmt_blind.campaign.foreign_run import ForeignLine, print_lines, run_laboratory, summary, write_tables
from nmt_core.errors import BenchError
from nmt_laboratories import laboratory_one, laboratory_two

pytestmark = pytest.mark.usefixtures("module_undrawn")

LABORATORY_ONE = Path(__file__).resolve().parents[2].parent / "shared" / "laboratories" / "one"
CUBIC = ForeignTruth("effect", ("effect",), (frozenset({"cubic_stiffness"}),), place=("7",), parameters={"k": 1e6})
PAIR = ForeignTruth(
    "effect",
    ("effect",),
    (frozenset({"cubic_stiffness", "force_gain"}),),
    (frozenset({"cubic_stiffness"}),),
    ("7",),
    {"cubic_stiffness.k": 1e6, "force_gain.g": 0.04},
)
KINDRED = ForeignTruth("effect", ("effect",), CUBIC.effects, (frozenset({"quintic_stiffness"}),), ("7",))
FINE = ForeignTruth("healthy", ("none", "calibration"))
SHIFTED = ForeignTruth("healthy", ("calibration",), parameters={"joint.slip_force_n": 1.25})
STRIBECK = ForeignTruth("unknown", ("unknown",), (), (frozenset({"power_law_damping"}),), ("6",))


def explained(effect: str, place: str, p: float, **more: Any) -> dict[str, Any]:
    """An entry of a ranking; place as "structure 7"."""
    kind, _, detail = place.partition(" ")
    return {"effect": effect, "place": kind, "detail": detail, "probability": p, "equivalents": [], **more}


def said(verdict: str, *ranking: dict[str, Any], p: float = 0.0, where: str = "", **more: Any) -> dict[str, Any]:
    """What diagnosis.json holds; ``p`` of the verdict where it is not ``effect``."""
    kind, _, detail = where.partition(" ")
    places = [{"place": kind, "detail": detail, "share": 1.0, "p": 1.0}] if where else []
    probabilities = {"none": 0.0, "unknown": 0.0, "unknown" if verdict == "unknown" else "none": p}
    return {"verdict": verdict, "ranking": list(ranking), "where": places, "probabilities": probabilities, **more}


def test_answers_stated_together_hold_the_truth_or_not() -> None:
    cubic = explained("cubic_stiffness", "structure 7", 0.6, equivalents=["quintic_stiffness"])
    named = {"kind": "effect", "effects": ["cubic_stiffness", "quintic_stiffness"], "probability": 0.6}
    unnamed = {"kind": "unknown", "effects": [], "probability": 0.36}
    diagnosis = {**said("effect", cubic), "answers": [named, unnamed]}
    answer = judge(KINDRED, diagnosis)
    assert (answer.credible, answer.held) == (2, True)
    assert judge(STRIBECK, diagnosis).held
    assert not judge(FINE, diagnosis).held
    quiet = {**said("none", p=0.8), "answers": [{"kind": kind, "effects": []} for kind in ("none", "too_weak")]}
    assert judge(FINE, quiet).held
    assert judge(CUBIC, quiet).held
    assert not judge(CUBIC, {**quiet, "answers": quiet["answers"][:1]}).held


def test_what_an_answer_states_is_compared_with_how_often_it_is_right() -> None:
    lines = [
        ForeignLine(f"case{k}", "healthy", "none", judge(FINE, said(verdict, p=p)), 1.0, 0.5)
        for k, (verdict, p) in enumerate([("none", 0.9), ("none", 0.9), ("unknown", 0.9), ("unknown", 0.9)])
    ]
    found = summary(lines)
    assert found["calibration_error"] == pytest.approx(0.4)
    assert found["brier"] == pytest.approx((2 * 0.1**2 + 2 * 0.9**2) / 4)
    assert "0.90: 0.50 (4)" in " ".join(print_lines(lines))


@pytest.mark.parametrize(
    ("truth", "diagnosis", "outcome"),
    [
        (FINE, said("none", p=0.99), "right"),
        (FINE, said("calibration", p=0.6), "right"),
        (FINE, said("effect", explained("mains_hum", "response_sensor a2", 0.95)), "confidently wrong"),
        (FINE, said("effect", explained("mains_hum", "response_sensor a2", 0.95, adequate=False)), "confidently wrong"),
        (FINE, said("effect", explained("mains_hum", "response_sensor a2", 0.85)), "hedged wrong"),
        (FINE, said("unknown", p=0.97), "confidently wrong"),
        (FINE, said("unknown", p=0.7), "hedged wrong"),
        (SHIFTED, said("calibration", p=0.9), "right"),
        (SHIFTED, said("none", p=0.95), "confidently wrong"),
        (SHIFTED, said("none", p=0.5), "hedged wrong"),
        (CUBIC, said("effect", explained("cubic_stiffness", "structure 7", 0.99)), "right"),
        (CUBIC, said("effect", explained("cubic_stiffness", "structure 7", 0.4)), "hedged right"),
        (CUBIC, said("effect", explained("cubic_stiffness", "structure 7", 0.99, adequate=False)), "hedged right"),
        (CUBIC, said("effect", explained("cubic_stiffness", "structure 7", 0.99), adequate=False), "hedged right"),
        (CUBIC, said("effect", explained("cubic_stiffness", "structure 17", 0.99)), "confidently wrong"),
        (
            CUBIC,
            said("effect", explained("quintic_stiffness", "structure 7", 0.8, equivalents=["cubic_stiffness@7"])),
            "right",
        ),
        (CUBIC, said("effect", explained("cubic_stiffness + mains_hum", "structure 7 + a2", 0.99)), "hedged right"),
        (CUBIC, said("effect", explained("added_mass", "structure 7", 0.99)), "confidently wrong"),
        (CUBIC, said("effect", explained("added_mass", "structure 7", 0.89)), "hedged wrong"),
        (CUBIC, said("effect", explained("added_mass", "structure 7", 0.99, adequate=False)), "hedged wrong"),
        (
            CUBIC,
            said(
                "effect",
                explained("added_mass", "structure 7", 0.99, adequate=False),
                explained("cubic_stiffness", "structure 7", 0.005),
            ),
            "hedged right",
        ),
        (
            CUBIC,
            said(
                "effect", explained("added_mass", "structure 7", 0.6), explained("cubic_stiffness", "structure 7", 0.4)
            ),
            "hedged wrong",
        ),
        (CUBIC, said("unknown", explained("cubic_stiffness", "structure 7", 0.1), p=0.9), "hedged right"),
        (CUBIC, said("unknown", explained("cubic_stiffness", "structure 5", 0.1), p=0.9), "honest unknown"),
        (CUBIC, said("unknown", p=1.0), "honest unknown"),
        (CUBIC, said("none", p=0.95), "confidently wrong"),
        (CUBIC, said("calibration", p=0.6), "hedged wrong"),
        (PAIR, said("effect", explained("force_gain + cubic_stiffness", "structure 7", 0.9)), "right"),
        (PAIR, said("effect", explained("cubic_stiffness", "structure 7", 0.99)), "hedged right"),
        (PAIR, said("effect", explained("force_gain", "force_sensor f2", 0.99)), "confidently wrong"),
        (KINDRED, said("effect", explained("quintic_stiffness", "structure 7", 0.95)), "confidently wrong"),
        (KINDRED, said("effect", explained("quintic_stiffness", "structure 7", 0.5)), "hedged wrong"),
        (KINDRED, said("effect", explained("quintic_stiffness", "structure 7", 0.95, adequate=False)), "hedged right"),
        (STRIBECK, said("unknown", p=0.9, where="structure 6"), "right"),
        (STRIBECK, said("unknown", p=0.9, where="structure 5"), "hedged right"),
        (STRIBECK, said("effect", explained("power_law_damping", "structure 6", 0.9)), "confidently wrong"),
        (STRIBECK, said("effect", explained("power_law_damping", "structure 6", 0.9, adequate=False)), "hedged right"),
        (STRIBECK, said("none", p=0.3), "hedged wrong"),
        (CUBIC, None, "refused"),
        (CUBIC, {}, "refused"),
    ],
)
def test_an_answer_is_classed(truth: ForeignTruth, diagnosis: dict[str, Any] | None, outcome: str) -> None:
    assert judge(truth, diagnosis).outcome == outcome


def told(verdict: str, text: str, adequate: bool, unnamed: float, *ranking: dict[str, Any]) -> dict[str, Any]:
    """What ``diagnosis.json`` holds of what is said."""
    return {
        "verdict": verdict, "sentences": [text], "adequate": adequate, "ranking": ranking,
        "probabilities": {"unknown": unnamed},
    }  # fmt: skip


WHOLE = explained("cubic_stiffness", "structure 7", 0.97)
PART = explained("cubic_stiffness", "structure 7", 0.97, adequate=False, given_library=True)
CAUSE = "The cause is cubic stiffness at point 7."
RUBS = "The cause is friction contact at point 6."
ACTS = "99 % of the gap acts like cubic stiffness at point 7."


@pytest.mark.parametrize(
    ("diagnosis", "differing"),
    [
        (told("effect", CAUSE, True, 0.01, WHOLE), 0),
        (told("effect", ACTS, False, 0.9, PART), 0),
        (told("unknown", "Nothing in the library explains all of it.", False, 0.9, WHOLE), 0),
        (told("effect", RUBS, True, 0.01, explained("second_friction_contact", "joint 6", 0.97)), 0),
        (told("none", "There is no gap.", True, 0.0), 0),
        (told("none", CAUSE, True, 0.0, WHOLE), 1),
        (told("effect", CAUSE, True, 0.98, {**WHOLE, "probability": 0.02}), 1),
        (told("effect", CAUSE, False, 0.01, WHOLE), 4),
        (told("effect", CAUSE.replace("cubic", "quintic"), True, 0.01, WHOLE), 1),
        (told("effect", "The cause is seen.", True, 0.0), 1),
        (told("unknown", "Nothing.", True, 0.9), 1),
    ],
)
def test_parts_that_say_different_things_are_found(diagnosis: dict[str, Any], differing: int) -> None:
    assert len(contradictions(diagnosis)) == differing, contradictions(diagnosis)


def test_a_parameter_is_compared_in_stated_standard_deviations() -> None:
    k, wrong = {"value": 1.02e6, "std": 1e4, "unit": "N/m³"}, {"value": 9.0, "std": 1.0, "unit": "kg"}
    alone = said("effect", explained("cubic_stiffness", "structure 7", 0.9, parameters={"k": k}))
    found = judge(CUBIC, alone)
    assert (found.parameter, round(found.deviation, 6)) == ("k", 2.0)
    # Of two effects, names of parameters say whose they are.
    parameters = {"cubic_stiffness@7.k": k, "force_gain@f2.g": {"value": 0.01, "std": 0.01, "unit": "1"}}
    both = said("effect", explained("cubic_stiffness + force_gain", "structure 7", 0.9, parameters=parameters))
    found = judge(PAIR, both)
    assert (found.parameter, round(found.deviation, 6)) == ("force_gain.g", -3.0)
    # A number of another effect is not an estimate of this one's.
    other = said("effect", explained("added_mass", "structure 7", 0.9, parameters={"k": wrong}))
    assert judge(CUBIC, other).parameter == ""
    # Nor one at another point, where another value does the same.
    tied = ForeignTruth("effect", ("effect",), CUBIC.effects, parameters={"cubic_stiffness@7.k": 1e6})
    assert round(judge(tied, alone).deviation, 6) == 2.0
    moved = said("effect", explained("cubic_stiffness", "structure 6", 0.9, parameters={"k": k}))
    assert judge(tied, moved).parameter == ""
    refitted = said("calibration", p=0.9, calibration=[{"name": "joint.slip_force_n", "to": 1.2, "std": 0.1}])
    found = judge(SHIFTED, refitted)
    assert (found.parameter, round(found.deviation, 6)) == ("joint.slip_force_n", -0.5)


PROGRAM = """
import json, pathlib, sys, time
words = sys.argv[1:]
out = pathlib.Path(words[words.index("--out") + 1])
with open({calls!r}, "a") as file:
    file.write(" ".join(words) + "\\n")
out.mkdir(parents=True)
case = out.parent.name
if words[0] == "import":
    if case == "refused":
        sys.exit("The sidecar is wrong; correct it.")
    raise SystemExit
if case == "endless":
    while True:
        pass
(out / "diagnosis.json").write_text(json.dumps({answers!r}[case]))
"""


def laboratory(folder: Path, truths: dict[str, dict[str, Any]]) -> Path:
    """A laboratory whose data are a word."""
    for name, truth in truths.items():
        own = folder / "laboratory" / name
        own.mkdir(parents=True)
        for file in ("model.yaml", "sidecar_1.yaml", "sidecar_2.yaml"):
            (own / file).write_text(name)
        (own / "truth.yaml").write_text(yaml.safe_dump(truth))
    return folder / "laboratory"


def program(folder: Path, answers: dict[str, Any]) -> tuple[str, ...]:
    """Words that start a program which answers as given and notes how it was called."""
    script = folder / "program.py"
    script.write_text(PROGRAM.format(calls=str(folder / "calls"), answers=answers))
    return sys.executable, str(script)


def calls(folder: Path) -> list[str]:
    """What the program was asked for since the last time, without paths."""
    file = folder / "calls"
    lines = file.read_text().splitlines() if file.exists() else []
    file.unlink(missing_ok=True)
    return [line.split()[0] for line in lines]


def test_what_was_diagnosed_is_not_diagnosed_again(tmp_path: Path) -> None:
    healthy = {"kind": "healthy", "verdicts": ["none", "calibration"]}
    folder = laboratory(tmp_path, {"fine": healthy, "refused": healthy})
    command, out = program(tmp_path, {"fine": said("none", p=0.9)}), tmp_path / "out"
    first = run_laboratory(folder, out, command)
    assert [line.answer.outcome for line in first] == ["right", "refused"]
    assert first[1].trouble == "The sidecar is wrong; correct it."
    assert not list(out.glob("*/imported*"))
    assert calls(tmp_path) == ["import", "import", "diagnose", "import"]
    # The same again, and with the truth corrected: nothing is run, the class follows the truth.
    (folder / "fine" / "truth.yaml").write_text("{kind: healthy, verdicts: [calibration]}")
    again = run_laboratory(folder, out, command)
    assert [(line.answer.outcome, line.kept) for line in again] == [("confidently wrong", True), ("refused", True)]
    assert calls(tmp_path) == []
    # A changed file of the case, another program, and the user's wish.
    (folder / "fine" / "sidecar_2.yaml").write_text("changed")
    run_laboratory(folder, out, command)
    assert calls(tmp_path) == ["import", "import", "diagnose"]
    result = out / "fine" / "result.json"
    result.write_text(json.dumps(json.loads(result.read_text()) | {"program": "another"}))
    run_laboratory(folder, out, command, only=["fine"])
    assert calls(tmp_path) == ["import", "import", "diagnose"]
    assert len(run_laboratory(folder, out, command, only=["fine"], force=True)) == 1
    assert calls(tmp_path) == ["import", "import", "diagnose"]


def test_a_diagnosis_without_an_end_is_ended(tmp_path: Path) -> None:
    folder = laboratory(tmp_path, {"endless": {"kind": "healthy", "verdicts": ["none"]}})
    (line,) = run_laboratory(folder, tmp_path / "out", program(tmp_path, {}), limit=1.0)
    assert line.answer.outcome == "refused"
    assert "1 s of processor time" in line.trouble
    assert 0.9 < line.import_seconds + line.seconds < 5.0


def test_the_tables_say_what_was_found(tmp_path: Path) -> None:
    answers = {
        "a": (CUBIC, said("effect", explained("cubic_stiffness", "structure 7", 0.9), gap={"closed": 0.99})),
        "b": (FINE, said("unknown", p=0.7)),
        "c": (FINE, said("none", p=0.9)),
        "d": (CUBIC, None),
    }
    lines = [
        ForeignLine(name, truth.kind, "", judge(truth, answer), seconds, 1.0)
        for (name, (truth, answer)), seconds in zip(answers.items(), (4.0, 8.0, 30.0, 2.0), strict=True)
    ]
    found = summary(lines)
    assert found["classes"] == {
        "right": 2, "hedged right": 0, "honest unknown": 0, "hedged wrong": 1, "confidently wrong": 0, "refused": 1
    }  # fmt: skip
    assert (found["share_right_or_hedged"], found["healthy"], found["alarms"]) == (0.5, 2, 1)
    assert (found["seconds_median"], found["seconds_worst"]) == (8.0, 30.0)
    text = "\n".join(print_lines(lines))
    assert "right or hedged right 50.0 %" in text
    assert "alarms in 1 of 2 healthy" in text
    table, document = write_tables(lines, tmp_path)
    with table.open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [row["outcome"] for row in rows] == ["right", "hedged wrong", "right", "refused"]
    entries = json.loads(document.read_text())["cases"]
    assert (entries[0]["closed"], entries[3]["probability"]) == (0.99, None)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("{kind: healthy}", "kind and verdicts"),
        ("{kind: sound, verdicts: [none]}", "kind must be one of"),
        ("{kind: healthy, verdicts: [fine]}", "verdicts must be a list"),
        ("{kind: effect, verdicts: [effect]}", "needs its name"),
        ("{kind: healthy, verdicts: [none], parameters: {k: much}}", "must be numbers by name"),
        ("{kind: healthy, verdicts: [none], place: 7}", "place must be a list"),
        ("{kind: healthy, verdicts: [none], colour: red}", "may have effects"),
    ],
)
def test_a_mistake_in_a_truth_is_said(tmp_path: Path, text: str, sentence: str) -> None:
    (tmp_path / "truth.yaml").write_text(text)
    with pytest.raises(BenchError, match=sentence):
        read_truth(tmp_path / "truth.yaml")


def test_a_folder_without_cases_and_a_case_without_a_model_are_refused(tmp_path: Path) -> None:
    with pytest.raises(BenchError, match="holds no cases"):
        read_cases(tmp_path)
    (tmp_path / "one").mkdir()
    (tmp_path / "one" / "truth.yaml").write_text("{kind: healthy, verdicts: [none]}")
    with pytest.raises(BenchError, match=r"lacks model\.yaml or sidecar\.yaml"):
        read_cases(tmp_path)


def backbone_case(own: Path, hardening: float, truth: str) -> None:
    """A printed table of one mode; ``hardening``: relative rise of its frequency at 1 mm."""
    own.mkdir(parents=True)
    (own / "model.yaml").write_text(
        "{name: one_mode, structure: {kind: modal, modes: [{frequency_hz: 50.0, damping_ratio: 0.01}]}}"
    )
    draw = np.random.default_rng(1)
    rows = [
        f"{50.0 * (1 + hardening * q**2 + 2e-5 * draw.standard_normal()):.4f},{q:.3g},"
        f"{1 + 0.01 * draw.standard_normal():.3f},0.001,0.01"
        for q in np.geomspace(0.01, 1.0, 9)
    ]
    (own / "table.csv").write_text("\n".join(["frequency_hz,amplitude,zeta,f_std,zeta_std", *rows]) + "\n")
    (own / "sidecar.yaml").write_text(
        "rig: model.yaml\nfile: table.csv\nsegments:\n"
        "  - {kind: backbone, unit: mm, point: 1, columns: {frequency_hz: frequency_hz, amplitude: amplitude,"
        " damping_ratio: zeta, frequency_hz_std: f_std, damping_ratio_std: zeta_std},"
        " units: {damping_ratio: '%', damping_ratio_std: '%'}}\n"
    )
    (own / "truth.yaml").write_text(truth)


@pytest.mark.campaign
def test_the_command_diagnoses_a_backbone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A printed table of a mode that is as its model says, by the program itself."""
    backbone_case(tmp_path / "laboratory" / "table", 0.0, "{kind: healthy, verdicts: [none, calibration]}")
    words = ["blind", "laboratory", str(tmp_path / "laboratory"), "--out", str(tmp_path / "out"), "--jobs", "1"]
    assert main(words) == 0
    assert "alarms in 0 of 1 healthy" in capsys.readouterr().out
    assert (tmp_path / "out" / "table" / "diagnosis" / "report.html").is_file()


@pytest.mark.campaign
def test_an_answer_is_accounted_for_beside_the_fitted_truth(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A cubic spring of known stiffness: ω² = ω₀² + ¾ k q² of a unit mass."""
    hardening = 0.004
    k = hardening * 8.0 / 3.0 * (2.0 * np.pi * 50.0) ** 2 / 1e-3**2
    truth = f"{{kind: effect, verdicts: [effect], effects: [cubic_stiffness], place: ['1'], parameters: {{k: {k}}}}}"
    backbone_case(tmp_path / "hard", hardening, truth)
    account = explain_foreign(tmp_path, "hard", (sys.executable, "-m", "nmt_bench"))
    assert (account.follows, account.truth, account.winner) == ("found", "cubic_stiffness@1", "cubic_stiffness@1")
    assert account.costs[2] == pytest.approx(account.costs[1], abs=0.5)
    assert account.sigma > 5.0
    assert main(["blind", "explain", "hard", "--laboratory", str(tmp_path)]) == 0
    assert "what follows: found" in capsys.readouterr().out
    with pytest.raises(BenchError, match="There is no case soft in"):
        explain_foreign(tmp_path, "soft", ())


@pytest.mark.campaign
@pytest.mark.parametrize("name", ["null_2", "more_14_cubic"])
def test_laboratory_one(tmp_path: Path, name: str) -> None:
    if not LABORATORY_ONE.is_dir():
        pytest.skip("The laboratory that others wrote is not at hand beside this repository.")
    laboratory_one.make_case(LABORATORY_ONE, tmp_path / "cases", name)
    (line,) = run_laboratory(tmp_path / "cases", tmp_path / "out", (sys.executable, "-m", "nmt_bench"))
    assert line.answer.outcome == "right", print_lines([line])


@pytest.mark.campaign
@pytest.mark.parametrize("seed", [0, 3, 4, 12])
def test_laboratory_two(tmp_path: Path, seed: int) -> None:
    """A plate and a beam as their models say, a mast on a table whose stiffness is off, a strip that hardens."""
    laboratory_two.make_case(tmp_path / "cases", seed)
    (line,) = run_laboratory(tmp_path / "cases", tmp_path / "out", (sys.executable, "-m", "nmt_bench"))
    assert line.answer.outcome == "right", print_lines([line])
