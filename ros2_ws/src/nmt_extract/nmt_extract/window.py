"""From blocks and lock events to whole windows, or to the reason why a window cannot be used.

What comes out depends on the content of the streams alone, not on the order in which different streams
arrive: live and offline evaluation see the same windows.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from nmt_core.blocks import BlockFlag, FloatArray, Quantity, SampleBlock
from nmt_core.records import LockEvent
from nmt_core.vocabulary import LoopState

_STATE_NAMES: dict[int, str] = {
    LoopState.FIXED: "fixed frequency",
    LoopState.ACQUIRING: "acquiring",
    LoopState.LOCKED: "locked",
    LoopState.LOCK_LOST: "lock lost",
}
_FLAG_NAMES = (
    (BlockFlag.OVERLOAD, "a converter was overloaded"),
    (BlockFlag.LIMIT, "a safety limit had tripped"),
    (BlockFlag.WATCHDOG, "the drive watchdog had tripped"),
)
# More than rounding, far less than any phase step worth the name.
_PHASE_JUMP_CYCLES = 1e-6


class Channel(NamedTuple):
    """What a row of a window's data is."""

    name: str
    quantity: Quantity
    point: int


class StateAfter(NamedTuple):
    """State of the phase-locked loop after the block that ends with ``last_sample``."""

    last_sample: int
    state: int
    reason: str = ""


@dataclass(frozen=True, eq=False)
class Window:
    """All channels over a window without a flaw.

    Attributes:
        lock: the event that named it.
        sample_rate: Hz.
        channels: one for each row of ``data``.
        data: shape ``(channels, samples)``.
        cycles: excitation phase at each sample, cycles, not wrapped, shape ``(samples,)``; None if nobody
            knows it.
        end_cycles: phase at the sample after the last; NaN if not known.
    """

    lock: LockEvent
    sample_rate: float
    channels: tuple[Channel, ...]
    data: FloatArray
    cycles: FloatArray | None
    end_cycles: float

    @property
    def samples(self) -> int:
        """Number of samples."""
        return int(self.data.shape[1])


@dataclass(frozen=True)
class SpoiledWindow:
    """A window that must not be used.

    Attributes:
        lock: the event that named it.
        sample_rate: Hz; NaN if no block came.
        reason: one sentence.
    """

    lock: LockEvent
    sample_rate: float
    reason: str


class _SpoiledError(Exception):
    """Carries the reason out of the assembly."""


class _Record(NamedTuple):
    first: int
    end: int
    payload: Any


# One topic may lag behind another by the time a lost datagram takes to be sent again; at a hundred times real time
# that is many seconds of bench time.
HISTORY_SAMPLES = 600_000
PATIENCE_SAMPLES = 1_200_000


