# ruff: noqa: E402 - imports follow the check that ROS is there
"""Nodes that are none of the bench's, recorded as they publish, paused once: imported and extracted."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from mcap.writer import Writer

rclpy = pytest.importorskip("rclpy", reason="needs ROS 2; source the workspace")

from geometry_msgs.msg import WrenchStamped
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import CompressedImage, JointState

from nmt_extract.decays.free_decay import free_decays
from nmt_record import Bag
from nmt_record.bag.message_definitions import local_definitions
from nmt_record.exchange.imports.imported_run import read_import, write_import
from nmt_record.exchange.templates.sidecar_template import sidecar_templates

pytestmark = [
    pytest.mark.node,
    # The type support of rclpy imports a parser that still uses it.
    pytest.mark.filterwarnings("ignore:module 'sre_:DeprecationWarning"),
]

DOMAIN = 90 + int(os.environ.get("PYTEST_XDIST_WORKER", "gw0")[2:])
RATE, FREQUENCY, DAMPING = 200.0, 7.0, 0.02
OMEGA = 2.0 * math.pi * FREQUENCY
BEGIN = 1_764_064_800_000_000_000  # ns
SAMPLES = 600
PAUSE = 30.0  # s


class Robot(Node):
    """Joints, a force sensor and a camera, with stamps of their own."""

    def __init__(self, context: Context) -> None:
        super().__init__("robot", context=context, enable_rosout=False, start_parameter_services=False)
        self.joints = self.create_publisher(JointState, "/joint_states", 1000)
        self.wrench = self.create_publisher(WrenchStamped, "/wrench", 1000)
        self.camera = self.create_publisher(CompressedImage, "/camera", 1000)

    def send(self, number: int, begin: float) -> None:
        """A sample of each after the beginning of a decay (s); the order of the joints changes."""
        moment = number / RATE
        stamp = BEGIN + round(1e9 * (begin + moment))
        messages = JointState(), WrenchStamped(), CompressedImage(format="jpeg", data=b"\xff\xd8" * 50)
        for message in messages:
            message.header.stamp.sec, message.header.stamp.nanosec = stamp // 10**9, stamp % 10**9
        joints, wrench, picture = messages
        value = math.exp(-DAMPING * OMEGA * moment) * math.cos(OMEGA * math.sqrt(1.0 - DAMPING**2) * moment)
        joints.name, joints.position = ["elbow", "wrist"], [0.1 * value, -0.5]
        if number % 2:
            joints.name, joints.position = joints.name[::-1], joints.position[::-1]
        wrench.wrench.force.z = 5.0 * value
        for publisher, message in ((self.joints, joints), (self.wrench, wrench), (self.camera, picture)):
            publisher.publish(message)


class Recorder(Node):
    """Writes what comes as it comes, serialised; of the camera's type it knows the name only."""

    TOPICS = (
        ("/joint_states", JointState, "sensor_msgs/msg/JointState"),
        ("/wrench", WrenchStamped, "geometry_msgs/msg/WrenchStamped"),
        ("/camera", CompressedImage, "lab_cameras/msg/Frame"),
    )

    def __init__(self, context: Context, path: Path) -> None:
        super().__init__("recorder", context=context, enable_rosout=False, start_parameter_services=False)
        self.counts = dict.fromkeys((topic for topic, _, _ in self.TOPICS), 0)
        self.now = 0
        self.file = path.open("wb")
        self.writer = Writer(self.file)
        self.writer.start(profile="ros2", library="")
        for topic, message, kind in self.TOPICS:
            known = not kind.startswith("lab_")
            text = local_definitions().definition(kind).text.encode() if known else b""
            channel = self.writer.register_channel(topic, "cdr", self.writer.register_schema(kind, "ros2msg", text))
            self.create_subscription(message, topic, self._taker(topic, channel), 1000, raw=True)

    def _taker(self, topic: str, channel: int) -> Callable[[bytes], None]:
        def take(raw: bytes) -> None:
            self.counts[topic] += 1
            self.writer.add_message(channel, self.now, bytes(raw), self.now)

        return take

    def close(self) -> None:
        self.writer.finish()
        self.file.close()


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """Two decays with a pause in between, as messages that came over the wire."""
    path = tmp_path / "robot.mcap"
    context = Context()
    rclpy.init(context=context, domain_id=DOMAIN)
    executor = SingleThreadedExecutor(context=context)
    robot, recorder = Robot(context), Recorder(context, path)
    try:
        for node in (robot, recorder):
            executor.add_node(node)

        def until(condition: Callable[[], Any]) -> None:
            end = time.monotonic() + 60.0
            while not condition():
                executor.spin_once(timeout_sec=0.01)
                assert time.monotonic() < end

        until(lambda: all(one.get_subscription_count() for one in (robot.joints, robot.wrench, robot.camera)))
        for decay, begin in enumerate((0.0, SAMPLES / RATE + PAUSE)):
            for number in range(SAMPLES):
                recorder.now = BEGIN + round(1e9 * (begin + number / RATE)) + 200_000
                robot.send(number, begin)
                sent = decay * SAMPLES + number + 1
                until(lambda sent=sent: min(recorder.counts.values()) >= sent)
    finally:
        recorder.close()
        for node in (robot, recorder):
            node.destroy_node()
        executor.shutdown()
        rclpy.shutdown(context=context)
    return path


def test_a_paused_recording_of_nodes_is_imported_and_extracted(recording: Path) -> None:
    texts = sidecar_templates(recording)
    assert len(texts) == 2
    columns = {"/joint_states.position.elbow": 0.1, "/wrench.wrench.force.z": 5.0}
    for text, (column, size) in zip(sorted(texts), columns.items(), strict=True):
        assert "Topic /camera (lab_cameras/msg/Frame, 1200 messages) was left out" in text
        values = yaml.safe_load(text)
        (channel,) = values["channels"]
        assert channel["column"] == column
        channel.update(quantity="angle" if "joint" in column else "force", unit="rad" if "joint" in column else "N")
        assert [segment["start"] for segment in values["segments"]] == [0, SAMPLES / RATE + PAUSE]
        sidecar = recording.with_name(f"{channel['quantity']}.yaml")
        for segment in values["segments"]:
            segment["kind"] = "ring_down" if "joint" in column else "record"
        sidecar.write_text(yaml.safe_dump(values))
        run = read_import(sidecar)
        assert run.sample_rate == RATE
        assert np.nanmax(run.channels[0].data) == pytest.approx(size)
        write_import(run, sidecar.with_suffix(""), "", "", {})
    decays = free_decays(Bag.open(recording.with_name("angle")))
    assert len(decays) == 2
    for decay in decays:
        assert decay.reason == ""
        assert decay.mean("frequency_hz")[0] == pytest.approx(FREQUENCY, rel=1e-4)
        assert decay.mean("damping_ratio")[0] == pytest.approx(DAMPING, rel=1e-3)
