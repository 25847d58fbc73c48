"""``./nmt investigate`` refuses in one sentence before a node starts."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from nmt_bench.cli import main
from nmt_bench.command_parser import EXIT_FAILED
from nmt_bench.commands.investigate_command import random_length, reason_of_failure
from nmt_diagnose.investigation.investigation_record import InvestigationRecord
from nmt_rig.linear_description import linear_description
from nmt_rig.rig import load_rig

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
        ((*RIG, "--random", "inf"), "--random positive and finite"),
        ((*RIG, "--random", "1e9"), "duration"),
        ((*RIG, "--device", "evil"), "--device 'evil' is not known"),
        ((*RIG, "--levels", "0.1,51"), "51 V"),
        ((*RIG, "--latency-blocks", "-1"), "latency"),
        (RIG, "--allow-own-model"),
        (("--rig", "van_der_pol"), "Mode 1 of van_der_pol feeds its motion (damping -6 %)"),
        (("--real", "/"), "The folder / is not a bag"),
    ],
)
def test_refusals_are_sentences(
    words: tuple[str, ...], sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["investigate", "joint_resonator", *words, "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert sentence in error
    assert error.count("\n") == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("name", ["file/out", "x" * 300])
def test_a_folder_that_cannot_be_is_refused_in_a_sentence(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("", encoding="utf-8")
    words = ["investigate", "joint_resonator", *RIG, "--allow-own-model", "--out", str(tmp_path / name)]
    assert main(words) == 2
    error = capsys.readouterr().err
    assert "choose another one" in error
    assert error.count("\n") == 1


def test_a_failed_test_is_told_by_its_first_refusal() -> None:
    log = "ready\nnmt: The level of 51 V is above the limit of 20 V.\n[plant] closed\nsee run.json\n"
    assert reason_of_failure(log, {}) == "The level of 51 V is above the limit of 20 V."
    died = {"code": "FAILED", "message": "The node pll died."}
    assert reason_of_failure("ready\n[recorder] closed\n", died) == "The node pll died."
    assert reason_of_failure("ready\n[recorder] closed\n", {}) == "[recorder] closed"
    assert reason_of_failure("", {}) == ""


def test_a_test_that_fails_ends_with_the_code_of_a_failure(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Exit code 2 is for mistakes that change by another command; the same command goes on after a failure."""
    monkeypatch.setattr("sys.executable", shutil.which("false"))
    words = ["investigate", "joint_resonator", *RIG, "--allow-own-model", "--quiet", "--out", str(tmp_path / "out")]
    assert main(words) == EXIT_FAILED == 1
    error = capsys.readouterr().err
    assert "Test 01_linear failed" in error
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


@pytest.mark.parametrize(
    ("rig", "least"),
    [
        ("frame", 20.0),  # its modes are wide
        ("beam", 5.0 / (2.0 * 0.0051 * 24.0)),
        ("joint_resonator", 20.0),  # the narrow rigid-body mode below the mode under test does not count
    ],
)
def test_the_record_of_the_linear_test_resolves_the_narrowest_mode(rig: str, least: float) -> None:
    assert random_length(linear_description(load_rig(rig))) == pytest.approx(least, rel=0.15)
    assert random_length(None) == 20.0
