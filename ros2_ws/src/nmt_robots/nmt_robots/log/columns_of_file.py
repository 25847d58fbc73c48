"""Columns of a file by name: one value or one for each joint in every row."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.files.hardened import read_arrays
from nmt_core.files.mat_file import read_attributes, read_mat
from nmt_record.exchange.clocks.message_clock import ClockChoice
from nmt_record.exchange.clocks.time_columns import TIME_NAME
from nmt_record.exchange.import_table import kind_of, read_table
from nmt_record.exchange.messages.ros_bag_table import is_bag, recordings_of
from nmt_record.exchange.source_table import SourceTable, split_name
from nmt_record.exchange.text.text_table import read_text_table
from nmt_robots.log.column_roles import POSITION, joint_words, roles_of

Array = np.ndarray[Any, Any]

STAMP = "(time of the messages)"
"""Column of a bag's clock."""
_HOLES = 0.9
"""Share of the rows that have a value; where fewer have one the others are rows of another clock."""
_RATES = ("fs", "rate", "rate_hz", "sample_rate", "sampling_rate", "sample_rate_hz")
_STEPS = ("dt", "ts", "step_s", "sample_time")


@dataclass(frozen=True, eq=False)
class FileColumns:
    """Columns of a log as they are in its file.

    Attributes:
        values: by name: N or N × J values, or a few for the whole log (gains), in the file's units.
        units: stated by the file next to the names; empty = none.
        rate_hz: rows per second that the file states; None = none.
        stamps: columns that the file has as dates or times of day; they hold seconds.
        notes: sentences on how it was read.
        question: what must be known of a bag's clock; empty where that is clear.
    """

    values: dict[str, Array]
    units: dict[str, str] = field(default_factory=dict)
    rate_hz: float | None = None
    stamps: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    question: str = ""


@dataclass(frozen=True)
class _Positions:
    """Tells which columns are measured positions: those that were chosen, or by their names and the joints'."""

    chosen: frozenset[str]
    joints: dict[tuple[str, ...], str]

    def count(self, columns: Iterable[str]) -> tuple[int, int]:
        """How many columns are positions of joints that the robot has, and of any."""
        if self.chosen:
            return 0, len(self.chosen & set(columns))
        roles = [role for name in columns if (role := roles_of(name, self.joints)[0]).kind == POSITION]
        measured = [role for role in roles if not role.commanded]
        return sum(bool(role.joint) for role in measured), len(measured)


def read_columns(
    path: Path, clock: str = "", joints: Sequence[str] = (), positions: Sequence[str] | str = ()
) -> FileColumns:
    """All columns of a log.

    Args:
        path: NPZ, MATLAB or HDF5 file, table of text, or bag of ROS 2.
        clock: of a bag's messages: header or log; empty = as judged.
        joints: of the robot, whose positions have the clock that all columns are read at.
        positions: the columns of the positions, where they are known.

    Raises:
        BenchError: it cannot be read.
    """
    if not path.exists():
        raise BenchError(f"The log {path} does not exist.")
    of_positions = _Positions(frozenset((positions,) if isinstance(positions, str) else positions), joint_words(joints))
    if is_bag(path):
        return _of_bag(path, clock, of_positions)
    if path.suffix.lower() == ".npz":
        return _of_arrays(dict(read_arrays(path, "log of joints")), {})
    if path.suffix.lower() in ("", ".log"):
        return _of_table(read_text_table(path), of_positions)
    if kind_of(path) == "mat":
        stated = {name: str(of.get("units", of.get("unit", ""))) for name, of in read_attributes(path).items()}
        return _of_arrays(read_mat(path, "log of joints"), stated)
    return _of_table(read_table(path), of_positions)


def _of_arrays(arrays: dict[str, Array], units: dict[str, str]) -> FileColumns:
    """Arrays as columns; rows first."""
    values: dict[str, Array] = {}
    rate: float | None = None
    for name, array in arrays.items():
        last = name.rpartition(".")[2].lower()
        if array.dtype.kind not in "fiub":
            values[name] = array
            continue
        column = np.asarray(array, dtype=float)
        if column.ndim == 2 and column.shape[0] < column.shape[1] and column.shape[1] >= 50:
            column = column.T
        if column.size == 1 and float(column.ravel()[0]) > 0.0 and last in (*_RATES, *_STEPS):
            number = float(column.ravel()[0])
            rate = number if last in _RATES else 1.0 / number
        elif column.ndim == 2 and 1 in column.shape and column.size > 50 and TIME_NAME.match(last):
            column = column.ravel()
        values[name] = column
    return FileColumns(values, units, rate)


def _of_table(table: SourceTable, positions: _Positions) -> FileColumns:
    names = [name or f"column {number + 1}" for number, name in enumerate(table.names)] or [
        f"column {number + 1}" for number in range(len(table.columns))
    ]
    columns = {
        name: np.asarray(values, dtype=float)
        for number, (name, values) in enumerate(zip(names, table.columns, strict=True))
        if number not in table.parts
    }
    rate = table.sample_rate or (1.0 / table.step if table.step else None)
    units = {name: unit for name, unit in zip(names, table.units, strict=True) if unit}
    stamps = tuple(names[number] for number in table.stamps)
    columns, notes = _one_clock(columns, stamps, positions)
    return FileColumns(columns, units, rate, stamps, (*table.notes, *notes))


