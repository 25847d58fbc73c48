"""One bench, one of each: whoever does the same work a second time is named, and nothing moves under two."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.action import ActionServer, GoalResponse
from rclpy.node import Node
from std_srvs.srv import Trigger
from tiers import with_quick

from nmt_bench.harness import Bench, Progress
from nmt_core.base_node import SAMPLES_QOS, STATE_QOS
from nmt_core.vocabulary import LoopState, ResultCode
from nmt_msgs.action import RunLevels
from nmt_msgs.msg import DriveStop, ModalPoint, RunState
from nmt_record.bag.bag_reader import Bag


class Stranger(Node):  # type: ignore[misc]
    """Does what a node of the bench does already."""

    def __init__(self, bench: Bench) -> None:
        super().__init__("stranger", context=bench.context, enable_rosout=False, start_parameter_services=False)
        self.server: ActionServer | None = None
        bench.add_node("stranger", self)

    def destroy_node(self) -> None:
        """A node does not destroy its action servers: this one would stay in the domain, whoever has it next."""
        if self.server is not None:
            self.server.destroy()
        super().destroy_node()

    def serve(self) -> None:
        self.server = ActionServer(
            self, RunLevels, "run_levels", lambda _: RunLevels.Result(), goal_callback=lambda _: GoalResponse.REJECT
        )

    def publish_states(self) -> None:
        publisher = self.create_publisher(RunState, "run_state", STATE_QOS)
        publisher.publish(RunState(phase=RunState.DONE))

    def publish_points(self) -> None:
        self.create_publisher(ModalPoint, "modal_point", SAMPLES_QOS)

    def publish_stops(self) -> None:
        self.create_publisher(DriveStop, "drive_stop", STATE_QOS)

    def serve_quiet(self) -> None:
        self.create_service(Trigger, "quiet", lambda _, response: response)

    def beat(self) -> None:
        publisher = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        status = DiagnosticStatus(name="extract", message="ready", hardware_id="another process")
        self.create_timer(0.1, lambda: publisher.publish(DiagnosticArray(status=[status])))


KINDS: dict[str, tuple[Callable[[Stranger], None], str]] = {
    "action server": (Stranger.serve, "topic run_levels/_action/status has several publishers"),
    "run state": (Stranger.publish_states, "topic run_state has several publishers"),
    "modal points": (Stranger.publish_points, "topic modal_point has several publishers"),
    "stops of the drive": (Stranger.publish_stops, "topic drive_stop has several publishers"),
    "service": (Stranger.serve_quiet, "service quiet has several servers"),
    "heartbeat": (Stranger.beat, "node extract is there twice: another process and "),
}


@pytest.mark.parametrize("kind", with_quick(KINDS, "run state", "heartbeat"))
def test_a_second_one_ends_the_run_by_a_ramp_and_is_named(kind: str, tmp_path: Path) -> None:
    intrude, sentence = KINDS[kind]
    with Bench("beam", [0.3] * 40, out=tmp_path / "out", window_periods=300) as bench:
        began: list[int] = []

        def disturb(progress: Progress) -> None:
            if progress.state == LoopState.LOCKED and not began:
                began.append(progress.sample)
                intrude(Stranger(bench))

        result = bench.run(disturb)
    assert began
    assert result.code == ResultCode.NODE_LOST
    assert sentence.lower() in result.message.lower()
    if kind != "heartbeat":
        assert "/stranger" in result.message
    assert result.bag is not None
    blocks = list(Bag.open(result.bag).blocks("voltage"))
    assert not blocks[-1].data.any()
    assert blocks[-1].end_sample < 40 * 150_000  # it did not go on to the end


@pytest.mark.parametrize("kind", with_quick(KINDS, "service"))
def test_no_run_begins_under_two(kind: str) -> None:
    intrude, sentence = KINDS[kind]
    with Bench("beam", [0.3], window_periods=10, node_values={"sequencer": {"ready_timeout": 1.0}}) as bench:
        bench.spin_until(bench.client.server_is_ready, 20.0, "the action server")
        stranger = Stranger(bench)
        intrude(stranger)
        bench.spin(0.5)
        if kind == "action server":
            goal = bench.client.send_goal(bench.plan.goal, None)
            bench.spin_until(goal.done, 20.0, "the answer")
            assert not goal.result().accepted
            assert sentence in bench.nodes["sequencer"].second_publisher()
            return
        result = bench.run()
    assert result.code == ResultCode.NODE_LOST
    assert sentence in result.message
    assert result.bench_time < 0.001
