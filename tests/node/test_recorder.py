# ruff: noqa: E402 - imports follow the check that ROS is there
from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from tiers import with_quick

rclpy = pytest.importorskip("rclpy", reason="needs ROS 2; source the workspace")
pytest.importorskip("nmt_msgs.msg", reason="needs the built workspace; source ros2_ws/install/setup.bash")

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.context import Context
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from std_msgs.msg import Float64, String, UInt64

from nmt_core.base_node import SAMPLES_QOS, STATE_QOS
from nmt_core.errors import BenchError
from nmt_core.messages.blocks import OscillatorPhase, Quantity, SampleBlock
from nmt_core.messages.run_announcement import RunAnnouncement
from nmt_core.messages.wire import BlockReader, BlockWriter
from nmt_core.nodes.liveness import HANG_LIMIT
from nmt_core.settings import settings_of
from nmt_msgs.msg import Drive, LockEvent, ModalPoint, RunState
from nmt_msgs.msg import SampleBlock as SampleBlockMessage
from nmt_record import Bag
from nmt_record.bag.recorder_node import RecorderNode
from nmt_record.bag.recorder_settings import RecorderSettings

pytestmark = [
    pytest.mark.node,
    # The type support of rclpy imports a parser that still uses it.
    pytest.mark.filterwarnings("ignore:module 'sre_:DeprecationWarning"),
]

DOMAIN = 10 + int(os.environ.get("PYTEST_XDIST_WORKER", "gw0")[2:])
RUN = {"run_id": "run-7", "linear": {"source": "model"}}


class Rig(Node):
    """What the recorder listens to, played by the test."""

    def __init__(self, context):
        super().__init__("rig", context=context, enable_rosout=False, start_parameter_services=False)
        self.blocks = {
            name: self.create_publisher(SampleBlockMessage, name, SAMPLES_QOS)
            for name in ("force", "acceleration", "voltage")
        }
        self.drive = self.create_publisher(Drive, "drive", SAMPLES_QOS)
        self.lock = self.create_publisher(LockEvent, "lock", SAMPLES_QOS)
        self.modal_point = self.create_publisher(ModalPoint, "modal_point", SAMPLES_QOS)
        self.run_state = self.create_publisher(RunState, "run_state", STATE_QOS)
        self.extra = self.create_publisher(Float64, "temperature", 10)
        self.bag_states = []
        self.diagnostics = []
        self.create_subscription(String, "bag", lambda m: self.bag_states.append(json.loads(m.data)), STATE_QOS)
        self.create_subscription(DiagnosticArray, "/diagnostics", self.diagnostics.append, 10)

    def publish_block(self, topic, first_sample, samples=20):
        publish = self.blocks[topic].publish
        publish(BlockWriter("beam").write(make_block(topic, first_sample, samples)))

    def publish_voltage(self, first_sample, amplitude, samples=20):
        data = np.full((1, samples), amplitude)
        phase = OscillatorPhase(0.0, 0.0, 0.0)
        block = SampleBlock(first_sample, 1000.0, Quantity.VOLTAGE, "V", ("u",), (0,), data, phase)
        self.blocks["voltage"].publish(BlockWriter("beam").write(block))

    def publish_state(self, phase, sample=0, run_id="run-7", result_code=0):
        stamp = Time(nanosec=1_000_000 * sample)
        state = RunState(stamp=stamp, run_id=run_id, phase=phase, sample=sample, result_code=result_code)
        self.run_state.publish(state)


def make_block(topic, first_sample, samples=20):
    channels = {"force": ("f2",), "acceleration": ("a1", "a2", "a6")}[topic]
    return SampleBlock(
        first_sample=first_sample,
        sample_rate=1000.0,
        quantity=Quantity[topic.upper()],
        unit=Quantity[topic.upper()].unit,
        channels=channels,
        points=tuple(int(name[1:]) for name in channels),
        data=np.random.default_rng(first_sample).standard_normal((len(channels), samples)),
        oscillator=OscillatorPhase(0.125, 40.0, 0.0),
    )


