"""The three messages of the sample path as bytes.

Between plant and loop a message must not cost more than the block it carries. rclpy builds a Python object for every
nested field of every message; these codecs go from the bench's own types to the serialised form (XCDR version 1, little
endian, as Fast DDS and every bag have it) and back in a few microseconds. What others publish is read as well, and
what is published here is the ordinary message: tests compare byte for byte with rclpy.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from nmt_core.blocks import OscillatorPhase, Quantity, SampleBlock

_ENCAPSULATION = b"\x00\x01\x00\x00"
_BASE = len(_ENCAPSULATION)
_STAMP = struct.Struct("<iI")
_COUNT = struct.Struct("<I")
_INDEX = struct.Struct("<Qd")
_TAIL = struct.Struct("<dddB")


_MAX_SECONDS = 2**31 - 1


def _aligned(position: int, size: int) -> int:
    """Next position with the alignment of ``size``, counted from the end of the encapsulation header."""
    return _BASE + -(-(position - _BASE) // size) * size


def bench_stamp(sample: int, sample_rate: float) -> tuple[int, int]:
    """Bench time of a sample as seconds and nanoseconds, at most what a ROS time can hold."""
    seconds = int(sample / sample_rate)
    if seconds > _MAX_SECONDS:
        return _MAX_SECONDS, 999_999_999
    return seconds, min(999_999_999, round((sample - seconds * sample_rate) / sample_rate * 1e9))


def _string(text: str) -> bytes:
    data = text.encode()
    return _COUNT.pack(len(data) + 1) + data + b"\x00"


def _check_encapsulation(raw: bytes) -> None:
    if raw[:2] != _ENCAPSULATION[:2]:
        raise ValueError("the message is not little-endian XCDR1")


@dataclass(frozen=True, slots=True)
class _BlockLayout:
    """Where the parts of a serialised block are, for one set of channels and one length."""

    head: bytes
    middle: bytes
    index: int
    quantity: int
    data: int
    count: int
    tail: int
    values: tuple[Quantity, str, tuple[str, ...], tuple[int, ...]]


class BlockHead(NamedTuple):
    """A block without its samples; fields as in :class:`nmt_core.blocks.SampleBlock`."""

    first_sample: int
    samples: int
    sample_rate: float
    quantity: Quantity
    unit: str
    channels: tuple[str, ...]
    points: tuple[int, ...]
    oscillator: OscillatorPhase
    flags: int

    @property
    def end_sample(self) -> int:
        """Index of the sample after the last one."""
        return self.first_sample + self.samples


class BlockReader:
    """Reads serialised ``nmt_msgs/SampleBlock``.

    Blocks of one topic differ only in samples and a few numbers; the layout found with the first is used as long as
    names, points and lengths stay the same, which is compared every time.
    """

    def __init__(self) -> None:
        self._layout: _BlockLayout | None = None

    def read(self, raw: bytes) -> SampleBlock:
        """The block; its samples are a copy, so that ``raw`` may go.

        Raises:
            ValueError: the bytes are not a whole SampleBlock, or its data does not divide into its channels.
        """
        layout = self._layout_of(raw)
        try:
            first_sample, sample_rate = _INDEX.unpack_from(raw, layout.index)
            cycles, frequency, rate, flags = _TAIL.unpack_from(raw, layout.tail)
            data = np.frombuffer(raw, np.float64, layout.count, layout.data).copy()
        except (struct.error, ValueError) as error:
            raise ValueError(f"the message is not a whole SampleBlock: {error}") from error
        quantity, unit, channels, points = layout.values
        return SampleBlock(
            first_sample,
            sample_rate,
            quantity,
            unit,
            channels,
            points,
            data.reshape(len(channels), -1),
            OscillatorPhase(cycles, frequency, rate),
            flags,
        )

    def head(self, raw: bytes) -> BlockHead:
        """All but the samples, which are not touched: for whoever looks at every block of a long recording.

        Raises:
            ValueError: as :meth:`read`.
        """
        layout = self._layout_of(raw)
        try:
            first_sample, sample_rate = _INDEX.unpack_from(raw, layout.index)
            cycles, frequency, rate, flags = _TAIL.unpack_from(raw, layout.tail)
        except struct.error as error:
            raise ValueError(f"the message is not a whole SampleBlock: {error}") from error
        quantity, unit, channels, points = layout.values
        samples = layout.count // len(channels)
        phase = OscillatorPhase(cycles, frequency, rate)
        return BlockHead(first_sample, samples, sample_rate, quantity, unit, channels, points, phase, flags)

    def _layout_of(self, raw: bytes) -> _BlockLayout:
        layout = self._layout
        if (
            layout is None
            or len(raw) <= layout.tail
            or raw[12 : layout.index] != layout.head
            or raw[layout.quantity : layout.data] != layout.middle
        ):
            layout = self._layout = self._find_layout(raw)
        return layout

    @staticmethod
    def _find_layout(raw: bytes) -> _BlockLayout:
        _check_encapsulation(raw)
        try:
            _, index = _read_string(raw, 12)
            index = _aligned(index, 8)
            quantity_at = index + _INDEX.size
            unit, position = _read_string(raw, _aligned(quantity_at + 1, 4))
            position = _aligned(position, 4)
            (channel_count,) = _COUNT.unpack_from(raw, position)
            position += 4
            if channel_count > len(raw):
                raise ValueError("more channels than bytes")
            channels = []
            for _ in range(channel_count):
                name, position = _read_string(raw, _aligned(position, 4))
                channels.append(name)
            position = _aligned(position, 4)
            (point_count,) = _COUNT.unpack_from(raw, position)
            if 4 * point_count > len(raw):
                raise ValueError("more points than bytes")
            points = struct.unpack_from(f"<{point_count}I", raw, position + 4)
            position += 4 + 4 * point_count
            (count,) = _COUNT.unpack_from(raw, position)
            data = _aligned(position + 4, 8)
            quantity = Quantity(raw[quantity_at])
        except (struct.error, IndexError, UnicodeDecodeError) as error:
            raise ValueError(f"the message is not a whole SampleBlock: {error}") from error
        if data + 8 * count + _TAIL.size > len(raw):
            raise ValueError("the message is not a whole SampleBlock: it ends early")
        if not channels or count % len(channels):
            raise ValueError(f"{count} values do not divide into {len(channels)} channels")
        return _BlockLayout(
            raw[12:index],
            raw[quantity_at:data],
            index,
            quantity_at,
            data,
            count,
            data + 8 * count,
            (quantity, unit, tuple(channels), tuple(points)),
        )


def _read_string(raw: bytes, position: int) -> tuple[str, int]:
    (length,) = _COUNT.unpack_from(raw, position)
    end = position + 4 + length
    if end > len(raw):
        raise ValueError("a text runs past the end of the message")
    return raw[position + 4 : end - 1].decode(), end


class BlockWriter:
    """Serialises blocks of one quantity as ``nmt_msgs/SampleBlock``.

    Args:
        frame_id: name of the rig.
    """

    def __init__(self, frame_id: str) -> None:
        self._frame = _string(frame_id)
        self._key: tuple[object, ...] = ()
        self._buffer = bytearray()
        self._index = self._data = self._tail = 0

    def write(self, block: SampleBlock) -> bytes:
        """The serialised message."""
        key = (block.quantity, block.unit, block.channels, block.points, block.data.shape)
        if key != self._key:
            self._lay_out(block)
            self._key = key
        buffer = self._buffer
        _STAMP.pack_into(buffer, _BASE, *bench_stamp(block.first_sample, block.sample_rate))
        _INDEX.pack_into(buffer, self._index, block.first_sample, block.sample_rate)
        buffer[self._data : self._tail] = np.ascontiguousarray(block.data, dtype=np.float64).tobytes()
        phase = block.oscillator
        _TAIL.pack_into(buffer, self._tail, phase.cycles, phase.frequency_hz, phase.rate_hz_s, block.flags)
        return bytes(buffer)

    def _lay_out(self, block: SampleBlock) -> None:
        buffer = bytearray(_ENCAPSULATION + bytes(_STAMP.size) + self._frame)

        def pad(size: int) -> int:
            buffer.extend(bytes(_aligned(len(buffer), size) - len(buffer)))
            return len(buffer)

        self._index = pad(8)
        buffer.extend(bytes(_INDEX.size))
        buffer.append(int(block.quantity))
        pad(4)
        buffer.extend(_string(block.unit))
        pad(4)
        buffer.extend(_COUNT.pack(len(block.channels)))
        for channel in block.channels:
            pad(4)
            buffer.extend(_string(channel))
        pad(4)
        buffer.extend(_COUNT.pack(len(block.points)) + struct.pack(f"<{len(block.points)}I", *block.points))
        buffer.extend(_COUNT.pack(block.data.size))
        self._data = pad(8)
        buffer.extend(bytes(8 * block.data.size))
        self._tail = len(buffer)
        buffer.extend(bytes(_TAIL.size))
        self._buffer = buffer


class PlainDrive(NamedTuple):
    """A drive command without harmonics; fields as in ``nmt_msgs/Drive``."""

    apply_at_sample: int
    based_on_sample: int
    waveform: int
    frequency_hz: float
    amplitude: float
    ramp: float
    band_low_hz: float = 0.0
    band_high_hz: float = 0.0
    rate_hz_s: float = 0.0
    frequency_end_hz: float = 0.0


_DRIVE_END = 76  # position after the three counts: a message with harmonics has other things behind it
# stamp, apply, based, waveform, three numbers, three empty sequences, four numbers
_DRIVE = struct.Struct("<4siIQQB7xdddIII4xdddd")


def write_drive(drive: PlainDrive, sample_rate: float) -> bytes:
    """Serialise as ``nmt_msgs/Drive`` with the stamp of ``based_on_sample``."""
    return _DRIVE.pack(
        _ENCAPSULATION,
        *bench_stamp(drive.based_on_sample, sample_rate),
        drive.apply_at_sample,
        drive.based_on_sample,
        drive.waveform,
        drive.frequency_hz,
        drive.amplitude,
        drive.ramp,
        0,
        0,
        0,
        drive.band_low_hz,
        drive.band_high_hz,
        drive.rate_hz_s,
        drive.frequency_end_hz,
    )


def read_drive(raw: bytes) -> PlainDrive | None:
    """A serialised ``nmt_msgs/Drive``; None if it has harmonics and needs the full deserialisation.

    Raises:
        ValueError: the bytes are not a whole Drive message.
    """
    _check_encapsulation(raw)
    if len(raw) < _DRIVE_END:
        raise ValueError("the message is not a whole Drive")
    values = _DRIVE.unpack_from(raw)
    if values[9]:
        return None
    return PlainDrive(*values[3:9], *values[12:16])


class LoopStatus(NamedTuple):
    """State of the loop after a block; fields as in ``nmt_msgs/Frequency``."""

    last_sample: int
    level_index: int
    level_sequence: int
    state: int
    frequency_hz: float
    phase_error: float
    force_amplitude: float
    response_amplitude: float
    response_unit: str
    drive_amplitude: float
    flags: int = 0
    reason: str = ""


_STATUS_HEAD = struct.Struct("<4siIQIIB7xdddd")
_STATUS_TAIL = struct.Struct("<dB")


def write_status(status: LoopStatus, sample_rate: float) -> bytes:
    """Serialise as ``nmt_msgs/Frequency`` with the stamp of ``last_sample``."""
    head = _STATUS_HEAD.pack(
        _ENCAPSULATION,
        *bench_stamp(status.last_sample, sample_rate),
        status.last_sample,
        status.level_index,
        status.level_sequence,
        status.state,
        status.frequency_hz,
        status.phase_error,
        status.force_amplitude,
        status.response_amplitude,
    ) + _string(status.response_unit)
    head += bytes(_aligned(len(head), 8) - len(head)) + _STATUS_TAIL.pack(status.drive_amplitude, status.flags)
    return head + bytes(_aligned(len(head), 4) - len(head)) + _string(status.reason)


def read_status(raw: bytes) -> LoopStatus:
    """A serialised ``nmt_msgs/Frequency``.

    Raises:
        ValueError: the bytes are not a whole Frequency message.
    """
    _check_encapsulation(raw)
    try:
        head = _STATUS_HEAD.unpack_from(raw)
        unit, position = _read_string(raw, _STATUS_HEAD.size)
        position = _aligned(position, 8)
        drive_amplitude, flags = _STATUS_TAIL.unpack_from(raw, position)
        reason, _ = _read_string(raw, _aligned(position + _STATUS_TAIL.size, 4))
    except (struct.error, UnicodeDecodeError) as error:
        raise ValueError(f"the message is not a whole Frequency: {error}") from error
    return LoopStatus._make((*head[3:11], unit, drive_amplitude, flags, reason))