def _of_bag(path: Path, clock: str, positions: _Positions) -> FileColumns:
    """Fields of all topics that speak of joints, in the rows of the messages that have the positions."""
    recordings, notes = recordings_of(path, ClockChoice(clock))
    spoken = [
        (one, judged, columns)
        for one, judged in recordings
        if one.block == 1 and (columns := {n: v for n, v in one.columns.items() if _speaks_of_joints(n, positions)})
    ]
    with_positions = [one for one in spoken if any(positions.count(one[2]))]
    if not with_positions:
        why = " ".join(notes)
        raise BenchError(f"The bag {path.name} has no positions of joints by the names of its fields. {why}".strip())
    head, head_clock, head_columns = max(with_positions, key=lambda one: (positions.count(one[2]), one[0].logged.size))
    question = next((judged.question[0] for _, judged, _ in spoken if judged.question), "")
    time = np.asarray((head_clock.time - head_clock.time[0]) * 1e-9, dtype=float)
    values: dict[str, Array] = {STAMP: time, **{name: rows[head_clock.rows] for name, rows in head_columns.items()}}
    for one, judged, theirs in spoken:
        if one is head:
            continue
        at = (judged.time - head_clock.time[0]) * 1e-9
        for name, rows in theirs.items():
            values.setdefault(name, sampled(at, rows[judged.rows], time, _is_command(name)))
        notes.append(f"{one.name} has a clock of its own and was read at the times of {head.name}.")
    return FileColumns(values, notes=(*head.notes, *head_clock.notes, *notes), question=question)


def _speaks_of_joints(name: str, positions: _Positions) -> bool:
    """Whether a field is a position, speed, effort, current or command of a joint."""
    role = roles_of(name, positions.joints)[0]
    return name in positions.chosen or (role.kind not in ("", "other") or (role.commanded and role.kind == ""))


def _is_command(name: str) -> bool:
    return roles_of(name, {})[0].commanded


def sampled(at: Array, values: Array, wanted: Array, held: bool) -> Array:
    """Values of another clock at some times: as they were last where they are held, else on a straight line.

    NaN where there are none, but for commands before the first one, which was there before the recording.
    """
    known = np.isfinite(values) & np.isfinite(at)
    at, values = at[known], values[known]
    if not len(at):
        return np.full(len(wanted), np.nan)
    if held:
        places = np.searchsorted(at, wanted + 1e-9, side="right") - 1
        return np.asarray(values[np.maximum(places, 0)])
    return np.interp(wanted, at, values, left=np.nan, right=np.nan)


def _one_clock(
    columns: dict[str, Array], stamps: Sequence[str], positions: _Positions
) -> tuple[dict[str, Array], list[str]]:
    """The rows that have positions, of a table whose blanks are rows of other topics; and a sentence on it."""
    masks = {name: np.isfinite(values) for name, values in columns.items() if values.dtype.kind == "f"}
    time = next((name for name in columns if _is_clock(name, columns[name], stamps)), None)
    groups: dict[bytes, list[str]] = {}
    for name, mask in masks.items():
        if name != time and mask.any():
            groups.setdefault(mask.tobytes(), []).append(name)
    if time is None or len(groups) < 2:
        return columns, []
    of_positions = [names for names in groups.values() if any(positions.count(names))]
    if not of_positions:
        return columns, []
    head = max(of_positions, key=lambda names: (positions.count(names), int(masks[names[0]].sum())))
    rows = masks[head[0]]
    others = [names for names in groups.values() if names is not head]
    elsewhere = np.zeros(len(rows), dtype=bool)
    for names in others:
        mask = masks[names[0]]
        if float(np.mean(mask & rows)) < (1.0 - _HOLES) * min(float(np.mean(mask)), float(np.mean(rows))) or (
            float(np.mean(mask[rows])) < _HOLES
        ):
            elsewhere |= mask
    # Rows in which nothing else stands either are holes.
    kept = rows | ~elsewhere
    if not elsewhere.any():
        return columns, []
    clock = columns[time]
    changed: dict[str, Array] = {}
    resampled = []
    for name, values in columns.items():
        if name == time or name not in masks or not (mask := masks[name]).any() or np.mean(mask[kept]) >= _HOLES:
            changed[name] = values[kept] if len(values) == len(kept) else values
            continue
        changed[name] = sampled(clock[mask], values[mask], clock[kept], _is_command(name))
        resampled.append(name)
    note = (
        f"The table has the rows of several clocks: {int(kept.sum())} of {len(kept)} rows have the positions; "
        f"{len(resampled)} columns of other clocks were read at their times."
    )
    return changed, [note]


def _is_clock(name: str, values: Array, stamps: Sequence[str]) -> bool:
    """Whether a column rises as a clock, by its name too."""
    called = name in stamps or TIME_NAME.match(split_name(name)[0].strip("_ ")) is not None
    known = values[np.isfinite(values)] if values.dtype.kind == "f" else values[:0]
    return called and len(known) > 2 and bool(np.all(np.diff(known) >= 0.0)) and bool(known[-1] > known[0])