class Stage:
    """One context with the rig in it; spins everything from the test's own thread."""

    def __init__(self, folder):
        self.path = folder / "bag"
        self.context = Context()
        rclpy.init(context=self.context, domain_id=DOMAIN)
        self.executor = EventsExecutor(context=self.context)
        self.rig = Rig(self.context)
        self.executor.add_node(self.rig)
        self.recorder = None

    def start(self, **values):
        values = {"output": str(self.path), "run_json": json.dumps(RUN), "rig_yaml": "name: beam\n", **values}
        self.recorder = RecorderNode(settings_of(RecorderSettings, values, "recorder"), context=self.context)
        self.executor.add_node(self.recorder)
        self.until(lambda: self.rig.lock.get_subscription_count() and self.rig.run_state.get_subscription_count())
        self.until(lambda: all(self.rig.blocks[name].get_subscription_count() for name in ("force", "acceleration")))
        self.until(lambda: self.rig.bag_states)
        return self.recorder

    def until(self, condition, timeout=20.0):
        deadline = time.monotonic() + timeout
        while not condition():
            assert time.monotonic() < deadline, "waited in vain"
            self.executor.spin_once(timeout_sec=0.05)

    def end(self):
        for node in (self.recorder, self.rig):
            if node is not None:
                node.destroy_node()
        self.executor.shutdown()
        rclpy.shutdown(context=self.context)


@pytest.fixture
def stage(tmp_path, monkeypatch):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setenv("ROS_PYTHON_CHECK_FIELDS", "1")
    stage = Stage(tmp_path)
    yield stage
    stage.end()


def test_a_run_is_recorded_and_the_bag_closes_by_itself(stage):
    recorder = stage.start()
    rig = stage.rig
    bag = Bag.open(stage.path)  # already there
    assert bag.run_start == RUN
    assert bag.rig_yaml == "name: beam\n"
    assert rig.bag_states[-1]["state"] == "open"
    rig.publish_state(RunState.RUNNING)
    for index in range(30):
        rig.publish_block("force", 20 * index)
        rig.publish_block("acceleration", 20 * index)
        rig.drive.publish(Drive(based_on_sample=20 * index + 19, waveform=Drive.SINE, frequency_hz=40.0))
    rig.lock.publish(LockEvent(level_index=2, sample=300, window_first_sample=320, window_samples=200))
    stage.until(lambda: recorder.writer.counts.get("lock"))
    rig.publish_state(RunState.DONE, sample=599)
    stage.until(lambda: recorder.state == "closed")
    stage.until(lambda: rig.bag_states[-1]["state"] == "closed")
    bag = Bag.open(stage.path)
    assert rig.bag_states[-1] == {
        "path": str(stage.path),
        "state": "closed",
        "messages": sum(count for _, count in bag.topics.values()),
        "reason": "",
        "goal": "",
        "recorded_s": 0.6,
        "lacks_s": 0.0,
    }
    assert bag.loss is None
    for topic in ("force", "acceleration"):
        blocks = list(bag.blocks(topic))
        assert [block.first_sample for block in blocks] == list(range(0, 600, 20))
        for block in blocks:
            sent = make_block(topic, block.first_sample)
            np.testing.assert_array_equal(block.data, sent.data)
            assert (block.channels, block.points, block.oscillator) == (sent.channels, sent.points, sent.oscillator)
    (event,) = bag.lock_events()
    assert (event.level_index, event.window_first_sample) == (2, 320)
    assert bag.topics["drive"] == ("nmt_msgs/msg/Drive", 30)
    assert bag.run_stop["exit"] == {"state": "done", "reason": ""}
    assert bag.run_stop["run_id"] == "run-7"
    assert bag.run_stop["gaps"]["force"] == {
        "first_sample": 0,
        "end_sample": 600,
        "blocks": 30,
        "gaps": 0,
        "missing_samples": 0,
        "repeats": 0,
    }
    published = [stamp for _, _, stamp, _ in bag.raw_messages(["force"])]
    assert published == [20_000_000 * index for index in range(30)]  # bench time


