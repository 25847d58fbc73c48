"""A few fields straight from serialised messages, without decoding the rest.

The recorder stamps every message and acts upon the run's state but must not spend time on the rest. Offsets follow the
CDR rules: every primitive is aligned to its own size, counted from the byte after the four-byte encapsulation header.
"""

from __future__ import annotations

import struct
from typing import NamedTuple

_HEADER = 4
_UINT32 = struct.Struct("<I").unpack_from
_STAMP = struct.Struct("<iI").unpack_from
_SAMPLE = struct.Struct("<Q").unpack_from


class RunStatePeek(NamedTuple):
    """The fields of a serialised ``RunState`` that the recorder acts upon."""

    run_id: str
    phase: int
    sample: int


def peek_stamp(raw: bytes) -> int:
    """Nanoseconds of a message whose first field is a ``Time`` or a ``Header``.

    Raises:
        ValueError: not little-endian CDR, or too short.
    """
    _check(raw)
    try:
        seconds, nanoseconds = _STAMP(raw, _HEADER)
    except struct.error as error:
        raise ValueError("the message is too short for a stamp") from error
    return int(seconds) * 1_000_000_000 + int(nanoseconds)


def peek_run_state(raw: bytes) -> RunStatePeek:
    """Run id, phase and sample of a serialised ``nmt_msgs/RunState``.

    Raises:
        ValueError: not little-endian CDR, or too short.
    """
    _check(raw)
    try:
        length = _UINT32(raw, 12)[0]
        run_id = bytes(raw[16 : 16 + length]).rstrip(b"\0").decode("utf-8", "replace")
        position = 16 + length
        phase = raw[position]
        position += 1
        position += -position % 4 + 8  # level_index, level_count
        position += -(position - _HEADER) % 8 + 16  # level, progress
        return RunStatePeek(run_id, phase, _SAMPLE(raw, position)[0])
    except (struct.error, IndexError) as error:
        raise ValueError("the message is too short for a run state") from error


def _check(raw: bytes) -> None:
    if len(raw) < _HEADER or raw[0] != 0 or raw[1] != 1:
        raise ValueError("the message is not plain little-endian CDR")
