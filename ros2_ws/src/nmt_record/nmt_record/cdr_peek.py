"""A few fields straight from serialised messages, without decoding the rest.

The recorder looks at every block for gaps but must not spend time on samples. Offsets follow the CDR rules:
every primitive is aligned to its own size, counted from the byte after the four-byte encapsulation header.
"""

from __future__ import annotations

import struct
from typing import NamedTuple

_HEADER = 4
_UINT32 = struct.Struct("<I").unpack_from
_STAMP = struct.Struct("<iI").unpack_from
_FIRST_RATE = struct.Struct("<Qd").unpack_from
_SAMPLE = struct.Struct("<Q").unpack_from


class BlockExtent(NamedTuple):
    """Which samples a serialised ``SampleBlock`` holds; ``sample_rate`` in Hz."""

    first_sample: int
    samples: int
    sample_rate: float

    @property
    def end_sample(self) -> int:
        """Index of the sample after the last one."""
        return self.first_sample + self.samples


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


def peek_block(raw: bytes) -> BlockExtent:
    """Extent of a serialised ``nmt_msgs/SampleBlock``.

    Raises:
        ValueError: not little-endian CDR, too short, or the data does not divide into the channels.
    """
    _check(raw)
    try:
        position = 16 + _UINT32(raw, 12)[0]  # after stamp (8) and frame_id
        position += -(position - _HEADER) % 8
        first_sample, sample_rate = _FIRST_RATE(raw, position)
        position += 17  # quantity is one byte
        position = _skip_string(raw, position)  # unit
        position += -position % 4
        channels = _UINT32(raw, position)[0]
        position += 4
        if channels * 4 > len(raw):
            raise ValueError("the message is too short for its channels")
        for _ in range(channels):
            position = _skip_string(raw, position)
        position += -position % 4
        position += 4 + 4 * _UINT32(raw, position)[0]  # points
        values = _UINT32(raw, position)[0]
    except struct.error as error:
        raise ValueError("the message is too short for a block of samples") from error
    if not channels or values % channels or values * 8 > len(raw):
        raise ValueError(f"{values} values do not divide into {channels} channels")
    return BlockExtent(first_sample, values // channels, sample_rate)


class BlockPeek:
    """:func:`peek_block` for the blocks of one topic, whose names and lengths hardly ever change.

    The bytes between the numbers are compared with those of the block before; only when they differ is the message
    walked through again.
    """

    def __init__(self) -> None:
        self._head = self._middle = b""
        self._index = self._quantity = self._count = self._samples = 0

    def extent(self, raw: bytes) -> BlockExtent:
        """Extent of a serialised block; raises as :func:`peek_block`."""
        index = self._index
        if index and raw[12:index] == self._head and raw[self._quantity : self._count] == self._middle:
            first_sample, sample_rate = _FIRST_RATE(raw, index)
            return BlockExtent(first_sample, self._samples, sample_rate)
        extent = peek_block(raw)
        position = 16 + _UINT32(raw, 12)[0]
        self._index = position + -(position - _HEADER) % 8
        self._quantity = self._index + 16
        # Up to and including the number of values: everything that decides where the samples are.
        position = _skip_string(raw, self._quantity + 1)
        position += -position % 4
        channels = _UINT32(raw, position)[0]
        position += 4
        for _ in range(channels):
            position = _skip_string(raw, position)
        position += -position % 4
        self._count = position + 8 + 4 * _UINT32(raw, position)[0]
        self._head, self._middle = raw[12 : self._index], raw[self._quantity : self._count]
        self._samples = extent.samples
        return extent


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


def _skip_string(raw: bytes, position: int) -> int:
    position += -position % 4
    return int(position + 4 + _UINT32(raw, position)[0])