def test_after_an_early_end_the_bag_stays_open_until_the_drive_is_at_zero(stage):
    recorder = stage.start(settle_time=0.0)
    rig = stage.rig
    stage.until(rig.blocks["voltage"].get_subscription_count)
    rig.publish_state(RunState.RUNNING)
    rig.publish_voltage(0, 0.8)
    stage.until(lambda: recorder.writer.counts.get("voltage") == 1)
    rig.publish_state(RunState.DONE, sample=19, result_code=6)
    stage.until(lambda: recorder.core.end_sample == 19)
    for _ in range(5):
        recorder.watch()
    assert recorder.state == "open"
    rig.publish_voltage(20, 0.4)
    rig.publish_voltage(40, 0.0)
    stage.until(lambda: recorder.state == "closed")
    blocks = list(Bag.open(stage.path).blocks("voltage"))
    assert [float(block.data.max()) for block in blocks] == [0.8, 0.4, 0.0]


def end_while_driven(stage, recorder):
    """A run that ends, by a fault, with the drive at 0.8 V."""
    stage.until(stage.rig.blocks["voltage"].get_subscription_count)
    stage.rig.publish_state(RunState.RUNNING)
    stage.rig.publish_voltage(0, 0.8)
    stage.until(lambda: recorder.writer.counts.get("voltage") == 1)
    stage.rig.publish_state(RunState.DONE, sample=19, result_code=6)


def test_the_ramp_of_a_plant_that_is_gone_is_not_waited_for(stage, monkeypatch):
    monkeypatch.setattr("nmt_record.bag.recorder_node.LONGEST_RAMP", 1000.0)
    recorder = stage.start(settle_time=0.0)
    end_while_driven(stage, recorder)
    stage.until(lambda: recorder.core.end_sample == 19)
    recorder.watch()
    assert recorder.state == "open"
    stage.rig.destroy_publisher(stage.rig.blocks.pop("voltage"))
    stage.until(lambda: recorder.state == "closed")


def test_a_drive_that_never_comes_to_rest_does_not_keep_the_bag_open(stage, monkeypatch):
    monkeypatch.setattr("nmt_record.bag.recorder_node.LONGEST_RAMP", 0.2)
    recorder = stage.start(settle_time=0.0)
    end_while_driven(stage, recorder)
    stage.until(lambda: recorder.state == "closed")


def test_offline_blocks_equal_live_ones(stage):
    """What a live subscriber decodes and what the bag gives back are the same numbers."""
    stage.start()
    live = []
    stage.rig.create_subscription(
        SampleBlockMessage, "force", lambda raw: live.append(BlockReader().read(raw)), SAMPLES_QOS, raw=True
    )
    stage.until(lambda: stage.rig.blocks["force"].get_subscription_count() == 2)
    for index in range(5):
        stage.rig.publish_block("force", 20 * index)
    stage.until(lambda: len(live) == 5 and stage.recorder.writer.counts.get("force") == 5)
    stage.recorder.close()
    for offline, online in zip(Bag.open(stage.path).blocks("force"), live, strict=True):
        assert offline.data.tobytes() == online.data.tobytes()
        assert offline.first_sample == online.first_sample
        assert offline.channels == online.channels


def test_gaps_are_counted_and_reported(stage):
    recorder = stage.start()
    for first in (0, 20, 80, 100, 160):
        stage.rig.publish_block("force", first)
    stage.until(lambda: recorder.writer.counts.get("force") == 5)

    def reported():
        return [
            status
            for array in stage.rig.diagnostics
            for status in array.status
            if status.name == "recorder" and status.level == DiagnosticStatus.WARN
        ]

    stage.until(reported)
    values = {item.key: item.value for item in reported()[-1].values}
    assert (values["gaps"], values["missing_samples"], values["state"]) == ("2", "80", "open")
    recorder.close("the test is over")
    stop = Bag.open(stage.path).run_stop
    assert stop["gaps"]["force"]["missing_samples"] == 80
    assert stop["exit"] == {"state": "interrupted", "reason": "the test is over"}


