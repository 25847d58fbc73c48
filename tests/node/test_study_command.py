"""A study through the nodes: table, report, and going on where it stopped."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest

pytest.importorskip("rclpy")

from nmt_bench import cli
from nmt_study import case_runner

pytestmark = pytest.mark.campaign


def test_a_study_runs_compares_and_is_not_run_twice(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd) -> None:
    words = ["study", "levels", "--quick", "--jobs", "1", "--out", str(tmp_path / "out")]
    assert cli.main(words) == 0
    assert "2/2" in capfd.readouterr().out
    rows = list(csv.DictReader((tmp_path / "out" / "study.csv").read_text().splitlines()))
    assert len(rows) == 6
    for row in rows:
        assert row["status"] == "locked"
        assert abs(float(row["omega_error_single_point"])) < 1e-3
        assert abs(float(row["damping_error_single_point"])) < 2e-2
        assert float(row["periods"]) > 20
    report = (tmp_path / "out" / "report.html").read_text()
    assert "Order of the levels" in report

    def must_not_run(*_: object) -> None:
        raise AssertionError("a finished case was run again")

    monkeypatch.setattr(case_runner, "run_case", must_not_run)
    assert cli.main(words) == 0
    assert "2 of them done before" in capfd.readouterr().out
    assert (tmp_path / "out" / "report.html").read_text() == report
    (tmp_path / "out" / "cases" / "up.json").unlink()
    assert cli.main(words) == 1
    assert "Case up failed: AssertionError" in capfd.readouterr().out


def test_options_are_checked(tmp_path: Path, capfd) -> None:
    assert cli.main(["study", "nonsense", "--out", str(tmp_path / "x")]) == 2
    assert cli.main(["study", "levels", "--jobs", "0", "--out", str(tmp_path / "x")]) == 2
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes").write_text("x")
    assert cli.main(["study", "levels", "--quick", "--out", str(tmp_path / "mine")]) == 2
    assert "holds something else" in capfd.readouterr().err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["mine"]


def test_other_methods_are_compared_on_the_joint_resonator(tmp_path: Path, capfd) -> None:
    assert cli.main(["study", "method_comparison", "--quick", "--jobs", "1", "--out", str(tmp_path / "out")]) == 0
    said, page = capfd.readouterr().out, (tmp_path / "out" / "report.html").read_text()
    assert "not judged: phase resonance" in said
    assert "holds:" not in said
    assert "not for conclusions" in page
    assert ">holds<" not in page
    rows = list(csv.DictReader((tmp_path / "out" / "study.csv").read_text().splitlines()))
    methods = {row["labels"].split(";")[0].removeprefix("method=") for row in rows}
    assert methods == {
        "phase_resonance", "ring_down", "ring_downs", "apparent", "sweeps", "half_power", "stepped", "held_response",
    }  # fmt: skip

    def errors(method: str, quantity: str, low: float = 0.0) -> list[float]:
        return [
            abs(float(row[f"{quantity}_error_epmc"]))
            for row in rows
            if f"method={method};" in row["labels"]
            and float(row["omega_rad_s"]) ** 2 * float(row["modal_amplitude"]) > low
        ]

    for method in ("phase_resonance", "stepped", "held_response"):
        assert max(errors(method, "omega")) < 3e-4
        assert max(errors(method, "damping")) < 2e-2
    assert max(errors("ring_downs", "omega", 45.0)) < 3e-4
    assert max(errors("ring_downs", "damping", 45.0)) < 0.1
    # Structure and exciter together decay several times as fast as the structure.
    assert min(errors("apparent", "damping", 45.0)) > 0.5
    report = (tmp_path / "out" / "report.html").read_text()
    assert "Sensitivity to noise" in report
    assert "the rig joint_resonator" in report
