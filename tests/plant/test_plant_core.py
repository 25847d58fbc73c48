"""What the plant does with drive commands that cannot be meant: nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from nmt_core.errors import BenchError
from nmt_core.messages.command_judge import CommandSource, Refusal
from nmt_core.messages.records import DriveCommand, RunState
from nmt_core.vocabulary import BlockFlag, OutputState, Quantity, ResultCode, RunPhase, StopCause, Waveform
from nmt_plant.devices.loopback_device import LoopbackDevice
from nmt_plant.plant_core import PlantCore

BLOCK, RATE = 100, 1000.0
LOOP = CommandSource("01", "/pll")
STRANGER = CommandSource("02", "/stranger")


def state(phase: RunPhase, horizon: int = 10_000) -> RunState:
    return RunState("run", phase, 0, 1, 0.3, 0.0, 0, horizon, ResultCode.UNKNOWN, "")


def sine(based_on: int, amplitude: float = 0.3, apply_at: int | None = None) -> DriveCommand:
    return DriveCommand(
        Waveform.SINE, 20.0, amplitude, 0.0, based_on + 1 if apply_at is None else apply_at, based_on_sample=based_on
    )


def running(latency_blocks: int = 0, lockstep: bool = True) -> PlantCore:
    core = PlantCore(LoopbackDevice(RATE, BLOCK), latency_blocks, lockstep)
    core.take_state(state(RunPhase.RUNNING))
    return core


def produce(core: PlantCore) -> float:
    """Largest voltage of the next block."""
    blocks = {block.quantity: block for block in core.produce()}
    return float(np.max(np.abs(blocks[Quantity.VOLTAGE].data)))


def test_the_commands_of_the_loop_are_taken_one_a_block() -> None:
    core = running()
    for number in range(20):
        assert core.due
        produce(core)
        assert not core.due
        assert core.take_drive(sine((number + 1) * BLOCK - 1), LOOP) == ""
    assert produce(core) == pytest.approx(0.3, rel=1e-2)
    assert core.judge.counts == {"accepted": 20, "missing_blocks": 0}


@pytest.mark.parametrize("lockstep", [True, False])
def test_a_base_that_nobody_has_measured_does_not_switch_lockstep_off(lockstep: bool) -> None:
    core = running(lockstep=lockstep)
    produce(core)
    assert "has not been measured" in core.take_drive(sine(2**60, 5.0, apply_at=0), LOOP)
    assert "has not been measured" in core.take_drive(sine(2 * BLOCK - 1, 5.0, apply_at=0), LOOP)
    assert not core.due
    assert produce(core) == 0.0
    assert core.judge.counts["refused_not_measured_yet"] == 2


def test_a_command_before_the_first_block_has_no_base() -> None:
    core = running()
    assert core.take_drive(sine(BLOCK - 1, 5.0, apply_at=0), LOOP)
    assert produce(core) == 0.0


def test_blocks_left_out_are_allowed_as_far_as_the_plant_runs_ahead() -> None:
    strict, loose = running(0), running(2)
    for core in (strict, loose):
        produce(core)
        assert core.take_drive(sine(BLOCK - 1), LOOP) == ""
        for _ in range(3):
            produce(core)
    assert "were left out" in strict.take_drive(sine(3 * BLOCK - 1), LOOP)
    assert loose.take_drive(sine(4 * BLOCK - 1), LOOP) == ""


def test_a_second_source_is_named_and_moves_nothing() -> None:
    core = running()
    produce(core)
    assert core.take_drive(sine(BLOCK - 1), LOOP) == ""
    assert core.second_source == ""
    produce(core)
    assert "/stranger" in core.take_drive(sine(2 * BLOCK - 1, 5.0, apply_at=0), STRANGER)
    assert not core.due
    assert core.second_source == "topic drive has a second publisher: /stranger"
    assert core.take_drive(sine(2 * BLOCK - 1), LOOP) == ""
    assert core.due
    assert produce(core) < 0.31
    assert core.judge.refused[Refusal.SOURCE] == 1


def test_of_several_publishers_none_is_believed_even_before_the_first_command() -> None:
    core = running()
    produce(core)
    both = CommandSource("01 02", "/pll and /stranger", alone=False)
    assert "several publishers" in core.take_drive(sine(BLOCK - 1, 5.0), both)
    assert not core.due
    assert "/pll and /stranger" in core.second_source


def test_a_command_that_names_a_sample_far_ahead_is_refused() -> None:
    core = running()
    produce(core)
    assert "ahead" in core.take_drive(sine(BLOCK - 1, apply_at=2**60), LOOP)
    assert not core.due


def test_a_command_beyond_the_device_is_an_answer_all_the_same() -> None:
    core = running()
    produce(core)
    with pytest.raises(BenchError, match="limit of 10 V"):
        core.take_drive(sine(BLOCK - 1, 50.0), LOOP)
    assert core.due


def test_a_new_run_accepts_a_loop_that_was_started_again() -> None:
    core = running()
    produce(core)
    assert core.take_drive(sine(BLOCK - 1), LOOP) == ""
    core.take_state(state(RunPhase.DONE))
    produce(core)
    assert core.take_drive(sine(2 * BLOCK - 1), STRANGER)
    core.take_state(state(RunPhase.RUNNING))
    assert core.second_source == ""
    assert core.take_drive(sine(2 * BLOCK - 1), STRANGER) == ""


def test_a_new_run_does_not_wait_for_an_answer_that_went_with_the_loop() -> None:
    core = running()
    produce(core)
    assert not core.due
    core.take_state(state(RunPhase.DONE))
    core.take_state(state(RunPhase.RUNNING, horizon=3 * BLOCK))
    assert core.due
    produce(core)
    assert not core.due, "in the run every block waits for its answer"


def test_a_plant_that_was_started_again_does_not_go_on_with_the_run_of_the_one_before() -> None:
    core = PlantCore(LoopbackDevice(RATE, BLOCK))
    assert not core.take_state(replace(state(RunPhase.RUNNING), sample=5000))
    assert not core.running
    core.take_state(replace(state(RunPhase.DONE), sample=5000))
    assert core.take_state(state(RunPhase.RUNNING, horizon=BLOCK))
    assert core.due
    produce(core)
    core.take_drive(sine(BLOCK - 1), LOOP)
    assert not core.due, "the horizon of the run before is forgotten"


def replace_base(command: DriveCommand, based_on: int) -> DriveCommand:
    return command._replace(based_on_sample=based_on)


def moving() -> PlantCore:
    """A core whose drive is on; its ramp to zero takes two blocks and a half."""
    core = PlantCore(LoopbackDevice(RATE, BLOCK, quiet_ramp=0.25))
    core.take_state(state(RunPhase.RUNNING))
    for number in range(4):
        produce(core)
        core.take_drive(sine((number + 1) * BLOCK - 1), LOOP)
    assert core.stop() is None
    return core


def test_a_stop_is_told_when_it_begins_is_at_zero_and_is_released() -> None:
    core = moving()
    at = core.device.next_sample
    blocks = []
    told = []
    for produced in core.stop_drive("emergency stop by /door", StopCause.EMERGENCY_STOP):
        told.append(core.stop())
        blocks.append(next(block for block in produced if block.quantity == Quantity.VOLTAGE))
    events = [stop for stop in [*told, core.stop()] if stop is not None]
    assert [(stop.cause, stop.output) for stop in events] == [
        (StopCause.EMERGENCY_STOP, OutputState.RAMPING),
        (StopCause.EMERGENCY_STOP, OutputState.HELD),
    ]
    assert events[0].sample == at + BLOCK, "told with the first block of the ramp"
    assert {stop.reason for stop in events} == {"emergency stop by /door"}
    assert events[1].time_ns == round(events[1].sample / RATE * 1e9)
    assert all(block.flags & BlockFlag.STOP for block in blocks)
    assert blocks[0].data.any()
    assert not blocks[-1].data.any()
    assert core.stop() is None, "once each"
    core.device.reset()
    released = core.stop()
    assert released is not None
    assert (released.cause, released.output, released.reason) == (StopCause.RELEASED, OutputState.AT_ZERO, "")
    assert core.stop() is None


def test_a_block_of_zeros_follows_a_ramp_that_the_loop_has_commanded() -> None:
    core = moving()
    off = DriveCommand(Waveform.OFF, 0.0, 0.0, 0.15, 0, based_on_sample=4 * BLOCK - 1)
    for number in range(4, 8):
        last = produce(core)
        if core.device.is_quiet:
            break
        core.take_drive(replace_base(off, (number + 1) * BLOCK - 1), LOOP)
    assert core.device.is_quiet
    assert last > 0.0, "the newest block still shows the ramp"
    assert not core.at_rest
    blocks = [block for produced in core.quiet_down("the plant node was told to end") for block in produced]
    voltages = [block.data for block in blocks if block.quantity == Quantity.VOLTAGE]
    assert len(voltages) == 1
    assert not voltages[0].any()
    assert core.at_rest
    assert list(core.quiet_down("the plant node was told to end")) == []


def test_a_stop_before_a_run_is_latched_and_takes_no_block() -> None:
    core = PlantCore(LoopbackDevice(RATE, BLOCK))
    assert list(core.stop_drive("the service quiet", StopCause.QUIET)) == []
    assert core.device.next_sample == 0
    stop = core.stop()
    assert stop is not None
    assert (stop.cause, stop.output, stop.sample) == (StopCause.QUIET, OutputState.HELD, 0)
    core.take_state(state(RunPhase.RUNNING))
    produce(core)
    core.take_drive(sine(BLOCK - 1), LOOP)
    assert produce(core) == 0.0


def test_the_first_stop_is_the_one_that_is_told() -> None:
    core = moving()
    list(core.stop_drive("the service quiet", StopCause.QUIET))
    core.stop()
    list(core.stop_drive("emergency stop by /door", StopCause.EMERGENCY_STOP))
    assert core.stop() is None
    assert core.device.stop_cause is StopCause.QUIET


def test_a_failure_is_told_with_what_became_of_the_output() -> None:
    core = moving()
    core.device.close()
    stop = core.failure("the amplifier is on fire")
    assert (stop.cause, stop.output, stop.reason) == (StopCause.DEVICE, OutputState.ENDED, "the amplifier is on fire")


def test_an_emergency_stop_does_not_wait_for_a_longer_ramp() -> None:
    core = moving()
    core.device.quiet("slowly", 2.0)
    blocks = list(core.stop_drive("emergency stop by /door", StopCause.EMERGENCY_STOP))
    assert len(blocks) <= 4
    assert core.device.is_quiet
    assert core.device.tripped == "slowly", "the first reason stays"


def test_in_lockstep_a_run_waits_for_its_slowest_reader_and_the_ramp_to_zero_does_not() -> None:
    core = PlantCore(LoopbackDevice(RATE, BLOCK), reader_lead=300)
    core.take_state(state(RunPhase.RUNNING, horizon=1000))
    made = 0

    def as_far_as_may_be() -> int:
        nonlocal made
        while core.due:
            produce(core)
            made += BLOCK
            core.take_drive(sine(made - 1), LOOP)
        return made

    assert as_far_as_may_be() == 300
    core.take_progress("recorder", 300)
    assert core.waits_for == "extract"
    assert as_far_as_may_be() == 300
    core.take_progress("extract", 250)
    assert as_far_as_may_be() == 600  # blocks are whole: the one that begins 50 samples short of the lead is made
    core.take_state(state(RunPhase.STOPPING, horizon=1000))
    assert as_far_as_may_be() == 1000


def test_without_a_lead_no_bag_is_waited_for() -> None:
    core = running()
    for made in range(BLOCK, 50 * BLOCK, BLOCK):
        assert core.due
        produce(core)
        core.take_drive(sine(made - 1), LOOP)
    assert not core.waits_for
