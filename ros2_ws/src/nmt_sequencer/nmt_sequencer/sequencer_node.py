"""The sequencer node: action server ``run_levels``, level commands, run state and the guard over the other nodes."""

from __future__ import annotations

import time
from typing import Any

from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.serialization import deserialize_message
from rclpy.task import Future
from std_srvs.srv import Trigger

from nmt_core.base_node import SAMPLES_QOS, STATE_QOS, BenchNode, spin_node
from nmt_core.command_judge import Source
from nmt_core.errors import BenchError
from nmt_core.vocabulary import ResultCode, RunPhase
from nmt_core.wire import LEVEL, LOCK_EVENT, MODAL_POINT, RUN_STATE, read_status
from nmt_msgs import msg
from nmt_msgs.action import RunLevels
from nmt_sequencer.run_core import PARAMETERS, RunCore
from nmt_sequencer.run_machine import RunPlan

_GUARD_PERIOD = 0.1
_FEEDBACK_PERIOD = 0.1
_QUIET_TIMEOUT = 4.0


class SequencerNode(BenchNode):
    """Runs plans of levels, one at a time; every end is a ramp to zero.

    Args:
        values: parameter values for launch-free use; see ``PARAMETERS``.
        **kwargs: forwarded to :class:`rclpy.node.Node`.
    """

    NEEDED = ("sample_rate", "block_samples", "watched_nodes")

    def __init__(self, values: dict[str, Any] | None = None, **kwargs: Any) -> None:
        super().__init__("sequencer", PARAMETERS, values, **kwargs)
        self.core = RunCore(self.values)
        self.machine = self.core.machine
        self._pending: tuple[Any, RunPlan, float] | None = None
        self._goal: Any = None
        self._finished: Future | None = None
        self._done_since: float | None = None
        self._stopping_since: float | None = None
        self._newest_wall = 0.0
        self._last_feedback = 0.0

        self._level = self.bench_publisher(msg.Level, "level", SAMPLES_QOS)
        self._state = self.bench_publisher(msg.RunState, "run_state", STATE_QOS)
        self.command_subscription(msg.Frequency, "frequency", self._on_frequency, SAMPLES_QOS)
        self.bench_subscription(msg.LockEvent, "lock", self._on_lock, SAMPLES_QOS, raw=True)
        self.bench_subscription(msg.ModalPoint, "modal_point", self._on_point, SAMPLES_QOS, raw=True)
        self._server = ActionServer(
            self,
            RunLevels,
            "run_levels",
            execute_callback=self._execute,
            goal_callback=self._on_goal,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
        )
        for name, call in (("stop", self._stop), ("pause", self._pause), ("resume", self._resume)):
            self.create_service(Trigger, name, call)
        self._refused = 0
        self._told = ""
        self.steady_timer(_GUARD_PERIOD, self._guard)
        self._publish_state()

    # -- goals ---------------------------------------------------------------------------------------------------

    def _plan(self, goal: Any) -> RunPlan:
        return self.core.plan({name: getattr(goal, name) for name in goal.get_fields_and_field_types()})

    def _on_goal(self, goal: Any) -> GoalResponse:
        try:
            self._plan(goal)
        except BenchError as error:
            self.get_logger().error(f"Goal refused: {error}")
            return GoalResponse.REJECT
        if self._goal is not None or self.machine.active:
            self.get_logger().error("Goal refused: a run is active; stop it or wait for its end.")
            return GoalResponse.REJECT
        return GoalResponse.ACCEPT

    async def _execute(self, goal_handle: Any) -> Any:
        self._goal = goal_handle
        self.core.points.clear()
        self._finished = Future()
        plan = self._plan(goal_handle.request)
        self._pending = (goal_handle, plan, time.monotonic())
        self._done_since = self._stopping_since = None
        try:
            await self._finished
            return self._result(goal_handle)
        finally:
            self._goal = self._pending = None

    def _result(self, goal_handle: Any) -> Any:
        machine = self.machine
        result = RunLevels.Result()
        result.result_code = int(machine.code)
        result.message = machine.reason
        result.levels_locked = sum(record.complete for record in machine.records)
        result.levels_not_locked = len(machine.records) - result.levels_locked
        points = [self.core.points[index] for index in sorted(self.core.points)]
        result.points = [deserialize_message(MODAL_POINT.write(point), msg.ModalPoint) for point in points]
        if machine.code == ResultCode.SUCCEEDED:
            goal_handle.succeed()
        elif goal_handle.is_cancel_requested:
            goal_handle.canceled()
        else:
            goal_handle.abort()
        return result

    def _begin_when_ready(self) -> None:
        if self._pending is None:
            return
        goal_handle, plan, since = self._pending
        missing = self.unready_nodes()
        own = self.missing_peers()
        second = self.second_publisher()
        if goal_handle.is_cancel_requested:
            self._refuse(plan, ResultCode.CANCELED, "Cancelled before the first level.")
        elif not missing and not own and not second:
            self._pending = None
            self.forget_failures()
            self._told = ""
            self.core.start(plan)
            self._publish_all()
        elif time.monotonic() - since > float(self.values["ready_timeout"]):
            what = [f"{name} ({state})" for name, state in missing.items()]
            what += [f"the peers of topic {topic}" for topic in own]
            what += [second] if second else []
            self._refuse(
                plan,
                ResultCode.NODE_LOST,
                f"Not ready within {self.values['ready_timeout']:g} s: {', '.join(what)}; start the missing "
                "nodes and end those that do not belong here.",
            )

    def _refuse(self, plan: RunPlan, code: ResultCode, reason: str) -> None:
        self._pending = None
        self.core.refuse(plan, code, reason)
        self._publish_state()
        self._finish()

    def _finish(self) -> None:
        if self._finished is not None and not self._finished.done():
            self._finished.set_result(True)

    # -- what comes in -------------------------------------------------------------------------------------------

    def _on_frequency(self, raw: bytes, source: Source) -> None:
        try:
            status = read_status(raw)
        except ValueError as error:
            self.get_logger().error(f"Loop state refused: {error}", throttle_duration_sec=1.0)
            return
        if status.flags and self.machine.active:
            self._stop_for_failures()  # the plant may have said why it tripped
        newest = self.machine.newest
        why = self.core.take_status(status, source)
        if why:
            self._refused += 1
            self.get_logger().error(f"Loop state refused: {why}", throttle_duration_sec=1.0)
        if self.machine.newest > newest:
            self._newest_wall = time.monotonic()
        self._publish_all()

    def _stop_for_failures(self) -> None:
        failed, words = self.failed_node()
        if failed:
            self.machine.stop(ResultCode.NODE_LOST, f"Node {failed} reports: {words.rstrip('.')}.")

    def _on_lock(self, raw: bytes) -> None:
        try:
            lock = LOCK_EVENT.read(raw)
        except (BenchError, ValueError) as error:
            self.get_logger().error(f"Lock event refused: {error}", throttle_duration_sec=1.0)
            return
        self.core.take_lock(lock)
        self._publish_all()

    def _on_point(self, raw: bytes) -> None:
        try:
            self.core.take_point(MODAL_POINT.read(raw))
        except ValueError as error:
            self.get_logger().error(f"Modal point refused: {error}", throttle_duration_sec=1.0)

    def _stop(self, _: Any, response: Any) -> Any:
        response.success = self.machine.active or self._pending is not None
        response.message = "ramping to zero" if response.success else "no run is active"
        if self._pending is not None:
            self._refuse(self._pending[1], ResultCode.STOPPED, "Stopped before the first level.")
        self.machine.stop(ResultCode.STOPPED, "Stopped by the stop service.")
        self._publish_all()
        return response

    def _pause(self, _: Any, response: Any) -> Any:
        response.success = self.machine.pause()
        response.message = "paused" if response.success else "no run can be paused"
        self._publish_all()
        return response

    def _resume(self, _: Any, response: Any) -> Any:
        response.success = self.machine.resume()
        response.message = "going on" if response.success else "nothing is paused"
        self._publish_all()
        return response

    # -- what goes out -------------------------------------------------------------------------------------------

    def _publish_all(self) -> None:
        for order in self.core.orders():
            self._level.publish(LEVEL.write(order))
        self._publish_state()
        self._publish_feedback()

    def _publish_state(self) -> None:
        state = self.core.state()
        if state is not None:
            self._state.publish(RUN_STATE.write(state))

    def _publish_feedback(self) -> None:
        now = time.monotonic()
        report = self.machine.report
        if self._goal is None or report is None or now - self._last_feedback < _FEEDBACK_PERIOD:
            return
        self._last_feedback = now
        feedback = RunLevels.Feedback()
        feedback.level_index = self.machine.level_index
        feedback.level_count = len(self.machine.plan.levels) if self.machine.plan else 0
        feedback.level = self.machine.records[-1].amplitude if self.machine.records else 0.0
        feedback.state = report.state
        feedback.frequency_hz = report.frequency_hz
        feedback.phase_error = report.phase_error
        feedback.fraction_done = float(self.machine.progress)
        feedback.sample = self.machine.newest
        self._goal.publish_feedback(feedback)

    # -- the guard -----------------------------------------------------------------------------------------------

    def _guard(self) -> None:
        """Ten times a second of wall time: readiness, cancel requests, silent nodes, the end of the run."""
        self._begin_when_ready()
        machine = self.machine
        now = time.monotonic()
        if self._goal is not None and self._goal.is_cancel_requested and machine.active:
            machine.stop(ResultCode.CANCELED, "Cancelled by the client.")
        if machine.active:
            silent = self.silent_node()
            if silent:
                machine.stop(ResultCode.NODE_LOST, f"Node {silent} has fallen silent.")
            self._stop_for_failures()
            second = self.second_publisher()
            if second:
                reason = f"{second[0].upper()}{second[1:]}."
                machine.stop(ResultCode.REFUSED, reason)
                if self._told != second:
                    self._told = second
                    self.get_logger().warning(f"The run ends: {reason}")
            if machine.phase == RunPhase.STOPPING or machine.stop_request is not None:
                self._stopping_since = self._stopping_since or now
                limit = _QUIET_TIMEOUT + (0.0 if machine.pacing.lockstep else machine.pacing.quiet_ramp + 1.0)
                if now - self._stopping_since > limit and now - self._newest_wall > _QUIET_TIMEOUT / 2:
                    code, reason = machine.stop_request or (machine.code, machine.reason)
                    why = f"{reason} The loop no longer answers; the plant's watchdog quiets the drive."
                    machine.abandon(code, why)
            machine.work()
            self._publish_all()
        elif self._goal is not None and self._pending is None and machine.phase == RunPhase.DONE:
            self._done_since = self._done_since or now
            overdue = now - self._done_since > float(self.values["points_timeout"])
            if overdue or not self.core.missing_points:
                self._finish()

    def update_counters(self) -> None:
        """Counters for the heartbeat."""
        records = self.machine.records
        self.counters.update(
            phase=self.machine.phase.name,
            levels_locked=sum(record.complete for record in records),
            levels_not_locked=sum(bool(record.reason) for record in records),
            refused=self._refused,
            **{f"frequency_{key}": value for key, value in self.core.judge.counts.items()},
        )

    def shut_down(self) -> None:
        """End an active run: the loop is told to go to zero before the node goes."""
        if self.machine.active:
            self.machine.stop(ResultCode.STOPPED, "The sequencer was shut down.")
            self.machine.abandon(ResultCode.STOPPED, "The sequencer was shut down.")


def main(args: list[str] | None = None) -> int:
    """Entry point of ``ros2 run nmt_sequencer sequencer``."""
    return spin_node(SequencerNode, args)
