"""The blocks of one topic: which of them make up a stretch of samples, what is wrong with them, and their samples."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import FloatArray
from nmt_record.windows.window_policy import FLAG_FAULTS, PHASE_JUMP_CYCLES, AnyBlock, WindowFault, WindowFinding

# A source that goes on from below this share of the samples reached has been started anew; above, its clock is wrong.
_NEW_ACQUISITION = 0.5
_COMPACT = 256


class BlockRecord(NamedTuple):
    """Samples ``first`` to ``end`` − 1, and whatever they are decoded from."""

    first: int
    end: int
    payload: Any


_FORGOTTEN = BlockRecord(0, 0, None)


class TopicBlocks:
    """The newest blocks of one topic, in the order in which they came.

    Args:
        topic: its name.
        one_acquisition: a source that starts over is a clock that was set back; else what came before is forgotten.

    Attributes:
        topic: its name.
        blocks: number of blocks that came.
        gaps: number of blocks that did not begin where the one before ended.
        reached: sample after the newest one; None before the first block.
        set_back: sample after the newest one when the clock was set back, and the sample it was set back to; None if
            it was not. What comes later is not where events say and is not kept.
    """

    def __init__(self, topic: str, *, one_acquisition: bool = False) -> None:
        self.topic = topic
        self.blocks = 0
        self.gaps = 0
        self.reached: int | None = None
        self.set_back: tuple[int, int] | None = None
        self._lowest_new = 0.0 if one_acquisition else _NEW_ACQUISITION
        self._last_end = 0
        # A block from before the newest sample, with the newest sample before it came.
        self._doubtful: tuple[BlockRecord, int] | None = None
        self._records: list[BlockRecord] = []
        # Running maximum of the records' ends: ascending, so that it can be searched, whatever is repeated.
        self._reached: list[int] = []
        self._start = 0

    def __len__(self) -> int:
        return len(self._records) - self._start

    def add(self, first: int, end: int, payload: Any) -> bool:
        """Take the next block; returns whether it shows that the acquisition has started over."""
        record = BlockRecord(first, end, payload)
        anew = False
        self.blocks += 1
        if self.reached is None:
            self.reached = end
        elif first == self._last_end and self._doubtful is None:
            self.reached = max(self.reached, end)
        else:
            anew = self._add_out_of_order(record)
        self._last_end = end
        if self.set_back is None:
            self._records.append(record)
            self._reached.append(self.reached)
        return anew

    def _add_out_of_order(self, record: BlockRecord) -> bool:
        """One block out of order is a repeat; two that follow each other are a clock that was set back."""
        assert self.reached is not None
        anew = False
        if record.first != self._last_end:
            self.gaps += 1
        doubtful, self._doubtful = self._doubtful, None
        if doubtful is not None and record.first == doubtful[0].end != doubtful[1]:
            before, reached = doubtful
            if before.first < self._lowest_new * reached:
                anew = True
                self._records, self._reached, self._start = [before], [before.end], 0
                self.set_back, self.reached = None, before.end
            elif self.set_back is None:
                self.set_back = (reached, before.first)
        elif record.first < self.reached:
            self._doubtful = (record, self.reached)
        self.reached = max(self.reached, record.end)
        return anew

    def over(self, first: int, end: int) -> Iterator[BlockRecord]:
        """Records from the first that reaches beyond ``first`` until one reaches ``end``, repeats included."""
        for index in range(bisect_right(self._reached, first, self._start), len(self._records)):
            yield self._records[index]
            if self._reached[index] >= end:
                return

    def forget(self, oldest: int) -> None:
        """Drop what ends at or before a sample."""
        start = bisect_right(self._reached, oldest, self._start)
        for index in range(self._start, start):
            self._records[index] = _FORGOTTEN  # its samples go now, its place when many have gone
        self._start = start
        if self._start > _COMPACT and 2 * self._start > len(self._records):
            del self._records[: self._start], self._reached[: self._start]
            self._start = 0


@dataclass(eq=False)
class TopicStretch:
    """The blocks of one topic over a stretch of samples, none twice, with what is wrong with them.

    Attributes:
        topic: its name.
        first_sample: first sample of the stretch.
        samples: number of samples.
        blocks: those of one kind of channels and one rate, in time; without gaps if nothing was found.
        findings: what is wrong, in the order in which it was found.
    """

    topic: str
    first_sample: int
    samples: int
    blocks: tuple[Any, ...]
    findings: tuple[WindowFinding, ...]

    @classmethod
    def of(
        cls,
        topic: str,
        first_sample: int,
        samples: int,
        records: Iterable[BlockRecord],
        decode: Callable[[Any], AnyBlock] = lambda payload: payload,
    ) -> TopicStretch:
        """Choose and check the blocks of a stretch."""
        end = first_sample + samples
        position = first_sample
        blocks: list[AnyBlock] = []
        findings: list[WindowFinding] = []
        started = False
        for record in records:
            if record.end <= first_sample and not started:
                continue
            if record.first >= end and position >= end:
                break
            if record.first < position and started:
                reason = f"'{topic}' repeats samples from {record.first} on within the window."
                findings.append(
                    WindowFinding(WindowFault.REPEATED, reason, max(first_sample, record.first), topic, record.end)
                )
                continue
            if record.first > position:
                findings.append(_missing(topic, position, min(record.first, end)))
            started = True
            position = max(position, record.end)
            if record.first >= end:
                break
            try:
                block = decode(record.payload)
            except ValueError as error:
                reason = f"The block of '{topic}' at sample {record.first} is malformed: {error}."
                findings.append(
                    WindowFinding(WindowFault.MALFORMED, reason, max(first_sample, record.first), topic, record.end)
                )
                continue
            found = list(_faults_of(topic, block, blocks[0] if blocks else None, first_sample))
            findings += found
            if not found or not any(
                finding.fault in (WindowFault.CHANNELS, WindowFault.RATE, WindowFault.MALFORMED) for finding in found
            ):
                blocks.append(block)
        if position < end:
            findings.append(_missing(topic, position, end))
        return cls(topic, first_sample, samples, tuple(blocks), tuple(findings))

    @property
    def sample_rate(self) -> float:
        """Hz; NaN without a block."""
        return float(self.blocks[0].sample_rate) if self.blocks else math.nan

    @property
    def flags(self) -> int:
        """Flags of all blocks together."""
        flags = 0
        for block in self.blocks:
            flags |= block.flags
        return flags

    def copy_data(self, target: FloatArray) -> None:
        """Copy the samples, shape ``(channels, samples)``; what is missing keeps the values that ``target`` has."""
        for block in self.blocks:
            self._copy(block, target)

    def move_data(self, target: FloatArray) -> None:
        """The same; blocks go as they are copied, so that samples of many channels are not held twice. One is left."""
        blocks = list(self.blocks[::-1])
        self.blocks = self.blocks[:1]
        while blocks:
            self._copy(blocks.pop(), target)

    def _copy(self, block: Any, target: FloatArray) -> None:
        start = block.first_sample - self.first_sample
        stop = start + block.samples
        if start >= 0 and stop <= self.samples:
            target[:, start:stop] = block.data
        else:
            inside = slice(max(0, -start), block.samples - max(0, stop - self.samples))
            target[:, max(0, start) : min(self.samples, stop)] = block.data[:, inside]

    def missing_values(self, data: FloatArray) -> WindowFinding | None:
        """The first sample of ``data``, shape ``(channels, samples)``, that is not a finite number."""
        # A row at a time: of hundreds of channels the whole would be tens of megabytes.
        if all(np.isfinite(row).all() for row in data):
            return None
        finite = np.isfinite(data)
        sample = int(np.argmin(finite.all(axis=0)))
        channel = self.blocks[0].channels[int(np.argmin(finite[:, sample]))]
        where = self.first_sample + sample
        reason = f"Channel '{channel}' of '{self.topic}' has no valid value at sample {where}."
        return WindowFinding(WindowFault.VALUE, reason, where, self.topic)


def _missing(topic: str, first: int, end: int) -> WindowFinding:
    reason = f"Samples {first} to {end - 1} of '{topic}' are missing from the window."
    return WindowFinding(WindowFault.MISSING, reason, first, topic, end)


def _faults_of(topic: str, block: AnyBlock, head: AnyBlock | None, first_sample: int) -> Iterator[WindowFinding]:
    """What is wrong with one block, given the first of the stretch (None = this is the first)."""
    where = f"in the block of '{topic}' at sample {block.first_sample}"
    sample = max(first_sample, block.first_sample)

    def finding(fault: WindowFault, reason: str) -> WindowFinding:
        return WindowFinding(fault, reason, sample, topic, block.end_sample)

    if head is None:
        if len(block.points) != len(block.channels):
            yield finding(WindowFault.MALFORMED, f"The points do not match the channels {where}.")
        if not block.sample_rate > 0.0:
            yield finding(WindowFault.RATE, f"The sampling rate is {block.sample_rate:g} Hz {where}.")
    else:
        if block.channels != head.channels or block.points != head.points:
            yield finding(WindowFault.CHANNELS, f"The channels change within the window {where}.")
        if block.sample_rate != head.sample_rate:
            reason = f"The sampling rate is {block.sample_rate:g} Hz {where}, {head.sample_rate:g} Hz before."
            yield finding(WindowFault.RATE, reason)
    if head is None or block.quantity is not head.quantity or block.unit != head.unit:
        if block.quantity is Quantity.UNKNOWN or block.quantity.topic != topic:
            yield finding(WindowFault.UNIT, f"The quantity of '{topic}' is {block.quantity.name.lower()}.")
        elif not block.quantity.accepts(block.unit):
            yield finding(
                WindowFault.UNIT, f"The unit of '{topic}' is '{block.unit}' instead of {block.quantity.unit}."
            )
    if block.flags:
        for flag, fault, text in FLAG_FAULTS:
            if block.flags & flag:
                reason = f"Within the window {text} ('{topic}', block at sample {block.first_sample})."
                yield finding(fault, reason)


class ExcitationPhase:
    """Phase of the excitation over the blocks of a stretch, from block to block without wrapping.

    Across a gap the last frequency is the best guess of the whole turns in between.

    Attributes:
        known: whether every block says its phase and frequency.
    """

    def __init__(self, stretch: TopicStretch) -> None:
        self._stretch = stretch
        oscillators = [block.oscillator for block in stretch.blocks]
        self._start = np.array([oscillator.cycles for oscillator in oscillators], dtype=np.float64)
        self._frequency = np.array([oscillator.frequency_hz for oscillator in oscillators], dtype=np.float64)
        self._rate = np.array([oscillator.rate_hz_s for oscillator in oscillators], dtype=np.float64)
        self._first = np.array([block.first_sample for block in stretch.blocks], dtype=np.int64)
        self._samples = np.array([block.samples for block in stretch.blocks], dtype=np.int64)
        self.known = bool(self._first.size) and not bool(np.isnan(self._start).any() | np.isnan(self._frequency).any())
        if not self.known:
            return
        length = self._samples / stretch.sample_rate
        advance = length * (self._frequency + 0.5 * self._rate * length)
        ahead = (self._first[1:] - (self._first + self._samples)[:-1]) / stretch.sample_rate
        bridge = (self._frequency + self._rate * length)[:-1] * ahead
        expected = (self._start + advance)[:-1] + bridge
        self._turns = np.concatenate(([0.0], np.cumsum(np.round(expected - self._start[1:]))))
        meets = (self._start + advance + self._turns)[:-1] - (self._start + self._turns)[1:]
        self._jumps = (ahead == 0.0) & (np.abs(meets) > PHASE_JUMP_CYCLES)

    @property
    def silent(self) -> bool:
        """Whether nothing oscillates in any block."""
        return self.known and bool((self._frequency == 0.0).all())

    def findings(self) -> Iterator[WindowFinding]:
        """Blocks without periodic excitation, and where the phase is not continuous or does not rise."""
        if not self.known:
            return
        topic, earliest = self._stretch.topic, self._stretch.first_sample
        quiet = ~(self._frequency > 0.0)
        if quiet.any():
            sample = int(self._first[np.argmax(quiet)])
            reason = f"There is no periodic excitation within the window (sample {sample})."
            yield WindowFinding(WindowFault.SILENT, reason, max(earliest, sample), topic)
        if self._jumps.any():
            sample = int(self._first[1 + np.argmax(self._jumps)])
            reason = f"The excitation's phase jumps within the window at sample {sample}."
            yield WindowFinding(WindowFault.PHASE_JUMP, reason, max(earliest, sample), topic)
        last = self._frequency + self._rate * (self._samples - 1) / self._stretch.sample_rate
        falls = ~quiet & ~(last > 0.0)
        if falls.any():
            sample = int(self._first[np.argmax(falls)])
            reason = "The excitation's phase runs backwards within the window."
            yield WindowFinding(WindowFault.PHASE_JUMP, reason, max(earliest, sample), topic)

    def cycles(self) -> FloatArray:
        """Phase at each sample of the stretch, cycles, shape ``(samples,)``; NaN in gaps."""
        first, size = self._stretch.first_sample, self._stretch.samples
        block = np.repeat(np.arange(self._samples.size), self._samples)
        before = np.cumsum(self._samples) - self._samples
        within = np.arange(block.size) - before[block]
        index = self._first[block] + within - first
        inside = (index >= 0) & (index < size)
        block, within, index = block[inside], within[inside], index[inside]
        time = within / self._stretch.sample_rate
        values = (self._start + self._turns)[block] + time * (self._frequency[block] + 0.5 * self._rate[block] * time)
        if index.size == size:
            return np.ascontiguousarray(values)
        result: FloatArray = np.full(size, math.nan)
        result[index] = values
        return result

    def end_cycles(self) -> float:
        """Phase at the sample after the last, cycles, on from the last block."""
        time = (self._stretch.first_sample + self._stretch.samples - self._first[-1]) / self._stretch.sample_rate
        advance = time * (self._frequency[-1] + 0.5 * self._rate[-1] * time)
        return float((self._start + self._turns)[-1] + advance)


def phase_reference(stretches: Sequence[TopicStretch]) -> TopicStretch:
    """The stretch whose phase counts: that of the force; all topics carry the same oscillator."""
    return next((stretch for stretch in stretches if stretch.topic == "force"), stretches[0])
