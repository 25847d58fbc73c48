"""Topics of nodes that are none of the bench's as channels of it: stamped messages in, blocks of samples out.

The blocks lie on a grid of equal steps. Its sample 0 is the first stamp that all topics have passed, or, next to a
plant, the plant's own sample 0. Values at the times of the grid are those of the cubic through the four nearest
messages. Where messages are missing, samples are NaN; without any message no block comes.

This is not a sample clock that is shared with the excitation: the phase of a channel is as good as its stamps are. No
loop can be closed over it.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from nmt_core.messages.blocks import SampleBlock
from nmt_core.messages.stamped_samples import interpolated
from nmt_core.nodes.node_settings import NodeSettings
from nmt_core.settings import setting
from nmt_plant.stamp_watch import StampWatch
from nmt_plant.topic_bridge_table import BridgeChannel, BridgeTable


@dataclass(frozen=True)
class TopicBridgeSettings(NodeSettings):
    """Which topics become which channels."""

    table: str = setting("", "Channel table: a YAML file, see the how-to on foreign topics.")
    rig: str = setting("", "Name of the rig, for the frame of the blocks.")
    reference: str = setting(
        "",
        "Topic of a plant whose sample index is used, such as force; empty = an own clock.",
    )
    patience: float = setting(1.0, "Delay of a topic before its samples count as missing.", unit="s", low=0.05)


_BEHIND = 3  # messages that a cubic needs beyond the end of a block
_ENVELOPE = 500  # blocks of the plant over which the least delay of its messages is sought


@dataclass(eq=False)
class _Stream:
    """What has come of one topic: stamps (s after the origin) and values of its channels."""

    channels: list[BridgeChannel]
    times: deque[float] = field(default_factory=deque)
    rows: deque[list[float]] = field(default_factory=deque)
    step: float = math.nan
    shift: int = 0  # ns that are added to stamps since their clock was set back

    @property
    def newest(self) -> float:
        return self.times[-1] if self.times else -math.inf


class TopicBridge:
    """Makes blocks of stamped messages.

    Args:
        table: the channels.
        patience: s by which a topic may be behind the newest one.
        with_plant: sample indices are those of a plant, see :meth:`add_reference`.

    Attributes:
        late: messages whose stamps do not rise; they are left out.
        missing: samples that were made NaN.
        watch: says in sentences what is wrong with the messages.
    """

    def __init__(self, table: BridgeTable, patience: float = 1.0, with_plant: bool = False) -> None:
        self.table = table
        self.late = 0
        self.missing = 0
        self.watch = StampWatch(table, patience)
        self._patience = patience
        self._streams: dict[str, _Stream] = {}
        for channel in table.channels:
            self._streams.setdefault(channel.topic, _Stream([])).channels.append(channel)
        self._rate = table.sample_rate
        self._origin: int | None = None  # ns; stamps are kept relative to it
        self._zero: float | None = None  # s after the origin of sample 0
        self._delays: deque[float] | None = deque(maxlen=_ENVELOPE) if with_plant else None
        self._next = 0

    def add(self, topic: str, message: Any, arrived_ns: int) -> None:
        """Take a message.

        Args:
            topic: with its slash.
            message: with the fields of the table; its clock is ``header.stamp`` where there is one that is not zero.
            arrived_ns: when it came, on the same clock.
        """
        stream = self._streams[topic]
        time = self.watch.time_of(topic, message, arrived_ns)
        if time is None:
            return
        time += stream.shift
        if self._origin is None:
            self._origin = time
        seconds = (time - self._origin) * 1e-9
        if seconds <= stream.newest:
            self.late += 1
            resumed = self.watch.late(topic, seconds - stream.newest, time, arrived_ns)
            if resumed is None:
                return
            stream.shift += resumed - time
            seconds = max((resumed - self._origin) * 1e-9, stream.newest + 1e-9)
        self.watch.taken(topic, message, time, arrived_ns)
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
        """Blocks that have become complete, or whose missing samples are given up."""
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
            self.watch.cut(own, data)
            yield SampleBlock(
                self._next,
                self._rate,
                quantity,
                own[0].unit,
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
