"""The windows of a recorded run and their samples as contiguous arrays, for analysis of whole windows."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from nmt_core.blocks import FloatArray, OscillatorPhase, Quantity, SampleBlock
from nmt_core.errors import BenchError
from nmt_core.vocabulary import LoopState, TestKind
from nmt_core.wire import BlockReader, read_status
from nmt_record.bag_reader import Bag
from nmt_record.bench_topics import SAMPLE_BLOCK
from nmt_record.cdr_peek import peek_block


@dataclass(frozen=True, slots=True)
class Segment:
    """Window that a lock event has named.

    Attributes:
        kind: kind of test.
        level_index: level number in the plan, from 0.
        level: its target amplitude, in ``level_unit`` (RANDOM: V rms).
        level_unit: V, N, m or m/s^2.
        first_sample: first sample of the window.
        samples: number of samples.
        periods: whole excitation periods in it; 0 = not so many.
        frequency_hz: Hz at the lock; SWEEP: at the first sample; RANDOM: 0.
        fault: why the window is not as planned (lock lost, recording ended); empty if it is.
    """

    kind: TestKind
    level_index: int
    level: float
    level_unit: str
    first_sample: int
    samples: int
    periods: int
    frequency_hz: float
    fault: str = ""

    @property
    def end_sample(self) -> int:
        """Index of the sample after the window."""
        return self.first_sample + self.samples


@dataclass(frozen=True, eq=False)
class Signals:
    """Samples of all channels over one stretch of a recording.

    Attributes:
        sample_rate: Hz.
        first_sample: index of the first sample.
        channels: name -> samples in SI units, (samples,) each, contiguous; NaN where samples are missing.
        units: name -> unit.
        points: name -> measurement point, 0 where it belongs to none.
        quantities: name -> quantity.
        oscillator: phase of the excitation at each sample, cycles, (samples,), unwrapped, starting in [0, 1); None
            if it is not known or nothing oscillates (random excitation).
        gaps: (topic, first sample, samples) of what is missing.
        flags: flags of all the blocks together; as in ``nmt_msgs/SampleBlock``.
    """

    sample_rate: float
    first_sample: int
    channels: dict[str, FloatArray]
    units: dict[str, str]
    points: dict[str, int]
    quantities: dict[str, Quantity]
    oscillator: FloatArray | None
    gaps: tuple[tuple[str, int, int], ...]
    flags: int = 0

    @property
    def samples(self) -> int:
        """Number of samples."""
        return next(iter(self.channels.values())).size

    def named(self, quantity: Quantity, point: int | None = None) -> list[str]:
        """Names of the channels of a quantity, at one point if given, in the order of the recording."""
        return [
            name
            for name, kind in self.quantities.items()
            if kind is quantity and (point is None or self.points[name] == point)
        ]


def segments(bag: Bag) -> list[Segment]:
    """Windows of a recorded run, in the order of their lock events.

    Recordings from before there were kinds of test hold phase resonance windows.

    Raises:
        BenchError: the bag is damaged.
    """
    found = []
    for event in bag.lock_events():
        found.append(
            Segment(
                kind=event.test,
                level_index=event.level_index,
                level=event.level,
                level_unit=event.level_unit,
                first_sample=event.window_first_sample,
                samples=event.window_samples,
                periods=event.window_periods,
                frequency_hz=event.frequency_hz,
            )
        )
    if not found:
        return found
    losses = _lost_locks(bag)
    end = _recorded_end(bag)
    return [_with_fault(segment, losses, end) for segment in found]


def read_signals(bag: Bag, first_sample: int, samples: int) -> Signals:
    """All channels of a bag over a stretch of samples.

    Args:
        bag: an opened bag.
        first_sample: index of the first sample.
        samples: number of samples.

    Raises:
        BenchError: an empty stretch, no samples of it in the bag, topics of different sample rates, channels that
            change on the way, or a damaged bag.
    """
    if samples < 1:
        raise BenchError(f"A stretch of samples needs at least one, got {samples}.")
    topics: dict[str, _Topic] = {}
    for topic, block in _blocks(bag, first_sample, first_sample + samples):
        if topic not in topics:
            topics[topic] = _Topic(topic, block, first_sample, samples)
        topics[topic].add(block)
    if not topics:
        raise BenchError(
            f"The bag {bag.path} has no samples from {first_sample} to {first_sample + samples - 1}; "
            "choose a stretch that was recorded."
        )
    parts = [topics[name] for name in bag.topics if name in topics]
    rate = parts[0].sample_rate
    for part in parts:
        if part.sample_rate != rate:
            raise BenchError(
                f"In the bag {bag.path} '{part.topic}' was sampled at {part.sample_rate:g} Hz and "
                f"'{parts[0].topic}' at {rate:g} Hz; signals of one rate are needed."
            )
    channels: dict[str, FloatArray] = {}
    units: dict[str, str] = {}
    points: dict[str, int] = {}
    quantities: dict[str, Quantity] = {}
    flags = 0
    for part in parts:
        flags |= part.flags
        for row, own in enumerate(part.names):
            name = f"{part.topic}/{own}" if own in channels else own
            channels[name] = part.data[row]
            units[name] = part.unit
            points[name] = part.points[row]
            quantities[name] = part.quantity
    reference = topics.get("force", parts[0])
    gaps = tuple(gap for part in parts for gap in part.gaps())
    return Signals(rate, first_sample, channels, units, points, quantities, reference.cycles(), gaps, flags)


class _Topic:
    """The samples of one topic, filled block by block."""

    def __init__(self, topic: str, block: SampleBlock, first_sample: int, samples: int) -> None:
        self.topic = topic
        self.names, self.points = block.channels, block.points
        self.quantity, self.unit, self.sample_rate = block.quantity, block.unit, block.sample_rate
        self.first, self.size = first_sample, samples
        self.data: FloatArray = np.full((len(block.channels), samples), math.nan)
        self.flags = 0
        self._spans: list[tuple[int, int]] = []
        self._phases: list[tuple[int, int, OscillatorPhase]] = []

    def add(self, block: SampleBlock) -> None:
        if (block.channels, block.points, block.unit, block.sample_rate) != (
            self.names,
            self.points,
            self.unit,
            self.sample_rate,
        ):
            raise BenchError(
                f"The channels of topic '{self.topic}' change at sample {block.first_sample}; choose a stretch "
                "before or after it."
            )
        start = block.first_sample - self.first
        low, high = max(0, start), min(self.size, start + block.samples)
        self.data[:, low:high] = block.data[:, low - start : high - start]
        self.flags |= block.flags
        self._spans.append((low, high))
        self._phases.append((start, block.samples, block.oscillator))

    def gaps(self) -> Iterator[tuple[str, int, int]]:
        position = 0
        for low, high in [*sorted(self._spans), (self.size, self.size)]:
            if low > position:
                yield self.topic, self.first + position, low - position
            position = max(position, high)

    def cycles(self) -> FloatArray | None:
        """Unwrapped phase at each sample, cycles; NaN in gaps."""
        phases = sorted(self._phases, key=lambda item: item[0])
        if any(math.isnan(phase.cycles) or math.isnan(phase.frequency_hz) for _, _, phase in phases):
            return None
        if all(phase.frequency_hz == 0.0 for _, _, phase in phases):
            return None
        result = np.full(self.size, math.nan)
        end, reached = phases[0][0], phases[0][2].cycles
        frequency = phases[0][2].frequency_hz
        for start, samples, phase in phases:
            # Across a gap the last frequency is the best guess of the whole turns in between.
            expected = reached + frequency * (start - end) / self.sample_rate
            turns = round(expected - phase.cycles)
            low, high = max(0, start), min(self.size, start + samples)
            time = np.arange(low - start, high - start) / self.sample_rate
            advance = time * (phase.frequency_hz + 0.5 * phase.rate_hz_s * time)
            result[low:high] = phase.cycles + turns + advance
            length = samples / self.sample_rate
            end = start + samples
            reached = phase.cycles + turns + length * (phase.frequency_hz + 0.5 * phase.rate_hz_s * length)
            frequency = phase.frequency_hz + phase.rate_hz_s * length
        result -= math.floor(result[np.isfinite(result)][0])
        return result


def _blocks(bag: Bag, first: int, stop: int) -> Iterator[tuple[str, SampleBlock]]:
    """Topic and block of everything that overlaps the samples first..stop - 1."""
    names = [name for name, (kind, _) in bag.topics.items() if kind == SAMPLE_BLOCK]
    readers = {name: BlockReader() for name in names}
    for topic, _, _, raw in bag.raw_messages(names) if names else ():
        try:
            extent = peek_block(raw)
            if extent.end_sample > first and extent.first_sample < stop:
                yield topic, readers[topic].read(raw)
        except ValueError as error:
            raise BenchError(f"A block of topic '{topic}' in the bag {bag.path} cannot be used: {error}.") from error


def _recorded_end(bag: Bag) -> int:
    """Index of the sample after the last one that all sample topics have."""
    ends: dict[str, int] = {}
    names = [name for name, (kind, count) in bag.topics.items() if kind == SAMPLE_BLOCK and count]
    for topic, _, _, raw in bag.raw_messages(names) if names else ():
        try:
            ends[topic] = max(ends.get(topic, 0), peek_block(raw).end_sample)
        except ValueError:
            continue
    return min(ends.values(), default=0)


def _lost_locks(bag: Bag) -> list[tuple[int, int, str]]:
    """Level index, sample and reason of every lost lock."""
    losses = []
    state = 0
    for _, _, _, raw in bag.raw_messages(["frequency"]) if "frequency" in bag.topics else ():
        try:
            status = read_status(raw)
        except ValueError:
            continue
        if status.state == LoopState.LOCK_LOST and state != LoopState.LOCK_LOST:
            losses.append((status.level_index, status.last_sample, status.reason))
        state = status.state
    return losses


def _with_fault(segment: Segment, losses: list[tuple[int, int, str]], end: int) -> Segment:
    fault = ""
    for level, sample, reason in losses:
        if level == segment.level_index and segment.first_sample <= sample < segment.end_sample:
            fault = f"given up at sample {sample}: {reason.rstrip('.')}"
    if not fault and end < segment.end_sample:
        fault = f"the recording ends at sample {end}, before the window does"
    return replace(segment, fault=fault)