def test_the_bag_waits_for_late_blocks(stage):
    recorder = stage.start(settle_time=0.0)
    stage.rig.publish_state(RunState.RUNNING)
    stage.rig.publish_block("force", 0)
    stage.until(lambda: recorder.writer.counts.get("force") and recorder.writer.counts.get("run_state"))
    stage.rig.publish_state(RunState.DONE, sample=39)
    stage.until(lambda: recorder.writer.counts["run_state"] == 2)
    for _ in range(10):
        stage.executor.spin_once(timeout_sec=0.05)
    assert recorder.state == "open"
    stage.rig.publish_block("force", 20)
    stage.until(lambda: recorder.state == "closed")
    assert Bag.open(stage.path).run_stop["exit"]["state"] == "done"


def go_on_until(stage, condition, first=40):
    """A source in real time: blocks after the end of the run, without a pause."""
    deadline = time.monotonic() + 20.0
    while not condition():
        assert time.monotonic() < deadline, "waited in vain"
        stage.rig.publish_block("force", first)
        first += 20
        stage.executor.spin_once(timeout_sec=0.02)
    return first


def end_with_a_lock(stage, recorder):
    """A run with a level that locked, whose end is sample 39; its source goes on."""
    rig = stage.rig
    stage.until(lambda: rig.modal_point.get_subscription_count())
    rig.publish_state(RunState.RUNNING)
    rig.publish_block("force", 0)
    rig.publish_block("force", 20)
    rig.lock.publish(LockEvent(sample=10))
    stage.until(lambda: recorder.writer.counts.get("lock") and recorder.writer.counts.get("force") == 2)
    rig.publish_state(RunState.DONE, sample=39)
    return go_on_until(stage, lambda: recorder.core.end_sample == 39)


def test_a_source_that_goes_on_does_not_keep_the_bag_open(stage, monkeypatch):
    monkeypatch.setattr("nmt_record.bag.recorder_node.LONGEST_END", 1000.0)
    recorder = stage.start()
    first = end_with_a_lock(stage, recorder)
    stage.rig.modal_point.publish(ModalPoint())
    go_on_until(stage, lambda: recorder.state == "closed", first)
    bag = Bag.open(stage.path)
    assert bag.run_stop["exit"] == {"state": "done", "reason": ""}
    assert bag.topics["modal_point"] == ("nmt_msgs/msg/ModalPoint", 1)


def test_a_late_modal_point_is_in_the_bag(stage, monkeypatch):
    """Many times the silence that ends a run passes before it comes."""
    monkeypatch.setattr("nmt_record.bag.recorder_node.LONGEST_END", 1000.0)
    recorder = stage.start(settle_time=0.01)
    first = end_with_a_lock(stage, recorder)
    end = time.monotonic() + 0.5
    first = go_on_until(stage, lambda: time.monotonic() > end, first)
    assert recorder.state == "open"
    stage.rig.modal_point.publish(ModalPoint())
    go_on_until(stage, lambda: recorder.state == "closed", first)
    assert Bag.open(stage.path).topics["modal_point"] == ("nmt_msgs/msg/ModalPoint", 1)


def test_a_modal_point_that_never_comes_does_not_keep_the_bag_open(stage, monkeypatch):
    monkeypatch.setattr("nmt_record.bag.recorder_node.LONGEST_END", 0.5)
    recorder = stage.start()
    first = end_with_a_lock(stage, recorder)
    go_on_until(stage, lambda: recorder.state == "closed", first)
    assert Bag.open(stage.path).run_stop["exit"]["state"] == "done"


def test_missing_blocks_are_given_up_after_silence(stage):
    recorder = stage.start(patience=0.3)
    stage.rig.publish_state(RunState.RUNNING)
    stage.rig.publish_block("force", 0)
    stage.until(lambda: recorder.writer.counts.get("force") and recorder.writer.counts.get("run_state"))
    stage.rig.publish_state(RunState.DONE, sample=500)
    stage.until(lambda: recorder.state == "closed")
    assert Bag.open(stage.path).run_stop["exit"] == {
        "state": "incomplete",
        "reason": "blocks up to sample 500 did not arrive",
    }


