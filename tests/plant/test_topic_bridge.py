"""Stamped messages become blocks on an even grid; what is missing stays missing."""

from __future__ import annotations

import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_core.messages.named_elements import what_a_type_lacks
from nmt_plant.topic_bridge import TopicBridge
from nmt_plant.topic_bridge_table import BridgeTable, read_channel_table

TABLE = """
sample_rate: 1000
block_samples: 50
channels:
  - {topic: /imu, type: sensor_msgs/msg/Imu, field: linear_acceleration.z, quantity: acceleration, point: 3}
  - {topic: forces, type: std_msgs/msg/Float64MultiArray, field: data.2, quantity: force, point: 1, scale: 4.448}
"""
BEGIN = 1_764_064_800_000_000_000  # ns


@pytest.fixture
def table(tmp_path: Path) -> BridgeTable:
    (tmp_path / "table.yaml").write_text(TABLE)
    return read_channel_table(tmp_path / "table.yaml")


def wave(time: np.ndarray | float) -> Any:
    return np.sin(2.0 * math.pi * 37.0 * time + 0.4)


def imu(time: float, value: float | None = None) -> Any:
    stamp = BEGIN + round(1e9 * time)
    own = float(wave(time)) if value is None else value
    return SimpleNamespace(
        header=SimpleNamespace(stamp=SimpleNamespace(sec=stamp // 10**9, nanosec=stamp % 10**9)),
        linear_acceleration=SimpleNamespace(x=0.0, y=0.0, z=own),
    )


def forces(time: float) -> Any:
    return SimpleNamespace(data=np.array([0.0, 2.0 * float(wave(time))]))


def fed(bridge: TopicBridge, imu_times: np.ndarray, force_times: np.ndarray) -> list[Any]:
    """All blocks of messages in the order of their times; forces have no stamp but come at once."""
    blocks = []
    events = sorted([(t, "/imu") for t in imu_times] + [(t, "/forces") for t in force_times])
    for time, topic in events:
        message = imu(time) if topic == "/imu" else forces(time)
        bridge.add(topic, message, BEGIN + round(1e9 * time))
        blocks += bridge.take()
    return blocks


def joined(blocks: list[Any], quantity: Quantity) -> tuple[np.ndarray, np.ndarray]:
    """Sample indices and values of one quantity."""
    own = [block for block in blocks if block.quantity is quantity]
    index = np.concatenate([np.arange(block.first_sample, block.end_sample) for block in own])
    return index, np.concatenate([block.data[0] for block in own])


def test_the_table_is_read(table: BridgeTable) -> None:
    imu_channel, force = table.channels
    assert (imu_channel.name, imu_channel.quantity, imu_channel.point) == ("a3", Quantity.ACCELERATION, 3)
    assert (force.topic, force.name, force.scale) == ("/forces", "f1", 4.448)
    assert table.topics == {"/imu": "sensor_msgs/msg/Imu", "/forces": "std_msgs/msg/Float64MultiArray"}


def test_two_topics_with_rates_of_their_own_lie_on_one_grid(table: BridgeTable) -> None:
    random = np.random.default_rng(1)
    imu_times = np.arange(4000) / 2000.0 + random.uniform(-1, 1, 4000) * 1e-4
    blocks = fed(TopicBridge(table), imu_times, np.arange(1600) / 801.3)
    begin = max(imu_times[0], 0.0)
    for quantity, factor in ((Quantity.ACCELERATION, 1.0), (Quantity.FORCE, 2.0 * 4.448)):
        index, values = joined(blocks, quantity)
        assert index.tolist() == list(range(index[-1] + 1))
        assert index.size > 1800
        good = np.isfinite(values)
        assert good[20:].all()
        # The cubic through four samples of a sine: its error is 3/128 (ω Δt)⁴.
        bound = 1.5 * 3.0 / 128.0 * (2.0 * math.pi * 37.0 / 801.3) ** 4 + 2e-5
        assert np.abs(values - factor * wave(begin + index / 1000.0))[good].max() < factor * bound


def test_what_is_missing_is_marked(table: BridgeTable) -> None:
    imu_times = np.arange(4000) / 2000.0
    imu_times = np.delete(imu_times, slice(1000, 1100))
    bridge = TopicBridge(table)
    blocks = fed(bridge, imu_times, np.arange(2000) / 1000.0)
    index, values = joined(blocks, Quantity.ACCELERATION)
    missing = index[np.isnan(values)]
    assert missing[0] == 500
    assert missing[-1] == 549
    assert missing.size == 50
    assert bridge.missing == 50


def test_a_silent_topic_does_not_hold_up_the_others(table: BridgeTable) -> None:
    bridge = TopicBridge(table, patience=0.2)
    blocks = fed(bridge, np.arange(1000) / 2000.0, np.arange(2000) / 1000.0)
    _, values = joined(blocks, Quantity.ACCELERATION)
    assert np.isfinite(values[:490]).all()
    assert np.isnan(values[510:]).all()
    assert joined(blocks, Quantity.FORCE)[0][-1] > 1700


def test_where_nothing_comes_there_is_no_block(table: BridgeTable) -> None:
    times = np.concatenate([np.arange(500), np.arange(3500, 4200)]) / 1000.0
    index, _ = joined(fed(TopicBridge(table), times, times), Quantity.FORCE)
    steps = np.diff(index)
    assert steps.max() > 2900
    assert index[-1] > 4000


def test_a_delay_is_taken_off(tmp_path: Path) -> None:
    (tmp_path / "table.yaml").write_text(TABLE.replace("point: 3}", "point: 3, delay_s: 0.0125}"))
    bridge = TopicBridge(read_channel_table(tmp_path / "table.yaml"))
    blocks = fed(bridge, np.arange(2000) / 1000.0, np.arange(2000) / 1000.0)
    index, values = joined(blocks, Quantity.ACCELERATION)
    good = np.isfinite(values)
    assert np.abs(values - wave(index / 1000.0 + 0.0125))[good].max() < 1e-3


def test_stamps_that_do_not_rise_are_counted(table: BridgeTable) -> None:
    bridge = TopicBridge(table)
    for time in (0.0, 0.001, 0.001, 0.0005, 0.002):
        bridge.add("/imu", imu(time), BEGIN)
    assert bridge.late == 2


@pytest.mark.parametrize(
    ("name", "unit", "topic"),
    [
        ("angle", "rad", "displacement"),
        ("angular_velocity", "rad/s", "velocity"),
        ("angular_acceleration", "rad/s^2", "acceleration"),
        ("torque", "N*m", "force"),
    ],
)
def test_what_turns_has_its_unit_on_the_topic_of_what_moves(name: str, unit: str, topic: str, tmp_path: Path) -> None:
    other = "force" if topic == "force" else "acceleration"
    (tmp_path / "table.yaml").write_text(TABLE.replace(f"quantity: {other}", f"quantity: {name}"))
    bridge = TopicBridge(read_channel_table(tmp_path / "table.yaml"))
    blocks = fed(bridge, np.arange(2000) / 1000.0, np.arange(2000) / 1000.0)
    assert {block.unit for block in blocks if block.quantity.topic == topic} == {unit}
    assert all(block.quantity.accepts(block.unit) for block in blocks)


def test_beside_a_plant_its_sample_index_is_taken(table: BridgeTable) -> None:
    random = np.random.default_rng(2)
    bridge = TopicBridge(table, with_plant=True)
    blocks = []
    # The plant's sample 0 was 7.3 s before the first message; its blocks come at least 4 ms late.
    for k in range(2000):
        time = k / 1000.0
        if k % 20 == 0:
            late = 0.004 + float(random.exponential(0.003))
            bridge.add_reference(7300 + k, 1000.0, BEGIN + round(1e9 * (time + late)))
        bridge.add("/imu", imu(time), BEGIN + round(1e9 * time))
        bridge.add("/forces", forces(time), BEGIN + round(1e9 * time))
        blocks += bridge.take()
    index, values = joined(blocks, Quantity.ACCELERATION)
    assert index[0] >= 7300
    late = index > 8000
    assert np.nanmax(np.abs(values - wave((index - 7300) / 1000.0 + 0.004))[late]) < 0.1


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("sample_rate: 1000", "sample_rate: fast", "line 2: sample_rate must be a number"),
        ("quantity: force", "quantity: strength", "quantity must be one of force"),
        ("quantity: force", "quantity: angular_acceleration", "topic acceleration, which has one unit"),
        ("std_msgs/msg/Float64MultiArray", "Float64MultiArray", "type must be written as package/msg/Name"),
        ("field: data.2, ", "", "'field' of the channel is missing"),
        ("scale: 4.448", "gain: 4.448", "'gain' is not known"),
        ("point: 1, scale: 4.448", "point: 1, name: a3", "two channels are named a3"),
        ("topic: forces", "topic: /imu", "topic /imu has two types"),
    ],
)
def test_a_wrong_table_is_refused_with_its_line(old: str, new: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "table.yaml").write_text(TABLE.replace(old, new))
    with pytest.raises(BenchError, match=words):
        read_channel_table(tmp_path / "table.yaml")


