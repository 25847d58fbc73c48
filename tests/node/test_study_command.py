"""A study through the nodes: table, report, and going on where it stopped."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest

pytest.importorskip("rclpy")

from nmt_bench import cli
from nmt_bench.studies import case_runner


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
