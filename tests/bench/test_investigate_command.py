"""``./nmt investigate`` refuses in one sentence before a node starts."""

from __future__ import annotations

from pathlib import Path

import pytest

from nmt_bench.cli import main
from nmt_diagnose.investigation.investigation_record import InvestigationRecord

RIG = ("--rig", "joint_resonator")


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ((), "either --rig"),
        ((*RIG, "--real", "bag"), "either --rig"),
        ((*RIG, "--until", "1.2"), "between 0.5 and 1"),
        ((*RIG, "--budget", "-3"), "--budget must be positive"),
        ((*RIG, "--periods", "1"), "--periods must be 2 or more"),
        (("--real", "bag", "--page"), "--page is of an investigation with --rig"),
        ((*RIG, "--calibration", "nowhere.yaml"), "nowhere.yaml"),
    ],
)
def test_refusals_are_sentences(
    words: tuple[str, ...], sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["investigate", "joint_resonator", *words, "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert sentence in error
    assert error.count("\n") == 1


@pytest.mark.parametrize("other", ["model", "real", "calibration", "changes"])
def test_what_another_investigation_measured_is_not_gone_on_with(
    other: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    values = {"model": "joint_resonator", "real": "joint_resonator", "calibration": "", "changes": ()}
    values[other] = ("seed=3",) if other == "changes" else "beam"
    InvestigationRecord(**values).write(tmp_path)  # type: ignore[arg-type]
    assert main(["investigate", "joint_resonator", *RIG, "--out", str(tmp_path)]) == 2
    assert "give another folder with --out" in capsys.readouterr().err
