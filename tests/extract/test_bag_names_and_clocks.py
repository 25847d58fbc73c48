"""What bags of others name and how their clocks fail: each is read right, or asked about in one sentence."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from mcap.writer import Writer as McapWriter
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from nmt_core.errors import BenchError
from nmt_extract.decays.free_decay import free_decays
from nmt_record.bag.bag_reader import Bag
from nmt_record.exchange.clocks.message_clock import ClockChoice
from nmt_record.exchange.imports.imported_run import ImportedRun, read_import, write_import
from nmt_record.exchange.messages.ros_bag_table import bag_tables, read_bag
from nmt_record.exchange.templates.sidecar_template import sidecar_templates

BEGIN = 1_764_064_800_000_000_000  # ns
STORE = get_typestore(Stores.ROS2_JAZZY)
for text, name in (
    ("float64 x\nint32 n\n", "lab_msgs/msg/Probe"),
    ("uint64 timestamp\nfloat64 time_constant\nfloat64 t\nfloat64 value\n", "lab_msgs/msg/Own"),
    ("std_msgs/Header header\nuint8[] ids\nfloat32[] load\n", "lab_msgs/msg/Loads"),
    ("std_msgs/Header header\nstring[] axes\nlab_msgs/Own[] state\n", "lab_msgs/msg/Axes"),
    ("std_msgs/Header header\nuint32 sec\nuint32 nanosec\nfloat64 value\n", "lab_msgs/msg/Parted"),
):
    STORE.register(get_types_from_msg(text, name))
T = STORE.types
Rows = Iterable[tuple[float, Any]]
"""Time of reception (s) and message."""


def decay(time: float | np.ndarray, frequency: float = 6.0, damping: float = 0.015) -> Any:
    omega = 2.0 * math.pi * frequency
    return np.exp(-damping * omega * time) * np.cos(omega * math.sqrt(1.0 - damping**2) * time)


def head(time: float | None, frame: str = "") -> Any:
    stamp = 0 if time is None else BEGIN + round(1e9 * time)
    return T["std_msgs/msg/Header"](T["builtin_interfaces/msg/Time"](stamp // 10**9, stamp % 10**9), frame)


def joints(time: float | None, values: dict[str, float], effort: bool = True) -> Any:
    position = np.array(list(values.values()))
    return T["sensor_msgs/msg/JointState"](
        head(time), list(values), position, np.full(position.size, np.nan), 3.0 * position if effort else np.zeros(0)
    )


def point(time: float | None, value: float, frame: str = "") -> Any:
    return T["geometry_msgs/msg/PointStamped"](head(time, frame), T["geometry_msgs/msg/Point"](value, 0.0, 1.0))


def bag_of(folder: Path, topics: dict[str, Rows], plugin: StoragePlugin = StoragePlugin.MCAP) -> Path:
    path = folder / "bag"
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        every = []
        for topic, rows in topics.items():
            rows = list(rows)
            connection = writer.add_connection(topic, rows[0][1].__msgtype__, typestore=STORE)
            every += [(at, connection, message) for at, message in rows]
        for at, connection, message in sorted(every, key=lambda one: one[0]):
            writer.write(connection, BEGIN + round(1e9 * at), STORE.serialize_cdr(message, message.__msgtype__))
    return path


def imported(bag: Path, column: str, **keys: Any) -> ImportedRun:
    values = {"file": bag.name, "channels": [{"column": column, "quantity": "displacement", "unit": "m", "point": 1}]}
    path = bag.with_name("sidecar.yaml")
    path.write_text(yaml.safe_dump({**values, **keys}))
    return read_import(path)


def decays(run: ImportedRun) -> list[tuple[float, float]]:
    """Frequency and damping of each decay."""
    folder = run.path.with_name("out")
    write_import(run, folder, "", "", {})
    found = free_decays(Bag.open(folder))
    assert all(one.reason == "" for one in found)
    return [(one.mean("frequency_hz")[0], one.mean("damping_ratio")[0]) for one in found]


def check(run: ImportedRun, frequency: float = 6.0, damping: float = 0.015) -> None:
    for found in decays(run):
        assert found == (pytest.approx(frequency, rel=1e-3), pytest.approx(damping, rel=0.03))


RING = {"segments": [{"kind": "ring_down", "start": 0.0, "stop": 3.9}]}
TIMES = np.arange(2000) / 500.0

# --- names -----------------------------------------------------------------------------------------------------------


def test_joints_keep_their_columns_when_their_order_changes(tmp_path: Path) -> None:
    def rows() -> Rows:
        for k, t in enumerate(TIMES):
            pair = {"a": float(decay(t, 3.0)), "b": float(decay(t))}
            yield t, joints(t, dict(reversed(pair.items())) if k > 900 else pair)

    run = imported(bag_of(tmp_path, {"/joint_states": rows()}), "/joint_states.position.b", **RING)
    assert (run.channels[0].data == decay(TIMES)).all()
    check(run)


@pytest.mark.parametrize("first", ["arm", "gripper"])
def test_joints_in_messages_of_their_own_have_a_clock_of_their_own(first: str, tmp_path: Path) -> None:
    late = 0.0051 if first == "arm" else 0.0
    arm = [(t + 0.003, joints(t + 0.003, {"a1": float(decay(t)), "a2": 0.7})) for t in TIMES]
    gripper = [(k / 30 + late, joints(k / 30 + late, {"finger": 0.02 + 1e-3 * k})) for k in range(118)]
    bag = bag_of(tmp_path, {"/joint_states": [*arm, *gripper]})
    tables = bag_tables(bag)
    assert [round(1.0 / table.step) for table in tables] == [500, 30]
    assert "/joint_states.position.a1" in tables[0].names
    assert tables[1].names == ("/joint_states.position.finger", "/joint_states.effort.finger")
    check(imported(bag, "/joint_states.position.a1", **RING))


def test_two_publishers_on_one_topic_are_two_recordings(tmp_path: Path) -> None:
    rows = [
        (t + late, joints(t + late, {side: float(decay(t + late, frequency))}))
        for t in TIMES
        for side, late, frequency in (("l1", 0.0, 3.0), ("r1", 0.0007, 6.0))
    ]
    bag = bag_of(tmp_path, {"/joint_states": rows})
    run = imported(bag, "/joint_states.position.r1", **RING)
    assert (run.sample_rate, run.samples) == (500.0, 2000)
    check(run)


def test_a_name_that_comes_later_has_holes_before(tmp_path: Path) -> None:
    def rows() -> Rows:
        for k, t in enumerate(TIMES):
            values = {"a": float(decay(t, 3.0)), **({"b": float(decay(t))} if k >= 500 and not 800 <= k < 900 else {})}
            yield t, joints(t, values, effort=k >= 100)

    (table,) = bag_tables(bag_of(tmp_path, {"/joint_states": rows()}))
    missing = {name: np.flatnonzero(np.isnan(table.columns[table.names.index(name)])) for name in table.names}
    assert not missing["/joint_states.position.a"].size
    assert missing["/joint_states.position.b"].tolist() == [*range(500), *range(800, 900)]
    assert missing["/joint_states.effort.a"].tolist() == list(range(100))


def test_bodies_of_transforms_have_columns_by_their_frames(tmp_path: Path) -> None:
    vector, turn = T["geometry_msgs/msg/Vector3"], T["geometry_msgs/msg/Quaternion"]

    def frame(t: float, name: str, value: float) -> Any:
        body = T["geometry_msgs/msg/Transform"](vector(value, 0.0, 0.0), turn(0.0, 0.0, 0.0, 1.0))
        return T["geometry_msgs/msg/TransformStamped"](head(t, "world"), name, body)

    def rows() -> Rows:
        for k, t in enumerate(TIMES):
            both = [frame(t, "tip", float(decay(t))), frame(t - 0.001, "base link", float(decay(t, 3.0)))]
            yield t, T["tf2_msgs/msg/TFMessage"](both[:: -1 if k % 2 else 1])
            if k % 50 == 0:
                yield t, T["tf2_msgs/msg/TFMessage"]([frame(t, "camera", 1.0)])

    bag = bag_of(tmp_path, {"/tf": rows()})
    check(imported(bag, "/tf.transforms.tip.transform.translation.x", **RING))
    slow = [round(1.0 / table.step) for table in bag_tables(bag) if "camera" in table.names[0]]
    assert slow == [10]


def test_pairs_ids_and_nested_names_make_columns(tmp_path: Path) -> None:
    pair, status = T["diagnostic_msgs/msg/KeyValue"], T["diagnostic_msgs/msg/DiagnosticStatus"]

    def diagnostics(t: float, k: int) -> Any:
        values = [pair("current", f"{decay(t):.9f}"), pair("mode", "auto"), pair("speed", f"{k}")]
        both = [status(0, "motor 1", "", "", values[:: 1 if k % 2 else -1]), status(0, "motor 2", "", "", values[2:])]
        return T["diagnostic_msgs/msg/DiagnosticArray"](head(t), both[:: 1 if k % 3 else -1])

    def loads(t: float, k: int) -> Any:
        order = slice(None, None, 1 if k % 3 else -1)
        ids, load = np.array([4, 7], np.uint8)[order], np.array([decay(t), 2.0], np.float32)[order]
        return T["lab_msgs/msg/Loads"](head(t), ids.copy(), load.copy())

    def axes(t: float, k: int) -> Any:
        state = [T["lab_msgs/msg/Own"](0, 0.1, 0.0, value) for value in (float(decay(t)), 5.0)]
        order = slice(None, None, 1 if k % 2 else -1)
        return T["lab_msgs/msg/Axes"](head(t), ["x", "y"][order], state[order])

    makers: dict[str, Callable[[float, int], Any]] = {"/diagnostics": diagnostics, "/loads": loads, "/axes": axes}
    bag = bag_of(tmp_path, {topic: [(t, make(t, k)) for k, t in enumerate(TIMES)] for topic, make in makers.items()})
    for column in ("/diagnostics.status.motor 1.values.current", "/loads.load.4", "/axes.state.x.value"):
        table = read_bag(bag, [column])
        assert table.columns[table.names.index(column)] == pytest.approx(decay(TIMES), abs=1e-6)
    assert not any("mode" in name for name in read_bag(bag, ["/diagnostics.status.motor 1.values.speed"]).names)


def test_labels_of_a_layout_and_frames_that_change_name_columns(tmp_path: Path) -> None:
    dimension, layout = T["std_msgs/msg/MultiArrayDimension"], T["std_msgs/msg/MultiArrayLayout"]

    def labelled(k: int, t: float) -> Any:
        names, values = ["left", "right"], [float(decay(t)), 9.0]
        if k % 2:
            names, values = names[::-1], values[::-1]
        return T["std_msgs/msg/Float64MultiArray"](layout([dimension(n, 1, 1) for n in names], 0), np.array(values))

    alternating = [(t + late, point(t + late, float(decay(t, f)), name)) for t in TIMES for name, f, late in
                   (("tip", 6.0, 0.0), ("root", 3.0, 0.0007))]  # fmt: skip
    bag = bag_of(tmp_path, {"/loads": [(t, labelled(k, t)) for k, t in enumerate(TIMES)], "/points": alternating})
    table = read_bag(bag, ["/loads.data.left"])
    assert (table.columns[table.names.index("/loads.data.left")] == decay(TIMES)).all()
    check(imported(bag, "/points.tip.point.x", **RING))
    with pytest.raises(BenchError, match=r"has no column /points\.point\.x; topic /points has /points\.tip\.point\.x"):
        read_bag(bag, ["/points.point.x"])


def test_a_type_without_a_definition_is_left_out_and_named(tmp_path: Path) -> None:
    path = tmp_path / "bag.mcap"
    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.start(profile="ros2", library="")
        text = STORE.generate_msgdef("geometry_msgs/msg/PointStamped", ros_version=2)[0].encode()
        keys = [
            writer.register_channel(topic, "cdr", writer.register_schema(kind, "ros2msg", content))
            for topic, kind, content in (
                ("/tip", "geometry_msgs/msg/PointStamped", text),
                ("/camera", "lab_msgs/msg/Unknown", b""),
            )
        ]
        for t in TIMES:
            message = point(t, float(decay(t)))
            at = BEGIN + round(1e9 * t)
            writer.add_message(keys[0], at, bytes(STORE.serialize_cdr(message, message.__msgtype__)), at)
            writer.add_message(keys[1], at, b"\0\1\0\0abcd", at)
        writer.finish()
    run = imported(path, "/tip.point.x", **RING)
    check(run)
    (text_of_tip,) = sidecar_templates(path)
    assert "Topic /camera (lab_msgs/msg/Unknown, 2000 messages) was left out" in text_of_tip
    with pytest.raises(BenchError, match=r"/camera .*was left out: .*lab_msgs/msg/Unknown is not on this machine"):
        read_bag(path, ["/camera.x"])


@pytest.mark.parametrize(
    ("other", "encoding", "why"), [("/tf", "json", "'json' messages"), ("/mixed", "cdr", "two types")]
)
def test_a_topic_that_cannot_be_read_leaves_the_others(other: str, encoding: str, why: str, tmp_path: Path) -> None:
    path = tmp_path / "bag.mcap"
    kinds = ("geometry_msgs/msg/PointStamped", "lab_msgs/msg/Probe")
    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.start(profile="ros2", library="")
        schemas = [
            writer.register_schema(kind, "ros2msg", STORE.generate_msgdef(kind, ros_version=2)[0].encode())
            for kind in kinds
        ]
        tip = writer.register_channel("/tip", "cdr", schemas[0])
        others = [writer.register_channel(other, encoding, schema) for schema in schemas]
        for t in TIMES:
            message = point(t, float(decay(t)))
            at = BEGIN + round(1e9 * t)
            raw = bytes(STORE.serialize_cdr(message, message.__msgtype__))
            for channel in (tip, *others):
                writer.add_message(channel, at, raw, at)
        writer.finish()
    check(imported(path, "/tip.point.x", **RING))
    (text_of_tip,) = sidecar_templates(path)
    assert why in text_of_tip
    with pytest.raises(BenchError, match=why):
        read_bag(path, [f"{other}.x"])


def test_a_definition_in_idl_is_read(tmp_path: Path) -> None:
    text = (
        "=" * 80 + "\nIDL: lab_msgs/msg/Gap\nmodule lab_msgs {\n  module msg {\n    struct Gap {\n"
        "      double value;\n      long counter;\n    };\n  };\n};\n"
    )
    path = tmp_path / "bag.mcap"
    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.start(profile="ros2", library="")
        key = writer.register_channel(
            "/gap", "cdr", writer.register_schema("lab_msgs/msg/Gap", "ros2idl", text.encode())
        )
        for k, t in enumerate(TIMES):
            raw = b"\0\1\0\0" + np.float64(decay(t)).tobytes() + np.int32(k).tobytes()
            writer.add_message(key, BEGIN + round(1e9 * t), raw, BEGIN + round(1e9 * t))
        writer.finish()
    check(imported(path, "/gap.value", **RING))


# --- clocks ----------------------------------------------------------------------------------------------------------


def test_simulated_time_is_asked_about_and_taken_as_answered(tmp_path: Path) -> None:
    rows = [(2.0 * t, point(None if k < 3 else t, float(decay(t)))) for k, t in enumerate(TIMES)]
    bag = bag_of(tmp_path, {"/tip": rows})
    (text,) = sidecar_templates(bag)
    assert "By its header stamps /tip has 500 Hz, by its log times 250 Hz" in text
    assert yaml.safe_load(text)["clock"] == "?"
    with pytest.raises(BenchError, match="'clock: header' or 'clock: log'"):
        imported(bag, "/tip.point.x", **RING)
    run = imported(bag, "/tip.point.x", clock="header", **RING)
    assert any("3 zero cannot be right" in note for note in run.notes)
    check(run)
    assert imported(bag, "/tip.point.x", clock="log").sample_rate == pytest.approx(250.0)


@pytest.mark.parametrize(("place", "wrong"), [(700, 699), (700, 698), (700, 900), (700, 5000)])
def test_a_single_stamp_that_is_wrong_is_left_out(place: int, wrong: int, tmp_path: Path) -> None:
    stamps = TIMES.copy()
    stamps[place] = wrong / 500.0 + (0.0003 if wrong < 699 else 0.0)
    rows = [(t + 1e-4, point(stamp, float(decay(t)))) for t, stamp in zip(TIMES, stamps, strict=True)]
    run = imported(bag_of(tmp_path, {"/tip": rows}), "/tip.point.x")
    data = run.channels[0].data
    good = np.isfinite(data)
    assert np.flatnonzero(~good).tolist() == [place]
    assert (data[good] == decay(TIMES)[good]).all()
    assert any("1 repeated" in note or "1 set back" in note or "1 misplaced" in note for note in run.notes)


def test_a_field_that_counts_time_is_the_clock(tmp_path: Path) -> None:
    # Log times come in bursts; fields that only sound like a clock are values.
    rows = [
        (
            0.008 * (k // 4 + 1) + 3e-5 * (k % 4),
            T["lab_msgs/msg/Own"](73_000_123 + 2000 * k, 0.25, 20.0, float(decay(t))),
        )
        for k, t in enumerate(TIMES)
    ]
    bag = bag_of(tmp_path, {"/own": rows})
    (table,) = bag_tables(bag)
    assert table.names == ("/own.time_constant", "/own.t", "/own.value")
    run = imported(bag, "/own.value", **RING)
    assert (run.sample_rate, run.clock_std) == (500.0, 0.0)
    check(run)
    assert imported(bag, "/own.value", clock="log").clock_std > 0.0


def test_a_field_in_no_known_unit_is_asked_about(tmp_path: Path) -> None:
    rows = [(t, T["lab_msgs/msg/Own"](1 + 84 * k, 0.25, 20.0, float(decay(t)))) for k, t in enumerate(TIMES)]
    bag = bag_of(tmp_path, {"/own": rows})
    with pytest.raises(
        BenchError, match=r"Field timestamp of /own rises by 84 .*'clock: log', or 'time: /own.timestamp'"
    ):
        imported(bag, "/own.value")
    check(imported(bag, "/own.value", clock="log", **RING))


def test_seconds_and_nanoseconds_are_one_stamp(tmp_path: Path) -> None:
    rows = [
        (1.5 * t, T["lab_msgs/msg/Parted"](head(t), int(t), round(1e9 * (t % 1.0)), float(decay(t)))) for t in TIMES
    ]
    (table,) = bag_tables(bag_of(tmp_path, {"/parted": rows}))
    assert table.names == ("/parted.value",)


def test_a_pause_makes_two_stretches(tmp_path: Path) -> None:
    rows = [(t + begin, point(t + begin, float(decay(t)))) for begin in (0.0, 50.0) for t in TIMES]
    bag = bag_of(tmp_path, {"/tip": rows})
    (text,) = sidecar_templates(bag)
    segments = yaml.safe_load(text)["segments"]
    assert [segment["start"] for segment in segments] == [0, 50]
    path = tmp_path / "both.yaml"
    path.write_text(text)
    run = read_import(path)
    assert any("/tip of bag has 2 stretches" in note for note in run.notes)
    assert len(decays(run)) == 2
    second = imported(bag, "/tip.point.x", stretch=2)
    assert (second.channels[0].data == decay(TIMES)).all()
    with pytest.raises(BenchError, match="there is no stretch 3"):
        imported(bag, "/tip.point.x", stretch=3)


@pytest.mark.parametrize("jump", [-0.51, -0.05, 0.05, -7.0])
def test_a_clock_that_jumps_makes_stretches_that_the_log_times_place(jump: float, tmp_path: Path) -> None:
    rows = [(t + 2e-4, point(10.0 + t + (jump if k >= 1000 else 0.0), float(decay(t)))) for k, t in enumerate(TIMES)]
    run = imported(bag_of(tmp_path, {"/tip": rows}), "/tip.point.x")
    data = run.channels[0].data
    assert (data[:1000] == decay(TIMES[:1000])).all()
    # One sample at least stands between two stretches.
    assert (data[1001:] == decay(TIMES[1000:])).all()
    assert any("2 stretches" in note for note in run.notes)


def test_stretches_of_different_rates_are_asked_about(tmp_path: Path) -> None:
    times = [*TIMES[:1000], *(2.0 + np.arange(1, 2000) / 1000.0)]
    bag = bag_of(tmp_path, {"/tip": [(t, point(t, float(decay(t)))) for t in times]})
    with pytest.raises(BenchError, match=r"different rates.*500.*1000.*'stretch: 1' to 'stretch: 2'"):
        imported(bag, "/tip.point.x")
    assert imported(bag, "/tip.point.x", stretch=2).sample_rate == pytest.approx(1000.0)


def test_jitter_without_loss_loses_nothing(tmp_path: Path) -> None:
    random = np.random.default_rng(0)
    times = TIMES + random.normal(0.0, 3e-4, TIMES.size).clip(-8e-4, 8e-4)
    times -= times[0]
    rows = [(t + 2e-4, joints(t, {"elbow": float(decay(t))})) for t in times]
    run = imported(bag_of(tmp_path, {"/joint_states": rows}), "/joint_states.position.elbow", **RING)
    assert run.samples == TIMES.size
    assert np.isfinite(run.channels[0].data).all()
    assert run.sample_rate == pytest.approx(500.0, rel=4.0 * run.clock_std)
    assert 1e-7 < run.clock_std < 1e-4
    check(run)


def test_jitter_and_loss_are_told_apart(tmp_path: Path) -> None:
    random = np.random.default_rng(1)
    lost = np.sort(random.choice(np.arange(10, TIMES.size - 10), 60, replace=False))
    times = TIMES + random.uniform(-0.3, 0.3, TIMES.size) / 500.0
    rows = [(t, point(t, float(decay(t)))) for k, t in enumerate(times) if k not in lost]
    run = imported(bag_of(tmp_path, {"/tip": rows}), "/tip.point.x")
    assert np.flatnonzero(np.isnan(run.channels[0].data)).tolist() == lost.tolist()


def test_messages_that_came_twice_count_once(tmp_path: Path) -> None:
    rows = [(t + late, point(t, float(decay(t)))) for t in TIMES for late in (1e-4, 3e-4)]
    run = imported(bag_of(tmp_path, {"/tip": rows}), "/tip.point.x")
    assert (run.channels[0].data == decay(TIMES)).all()
    assert any("2000 messages of /tip came twice" in note for note in run.notes)


def test_stamps_that_many_messages_share_are_asked_about(tmp_path: Path) -> None:
    rows = [(t + late, point(t, float(decay(t)) + late)) for t in TIMES for late in (1e-4, 1.1e-3)]
    with pytest.raises(BenchError, match=r"2000 of 4000 .* 500 Hz, by its log times 1000 Hz.*'clock: log'"):
        imported(bag_of(tmp_path, {"/tip": rows}), "/tip.point.x")


def test_names_that_are_other_ones_in_each_message_are_no_columns(tmp_path: Path) -> None:
    def rows(changes: bool) -> Rows:
        for k, t in enumerate(TIMES):
            yield t, point(t, float(decay(t)), f"picture {k}") if not changes else joints(t, {f"joint {k}": 1.0})

    bag = bag_of(tmp_path, {"/tip": rows(False), "/joint_states": rows(True)})
    check(imported(bag, "/tip.point.x", **RING))
    with pytest.raises(BenchError, match="/joint_states was left out: names or lengths of arrays are other"):
        read_bag(bag, ["/joint_states.position.a"])


def test_topics_whose_clocks_count_from_different_times_are_asked_about(tmp_path: Path) -> None:
    wall = [(t, point(t, float(decay(t)))) for t in TIMES]
    simulated = [(t + 1e-4, point(t - 1e9, float(decay(t, 3.0)))) for t in TIMES]
    bag = bag_of(tmp_path, {"/tip": wall, "/root": simulated})
    columns = ["/tip.point.x", "/root.point.x"]
    with pytest.raises(
        BenchError, match=r"/tip and the header stamps of /root count from different times .*clock: log"
    ):
        read_bag(bag, columns)
    table = read_bag(bag, columns, ClockChoice(clock="log"))
    assert np.isfinite(table.columns[table.names.index("/root.point.x")]).mean() > 0.99


def test_a_message_that_another_topic_lost_is_a_hole_at_the_times_of_the_first(tmp_path: Path) -> None:
    slow = [(t, point(t, float(decay(t)))) for k, t in enumerate(TIMES[::2]) if k != 400]
    bag = bag_of(tmp_path, {"/tip": [(t, point(t, 1.0 + t)) for t in TIMES], "/root": slow})
    table = read_bag(bag, ["/tip.point.x", "/root.point.x"])
    column = table.columns[table.names.index("/root.point.x")]
    assert np.flatnonzero(np.isnan(column[:-2])).tolist() == [799, 800, 801]
    assert np.abs(column - decay(TIMES))[np.isfinite(column)].max() < 1e-4


def test_publishers_without_names_on_one_topic_are_said(tmp_path: Path) -> None:
    rows = [
        (t + late, point(t + late, float(decay(t, f)) + late)) for t in TIMES for late, f in ((0, 3.0), (7e-4, 6.0))
    ]
    rows = [(at, point(at, message.point.x + (5.0 if k % 2 else 0.0))) for k, (at, message) in enumerate(rows)]
    (table,) = bag_tables(bag_of(tmp_path, {"/tip": rows}))
    assert any("alternate from message to message" in note for note in table.notes)


def test_blocks_without_a_layout_are_samples_where_they_go_on(tmp_path: Path) -> None:
    random = np.random.default_rng(0)
    time = np.arange(10_000) / 2000.0
    values = decay(time, 37.0, 0.006).astype(np.float32)
    dimension, layout = T["std_msgs/msg/MultiArrayDimension"], T["std_msgs/msg/MultiArrayLayout"]

    def rows(dimensions: list[Any]) -> Rows:
        for k in range(50):
            data = values[200 * k : 200 * k + 200]
            yield 0.1 * k + random.exponential(3e-4), T["std_msgs/msg/Float32MultiArray"](layout(dimensions, 0), data)

    noise = [(0.1 * k, T["std_msgs/msg/Float32MultiArray"](layout([], 0), random.normal(size=100).astype(np.float32)))
             for k in range(50)]  # fmt: skip
    bag = bag_of(tmp_path, {"/daq": rows([dimension("samples", 200, 200)]), "/raw": rows([]), "/noise": noise})
    keys = {"segments": [{"kind": "ring_down", "start": 0.0, "stop": 4.9}]}
    for column in ("/daq.data", "/raw.data"):
        run = imported(bag, column, **keys)
        assert run.sample_rate == pytest.approx(2000.0, rel=5.0 * run.clock_std)
        ((frequency, damping),) = decays(run)
        assert (frequency, damping) == (pytest.approx(37.0, rel=5e-4), pytest.approx(0.006, rel=0.02))
        (tmp_path / "out").rename(tmp_path / f"out{column[1:4]}")
    with pytest.raises(BenchError, match=r"/noise.*says not what its elements are.*'elements: samples'"):
        imported(bag, "/noise.data.1")
    assert imported(bag, "/noise.data", elements="samples").samples == 5000