JOINT_TABLE = """
sample_rate: 200
block_samples: 10
channels:
  - {topic: /joints, type: sensor_msgs/msg/JointState, field: position.elbow, quantity: displacement, point: 1}
"""


def stamped(stamp: int, **fields: Any) -> Any:
    head = SimpleNamespace(stamp=SimpleNamespace(sec=stamp // 10**9, nanosec=stamp % 10**9))
    return SimpleNamespace(header=head, **fields)


def bridge_of(folder: Path, text: str = JOINT_TABLE, patience: float = 0.5) -> TopicBridge:
    (folder / "table.yaml").write_text(text)
    return TopicBridge(read_channel_table(folder / "table.yaml"), patience)


def run(bridge: TopicBridge, messages: list[tuple[str, int, Any]]) -> tuple[list[Any], list[str]]:
    """Blocks and sentences of messages: topic, arrival (ns), message."""
    blocks, sentences = [], []
    for topic, arrived, message in messages:
        bridge.add(topic, message, arrived)
        blocks += bridge.take()
        sentences += bridge.watch.findings(arrived)
    return blocks, sentences


def joints(count: int, offset: int = 0, zero: int = 0) -> list[tuple[str, int, Any]]:
    """Two joints whose order changes; the elbow is a ramp of 1/s."""
    messages = []
    for k in range(count):
        stamp = 0 if k < zero else BEGIN + offset + 5_000_000 * k
        names, values = ["elbow", "wrist"], [k / 200.0, -7.0]
        if k % 3:
            names, values = names[::-1], values[::-1]
        messages.append(("/joints", BEGIN + 5_000_000 * k, stamped(stamp, name=names, position=np.array(values))))
    return messages


def test_a_joint_is_taken_by_its_name(tmp_path: Path) -> None:
    blocks, sentences = run(bridge_of(tmp_path), joints(100))
    index, values = joined(blocks, Quantity.DISPLACEMENT)
    assert values == pytest.approx(index / 200.0, abs=1e-9)
    assert sentences == []


def test_a_joint_that_does_not_come_is_named(tmp_path: Path) -> None:
    _, sentences = run(bridge_of(tmp_path, JOINT_TABLE.replace("elbow", "knee")), joints(100))
    assert "gives nothing for channel x1: position has no element knee; it has wrist, elbow" in " ".join(sentences)


@pytest.mark.parametrize("offset", [0, 5 * 10**9 - BEGIN])
def test_stamps_of_zero_before_others_are_left_out_with_a_sentence(tmp_path: Path, offset: int) -> None:
    bridge = bridge_of(tmp_path)
    blocks, sentences = run(bridge, joints(100, offset, zero=3))
    index, values = joined(blocks, Quantity.DISPLACEMENT)
    assert values == pytest.approx((index + 3) / 200.0, abs=1e-6)
    assert bridge.late == 0
    assert sentences == ["Messages of /joints have a stamp of zero; they are left out."]


def test_messages_that_never_have_a_stamp_are_placed_by_their_arrival(tmp_path: Path) -> None:
    blocks, sentences = run(bridge_of(tmp_path), joints(400, zero=400))
    assert joined(blocks, Quantity.DISPLACEMENT)[1].size > 200
    assert any("placed by their arrival" in sentence for sentence in sentences)


def test_stamps_that_are_set_back_go_on_with_a_sentence(tmp_path: Path) -> None:
    messages = joints(100) + [(topic, at + 500_000_000, message) for topic, at, message in joints(100, -3 * 10**9)]
    blocks, sentences = run(bridge_of(tmp_path), messages)
    assert any("were set back by" in sentence for sentence in sentences)
    index, values = joined(blocks, Quantity.DISPLACEMENT)
    assert index[-1] > 150
    late = index > 125
    assert values[late] == pytest.approx(index[late] / 200.0 - 0.5, abs=2e-3)


TWO = (
    JOINT_TABLE
    + "  - {topic: /acc, type: geometry_msgs/msg/AccelStamped, field: accel.z, quantity: acceleration, point: 1}\n"
)


def test_clocks_that_count_from_different_times_are_said(tmp_path: Path) -> None:
    both = [
        one
        for k, joint in enumerate(joints(1000))
        for one in (joint, ("/acc", joint[1], stamped(5 * 10**9 + 5_000_000 * k, accel=SimpleNamespace(z=1.0))))
    ]
    _, sentences = run(bridge_of(tmp_path, TWO), both)
    assert any("count from different times" in sentence and "clock: arrival" in sentence for sentence in sentences)
    blocks, sentences = run(bridge_of(tmp_path, TWO.replace("sample_rate", "clock: arrival\nsample_rate", 1)), both)
    assert np.isfinite(joined(blocks, Quantity.ACCELERATION)[1]).all()
    assert sentences == []


def test_a_silent_topic_is_named_where_no_block_can_be_made(tmp_path: Path) -> None:
    bridge = bridge_of(tmp_path, TWO)
    bridge.add("/acc", stamped(BEGIN, accel=SimpleNamespace(z=1.0)), BEGIN)
    assert bridge.watch.findings(BEGIN + 10**9) == []
    (sentence,) = bridge.watch.findings(BEGIN + 2 * 10**9)
    assert sentence == "No block could be made yet: nothing that can be used came on /joints."


def test_samples_that_are_mostly_missing_are_said(tmp_path: Path) -> None:
    messages = []
    for k, (topic, _, message) in enumerate(joints(1000)):
        at = BEGIN + (k // 10 + 1) * 50_000_000 + (k % 10) * 30_000  # bursts, stamped on arrival
        message.header.stamp = SimpleNamespace(sec=at // 10**9, nanosec=at % 10**9)
        messages.append((topic, at, message))
    _, sentences = run(bridge_of(tmp_path), messages)
    assert any("of the samples of channel x1 are missing" in sentence for sentence in sentences)


TYPES = {
    "a/msg/Stamped": {"header": "std_msgs/Header", "accel": "a/Accel", "label": "string", "all": "sequence<a/Named>"},
    "std_msgs/msg/Header": {"frame_id": "string"},
    "a/msg/Accel": {"linear": "double", "many": "double[9]", "few": "sequence<double, 4>"},
    "a/msg/Named": {"name": "string", "accel": "a/Accel"},
}


@pytest.mark.parametrize(
    ("path", "words"),
    [
        ("accel.linear", ""),
        ("accel.many.3", ""),
        ("accel.few.left arm.2", ""),
        ("all.tip.of.it.accel.linear", ""),
        ("acc.linear", "a/msg/Stamped has no field 'acc'; it has header, accel, label, all"),
        ("accel.angular", "a/msg/Accel has no field 'angular'"),
        ("accel", "a/msg/Accel has no number of its own"),
        ("label", "is a string and is not a number"),
        ("accel.linear.x", "is a double and has no 'x'"),
        ("accel.many", "is an array; name one of its elements"),
        ("all.tip.accel.angular", "no field"),
    ],
)
def test_what_a_type_lacks_is_known_from_the_type(path: str, words: str) -> None:
    lack = what_a_type_lacks(path, "a/msg/Stamped", lambda kind: TYPES[kind])
    assert words in lack
    assert bool(words) == bool(lack)