def lockstep_run(stage, **values):
    """A recorder in lockstep whose run is over; five of ten blocks have come."""
    recorder = stage.start(pacing="lockstep", patience=0.1, settle_time=0.0, **values)
    stage.rig.publish_state(RunState.RUNNING)
    for index in range(5):
        stage.rig.publish_block("force", 20 * index)
        stage.rig.publish_block("acceleration", 20 * index)
    stage.until(lambda: recorder.core.gaps.recorded == 100)
    stage.rig.publish_state(RunState.DONE, sample=199, result_code=1)
    stage.until(lambda: recorder.core.end_sample == 199)
    return recorder


def look_at(recorder, count=5):
    for _ in range(count):
        recorder.watch()


def test_in_lockstep_a_bag_waits_for_its_backlog_however_long_that_takes(stage, monkeypatch):
    recorder = lockstep_run(stage)
    now = [time.monotonic()]
    monkeypatch.setattr("nmt_record.bag.recorder_node.time.monotonic", lambda: now[0])
    now[0] += 0.9 * HANG_LIMIT
    look_at(recorder)
    assert recorder.state == "open"
    for index in range(5, 10):
        stage.rig.publish_block("force", 20 * index)
        stage.rig.publish_block("acceleration", 20 * index)
    stage.until(lambda: recorder.core.gaps.recorded == 200)
    look_at(recorder)
    assert recorder.state == "closed"
    assert Bag.open(stage.path).loss is None


def test_in_lockstep_a_bag_without_its_plant_says_what_it_lacks(stage, monkeypatch):
    recorder = lockstep_run(stage)
    monkeypatch.setattr(type(recorder), "_plant_is_there", property(lambda _: False))
    now = [time.monotonic() + 0.2]
    monkeypatch.setattr("nmt_record.bag.recorder_node.time.monotonic", lambda: now[0])
    look_at(recorder)
    assert recorder.state == "closed"
    bag = Bag.open(stage.path)
    assert bag.run_stop["exit"]["state"] == "incomplete"
    assert bag.run_stop["lacks_s"] == pytest.approx(0.1)
    assert "lacks 0.100 s of bench time" in bag.loss
    stage.until(lambda: stage.rig.bag_states[-1]["lacks_s"] == pytest.approx(0.1))


def test_in_lockstep_the_points_that_the_sequencer_waits_for_are_in_the_bag(stage, monkeypatch):
    recorder = lockstep_run(stage)
    for index in range(5, 10):
        stage.rig.publish_block("force", 20 * index)
        stage.rig.publish_block("acceleration", 20 * index)
    stage.until(lambda: recorder.core.gaps.recorded == 200)
    recorder.goal, recorder.announced = "ab", RunAnnouncement("ab", "run-7")
    monkeypatch.setattr(recorder, "count_publishers", lambda _: 1)
    look_at(recorder)
    assert recorder.state == "open"
    recorder.announced = RunAnnouncement()
    look_at(recorder)
    assert recorder.state == "closed"


def test_how_far_the_bag_is_is_told(stage):
    told = []
    stage.rig.create_subscription(UInt64, "recorded", lambda message: told.append(message.data), STATE_QOS)
    stage.start(pacing="lockstep")
    for index in range(150):
        stage.rig.publish_block("force", 20 * index)
        stage.rig.publish_block("acceleration", 20 * index)
    stage.until(lambda: told and told[-1] == 3000)


def test_the_latched_end_of_an_earlier_run_is_not_ours(stage):
    stage.rig.publish_state(RunState.DONE, sample=0, run_id="run-6")
    recorder = stage.start(settle_time=0.0)
    stage.until(lambda: recorder.writer.counts.get("run_state"))
    for _ in range(10):
        stage.executor.spin_once(timeout_sec=0.05)
    assert recorder.state == "open"
    stage.rig.publish_state(RunState.DONE, sample=0, run_id="run-7")
    stage.until(lambda: recorder.state == "closed")


