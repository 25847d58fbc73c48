"""Writes and reads ``modal.csv`` (the table) and ``modal.json`` (everything).

Numbers are written with as many digits as reading them back to the same bits takes, so two files of the same
extraction are identical. Rows of levels without values hold ``nan``; ``modal.json`` says why.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.files.hardened import json_value, read_rows, read_text
from nmt_core.files.plain_json import plain_json
from nmt_core.files.whole_file import csv_text, write_result
from nmt_core.messages.modal_point import COMPLEX, QUANTITIES, ModalPoint
from nmt_core.numerics.arrays import ComplexArray
from nmt_core.vocabulary import PointStatus
from nmt_extract.curves.limit_cycles import limit_cycles, write_limit_cycles
from nmt_extract.curves.response_curve import is_of_curve, response_curves, write_response_curves
from nmt_extract.modal.harmonics_indicators import HARMONICS_COLUMNS, any_control, indicators
from nmt_extract.modal.hysteresis import HysteresisLayout, loop_of_point

COLUMNS = ("level", *(item.name + suffix for item in QUANTITIES if item.csv for suffix in ("", "_std")))
"""Columns of ``modal.csv``, in order; units and meanings stand in :data:`nmt_core.messages.modal_point.QUANTITIES`."""

_BACKBONE = ("level", "omega_rad_s", "damping_ratio", "modal_amplitude")
"""Columns without which a table is none of modal points."""

LOOP_COLUMNS = ("level", "period_fraction", "relative_displacement_m", "joint_force_n")
"""Columns of ``hysteresis.csv``."""

LOOP_SAMPLES = 256
"""Rows of ``hysteresis.csv`` a level: one period."""

FORMAT = "nmt modal points 1"

_WHAT = "table of modal points"


def write_csv(points: Iterable[ModalPoint], path: Path | str) -> None:
    """Write ``modal.csv``: one row for each level, in the given order.

    Where harmonics of the force were controlled in any level, ``HARMONICS_COLUMNS`` follow.

    Raises:
        BenchError: the file cannot be written; an older file is then left as it was.
    """
    points = list(points)
    rows = [[repr(float(getattr(point, name))) for name in COLUMNS] for point in points]
    columns: tuple[str, ...] = COLUMNS
    if any_control(points):
        columns = (*COLUMNS, *HARMONICS_COLUMNS)
        for row, told in zip(rows, indicators(points), strict=True):
            row += [repr(float(getattr(told, name))) for name in HARMONICS_COLUMNS]
    write_result(Path(path), csv_text([columns, *rows]))


def read_csv(path: Path | str) -> dict[str, list[Any]]:
    """Read ``modal.csv`` of this or another release, or with columns that somebody has added.

    Returns:
        Columns by name in the order of the file: numbers, or texts where an unknown column has any. Columns of
        :data:`COLUMNS` that the file lacks follow, all NaN.

    Raises:
        BenchError: not there, no table of modal points, or a value of a known column that is not a number.
    """
    rows = read_rows(Path(path), _WHAT)
    names = tuple(rows[0]) if rows else ()
    lacking = [name for name in _BACKBONE if name not in names]
    if lacking:
        raise BenchError(f"{path} is not a table of modal points; its first line must have {','.join(_BACKBONE)}.")
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise BenchError(f"{path} has the column {twice[0]} twice; give each its name.")
    for number, row in enumerate(rows[1:], start=2):
        if len(row) != len(names):
            raise BenchError(f"{path} line {number} has {len(row)} values for {len(names)} columns.")
    columns: dict[str, list[Any]] = {name: [row[place] for row in rows[1:]] for place, name in enumerate(names)}
    for name, texts in columns.items():
        numbers = [_number(text) for text in texts]
        if None not in numbers:
            columns[name] = numbers
        elif name in (*COLUMNS, *HARMONICS_COLUMNS):
            line = numbers.index(None)
            raise BenchError(f"{path} line {line + 2}: {name} is '{texts[line]}'; give a number.")
    return columns | {name: [math.nan] * (len(rows) - 1) for name in COLUMNS if name not in columns}


def _number(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None


def write_json(points: Iterable[ModalPoint], path: Path | str, inputs: Mapping[str, Any] | None = None) -> None:
    """Write ``modal.json``: all fields, harmonics and reasons.

    Args:
        points: in the order of the levels.
        path: file.
        inputs: what the extraction worked with (linear description, settings, run id, ...), JSON values.

    Raises:
        BenchError: the file cannot be written; an older file is then left as it was.
    """
    document = {
        "format": FORMAT,
        "inputs": plain_json(dict(inputs or {})),
        "points": [_point_to_mapping(point) for point in points],
    }
    write_result(Path(path), json.dumps(document, indent=1, allow_nan=False, ensure_ascii=False) + "\n")


def read_json(path: Path | str) -> tuple[list[ModalPoint], dict[str, Any]]:
    """Read ``modal.json`` of this or an earlier release.

    Returns:
        Points (the same bits as were written; a field that the file lacks has the default of
        :class:`~nmt_core.messages.modal_point.ModalPoint`) and inputs.

    Raises:
        BenchError: not there, not such a file, or a point without number, level or status.
    """
    try:
        document = json_value(read_text(Path(path), _WHAT), str(path), bounded=False)
        if document["format"] != FORMAT:
            raise ValueError(f"its format is '{document['format']}'")
        return [_point_from_mapping(values) for values in document["points"]], document["inputs"]
    except (ValueError, KeyError, TypeError, OverflowError) as error:
        raise BenchError(f"{path} is not a file of modal points ('{FORMAT}'): {error}.") from error


def write_results(points: Sequence[ModalPoint], folder: Path | str, inputs: Mapping[str, Any] | None = None) -> None:
    """Write ``modal.csv`` and ``modal.json`` into a folder that exists, and ``hysteresis.csv`` where there are loops.

    ``limit_cycles.csv`` is written where the damping ratio passes through zero, ``response_curve.csv`` and
    ``response_folds.csv`` of response curves. There are loops where
    ``inputs["extraction"]["hysteresis"]`` names points and masses of a chain with a joint.

    Raises:
        BenchError: a file cannot be written.

    Examples:
        >>> write_results(nmt.extract("out/demo").points, "out/table")
        >>> [point.level for point in nmt.open("out/table").points]
        [0.1, 0.6]
    """
    write_csv(points, Path(folder) / "modal.csv")
    write_json(points, Path(folder) / "modal.json", inputs)
    if is_of_curve(points):
        write_response_curves(response_curves(points), folder)
    cycles = limit_cycles(points)
    if cycles:
        write_limit_cycles(cycles, Path(folder) / "limit_cycles.csv")
    layout = ((inputs or {}).get("extraction") or {}).get("hysteresis")
    if layout is not None:
        write_loops(points, HysteresisLayout.from_mapping(layout), Path(folder) / "hysteresis.csv")


def write_loops(points: Iterable[ModalPoint], layout: HysteresisLayout, path: Path | str) -> None:
    """Write ``hysteresis.csv``: joint force over relative displacement, ``LOOP_SAMPLES`` rows a level.

    Raises:
        BenchError: the file cannot be written; an older file is then left as it was.
    """
    rows: list[Sequence[str]] = [LOOP_COLUMNS]
    for point in points:
        loop = loop_of_point(layout, point)
        if loop is None:
            continue
        step = loop.force.shape[0] // LOOP_SAMPLES
        for phase, (displacement, force) in enumerate(
            zip(loop.relative_displacement[::step], loop.force[::step], strict=True)
        ):
            rows.append([repr(float(v)) for v in (point.level, phase / LOOP_SAMPLES, displacement, force)])
    write_result(Path(path), csv_text(rows))


def _point_to_mapping(point: ModalPoint) -> dict[str, Any]:
    values: dict[str, Any] = {item.name: getattr(point, item.name) for item in fields(point)}
    values["status"] = point.status.name
    for name in ("harmonics_control", "response_order", "force_order", "held_phase", "parameter"):
        if not values[name]:
            del values[name]
    if not point.exciter_points:
        del values["exciter_points"], values["exciter_forces"]
    for name in COMPLEX:
        if name not in values:
            continue
        values[name] = {"real": values[name].real, "imag": values[name].imag}
    return plain_json(values)  # type: ignore[no-any-return]


def _point_from_mapping(values: Mapping[str, Any]) -> ModalPoint:
    """The point of a file of any release: fields that it lacks have the record's defaults, unknown ones are ignored."""
    data: dict[str, Any] = {}
    for item in fields(ModalPoint):
        if item.name not in values:
            continue  # those without a default are shown by the record itself
        value = values[item.name]
        if item.name in COMPLEX:
            data[item.name] = _complex_array(value, 2 if item.name == "shape_harmonics" else 1)
        elif item.name == "status":
            data[item.name] = PointStatus[value]
        elif item.name in ("points", "exciter_points"):
            data[item.name] = tuple(value)
        else:
            data[item.name] = math.nan if value is None else value
    return ModalPoint(**data)


def _complex_array(value: Mapping[str, Any], dimensions: int) -> ComplexArray:
    real, imag = np.array(value["real"], dtype=np.float64), np.array(value["imag"], dtype=np.float64)
    result = np.empty(real.shape if real.size else (0,) * dimensions, dtype=np.complex128)
    result.real, result.imag = real.reshape(result.shape), imag.reshape(result.shape)
    return result
