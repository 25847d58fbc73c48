"""Tests of a simulated rig in one process without ROS: the bench's own loop and bag, at a finer mesh and step.

What is recorded says nothing of the truth: the bag's rig file, plan and linear description are those of the model.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from nmt_blind.cases.rig_edits import rig_yaml
from nmt_core.blocks import Quantity, SampleBlock
from nmt_core.errors import BenchError
from nmt_core.records import DriveCommand, LevelCommand
from nmt_core.vocabulary import LoopState, TestKind, Waveform
from nmt_plant.device import DeviceFault
from nmt_plant.simulated_rig import SimulatedRig
from nmt_pll.level_loop import LevelLoop, LockWindow, LoopOutput
from nmt_pll.loop import PhaseLockedLoop
from nmt_pll.random_drive import RandomDrive
from nmt_pll.settings import settings_from
from nmt_record.bag_writer import BagWriter
from nmt_record.run_messages import RunMessages
from nmt_rig.linear_description import linear_description
from nmt_rig.rig import BeamSection, Rig

# The oscillator runs through the random numbers of a seed: each test has one of its own.
_RANDOM_SEED = 0x5245
_CHUNK_MESSAGES = 2000


@dataclass(frozen=True)
class BenchSettings:
    """How the tests of a blind rig are made.

    Attributes:
        levels: drive amplitudes of the backbone test, V.
        window_periods: whole periods of each window.
        ramp: between levels, s.
        random_level: rms of the random drive, V.
        band_hz: band of the random drive.
        duration: window of the random test, s.
        settling_time: before that window, s.
        mesh_refinement: elements per point spacing of a beam, in the truth.
        substeps: steps of the time integration per sample, in the truth.
    """

    levels: tuple[float, ...]
    window_periods: int
    ramp: float
    random_level: float
    band_hz: tuple[float, float]
    duration: float
    settling_time: float
    mesh_refinement: int = 3
    substeps: int = 4


@dataclass(frozen=True)
class Outcome:
    """How a test went.

    Attributes:
        locked: levels whose window was recorded.
        levels: levels of the plan.
        bench_seconds: bench time, s.
        trouble: why it ended early; empty if it did not.
    """

    locked: int
    levels: int
    bench_seconds: float
    trouble: str = ""


def as_built(truth: Rig, bench: BenchSettings, seed: int) -> Rig:
    """The rig as the laboratory has it: finer mesh and step, noise of its own seed."""
    changes: dict[str, Any] = {"substeps": bench.substeps, "seed": seed}
    if isinstance(truth.structure, BeamSection):
        changes["structure"] = truth.structure.model_copy(update={"mesh_refinement": bench.mesh_refinement})
    return truth.model_copy(update=changes)


@dataclass(frozen=True)
class PlannedTest:
    """A test ready to be made: its loop, levels and what the run says of itself."""

    loop: LevelLoop
    commands: tuple[LevelCommand, ...]
    run: dict[str, Any]


@dataclass(frozen=True)
class Step:
    """One block of a test.

    Attributes:
        blocks: samples by quantity.
        output: the loop's answer.
        begun: the level that begins after this block, if one does.
        ended: the window that ended with this block; None otherwise.
    """

    blocks: dict[Quantity, SampleBlock]
    output: LoopOutput
    begun: LevelCommand | None
    ended: LockWindow | None


def backbone_test(truth: Rig, model: Rig, bench: BenchSettings) -> PlannedTest:
    """Phase resonance at every level, with real lock transients.

    Args:
        truth: the rig with what it really has; the loop's own settings are among that.
        model: the rig as it is believed to be: loop, plan and description come from it.
        bench: settings of the test.

    Raises:
        BenchError: a setting is refused.
    """
    linear = linear_description(model)
    lowest = min(bench.levels)
    scale = linear.frequencies_rad_s[linear.target_mode] ** 2 if model.extraction.quantity == "acceleration" else 1.0
    settings = {
        "force_floor": 0.02 * lowest * linear.force_per_volt,
        "response_floor": 0.02 * lowest * linear.displacement_per_volt * scale,
        **truth.pll,
    }
    loop = PhaseLockedLoop(linear, settings_from(settings), model.sample_rate_hz, model.block_samples)
    commands = tuple(
        LevelCommand(
            sequence=index + 1,
            index=index,
            amplitude=level,
            apply_at_sample=0,
            ramp=bench.ramp,
            window_periods=bench.window_periods,
            timeout=model.test.lock_timeout_s,
        )
        for index, level in enumerate(bench.levels)
    )
    return PlannedTest(loop, commands, _run(model, commands, linear.to_json()))


def random_test(model: Rig, bench: BenchSettings) -> PlannedTest:
    """One window of random excitation at low level; arguments as for `backbone_test`."""
    loop = RandomDrive(model.drive_point, model.sample_rate_hz, model.block_samples, settling_time=bench.settling_time)
    command = LevelCommand(
        sequence=1,
        index=0,
        amplitude=bench.random_level,
        apply_at_sample=0,
        ramp=bench.ramp,
        timeout=model.test.lock_timeout_s,
        test=TestKind.RANDOM,
        band_low_hz=bench.band_hz[0],
        band_high_hz=bench.band_hz[1],
        duration=bench.duration,
    )
    return PlannedTest(loop, (command,), _run(model, (command,), "null"))


def record_backbone(bag: Path, truth: Rig, model: Rig, bench: BenchSettings, seed: int) -> Outcome:
    """Make the backbone test and write it into a bag.

    Args:
        bag: folder to create.
        truth: the rig with what it really has.
        model: the rig as it is believed to be.
        bench: settings of the test.
        seed: of noise and random numbers.

    Raises:
        BenchError: a setting is refused or the bag cannot be written.
    """
    return _record(bag, as_built(truth, bench, seed), model, backbone_test(truth, model, bench))


def record_random(bag: Path, truth: Rig, model: Rig, bench: BenchSettings, seed: int) -> Outcome:
    """Make the random test and write it into a bag; arguments as for `record_backbone`."""
    return _record(bag, as_built(truth, bench, seed ^ _RANDOM_SEED), model, random_test(model, bench))


def _run(model: Rig, commands: Sequence[LevelCommand], linear_json: str) -> dict[str, Any]:
    """The run's description of itself: nothing in it depends on the truth."""
    first = commands[0]
    return {
        "run_id": "run",
        "rig": model.name,
        "seed": model.seed,
        "plan": {
            "control": first.control,
            "levels": [command.amplitude for command in commands],
            "ramp": first.ramp,
            "window_periods": first.window_periods,
            "timeout": first.timeout,
            "test": first.test.label,
            "band_low_hz": first.band_low_hz,
            "band_high_hz": first.band_high_hz,
            "duration": first.duration,
        },
        "exciter_point": model.drive_point,
        "linear": json.loads(linear_json),
        "extraction": {"harmonics": model.extraction.harmonics, "topics": ["force", model.extraction.quantity]},
        "versions": {"nmt": "0.1.0"},
    }


