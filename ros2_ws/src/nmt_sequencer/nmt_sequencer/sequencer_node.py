"""The sequencer node: action server ``run_levels``, level commands, run state and the guard over the other nodes."""

from __future__ import annotations

import os
import time
from typing import Any

from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.serialization import deserialize_message
from rclpy.task import Future
from std_msgs.msg import String
from std_srvs.srv import Trigger

from nmt_core.base_node import SAMPLES_QOS, STATE_QOS, BenchNode, spin_node
from nmt_core.errors import BenchError
from nmt_core.messages.command_judge import CommandSource
from nmt_core.messages.run_announcement import ANNOUNCEMENT_TOPIC, BAG_TOPIC, BagState, RunAnnouncement
from nmt_core.messages.wire import (
    DRIVE_STOP,
    LEVEL,
    LOCK_EVENT,
    MODAL_POINT,
    RUN_STATE,
    STEERING,
    NodeStatus,
    read_status,
)
from nmt_core.nodes.launcher_watch import LauncherWatch
from nmt_core.processes.output_record import drive_sentence
from nmt_core.processes.process_watch import ProcessWatch
from nmt_core.vocabulary import LoopState, ResultCode, RunPhase, SteeringAct
from nmt_msgs import msg
from nmt_msgs.action import RunLevels
from nmt_msgs.srv import Steer
from nmt_sequencer.level_plan import RunPlan
from nmt_sequencer.run_core import RunCore
from nmt_sequencer.sequencer_settings import SequencerSettings
from nmt_sequencer.steering import SteeringRequest

_GUARD_PERIOD = 0.1
_FEEDBACK_PERIOD = 0.1
_QUIET_TIMEOUT = 4.0
_STILL = 1.0  # s without a block after which it is looked at what a run in lockstep waits for
_TIMING = ("sample_rate", "block_samples")  # parameters that all nodes of a bench share
_STATUS_TOPIC = "run_levels/_action/status"  # a topic, and thus an owner, that every action server has
_LONGEST_END = 2.0  # s that the sequencer waits for the ramp to zero when it is asked to end


