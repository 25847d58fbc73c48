"""The windows of a recorded run and their samples as contiguous arrays, for analysis of whole windows."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import reduce
from typing import Any

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.files.hardened import yaml_value
from nmt_core.messages.blocks import Quantity, SampleBlock
from nmt_core.messages.driven_test import DrivenTest
from nmt_core.messages.records import LockEvent
from nmt_core.messages.wire import LOCK_EVENT, BlockHead, BlockReader, read_status
from nmt_core.numerics.arrays import FloatArray
from nmt_core.vocabulary import TestKind
from nmt_record.bag.bag_reader import Bag
from nmt_record.windows.sample_table import SampleTable, window_findings
from nmt_record.windows.topic_blocks import BlockRecord, ExcitationPhase, TopicStretch, phase_reference
from nmt_record.windows.window_policy import MINIMUM_PERIODS, NamedWindow, WindowFault, WindowFinding, WindowVerdict

_ANALYSED = ("force", "displacement", "velocity", "acceleration")


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
        fault: why the window is not as planned, a sentence without its full stop; empty if it is. The extraction
            rejects it for the same reason.
        usable_first_sample: first sample that can be used all the same (a sweep that was given up, random excitation
            with a gap); ``first_sample`` without a fault.
        usable_samples: how many can be used; 0 = none, ``samples`` without a fault.
    """

    kind: TestKind
    level_index: int
    level: float
    level_unit: str
    first_sample: int
    samples: int
    periods: int
    frequency_hz: float
    fault: str
    usable_first_sample: int
    usable_samples: int

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
        gaps: (topic, first sample, samples) of missing stretches.
        flags: flags of all the blocks together; as in ``nmt_msgs/SampleBlock``.
        findings: what is wrong with the blocks, topic by topic.
        topics: name -> topic of the channel.
        cycles_before: excitation periods from the start of the bag to the middle of the stretch; NaN if not known.
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
    findings: tuple[WindowFinding, ...] = ()
    topics: dict[str, str] = field(default_factory=dict)
    cycles_before: float = math.nan

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


def analysed_topics(bag: Bag) -> tuple[str, ...]:
    """Topics with blocks that a window is extracted from unless the run says otherwise: force and motions."""
    return tuple(topic for topic in _ANALYSED if topic in bag.sample_topics)


def needed_topics(bag: Bag) -> tuple[str, ...]:
    """Topics that a window of a bag needs whole: those that the run's extraction names and the bag has.

    Faults of other topics cost their channels, not the window.
    """
    present = bag.sample_topics
    named = _extraction(bag).get("topics")
    chosen = [topic for topic in named if topic in present] if isinstance(named, list | tuple) else []
    return tuple(chosen) or analysed_topics(bag) or tuple(present)


def segments(bag: Bag) -> list[Segment]:
    """Windows of a recorded run, in the order of their lock events.

    Recordings from before there were kinds of test hold phase resonance windows. Samples of which no run says what they
    are, such as those of a bridge, are a record.

    Raises:
        BenchError: the bag is damaged.
    """
    events = _records(bag) if _is_without_run(bag) else []
    topics = needed_topics(bag)
    table = SampleTable(
        topics,
        require_loop_state=bag.topics.get("frequency", ("", 0))[1] > 0,
        minimum_periods=_minimum_periods(bag),
        one_acquisition=True,
    )
    for number, event in enumerate(events):
        table.add_window(number, _window(event))
    readers = {topic: BlockReader() for topic in topics}
    wanted = [topic for topic in (*topics, "frequency", "lock") if topic in bag.topics]
    for topic, _, _, raw in bag.raw_messages(wanted) if events or "lock" in bag.topics else ():
        if topic == "lock":
            event = _lock_event(bag, raw)
            table.add_window(len(events), _window(event))
            events.append(event)
            continue
        try:
            if topic == "frequency":
                status = read_status(raw)
                table.add_state(status.last_sample, status.state, status.reason)
            else:
                head = readers[topic].head(raw)
                table.add_record(topic, head.first_sample, head.samples, head)
        except ValueError:
            continue  # the window it belongs to will be found to have a gap
    table.finish()
    verdicts = {cut.key: cut.verdict for cut in table.take()}
    return [_segment(event, verdicts[number]) for number, event in enumerate(events)]


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
    (signals,) = read_stretches(bag, [(first_sample, samples)])
    if signals is None:
        raise BenchError(
            f"The bag {bag.path} has no samples from {first_sample} to {first_sample + samples - 1}; "
            "choose a stretch that was recorded."
        )
    for finding in signals.findings:
        if finding.fault in (WindowFault.CHANNELS, WindowFault.RATE):
            raise BenchError(
                f"In the bag {bag.path} the samples {first_sample} to {first_sample + samples - 1} do not belong "
                f"together: {finding.reason.rstrip('.')}; choose a stretch of one kind of channels and one rate."
            )
    return signals


