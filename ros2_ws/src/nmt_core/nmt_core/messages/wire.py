"""Every message of the bench as bytes: one codec each, between the bench's records and the serialised form.

Between plant and loop a message must not cost more than the block it carries. rclpy builds a Python object for every
nested field of every message; these codecs go from the bench's own types to the serialised form (XCDR version 1, little
endian, as Fast DDS and every bag have it) and back in a few microseconds. What others publish is read as well, and
what is published here is the ordinary message: tests compare byte for byte with rclpy.

Samples, drive commands and loop states, of which each block needs one, have codecs written out by hand; those of the
others follow from the message files.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, field, fields
from itertools import chain
from typing import Any, NamedTuple

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import OscillatorPhase, SampleBlock
from nmt_core.messages.cdr import (
    BASE,
    ENCAPSULATION,
    STAMP,
    TIME,
    MessageCodec,
    aligned,
    append,
    bench_stamp,
    bench_time_ns,
    check_encapsulation,
    pad,
    read_string,
    string_bytes,
    take,
)
from nmt_core.messages.modal_point import COMPLEX, ModalPoint
from nmt_core.messages.records import (
    DriveCommand,
    DriveStop,
    DriveTerm,
    LevelCommand,
    LockEvent,
    LoopStatus,
    RunRecord,
    RunState,
    SignalLevels,
    Steering,
)
from nmt_core.numerics.arrays import FloatArray
from nmt_core.vocabulary import (
    OutputState,
    PointStatus,
    Quantity,
    RecordKind,
    ResultCode,
    RunPhase,
    SteeringAct,
    StopCause,
    TestKind,
    Waveform,
)

_INDEX = struct.Struct("<Qd")
_TAIL = struct.Struct("<dddB")


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
    """A block without its samples; fields as in :class:`nmt_core.messages.blocks.SampleBlock`."""

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
            first_sample, sample_rate, quantity, unit, channels, points, data.reshape(len(channels), -1),
            OscillatorPhase(cycles, frequency, rate), flags,
        )  # fmt: skip

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

    def samples(self, raw: bytes, row: int) -> FloatArray:
        """Samples of one channel, which cannot be written to and keep ``raw``.

        Raises:
            ValueError: as :meth:`read`.
            IndexError: no such channel exists.
        """
        layout = self._layout_of(raw)
        channels = len(layout.values[2])
        if not 0 <= row < channels:
            raise IndexError(f"channel {row} of {channels}")
        size = layout.count // channels
        return np.frombuffer(raw, np.float64, size, layout.data + 8 * size * row)

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
        check_encapsulation(raw)
        try:
            _, index = take(raw, BASE + STAMP.size, "string")
            index = aligned(index, 8)
            quantity_at = index + _INDEX.size
            unit, position = take(raw, quantity_at + 1, "string")
            channel_count, position = take(raw, position, "uint32")
            if channel_count > len(raw):
                raise ValueError("more channels than bytes")
            channels = []
            for _ in range(channel_count):
                name, position = take(raw, position, "string")
                channels.append(name)
            points, position = take(raw, position, "uint32[]")
            count, position = take(raw, position, "uint32")
            data = aligned(position, 8)
            quantity = Quantity(raw[quantity_at])
        except (struct.error, IndexError, UnicodeDecodeError) as error:
            raise ValueError(f"the message is not a whole SampleBlock: {error}") from error
        if data + 8 * count + _TAIL.size > len(raw):
            raise ValueError("the message is not a whole SampleBlock: it ends early")
        if not channels or count % len(channels):
            raise ValueError(f"{count} values do not divide into {len(channels)} channels")
        return _BlockLayout(
            raw[12:index], raw[quantity_at:data], index, quantity_at, data, count, data + 8 * count,
            (quantity, unit, tuple(channels), tuple(points)),
        )  # fmt: skip


class BlockWriter:
    """Serialises blocks of one quantity as ``nmt_msgs/SampleBlock``.

    Args:
        frame_id: name of the rig.
    """

    def __init__(self, frame_id: str) -> None:
        self._frame = string_bytes(frame_id)
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
        STAMP.pack_into(buffer, BASE, *bench_stamp(block.first_sample, block.sample_rate))
        _INDEX.pack_into(buffer, self._index, block.first_sample, block.sample_rate)
        buffer[self._data : self._tail] = np.ascontiguousarray(block.data, dtype=np.float64).tobytes()
        phase = block.oscillator
        _TAIL.pack_into(buffer, self._tail, phase.cycles, phase.frequency_hz, phase.rate_hz_s, block.flags)
        return bytes(buffer)

    def _lay_out(self, block: SampleBlock) -> None:
        buffer = bytearray(ENCAPSULATION + bytes(STAMP.size) + self._frame)

        self._index = pad(buffer, 8)
        buffer.extend(bytes(_INDEX.size))
        append(buffer, "uint8", block.quantity)
        append(buffer, "string", block.unit)
        append(buffer, "uint32", len(block.channels))
        for channel in block.channels:
            append(buffer, "string", channel)
        append(buffer, "uint32[]", block.points)
        append(buffer, "uint32", block.data.size)
        self._data = pad(buffer, 8)
        buffer.extend(bytes(8 * block.data.size))
        self._tail = len(buffer)
        buffer.extend(bytes(_TAIL.size))
        self._buffer = buffer


# stamp, apply, based, waveform, three numbers, three empty sequences, four numbers, four empty sequences
_DRIVE = struct.Struct("<4siIQQB7xdddIII4xddddIIII")


def write_drive(drive: DriveCommand, sample_rate: float) -> bytes:
    """Serialise as ``nmt_msgs/Drive`` with the stamp of ``based_on_sample``."""
    if drive.terms:
        values = {**drive._asdict(), "stamp": bench_time_ns(drive.based_on_sample, sample_rate)}
        ratios = [term for term in drive.terms if term.relative]
        volts = [term for term in drive.terms if not term.relative]
        values["exciters"] = [term.exciter for term in ratios]
        values["exciter_orders"] = [term.order for term in ratios]
        values["exciter_ratio_real"] = [term.value.real for term in ratios]
        values["exciter_ratio_imag"] = [term.value.imag for term in ratios]
        values["harmonics"] = [term.order for term in volts]
        values["harmonics_real"] = [term.value.real for term in volts]
        values["harmonics_imag"] = [term.value.imag for term in volts]
        return _HARMONIC_DRIVE.pack(values)
    return _DRIVE.pack(
        ENCAPSULATION, *bench_stamp(drive.based_on_sample, sample_rate), drive.apply_at_sample, drive.based_on_sample,
        drive.waveform, drive.frequency_hz, drive.amplitude, drive.ramp, 0, 0, 0, drive.band_low_hz,
        drive.band_high_hz, drive.rate_hz_s, drive.frequency_end_hz, 0, 0, 0, 0,
    )  # fmt: skip


def read_drive(raw: bytes) -> DriveCommand:
    """A serialised ``nmt_msgs/Drive``.

    Raises:
        ValueError: the bytes are not a whole Drive message.
        BenchError: the waveform is not known, or the harmonics' lists differ in length.
    """
    check_encapsulation(raw)
    if len(raw) < _DRIVE.size:
        raise ValueError("the message is not a whole Drive")
    values = _DRIVE.unpack_from(raw)
    if any(values[9:12]) or any(values[16:20]):
        return _HARMONIC_DRIVE.read(raw)
    waveform = _WAVEFORMS.get(values[5])
    if waveform is None:
        raise _unknown_waveform(values[5])
    return DriveCommand._make((waveform, *values[6:9], values[3], values[4], *values[12:16], ()))


_WAVEFORMS = {int(waveform): waveform for waveform in Waveform if waveform is not Waveform.UNKNOWN}


def _unknown_waveform(value: int) -> BenchError:
    return BenchError(f"drive command: waveform {value} is unknown; use OFF, SINE, RANDOM or SWEEP.")


def _drive_record(values: dict[str, Any]) -> DriveCommand:
    real, imag, orders = values.pop("harmonics_real"), values.pop("harmonics_imag"), values.pop("harmonics")
    if not len(orders) == len(real) == len(imag):
        raise BenchError("drive command: harmonics, harmonics_real and harmonics_imag must have equal lengths.")
    exciters, numbers = values.pop("exciters"), values.pop("exciter_orders")
    ratios = values.pop("exciter_ratio_real"), values.pop("exciter_ratio_imag")
    if not len(exciters) == len(numbers) == len(ratios[0]) == len(ratios[1]):
        raise BenchError("drive command: exciters, exciter_orders and exciter_ratio_* must have equal lengths.")
    if values["waveform"] not in _WAVEFORMS:
        raise _unknown_waveform(values["waveform"])
    del values["time_ns"]
    values["waveform"] = _WAVEFORMS[values["waveform"]]
    volts = zip(orders, map(complex, real.tolist(), imag.tolist()), strict=True)
    ratio = map(complex, ratios[0].tolist(), ratios[1].tolist())
    values["terms"] = (
        *(DriveTerm(1, order, value, relative=False) for order, value in volts),
        *(DriveTerm(*term) for term in zip(exciters, numbers, ratio, strict=True)),
    )
    return DriveCommand(**values)


_HARMONIC_DRIVE = MessageCodec("Drive", DriveCommand, make=_drive_record)


_STATUS_HEAD = struct.Struct("<4siIQIIB7xdddd")
_STATUS_TAIL = struct.Struct("<dB")


def write_status(status: LoopStatus, sample_rate: float) -> bytes:
    """Serialise as ``nmt_msgs/Frequency`` with the stamp of ``last_sample``."""
    stamp = bench_stamp(status.last_sample, sample_rate)
    head = _STATUS_HEAD.pack(ENCAPSULATION, *stamp, *status[:8]) + string_bytes(status.response_unit)
    head += bytes(aligned(len(head), 8) - len(head)) + _STATUS_TAIL.pack(status.drive_amplitude, status.flags)
    return head + bytes(aligned(len(head), 4) - len(head)) + string_bytes(status.reason)


def read_status(raw: bytes) -> LoopStatus:
    """A serialised ``nmt_msgs/Frequency``.

    Raises:
        ValueError: the bytes are not a whole Frequency message.
    """
    check_encapsulation(raw)
    try:
        head = _STATUS_HEAD.unpack_from(raw)
        unit, position = read_string(raw, _STATUS_HEAD.size)
        position = aligned(position, 8)
        drive_amplitude, flags = _STATUS_TAIL.unpack_from(raw, position)
        reason, _ = read_string(raw, aligned(position + _STATUS_TAIL.size, 4))
    except (struct.error, UnicodeDecodeError) as error:
        raise ValueError(f"the message is not a whole Frequency: {error}") from error
    return LoopStatus._make((*head[3:11], unit, drive_amplitude, flags, reason))


@dataclass(slots=True)
class NodeStatus:
    """One status of ``diagnostic_msgs/DiagnosticArray``, with its fields; ``values`` by their keys."""

    name: str
    hardware_id: str
    level: bytes = b"\x00"
    message: str = ""
    values: Mapping[str, object] = field(default_factory=dict)


def write_diagnostics(status: NodeStatus, time_ns: int) -> bytes:
    """Serialise one status as ``diagnostic_msgs/DiagnosticArray``, stamped with a time."""
    buffer = bytearray(ENCAPSULATION)
    for kind, value in ((TIME, time_ns), ("string", ""), ("uint32", 1)):
        append(buffer, kind, value)
    buffer.extend(status.level)
    for text in (status.name, status.message, status.hardware_id):
        append(buffer, "string", text)
    append(buffer, "uint32", len(status.values))
    for word in chain.from_iterable(status.values.items()):
        append(buffer, "string", str(word))
    return bytes(buffer)


def read_diagnostics(raw: bytes) -> list[NodeStatus]:
    """Every status of a serialised ``diagnostic_msgs/DiagnosticArray``.

    Raises:
        ValueError: the bytes are not a whole DiagnosticArray message.
    """
    check_encapsulation(raw)
    position = BASE + STAMP.size

    def following(kind: str) -> Any:
        nonlocal position
        value, position = take(raw, position, kind)
        return value

    statuses = []
    try:
        following("string")
        for _ in range(following("uint32")):
            level = raw[position : position + 1]
            position += 1
            name, message, hardware = (following("string") for _ in range(3))
            values = [(following("string"), following("string")) for _ in range(following("uint32"))]
            statuses.append(NodeStatus(name, hardware, level, message, dict(values)))
    except (struct.error, UnicodeDecodeError, ValueError) as error:
        raise ValueError(f"the message is not a whole DiagnosticArray: {error}") from error
    return statuses


def _numbers(values: Any) -> tuple[float, ...]:
    return tuple(values.tolist())


LEVEL = MessageCodec("Level", LevelCommand, {"test": TestKind.of})
"""``nmt_msgs/Level``."""
LOCK_EVENT = MessageCodec("LockEvent", LockEvent, {"test": TestKind.of})
"""``nmt_msgs/LockEvent``."""
RUN_STATE = MessageCodec("RunState", RunState, {"phase": RunPhase, "result_code": ResultCode})
"""``nmt_msgs/RunState``."""
STEERING = MessageCodec("Steering", Steering, {"act": SteeringAct, "levels": _numbers, "frequencies_hz": _numbers})
"""``nmt_msgs/Steering``."""
DRIVE_STOP = MessageCodec("DriveStop", DriveStop, {"cause": StopCause, "output": OutputState})
"""``nmt_msgs/DriveStop``."""
RUN_RECORD = MessageCodec("RunRecord", RunRecord, {"kind": RecordKind})
"""``nmt_msgs/RunRecord``."""

_LEVEL_PAIRS = tuple(
    f"{quantity.topic}_{what}" for quantity in Quantity if quantity is not Quantity.UNKNOWN for what in ("peak", "rms")
)


def _level_pairs(levels: SignalLevels) -> dict[str, float]:
    return dict(zip(_LEVEL_PAIRS, chain.from_iterable(levels.drive_point), strict=True))


def _monitor_record(values: dict[str, Any]) -> SignalLevels:
    pairs = [values.pop(name) for name in _LEVEL_PAIRS]
    return SignalLevels(drive_point=tuple(zip(pairs[::2], pairs[1::2], strict=True)), **values)


MONITOR = MessageCodec(
    "Monitor", SignalLevels, {"peak": _numbers, "rms": _numbers}, make=_monitor_record, otherwise=_level_pairs
)
"""``nmt_msgs/Monitor``."""


def _complex_parts(point: ModalPoint) -> dict[str, Any]:
    arrays = {name: getattr(point, name).ravel() for name in COMPLEX}
    return {f"{name}_{part}": getattr(array, part) for name, array in arrays.items() for part in ("real", "imag")}


def _point_record(values: dict[str, Any]) -> ModalPoint:
    for name in COMPLEX:
        real = values.pop(f"{name}_real")
        values[name] = np.empty(real.shape, dtype=np.complex128)
        values[name].real, values[name].imag = real, values.pop(f"{name}_imag")
    shape = values["shape_harmonics"]
    values["shape_harmonics"] = shape.reshape((values["harmonics"] + 1, -1) if shape.size else (0, 0))
    return ModalPoint(**values)


MODAL_POINT = MessageCodec(
    "ModalPoint",
    ModalPoint,
    {"status": PointStatus},
    make=_point_record,
    otherwise=_complex_parts,
)
"""``nmt_msgs/ModalPoint``."""

_RECORDS: dict[str, Any] = {
    "Drive": DriveCommand,
    "DriveStop": DriveStop,
    "Frequency": LoopStatus,
    "Level": LevelCommand,
    "LockEvent": LockEvent,
    "ModalPoint": ModalPoint,
    "Monitor": SignalLevels,
    "RunRecord": RunRecord,
    "RunState": RunState,
    "SampleBlock": SampleBlock,
    "Steering": Steering,
}


def record_defaults(name: str) -> dict[str, Any]:
    """What the fields of a message stand at where nothing is said of them, as far as its record has a default.

    Args:
        name: of the message, for example ``ModalPoint``; one without a record has none.
    """
    record = _RECORDS.get(name)
    if record is None:
        return {}
    if hasattr(record, "_field_defaults"):
        return dict(record._field_defaults)
    return {item.name: item.default for item in fields(record) if item.default is not MISSING}
