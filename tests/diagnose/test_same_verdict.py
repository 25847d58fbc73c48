"""One bag, one verdict: extraction, readers of whole windows and diagnosis reject the same windows for one reason."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from diagnose.observation_bags import record, rig_with_noise

from nmt_core.messages.blocks import BlockFlag, Quantity, SampleBlock
from nmt_core.messages.modal_point import ModalPoint
from nmt_core.messages.records import LoopStatus
from nmt_core.messages.wire import BlockReader, BlockWriter, write_status
from nmt_core.vocabulary import LoopState, PointStatus
from nmt_diagnose.measurements.locked_windows import LockedWindows
from nmt_diagnose.measurements.measurement import Observations
from nmt_diagnose.observations.read_observations import read_observations
from nmt_extract.offline import extract_bag
from nmt_record.bag.bag_reader import Bag
from nmt_record.bag.bag_writer import BagWriter
from nmt_record.bag.bench_topics import SAMPLE_BLOCK, parse_topic
from nmt_record.windows.segments import Segment, segments

RIG = rig_with_noise(overrides=["sample_rate_hz=10000"])
LEVELS = tuple(0.1 * 1.2**number for number in range(12))
REASONS = {
    1: "Within the window a converter was overloaded ('force', block at sample {block}).",
    2: "Samples {block} to {last} of 'displacement' are missing from the window.",
    3: "Within the window a safety limit had tripped ('displacement', block at sample {block}).",
    4: "Within the window the drive watchdog had tripped ('force', block at sample {block}).",
    5: "The excitation's phase jumps within the window at sample {block}.",
    6: "'force' repeats samples from {block} on within the window.",
    7: "The loop did not hold its lock over the window: lock lost at sample {last} (the response is gone).",
    8: "The channels change within the window in the block of 'displacement' at sample {block}.",
    9: "The sampling rate is 5000 Hz in the block of 'force' at sample {block}, 10000 Hz before.",
    11: "The window was never completed: 'force' ended after {have} of its {samples} samples.",
}
TOUCHED = {0, 10}
"""Faults in the blocks next to the window, on either side: no fault of the window."""


def spoiled(block: SampleBlock, level: int) -> Iterator[SampleBlock]:
    """A block with the fault of a level; nothing if the fault is that it is missing."""
    force, motion = block.quantity is Quantity.FORCE, block.quantity is Quantity.DISPLACEMENT
    flag = {1: BlockFlag.OVERLOAD, 3: BlockFlag.LIMIT, 4: BlockFlag.WATCHDOG}.get(level, BlockFlag.NONE)
    if level in TOUCHED:
        yield dataclasses.replace(block, flags=int(BlockFlag.OVERLOAD | BlockFlag.LIMIT | BlockFlag.WATCHDOG))
    elif flag and (motion if level == 3 else force):
        yield dataclasses.replace(block, flags=int(flag))
    elif level == 5 and force:
        phase = block.oscillator
        yield dataclasses.replace(block, oscillator=phase._replace(cycles=(phase.cycles + 0.1) % 1.0))
    elif level == 6 and force:
        yield block
        yield block
    elif level == 8 and motion:
        yield dataclasses.replace(block, points=block.points[::-1])
    elif level == 9 and force:
        yield dataclasses.replace(block, sample_rate=5000.0)
    elif not (level == 2 and motion):
        yield block


class Faults:
    """Which blocks of the clean bag are spoiled, from the windows in it."""

    def __init__(self, windows: list[Segment], block: int) -> None:
        self.hits: dict[int, int] = {}
        for window in windows:
            if window.level_index in TOUCHED:
                self.hits[(window.first_sample // block - 1) * block] = window.level_index
                self.hits[-(-window.end_sample // block) * block] = window.level_index
            else:
                # The block of the last sample but for the faults that show at its beginning.
                middle = window.first_sample + window.samples // 2
                sample = middle if window.level_index in (5, 6) else window.end_sample - 1
                self.hits[sample // block * block] = window.level_index
        self.end = next(first for first, level in self.hits.items() if level == 11)

    def block(self, level: int) -> int:
        """First sample of the spoiled block of a level."""
        return next(first for first, own in self.hits.items() if own == level)


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[int, str]]:
    """A bag with one fault in each of its windows but two, and the reasons."""
    folder = tmp_path_factory.mktemp("verdict")
    clean = Bag.open(record(folder / "clean", RIG, levels=LEVELS, periods=12))
    windows = segments(clean)
    assert [window.fault for window in windows] == [""] * len(LEVELS)
    size = next(clean.blocks("force")).samples
    faults = Faults(windows, size)
    writer = BagWriter(folder / "bag", run_json=json.dumps(clean.run_start), rig_yaml=clean.rig_yaml or "")
    for name in ("force", "displacement", "acceleration", "voltage", "frequency", "lock"):
        topic = parse_topic(name)
        writer.add_topic(name, topic.message_type, topic.service)
    readers = {topic: BlockReader() for topic in clean.topics}
    for topic, _, _, raw in clean.raw_messages():
        if clean.topics[topic][0] != SAMPLE_BLOCK:
            if topic == "lock":
                writer.write(topic, raw)
            continue
        block = readers[topic].read(raw)
        if block.first_sample >= faults.end:
            continue
        level = faults.hits.get(block.first_sample, -1)
        for new in spoiled(block, level):
            writer.write(topic, BlockWriter("rig").write(new))
        if topic == "force":
            writer.write("frequency", write_status(_status(block, level), block.sample_rate))
    writer.close()
    last = windows[11]
    reasons = {
        level: text.format(
            block=faults.block(level),
            last=faults.block(level) + size - 1,
            have=faults.end - last.first_sample,
            samples=last.samples,
        )
        for level, text in REASONS.items()
    }
    reasons[2] = reasons[2].replace(str(faults.block(2) + size - 1), str(windows[2].end_sample - 1))
    return folder / "bag", reasons


def _status(block: SampleBlock, level: int) -> LoopStatus:
    lost = level == 7
    return LoopStatus(
        block.end_sample - 1, 0, 1, LoopState.LOCK_LOST if lost else LoopState.LOCKED, 20.0, 0.0, 1.0, 1.0, "m", 0.1,
        reason="the response is gone." if lost else "",
    )  # fmt: skip


def extracted(path: Path) -> dict[int, ModalPoint]:
    return {
        point.level_index: point for point in extract_bag(path).points if point.status is not PointStatus.NOT_LOCKED
    }


def left_out(observations: Observations) -> dict[int, str]:
    """Level -> reason, out of the notes."""
    found: dict[int, str] = {}
    for note in observations.notes:
        head, found_it, reason = note.partition(" (phase_resonance) is left out: ")
        if found_it:
            found[int(head.rpartition(" ")[2])] = reason
    return found


def test_all_readers_reject_the_same_windows_for_the_same_reason(bag: tuple[Path, dict[int, str]]) -> None:
    path, reasons = bag
    points = extracted(path)
    assert {level: point.reason for level, point in points.items() if point.status is PointStatus.REJECTED} == reasons
    assert {level for level, point in points.items() if point.status is PointStatus.OK} == TOUCHED
    read = {segment.level_index: segment for segment in segments(Bag.open(path))}
    assert {level: f"{segment.fault}." for level, segment in read.items() if segment.fault} == reasons
    assert {level for level, segment in read.items() if segment.usable_samples} == TOUCHED
    observations = read_observations([path], RIG)
    assert left_out(observations) == reasons
    (test,) = observations.tests
    assert isinstance(test, LockedWindows)
    assert {level.index for level in test.levels} == TOUCHED


def test_the_samples_of_a_window_are_those_that_were_extracted(bag: tuple[Path, dict[int, str]]) -> None:
    """Edges and phase of the window that two readers cut, beside the frequency that the third has of it."""
    path, _ = bag
    opened = Bag.open(path)
    points: dict[int, Any] = extracted(path)
    observations = read_observations([path], RIG)
    (test,) = observations.tests
    assert isinstance(test, LockedWindows)
    for level in test.levels:
        segment = segments(opened)[level.index]
        rate = RIG.sample_rate_hz
        assert (level.start_s, level.stop_s) == (segment.first_sample / rate, segment.end_sample / rate)
        assert level.frequency_hz == pytest.approx(points[level.index].frequency_hz, rel=1e-8)
