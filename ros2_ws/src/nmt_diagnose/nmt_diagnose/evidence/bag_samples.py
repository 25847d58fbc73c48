"""Stretches of samples out of a bag in one pass, with what is wrong with them in words."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from nmt_core.blocks import BlockFlag, FloatArray, OscillatorPhase, Quantity, SampleBlock
from nmt_core.errors import BenchError
from nmt_core.wire import BlockReader
from nmt_diagnose.evidence.conditions import MeasuredChannel
from nmt_record.bag_reader import Bag
from nmt_record.bench_topics import SAMPLE_BLOCK
from nmt_record.cdr_peek import peek_block

_PHASE_JUMP_CYCLES = 1e-6


@dataclass(frozen=True, eq=False)
class Stretch:
    """Samples of all channels between two sample indices.

    Attributes:
        first_sample: index of the first sample.
        sample_rate: Hz.
        channels: one for each row of ``data``.
        data: shape (channels, samples), NaN where samples are missing.
        cycles: phase of the excitation at each sample, cycles, unwrapped, shape (samples,); None where it is not known
            or nothing oscillates.
        faults: what is wrong with a channel over this stretch, one clause each, by channel name; whole channels only.
        flags: flags of all the blocks together.
        cycles_before: excitation periods from the start of the bag to the middle of the stretch; NaN if not known.
    """

    first_sample: int
    sample_rate: float
    channels: tuple[MeasuredChannel, ...]
    data: FloatArray
    cycles: FloatArray | None
    faults: dict[str, str]
    flags: int
    cycles_before: float

    @property
    def samples(self) -> int:
        """Number of samples."""
        return int(self.data.shape[1])

    @property
    def start_s(self) -> float:
        """Time of the first sample on the clock of the bag, s."""
        return self.first_sample / self.sample_rate

    @property
    def stop_s(self) -> float:
        """Time of the sample after the last, s."""
        return (self.first_sample + self.samples) / self.sample_rate

    def row(self, name: str) -> FloatArray:
        """Samples of a channel, shape (samples,)."""
        names = [channel.name for channel in self.channels]
        result: FloatArray = self.data[names.index(name)]
        return result

    def find(self, quantity: Quantity, point: int | None = None) -> MeasuredChannel | None:
        """First channel of a quantity, at one point if given."""
        for channel in self.channels:
            if channel.quantity is quantity and (point is None or channel.point == point):
                return channel
        return None

    def clean(self) -> slice:
        """Longest stretch in which every channel without a fault has a value."""
        rows = [row for row, channel in enumerate(self.channels) if channel.name not in self.faults]
        good = np.isfinite(self.data[rows]).all(axis=0)
        edges = np.flatnonzero(np.diff(np.concatenate(([0], good.astype(np.int8), [0]))))
        if edges.size == 0:
            return slice(0, 0)
        lengths = edges[1::2] - edges[::2]
        longest = int(np.argmax(lengths))
        return slice(int(edges[2 * longest]), int(edges[2 * longest + 1]))


def read_stretches(bag: Bag, stretches: Sequence[tuple[int, int]]) -> list[Stretch | None]:
    """Samples of several stretches in one pass.

    Args:
        bag: an opened bag.
        stretches: first sample and number of samples of each.

    Returns:
        One for each stretch; None where the bag holds no sample of it.

    Raises:
        BenchError: a block is damaged.
    """
    names = [name for name, (kind, count) in bag.topics.items() if kind == SAMPLE_BLOCK and count]
    readers = {name: BlockReader() for name in names}
    clock_topic = next((name for name in ("force", *names) if name in names), "")
    collectors = [_Collector(first, samples) for first, samples in stretches]
    clock = _Clock()
    turns = {name: _Turns() for name in names}
    for topic, _, _, raw in bag.raw_messages(names) if names else ():
        try:
            extent = peek_block(raw)
            turns[topic].add(extent.first_sample, extent.end_sample)
            wanted = [c for c in collectors if extent.end_sample > c.first and extent.first_sample < c.end]
            if not wanted and topic != clock_topic:
                continue
            block = readers[topic].read(raw)
        except ValueError as error:
            raise BenchError(f"A block of topic '{topic}' in the bag {bag.path} cannot be used: {error}.") from error
        if topic == clock_topic:
            clock.add(block)
        for collector in wanted:
            collector.add(topic, block)
    for topic, own in turns.items():
        for collector in collectors:
            if own.turned_at is not None and collector.end > own.back_to:
                collector.spoil(topic, f"time runs backwards at sample {own.turned_at}, to {own.back_to}")
    return [collector.stretch(clock) for collector in collectors]


@dataclass
class _Turns:
    """Looks for a clock that is set back and goes on from there: samples after that are not where events say.

    A single block out of order is left to the window that it touches.
    """

    reached: int = -1
    end: int = -1
    turned_at: int | None = None
    back_to: int = 0
    _pending: tuple[int, int] | None = None

    def add(self, first: int, end: int) -> None:
        """The next block of the topic, in the order of recording."""
        if self.turned_at is None:
            if self._pending is not None and first == self.end:
                self.turned_at, self.back_to = self._pending
            self._pending = (self.reached, first) if first < self.reached else None
        self.reached, self.end = max(self.reached, end), end


@dataclass
class _Clock:
    """Excitation periods since the start of the bag."""

    sample: list[int] = field(default_factory=lambda: [0])
    cycles: list[float] = field(default_factory=lambda: [0.0])

    def add(self, block: SampleBlock) -> None:
        frequency = block.oscillator.frequency_hz
        turns = frequency * block.samples / block.sample_rate if frequency > 0.0 else 0.0
        self.sample.append(block.end_sample)
        self.cycles.append(self.cycles[-1] + (math.nan if math.isnan(frequency) else turns))

    def at(self, sample: float) -> float:
        return float(np.interp(sample, self.sample, self.cycles))


class _Collector:
    """Fills one stretch."""

    def __init__(self, first: int, samples: int) -> None:
        self.first, self.samples, self.end = first, samples, first + samples
        self.flags = 0
        self._topics: dict[str, _TopicSamples] = {}

    def add(self, topic: str, block: SampleBlock) -> None:
        if topic not in self._topics:
            self._topics[topic] = _TopicSamples(topic, block, self.first, self.samples)
        self._topics[topic].add(block)
        self.flags |= block.flags

    def spoil(self, topic: str, why: str) -> None:
        """Nothing of a topic can be used."""
        if topic in self._topics:
            self._topics[topic].spoil(why)

    def stretch(self, clock: _Clock) -> Stretch | None:
        parts = list(self._topics.values())
        if not parts:
            return None
        reference = self._topics.get("force", parts[0])
        channels: list[MeasuredChannel] = []
        faults: dict[str, str] = {}
        for part in parts:
            fault = part.fault()
            if part.rate != reference.rate:
                fault = f"sampled at {part.rate:g} Hz, others at {reference.rate:g} Hz"
            for name, point in zip(part.names, part.points, strict=True):
                channels.append(MeasuredChannel(name, part.quantity, point))
                if fault:
                    faults[name] = fault
        data = np.concatenate([part.data for part in parts])
        cycles = reference.cycles()
        if isinstance(cycles, str):
            faults |= {channel.name: cycles for channel in channels}
            cycles = None
        for channel, row in zip(channels, data, strict=True):
            missing = int(np.isnan(row).sum())
            if channel.name not in faults and missing:
                where = self.first + int(np.argmax(np.isnan(row)))
                faults[channel.name] = f"{missing} of {row.size} samples are missing or NaN, first at sample {where}"
            elif channel.name not in faults and not np.isfinite(row).all():
                faults[channel.name] = "holds infinite values"
            elif channel.name not in faults and channel.quantity is not Quantity.VOLTAGE and not np.ptp(row) > 0.0:
                faults[channel.name] = "does not move at all; is it connected?"
        middle = 0.5 * (self.first + self.end)
        return Stretch(
            self.first, reference.rate, tuple(channels), data, cycles, faults, self.flags, clock.at(middle)
        )  # fmt: skip


class _TopicSamples:
    """Samples of one topic over one stretch."""

    def __init__(self, topic: str, block: SampleBlock, first: int, samples: int) -> None:
        self.topic, self.first, self.size = topic, first, samples
        self.names, self.points = block.channels, block.points
        self.quantity, self.unit, self.rate = block.quantity, block.unit, block.sample_rate
        self.data: FloatArray = np.full((len(block.channels), samples), math.nan)
        self._phases: list[tuple[int, int, OscillatorPhase]] = []
        self._reached = -1
        self._problem = ""
        if self.quantity is Quantity.UNKNOWN or self.unit != self.quantity.unit:
            self._problem = f"the unit '{self.unit}' is not {self.quantity.unit or 'known'}"
        elif not self.rate > 0.0:
            self._problem = f"the sampling rate is {self.rate:g} Hz"

    def add(self, block: SampleBlock) -> None:
        if (block.channels, block.points, block.unit, block.sample_rate) != (
            self.names,
            self.points,
            self.unit,
            self.rate,
        ):
            self._problem = self._problem or f"channels, unit or sampling rate change at sample {block.first_sample}"
            return
        if block.first_sample < self._reached:
            self._problem = self._problem or f"time runs backwards at sample {block.first_sample}"
            return
        self._reached = block.end_sample
        start = block.first_sample - self.first
        low, high = max(0, start), min(self.size, start + block.samples)
        self.data[:, low:high] = block.data[:, low - start : high - start]
        self._phases.append((start, block.samples, block.oscillator))
        if block.flags & (BlockFlag.LIMIT | BlockFlag.WATCHDOG):
            self._problem = self._problem or f"limit or watchdog had tripped at sample {block.first_sample}"

    def spoil(self, why: str) -> None:
        self._problem = why

    def fault(self) -> str:
        return self._problem

    def cycles(self) -> FloatArray | str | None:
        """Unwrapped phase at each sample, cycles; None if not known, a clause if it is not continuous."""
        if any(math.isnan(phase.cycles) or not phase.frequency_hz > 0.0 for _, _, phase in self._phases):
            return None
        result = np.full(self.size, math.nan)
        reached, end = math.nan, 0
        for start, samples, phase in self._phases:
            turns = 0.0
            if not math.isnan(reached) and start == end:
                turns = float(np.round(reached - phase.cycles))
                if abs(reached - phase.cycles - turns) > _PHASE_JUMP_CYCLES:
                    return f"the phase of the excitation jumps at sample {self.first + start}"
            elif not math.isnan(reached):
                return f"samples before {self.first + start} are missing"
            time = np.arange(samples + 1) / self.rate
            advance = phase.cycles + turns + time * (phase.frequency_hz + 0.5 * phase.rate_hz_s * time)
            low, high = max(0, start), min(self.size, start + samples)
            result[low:high] = advance[low - start : high - start]
            reached, end = float(advance[-1]), start + samples
        return result
