"""State machine of a run, free of ROS and of wall time: loop states and lock events in, levels and pacing out.

In lockstep every decision is taken at a tick, a fixed number of blocks, from what the loop reported up to that very
sample, and takes effect one tick ahead at the horizon that the plant may not cross. A level is published before the
horizon moves past its sample, and the horizon moves only when the loop has acknowledged the level. So the same plan on
the same rig gives the same samples, however the processes are scheduled.

Steering is decided at ticks as well, and each act is noted with the sample from which it counts. Acts that name their
sample give the same samples in every run; a run that is not steered knows nothing of it.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field, replace

from nmt_core.errors import BenchError
from nmt_core.messages.cdr import bench_time_ns
from nmt_core.messages.records import LevelCommand, LoopStatus, Steering
from nmt_core.vocabulary import BlockFlag, LoopState, ResultCode, RunPhase, SteeringAct
from nmt_sequencer.level_plan import NO_LIMITS, LevelLimits, RunPlan
from nmt_sequencer.schedule import Schedule, Steps, schedule_of
from nmt_sequencer.steering import PRESENT_LEVEL, SteeringRequest, with_repetition, with_rest

NO_HORIZON = 2**62
_TRIPPED = int(BlockFlag.LIMIT | BlockFlag.WATCHDOG | BlockFlag.STOP)
_STOPPED = int(BlockFlag.STOP)


@dataclass(frozen=True)
class Pacing:
    """Time base of the machine.

    Attributes:
        sample_rate: Hz.
        block_samples: samples a block.
        tick_blocks: blocks a tick.
        lockstep: the plant waits for the horizon.
        quiet_ramp: half-cosine to zero at the end, s.
        settle: bench time after that ramp before the run is done, s.
        latency_blocks: blocks a command takes to act.
    """

    sample_rate: float
    block_samples: int
    tick_blocks: int = 5
    lockstep: bool = True
    quiet_ramp: float = 0.5
    settle: float = 0.2
    latency_blocks: int = 0

    @property
    def tick(self) -> int:
        """Samples a tick."""
        return self.block_samples * max(self.tick_blocks, 2 + self.latency_blocks)

    def samples(self, seconds: float) -> int:
        """Whole blocks that cover a time, in samples."""
        blocks = -(-round(seconds * self.sample_rate) // self.block_samples)
        return blocks * self.block_samples


@dataclass
class LevelRecord:
    """Outcome of one level."""

    index: int
    amplitude: float
    started: int
    locked_at: int | None = None
    window_end: int | None = None
    ended: int | None = None
    complete: bool = False
    reason: str = ""


@dataclass
class RunMachine:
    """Works through a plan.

    Feed :meth:`on_report` and :meth:`on_lock`; after each call publish what :meth:`take_orders` returns and then the
    state. :attr:`horizon` is the first sample the plant may not produce yet. :attr:`plant_stop` says how a run ends
    when its blocks are flagged because the plant has taken the drive to zero, and its end was not asked for.
    """

    pacing: Pacing
    limits: LevelLimits = NO_LIMITS
    phase: RunPhase = RunPhase.IDLE
    plan: RunPlan | None = None
    code: ResultCode = ResultCode.UNKNOWN
    reason: str = ""
    horizon: int = 0
    newest: int = -1
    records: list[LevelRecord] = field(default_factory=list)
    report: LoopStatus | None = None
    end_sample: int = 0
    stop_request: tuple[ResultCode, str] | None = None
    plant_stop: tuple[ResultCode, str] | None = None
    _orders: list[LevelCommand] = field(default_factory=list)
    _sequence: int = 0
    _acknowledged: int = 0
    _unacknowledged: deque[LevelCommand] = field(default_factory=deque)
    _ticks: deque[LoopStatus] = field(default_factory=deque)
    _next_tick: int = 0
    _next_horizon: int = 0
    _quiet_at: int | None = None
    _lock_events: set[int] = field(default_factory=set)
    _loss_reasons: dict[int, str] = field(default_factory=dict)
    _unanswered: set[int] = field(default_factory=set)
    _steering: list[SteeringRequest] = field(default_factory=list)
    _end_request: SteeringRequest | None = None
    _acts: list[Steering] = field(default_factory=list)
    _act_count: int = 0
    _decided: int = 0
    _schedule: Schedule = field(default_factory=Schedule)

    @property
    def active(self) -> bool:
        """True from start until the drive is at zero."""
        return self.phase in (RunPhase.RUNNING, RunPhase.PAUSED, RunPhase.STOPPING)

    @property
    def level_index(self) -> int:
        """Index of the present level."""
        return self.records[-1].index if self.records else 0

    @property
    def reported(self) -> LevelRecord | None:
        """The level that the newest report is about: the one before while the order of the present one is on its way.

        None before the first level.
        """
        if not self.records:
            return None
        if self.report is None or len(self.records) == 1 or self._begun(self.report):
            return self.records[-1]
        return next(
            (record for record in reversed(self.records) if record.index == self.report.level_index), self.records[-1]
        )

    @property
    def progress(self) -> float:
        """Fraction of the plan done, 0..1."""
        if self.plan is None:
            return 0.0
        if self.phase == RunPhase.DONE and self.code == ResultCode.SUCCEEDED:
            return 1.0
        done = sum(record.complete or bool(record.reason) for record in self.records)
        share = 0.0
        current = self.records[-1] if self.records else None
        if current and not current.complete and current.locked_at is not None and current.window_end:
            share = (self.newest - current.locked_at) / max(1, current.window_end - current.locked_at)
        return min(1.0, (done + min(max(share, 0.0), 1.0)) / len(self.plan.levels))

    def start(self, plan: RunPlan) -> None:
        """Begin a plan.

        Raises:
            BenchError: a run is active.
        """
        if self.active:
            raise BenchError(f"A run is active ({self.plan.run_id if self.plan else ''}); stop it or wait for its end.")
        self.plan = plan
        self.phase = RunPhase.RUNNING
        self.code, self.reason = ResultCode.UNKNOWN, ""
        self.records.clear()
        self._lock_events.clear()
        self._loss_reasons.clear()
        self._unanswered.clear()
        self._ticks.clear()
        self._quiet_at = None
        self.stop_request = self.plant_stop = None
        self._steering.clear()
        self._end_request = None
        self._act_count = 0
        self._schedule = schedule_of(plan.kind, plan.levels, plan.control)
        tick = self.pacing.tick
        begin = self.horizon if self.pacing.lockstep else self.newest + 1
        self._next_tick = (begin // tick + 1) * tick
        self._next_horizon = begin + 2 * tick if self.pacing.lockstep else NO_HORIZON
        self._begin_level(begin + tick if self.pacing.lockstep else self._soon())
        self._advance_horizon()

    def join(self, next_sample: int) -> None:
        """Go on from where a plant stands that this machine has not driven yet: one of them was started again.

        Args:
            next_sample: the first one that the plant has not produced.

        Raises:
            BenchError: a run is active.
        """
        if self.active:
            raise BenchError("A run is active; its samples cannot be counted anew.")
        self.newest, self.report = next_sample - 1, None
        if self.pacing.lockstep:
            self.horizon = next_sample

    def stop(self, code: ResultCode, reason: str) -> None:
        """End the run early: the drive is ramped to zero at the next tick."""
        if self.active and self.phase != RunPhase.STOPPING and self.stop_request is None:
            self.stop_request = (code, reason)
            if self.phase == RunPhase.PAUSED:
                self.resume()

    def abandon(self, code: ResultCode, reason: str) -> None:
        """Declare the run over although the loop no longer answers."""
        if self.active:
            if self.code == ResultCode.UNKNOWN:
                self.code, self.reason = code, reason
            self._note_end(self.newest + 1, self.newest + 1)
            self.phase = RunPhase.DONE
            self.end_sample = self.newest + 1

    def steer(self, request: SteeringRequest) -> str:
        """Take a request to steer the run; what becomes of it is in :meth:`take_acts`.

        A pause without a sample, the end of a pause and the end of the run are taken at once, everything else at the
        tick that knows all samples before ``at_sample``; during a pause it waits. One tick begins one level at most:
        further acts wait for the next.

        Returns:
            Empty, or the sentence why the run cannot be steered so.
        """
        why = self._refusal(request)
        if why:
            return why
        if not request.at_sample:
            request = self._naming_the_level(request)
        now = self.newest + 1
        if request.act is SteeringAct.RESUME:
            self._note(request, now, now)
            self.resume()
        elif request.act is SteeringAct.PAUSE and not request.at_sample:
            self._note(request, now, now)
            self.pause()
        elif request.act is SteeringAct.END and not request.at_sample:
            self._end_request = request
            self.stop(ResultCode.STOPPED, f"Stopped by {request.source}.")
        else:
            self._steering.append(request)
            self._steering.sort(key=lambda item: item.at_sample)  # stable: in the order in which they came
        return ""

    def _naming_the_level(self, request: SteeringRequest) -> SteeringRequest:
        return replace(request, level_index=self.level_index) if request.level_index == PRESENT_LEVEL else request

    def _refusal(self, request: SteeringRequest) -> str:
        """Why a request cannot be taken now; empty if it can."""
        plan, present = self.plan, self.level_index
        if plan is None or not self.active:
            return "no run is active"
        if self.phase == RunPhase.STOPPING or self.stop_request is not None:
            return "the run is ending"
        if request.act is SteeringAct.RESUME and self.phase != RunPhase.PAUSED:
            return "nothing is paused"
        if request.act is SteeringAct.PAUSE and self.phase == RunPhase.PAUSED:
            return "the run is paused already"
        if not request.at_sample:  # else it may be right by then
            why = self._wrong_level(request, present)
            if why:
                return why
        try:
            self._steered_plan(request, present)
        except BenchError as error:
            return str(error)
        return ""

    @staticmethod
    def _wrong_level(request: SteeringRequest, present: int) -> str:
        """Why the level that a request names cannot be meant while another is the present one; empty if it can."""
        level = request.level_index
        if request.act is SteeringAct.SKIP_LEVEL and level not in (PRESENT_LEVEL, present):
            return f"level {level + 1} is not the present one, which is {present + 1}"
        if request.act is SteeringAct.REPEAT_LEVEL and level != PRESENT_LEVEL and level > present:
            return f"level {level + 1} has not begun; the present one is {present + 1}"
        return ""

    def _steered_plan(self, request: SteeringRequest, index: int) -> RunPlan:
        """What a request makes of the plan while a level is the present one; BenchError if it cannot be done."""
        plan = self.plan
        assert plan is not None
        if request.act is SteeringAct.CHANGE_LEVELS:
            plan = with_rest(plan, index, request.levels, request.frequencies_hz)
        elif request.act is SteeringAct.REPEAT_LEVEL:
            plan = with_repetition(plan, index, min(request.level_index, index))
        plan.check(self.pacing.sample_rate, self.limits)
        return plan

    def take_acts(self) -> list[Steering]:
        """Acts of steering to be published now, in order, before the orders that follow from them."""
        acts, self._acts = self._acts, []
        return acts

    def _note(self, request: SteeringRequest, sample: int, apply_at_sample: int, refused: str = "") -> None:
        plan = self.plan
        assert plan is not None
        self._act_count += 1
        rate = self.pacing.sample_rate
        self._acts.append(
            Steering(
                self._act_count,
                plan.run_id,
                request.act,
                min(request.level_index, 2**32 - 1),
                max(sample, 0),
                max(apply_at_sample, 0),
                not refused,
                tuple(float(level) for level in plan.levels),
                tuple(float(frequency) for frequency in plan.frequencies_hz),
                request.source,
                refused,
                bench_time_ns(max(sample, 0), rate),
            )
        )

    def _note_end(self, sample: int, apply_at_sample: int) -> None:
        """Note the end that was asked for, and what has come too late."""
        if self._end_request is not None:
            self._note(self._end_request, sample, apply_at_sample)
            self._end_request = None
        for request in self._steering:
            self._note(request, sample, sample, "the run is ending")
        self._steering.clear()

    def _due(self, end: int) -> bool:
        return bool(self._steering) and self._steering[0].at_sample <= end

    def _steer(self, end: int, effective: int) -> bool:
        """Decide what is due; True if the present level or the run is over by it."""
        while self._due(end) and self._steering[0].act is not SteeringAct.PAUSE:
            request = self._naming_the_level(self._steering.pop(0))
            record = self.records[-1]
            if request.act is SteeringAct.END:
                record.ended = end - 1
                self._end_request = request
                self._quiet(effective, ResultCode.STOPPED, f"Stopped by {request.source}.")
                return True
            why = self._wrong_level(request, record.index)
            if why:
                self._note(request, end, end, why)
                continue
            try:
                self.plan = self._steered_plan(request, record.index)
            except BenchError as error:
                self._note(request, end, end, str(error))
                continue
            self._note(request, end, effective)
            if request.act is SteeringAct.CHANGE_LEVELS or request.level_index != record.index:
                continue
            record.ended = end - 1
            if self._window_over(record, end):
                record.complete = True
            else:
                again = request.act is SteeringAct.REPEAT_LEVEL
                record.reason = f"{'started over' if again else 'skipped'} by {request.source}"
            self._next_level(effective)
            return True
        return False

    @staticmethod
    def _window_over(record: LevelRecord, end: int) -> bool:
        return record.window_end is not None and end >= record.window_end

    def pause(self) -> bool:
        """Hold the present level; in lockstep bench time stands still. False if no run can be paused."""
        if self.phase != RunPhase.RUNNING:
            return False
        self.phase = RunPhase.PAUSED
        return True

    def resume(self) -> bool:
        """Go on after a pause. False if nothing is paused."""
        if self.phase != RunPhase.PAUSED:
            return False
        self.phase = RunPhase.RUNNING
        self.work()
        return True

    def on_report(self, report: LoopStatus) -> None:
        """Take in the loop's state after a block."""
        if report.level_sequence > self._acknowledged:
            self._acknowledged = report.level_sequence
            while self._unacknowledged and self._unacknowledged[0].sequence <= report.level_sequence:
                self._unacknowledged.popleft()
        if report.state == LoopState.LOCK_LOST and report.reason:
            self._loss_reasons[report.level_index] = report.reason
        if self.phase == RunPhase.STOPPING and report.state == LoopState.FIXED and report.reason:
            self._note_ending(report)
        if report.state in (LoopState.ACQUIRING, LoopState.LOCKED):
            # The phase is not a number where force or response is missing.
            (self._unanswered.add if math.isnan(report.phase_error) else self._unanswered.discard)(report.level_index)
        if report.last_sample > self.newest:
            if report.state == LoopState.LOCKED:
                self._schedule.hear(report)
            self.newest = report.last_sample
            self.report = report
            if self.phase == RunPhase.PAUSED and report.flags & _TRIPPED:
                self.phase = RunPhase.RUNNING
            if self.active and report.last_sample + 1 >= self._next_tick:
                if self.phase == RunPhase.PAUSED and not self.pacing.lockstep:
                    self._ticks.clear()  # bench time goes on; what is old is not decided later
                self._ticks.append(report)
                self._next_tick = ((report.last_sample + 1) // self.pacing.tick + 1) * self.pacing.tick
        self.work()

    def on_lock(self, level_index: int, sample: int, window_end: int) -> None:
        """Take in a lock event: its sample and the sample after its window.

        Events that cannot be of the present level (another index, a sample before its start, an empty window) are
        not taken.
        """
        record = self.records[-1] if self.records else None
        if record is None or record.index != level_index or not record.started <= sample < window_end:
            return
        self._lock_events.add(level_index)
        record.locked_at, record.window_end = sample, window_end
        self.work()

    def take_orders(self) -> list[LevelCommand]:
        """Levels to be published now, in order."""
        orders, self._orders = self._orders, []
        return orders

    def _soon(self) -> int:
        return self.newest + 1 + (1 + self.pacing.latency_blocks) * self.pacing.block_samples

    def work(self) -> None:
        """Take the decisions that are due; called by the methods that feed the machine."""
        while self._ticks and self.active:
            if self.phase == RunPhase.PAUSED:
                return
            report = self._ticks[0]
            if self._due(report.last_sample + 1) and self._steering[0].act is SteeringAct.PAUSE:
                self._note(self._steering.pop(0), report.last_sample + 1, report.last_sample + 1)
                self.pause()
                return
            if report.state == LoopState.LOCKED and self._begun(report) and report.level_index not in self._lock_events:
                return  # the lock event is on its way; decide with it, not without
            self._ticks.popleft()
            end = self._decided = report.last_sample + 1
            if self.pacing.lockstep:
                self._next_horizon = (end // self.pacing.tick + 2) * self.pacing.tick
            self._decide(report, self._effective_from(end))
        if self.active:
            self._advance_horizon()

    def _begun(self, report: LoopStatus) -> bool:
        """Whether the report is about the present level: the loop has its order and has reached its sample.

        The index alone does not tell: a level of the run before may have had the same.
        """
        record = self.records[-1]
        return (
            report.level_index == record.index
            and report.level_sequence >= self._sequence
            and report.last_sample >= record.started
        )

    def _effective_from(self, end: int) -> int:
        if self.pacing.lockstep:
            return (end // self.pacing.tick + 1) * self.pacing.tick
        return max(self._soon(), end)

    def _advance_horizon(self) -> None:
        limit = self._unacknowledged[0].apply_at_sample if self._unacknowledged else NO_HORIZON
        self.horizon = max(self.horizon, min(self._next_horizon, limit))

    def _decide(self, report: LoopStatus, effective: int) -> None:
        plan = self.plan
        assert plan is not None
        if self.phase == RunPhase.STOPPING:
            if report.drive_amplitude > 0.0 and self._quiet_at is not None:  # the loop damps before its ramp
                ends = report.last_sample + 1 + self.pacing.samples(self.pacing.quiet_ramp + self.pacing.settle)
                self._quiet_at = max(self._quiet_at, ends)
            if self._quiet_at is not None and report.last_sample + 1 >= self._quiet_at:
                self.phase = RunPhase.DONE
                self._advance_horizon()
                self.end_sample = self.horizon if self.pacing.lockstep else self.newest + 1
            return
        record = self.records[-1]
        if report.flags & _TRIPPED:
            stopped = report.flags & _STOPPED
            asked = self.stop_request
            if asked is not None and (stopped or asked[0] == ResultCode.NODE_LOST):
                self._quiet(effective, *asked)  # why it tripped
                return
            if stopped:
                self._quiet(effective, ResultCode.STOPPED, "The drive was stopped at the plant.")
                return
            if self.plant_stop is not None and not report.flags & BlockFlag.LIMIT:
                record.reason = record.reason or self.plant_stop[1].rstrip(".")
                self._quiet(effective, *self.plant_stop)
                return
            tripped = "a safety limit" if report.flags & BlockFlag.LIMIT else "the drive watchdog"
            record.reason = record.reason or f"{tripped} has tripped"
            self._quiet(effective, ResultCode.LIMIT, f"Level {record.index + 1}: {record.reason}.")
            return
        if self.stop_request is not None:
            code, reason = self.stop_request
            record.ended = report.last_sample
            self._quiet(effective, code, reason)
            return
        if self._steer(report.last_sample + 1, effective):
            return
        if not self._begun(report):
            return
        if report.state == LoopState.LOCK_LOST:
            record.reason = self._loss_reasons.get(record.index, "lock was lost")
            record.ended = report.last_sample
            if plan.stop_on_lost_lock:
                why = f"Level {record.index + 1} did not hold lock: {record.reason}."
                self._quiet(effective, ResultCode.LOCK_LOST, why)
                return
            following = plan.levels[record.index + 1 : record.index + 2]
            is_open = plan.open_loop_abort and plan.kind.stops_without_answer
            if is_open and record.index in self._unanswered and following and following[0] > record.amplitude:
                why = (
                    f"Level {record.index + 1} had no force or no response ({record.reason}), so no higher level "
                    "follows; look at the sensors at the drive point and at their cables."
                )
                self._quiet(effective, ResultCode.LOCK_LOST, why)
                return
        elif self._window_over(record, report.last_sample + 1):
            record.complete = True
            record.ended = report.last_sample
        else:
            return
        self._put_in(record, report, effective)
        self._next_level(effective)

    def _put_in(self, record: LevelRecord, report: LoopStatus, effective: int) -> None:
        """Let the schedule say what follows a level that has ended; noted as any change of the plan."""
        plan, index = self.plan, record.index
        assert plan is not None
        done = Steps((record.amplitude,), plan.phases[index : index + 1])
        planned = Steps(plan.levels[index + 1 :], plan.phases[index + 1 :])
        steps = self._schedule.following(done, record.complete, planned, report)
        if steps is None:
            return
        request = SteeringRequest(SteeringAct.CHANGE_LEVELS, levels=steps.levels, source="the step control")
        self.plan = with_rest(plan, index, steps.levels, (), steps.phases)
        self._note(request, report.last_sample + 1, effective)

    def _next_level(self, effective: int) -> None:
        plan = self.plan
        assert plan is not None
        if self.records[-1].index + 1 < len(plan.levels):
            self._begin_level(effective)
        else:
            locked = sum(item.complete for item in self.records)
            self._quiet(effective, ResultCode.SUCCEEDED, f"{locked} of {len(plan.levels)} levels locked.")

    def _begin_level(self, effective: int) -> None:
        plan = self.plan
        assert plan is not None
        index = len(self.records)
        self.records.append(LevelRecord(index, plan.levels[index], effective))
        self._order(index, plan.levels[index], effective, plan.ramp, plan.window_periods, plan.timeout)

    def _note_ending(self, report: LoopStatus) -> None:
        """How the loop of a self-excited rig ended the motion belongs to the reason of the run's end."""
        if self.plan is not None and self.plan.kind.damps_at_end and "damp" in report.reason:
            self.reason = f"{self.reason.rstrip()} At the end {report.reason}."

    def _quiet(self, effective: int, code: ResultCode, reason: str) -> None:
        self.phase = RunPhase.STOPPING
        self.code, self.reason = code, reason
        self._note_end(self._decided, effective)
        self._order(self.level_index, 0.0, effective, self.pacing.quiet_ramp, 0, 0.0)
        self._quiet_at = effective + self.pacing.samples(self.pacing.quiet_ramp + self.pacing.settle)

    def _order(
        self, index: int, amplitude: float, effective: int, ramp: float, window_periods: int, timeout: float
    ) -> None:
        assert self.plan is not None
        self._sequence += 1
        plan = self.plan
        frequency = plan.frequencies_hz[index] if plan.frequencies_hz and amplitude > 0.0 else 0.0
        order = LevelCommand(
            self._sequence,
            index,
            float(amplitude),
            effective,
            float(ramp),
            plan.control,
            float(frequency),
            window_periods,
            float(timeout),
            **plan.kind.level_fields,
        )
        if plan.phases and amplitude > 0.0:
            phase = plan.phases[index]
            order = replace(order, **self._schedule.level_fields(amplitude, phase))
        if index in plan.levels_without:
            order = replace(order, harmonics_control=0)
        self._orders.append(order)
        if self.pacing.lockstep:
            self._unacknowledged.append(order)
