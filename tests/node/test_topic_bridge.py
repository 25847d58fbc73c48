# ruff: noqa: E402 - imports follow the check that ROS is there
"""A sensor node that is none of the bench's, bridged, recorded and extracted as any channel."""

from __future__ import annotations

import json
import math
import os
import time
from pathlib import Path

import numpy as np
import pytest

rclpy = pytest.importorskip("rclpy", reason="needs ROS 2; source the workspace")
pytest.importorskip("nmt_msgs.msg", reason="needs the built workspace; source ros2_ws/install/setup.bash")

from extract.synthetic import linear_description, lock_event
from geometry_msgs.msg import WrenchStamped
from rclpy.context import Context
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from sensor_msgs.msg import Imu

from nmt_core.base_node import SAMPLES_QOS
from nmt_core.errors import BenchError
from nmt_core.messages.wire import LOCK_EVENT
from nmt_core.vocabulary import PointStatus
from nmt_extract.extraction_settings import ExtractionSettings
from nmt_extract.offline import extract_bag
from nmt_msgs.msg import LockEvent
from nmt_plant.topic_bridge import TopicBridgeSettings
from nmt_plant.topic_bridge_node import TopicBridgeNode
from nmt_record import Bag
from nmt_record.bag.recorder_node import RecorderNode
from nmt_record.bag.recorder_settings import RecorderSettings

pytestmark = [
    pytest.mark.node,
    # The type support of rclpy imports a parser that still uses it.
    pytest.mark.filterwarnings("ignore:module 'sre_:DeprecationWarning"),
]

DOMAIN = 70 + int(os.environ.get("PYTEST_XDIST_WORKER", "gw0")[2:])
RATE, FREQUENCY, DAMPING = 1000.0, 20.0, 0.01
OMEGA = 2.0 * math.pi * FREQUENCY
BEGIN = 1_764_064_800_000_000_000  # ns
TABLE = f"""
sample_rate: {RATE:g}
block_samples: 100
channels:
  - {{topic: /wrench, type: geometry_msgs/msg/WrenchStamped, field: wrench.force.z, quantity: force, point: 2}}
  - {{topic: /imu, type: sensor_msgs/msg/Imu, field: linear_acceleration.x, quantity: acceleration, point: 2}}
"""


class Sensors(Node):
    """A force sensor and an IMU of one mode of 1 kg at phase resonance, with stamps; and the lock of a loop."""

    def __init__(self, context: Context) -> None:
        super().__init__("sensors", context=context, enable_rosout=False, start_parameter_services=False)
        self.wrench = self.create_publisher(WrenchStamped, "/wrench", 1000)
        self.imu = self.create_publisher(Imu, "/imu", 1000)
        self.lock = self.create_publisher(LockEvent, "lock", SAMPLES_QOS)
        self.sent = 0

    def send(self, number: int) -> None:
        """A sample of each sensor; the IMU samples 0.3 ms after the force sensor."""
        wrench, imu = WrenchStamped(), Imu()
        for message, moment in ((wrench, number / RATE), (imu, number / RATE + 3e-4)):
            stamp = BEGIN + round(1e9 * moment)
            message.header.stamp.sec, message.header.stamp.nanosec = stamp // 10**9, stamp % 10**9
        # x = sin ωt, so v = ω cos ωt and the force 2 δ ω v is in phase with it.
        wrench.wrench.force.z = 2.0 * DAMPING * OMEGA**2 * math.cos(OMEGA * number / RATE)
        imu.linear_acceleration.x = -(OMEGA**2) * math.sin(OMEGA * (number / RATE + 3e-4))
        self.wrench.publish(wrench)
        self.imu.publish(imu)
        self.sent = number


