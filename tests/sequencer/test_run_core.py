"""States of the loop that cannot be meant do not move a run; a second source ends it."""

from __future__ import annotations

from typing import Any

import pytest
from sequencer.bench import status

from nmt_core.messages.command_judge import CommandSource
from nmt_core.messages.records import DriveStop, LoopStatus
from nmt_core.settings import settings_of
from nmt_core.vocabulary import BlockFlag, LoopState, OutputState, ResultCode, RunPhase, StopCause
from nmt_sequencer.level_plan import RunPlan
from nmt_sequencer.run_core import RunCore
from nmt_sequencer.sequencer_settings import SequencerSettings

BLOCK, RATE = 100, 1000.0
LOOP, STRANGER = CommandSource("01", "/pll"), CommandSource("02", "/stranger")


def running(**values: Any) -> RunCore:
    given = {"sample_rate": RATE, "block_samples": BLOCK, **values}
    core = RunCore(settings_of(SequencerSettings, given, "sequencer"))
    core.start(RunPlan("run", (0.3,)))
    core.orders()
    return core


def fixed(last_sample: int, sequence: int = 0) -> LoopStatus:
    return status(last_sample, 0, sequence, LoopState.FIXED)


def feed(core: RunCore, first: int, last: int) -> None:
    """States after the blocks from one number to another, each level acknowledged."""
    for number in range(first, last):
        assert core.take_status(fixed((number + 1) * BLOCK - 1, 10), LOOP) == ""


@pytest.mark.parametrize("pacing", ["lockstep", "realtime"])
def test_a_state_of_a_sample_that_cannot_exist_does_not_hold_the_run(pacing: str) -> None:
    core = running(pacing=pacing)
    assert "ahead" in core.take_status(fixed(2**60 - 1), LOOP)
    feed(core, 0, 3)
    before = core.machine.horizon
    assert core.take_status(fixed(2**60 - 1), LOOP)
    assert core.machine.newest == 3 * BLOCK - 1
    feed(core, 3, 12)
    assert core.machine.newest == 12 * BLOCK - 1
    assert pacing == "realtime" or core.machine.horizon > before


def test_a_repeated_state_acknowledges_a_level() -> None:
    core = running()
    assert core.take_status(fixed(BLOCK - 1, 0), LOOP) == ""
    before = core.machine.horizon
    assert core.take_status(fixed(BLOCK - 1, 1), LOOP) == ""
    assert core.machine.horizon > before


def test_a_second_source_ends_the_run_by_name_and_with_a_ramp() -> None:
    core = running()
    feed(core, 0, 12)
    assert "/stranger" in core.take_status(fixed(13 * BLOCK - 1, 10), STRANGER)
    assert core.machine.newest == 12 * BLOCK - 1
    feed(core, 12, 40)
    (order,) = core.orders()
    assert (order.amplitude, order.ramp) == (0.0, core.machine.pacing.quiet_ramp)
    state = core.state()
    assert state is not None
    assert (state.phase, state.result_code) == (RunPhase.DONE, ResultCode.NODE_LOST)
    assert state.reason == "Topic frequency has a second publisher: /stranger."


def test_of_several_publishers_none_is_believed_and_the_run_is_over() -> None:
    core = running()
    feed(core, 0, 12)
    assert core.take_status(fixed(13 * BLOCK - 1, 10), CommandSource("01 02", "/pll and /stranger", alone=False))
    state = core.state()
    assert state is not None
    assert (state.phase, state.result_code) == (RunPhase.DONE, ResultCode.NODE_LOST)
    assert "/pll and /stranger" in state.reason
    assert core.machine.newest == 12 * BLOCK - 1


def test_a_new_run_begins_with_a_clean_slate() -> None:
    core = running()
    feed(core, 0, 12)
    core.take_status(fixed(13 * BLOCK - 1, 10), STRANGER)
    feed(core, 12, 40)
    core.start(RunPlan("again", (0.3,)))
    assert core.take_status(fixed(60 * BLOCK - 1, 10), STRANGER) == ""
    assert core.machine.active
    assert core.judge.second_source == ""


@pytest.mark.parametrize(
    ("cause", "code"),
    [
        (StopCause.QUIET, ResultCode.STOPPED),
        (StopCause.EMERGENCY_STOP, ResultCode.STOPPED),
        (StopCause.EXTERNAL_INPUT, ResultCode.STOPPED),
        (StopCause.OUTPUT, ResultCode.NODE_LOST),
    ],
)
def test_a_stop_at_the_plant_ends_the_run_with_its_reason(cause: StopCause, code: ResultCode) -> None:
    core = running()
    feed(core, 0, 3)
    core.take_stop(DriveStop(310, cause, OutputState.RAMPING, "somebody said so."))
    for number in range(3, 40):
        core.take_status(fixed((number + 1) * BLOCK - 1, 10)._replace(flags=int(BlockFlag.STOP)), LOOP)
    assert core.machine.phase == RunPhase.DONE
    assert core.machine.code == code
    assert core.machine.reason == "The drive was stopped at sample 310: somebody said so."


