"""Writes and reads the ``frf.csv`` of sweeps and stepped sines.

One row a frequency, the levels one after the other. Columns: ``segment`` (number of the window, from 0), ``level`` and
``level_unit`` (what was held), ``rate_hz_s`` (0 = stepped), ``frequency_hz``, ``force_n`` (|F₁|), ``voltage_v`` (|u₁|),
and for every response channel ``<name>_real``, ``<name>_imag`` (A₁/F₁, unit of the channel per N) and ``<name>_std``
(standard uncertainty of either part). Numbers read back to the same bits.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.files.hardened import read_rows
from nmt_core.files.whole_file import csv_text, write_result
from nmt_extract.curves.swept_response import FrequencyResponseTable

FIXED_COLUMNS = ("segment", "level", "level_unit", "rate_hz_s", "frequency_hz", "force_n", "voltage_v")
_PARTS = ("_real", "_imag", "_std")


def write_response_csv(tables: Sequence[FrequencyResponseTable], path: Path | str) -> None:
    """Write ``frf.csv``.

    Raises:
        BenchError: no tables, tables of different channels, or the file cannot be written.
    """
    if not tables:
        raise BenchError("No frequency response can be written.")
    channels = tables[0].channels
    if any(table.channels != channels for table in tables):
        raise BenchError("The levels of this sweep have different response channels.")
    rows: list[list[object]] = [[*FIXED_COLUMNS, *(name + part for name in channels for part in _PARTS)]]
    for number, table in enumerate(tables):
        for k, frequency in enumerate(table.frequency_hz):
            numbers = [frequency, table.force_n[k], table.voltage_v[k]]
            for row in range(len(channels)):
                value = table.frf[row, k]
                numbers += [value.real, value.imag, table.frf_std[row, k]]
            head = [number, repr(float(table.level)), table.level_unit, repr(float(table.rate_hz_s))]
            rows.append([*head, *(repr(float(item)) for item in numbers)])
    write_result(Path(path), csv_text(rows))


def read_response_csv(path: Path | str) -> list[FrequencyResponseTable]:
    """Read ``frf.csv`` of a sweep.

    Raises:
        BenchError: not there, other columns, or a value that is not a number.
    """
    rows = read_rows(Path(path), "table of responses")
    fixed = len(FIXED_COLUMNS)
    names = rows[0][fixed:] if rows else []
    channels = tuple(name.removesuffix("_real") for name in names[::3])
    expected = [name + part for name in channels for part in _PARTS]
    if not rows or tuple(rows[0][:fixed]) != FIXED_COLUMNS or names != expected or not channels:
        raise BenchError(f"{path} is not the frf.csv of a sweep; its first columns must be {','.join(FIXED_COLUMNS)}.")
    segments: dict[int, list[list[float]]] = {}
    units: dict[int, str] = {}
    for line, row in enumerate(rows[1:], start=2):
        try:
            if len(row) != len(rows[0]):
                raise ValueError
            key = int(row[0])
            segments.setdefault(key, []).append([float(cell) for i, cell in enumerate(row) if i != 2])
            units[key] = row[2]
        except ValueError as error:
            raise BenchError(f"{path} line {line} is not a row of {len(rows[0])} values.") from error
    if not segments:
        raise BenchError(f"{path} has no rows; its sweep gave no response.")
    tables = []
    for key, values in segments.items():
        data = np.array(values)
        body = data[:, fixed - 1 :].reshape(len(data), len(channels), 3)
        tables.append(
            FrequencyResponseTable(
                level=float(data[0, 1]),
                level_unit=units[key],
                rate_hz_s=float(data[0, 2]),
                frequency_hz=data[:, 3],
                force_n=data[:, 4],
                channels=channels,
                frf=(body[:, :, 0] + 1j * body[:, :, 1]).T,
                frf_std=body[:, :, 2].T,
                voltage_v=data[:, 5],
            )
        )
    return tables
