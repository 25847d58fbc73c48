"""With many channels the loop gets force and response at the drive point alone; everything is recorded all the same."""

from __future__ import annotations

from pathlib import Path

import pytest
from rclpy.node import Node

from nmt_bench.harness import Bench
from nmt_benchmark.channel_figures import large_rig
from nmt_core.base_node import SAMPLES_QOS
from nmt_core.messages.blocks import Quantity, SampleBlock
from nmt_core.messages.bundle import read_bundle
from nmt_core.messages.wire import BlockReader
from nmt_msgs import msg
from nmt_record.bag.bag_reader import Bag

pytestmark = pytest.mark.node


def test_the_loop_gets_force_and_response_at_the_drive_point_only(tmp_path: Path) -> None:
    joined: list[bytes] = []
    rig = large_rig(10, 40, 25_600.0)
    with Bench(rig, levels=[0.3], window_periods=10, out=tmp_path) as bench:
        point = bench.rig.drive_point
        listener = Node("listener", context=bench.context, enable_rosout=False, start_parameter_services=False)
        listener.create_subscription(msg.Bundle, "loop_input", joined.append, SAMPLES_QOS, raw=True)
        bench.add_node("listener", listener)
        result = bench.run()
        bench.spin(0.5)
    recorded: dict[str, list[SampleBlock]] = {"force": [], "acceleration": []}
    for topic, _, _, raw in Bag.open(result.bag or Path()).raw_messages(recorded):
        recorded[topic].append(BlockReader().read(bytes(raw)))
    assert len(joined) == len(recorded["force"]) == len(recorded["acceleration"]) > 50
    for raw, force, motion in zip(joined, recorded["force"], recorded["acceleration"], strict=True):
        blocks = [BlockReader().read(message) for _, message in read_bundle(raw)]
        assert [block.quantity for block in blocks] == [Quantity.FORCE, Quantity.ACCELERATION]
        assert all(block.points == (point,) and block.first_sample == force.first_sample for block in blocks)
        assert (blocks[0].data == force.data).all()
        assert len(motion.channels) == 38
        assert (blocks[1].data[0] == motion.data[motion.points.index(point)]).all()
