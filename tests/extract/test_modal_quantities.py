"""The one table of modal quantities feeds files, tables, figures and the live page."""

from __future__ import annotations

import math
import os
import re
import subprocess
import sys
from dataclasses import dataclass, fields
from pathlib import Path

import pytest

from nmt_core.messages.modal_point import EVALUATED, MEASURED, QUANTITIES, ModalPoint
from nmt_core.messages.modal_quantity import measured, quantities_of
from nmt_extract.judgement.signal_faults import floors
from nmt_extract.modal.quantities import ModalQuantities
from nmt_report.columns import MODAL_COLUMNS


def test_every_quantity_has_its_standard_uncertainty_and_words() -> None:
    names = [item.name for item in fields(ModalPoint)]
    assert [name.removesuffix("_std") for name in names if name.endswith("_std")] == list(MEASURED)
    for quantity in QUANTITIES:
        assert quantity.unit
        assert quantity.meaning
        assert quantity.column is None or 1 <= quantity.column.rank <= 5


def test_a_field_without_its_standard_uncertainty_is_refused() -> None:
    @dataclass
    class Half:
        loudness: float = measured("1", "loudness of it")
        other: float = math.nan

    with pytest.raises(TypeError, match="loudness is followed by other; it must be loudness_std"):
        list(quantities_of(Half))


@pytest.mark.parametrize("name", EVALUATED)
def test_what_is_evaluated_of_harmonics_has_a_formula(name: str) -> None:
    assert hasattr(ModalQuantities, name), f"give ModalQuantities a property {name}"


def test_the_floor_of_a_quantity_follows_from_its_powers() -> None:
    """Independent of the table: relative uncertainties of a product of powers add in squares, each times its power."""
    values = dict.fromkeys(MEASURED, 2.0)
    force, drive, shape = 3e-6, 4e-6, 6e-6
    least = floors(force, drive, shape, values, 10, True)
    assert least["active_power"] == pytest.approx(2.0 * 5e-6)
    assert least["damping_ratio"] == pytest.approx(2.0 * 13e-6)
    assert least["modal_amplitude"] == 2.0 * shape
    assert least["mac"] == 2.0 * shape
    assert least["omega_rad_s"] == pytest.approx(2.0 * 3e-6 / (20 * math.pi))
    assert least["phase_error"] == pytest.approx(5e-6)
    without = floors(force, drive, shape, values, 10, False)
    assert set(least) - set(without) == {item.name for item in QUANTITIES if item.second_order}


def test_columns_of_the_tables_stand_in_their_order() -> None:
    known = (
        "omega_rad_s", "damping_ratio", "hysteresis_damping", "modal_amplitude", "force_n", "pbmif", "gamma_force",
        "gamma_acceleration", "mac",
    )  # fmt: skip
    assert tuple(column.name for column in MODAL_COLUMNS if column.name in known) == known


ONE_MORE = """
from dataclasses import dataclass
import math, sys
from pathlib import Path
import nmt_core.messages.modal_point as record
from nmt_core.messages.modal_quantity import Powers, TableColumn, measured, quantities_of

@dataclass(frozen=True, eq=False)
class WithOneMore(record.ModalPoint):
    loudness: float = measured(
        "1", "loudness of it", csv=True, from_harmonics=False, powers=Powers(force=-2), axis="loudness of it",
        curve="$Q$", column=TableColumn("Qf", unit="dB", factor=10.0, rank=1, live=True, after="damping_ratio"),
    )
    loudness_std: float = math.nan

record.ModalPoint = WithOneMore
record.QUANTITIES = tuple(quantities_of(WithOneMore))
record.MEASURED = tuple(quantity.name for quantity in record.QUANTITIES)

from rich.console import Console
from nmt.results import RunResults
from nmt_bench.commands.terminal import modal_table
from nmt_bench.page.live_view import LiveView
from nmt_extract.modal.table import write_results
from nmt_extract.judgement.signal_faults import floors
from nmt_report.run_report import report_html
from report.synthetic_run import synthetic_run

folder = Path(sys.argv[1])
data = synthetic_run(levels=4, failed=None)
points = [WithOneMore(**{**vars(p), "loudness": 12.5, "loudness_std": 0.25}) for p in data.points]
object.__setattr__(data, "points", points)
write_results(points, folder)
(folder / "report.html").write_text(report_html(data), encoding="utf-8")
console = Console(width=70, record=True, file=sys.stderr)
console.print(modal_table(points, None, 70))
(folder / "terminal.txt").write_text(console.export_text(), encoding="utf-8")
head, rows = LiveView()._table(points)
(folder / "page.txt").write_text(" | ".join([*head, *rows[0]["cells"]]), encoding="utf-8")
run = RunResults.read(folder)
(folder / "open.txt").write_text(f"{run.plot('loudness').get_ylabel()} {run.rows()[0]['loudness_std']}")
(folder / "floor.txt").write_text(repr(floors(1e-3, 0, 0, dict.fromkeys(record.MEASURED, 1.0), 9, True)["loudness"]))
"""


@pytest.mark.campaign
def test_one_more_quantity_is_everywhere_by_its_field_alone(tmp_path: Path) -> None:
    """Files, tables, figures, live page, ``nmt.open`` and floors take a field that they have never heard of."""
    tests = str(Path(__file__).resolve().parents[1])
    paths = [tests, *filter(None, sys.path)]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(paths), "MPLBACKEND": "agg"}
    done = subprocess.run(
        [sys.executable, "-c", ONE_MORE, tmp_path], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    text = {path.name: path.read_text(encoding="utf-8") for path in tmp_path.iterdir()}
    assert text["modal.csv"].splitlines()[0].endswith(",loudness,loudness_std")
    assert text["modal.csv"].splitlines()[1].endswith(",12.5,0.25")
    assert '"loudness_std": 0.25' in text["modal.json"]
    assert re.search(r"δ̃ +Qf +q", text["terminal.txt"])
    assert "125.0(2.5)" in text["terminal.txt"]
    assert "δ̃ / % | Qf / dB | q" in text["page.txt"]
    assert "125.0 ± 2.5" in text["page.txt"]
    assert text["open.txt"] == "loudness of it 0.25"
    assert text["floor.txt"] == "0.002"
    assert "Loudness of it over modal amplitude" in text["report.html"]
    assert "125.0 <i>± 2.5</i>" in text["report.html"]