class SequencerNode(BenchNode):
    """Runs plans of levels, one at a time; every end is a ramp to zero.

    Args:
        settings: for launch-free use; ROS overrides win over them.
        **kwargs: forwarded to :class:`rclpy.node.Node`.
    """

    NEEDED = ("sample_rate", "block_samples", "watched_nodes")
    settings: SequencerSettings

    def __init__(self, settings: SequencerSettings | None = None, **kwargs: Any) -> None:
        super().__init__("sequencer", SequencerSettings, settings, **kwargs)
        self.core = RunCore(self.settings)
        self.machine = self.core.machine
        self._pending: tuple[Any, RunPlan, float] | None = None
        self._announced = RunAnnouncement()
        self._bag = BagState("", "closed")
        self._goal: Any = None
        self._finished: Future | None = None
        self._stopping_for = 0.0  # s since the end was asked for
        self._newest_wall = 0.0
        self._still_for = 0.0  # s in which this node was awake and bench time stood still
        self._guarded = time.monotonic()
        self._process = ProcessWatch(os.getpid()) if self.in_lockstep else None
        self._waited = 0.0  # s, for nodes to be ready or for modal points, in which all that live could have worked
        self._plant = ""
        self._plant_said: dict[str, str] | None = None
        self._plant_instance = self._joined = ""
        self._joined_publishers: set[bytes] = set()
        self._timing: dict[str, dict[str, str]] = {}
        self._phase = RunPhase.UNKNOWN
        self._last_feedback = 0.0

        self._level = self.bench_publisher(msg.Level, "level", SAMPLES_QOS)
        self._steering = self.bench_publisher(msg.Steering, "steering", SAMPLES_QOS)
        self._state = self.bench_publisher(msg.RunState, "run_state", STATE_QOS)
        self.command_subscription(msg.Frequency, "frequency", self._on_frequency, SAMPLES_QOS)
        self.bench_subscription(msg.LockEvent, "lock", self._on_lock, SAMPLES_QOS, raw=True)
        self.bench_subscription(msg.ModalPoint, "modal_point", self._on_point, SAMPLES_QOS, raw=True)
        self.create_subscription(msg.DriveStop, "drive_stop", self._on_stop, STATE_QOS, raw=True)
        if self.link is not None:
            self.link.take("drive_stop", self._on_stop)
            self.link.take("diagnostics", self._on_diagnostics)
        self._announcements = self.create_publisher(String, ANNOUNCEMENT_TOPIC, STATE_QOS)
        self.identity.claim(ANNOUNCEMENT_TOPIC)
        self.create_subscription(String, BAG_TOPIC, self._on_bag, STATE_QOS)
        self._server = ActionServer(
            self,
            RunLevels,
            "run_levels",
            execute_callback=self._execute,
            goal_callback=self._on_goal,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
        )
        self.identity.claim(_STATUS_TOPIC)
        for name, call in (("stop", self._stop), ("pause", self._pause), ("resume", self._resume)):
            self.bench_service(Trigger, name, call)
        self.bench_service(Steer, "steer", self._steer)
        self._refused = 0
        self._named_second = ""
        self._launcher = LauncherWatch()
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
        if self.count_publishers(self.resolve_topic_name(_STATUS_TOPIC)) > 1:
            self.get_logger().error(f"Goal refused: {self.second_publisher() or 'another server takes it, too'}.")
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
        self.get_logger().info(f"Goal accepted: run {plan.run_id} with {len(plan.levels)} levels")
        self._announce(self.core.announcement(bytes(goal_handle.goal_id.uuid).hex(), plan))
        self._waited = self._stopping_for = 0.0
        try:
            await self._finished
            return self._result(goal_handle)
        finally:
            self._goal = self._pending = None
            self._announce(RunAnnouncement())

    def _announce(self, announcement: RunAnnouncement) -> None:
        """Tell the recorder of a run that is about to begin, or that none is."""
        self._announced = announcement
        self._announcements.publish(String(data=announcement.to_json()))

    def _on_bag(self, message: Any) -> None:
        try:
            self._bag = BagState.from_json(message.data)
        except ValueError as error:
            self.get_logger().error(f"State of the bag refused: {error}", throttle_duration_sec=1.0)

    @property
    def _bag_is_open(self) -> bool:
        """Whether the recorder has opened a bag for the announced run, or none is asked for."""
        return not self.settings.recording or (self._bag.state == "open" and self._bag.goal == self._announced.goal)

    def _result(self, goal_handle: Any) -> Any:
        machine = self.machine
        result = RunLevels.Result()
        result.result_code = int(machine.code)
        result.message = machine.reason
        result.levels_locked = sum(record.complete for record in machine.records)
        result.levels_not_locked = len(machine.records) - result.levels_locked
        points = [self.core.points[index] for index in sorted(self.core.points)]
        result.missing_points = sorted(self.core.missing_points)
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
        missing = self.liveness.unready(time.monotonic())
        if self._joined:  # a run before: since then a node may have gone, and its last heartbeat is not old yet
            missing |= dict.fromkeys(self.liveness.unheard_since(since), "silent since the goal")
        own = self.transport.missing(self.expected_peers)
        second = self.second_publisher()
        recorded = self._bag_is_open
        if goal_handle.is_cancel_requested:
            self._refuse(plan, ResultCode.CANCELED, "Cancelled before the first level.")
        elif self.settings.recording and self._bag.state == "failed" and self._bag.goal == self._announced.goal:
            why = self._bag.reason.rstrip(".")
            self._refuse(plan, ResultCode.REFUSED, f"The run would not be recorded: {why}.")
        elif not missing and self._other_timing():
            self._refuse(plan, ResultCode.REFUSED, self._other_timing())
        elif not missing and not own and not second and recorded and self._join_plant():
            self._pending = None
            self.liveness.forget_failures(time.monotonic())
            self._named_second = ""
            self._still_for = self._waited = 0.0
            self.core.start(plan)
            self._publish_all()
        elif self._waited > self.settings.ready_timeout:
            what = [f"{name} ({state})" for name, state in missing.items()]
            what += [f"the peers of topic {topic}" for topic in own]
            what += [second] if second else []
            what += [] if recorded else ["no recorder has opened a bag for this run"]
            self._refuse(
                plan,
                ResultCode.NODE_LOST,
                f"Not ready within {self.settings.ready_timeout:g} s: {', '.join(what)}; start the missing "
                "nodes and end those that do not belong here.",
            )

    def _join_plant(self) -> bool:
        """Take the count of a plant that was started since the run before, or that was there before this node.

        False while the newest heartbeat is still that of the plant before.
        """
        found = self.get_publishers_info_by_topic(self.resolve_topic_name("drive_stop"))
        publishers = {bytes(info.endpoint_gid) for info in found}
        if self._plant_said is None or publishers <= self._joined_publishers:
            return True
        if self._plant_instance == self._joined:
            return False
        next_sample = int(self._plant_said.get("next_sample", "0"))
        if not self._joined:  # the loop's states may tell of later samples than the heartbeat
            next_sample = max(next_sample, self.machine.newest + 1)
        self._joined, self._joined_publishers = self._plant_instance, publishers
        self.core.join(next_sample)
        return True

    def _other_timing(self) -> str:
        """Which node works with other blocks than this one, as a sentence; empty where none says so."""
        own = {name: str(getattr(self.settings, name)) for name in _TIMING}
        for name, said in sorted(self._timing.items()):
            for key, text in said.items():
                if text != own[key]:
                    return (
                        f"Node {name} has {key} {text}, the sequencer {own[key]}: they would wait for each "
                        "other; start all nodes with the parameter file of one rig."
                    )
        return ""

    def _refuse(self, plan: RunPlan, code: ResultCode, reason: str) -> None:
        self._pending = None
        self.core.refuse(plan, code, reason)
        self._publish_state()
        self._finish()

    def _finish(self) -> None:
        if self._finished is not None and not self._finished.done():
            self._finished.set_result(True)

    # -- what comes in -------------------------------------------------------------------------------------------

    def _on_frequency(self, raw: bytes, source: CommandSource) -> None:
        try:
            status = read_status(raw)
        except ValueError as error:
            self.get_logger().error(f"Loop state refused: {error}", throttle_duration_sec=1.0)
            return
        if status.flags and self.machine.active:
            self._stop_for_failures()  # the plant may have said why it tripped
            self.identity.look_for_intruders()  # or somebody else has told it that the run is over
            self._stop_for_second()
        newest = self.machine.newest
        if status.state == LoopState.LOCK_LOST and status.reason:
            self.get_logger().info(f"Level {status.level_index + 1} lost its lock: {status.reason}")
        why = self.core.take_status(status, source)
        if why:
            self._refused += 1
            self.get_logger().error(f"Loop state refused: {why}", throttle_duration_sec=1.0)
        if self.machine.newest > newest:
            self._newest_wall = time.monotonic()
            self._still_for = 0.0
        self._publish_all()

    def _stop_for_failures(self) -> None:
        failed, words = self.liveness.first_failure()
        if failed:
            self.machine.stop(ResultCode.NODE_LOST, f"Node {failed} reports: {words.rstrip('.')}.")

    def _stop_for_second(self) -> None:
        second = self.second_publisher()
        if not second:
            return
        reason = f"{second[0].upper()}{second[1:]}."
        self.machine.stop(ResultCode.NODE_LOST, reason)  # as where another node has heard of it first
        if self._named_second != second:
            self._named_second = second
            self.get_logger().warning(f"The run ends: {reason}")

    def _on_lock(self, raw: bytes) -> None:
        try:
            lock = LOCK_EVENT.read(raw)
        except (BenchError, ValueError) as error:
            self.get_logger().error(f"Lock event refused: {error}", throttle_duration_sec=1.0)
            return
        # Noise has no frequency: its window begins when the response has settled.
        at = f"locked at {lock.frequency_hz:.6g} Hz" if lock.frequency_hz > 0.0 else "settled"
        self.get_logger().info(f"Level {lock.level_index + 1} {at}, sample {lock.sample}")
        self.core.take_lock(lock)
        self._publish_all()

    def _on_stop(self, raw: bytes) -> None:
        try:
            stop = DRIVE_STOP.read(raw)
        except ValueError as error:
            self.get_logger().error(f"Stop of the drive refused: {error}", throttle_duration_sec=1.0)
            return
        self.core.take_stop(stop)
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
        self.core.steer(SteeringRequest(SteeringAct.END, source="the stop service"))
        self._publish_all()
        return response

    def _pause(self, _: Any, response: Any) -> Any:
        return self._answer(response, SteeringRequest(SteeringAct.PAUSE, source="the pause service"), "paused")

    def _resume(self, _: Any, response: Any) -> Any:
        return self._answer(response, SteeringRequest(SteeringAct.RESUME, source="the resume service"), "going on")

    def _steer(self, request: Any, response: Any) -> Any:
        try:
            asked = SteeringRequest(
                SteeringAct(request.act),
                int(request.level_index),
                tuple(request.levels),
                tuple(request.frequencies_hz),
                int(request.at_sample),
                str(request.source) or "a program",
            )
        except (BenchError, ValueError) as error:
            response.success, response.message = False, str(error)
            return response
        return self._answer(response, asked, "taken; the topic steering says when it takes effect")

    def _answer(self, response: Any, request: SteeringRequest, done: str) -> Any:
        why = self.core.steer(request)
        response.success, response.message = not why, why or done
        self._publish_all()
        return response

    # -- what goes out -------------------------------------------------------------------------------------------

    def _publish_all(self) -> None:
        for act in self.core.acts():
            self._steering.publish(STEERING.write(act))
        for order in self.core.orders():
            self._level.publish(LEVEL.write(order))
            what = f"Level {order.index + 1}: {order.amplitude:g}" if order.amplitude else "Ramp to zero"
            self.get_logger().info(f"{what} from sample {order.apply_at_sample} on")
        self._publish_state()
        self._publish_feedback()

    def _publish_state(self) -> None:
        state = self.core.state()
        if state is not None:
            self._state.publish(RUN_STATE.write(state))
            if state.phase != self._phase:
                self._phase = state.phase
                why = f": {state.reason}" if state.reason else ""
                run = f"Run {state.run_id} is {state.phase.name.lower()}" if state.run_id else "No run yet"
                self.get_logger().info(f"{run}{why}")

    def _publish_feedback(self) -> None:
        now = time.monotonic()
        report = self.machine.report
        if self._goal is None or report is None or now - self._last_feedback < _FEEDBACK_PERIOD:
            return
        self._last_feedback = now
        feedback = RunLevels.Feedback()
        shown = self.machine.reported
        feedback.level_index = 0 if shown is None else shown.index
        feedback.level_count = len(self.machine.plan.levels) if self.machine.plan else 0
        feedback.level = 0.0 if shown is None else shown.amplitude
        feedback.state = report.state
        feedback.frequency_hz = report.frequency_hz
        feedback.phase_error = report.phase_error
        feedback.fraction_done = float(self.machine.progress)
        feedback.sample = self.machine.newest
        self._goal.publish_feedback(feedback)

    # -- the guard -----------------------------------------------------------------------------------------------

    def _guard(self) -> None:
        """Ten times a second of wall time: readiness, cancel requests, silent nodes, the end of the run."""
        now = time.monotonic()
        passed = self._passed(now)
        if self._pending is not None:
            self._waited += passed
        self._begin_when_ready()
        machine = self.machine
        if self._goal is not None and self._goal.is_cancel_requested and machine.active:
            machine.stop(ResultCode.CANCELED, "Cancelled by the client.")
        if machine.active:
            lost = self.liveness.first_lost(time.monotonic())
            if lost:
                machine.stop(ResultCode.NODE_LOST, f"{lost[0].upper()}{lost[1:]}.")
            self._stop_for_failures()
            for name in self.liveness.restarted(now):
                machine.stop(ResultCode.NODE_LOST, f"Node {name} was started again during the run.")
            unattended = "" if self.in_lockstep else self._launcher.complaint(now)
            if unattended:
                machine.stop(ResultCode.NODE_LOST, unattended)
            self._stop_for_second()
            self._stop_for_standstill(passed)
            if machine.phase == RunPhase.STOPPING or machine.stop_request is not None:
                # Who asks for the end does not wait for a node that is stopped.
                self._stopping_for += passed or (now - self._guarded if self._is_held_up(now) else 0.0)
                limit = _QUIET_TIMEOUT + (0.0 if self.in_lockstep else machine.pacing.quiet_ramp + 1.0)
                still = now - self._newest_wall
                gone = self.in_lockstep and bool(lost) and still > _STILL  # no block will come without that node
                if gone or (self._stopping_for > limit and still > _QUIET_TIMEOUT / 2):
                    code, reason = machine.stop_request or (machine.code, machine.reason)
                    machine.abandon(code, f"{reason} The loop no longer answers; {self._drive_sentence()}.")
            machine.work()
            self._publish_all()
        elif self._goal is not None and self._pending is None and machine.phase == RunPhase.DONE:
            # Extraction is waited for as long as it moves, or could not.
            self._waited += passed
            overdue = self._waited > self.settings.points_timeout
            # No sender is left.
            gone = bool(self.liveness.first_lost(time.monotonic()) or self.liveness.first_failure()[0])
            given_up = self._end_is_asked_for and self._is_held_up(now)
            if overdue or gone or given_up or not self.core.missing_points:
                self.core.account()
                self._publish_state()
                self._finish()
        self._guarded = now

    @property
    def _end_is_asked_for(self) -> bool:
        """Whether somebody has asked for the end of the run, who waits for no node that is stopped."""
        asked = self.machine.code in (ResultCode.CANCELED, ResultCode.STOPPED)
        return asked or bool(self._goal is not None and self._goal.is_cancel_requested)

    def _is_held_up(self, now: float) -> bool:
        """Whether a node that the run waits for is stopped or busy."""
        return bool(self.liveness.waited_for(now))

    def _passed(self, now: float) -> float:
        """Time since the last look that counts against nodes which do not answer, s.

        A machine that was suspended, or had no processor, has not waited for so long; and in lockstep no node waits for
        a node that is stopped or busy.
        """
        most = min(now - self._guarded, 2.0 * _GUARD_PERIOD)
        if self._process is None:
            return most
        if self.machine.phase == RunPhase.RUNNING and now - self._newest_wall < _STILL:
            return 0.0
        could = min(self._process.looked(now)[0], self.liveness.could_work(now))
        return 0.0 if self._is_held_up(now) else min(most, could)

    def _stop_for_standstill(self, passed: float) -> None:
        """End a run none of whose blocks is answered although every node is alive, as when messages are refused."""
        machine = self.machine
        if machine.phase != RunPhase.RUNNING:
            self._still_for = 0.0
            return
        self._still_for += passed
        limit = self.settings.stall_timeout
        if self._still_for <= limit:
            return
        refused = f" Refused last: {self.core.judge.latest}" if self.core.judge.latest else ""
        machine.stop(
            ResultCode.NODE_LOST,
            f"No block after sample {max(machine.newest, 0)} was answered for {limit:g} s; the logs of plant and pll "
            f"say what they refuse. If in doubt, end all nodes and start them again.{refused}",
        )

    def hear(self, status: NodeStatus) -> None:
        """Take a heartbeat, and what it says of timing and drive."""
        super().hear(status)
        if status.name not in self.watched_nodes:
            return
        said = {key: str(value) for key, value in status.values.items()}
        self._timing[status.name] = {key: said[key] for key in _TIMING if key in said}
        if "taken" in said and self.core.moves(int(said["taken"])) and self._pending is None:
            self._waited = 0.0
        if "drive_at_zero" in said:
            self._plant, self._plant_instance, self._plant_said = status.name, status.hardware_id, said

    def _drive_sentence(self) -> str:
        """What is known of the drive where the loop does not answer any more."""
        return drive_sentence(
            self._plant_said, self._plant not in self.liveness.lost(time.monotonic()), self.machine.pacing.lockstep
        )

    @property
    def is_at_work(self) -> bool:
        """Whether a run is under way."""
        return bool(self.machine.active)

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

    def told_to_end(self) -> None:
        """End an active run by its ramp to zero."""
        super().told_to_end()
        self.machine.stop(ResultCode.NODE_LOST, f"Node {self.get_name()} was told to end.")
        self._publish_all()

    def may_end(self, since: float) -> bool:
        """When no run is active; the plant takes the drive to zero by itself where the loop does not answer."""
        return not self.machine.active or since > _LONGEST_END

    def destroy_node(self) -> None:
        """Release the node; with a server of an action left, its participant would stay."""
        self._server.destroy()
        super().destroy_node()

    def shut_down(self) -> None:
        """Say that an active run is over: the plant takes the drive to zero then."""
        if self.machine.active:
            self.machine.abandon(ResultCode.NODE_LOST, f"Node {self.get_name()} was shut down.")
            self._publish_state()


def main(args: list[str] | None = None) -> int:
    """Entry point of ``ros2 run nmt_sequencer sequencer``."""
    return spin_node(SequencerNode, args)
