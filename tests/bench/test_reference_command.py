"""``./nmt reference``: the file, the comparison with a table, the convergence."""

from __future__ import annotations

import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from nmt_bench.cli import main
from nmt_bench.commands.run_command import _reference
from nmt_core.messages.driven_test import DrivenTest
from nmt_core.vocabulary import TestKind
from nmt_report.run_data import read_reference


def test_the_given_table_is_met(data_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table = data_folder / "epmc_beam_kt8000.csv"
    assert main(["reference", "beam", "--compare", str(table), "--out", str(tmp_path / "out")]) == 0
    printed = capsys.readouterr().out
    found = re.search(r"modal frequency (\S+), of damping ratio (\S+)", printed)
    assert found is not None
    assert float(found[1]) < 1e-4
    assert float(found[2]) < 1e-4
    written, given = read_reference(tmp_path / "out" / "reference.csv"), read_reference(table)
    np.testing.assert_allclose(written.modal_amplitude, given.modal_amplitude, rtol=1e-12)
    np.testing.assert_allclose(written.damping_ratio, given.damping_ratio, rtol=1e-4)


def test_a_wrong_table_shows(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table = tmp_path / "table.csv"
    table.write_text("modal_amplitude,omega_rad_s,damping_ratio\n1e-5,139.4238,0.0101176\n2e-5,139.4238,0.0101176\n")
    assert main(["reference", "beam", "--compare", str(table), "--out", str(tmp_path / "out")]) == 0
    assert "of damping ratio 5.0e-01" in capsys.readouterr().out


def test_convergence_falls_with_the_harmonics(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["reference", "beam", "--amplitudes", "1e-4:1e-3:8", "--convergence", "--out", str(tmp_path / "out")]
    assert main(words) == 0
    rows = re.findall(r"^\s+(\d+)\s+(\S+e-\d+)\s+(\S+e-\d+)\s*$", capsys.readouterr().out, re.MULTILINE)
    errors = [float(row[2]) for row in rows]
    assert [int(row[0]) for row in rows] == [1, 3, 5, 7, 20]
    assert errors == sorted(errors, reverse=True)
    assert errors[-1] < 1e-3 * errors[0]


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        (
            TestKind.PHASE_RESONANCE,
            "There is no reference to compare with: Newton's method does not converge at q = 1; ",
        ),
        (TestKind.RING_DOWN, "The reference is compared with modal points, and a ring down test gives free decays; "),
    ],
)
def test_a_run_says_why_it_has_no_reference(kind: TestKind, words: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object) -> None:
        raise ArithmeticError("Newton's method does not converge at q = 1.")

    monkeypatch.setattr("nmt_rig.reference.compute_reference", fails)
    bench: Any = SimpleNamespace(test=SimpleNamespace(driven=DrivenTest(kind=kind)), rig=None)
    result: Any = SimpleNamespace(points=[SimpleNamespace(modal_amplitude=1.0)])
    said: list[str] = []
    console = SimpleNamespace(print=lambda sentence, **_: said.append(sentence))
    assert _reference(None, bench, result, console) is None
    assert len(said) == 1
    assert said[0].startswith(words)
    assert said[0].endswith(".")
    assert _reference("none", bench, result, console) is None
    assert len(said) == 1
