# ruff: noqa: E402 - imports follow the check that ROS is there
from __future__ import annotations

import json
import os
import time
from dataclasses import asdict

import pytest

rclpy = pytest.importorskip("rclpy", reason="needs ROS 2; source the workspace")
pytest.importorskip("nmt_msgs.msg", reason="needs the built workspace; source ros2_ws/install/setup.bash")

from extract.synthetic import FREQUENCY, RATE, Stream, in_phase_case, linear_description, lock_event
from rclpy.context import Context
from rclpy.experimental import EventsExecutor
from rclpy.node import Node

from nmt_core.base_node import SAMPLES_QOS
from nmt_core.errors import BenchError
from nmt_core.messages.records import LevelCommand, LoopStatus
from nmt_core.messages.wire import LEVEL, LOCK_EVENT, MODAL_POINT, BlockReader, BlockWriter, write_status
from nmt_core.settings import settings_of
from nmt_core.vocabulary import LoopState, PointStatus
from nmt_extract.extract_node import ExtractNode
from nmt_extract.extraction_settings import ExtractSettings
from nmt_extract.offline import extract_bag
from nmt_msgs.msg import Frequency, Level, LockEvent, ModalPoint
from nmt_msgs.msg import SampleBlock as SampleBlockMessage
from nmt_record.bag.bag_writer import BagWriter

pytestmark = [
    pytest.mark.node,
    # The type support of rclpy imports a parser that still uses it.
    pytest.mark.filterwarnings("ignore:module 'sre_:DeprecationWarning"),
]

DOMAIN = 40 + int(os.environ.get("PYTEST_XDIST_WORKER", "gw0")[2:])
KINDS = {
    "force": SampleBlockMessage,
    "displacement": SampleBlockMessage,
    "frequency": Frequency,
    "lock": LockEvent,
    "level": Level,
}
SAMPLES = round(5 * RATE / FREQUENCY)
VALUES = {"linear_json": linear_description().to_json(), "topics": ["force", "displacement"], "rig": "beam"}


class Rig(Node):
    """Rig, loop and sequencer, played by the test."""

    def __init__(self, context):
        super().__init__("rig", context=context, enable_rosout=False, start_parameter_services=False)
        self.publishers_by_topic = {
            topic: self.create_publisher(kind, topic, SAMPLES_QOS) for topic, kind in KINDS.items()
        }
        self.points = []
        self.create_subscription(ModalPoint, "modal_point", self.points.append, SAMPLES_QOS, raw=True)


class Stage:
    """A context of its own with the node under test and the rig."""

    def __init__(self, values):
        self.context = Context()
        rclpy.init(context=self.context, domain_id=DOMAIN)
        self.node = None
        self.executor = EventsExecutor(context=self.context)
        try:
            self.node = ExtractNode(settings_of(ExtractSettings, values, "extract"), context=self.context)
        except BaseException:
            self.close()
            raise
        self.rig = Rig(self.context)
        for node in (self.node, self.rig):
            self.executor.add_node(node)

    def spin_until(self, condition, seconds=20.0):
        deadline = time.monotonic() + seconds
        while not condition():
            if time.monotonic() > deadline:
                pytest.fail("the expected messages did not come")
            self.executor.spin_once(timeout_sec=0.01)

    def wait_for_discovery(self):
        publishers = self.rig.publishers_by_topic.values()
        self.spin_until(
            lambda: (
                all(p.get_subscription_count() == 1 for p in publishers)
                and self.rig.count_publishers("modal_point") == 1
                and self.node.count_subscribers("modal_point") == 1
            )
        )

    def received(self, topic):
        """Messages of a topic that the node has taken."""
        extractor = self.node.core.extractor
        assembler = extractor.assembler
        counts = {"frequency": assembler.table.kept[1], "level": len(extractor.levels)}
        counts["lock"] = len(extractor.lock_samples)
        return {**counts, **assembler.table.blocks}[topic]

    def close(self):
        if self.node is not None:
            self.node.shut_down()
            self.executor.shutdown()
            self.node.destroy_node()
            self.rig.destroy_node()
        self.context.try_shutdown()


@pytest.fixture
def stage(monkeypatch):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    stages = []

    def make(values=VALUES):
        stages.append(Stage(values))
        return stages[-1]

    yield make
    for item in stages:
        item.close()