def test_a_full_disk_is_reported_and_the_node_lives_on(stage, monkeypatch):
    recorder = stage.start(chunk_messages=2)

    def full():
        raise OSError(28, "No space left on device")

    stage.rig.publish_block("force", 0)
    stage.rig.publish_block("force", 20)
    stage.until(lambda: recorder.writer.counts.get("force") == 2)
    recorder.writer.flush()
    monkeypatch.setattr(recorder.writer.mcap, "flush", full)
    for index in range(2, 6):
        stage.rig.publish_block("force", 20 * index)
    stage.until(lambda: stage.rig.bag_states[-1]["state"] == "failed")
    assert "No space left on device" in stage.rig.bag_states[-1]["reason"]
    stage.until(lambda: any(s.level == DiagnosticStatus.ERROR for a in stage.rig.diagnostics for s in a.status))
    assert recorder.state == "failed"
    recorder.close()
    bag = Bag.open(stage.path)
    assert [block.first_sample for block in bag.blocks("force")] == [0, 20]
    assert "was not closed" in bag.loss


def test_topics_of_others_are_recorded_with_their_type(stage):
    recorder = stage.start(topics=["force", "lock", "acceleration", "run_state", "temperature:std_msgs/msg/Float64"])
    stage.until(lambda: stage.rig.extra.get_subscription_count())
    stage.rig.extra.publish(Float64(data=21.5))
    stage.rig.drive.publish(Drive())
    stage.until(lambda: recorder.writer.counts.get("temperature"))
    recorder.close()
    bag = Bag.open(stage.path)
    assert [message.data for _, _, message in bag.messages(["temperature"])] == [21.5]
    assert "drive" not in bag.topics


def test_destroying_the_node_closes_the_bag(stage):
    stage.start()
    stage.executor.remove_node(stage.recorder)
    stage.recorder.destroy_node()
    stage.recorder = None
    bag = Bag.open(stage.path)
    assert bag.loss is None
    assert bag.run_stop["exit"]["reason"] == "the recorder was told to end"


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        ({"output": ""}, "must name the folder"),
        ({"topics": ["forze"]}, "'forze' is not one of the bench"),
        ({"topics": ["a:b"]}, "must be written as"),
        ({"topics": ["a:nobody_msgs/msg/None"]}, "nobody_msgs/msg/None is not installed"),
        ({"run_json": "{"}, "not JSON"),
        ({"run_json": "", "run_file": "/nowhere/run.json"}, "cannot be read"),
        ({"rig_file": "/nowhere/rig.yaml"}, "exclude each other"),
        ({"chunk_messages": 0}, "at least 1"),
        ({"flush_interval": -1.0}, "at least 0.01"),
        ({"folder": "x"}, "not known to recorder"),
    ],
)
def test_wrong_parameters_are_refused_and_leave_nothing(stage, values, sentence):
    given = {"output": str(stage.path), "run_json": "{}", "rig_yaml": "a", **values}
    with pytest.raises(BenchError, match=sentence):
        RecorderNode(settings_of(RecorderSettings, given, "recorder"), context=stage.context)
    assert not stage.path.exists()


@pytest.mark.parametrize(
    ("number", "whole"),
    with_quick(
        [(signal.SIGINT, True), (signal.SIGTERM, True), (signal.SIGKILL, False)],
        (signal.SIGTERM, True),
        (signal.SIGKILL, False),
    ),
)
def test_the_executable_under_signals(stage, number, whole):
    process = subprocess.Popen(
        [
            *(sys.executable, "-c", "import sys; from nmt_record.bag.recorder_node import main; sys.exit(main())"),
            *("--ros-args", "-p", f"output:={stage.path}"),
        ],
        env={**os.environ, "ROS_DOMAIN_ID": str(DOMAIN)},
    )
    try:
        stage.until(lambda: stage.rig.blocks["force"].get_subscription_count())
        stage.until(lambda: stage.rig.bag_states)
        for index in range(10):
            stage.rig.publish_block("force", 20 * index)
        # On disk without any help: the flush interval has passed.
        stage.until(lambda: Bag.open(stage.path).topics.get("force", ("", 0))[1] == 10)
        process.send_signal(number)
        assert process.wait(timeout=30) == (0 if whole else -number)
    finally:
        if process.poll() is None:
            process.kill()
            process.wait()
    bag = Bag.open(stage.path)
    assert [block.first_sample for block in bag.blocks("force")] == list(range(0, 200, 20))
    if whole:
        assert bag.run_stop["exit"]["state"] == "interrupted"
    else:
        # Without run_json there is a start record all the same, and no stop record.
        assert "last sample in it is 199" in bag.loss