class WindowAssembler:
    """Keeps the newest blocks of every stream and cuts windows out of them.

    Args:
        topics: sample topics that a window needs.
        decode: makes a :class:`SampleBlock` of what :meth:`add_record` was given; called only for blocks of a
            window.
        require_loop_state: a window needs loop states up to its end (False for data without a phase-locked
            loop).
        minimum_periods: windows of fewer whole periods are rejected.
        history_samples: samples kept of every topic while no window is awaited.
        patience_samples: how far other topics may run ahead before a window that lacks samples is given up.
        maximum_samples: longer windows are rejected, so that the memory stays bounded.
    """

    def __init__(
        self,
        topics: Sequence[str],
        decode: Callable[[Any], SampleBlock] = lambda payload: payload,
        *,
        require_loop_state: bool = True,
        minimum_periods: int = 3,
        history_samples: int = HISTORY_SAMPLES,
        patience_samples: int = PATIENCE_SAMPLES,
        maximum_samples: int = 4_000_000,
    ) -> None:
        self._topics = tuple(topics)
        self._decode = decode
        self._require_loop_state = require_loop_state
        self._minimum_periods = minimum_periods
        self._history = history_samples
        self._patience = patience_samples
        self._maximum = maximum_samples
        self._records: dict[str, deque[_Record]] = {topic: deque() for topic in self._topics}
        self._end: dict[str, int | None] = dict.fromkeys(self._topics)
        self._states: deque[StateAfter] = deque()
        self._state_sample = -1
        self._pending: list[LockEvent] = []
        # Nothing can change for a pending window before a stream reaches this sample.
        self._next_end: float = math.inf
        self._ready: list[Window | SpoiledWindow] = []
        self.sample_rate = math.nan
        self.gaps: dict[str, int] = dict.fromkeys(self._topics, 0)
        self.blocks: dict[str, int] = dict.fromkeys(self._topics, 0)

    def add_block(self, topic: str, block: SampleBlock) -> None:
        """Take one block of a topic, in the order of the stream; other topics are ignored."""
        self.add_record(topic, block.first_sample, block.samples, block)

    def add_record(self, topic: str, first_sample: int, samples: int, payload: Any) -> None:
        """Take one block that is decoded only if a window needs it.

        Args:
            topic: sample topic; ignored if no window needs it.
            first_sample: index of its first sample.
            samples: number of samples.
            payload: what ``decode`` understands; has the attribute ``sample_rate``.
        """
        records = self._records.get(topic)
        if records is None:
            return
        end = first_sample + samples
        expected = self._end[topic]
        if expected is None:
            if math.isnan(self.sample_rate):
                self.sample_rate = float(payload.sample_rate)
        elif first_sample != expected:
            self.gaps[topic] += 1
            if end < expected - self._history:
                records.clear()  # the acquisition has started anew
        self.blocks[topic] += 1
        self._end[topic] = end
        records.append(_Record(first_sample, end, payload))
        if end >= self._next_end:
            self._check()
        elif not self._pending:
            oldest = end - self._history
            while records[0].end <= oldest:
                records.popleft()

    def add_state(self, last_sample: int, state: int, reason: str = "") -> None:
        """Take the loop's state after one block."""
        if last_sample < self._state_sample:
            self._states.clear()  # the acquisition has started anew
        self._states.append(StateAfter(last_sample, state, reason))
        self._state_sample = last_sample
        if self._pending:
            if state != LoopState.LOCKED or last_sample + 1 >= self._next_end:
                self._check()
        else:
            oldest = last_sample - self._history
            while self._states[0].last_sample < oldest:
                self._states.popleft()

    def add_lock(self, lock: LockEvent) -> None:
        """Take a lock event: a window to wait for."""
        if lock.window_samples > self._maximum or lock.window_samples < 1:
            reason = f"The window of {lock.window_samples} samples is not within 1..{self._maximum} samples."
            self._ready.append(SpoiledWindow(lock, self.sample_rate, reason))
            return
        self._pending.append(lock)
        self._check()

    def take(self) -> list[Window | SpoiledWindow]:
        """Windows that have become ready since the last call, in the order of their readiness."""
        ready, self._ready = self._ready, []
        return ready

    @property
    def ready(self) -> bool:
        """Whether :meth:`take` would return something."""
        return bool(self._ready)

    def finish(self) -> None:
        """The streams have ended: give up what is not complete."""
        for lock in self._pending:
            self._give_up(lock)
        self._pending = []
        self._next_end = math.inf

    def _check(self) -> None:
        keep = []
        for lock in self._pending:
            lost = self._lost_lock(lock)
            if lost:
                self._ready.append(SpoiledWindow(lock, self.sample_rate, lost))
            elif self._complete(lock):
                self._ready.append(self._cut(lock))
            elif self._newest() >= lock.window_end + self._patience:
                self._give_up(lock)
            else:
                keep.append(lock)
        self._pending = keep
        self._next_end = min((lock.window_end for lock in keep), default=math.inf)
        self._forget(min((lock.window_first_sample for lock in keep), default=None))

    def _newest(self) -> int:
        return max((end for end in self._end.values() if end is not None), default=0)

    def _complete(self, lock: LockEvent) -> bool:
        if self._require_loop_state and self._state_sample < lock.window_end - 1:
            return False
        return all(end is not None and end >= lock.window_end for end in self._end.values())

    def _lost_lock(self, lock: LockEvent) -> str:
        start = max(lock.window_first_sample, lock.sample)
        for entry in self._states:
            if entry.last_sample < start:
                continue
            last = entry.last_sample >= lock.window_end - 1
            # The block that ends the window may already show the next level: it takes effect after that
            # block.
            if entry.state == LoopState.LOCK_LOST or (entry.state != LoopState.LOCKED and not last):
                name = _STATE_NAMES.get(entry.state, "unknown state")
                why = f" ({entry.reason.rstrip('.')})" if entry.reason else ""
                where = f"{name} at sample {entry.last_sample}{why}"
                return f"The loop did not hold its lock over the window: {where}."
            if last:
                break
        return ""

    def _give_up(self, lock: LockEvent) -> None:
        lost = self._lost_lock(lock)
        if lost:
            reason = lost
        elif self._complete(lock):
            self._ready.append(self._cut(lock))
            return
        else:
            reason = self._missing(lock)
        self._ready.append(SpoiledWindow(lock, self.sample_rate, reason))

    def _missing(self, lock: LockEvent) -> str:
        for topic in self._topics:
            end = self._end[topic]
            if end is None:
                return f"The window was never completed: no block of '{topic}' came."
            if end < lock.window_end:
                have = max(0, end - lock.window_first_sample)
                return (
                    f"The window was never completed: '{topic}' ended after {have} of its "
                    f"{lock.window_samples} samples."
                )
        return "The window was never completed: the loop's state did not come up to its end."

    def _forget(self, oldest_needed: int | None) -> None:
        for topic, records in self._records.items():
            oldest = (self._end[topic] or 0) - self._history
            if oldest_needed is not None:
                oldest = min(oldest, oldest_needed)
            while records and records[0].end <= oldest:
                records.popleft()
        oldest = self._state_sample - self._history
        if oldest_needed is not None:
            oldest = min(oldest, oldest_needed)
        while self._states and self._states[0].last_sample < oldest:
            self._states.popleft()

    def _cut(self, lock: LockEvent) -> Window | SpoiledWindow:
        try:
            return self._assemble(lock)
        except _SpoiledError as spoiled:
            return SpoiledWindow(lock, self.sample_rate, str(spoiled))

    def _assemble(self, lock: LockEvent) -> Window:
        if 0 < lock.window_periods < self._minimum_periods:
            raise _SpoiledError(
                f"The window holds {lock.window_periods} whole periods; at least {self._minimum_periods} are needed."
            )
        parts = [_TopicPart(topic, self._blocks_of(topic, lock), lock) for topic in self._topics]
        rate = parts[0].sample_rate
        for part in parts:
            if part.sample_rate != rate:
                raise _SpoiledError(
                    f"'{part.topic}' was sampled at {part.sample_rate:g} Hz, '{parts[0].topic}' at {rate:g} Hz."
                )
        channels = tuple(channel for part in parts for channel in part.channels)
        data = np.empty((len(channels), lock.window_samples))
        row = 0
        for part in parts:
            part.copy_data(data[row : row + len(part.channels)])
            row += len(part.channels)
        # All topics carry the same oscillator.
        cycles, end_cycles = next((part for part in parts if part.topic == "force"), parts[0]).phase()
        return Window(lock, rate, channels, data, cycles, end_cycles)

    def _blocks_of(self, topic: str, lock: LockEvent) -> list[SampleBlock]:
        first, end = lock.window_first_sample, lock.window_end
        position = first
        blocks: list[SampleBlock] = []
        for record in self._records[topic]:
            if record.end <= first and position == first:
                continue
            if record.first >= end and position >= end:
                break
            if record.first > position:
                raise _SpoiledError(
                    f"Samples {position} to {min(record.first, end) - 1} of '{topic}' are missing from the window."
                )
            if record.first < position and blocks:
                raise _SpoiledError(f"'{topic}' repeats samples from {record.first} on within the window.")
            try:
                block = self._decode(record.payload)
            except ValueError as error:
                raise _SpoiledError(
                    f"The block of '{topic}' at sample {record.first} is malformed: {error}."
                ) from error
            blocks.append(block)
            position = record.end
            if position >= end:
                break
        if position < end:
            raise _SpoiledError(f"Samples {position} to {end - 1} of '{topic}' are missing from the window.")
        return blocks


