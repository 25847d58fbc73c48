"""What the sequencer node does with messages, free of ROS: loop states and locks in, levels and run states out."""

from __future__ import annotations

import time
from collections.abc import Hashable, Mapping
from typing import Any

from nmt_core.messages.cdr import bench_time_ns
from nmt_core.messages.command_judge import LONGEST_AHEAD, CommandJudge, CommandSource
from nmt_core.messages.modal_point import ModalPoint
from nmt_core.messages.records import DriveStop, LevelCommand, LockEvent, LoopStatus, RunState, Steering
from nmt_core.messages.run_announcement import RunAnnouncement
from nmt_core.messages.run_settings import RunSettings
from nmt_core.text.number_words import level_list
from nmt_core.vocabulary import ResultCode, RunPhase, StopCause
from nmt_sequencer.level_plan import RunPlan
from nmt_sequencer.run_machine import Pacing, RunMachine
from nmt_sequencer.sequencer_settings import SequencerSettings
from nmt_sequencer.steering import SteeringRequest

# In real time a sequencer may join a loop that has run for long, and miss blocks that the loop could not answer.
_LONGEST_BEFORE = 7 * 86400.0  # s
_LONGEST_STALL = 10.0  # s


_STOPPED_BY = {
    StopCause.QUIET: ResultCode.STOPPED,
    StopCause.EMERGENCY_STOP: ResultCode.STOPPED,
    StopCause.EXTERNAL_INPUT: ResultCode.STOPPED,
    StopCause.OUTPUT: ResultCode.NODE_LOST,
}
"""How a run ends after a stop at the plant; the others are known by the flags of the samples, or on diagnostics."""