def read_stretches(
    bag: Bag,
    stretches: Sequence[tuple[int, int]],
    each: Callable[[str, bytes], None] | None = None,
    whole: bool = False,
) -> list[Signals | None]:
    """All channels of a bag over several stretches of samples, in one pass.

    Args:
        bag: an opened bag.
        stretches: first sample and number of samples of each.
        each: called on the way with the topic and the serialised block of every message of samples.
        whole: leave out stretches that reach beyond the last sample of the bag.

    Returns:
        One for each stretch, with what is wrong with it; None where the bag holds no sample of it.

    Raises:
        BenchError: the bag is damaged.
    """
    names = bag.sample_topics
    readers = {name: BlockReader() for name in names}
    clock_topic = "force" if "force" in names else names[0] if names else ""
    collectors = [_Collector(first, samples) for first, samples in stretches]
    in_order = sorted(collectors, key=lambda collector: collector.first)
    starts = [collector.first for collector in in_order]
    longest = max((collector.samples for collector in collectors), default=0)
    clock = _Clock()
    end_sample = 0
    for topic, _, _, raw in bag.raw_messages(names) if names else ():
        if each is not None:
            each(topic, raw)
        try:
            head = readers[topic].head(raw)
            # No other stretch has a sample of this block, however many stretches there are.
            near = slice(bisect_left(starts, head.first_sample - longest), bisect_left(starts, head.end_sample))
            wanted = [collector for collector in in_order[near] if collector.wants(topic, head)]
            block = readers[topic].read(raw) if wanted else None
        except ValueError:
            continue  # its samples will be found to be missing
        end_sample = max(end_sample, head.end_sample)
        if topic == clock_topic:
            clock.add(head)
        for collector in wanted:
            collector.add(topic, block)
    clock.finish()
    return [
        None if whole and collector.end > end_sample else collector.signals(names, clock) for collector in collectors
    ]


class _Collector:
    """Gathers the blocks of one stretch."""

    def __init__(self, first: int, samples: int) -> None:
        self.first, self.samples, self.end = first, samples, first + samples
        self._records: dict[str, list[BlockRecord]] = {}
        self._reached: dict[str, int] = {}

    def wants(self, topic: str, head: BlockHead) -> bool:
        """Whether the next block of a topic belongs to the stretch: until the topic has reached its end."""
        reached = self._reached.get(topic, head.first_sample)
        return head.end_sample > self.first and head.first_sample < self.end and reached < self.end

    def add(self, topic: str, block: SampleBlock | None) -> None:
        assert block is not None
        self._records.setdefault(topic, []).append(BlockRecord(block.first_sample, block.end_sample, block))
        self._reached[topic] = max(self._reached.get(topic, 0), block.end_sample)

    def signals(self, names: Sequence[str], clock: _Clock) -> Signals | None:
        """The samples, in the order of ``names``; the blocks are given up."""
        if self.samples < 1:
            return None
        channels: dict[str, FloatArray] = {}
        units: dict[str, str] = {}
        points: dict[str, int] = {}
        quantities: dict[str, Quantity] = {}
        topics: dict[str, str] = {}
        chosen = [
            TopicStretch.of(name, self.first, self.samples, self._records.pop(name))
            for name in names
            if name in self._records
        ]
        parts = [part for part in chosen if part.blocks]
        if not parts:
            return None
        flags = 0
        for part in parts:
            flags |= part.flags
            head = part.blocks[0]
            data = np.full((len(head.channels), self.samples), math.nan)
            part.copy_data(data)
            for row, own in enumerate(head.channels):
                name = f"{part.topic}/{own}" if own in channels else own
                channels[name] = data[row]
                units[name], points[name] = head.unit, head.points[row]
                quantities[name], topics[name] = head.quantity, part.topic
        reference = phase_reference(parts)
        phase = ExcitationPhase(reference)
        cycles = None
        if phase.known and not phase.silent:
            cycles = phase.cycles()
            cycles -= math.floor(cycles[np.isfinite(cycles)][0])
        findings = tuple(window_findings(chosen))
        gaps = tuple(
            (finding.topic, finding.sample, finding.end - finding.sample)
            for finding in findings
            if finding.fault is WindowFault.MISSING and finding.end is not None
        )
        return Signals(
            reference.sample_rate, self.first, channels, units, points, quantities, cycles, gaps, flags,
            findings, topics, clock.at(0.5 * (self.first + self.end)),
        )  # fmt: skip


