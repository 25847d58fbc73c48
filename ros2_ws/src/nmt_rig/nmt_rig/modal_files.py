"""Modes from files: a CSV table, or data sets 55 of a universal file as modal analysis programs export them.

What a data set 55 says is read here, not by a package: the format is ten records of fixed width, and a rig must load
where the recording side is not installed.
"""

from __future__ import annotations

import csv
import math
import re
from pathlib import Path
from typing import Any

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.files.universal_file import datasets
from nmt_rig.file_errors import BadFileError

_PLAIN_COLUMNS = ("frequency_hz", "damping_ratio", "modal_mass_kg", "participation")
_POINT_COLUMN = re.compile(r"point_([1-9]\d*)")
_NORMAL_MODE, _COMPLEX_MODES = 2, (3, 7)
_COMPLEX_DATA = 5
_DISPLACEMENT_SHAPES = (0, 1, 8)
# Of a shape's size may be imaginary, after the best rotation, for a mode to count as real.
_LARGEST_IMAGINARY = 0.1

Modes = list[dict[str, Any]]


def read_modal_csv(path: Path) -> tuple[list[int], Modes]:
    """Points and modes of a table: one row a mode, columns frequency_hz, damping_ratio, modal_mass_kg, participation
    (the last three may be left out), and point_1, point_7, … with the shape.

    Returns:
        Point numbers, and a mapping of rig-file keys for each mode.

    Raises:
        BadFileError: not such a table.
        OSError: the file cannot be read.
    """
    try:
        rows = list(csv.reader(path.read_text(encoding="utf-8-sig").splitlines()))
    except (UnicodeDecodeError, csv.Error) as error:
        raise BadFileError("it is not a CSV table in UTF-8") from error
    rows = [[cell.strip() for cell in row] for row in rows if row and not row[0].lstrip().startswith("#")]
    if len(rows) < 2:
        raise BadFileError("it needs a line of column names and a row for each mode")
    header = rows[0]
    points = [int(found[1]) for name in header if (found := _POINT_COLUMN.fullmatch(name))]
    unknown = [name for name in header if name not in _PLAIN_COLUMNS and not _POINT_COLUMN.fullmatch(name)]
    if unknown or "frequency_hz" not in header or len(set(header)) != len(header):
        wrong = f"column {unknown[0]!r} is not one of them" if unknown else "frequency_hz is missing or a name repeats"
        raise BadFileError(f"its columns must be {', '.join(_PLAIN_COLUMNS)} and point_1, point_2 and so on; {wrong}")
    modes: Modes = []
    for line, row in enumerate(rows[1:], start=1):
        if len(row) != len(header):
            raise BadFileError(f"row {line} has {len(row)} values for {len(header)} columns")
        try:
            numbers = [float(cell) for cell in row]
        except ValueError as error:
            raise BadFileError(f"row {line} has a value that is not a number ({error})") from error
        if not all(map(math.isfinite, numbers)):
            raise BadFileError(f"row {line} has a value that is not finite")
        mode: dict[str, Any] = {name: x for name, x in zip(header, numbers, strict=True) if name in _PLAIN_COLUMNS}
        mode["shape"] = [x for name, x in zip(header, numbers, strict=True) if name not in _PLAIN_COLUMNS] or [1.0]
        modes.append(mode)
    return points or [1], modes


def read_uff55(path: Path, direction: str = "z") -> tuple[list[int], Modes]:
    """Nodes and modes of all data sets 55 of a universal file; SI units, shapes of displacement.

    Normal modes come with their modal mass. Complex ones (analysis types 3 and 7) are turned into the real mode
    nearest to them; their modal mass is a / (2 i ω_d) of modal a.

    Args:
        path: the file.
        direction: x, y or z of the nodes.

    Returns:
        Node numbers, and a mapping of rig-file keys for each mode, by frequency.

    Raises:
        BadFileError: not a universal file, no data set 55, or one that is not whole, unscaled, or too complex.
        OSError: the file cannot be read.
    """
    try:
        found = [each.lines for each in datasets(path.read_bytes(), path.name) if each.kind == 55]
    except BenchError as error:
        raise BadFileError(f"it is not a whole universal file ({str(error).rstrip('.')})") from error
    shapes = [_data_set(lines, "xyz".index(direction)) for lines in found]
    if not shapes:
        raise BadFileError("it has no data set 55 (mode shapes); export the modes as UFF 55")
    points = sorted(shapes[0][1])
    if any(sorted(values) != points for _, values in shapes):
        raise BadFileError("its modes are not given at the same nodes")
    modes = [{**mode, "shape": [values[point] for point in points]} for mode, values in shapes]
    return points, sorted(modes, key=lambda mode: float(mode["frequency_hz"]))


