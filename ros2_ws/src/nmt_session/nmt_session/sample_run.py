"""A short test of a simulated rig in one process without ROS: plant, loop and bag writer called in turn.

It makes real bags where ROS is absent, and shows how much of the bench's time is computing.
"""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from nmt_core.blocks import Quantity
from nmt_core.errors import BenchError
from nmt_core.records import DriveCommand, LevelCommand
from nmt_core.vocabulary import LoopState, Waveform

if TYPE_CHECKING:
    from nmt_rig.rig import Rig


@dataclass(frozen=True)
class SampleRun:
    """What a sample run came to.

    Attributes:
        bag: folder of the bag.
        blocks: number of blocks.
        messages: number of messages in the bag.
        bench_seconds: bench time, s.
        plant_seconds: process time in the plant (read and write), s.
        loop_seconds: process time in the phase-locked loop, s.
        write_seconds: process time for serialising and writing, s.
        locked: levels that locked.
    """

    bag: Path
    blocks: int
    messages: int
    bench_seconds: float
    plant_seconds: float
    loop_seconds: float
    write_seconds: float
    locked: int


def record_sample_run(bag: Path, rig: Rig, levels: Sequence[float], window_periods: int) -> SampleRun:
    """Step through the levels: ramp, lock, one window each; record everything.

    Args:
        bag: folder to create.
        rig: a simulated rig with displacement sensors.
        levels: drive amplitudes, V.
        window_periods: whole periods of each window.

    Raises:
        BenchError: the rig or its levels are not acceptable, or the bag cannot be written.
    """
    from nmt_plant.simulated_rig import SimulatedRig
    from nmt_pll.loop import PhaseLockedLoop
    from nmt_pll.settings import settings_from
    from nmt_record.bag_writer import BagWriter
    from nmt_record.run_messages import RunMessages
    from nmt_rig.linear_description import linear_description

    linear = linear_description(rig)
    device = SimulatedRig(rig)
    device.configure()
    loop = PhaseLockedLoop(linear, settings_from(rig.pll), device.sample_rate, device.block_samples)
    run = {
        "run_id": "sample-run",
        "rig": rig.name,
        "seed": rig.seed,
        "plan": {"control": "voltage", "levels": list(levels), "window_periods": window_periods},
        "linear": json.loads(linear.to_json()),
        "extraction": {"harmonics": rig.extraction.harmonics, "topics": ["force", rig.extraction.quantity]},
        "versions": {"nmt": "0.1.0"},
    }
    # JSON is YAML, so that the rig travels without a second writer.
    writer = BagWriter(bag, run_json=json.dumps(run), rig_yaml=rig.model_dump_json(indent=1))
    messages = RunMessages(writer, rig.name)
    response_quantity = Quantity[rig.extraction.quantity.upper()]

    def start(index: int, sample: int) -> LevelCommand:
        level = LevelCommand(
            sequence=index + 1,
            index=index,
            amplitude=levels[index],
            apply_at_sample=sample,
            ramp=rig.test.ramp_s,
            window_periods=window_periods,
            timeout=rig.test.lock_timeout_s,
        )
        loop.set_level(level)
        messages.put_level(level)
        return level

    spent = dict.fromkeys(("plant", "loop", "write"), 0.0)
    device.start()
    clock = time.process_time
    start(0, 0)
    window_seconds = 2.0 * window_periods / linear.frequency_hz
    level_seconds = rig.test.ramp_s + rig.test.lock_timeout_s + window_seconds + 10.0
    longest = len(levels) * level_seconds * device.sample_rate
    index, window_end, locked, sample, blocks = 0, None, 0, 0, 0
    try:
        while index < len(levels):
            begin = clock()
            block_set = {block.quantity: block for block in device.read()}
            spent["plant"] += clock() - begin
            force, response = block_set[Quantity.FORCE], block_set[response_quantity]
            begin = clock()
            output = loop.process(force, response)
            spent["loop"] += clock() - begin
            begin = clock()
            for block in block_set.values():
                messages.put_block(block)
            messages.put_output(output, response_quantity)
            spent["write"] += clock() - begin
            begin = clock()
            waveform = Waveform.SINE if output.frequency_hz > 0.0 else Waveform.OFF
            device.write(DriveCommand(waveform, output.frequency_hz, output.amplitude, output.ramp))
            spent["plant"] += clock() - begin
            sample = force.end_sample
            blocks += 1
            if sample > longest:
                raise BenchError("The sample run does not come to an end; its loop neither locks nor gives up.")
            if output.lock is not None:
                window_end = output.lock.first_sample + output.lock.samples
                locked += 1
            # As on the bench, the next level waits for the last sample of the window.
            if (window_end is not None and sample >= window_end) or output.state == LoopState.LOCK_LOST:
                index, window_end = index + 1, None
                if index < len(levels):
                    start(index, sample)
        writer.close("done", "every level was worked through")
    finally:
        device.close()
        writer.close_quietly()
    return SampleRun(
        bag=bag,
        blocks=blocks,
        messages=writer.messages,
        bench_seconds=sample / device.sample_rate,
        plant_seconds=spent["plant"],
        loop_seconds=spent["loop"],
        write_seconds=spent["write"],
        locked=locked,
    )