def recording():
    """Topic and serialised message of a run: level 0 locks, level 1 loses its lock in the window, level 2 never."""
    force, shape = in_phase_case()
    stream = Stream([0, force, 0.1 * force], [[0, x, 0, 0.01 * x] for x in shape], samples=10_000, noise=0.01)
    levels = {0: 0, 19: 1, 38: 2}
    locks = {2: lock_event(600, SAMPLES, 5, sample=599), 22: lock_event(4600, SAMPLES, 5, sample=4599, level_index=1)}
    lost = {30: 1, 45: 2}
    level, state = 0, LoopState.FIXED
    messages = []
    writers = {topic: BlockWriter("beam") for topic in ("force", "displacement")}
    for index, pair in enumerate(zip(stream.blocks("force"), stream.blocks("displacement"), strict=True)):
        if index in levels:
            level, state = levels[index], LoopState.ACQUIRING
            order = LevelCommand(level + 1, level, 0.1 * (level + 1), 0, 0.0)
            messages.append(("level", LEVEL.write(order)))
        for block in pair:
            messages.append((block.quantity.topic, writers[block.quantity.topic].write(block)))
        if index in locks:
            state = LoopState.LOCKED
            messages.append(("lock", LOCK_EVENT.write(locks[index])))
        reason = ""
        if index in lost:
            state, reason = LoopState.LOCK_LOST, "phase error 9.1 deg"
        last = pair[0].end_sample - 1
        status = LoopStatus(last, level, 0, state, 0.0, 0.0, 0.0, 0.0, "m", 0.0, reason=reason)
        messages.append(("frequency", write_status(status, RATE)))
    return messages


@pytest.fixture(scope="module")
def messages():
    return recording()


def write_bag(path, messages):
    run = {"run_id": "r", "linear": asdict(linear_description()), "extraction": {"topics": VALUES["topics"]}}
    writer = BagWriter(path, run_json=json.dumps(run), rig_yaml="")
    for topic, kind in KINDS.items():
        writer.add_topic(topic, f"nmt_msgs/msg/{kind.__name__}")
    for topic, message in messages:
        writer.write(topic, message)
    writer.close()
    return path


def test_live_points_equal_those_from_the_bag_bit_for_bit(stage, messages, tmp_path):
    live = stage()
    live.wait_for_discovery()
    for topic, message in messages:
        live.rig.publishers_by_topic[topic].publish(message)
        live.executor.spin_once(timeout_sec=0.0)
    live.spin_until(lambda: len(live.rig.points) >= 3)
    points = [MODAL_POINT.read(raw) for raw in live.rig.points]
    assert [(point.level_index, point.status) for point in points] == [
        (0, PointStatus.OK),
        (1, PointStatus.REJECTED),
        (2, PointStatus.NOT_LOCKED),
    ]
    assert points[0].damping_ratio == pytest.approx(0.012, rel=0.02)
    assert points[1].reason.endswith("lock lost at sample 6199 (phase error 9.1 deg).")
    assert points[2].level == pytest.approx(0.3)
    offline = extract_bag(write_bag(tmp_path / "bag", messages)).points
    assert len(offline) == 3
    assert all(a.identical(b) for a, b in zip(points, offline, strict=True))
    live.node.update_counters()
    assert live.node.counters["points"] == 1
    assert live.node.counters["gaps_force"] == 0


@pytest.mark.parametrize("order", [("lock", "level", "frequency", "force", "displacement"), tuple(KINDS)])
def test_topics_may_come_late_against_each_other(stage, messages, order):
    """Each topic keeps its order; the lock event and the loop's states overtake the samples or lag behind."""
    live = stage()
    live.wait_for_discovery()
    until = [i for i, (topic, _) in enumerate(messages) if topic == "level"][1]
    for wanted in order:
        sent = [message for topic, message in messages[:until] if topic == wanted]
        for message in sent:
            live.rig.publishers_by_topic[wanted].publish(message)
        live.spin_until(lambda wanted=wanted, sent=sent: live.received(wanted) >= len(sent))
    live.spin_until(lambda: live.rig.points)
    (point,) = map(MODAL_POINT.read, live.rig.points)
    assert point.status is PointStatus.OK


def test_a_malformed_block_rejects_the_window_and_the_node_lives_on(stage, messages):
    live = stage()
    live.wait_for_discovery()
    for topic, message in messages:
        if topic == "force" and BlockReader().read(message).first_sample == 1000:
            broken = SampleBlockMessage(first_sample=1000, sample_rate=RATE, quantity=1, unit="N")
            live.rig.publishers_by_topic[topic].publish(broken)
            continue
        live.rig.publishers_by_topic[topic].publish(message)
        live.executor.spin_once(timeout_sec=0.0)
    live.spin_until(lambda: len(live.rig.points) >= 3)
    point = MODAL_POINT.read(live.rig.points[0])
    assert point.status is PointStatus.REJECTED
    assert "'force'" in point.reason
    assert "missing" in point.reason


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        ({"linear_json": "{"}, "not valid JSON"),
        ({"linear_json": "{}"}, "not complete or not well-formed"),
        ({**VALUES, "topics": ["force"]}, "one of displacement, velocity, acceleration"),
        ({**VALUES, "harmonics": 2.5}, "harmonics"),
        ({**VALUES, "hysteresis_json": "["}, "is not JSON"),
        ({**VALUES, "hysteresis_json": "[]"}, "must be a JSON object"),
        ({**VALUES, "colour": "red"}, "'colour' is not known to extract"),
    ],
)
def test_mistakes_in_parameters_are_told_in_a_sentence(stage, values, sentence):
    with pytest.raises(BenchError, match=sentence):
        stage(values)
