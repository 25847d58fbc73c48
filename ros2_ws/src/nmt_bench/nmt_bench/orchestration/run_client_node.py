"""Action client of a run: sends its goal, hears what nodes say of themselves; part of the harness."""

from __future__ import annotations

import contextlib
import time
import uuid
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from typing import Any

from action_msgs.msg import GoalStatusArray
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.action import ActionClient
from rclpy.action.client import ClientGoalHandle
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import qos_profile_action_status_default
from std_msgs.msg import String
from unique_identifier_msgs.msg import UUID

from nmt_bench.orchestration.interrupts import terminate_as_interrupt
from nmt_bench.orchestration.stop_node import visitor_of
from nmt_core.base_node import STATE_QOS
from nmt_core.errors import BenchError
from nmt_core.messages.run_announcement import BAG_TOPIC, BagState
from nmt_core.messages.wire import RUN_STATE, read_diagnostics
from nmt_core.nodes.liveness import Liveness
from nmt_core.vocabulary import RunPhase
from nmt_msgs.action import RunLevels
from nmt_msgs.msg import RunState
from nmt_msgs.srv import Steer
from nmt_session.run_result import Progress

RESEND = 1.5
"""Seconds without an answer after which the goal, or the wish for its result, is sent again."""
_SILENCE = 3.0  # s without a heartbeat after which a node that runs as a process is lost in real time


class RunClient(Node):  # type: ignore[misc]
    """Action client and listener of the harness and of ``./nmt goal``."""

    def __init__(self, context: Context, nodes: Sequence[str], lockstep: bool, namespace: str = "") -> None:
        super().__init__(
            "bench_client", context=context, namespace=namespace, enable_rosout=False, start_parameter_services=False
        )
        self.action_client = ActionClient(self, RunLevels, "run_levels")
        self.steer = self.create_client(Steer, "steer")
        self.liveness = Liveness(nodes, _SILENCE, lockstep=lockstep)
        self.bag = BagState("", "open")
        self.run_is_over = False
        self.started: float | None = None
        self.last_progress: float | None = None
        self.newest_sample = -1
        self._known_goals: set[bytes] = set()
        self._counters: dict[str, dict[str, str]] = {}
        self.create_subscription(String, BAG_TOPIC, self._on_bag, STATE_QOS)
        self.create_subscription(RunState, "run_state", self._on_state, STATE_QOS, raw=True)
        self.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 50, raw=True)
        self.create_subscription(
            GoalStatusArray, "run_levels/_action/status", self._on_goals, qos_profile_action_status_default
        )

    def destroy_node(self) -> None:
        """Release the node; with a client of an action left, its participant would stay."""
        self.action_client.destroy()
        super().destroy_node()

    def server_is_ready(self) -> bool:
        """Whether the services and topics of the action are there, those of its answers included."""
        return bool(self.action_client.server_is_ready()) and self.count_publishers("run_levels/_action/status") > 0

    @staticmethod
    def new_goal_id() -> UUID:
        """A number that no other goal has."""
        return UUID(uuid=list(uuid.uuid4().bytes))

    def send_goal(
        self, goal: Mapping[str, Any], on_progress: Callable[[Progress], None] | None, goal_id: UUID | None = None
    ) -> Any:
        """Send the fields of a goal; returns the future of its handle."""

        def on_feedback(message: Any) -> None:
            if on_progress is not None:
                feedback = message.feedback
                on_progress(Progress(*(getattr(feedback, item.name) for item in fields(Progress))))

        return self.action_client.send_goal_async(
            RunLevels.Goal(**goal), feedback_callback=on_feedback, goal_uuid=goal_id or self.new_goal_id()
        )

    def begin(
        self,
        goal: Mapping[str, Any],
        on_progress: Callable[[Progress], None] | None,
        turn: Callable[[], None],
        patience: float,
        again: float = RESEND,
    ) -> Any:
        """Send a goal until it is answered; returns its handle, None without an answer.

        The server may answer before it has found the reader of its answers, which then never comes. A goal that is sent
        again keeps its name: a server that knows it refuses to begin it twice, and lists it in its status. That status
        may come later than the refusal, so only the first refusal is one of the plan; any answer of any attempt counts.

        Args:
            goal, on_progress: as of :meth:`send_goal`.
            turn: lets this node work for a moment; what it raises ends the wait.
            patience: s to wait for an answer.
            again: s without an answer after which the goal is sent again.
        """
        goal_id = self.new_goal_id()
        end = time.monotonic() + patience
        sent: list[Any] = []
        while time.monotonic() < end:
            sent.append(self.send_goal(goal, on_progress, goal_id))
            resend = min(time.monotonic() + again, end)
            while time.monotonic() < resend:
                answers = [future.result() for future in sent if future.done()]
                accepted = next((answer for answer in answers if answer.accepted), None)
                if accepted is not None:
                    return accepted
                if self.is_known(goal_id):
                    return self.handle_of(goal_id)
                if sent[0].done():
                    return sent[0].result()
                turn()
        return None

    def is_known(self, goal_id: UUID) -> bool:
        """Whether the server lists a goal, which it does from its acceptance on."""
        return bytes(goal_id.uuid) in self._known_goals

    def handle_of(self, goal_id: UUID) -> ClientGoalHandle:
        """Handle of a goal whose answer was lost."""
        return ClientGoalHandle(self.action_client, goal_id, RunLevels.Impl.SendGoalService.Response(accepted=True))

    def _on_goals(self, message: GoalStatusArray) -> None:
        self._known_goals.update(bytes(status.goal_info.goal_id.uuid) for status in message.status_list)

    def _on_bag(self, message: String) -> None:
        with contextlib.suppress(ValueError):
            self.bag = BagState.from_json(message.data)

    def _on_state(self, raw: bytes) -> None:
        try:
            state = RUN_STATE.read(raw)
        except ValueError:
            return
        now = time.monotonic()
        self.run_is_over = state.phase == RunPhase.DONE
        if state.phase == RunPhase.RUNNING:
            self.started = self.started or now
        if state.sample > self.newest_sample:
            self.newest_sample = state.sample
            self.last_progress = now

    def _on_diagnostics(self, raw: bytes) -> None:
        now = time.monotonic()
        with contextlib.suppress(ValueError):
            for status in read_diagnostics(raw):
                failed = status.level == DiagnosticStatus.ERROR
                self.liveness.hear(status.name, status.hardware_id, status.message, failed, now)
                self._counters[status.name] = {key: str(value) for key, value in status.values.items()}

    @property
    def recorded(self) -> tuple[str, str]:
        """Messages and bench time (s) in the bag, as the recorder says."""
        said = self._counters.get("recorder", {})
        return said.get("messages", ""), said.get("recorded_s", "0")

    @property
    def taken(self) -> int:
        """Samples that extraction has taken, as it says."""
        return int(self._counters.get("extract", {}).get("taken", "0"))

    @property
    def plant_said(self) -> dict[str, str]:
        """Values of the plant's heartbeat by name."""
        return self._counters.get("plant", {})

    @property
    def drive_is_at_zero(self) -> bool:
        """Whether the plant says so."""
        return self.plant_said.get("drive_at_zero") == "1"

    def remarks(self, pacing: str) -> list[str]:
        """Sentences on what the nodes counted."""
        plant, recorder = self.plant_said, self._counters.get("recorder", {})
        lines = []
        if recorder:
            lines.append(
                f"Recorded {recorder.get('messages', '?')} messages; gaps {recorder.get('gaps', '?')}, missing samples "
                f"{recorder.get('missing_samples', '?')}."
            )
        if pacing == "realtime" and "jitter_p50_ms" in plant:
            lines.append(
                f"Real time: blocks late by {plant['jitter_p50_ms']} ms (median), {plant['jitter_p99_ms']} ms (99 %), "
                f"{plant['jitter_max_ms']} ms (worst); {plant['overruns']} by more than a block and a turn of the "
                f"converter; margin {100 * float(plant['real_time_margin']):.1f} % of the block time is left."
            )
        if "converter_delay" in plant:
            stated = plant.get("converter_stated", "-1")
            said = "" if stated.startswith("-") else f" (the driver says {stated})"
            clock = plant["converter_clock_ppm"]  # nan where the run was too short to tell
            lines.append(
                f"Converter: round trip {plant['converter_round_trip']} samples{said}, moved by "
                f"{plant['converter_drift']}; {'' if clock == 'nan' else f'clock {clock} ppm; '}samples lost in "
                f"{plant['converter_lost_turns']} turns; priority: converter {plant['converter_priority']}, plant "
                f"{plant['plant_priority']}; lateness {plant.get('lateness_histogram', 'not counted')}."
            )
        if plant.get("warnings"):
            lines.append(f"Warnings: {plant['warnings']}.")
        if plant.get("tripped"):
            lines.append(f"Plant: {plant['tripped']}.")
        return lines