class _Clock:
    """Excitation periods since the start of the bag."""

    def __init__(self) -> None:
        self._sample = [0]
        self._cycles = [0.0]

    def add(self, head: BlockHead) -> None:
        frequency = head.oscillator.frequency_hz
        turns = frequency * head.samples / head.sample_rate if frequency > 0.0 and head.sample_rate > 0.0 else 0.0
        self._sample.append(head.end_sample)
        self._cycles.append(self._cycles[-1] + (math.nan if math.isnan(frequency) else turns))

    def finish(self) -> None:
        """All blocks have come."""
        self._samples, self._values = np.array(self._sample, dtype=np.float64), np.array(self._cycles)

    def at(self, sample: float) -> float:
        return float(np.interp(sample, self._samples, self._values))


_OF_A_RUN = {"plan", "linear", "extraction"}
"""Keys of the start record of a run; a recorder that a bridge feeds writes none of them."""


def _is_without_run(bag: Bag) -> bool:
    """Whether no run drove what a bag holds, or marked a window in it."""
    marked = any(bag.topics.get(topic, ("", 0))[1] for topic in ("lock", "level", "frequency", "run_state"))
    return not marked and not _OF_A_RUN & (bag.run_start or {}).keys()


def _records(bag: Bag) -> list[LockEvent]:
    """The longest stretch in which no sample of any topic is missing, and those of at least half its length."""
    readers = {topic: BlockReader() for topic in needed_topics(bag)}
    stretches: dict[str, list[tuple[int, int]]] = {topic: [] for topic in readers}
    for topic, _, _, raw in bag.raw_messages(readers) if readers else ():
        try:
            block = readers[topic].read(raw)
        except ValueError:
            continue
        if not np.isfinite(block.data).all():
            continue
        found, first = stretches[topic], block.first_sample
        if found and found[-1][1] == first:
            first = found.pop()[0]
        found.append((first, block.end_sample))
    common = reduce(_overlaps, stretches.values()) if stretches else []
    longest = max((end - first for first, end in common), default=0)
    chosen = [(first, end) for first, end in common if 2 * (end - first) >= longest]
    return [
        LockEvent(index, math.nan, "V", first, 0.0, math.nan, first, end - first, 0, TestKind.RECORD)
        for index, (first, end) in enumerate(chosen)
    ]


def _overlaps(some: list[tuple[int, int]], others: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """Stretches that both have; each in order."""
    found, i, j = [], 0, 0
    while i < len(some) and j < len(others):
        first, end = max(some[i][0], others[j][0]), min(some[i][1], others[j][1])
        if first < end:
            found.append((first, end))
        if some[i][1] <= others[j][1]:
            i += 1
        else:
            j += 1
    return found


def _extraction(bag: Bag) -> dict[str, Any]:
    extraction = (bag.run_start or {}).get("extraction")
    return extraction if isinstance(extraction, dict) else {}


def _minimum_periods(bag: Bag) -> int:
    value = _extraction(bag).get("minimum_periods")
    return value if isinstance(value, int) and not isinstance(value, bool) else MINIMUM_PERIODS


def _lock_event(bag: Bag, raw: bytes) -> LockEvent:
    try:
        return LOCK_EVENT.read(raw)
    except ValueError as error:
        raise BenchError(f"A lock event in the bag {bag.path} cannot be read: {error}.") from error


def _window(event: LockEvent) -> NamedWindow:
    return NamedWindow(
        event.window_first_sample, event.window_samples, event.window_periods, event.sample, TestKind.of(event.test)
    )


def _segment(event: LockEvent, verdict: WindowVerdict) -> Segment:
    return Segment(
        kind=TestKind.of(event.test),
        level_index=event.level_index,
        level=event.level,
        level_unit=event.level_unit,
        first_sample=event.window_first_sample,
        samples=event.window_samples,
        periods=event.window_periods,
        frequency_hz=event.frequency_hz,
        fault=verdict.reason.rstrip("."),
        usable_first_sample=verdict.first_sample,
        usable_samples=verdict.samples,
    )


def recorded_tests(bag: Bag, windows: Sequence[Segment] | None = None) -> tuple[DrivenTest, ...]:
    """The tests of a recording, one of each kind, in the order of their first windows; of a run without a window the
    one that it was asked for.

    Args:
        bag: the recording.
        windows: its windows, where they have been read already.

    Raises:
        BenchError: the bag is damaged, or holds a kind of test that this release does not know.
    """
    rig = None
    if bag.rig_yaml:
        try:
            rig = yaml_value(bag.rig_yaml, f"The rig file in {bag.path}")
        except BenchError:
            rig = None
    asked = DrivenTest.of_run(bag.run_start, rig if isinstance(rig, dict) else None)
    kinds = dict.fromkeys(segment.kind for segment in (segments(bag) if windows is None else windows))
    return tuple(replace(asked, kind=kind) for kind in kinds) or (asked,)
