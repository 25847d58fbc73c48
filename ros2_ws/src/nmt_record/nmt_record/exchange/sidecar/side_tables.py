"""Side files of an exported run: the excitation's phase block by block; levels, locks and states of the loop."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar, get_type_hints

from nmt_core.errors import BenchError
from nmt_core.files.hardened import read_rows
from nmt_core.files.whole_file import csv_text, write_whole, writing
from nmt_core.messages.blocks import SAMPLE_TOPICS, OscillatorPhase
from nmt_core.messages.records import LevelCommand, LockEvent, LoopStatus

Record = TypeVar("Record")

_BLOCK_COLUMNS = ("first_sample", "samples", "cycles", "frequency_hz", "rate_hz_s")
_FLAGS = "flags_"
_SAMPLES = frozenset({"last_sample", "sample", "apply_at_sample", "window_first_sample", "window_samples", "time_ns"})
_RECORDS: dict[type, str] = {LoopStatus: "loop states", LevelCommand: "levels", LockEvent: "lock events"}


@dataclass(frozen=True)
class BlockRow:
    """One block of the recording.

    Attributes:
        first_sample: index of its first sample.
        samples: number of samples.
        oscillator: phase of the excitation.
        flags: topic -> flags of its block, as in ``nmt_msgs/SampleBlock``; 0 without an entry.
    """

    first_sample: int
    samples: int
    oscillator: OscillatorPhase
    flags: dict[str, int] = field(default_factory=dict)


def write_block_table(path: Path, rows: Sequence[BlockRow]) -> None:
    """Write ``oscillator.csv``; numbers read back to the same bits.

    Raises:
        BenchError: the file cannot be written.
    """
    topics = [topic for topic in SAMPLE_TOPICS if any(row.flags.get(topic) for row in rows)]
    lines: list[Sequence[object]] = [(*_BLOCK_COLUMNS, *(_FLAGS + topic for topic in topics))]
    lines += [
        (row.first_sample, row.samples, *map(repr, map(float, row.oscillator)), *(row.flags.get(t, 0) for t in topics))
        for row in rows
    ]
    _write(path, lines)


def read_block_table(path: Path, first_sample: int, samples: int) -> list[BlockRow]:
    """Read ``oscillator.csv``.

    Args:
        path: the file.
        first_sample: of the recording.
        samples: of the recording.

    Raises:
        BenchError: other columns, a value that is not a number, or blocks that overlap or leave the recording.
    """
    head, lines = _read(path)
    flags = [name for name in head[len(_BLOCK_COLUMNS) :] if name.removeprefix(_FLAGS) in SAMPLE_TOPICS]
    if tuple(head[: len(_BLOCK_COLUMNS)]) != _BLOCK_COLUMNS or len(head) != len(_BLOCK_COLUMNS) + len(flags):
        raise BenchError(f"{path.name} is not a table of blocks; its columns must be {', '.join(_BLOCK_COLUMNS)}.")
    rows = []
    reached = first_sample
    for number, cells in lines:
        try:
            first, count = int(cells[0]), int(cells[1])
            phase = OscillatorPhase(*(float(cell) for cell in cells[2:5]))
            marks = {name.removeprefix(_FLAGS): int(cell) for name, cell in zip(flags, cells[5:], strict=True)}
        except ValueError:
            raise BenchError(f"{path.name} line {number} is not a row of numbers.") from None
        if first < reached or count < 1 or first + count > first_sample + samples:
            raise BenchError(
                f"{path.name} line {number}: the block of samples {first} to {first + count - 1} overlaps the one "
                f"before or is outside the recording ({first_sample} to {first_sample + samples - 1})."
            )
        if any(map(math.isinf, phase)):
            raise BenchError(f"{path.name} line {number} has an infinite phase or frequency.")
        reached = first + count
        rows.append(BlockRow(first, count, phase, marks))
    if not rows:
        raise BenchError(f"{path.name} has no rows; leave 'oscillator' out of the sidecar if the phase is not known.")
    return rows


def write_records(path: Path, kind: type, records: Iterable[Any]) -> None:
    """Write records of one kind as they stand in messages, a line each; numbers read back to the same bits.

    Args:
        path: the file.
        kind: LoopStatus, LevelCommand or LockEvent.
        records: of that kind.

    Raises:
        BenchError: the file cannot be written.
    """
    types = get_type_hints(kind)
    lines: list[Sequence[object]] = [tuple(types)]
    for record in records:
        values = (getattr(record, name) for name in types)
        lines.append([repr(v) if isinstance(v, float) else int(v) if isinstance(v, int) else v for v in values])
    _write(path, lines)


def read_records(path: Path, kind: type[Record]) -> list[Record]:
    """Read what :func:`write_records` wrote.

    Raises:
        BenchError: other columns, a value that is not a number, or one that no message holds.
    """
    head, lines = _read(path)
    types, words = get_type_hints(kind), _RECORDS[kind]
    if head != list(types):
        raise BenchError(f"{path.name} is not a table of {words}; its columns must be {', '.join(types)}.")
    records = []
    for number, cells in lines:
        try:
            values = {name: types[name](_cell(types[name], cell)) for name, cell in zip(head, cells, strict=True)}
            for name, value in values.items():
                largest = 2**63 if name in _SAMPLES else 2**8 if name == "state" else 2**32
                if isinstance(value, int) and not 0 <= value < largest:
                    raise ValueError("out of range")
        except ValueError:
            raise BenchError(f"{path.name} line {number} is not a row of {words}.") from None
        records.append(kind(**values))
    return records


def _cell(kind: type, text: str) -> str | int:
    return int(text) if issubclass(kind, int) else text


def _write(path: Path, lines: Iterable[Sequence[object]]) -> None:
    with writing(path):
        write_whole(path, csv_text(lines))


def _read(path: Path) -> tuple[list[str], list[tuple[int, list[str]]]]:
    rows = read_rows(path, "table")
    return (rows[0] if rows else []), [(number, row) for number, row in enumerate(rows[1:], start=2) if row]
