"""Side files of an exported run: the excitation's phase and the loop's state, block by block."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from nmt_core.errors import BenchError
from nmt_core.files.hardened import read_rows
from nmt_core.files.whole_file import csv_text, write_whole, writing
from nmt_core.messages.blocks import SAMPLE_TOPICS, OscillatorPhase
from nmt_core.messages.records import LoopStatus

_BLOCK_COLUMNS = ("first_sample", "samples", "cycles", "frequency_hz", "rate_hz_s")
_FLAGS = "flags_"
_LOOP_COLUMNS = LoopStatus._fields
_WHOLE = frozenset({"last_sample", "level_index", "level_sequence", "state", "flags"})
_TEXT = frozenset({"response_unit", "reason"})


@dataclass(frozen=True)
class BlockRow:
    """One block of the recording.

    Attributes:
        first_sample: index of its first sample.
        samples: number of samples.
        oscillator: phase of the excitation.
        flags: topic -> flags of its block, as in ``nmt_msgs/SampleBlock``; 0 where there is no entry.
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
        BenchError: other columns, a value that is no number, or blocks that overlap or leave the recording.
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


def write_loop_table(path: Path, states: Iterable[LoopStatus]) -> None:
    """Write ``loop.csv``; numbers read back to the same bits.

    Raises:
        BenchError: the file cannot be written.
    """
    lines: list[Sequence[object]] = [_LOOP_COLUMNS]
    lines += [[repr(v) if isinstance(v, float) else v for v in status] for status in states]
    _write(path, lines)


def read_loop_table(path: Path) -> list[LoopStatus]:
    """Read ``loop.csv``.

    Raises:
        BenchError: other columns or a value that is no number.
    """
    head, lines = _read(path)
    if tuple(head) != _LOOP_COLUMNS:
        raise BenchError(f"{path.name} is not a table of loop states; its columns must be {', '.join(_LOOP_COLUMNS)}.")
    states = []
    for number, cells in lines:
        try:
            values = [
                cell if name in _TEXT else int(cell) if name in _WHOLE else float(cell)
                for name, cell in zip(_LOOP_COLUMNS, cells, strict=True)
            ]
            status = LoopStatus._make(values)
            if not (0 <= status.last_sample < 2**63 and 0 <= status.level_index < 2**32 and 0 <= status.state < 256):
                raise ValueError("out of range")
        except ValueError:
            raise BenchError(f"{path.name} line {number} is not a row of loop states.") from None
        states.append(status)
    return states


def _write(path: Path, lines: Iterable[Sequence[object]]) -> None:
    with writing(path):
        write_whole(path, csv_text(lines))


def _read(path: Path) -> tuple[list[str], list[tuple[int, list[str]]]]:
    rows = read_rows(path, "table")
    return (rows[0] if rows else []), [(number, row) for number, row in enumerate(rows[1:], start=2) if row]