def play(built: Rig, model: Rig, test: PlannedTest) -> Iterator[Step]:
    """Work through the levels block by block, as the bench does: the next level waits for the window's last sample.

    Args:
        built: the rig as it stands in the laboratory.
        model: the rig as it is believed to be.
        test: the test; its loop is used up.

    Raises:
        DeviceFault: the motion is not finite any more.
        TrialError: the levels do not come to an end.
    """
    device = SimulatedRig(built)
    device.configure()
    response_quantity = Quantity[model.extraction.quantity.upper()]
    longest = sum(_longest(command, model) for command in test.commands) * device.sample_rate
    device.start()
    index = 0
    window: LockWindow | None = None
    command: LevelCommand | None = test.commands[0]
    test.loop.set_level(test.commands[0])
    try:
        while index < len(test.commands):
            blocks = {block.quantity: block for block in device.read()}
            force = blocks[Quantity.FORCE]
            output = test.loop.process(force, blocks[response_quantity])
            device.write(_command(output))
            window = output.lock or window
            ended = window if window is not None and force.end_sample >= window.first_sample + window.samples else None
            lost = output.state == LoopState.LOCK_LOST
            begun, command = command, None
            yield Step(blocks, output, begun, None if lost else ended)
            if ended is not None or lost:
                index, window = index + 1, None
                if index < len(test.commands):
                    command = replace(test.commands[index], apply_at_sample=force.end_sample)
                    test.loop.set_level(command)
            elif force.end_sample > longest:
                raise TrialError("the levels do not come to an end")
    finally:
        device.close()


class TrialError(ArithmeticError):
    """A test that cannot be made on this truth."""


def _record(bag: Path, built: Rig, model: Rig, test: PlannedTest) -> Outcome:
    time_ns = [0]
    # Chunks by number of messages and the bench's clock alone: the same truth gives the same file.
    writer = BagWriter(
        bag,
        run_json=json.dumps(test.run),
        rig_yaml=rig_yaml(model),
        chunk_messages=_CHUNK_MESSAGES,
        flush_interval=math.inf,
        clock=lambda: time_ns[0],
    )
    messages = RunMessages(writer, model.name)
    response = Quantity[model.extraction.quantity.upper()]
    locked, sample, trouble = 0, 0, ""
    try:
        for step in play(built, model, test):
            if step.begun is not None:
                messages.put_level(step.begun)
            sample = step.output.last_sample + 1
            time_ns[0] = round(sample / model.sample_rate_hz * 1e9)
            for block in step.blocks.values():
                messages.put_block(block)
            messages.put_output(step.output, response)
            locked += step.ended is not None
        writer.close("done", "every level was worked through", time_ns[0])
    except (DeviceFault, TrialError, BenchError) as error:
        trouble = str(error)
    finally:
        writer.close_quietly()
    return Outcome(locked, len(test.commands), sample / model.sample_rate_hz, trouble)


def _longest(command: LevelCommand, model: Rig) -> float:
    """s that a level may take."""
    linear = linear_description(model)
    window = command.duration or 2.0 * command.window_periods / linear.frequency_hz
    return command.ramp + command.timeout + window + 10.0


def _command(output: LoopOutput) -> DriveCommand:
    if output.waveform == Waveform.RANDOM and output.amplitude > 0.0:
        return DriveCommand(
            Waveform.RANDOM,
            amplitude=output.amplitude,
            ramp=output.ramp,
            band_low_hz=output.band_low_hz,
            band_high_hz=output.band_high_hz,
        )
    if output.frequency_hz > 0.0:
        return DriveCommand(Waveform.SINE, output.frequency_hz, output.amplitude, output.ramp)
    return DriveCommand(Waveform.OFF, ramp=output.ramp)