def _numbers(line: str, width: int, kind: type) -> list[Any]:
    """Values of one record of fixed width."""
    text = line.rstrip()
    return [kind(text[start : start + width].replace("D", "E")) for start in range(0, len(text), width)]


def _data_set(lines: list[str], direction: int) -> tuple[dict[str, Any], dict[int, float]]:
    """Mode without shape, and its displacement by node."""
    try:
        _, analysis, characteristic, data_kind, data_type, per_node = _numbers(lines[5], 10, int)[:6]
        integers, reals = _numbers(lines[6], 10, int), _numbers(lines[7], 13, float)
        first = 8
        while len(integers) < 2 + integers[0]:  # further integers on lines of their own
            integers += _numbers(lines[first - 1], 10, int)
            reals, first = _numbers(lines[first], 13, float), first + 1
        count = per_node * (2 if data_type == _COMPLEX_DATA else 1)
        raw: dict[int, list[float]] = {}
        position = first
        while position < len(lines) and lines[position].strip():
            node = int(lines[position][:10])
            values: list[float] = []
            position += 1
            while len(values) < count:
                values += _numbers(lines[position], 13, float)
                position += 1
            raw[node] = values
    except (ValueError, IndexError) as error:
        raise BadFileError(f"a data set 55 is not whole or not of the form that UFF asks for ({error})") from error
    number = integers[3] if len(integers) > 3 else 0
    if data_kind not in _DISPLACEMENT_SHAPES:
        raise BadFileError(f"mode {number} has shapes of data type {data_kind}; export shapes of displacement (8)")
    if characteristic in (2, 3) and per_node < 3:
        raise BadFileError(f"mode {number} has {per_node} values a node where x, y and z are due")
    column = direction if per_node >= 3 else 0
    if data_type == _COMPLEX_DATA:
        shape = {node: complex(values[2 * column], values[2 * column + 1]) for node, values in raw.items()}
    else:
        shape = {node: complex(values[column]) for node, values in raw.items()}
    if not any(shape.values()):
        raise BadFileError(f"mode {number} does not move in direction {'xyz'[direction]}; set structure.direction")
    if analysis == _NORMAL_MODE:
        frequency, mass, viscous, hysteretic = (*reals, 0.0, 0.0, 0.0)[:4]
        damping = viscous if viscous else 0.5 * hysteretic
    elif analysis in _COMPLEX_MODES and len(reals) >= 4:
        root, a = complex(reals[0], reals[1]), complex(reals[2], reals[3])
        frequency, damping = abs(root) / (2.0 * np.pi), -root.real / abs(root) if root else 0.0
        entries = np.array(list(shape.values()))
        turn = np.exp(-0.5j * np.angle(np.sum(entries**2)))
        if np.linalg.norm((entries * turn).imag) > _LARGEST_IMAGINARY * np.linalg.norm(entries):
            raise BadFileError(f"mode {number} is too complex to stand for a real mode; export real (normal) modes")
        shape = {node: value * complex(turn) for node, value in shape.items()}
        mass = float((a * turn**2 / (2j * root.imag)).real) if root.imag else 0.0
    else:
        raise BadFileError(f"mode {number} is of analysis type {analysis}; normal (2) or complex (3, 7) modes are read")
    if not mass > 0.0:
        raise BadFileError(f"mode {number} has no modal mass, so its shape has no scale; export scaled modes")
    mode = {"frequency_hz": float(frequency), "damping_ratio": float(damping), "modal_mass_kg": float(mass)}
    return mode, {node: float(value.real) for node, value in shape.items()}