def test_a_bridged_topic_is_recorded_and_extracted_as_any(tmp_path: Path) -> None:
    (tmp_path / "table.yaml").write_text(TABLE)
    context = Context()
    rclpy.init(context=context, domain_id=DOMAIN)
    executor = EventsExecutor(context=context)
    nodes: list[Node] = []
    try:
        bridge = TopicBridgeNode(TopicBridgeSettings(table=str(tmp_path / "table.yaml"), rig="theirs"), context=context)
        nodes.append(bridge)
        run = json.dumps({"run_id": "bridged", "device": "topic bridge"})
        recorder = RecorderNode(RecorderSettings(output=str(tmp_path / "bag"), run_json=run), context=context)
        nodes.append(recorder)
        sensors = Sensors(context)
        nodes.append(sensors)
        for node in nodes:
            executor.add_node(node)

        def until(condition) -> None:
            end = time.monotonic() + 60.0
            while not condition():
                executor.spin_once(timeout_sec=0.01)
                assert time.monotonic() < end

        until(lambda: sensors.imu.get_subscription_count() and sensors.wrench.get_subscription_count())
        until(lambda: sensors.lock.get_subscription_count() and bridge.outlets and all(
            outlet.peers() for outlet in bridge.outlets.values()))  # fmt: skip
        lock = lock_event(500, 2000, 40, frequency_hz=FREQUENCY)
        sensors.lock.publish(LOCK_EVENT.write(lock))
        for number in range(3200):
            if 2800 <= number < 2850:
                continue  # lost messages, after the window
            sensors.send(number)
            # At most so many messages are on their way.
            until(lambda number=number: bridge.received >= 2 * (number - 100))
        until(lambda: bridge.counters.get("blocks", 0) >= 60)
        bridge.update_counters()
        assert bridge.counters["missing_samples"] > 90
        # The bag holds other messages, too: each quantity has to have arrived behind the gap.
        arrived = recorder.core.gaps.topics
        until(lambda: all(quantity in arrived and arrived[quantity].next_sample >= 3000
                          for quantity in ("force", "acceleration")))  # fmt: skip
        recorder.close("the test is over", "done")
    finally:
        for node in nodes:
            node.destroy_node()
        executor.shutdown()
        rclpy.shutdown(context=context)

    bag = Bag.open(tmp_path / "bag")
    blocks = list(bag.blocks("acceleration"))
    assert [block.first_sample for block in blocks] == list(range(0, 100 * len(blocks), 100))
    assert blocks[0].channels == ("a2",)
    assert np.isnan(np.concatenate([block.data[0] for block in blocks])).sum() >= 49
    linear = linear_description(
        np.array([[1.0]]), points=(2,), frequencies_rad_s=(OMEGA,), damping_ratios=(DAMPING,), drive_point_shape=1.0
    )
    (point,) = extract_bag(tmp_path / "bag", linear, ExtractionSettings()).points
    assert point.status is PointStatus.OK
    assert point.reason == ""
    assert point.damping_ratio == pytest.approx(DAMPING, rel=2e-3)
    assert point.frequency_hz == pytest.approx(FREQUENCY, rel=1e-5)
    assert abs(math.degrees(point.phase_error)) < 0.1


def test_a_type_that_is_not_installed_is_named(tmp_path: Path) -> None:
    (tmp_path / "table.yaml").write_text(TABLE.replace("sensor_msgs/msg/Imu", "lab_msgs/msg/Gauge"))
    context = Context()
    rclpy.init(context=context, domain_id=DOMAIN)
    try:
        with pytest.raises(BenchError, match="lab_msgs/msg/Gauge is not installed"):
            TopicBridgeNode(TopicBridgeSettings(table=str(tmp_path / "table.yaml")), context=context)
    finally:
        rclpy.shutdown(context=context)


def test_a_field_that_a_type_lacks_is_refused_at_the_start(tmp_path: Path) -> None:
    (tmp_path / "table.yaml").write_text(TABLE.replace("linear_acceleration.x", "acceleration.x"))
    context = Context()
    rclpy.init(context=context, domain_id=DOMAIN)
    try:
        with pytest.raises(BenchError, match=r"sensor_msgs/msg/Imu has no field 'acceleration'; it has header, "):
            TopicBridgeNode(TopicBridgeSettings(table=str(tmp_path / "table.yaml")), context=context)
    finally:
        rclpy.shutdown(context=context)