class RunCore:
    """The run machine with its parameters, and its orders and states as records.

    After every call publish what :meth:`acts`, then what :meth:`orders` and then what :meth:`state` returns.

    Args:
        settings: those of the node.

    Attributes:
        machine: the state machine of the run.
        points: modal points of the run, by level.
        judge: whether a state of the loop can be meant.
    """

    def __init__(self, settings: SequencerSettings) -> None:
        self.settings = settings
        self.machine = RunMachine(
            Pacing(
                sample_rate=settings.sample_rate,
                block_samples=settings.block_samples,
                tick_blocks=settings.tick_blocks,
                lockstep=settings.pacing == "lockstep",
                quiet_ramp=settings.quiet_ramp,
                latency_blocks=settings.latency_blocks,
            ),
            settings.limits,
        )
        self.points: dict[int, ModalPoint] = {}
        self._published: tuple[Any, ...] = ()
        self._extracted = (0, 0)  # samples that extraction has taken and points that have come, as last looked at
        rate, block = settings.sample_rate, settings.block_samples
        lockstep = self.machine.pacing.lockstep
        self.judge = CommandJudge(
            block,
            horizon=round((LONGEST_AHEAD if lockstep else _LONGEST_BEFORE) * rate),
            most_missing=settings.latency_blocks if lockstep else round(_LONGEST_STALL * rate / block),
        )

    def plan(self, goal: Mapping[str, Any]) -> RunPlan:
        """The plan that a goal asks for; what the goal leaves at zero is taken from the parameters.

        Args:
            goal: fields of the goal of ``nmt_msgs/RunLevels``.

        Raises:
            BenchError: the goal is not acceptable.
        """
        settings = self.settings
        asked = RunSettings.of_goal(goal)
        chosen = {
            "run_id": asked.run_id or time.strftime("run-%Y%m%d-%H%M%S"),
            "ramp": asked.ramp or settings.ramp,
            "window_periods": asked.window_periods or settings.window_periods,
            "timeout": asked.timeout or settings.timeout,
        }
        plan = RunPlan(**{**asked.values, **chosen}, open_loop_abort=settings.open_loop_abort)
        plan.check(settings.sample_rate, self.machine.limits)
        return plan

    def announcement(self, goal: str, plan: RunPlan) -> RunAnnouncement:
        """What the recorder gets of a plan before it begins; ``goal`` is the name of the goal."""
        described = {**plan.description, "pacing": self.settings.pacing}
        return RunAnnouncement(goal, plan.run_id, described)

    def join(self, next_sample: int) -> None:
        """Go on from where another plant stands, see :meth:`nmt_sequencer.run_machine.RunMachine.join`."""
        self.machine.join(next_sample)
        self.judge.release(max(next_sample - 1, 0))

    def start(self, plan: RunPlan) -> None:
        """Begin a plan.

        Raises:
            BenchError: a run is active.
        """
        self.points.clear()
        self.judge.release()
        self.machine.start(plan)

    def refuse(self, plan: RunPlan, code: ResultCode, reason: str) -> None:
        """End a run before its first level."""
        machine = self.machine
        machine.plan, machine.code, machine.reason = plan, code, reason
        machine.records.clear()
        machine.phase = RunPhase.DONE
        machine.end_sample = machine.newest + 1

    def take_status(self, status: LoopStatus, source: Hashable = "loop") -> str:
        """Take the state of the loop after a block.

        A state that is repeated or late acknowledges a level at most; a second source ends the run.

        Args:
            status: the state.
            source: who sent it, see `nmt_core.messages.command_judge.CommandJudge.judge`.

        Returns:
            Empty if the state is taken, otherwise the sentence why it cannot be meant.
        """
        last = self.judge.last
        why = self.judge.judge(
            source,
            based_on=status.last_sample if last is None or status.last_sample > last else None,
            values={"frequency_hz": status.frequency_hz, "drive_amplitude": status.drive_amplitude},
        )
        if self.judge.second_source and self.machine.active:
            reason = f"Topic frequency has a second publisher: {self.judge.second_source}."
            self.machine.stop(ResultCode.NODE_LOST, reason)
            if isinstance(source, CommandSource) and not source.alone:
                # Nothing heard can be believed any more; the plant ramps to zero when the run is over.
                self.machine.abandon(ResultCode.NODE_LOST, reason)
        if why:
            self.machine.work()
            return why
        self.machine.on_report(status)
        return ""

    def steer(self, request: SteeringRequest) -> str:
        """Take a request to steer the run; see :meth:`nmt_sequencer.run_machine.RunMachine.steer`.

        Returns:
            Empty, or the sentence why the run cannot be steered so.
        """
        return self.machine.steer(request)

    def acts(self) -> list[Steering]:
        """Acts of steering to be published now, in order, before the levels and the state that follow from them."""
        return self.machine.take_acts()

    def take_lock(self, lock: LockEvent) -> None:
        """Take a lock event."""
        self.machine.on_lock(lock.level_index, lock.sample, lock.window_end)

    def take_stop(self, stop: DriveStop) -> None:
        """Take a stop of the drive that the plant reports."""
        sentence = f"The drive was stopped at sample {stop.sample}: {stop.reason.rstrip('.')}."
        code = _STOPPED_BY.get(stop.cause)
        if code is not None:
            self.machine.stop(code, sentence)
        # Not at once: the sequencer may know better, as of a second publisher, once the blocks of the stop come.
        self.machine.plant_stop = (ResultCode.NODE_LOST, sentence) if stop.cause is StopCause.NODE else None

    def take_point(self, point: ModalPoint) -> None:
        """Take a modal point."""
        self.points[point.level_index] = point

    @property
    def missing_points(self) -> set[int]:
        """Levels whose modal point has not come yet."""
        machine = self.machine
        if machine.plan is not None and not machine.plan.kind.gives_modal_points:
            return set()
        return {record.index for record in machine.records if record.complete} - set(self.points)

    def moves(self, taken: int) -> bool:
        """Whether extraction has moved on in a run that is over, since the last call.

        Args:
            taken: samples that it has taken; those after the run, which a source in real time goes on to give, bring no
                point of it.
        """
        before = self._extracted
        self._extracted = min(taken, self.machine.end_sample), len(self.points)
        return self._extracted != before and self.machine.phase == RunPhase.DONE

    def account(self) -> None:
        """Close the account of a run that is over: it is not a success while locked levels lack their modal point."""
        machine, missing = self.machine, sorted(self.missing_points)
        if not missing:
            return
        if machine.code == ResultCode.SUCCEEDED:
            machine.code = ResultCode.POINTS_MISSING
        locked = sum(record.complete for record in machine.records)
        machine.reason = (
            f"{machine.reason} The modal points of {len(missing)} of {locked} locked levels did not come from "
            f"extraction: {level_list(missing)}."
        ).strip()

    def orders(self) -> list[LevelCommand]:
        """Levels to be published now, in order."""
        return self.machine.take_orders()

    def state(self) -> RunState | None:
        """The state of the run, None if it is the one returned last."""
        machine = self.machine
        plan = machine.plan
        count = len(plan.levels) if plan else 0
        key = (machine.phase, machine.horizon, machine.level_index, count, machine.code, machine.reason)
        if key == self._published:
            return None
        self._published = key
        newest = machine.end_sample - 1 if machine.phase == RunPhase.DONE else machine.newest
        sample = max(newest, 0)
        return RunState(
            run_id=plan.run_id if plan else "",
            phase=machine.phase,
            level_index=machine.level_index,
            level_count=count,
            level=machine.records[-1].amplitude if machine.records else 0.0,
            progress=float(machine.progress),
            sample=sample,
            horizon_sample=machine.horizon,
            result_code=machine.code,
            reason=machine.reason,
            time_ns=bench_time_ns(sample, machine.pacing.sample_rate),
        )