def run_with_bench(
    domain: int, namespace: str, goal: Mapping[str, Any], on_progress: Callable[[Progress], None], patience: float
) -> tuple[Any, bool]:
    """Run a goal on the nodes of a domain, which somebody else has started.

    Args:
        domain: ROS domain.
        namespace: of the nodes.
        goal: fields of the goal.
        on_progress: called with each feedback.
        patience: s to wait for the sequencer, and for its answer.

    Returns:
        The action's result, and whether Ctrl-C came, by which the drive goes to zero.

    Raises:
        BenchError: a field that no goal has, no sequencer that answers, or one that refuses.
    """
    try:
        RunLevels.Goal(**goal)
    except (AssertionError, TypeError, ValueError) as error:
        raise BenchError(f"The plan is not a goal of a run ({error}); write it anew with './nmt params'.") from error
    with visitor_of(domain) as context, terminate_as_interrupt():
        client = RunClient(context, (), lockstep=False, namespace=namespace)
        executor = SingleThreadedExecutor(context=context)
        executor.add_node(client)

        def turn() -> None:
            executor.spin_once(timeout_sec=0.1)

        try:
            end = time.monotonic() + patience
            while not client.server_is_ready() and time.monotonic() < end:
                turn()
            handle = client.begin(goal, on_progress, turn, patience) if client.server_is_ready() else None
            if handle is None:
                bench = f"ROS domain {domain}" + (f" under {namespace}" if namespace else "")
                raise BenchError(
                    f"No sequencer answers in {bench}; start the nodes that './nmt params' prints, then send the goal "
                    "again."
                )
            if not handle.accepted:
                raise BenchError("The sequencer refused the plan; its terminal says why.")
            future, interrupted = handle.get_result_async(), False
            while not future.done():
                try:
                    turn()
                except KeyboardInterrupt:
                    if interrupted:
                        raise
                    interrupted = True
                    handle.cancel_goal_async()
            return future.result().result, interrupted
        finally:
            executor.shutdown()
            client.destroy_node()
