"""Two benches in two namespaces on one domain: the death of a node of one ends that one and no other."""

from __future__ import annotations

import importlib
from pathlib import Path

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.action import ActionClient
from rclpy.context import Context
from rclpy.node import Node
from tiers import with_quick

from nmt_bench.harness import Bench, Progress
from nmt_core.errors import BenchError
from nmt_core.nodes.liveness import HUNG
from nmt_core.nodes.node_settings import NodeSettings
from nmt_core.vocabulary import LoopState, ResultCode
from nmt_msgs.action import RunLevels
from nmt_pll.pll_node import PllNode
from nmt_record.bag.bag_reader import Bag
from nmt_session import plan_test
from nmt_session.node_plan import NODES, plan_nodes

NAMESPACE = "second"


def make_node(bench: Bench, name: str, settings: NodeSettings | None) -> Node:
    module, _, attribute = NODES[name][2].partition(":")
    node: Node = getattr(importlib.import_module(module), attribute)(
        settings, context=bench.context, namespace=NAMESPACE
    )
    return node


@pytest.mark.parametrize("name", with_quick(NODES, "pll"))
def test_a_node_that_hangs_ends_its_own_bench_only(name: str, tmp_path: Path) -> None:
    with Bench("beam", [0.3] * 20, out=tmp_path / "first", window_periods=300) as bench:
        test = plan_test("beam", [0.2, 0.3], window_periods=60, run_id="second")
        (tmp_path / "rig.yaml").write_text(test.rig_yaml, encoding="utf-8")
        plan = plan_nodes(test, tmp_path / "second", tmp_path / "rig.yaml")
        for other in NODES:
            bench.add_node(f"{NAMESPACE}/{other}", make_node(bench, other, plan.settings[other]))
        caller = Node("caller", context=bench.context, namespace=NAMESPACE, enable_rosout=False)
        bench.add_node("caller", caller)
        client = ActionClient(caller, RunLevels, "run_levels")
        bench.spin_until(client.server_is_ready, 20.0, "the second bench")
        handle = bench.wait_for(client.send_goal_async(RunLevels.Goal(**plan.goal)), 20.0, "its answer")
        second = handle.get_result_async()
        hung: list[int] = []

        def hang(progress: Progress) -> None:
            if progress.state == LoopState.LOCKED and not hung:
                hung.append(progress.sample)
                node = bench.nodes[name]
                node.beat_timer.cancel()
                node.publish_diagnostics(DiagnosticStatus.ERROR, f"{HUNG}: nothing has been done for 61 s")

        first = bench.run(hang)
        assert hung
        bench.spin_until(second.done, 60.0, "the end of the second run")
        assert first.code == ResultCode.NODE_LOST
        assert f"ode {name} hangs" in first.message or f"ode {name} reports: hung" in first.message
        answer = second.result().result
        assert (answer.result_code, answer.levels_locked) == (ResultCode.SUCCEEDED, 2)
        assert len(answer.points) == 2
        recorder = bench.nodes[f"{NAMESPACE}/recorder"]
        bench.spin_until(lambda: recorder.writer.state == "closed", 20.0, "the second bag")
    assert not list(Bag.open(tmp_path / "first" / "bag").blocks("voltage"))[-1].data.any()
    ended = set(Bag.open(tmp_path / "first" / "bag").topics) - {"drive_stop"}  # of a plant that stopped the drive
    assert set(Bag.open(tmp_path / "second").topics) == ended


@pytest.mark.parametrize(
    ("name", "needed"), [("pll", "sample_rate"), ("sequencer", "sample_rate"), ("extract", "linear_json")]
)
def test_a_node_without_its_parameters_does_not_start(name: str, needed: str) -> None:
    with Bench("beam", [0.3]) as bench, pytest.raises(BenchError, match=f"/{NAMESPACE}/{name} needs .*'{needed}'"):
        make_node(bench, name, None)


@pytest.mark.parametrize("namespace", ["/", "/second", "/hall/second"])
def test_a_parameter_file_moves_with_its_namespace(namespace: str, tmp_path: Path) -> None:
    plan = plan_nodes(plan_test("beam", [0.2], run_id="moved", linked=False), tmp_path / "bag", tmp_path / "rig.yaml")
    plan.write_parameters(tmp_path / "nodes.yaml")
    arguments = ["--ros-args", "--params-file", str(tmp_path / "nodes.yaml"), "-r", f"__ns:={namespace}"]
    with Bench("beam", [0.3]) as bench:
        context = Context()
        rclpy.init(args=arguments, context=context, domain_id=bench.domain_id)
        try:
            node = PllNode(context=context)
            assert node.heartbeat_name == f"{namespace}/pll".lstrip("/")
            assert node.settings.linear_json == plan.pll.linear_json
            prefix = node.heartbeat_name.removesuffix("pll")
            assert node.watched_nodes == [f"{prefix}plant", f"{prefix}sequencer"]
            node.destroy_node()
        finally:
            rclpy.shutdown(context=context)
