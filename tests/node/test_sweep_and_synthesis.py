"""``./nmt sweep`` and ``./nmt synthesis`` on the joint resonator, shortened, through the nodes."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from nmt_bench.cli import main
from nmt_bench.harness import Bench
from nmt_core.vocabulary import ResultCode
from nmt_extract.curves.response_table import read_response_csv
from nmt_extract.modal.table import write_results
from nmt_record.bag.bag_reader import Bag
from nmt_record.windows.segments import segments
from nmt_report.response_analysis import model_responses
from nmt_rig.rig import load_rig

pytestmark = pytest.mark.node
RIG = "joint_resonator"
FAST = ["--one-process", "--quiet"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("responses")


@pytest.fixture(scope="module")
def swept(folder: Path) -> Path:
    out = folder / "sweep"
    arguments = ["--force", "14.65,38.15", "--from", "364", "--to", "371", "--rate", "1", "--points", "150"]
    assert main(["sweep", RIG, *arguments, *FAST, "--out", str(out)]) == 0
    return out


@pytest.fixture(scope="module")
def run(folder: Path) -> Path:
    out = folder / "run"
    with Bench(RIG, "1.2:18:9", out=out, window_periods=20) as bench:
        result = bench.run()
        inputs = {name: bench.plan.run[name] for name in ("run_id", "rig", "linear", "extraction")}
    assert result.code == ResultCode.SUCCEEDED
    write_results(result.points, out, inputs)
    return out


def test_sweep_leaves_what_the_contract_says(swept: Path) -> None:
    assert {"bag", "frf.csv", "report.html", "rig.yaml", "run.json"} <= {path.name for path in swept.iterdir()}
    tables = read_response_csv(swept / "frf.csv")
    assert [table.level for table in tables] == [14.65, 38.15]
    for table in tables:
        assert np.max(np.abs(table.held_error())) < 0.03
        assert np.all(np.diff(table.frequency_hz) > 0)
        assert table.channels == ("a1", "a2", "a3")
        assert np.all(table.frf_std > 0)
        assert table.rate_hz_s == pytest.approx(1.0)
    # Softer and more damped at the higher force.
    tops = [table.frequency_hz[np.argmax(np.abs(table.frf[0]))] for table in tables]
    assert tops[1] < tops[0] - 1.0
    assert np.abs(tables[1].frf[0]).max() < 0.8 * np.abs(tables[0].frf[0]).max()
    windows = segments(Bag.open(swept))
    assert [window.kind.label for window in windows] == ["sweep", "sweep"]
    assert [window.samples for window in windows] == [70_000, 70_000]
    page = (swept / "report.html").read_text(encoding="utf-8")
    assert "harmonic balance" in page
    assert "force held within" in page
    assert json.loads((swept / "run.json").read_text())["linear"] is None


@pytest.mark.campaign
def test_stepped_sine_is_the_models_steady_response(folder: Path, capfd: pytest.CaptureFixture[str]) -> None:
    out = folder / "stepped"
    arguments = ["--force", "14.65", "--from", "370", "--to", "368", "--stepped", "5", "--periods", "40"]
    assert main(["sweep", RIG, *arguments, *FAST, "--out", str(out)]) == 0
    (table,) = read_response_csv(out / "frf.csv")
    assert table.frequency_hz == pytest.approx([370.0, 369.5, 369.0, 368.5, 368.0])
    assert np.max(np.abs(table.held_error())) < 1e-3
    model = model_responses(load_rig(RIG), [14.65], 367.0, 371.0, table.channels)[0]
    for row in range(3):
        expected = model.at(row, table.frequency_hz) / 14.65
        assert np.abs(table.frf[row] - expected).max() < 3e-3 * np.abs(expected).max()
    assert "force error" in capfd.readouterr().out


def test_synthesis_from_the_backbone_meets_the_sweeps(
    folder: Path, swept: Path, run: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    linear = folder / "linear.json"
    linear.write_text(json.dumps(json.loads((run / "modal.json").read_text())["inputs"]["linear"]))
    out = folder / "synthesis"
    arguments = ["--backbone", str(run), "--linear", str(linear), "--sweep", str(swept), "--out", str(out)]
    capfd.readouterr()
    assert main(["synthesis", *arguments]) == 0
    lines = [line for line in capfd.readouterr().out.splitlines() if "synthesis: peak" in line]
    assert len(lines) == 6
    for line in lines:
        amplitude = float(line.split("synthesis: peak ")[1].split(" %")[0])
        frequency = float(line.split("frequency ")[1].split(" %")[0])
        assert abs(amplitude) < 3.0
        assert abs(frequency) < 0.1  # the sweep at 1 Hz/s lags by 0.04 %
    with (out / "synthesis.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert {row["force_n"] for row in rows} == {"14.65", "38.15"}
    assert float(rows[0]["frequency_hz"]) == pytest.approx(364.0, abs=0.2)
    assert "Half-power" in (out / "report.html").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["--from", "370", "--to", "370"], "two different"),
        (["--from", "360", "--to", "370", "--rate", "0"], "--rate must be positive"),
        (["--from", "360", "--to", "370", "--stepped", "1"], "--stepped needs"),
        (["--from", "360", "--to", "6000"], "half the sample"),
    ],
)
def test_sweep_refusals(arguments: list[str], word: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert main(["sweep", RIG, "--force", "5", *arguments, "--out", str(tmp_path / "out")]) == 2
    assert word in capfd.readouterr().err
    assert not (tmp_path / "out").exists()


def test_synthesis_refusals(swept: Path, run: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    out = ["--out", str(tmp_path / "out")]
    elsewhere = tmp_path / "frf.csv"
    with (swept / "frf.csv").open(encoding="utf-8") as file:
        table = list(csv.DictReader(file))
    with elsewhere.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, list(table[0]))
        writer.writeheader()
        writer.writerows({**row, "frequency_hz": float(row["frequency_hz"]) - 20.0} for row in table)
    assert main(["synthesis", "--backbone", str(run), "--sweep", str(elsewhere), *out]) == 2
    refusal = capfd.readouterr().err
    assert "from 344.1 to 350.9 Hz, where the backbone gives no response" in refusal
    assert "its own goes from 36" in refusal
    assert main(["synthesis", "--backbone", str(run), *out]) == 2
    assert "--sweep" in capfd.readouterr().err
    assert main(["synthesis", "--backbone", str(run), "--levels", "5", *out]) == 2
    assert "--from" in capfd.readouterr().err
    assert main(["synthesis", "--backbone", str(tmp_path), "--levels", "5", *out]) == 2
    assert "cannot be read" in capfd.readouterr().err
    missing = ["--linear", str(tmp_path / "no.json"), "--levels", "5"]
    assert main(["synthesis", "--backbone", str(run), *missing, *out]) == 2
    assert "no.json" in capfd.readouterr().err
