"""What files and sidecars say of the clock, one mechanism for all readers."""

from __future__ import annotations

import datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from nmt_core.errors import BenchError
from nmt_record.exchange.clocks.column_clock import quantum_of
from nmt_record.exchange.import_table import read_table
from nmt_record.exchange.imports.imported_run import ImportedRun, read_import

ROWS = 400


def written(folder: Path, text: str, **keys: Any) -> ImportedRun:
    (folder / "data.csv").write_text(text)
    values = {
        "file": "data.csv",
        "channels": [{"column": "a", "quantity": "acceleration", "unit": "m/s^2", "point": 1}],
    }
    (folder / "s.yaml").write_text(yaml.safe_dump({**values, **keys}))
    return read_import(folder / "s.yaml")


def table(times: list[str], head: str = "t", above: str = "") -> str:
    values = np.sin(0.3 * np.arange(len(times)))
    return f"{above}{head},a\n" + "".join(f"{time},{value:.5f}\n" for time, value in zip(times, values, strict=True))


@pytest.mark.parametrize(
    ("line", "rate"),
    [
        ("Sample rate: 51200 Hz", 51200.0),
        ("Sampling Frequency [kHz];51.2", 51200.0),
        ("fs=1024Hz", 1024.0),
        ("Abtastrate: 2000 Hz", 2000.0),
        ("Sampling interval (ms): 0.5", 2000.0),
        ("Time step: 0.00025 s", 4000.0),
        ("Delta_X\t1.953125E-5", 51200.0),
        # What may be something else is not a clock.
        ("Sample rate: 51,200 Hz", None),
        ("Sample rate: 51.2", None),
        ("dt = 0.5", None),
        ("Sample time (s) of channel 1", None),
    ],
)
def test_clocks_in_headings(line: str, rate: float | None, tmp_path: Path) -> None:
    (tmp_path / "data.csv").write_text(f"{line}\na;b\n" + "0.1;0.2\n0.3;0.4\n" * 20)
    found = read_table(tmp_path / "data.csv")
    told = found.sample_rate or (1.0 / found.step if found.step else None)
    assert told == (None if rate is None else pytest.approx(rate))


@pytest.mark.parametrize(
    "stamp",
    [
        "2026-03-01T23:59:59.{:06d}",
        "2026-03-01 23:59:59.{:06d}",
        "2026-03-01T23:59:59.{:06d}+01:00",
        "01.03.2026 23:59:59.{:06d}",
        "3/1/2026 23:59:59.{:06d}",
        "23:59:59.{:06d}",
    ],
)
def test_dates_and_times_of_day(stamp: str, tmp_path: Path) -> None:
    run = written(tmp_path, table([stamp.format(2000 * k) for k in range(ROWS)], "when"))
    assert (run.sample_rate, run.samples) == (500.0, ROWS)


def test_midnight_and_the_end_of_a_month_are_passed(tmp_path: Path) -> None:
    begin = datetime.datetime(2026, 2, 28, 23, 59, 59, 800000)
    stamps = [(begin + datetime.timedelta(milliseconds=k)).isoformat(timespec="milliseconds") for k in range(ROWS)]
    assert written(tmp_path, table(stamps)).sample_rate == 1000.0


def test_a_zone_that_changes_is_refused(tmp_path: Path) -> None:
    stamps = [f"2026-03-01T10:00:00.{k:03d}{'Z' if k < 200 else '+01:00'}" for k in range(ROWS)]
    with pytest.raises(BenchError, match=r"line 202: the time zone changes from 'Z' to '\+01:00'"):
        written(tmp_path, table(stamps))


def test_a_heading_and_a_column_that_contradict(tmp_path: Path) -> None:
    text = table([f"{k / 1000:.4f}" for k in range(ROWS)], "t [s]", "Sample rate: 2000 Hz\n")
    with pytest.raises(BenchError, match=r"2000 Hz.*says 1000 Hz.*clock: header"):
        written(tmp_path, text)
    assert written(tmp_path, text, clock="header").sample_rate == 2000.0
    assert written(tmp_path, text, clock="column").sample_rate == 1000.0
    with pytest.raises(BenchError, match="clock is sample_rate, but there is no such clock"):
        written(tmp_path, text, clock="sample_rate")


@pytest.mark.parametrize("factor", [1.0, 0.5])
def test_a_slow_time_without_a_unit_is_asked(factor: float, tmp_path: Path) -> None:
    text = table([f"{factor * k:g}" for k in range(ROWS)])
    with pytest.raises(BenchError, match="says no unit: seconds, ms or numbers of samples"):
        written(tmp_path, text)
    assert written(tmp_path, text, time_unit="ms").sample_rate == 1000.0 / factor
    assert written(tmp_path, text, time_unit="s").sample_rate == 1.0 / factor
    assert written(tmp_path, text, sample_rate=400, clock="sample_rate").sample_rate == 400.0


def test_coarse_stamps_that_rise_give_a_rate_to_their_digits(tmp_path: Path) -> None:
    text = table([f"{k / 750:.3f}" for k in range(ROWS)], "time [s]")
    run = written(tmp_path, text)
    assert run.sample_rate == pytest.approx(750.0, rel=2.0 * run.clock_std)
    assert 1e-4 < run.clock_std < 2e-3
    assert written(tmp_path, text, sample_rate=750).sample_rate == 750.0
    # Samples are missing: the stamps run away from the rate.
    gone = [f"{(k if k < 200 else k + 8) / 750:.3f}" for k in range(ROWS)]
    with pytest.raises(BenchError):
        written(tmp_path, table(gone, "time [s]"), sample_rate=750)


def test_data_over_time_are_no_clock(tmp_path: Path) -> None:
    text = table([f"{np.sin(k):.4f}" for k in range(ROWS)], "time_data")
    with pytest.raises(BenchError, match="give sample_rate"):
        written(tmp_path, text)
    assert written(tmp_path, text, sample_rate=100).samples == ROWS


def test_the_quantum_of_stamps() -> None:
    time = np.arange(1000) / 1024.0
    assert quantum_of(np.round(time, 3)) == pytest.approx(1e-3)
    assert quantum_of(np.round(time, 6)) == pytest.approx(1e-6)
    assert quantum_of(1.7e9 + time) <= 1e-5
    assert quantum_of(np.pi * time) == 0.0