@pytest.mark.parametrize(
    "cause", [StopCause.LIMIT, StopCause.WATCHDOG, StopCause.NODE, StopCause.DEVICE, StopCause.RELEASED]
)
def test_other_stops_are_told_otherwise(cause: StopCause) -> None:
    core = running()
    feed(core, 0, 3)
    core.take_stop(DriveStop(310, cause, OutputState.RAMPING, "somebody said so."))
    feed(core, 3, 12)
    assert core.machine.phase == RunPhase.RUNNING


def test_a_flag_without_its_message_ends_the_run_too() -> None:
    core = running()
    for number in range(40):
        core.take_status(fixed((number + 1) * BLOCK - 1, 10)._replace(flags=int(BlockFlag.STOP)), LOOP)
    assert (core.machine.code, core.machine.reason) == (ResultCode.STOPPED, "The drive was stopped at the plant.")


def test_a_limit_during_a_stop_that_was_asked_for_is_a_limit() -> None:
    core = running()
    feed(core, 0, 3)
    core.machine.stop(ResultCode.STOPPED, "Stopped by the stop service.")
    for number in range(3, 40):
        core.take_status(fixed((number + 1) * BLOCK - 1, 10)._replace(flags=int(BlockFlag.LIMIT)), LOOP)
    assert core.machine.code == ResultCode.LIMIT


def test_a_stop_for_a_node_that_has_gone_says_so_and_calls_no_watchdog() -> None:
    core = running()
    feed(core, 0, 3)
    core.take_stop(DriveStop(310, StopCause.NODE, OutputState.RAMPING, "node pll has fallen silent"))
    for number in range(3, 40):
        core.take_status(fixed((number + 1) * BLOCK - 1, 10)._replace(flags=int(BlockFlag.WATCHDOG)), LOOP)
    assert core.machine.phase == RunPhase.DONE
    assert core.machine.code == ResultCode.NODE_LOST
    assert core.machine.reason == "The drive was stopped at sample 310: node pll has fallen silent."


def test_who_knows_better_why_the_plant_stopped_is_believed() -> None:
    core = running()
    feed(core, 0, 3)
    core.take_stop(DriveStop(310, StopCause.NODE, OutputState.RAMPING, "topic drive has a second publisher"))
    core.machine.stop(ResultCode.NODE_LOST, "Topic drive has a second publisher: /a and /b.")
    for number in range(3, 40):
        core.take_status(fixed((number + 1) * BLOCK - 1, 10)._replace(flags=int(BlockFlag.WATCHDOG)), LOOP)
    assert core.machine.reason == "Topic drive has a second publisher: /a and /b."


@pytest.mark.parametrize("again", [False, True])
def test_a_stop_for_a_node_does_not_outlive_its_release_or_its_run(again: bool) -> None:
    core = running()
    feed(core, 0, 3)
    core.take_stop(DriveStop(310, StopCause.NODE, OutputState.HELD, "node pll has fallen silent"))
    if again:
        core.machine.abandon(ResultCode.NODE_LOST, "gone")
        core.start(RunPlan("again", (0.3,)))
    else:
        core.take_stop(DriveStop(350, StopCause.RELEASED, OutputState.AT_ZERO, ""))
    for number in range(3, 60):
        core.take_status(fixed((number + 1) * BLOCK - 1, 10)._replace(flags=int(BlockFlag.WATCHDOG)), LOOP)
    assert (core.machine.code, core.machine.phase) == (ResultCode.LIMIT, RunPhase.DONE)
    assert "the drive watchdog has tripped" in core.machine.reason


def over() -> RunCore:
    """A run that ended after the window of its only level."""
    core = running()
    core.machine.records[0].complete = True
    core.machine.phase, core.machine.code, core.machine.end_sample = RunPhase.DONE, ResultCode.SUCCEEDED, 5000
    core.machine.reason = "1 of 1 levels locked."
    return core


def test_after_a_run_extraction_moves_up_to_its_end_and_no_further() -> None:
    core = over()
    assert core.moves(3000)
    assert not core.moves(3000)
    assert core.moves(6000)
    assert not core.moves(7000), "what a source gives after the run brings no point of it"


def test_a_run_whose_point_does_not_come_is_no_success() -> None:
    core = over()
    core.account()
    assert core.machine.code == ResultCode.POINTS_MISSING
    assert "1 of 1 locked levels did not come from extraction: level 1." in core.machine.reason
    state = core.state()
    assert state is not None
    assert state.result_code == ResultCode.POINTS_MISSING


def test_a_run_that_was_ended_keeps_its_reason_and_names_what_is_missing() -> None:
    core = over()
    core.machine.code, core.machine.reason = ResultCode.STOPPED, "Stopped by a test."
    core.account()
    assert core.machine.code == ResultCode.STOPPED
    assert core.machine.reason.startswith("Stopped by a test. The modal points of 1 of 1")