class _TopicPart:
    """The blocks of one topic that make up a window, checked and joined."""

    def __init__(self, topic: str, blocks: list[SampleBlock], lock: LockEvent) -> None:
        self.topic = topic
        self._blocks = blocks
        self._lock = lock
        head = blocks[0]
        self.sample_rate = head.sample_rate
        self._check_head(head)
        for block in blocks:
            self._check(block, head)
        self.channels = tuple(
            Channel(name, head.quantity, point) for name, point in zip(head.channels, head.points, strict=True)
        )

    @staticmethod
    def _where(topic: str, block: SampleBlock) -> str:
        return f"in the block of '{topic}' at sample {block.first_sample}"

    def _check_head(self, head: SampleBlock) -> None:
        where = self._where(self.topic, head)
        if len(head.points) != len(head.channels):
            raise _SpoiledError(f"The points do not match the channels {where}.")
        if not head.sample_rate > 0.0:
            raise _SpoiledError(f"The sampling rate is {head.sample_rate:g} Hz {where}.")
        if head.quantity is Quantity.UNKNOWN or head.quantity.topic != self.topic:
            raise _SpoiledError(f"The quantity is {head.quantity.name.lower()} {where}.")
        if head.unit != head.quantity.unit:
            raise _SpoiledError(f"The unit is '{head.unit}' instead of {head.quantity.unit} {where}.")

    def _check(self, block: SampleBlock, head: SampleBlock) -> None:
        if block.channels != head.channels or block.points != head.points:
            raise _SpoiledError(f"The channels change within the window {self._where(self.topic, block)}.")
        if block.sample_rate != head.sample_rate:
            where = self._where(self.topic, block)
            raise _SpoiledError(
                f"The sampling rate is {block.sample_rate:g} Hz {where}, {head.sample_rate:g} Hz before."
            )
        if block.quantity is not head.quantity or block.unit != head.unit:
            self._check_head(block)
        if block.flags:
            for flag, text in _FLAG_NAMES:
                if block.flags & flag:
                    where = f"'{self.topic}', block at sample {block.first_sample}"
                    raise _SpoiledError(f"Within the window {text} ({where}).")

    def copy_data(self, target: FloatArray) -> None:
        """Copy the samples of the window, shape ``(channels, samples)``; every value must be finite."""
        first, size = self._lock.window_first_sample, self._lock.window_samples
        for block in self._blocks:
            start = block.first_sample - first
            stop = start + block.samples
            if start >= 0 and stop <= size:
                target[:, start:stop] = block.data
            else:
                inside = slice(max(0, -start), block.samples - max(0, stop - size))
                target[:, max(0, start) : min(size, stop)] = block.data[:, inside]
        finite = np.isfinite(target)
        if not finite.all():
            sample = int(np.argmin(finite.all(axis=0)))
            channel = self._blocks[0].channels[int(np.argmin(finite[:, sample]))]
            raise _SpoiledError(f"Channel '{channel}' of '{self.topic}' has no valid value at sample {first + sample}.")

    def phase(self) -> tuple[FloatArray | None, float]:
        """Unwrapped excitation phase at each sample of the window and at the sample after it, cycles."""
        oscillators = [block.oscillator for block in self._blocks]
        start = np.array([oscillator.cycles for oscillator in oscillators])
        if np.isnan(start).any():
            return None, math.nan
        frequency = np.array([oscillator.frequency_hz for oscillator in oscillators])
        rate = np.array([oscillator.rate_hz_s for oscillator in oscillators])
        first = np.array([block.first_sample for block in self._blocks])
        samples = np.array([block.samples for block in self._blocks])
        if not (frequency > 0.0).all():
            silent = int(first[np.argmin(frequency > 0.0)])
            raise _SpoiledError(f"There is no periodic excitation within the window (sample {silent}).")
        length = samples / self.sample_rate
        advance = length * (frequency + 0.5 * rate * length)
        turns = np.concatenate(([0.0], np.cumsum(np.round((start + advance)[:-1] - start[1:]))))
        jump = np.abs((start + advance + turns)[:-1] - (start + turns)[1:]) > _PHASE_JUMP_CYCLES
        if jump.any():
            where = int(first[1 + np.argmax(jump)])
            raise _SpoiledError(f"The excitation's phase jumps within the window at sample {where}.")
        # One sample more than the window: the phase at its end.
        index = np.arange(self._lock.window_samples + 1)
        block = np.repeat(np.arange(samples.shape[0]), samples)
        offset = self._lock.window_first_sample - int(first[0])
        block = np.append(block, block[-1])[offset : offset + index.shape[0]]
        time = (index + self._lock.window_first_sample - first[block]) / self.sample_rate
        cycles = (start + turns)[block] + time * (frequency[block] + 0.5 * rate[block] * time)
        if not (np.diff(cycles) > 0.0).all():
            raise _SpoiledError("The excitation's phase runs backwards within the window.")
        return np.ascontiguousarray(cycles[:-1]), float(cycles[-1])
