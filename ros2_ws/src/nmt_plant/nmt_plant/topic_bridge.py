"""Topics of nodes that are none of the bench's as channels of it: stamped messages in, blocks of samples out.

The blocks lie on a grid of equal steps. Its sample 0 is the first stamp that all topics have passed, or, beside a
plant, the plant's own sample 0. Values at the times of the grid are those of the cubic through the four nearest
messages. Where messages are missing, samples are NaN; where nothing came at all, there is no block.

This is no sample clock that is shared with the excitation: the phase of a channel is as good as its stamps are. No loop
can be closed over it.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.files.yaml_document import YamlDocument, read_document
from nmt_core.messages.blocks import Quantity, SampleBlock
from nmt_core.messages.stamped_samples import field_getter, interpolated
from nmt_core.nodes.node_settings import NodeSettings
from nmt_core.settings import setting


@dataclass(frozen=True)
class TopicBridgeSettings(NodeSettings):
    """Which topics become which channels."""

    table: str = setting("", "Channel table: a YAML file, see the how-to on foreign topics.")
    rig: str = setting("", "Name of the rig, for the frame of the blocks.")
    reference: str = setting(
        "",
        "Topic of samples of a plant that runs beside, such as force: its sample index is taken; empty = a "
        "clock of its own, from the first message on.",
    )
    patience: float = setting(
        1.0, "How far a topic may be behind the others before its samples count as missing.", unit="s", low=0.05
    )


_QUANTITIES = ("force", "displacement", "velocity", "acceleration", "voltage", "current")
_KEYS = ("topic", "type", "field", "quantity", "point", "scale", "delay_s", "name")
_BEHIND = 3  # messages that a cubic needs beyond the end of a block
_ENVELOPE = 500  # blocks of the plant over which the least delay of its messages is sought


@dataclass(frozen=True)
class BridgeChannel:
    """One line of the channel table.

    Attributes:
        topic: with its slash.
        kind: message type, ``package/msg/Name``.
        field: path of the number in the message, such as ``linear_acceleration.z`` or, of an array, ``data.1``.
        quantity: what it measures.
        point: measurement point; 0 = none.
        scale: factor of the values to the SI unit of the quantity.
        delay: by which the stamps are late, s.
        name: of the channel.
    """

    topic: str
    kind: str
    field: str
    quantity: Quantity
    point: int
    scale: float
    delay: float
    name: str

    def value(self, message: Any) -> float:
        """The number in a message, in SI units; NaN where the message has none."""
        head, _, last = self.field.rpartition(".")
        try:
            found = field_getter(head, int(last) - 1)(message) if last.isdigit() else field_getter(self.field)(message)
            return float(found) * self.scale
        except (AttributeError, IndexError, TypeError, ValueError):
            return math.nan


@dataclass(frozen=True)
class BridgeTable:
    """The channel table.

    Attributes:
        sample_rate: of the grid, Hz.
        block_samples: samples of a block.
        channels: at least one.
    """

    sample_rate: float
    block_samples: int
    channels: tuple[BridgeChannel, ...]

    @property
    def topics(self) -> dict[str, str]:
        """Message type by topic."""
        return {channel.topic: channel.kind for channel in self.channels}


def read_channel_table(path: Path) -> BridgeTable:
    """Read a channel table.

    Raises:
        BenchError: not there, or the first thing that is wrong in it, with its line.
    """
    document = read_document(path, "channel table", "sample_rate and channels")
    values = document.values
    for key in values:
        if key not in ("sample_rate", "block_samples", "channels"):
            raise BenchError(f"{document.place((key,))}: '{key}' is not known; there are sample_rate, block_samples, "
                             "channels.")  # fmt: skip
    rate = _number(document, ("sample_rate",), values.get("sample_rate"), 0.1, 1e6)
    block = _number(document, ("block_samples",), values.get("block_samples", max(16, round(0.05 * rate))), 8, 1e6)
    sections = values.get("channels")
    if not isinstance(sections, list) or not sections:
        raise BenchError(f"{document.place(('channels',))}: channels must list at least one topic and field.")
    channels = tuple(_channel(document, number, section) for number, section in enumerate(sections))
    kinds: dict[str, str] = {}
    for number, channel in enumerate(channels):
        if kinds.setdefault(channel.topic, channel.kind) != channel.kind:
            raise BenchError(f"{document.place(('channels', number))}: topic {channel.topic} has two types.")
        if channel.name in (other.name for other in channels[:number]):
            raise BenchError(f"{document.place(('channels', number))}: two channels are named {channel.name}.")
    return BridgeTable(rate, round(block), channels)


def _number(document: YamlDocument, path: tuple[str | int, ...], value: Any, low: float, high: float) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
        raise BenchError(f"{document.place(path)}: {path[-1]} must be a number in {low:g}..{high:g}, got {value!r}.")
    return float(value)


def _channel(document: YamlDocument, number: int, section: Any) -> BridgeChannel:
    path: tuple[str | int, ...] = ("channels", number)
    place = document.place(path)
    if not isinstance(section, dict):
        raise BenchError(f"{place}: a channel needs topic, type, field and quantity.")
    for key in section:
        if key not in _KEYS:
            raise BenchError(f"{place}: '{key}' is not known; a channel has {', '.join(_KEYS)}.")
    missing = [key for key in _KEYS[:4] if not isinstance(section.get(key), str)]
    if missing:
        raise BenchError(f"{place}: '{missing[0]}' of the channel is missing or no text.")
    parts = section["type"].split("/")
    if len(parts) != 3 or parts[1] != "msg" or not all(parts):
        raise BenchError(f"{place}: type must be written as package/msg/Name, got '{section['type']}'.")
    if section["quantity"] not in _QUANTITIES:
        raise BenchError(f"{place}: quantity must be one of {', '.join(_QUANTITIES)}, got '{section['quantity']}'.")
    quantity = Quantity[section["quantity"].upper()]
    point = _number(document, (*path, "point"), section.get("point", 0), 0, 10_000)
    return BridgeChannel(
        "/" + section["topic"].lstrip("/"),
        section["type"],
        section["field"],
        quantity,
        round(point),
        _number(document, (*path, "scale"), section.get("scale", 1.0), -1e12, 1e12),
        _number(document, (*path, "delay_s"), section.get("delay_s", 0.0), -10.0, 10.0),
        str(section.get("name") or quantity.letter + (str(round(point)) if point else "")),
    )


@dataclass(eq=False)
class _Stream:
    """What has come of one topic: stamps (s after the origin) and values of its channels."""

    channels: list[BridgeChannel]
    times: deque[float] = field(default_factory=deque)
    rows: deque[list[float]] = field(default_factory=deque)
    step: float = math.nan

    @property
    def newest(self) -> float:
        return self.times[-1] if self.times else -math.inf


class TopicBridge:
    """Makes blocks of stamped messages.

    Args:
        table: the channels.
        patience: s by which a topic may be behind the newest one.
        beside_plant: sample indices are those of a plant, see :meth:`add_reference`.

    Attributes:
        late: messages whose stamps do not rise; they are left out.
        missing: samples that were made NaN.
    """

    def __init__(self, table: BridgeTable, patience: float = 1.0, beside_plant: bool = False) -> None:
        self.table = table
        self.late = 0
        self.missing = 0
        self._patience = patience
        self._streams: dict[str, _Stream] = {}
        for channel in table.channels:
            self._streams.setdefault(channel.topic, _Stream([])).channels.append(channel)
        self._rate = table.sample_rate
        self._origin: int | None = None  # ns; stamps are kept relative to it
        self._zero: float | None = None  # s after the origin of sample 0
        self._delays: deque[float] | None = deque(maxlen=_ENVELOPE) if beside_plant else None
        self._next = 0

    def add(self, topic: str, message: Any, arrived_ns: int) -> None:
        """Take a message.

        Args:
            topic: with its slash.
            message: with the fields of the table; its clock is ``header.stamp`` where there is one that is not zero.
            arrived_ns: when it came, on the same clock.
        """
        stamp = getattr(getattr(message, "header", None), "stamp", None)
        time = 0 if stamp is None else int(stamp.sec) * 10**9 + int(stamp.nanosec)
        time = time or arrived_ns
        if self._origin is None:
            self._origin = time
        stream = self._streams[topic]
        seconds = (time - self._origin) * 1e-9
        if seconds <= stream.newest:
            self.late += 1
            return
        if stream.times:
            step = seconds - stream.newest
            # A running median: a gap moves it by little.
            stream.step = step if math.isnan(stream.step) else stream.step * (1.02 if step > stream.step else 1 / 1.02)
        stream.times.append(seconds)
        stream.rows.append([channel.value(message) for channel in stream.channels])

    def add_reference(self, end_sample: int, sample_rate: float, arrived_ns: int) -> None:
        """Take the end of a block of the plant: by the least delay with which blocks come, its index tells the time."""
        if self._delays is None:
            return
        if self._origin is None:
            self._origin = arrived_ns
        self._rate = sample_rate
        self._delays.append((arrived_ns - self._origin) * 1e-9 - end_sample / sample_rate)
        fresh = self._zero is None
        self._zero = min(self._delays)
        if fresh:
            self._next = end_sample

    def take(self) -> list[SampleBlock]:
        """Blocks that have become complete, or whose missing samples nobody waits for any more."""
        blocks: list[SampleBlock] = []
        while self._begun():
            assert self._zero is not None
            end = self._zero + (self._next + self.table.block_samples) / self._rate
            if not all(stream.newest >= end + _BEHIND * self._step_of(stream) for stream in self._streams.values()):
                newest = max(stream.newest for stream in self._streams.values())
                if newest < end + self._patience:
                    break
            blocks += self._cut()
            self._next += self.table.block_samples
            self._forget(end)
        return blocks

    def _begun(self) -> bool:
        """Whether it is known which time sample 0 has."""
        if self._zero is not None:
            return True
        first = [stream.times[0] for stream in self._streams.values() if stream.times]
        newest = max((stream.newest for stream in self._streams.values()), default=-math.inf)
        if self._delays is not None or not first:
            return False
        if len(first) < len(self._streams) and newest < min(first) + self._patience:
            return False
        self._zero = max(first)
        return True

    def _step_of(self, stream: _Stream) -> float:
        return stream.step if math.isfinite(stream.step) else 1.0 / self._rate

    def _cut(self) -> Iterator[SampleBlock]:
        """Blocks of all quantities for the next stretch of the grid; none where nothing came at all."""
        assert self._zero is not None
        places = np.asarray(
            self._zero + (self._next + np.arange(self.table.block_samples)) / self._rate, dtype=np.float64
        )
        rows: dict[BridgeChannel, Any] = {}
        for stream in self._streams.values():
            times, table = np.array(stream.times), np.array(stream.rows)
            for column, channel in enumerate(stream.channels):
                rows[channel] = np.full(places.size, np.nan)
                if times.size >= 4:
                    rows[channel] = interpolated(
                        times - channel.delay, table[:, column], places, 1.02 * self._step_of(stream)
                    )
        if all(np.isnan(row).all() for row in rows.values()):
            return
        for quantity in dict.fromkeys(channel.quantity for channel in self.table.channels):
            own = [channel for channel in self.table.channels if channel.quantity is quantity]
            data = np.stack([rows[channel] for channel in own])
            self.missing += int(np.isnan(data).sum())
            yield SampleBlock(
                self._next,
                self._rate,
                quantity,
                quantity.unit,
                tuple(channel.name for channel in own),
                tuple(channel.point for channel in own),
                data,
            )

    def _forget(self, before: float) -> None:
        for stream in self._streams.values():
            latest = max((abs(channel.delay) for channel in stream.channels), default=0.0)
            limit = before - latest - (_BEHIND + 5) * self._step_of(stream)
            while len(stream.times) > 8 and stream.times[0] < limit:
                stream.times.popleft()
                stream.rows.popleft()
