"""Bags for the reading of observations: recorded from the time-domain plant without ROS, and altered copies of them."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from nmt_core.messages.blocks import Quantity, SampleBlock
from nmt_core.messages.records import LevelCommand
from nmt_core.messages.wire import LOCK_EVENT, BlockReader, BlockWriter
from nmt_core.vocabulary import LoopState, TestKind
from nmt_plant.devices.simulated_rig import SimulatedRig
from nmt_pll.loop_core import drive_command, lock_event
from nmt_pll.loop_settings import settings_from
from nmt_pll.open_loop.random_drive import RandomDrive
from nmt_pll.phase_loop.loop import PhaseLockedLoop
from nmt_record.bag.bag_reader import Bag
from nmt_record.bag.bag_writer import BagWriter
from nmt_record.bag.bench_topics import SAMPLE_BLOCK, parse_topic
from nmt_rig.linear_description import linear_description
from nmt_rig.rig import Rig, load_rig

SAMPLES = ("force", "displacement", "acceleration", "voltage")
LEVELS = (0.1, 0.3, 0.6, 1.2)
_NOISE = {"force": 2e-12, "displacement": 4.5e-19, "acceleration": 1e-12}


def rig_with_noise(name: str = "beam", noise: float = 1.0, seed: int = 1, overrides: Sequence[str] = ()) -> Rig:
    """A shipped rig whose sensors have ``noise`` times a thousandth of the densities of the paper's study.

    It is sampled at 5 kHz unless the overrides say otherwise: half of the samples say as much.
    """
    rig = load_rig(name, ["sample_rate_hz=5000", *overrides])
    sensors = [
        sensor.model_copy(
            update={
                "noise_psd": noise * _NOISE.get(sensor.quantity, 0.0),
                "noise_correlation_time_s": 1e-5,
                "bits": None,
            }
        )
        for sensor in rig.sensors
    ]
    return rig.model_copy(update={"sensors": sensors, "seed": seed})


def with_sensor(rig: Rig, channel: str, **changes: Any) -> Rig:
    """A rig whose sensor of a channel is another."""
    sensors = [s.model_copy(update=changes) if rig.sensor_channel(s) == channel else s for s in rig.sensors]
    return rig.model_copy(update={"sensors": sensors})


def record(
    path: Path,
    rig: Rig,
    kind: TestKind = TestKind.PHASE_RESONANCE,
    levels: Sequence[float] = LEVELS,
    *,
    periods: int = 40,
    duration: float = 5.0,
    band_hz: tuple[float, float] = (5.0, 500.0),
    run: dict[str, Any] | None = None,
) -> Path:
    """Step a simulated rig through its levels and write the bag; returns the folder."""
    device = SimulatedRig(rig)
    device.configure()
    linear = linear_description(rig)
    loop: Any = PhaseLockedLoop(linear, settings_from(rig.pll), device.sample_rate, device.block_samples)
    if kind is TestKind.RANDOM:
        loop = RandomDrive(rig.drive_point, device.sample_rate, device.block_samples)
    description = {
        "run_id": "test",
        "rig": rig.name,
        "seed": rig.seed,
        "linear": json.loads(linear.to_json()),
        "extraction": {"topics": ["force", rig.extraction.quantity]},
        **(run or {}),
    }
    writer = _writer(path, json.dumps(description), rig.model_dump_json())
    codecs: dict[str, BlockWriter] = {}
    device.start()
    loop_response = Quantity[rig.extraction.quantity.upper()]
    index, end, closed = -1, None, True
    while True:
        blocks = {block.quantity: block for block in device.read()}
        for block in blocks.values():
            writer.write(block.quantity.topic, codecs.setdefault(block.quantity.topic, BlockWriter("rig")).write(block))
        force = blocks[Quantity.FORCE]
        if closed:
            index, end, closed = index + 1, None, False
            if index == len(levels):
                break
            loop.set_level(_level(kind, index, levels[index], force.end_sample, rig, periods, duration, band_hz))
        output = loop.process(force, blocks[loop_response])
        device.write(drive_command(output))
        if output.lock is not None:
            writer.write("lock", LOCK_EVENT.write(lock_event(output.lock, loop_response, device.sample_rate)))
            end = output.lock.first_sample + output.lock.samples
        closed = (end is not None and force.end_sample >= end) or output.state == LoopState.LOCK_LOST
        assert force.end_sample < 100 * (len(levels) + 1) * device.sample_rate
    writer.close()
    device.close()
    return path


def _level(
    kind: TestKind,
    index: int,
    amplitude: float,
    sample: int,
    rig: Rig,
    periods: int,
    duration: float,
    band_hz: tuple[float, float],
) -> LevelCommand:
    random = kind is TestKind.RANDOM
    return LevelCommand(
        sequence=index + 1,
        index=index,
        amplitude=amplitude,
        apply_at_sample=sample,
        ramp=rig.test.ramp_s,
        window_periods=0 if random else periods,
        timeout=30.0,
        test=kind,
        band_low_hz=band_hz[0] if random else 0.0,
        band_high_hz=band_hz[1] if random else 0.0,
        duration=0.0 if kind is TestKind.PHASE_RESONANCE else duration,
    )


def _writer(path: Path, run_json: str, rig_yaml: str) -> BagWriter:
    writer = BagWriter(path, run_json=run_json, rig_yaml=rig_yaml)
    for name in (*SAMPLES, "lock"):
        topic = parse_topic(name)
        writer.add_topic(name, topic.message_type, topic.service)
    return writer


Change = Callable[[SampleBlock], Iterator[SampleBlock]]


def altered(
    source: Path,
    path: Path,
    change: Change | None = None,
    *,
    events: Callable[[Any], Any] | None = None,
    run: dict[str, Any] | None = None,
) -> Path:
    """A copy of a bag; blocks go through ``change``, lock events through ``events`` (None = left out)."""
    bag = Bag.open(source)
    writer = _writer(path, json.dumps({**(bag.run_start or {}), **(run or {})}), bag.rig_yaml or "")
    reader = {topic: BlockReader() for topic in bag.topics}
    for topic, _, _, raw in bag.raw_messages():
        if bag.topics[topic][0] == SAMPLE_BLOCK:
            codec = BlockWriter("rig")
            block = reader[topic].read(raw)
            for new in [block] if change is None else change(block):
                writer.write(topic, codec.write(new))
        elif topic == "lock":
            event = LOCK_EVENT.read(raw)
            kept = event if events is None else events(event)
            if kept is not None:
                writer.write(topic, LOCK_EVENT.write(kept))
    writer.close()
    return path


def with_data(block: SampleBlock, data: Any) -> SampleBlock:
    """The block with other samples."""
    return SampleBlock(
        block.first_sample, block.sample_rate, block.quantity, block.unit, block.channels, block.points,
        np.ascontiguousarray(data), block.oscillator, block.flags,
    )  # fmt: skip
