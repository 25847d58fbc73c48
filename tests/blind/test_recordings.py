"""Real recordings: the commands of each plan are run, and what is said stands beside what is known."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import pytest

from nmt_blind.campaign.recordings import (
    KnownTruth,
    has_plans,
    outcome_of,
    read_known,
    run_recordings,
    summary_words,
    write_recordings,
)
from nmt_core.errors import BenchError

FRICTION = KnownTruth("friction", (frozenset({"microslip"}),), (frozenset({"unknown"}),), 0.9, False)
SOUND = KnownTruth("nothing", (frozenset({"none"}),), (frozenset({"air_drag"}),), 0.0, False)
BY_EYE = KnownTruth("a limit cycle", (), (), 0.0, True)


def said(verdict: str, *effects: str, p: float = 0.97, closed: float = 0.95, adequate: bool = True) -> dict[str, Any]:
    ranking = [{"effect": effect, "probability": p if k == 0 else 0.01} for k, effect in enumerate(effects)]
    return {
        "verdict": verdict, "ranking": ranking, "adequate": adequate, "gap": {"closed": closed},
        "sentences": ["Here.", "This."], "probabilities": {},
    }  # fmt: skip


@pytest.mark.parametrize(
    ("truth", "answer", "outcome"),
    [
        (FRICTION, said("effect", "microslip"), "right"),
        (FRICTION, said("effect", "microslip", closed=0.5), "hedged"),
        (FRICTION, said("effect", "microslip + response_gain"), "hedged"),
        (FRICTION, said("effect", "air_drag"), "confidently wrong"),
        (FRICTION, said("effect", "air_drag", p=0.6), "missed"),
        (FRICTION, said("effect", "air_drag", "microslip", adequate=False), "hedged"),
        (FRICTION, said("unknown", "air_drag"), "hedged"),
        (FRICTION, said("none"), "missed"),
        (SOUND, said("none"), "right"),
        (SOUND, said("effect", "air_drag"), "hedged"),
        (SOUND, said("unknown"), "missed"),
        (BY_EYE, said("none"), "by eye"),
    ],
)
def test_an_answer_is_worth(truth: KnownTruth, answer: dict[str, Any], outcome: str) -> None:
    assert outcome_of(truth, answer) == outcome


PROGRAM = """
import json, pathlib, sys
words = sys.argv[1:]
out = pathlib.Path(words[words.index("--out") + 1])
if words[0] == "import":
    if not pathlib.Path(words[1]).exists():
        sys.exit("There is no sidecar; write one.")
    out.mkdir()
if words[0] == "diagnose":
    out.mkdir()
    (out / "diagnosis.json").write_text(pathlib.Path("answer.json").read_text())
"""


def test_a_plan_is_run_with_bench_its_truth(tmp_path: Path) -> None:
    case, script = tmp_path / "cases" / "arm", tmp_path / "program.py"
    case.mkdir(parents=True)
    script.write_text(PROGRAM)
    (case / "a.yaml").write_text("")
    (case / "answer.json").write_text(json.dumps(said("effect", "microslip")))
    (case / "plan").write_text(
        "# in order\nimport a.yaml --out a\ndiagnose --real a --out d\n"
        "import b.yaml --out b\ndiagnose --real b --out e\n"
    )
    (case / "truth.yaml").write_text("{known: dry friction, right: [microslip], hedged: [unknown]}")
    assert has_plans(tmp_path / "cases")
    out = tmp_path / "out"
    found = run_recordings(tmp_path / "cases", out, (sys.executable, str(script)))
    # What an import did not leave is not diagnosed.
    assert [(it.command.split()[0], it.outcome) for it in found] == [("diagnose", "right"), ("import", "no answer")]
    assert found[1].answer == "There is no sidecar; write one."
    assert not (out / "arm" / "truth.yaml").exists()
    assert "1 recordings by their best answer: right 1" in summary_words(found)
    page = write_recordings(found, tmp_path / "cases", out)[2].read_text()
    assert "Known: dry friction." in page
    assert "| `diagnose --real a --out d` | right | Here. This. | 95.0 % |" in page
    with pytest.raises(BenchError, match="There is no case leg in"):
        run_recordings(tmp_path / "cases", out, (sys.executable, str(script)), only=["leg"])


def test_a_truth_says_what_is_right(tmp_path: Path) -> None:
    path = tmp_path / "truth.yaml"
    path.write_text("{known: something}")
    with pytest.raises(BenchError, match="must have the key right"):
        read_known(path)
    path.write_text("{right: ['self-excited: negative damping']}")
    assert read_known(path).by_eye
