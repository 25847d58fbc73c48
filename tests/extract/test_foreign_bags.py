"""Bags of nodes that are none of the bench's: from a proposal to frequency and damping of a decay."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from mcap.reader import make_reader
from mcap.writer import Writer as McapWriter
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from nmt_core.errors import BenchError
from nmt_core.messages.stamped_samples import interpolated
from nmt_extract.decays.free_decay import free_decays
from nmt_extract.offline import extract_bag
from nmt_record.bag.bag_reader import Bag
from nmt_record.exchange.clocks.even_grid import even_grid
from nmt_record.exchange.imports.imported_run import read_import, write_import
from nmt_record.exchange.messages.ros_bag_table import bag_tables
from nmt_record.exchange.templates.sidecar_template import sidecar_templates

RATE, FREQUENCY, DAMPING = 500.0, 20.0, 0.004
BEGIN = 1_764_064_800_000_000_000  # ns
OMEGA = 2.0 * math.pi * FREQUENCY
IMU_COLUMN = "/sensor.linear_acceleration.z"


def decay(time: np.ndarray) -> np.ndarray:
    return np.exp(-DAMPING * OMEGA * time) * np.cos(OMEGA * math.sqrt(1.0 - DAMPING**2) * time)


def store_with(text: str = "", name: str = "") -> Any:
    store = get_typestore(Stores.ROS2_JAZZY)
    if text:
        store.register(get_types_from_msg(text, name))
    return store


def header(store: Any, stamp: int) -> Any:
    time = store.types["builtin_interfaces/msg/Time"](sec=stamp // 10**9, nanosec=stamp % 10**9)
    return store.types["std_msgs/msg/Header"](stamp=time, frame_id="imu")


def imu(store: Any, stamp: int, value: float) -> Any:
    types = store.types
    vector, turn = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Quaternion"]
    none = np.zeros(9)
    return types["sensor_msgs/msg/Imu"](
        header(store, stamp), turn(0.0, 0.0, 0.0, 1.0), none, vector(0.0, 0.0, 0.0), none,
        vector(0.0, 0.0, 9.81 + value), none,
    )  # fmt: skip


def wrench(store: Any, stamp: int, value: float) -> Any:
    vector = store.types["geometry_msgs/msg/Vector3"]
    force, torque = vector(0.0, value, 0.0), vector(0.0, 0.0, 0.1 * value)
    return store.types["geometry_msgs/msg/WrenchStamped"](
        header(store, stamp), store.types["geometry_msgs/msg/Wrench"](force, torque)
    )


GAUGE = "std_msgs/Header header\nfloat32 deflection\nint32 counter\nstring state\nfloat64[3] others\n"


def gauge(store: Any, stamp: int, value: float) -> Any:
    return store.types["lab_msgs/msg/Gauge"](header(store, stamp), value * 1e-3, 7, "ok", np.array([value, 0.0, 1.0]))


def multi(store: Any, stamp: int, value: float) -> Any:
    layout = store.types["std_msgs/msg/MultiArrayLayout"]([], 0)
    return store.types["std_msgs/msg/Float64MultiArray"](layout, np.array([value, -0.5 * value]))


def write(
    folder: Path,
    message: Any,
    kind: str,
    *,
    store: Any = None,
    plugin: StoragePlugin = StoragePlugin.MCAP,
    compression: CompressionMode | None = None,
    seconds: float = 6.0,
    scatter: float = 0.0,
    late: float = 0.0,
    lost: tuple[int, ...] = (),
    shuffled: bool = False,
    more: Any = None,
) -> Path:
    """A bag of one topic: stamps that scatter because sampling does, log times that are late."""
    store = store or store_with()
    random = np.random.default_rng(4)
    count = round(seconds * RATE)
    true = np.arange(count) / RATE + scatter / RATE * random.uniform(-0.5, 0.5, count)
    values = decay(true)
    rows = [k for k in range(count) if k not in lost]
    if shuffled:
        rows = [k for first in range(0, len(rows), 40) for k in random.permutation(rows[first : first + 40])]
    writer = Writer(folder, version=9, storage_plugin=plugin)
    if compression is not None:
        writer.set_compression(compression, CompressionFormat.ZSTD)
    with writer:
        connection = writer.add_connection("/sensor", kind, typestore=store)
        for k in rows:
            stamp = BEGIN + round(1e9 * float(true[k]))
            logged = stamp + round(1e9 * late / RATE * float(random.uniform(0, 1)))
            writer.write(connection, logged, store.serialize_cdr(message(store, stamp, float(values[k])), kind))
    return folder


def answered(text: str, column: str, **answers: str) -> dict[str, Any]:
    """The proposal for one column; what nobody but the owner knows is answered."""
    values = yaml.safe_load(text)
    (channel,) = [own for own in values["channels"] if own["column"] == column]
    for key, answer in answers.items():
        assert channel[key] == "?"
        channel[key] = answer
    assert "?" not in channel.values()
    values["channels"] = [{**channel, "point": 1}]
    values["segments"] = [{"kind": "ring_down", "start": 0.0, "stop": 5.9}]
    return values


def found(bag: Path, column: str, **answers: str) -> Any:
    text = sidecar_templates(bag)[0]
    path = bag.with_name("sidecar.yaml")
    path.write_text(yaml.safe_dump(answered(text, column, **answers)))
    run = read_import(path)
    write_import(run, bag.with_name("imported"), "", "", {})
    (own,) = free_decays(Bag.open(bag.with_name("imported")))
    assert own.reason == ""
    return run, own


def check(own: Any) -> None:
    frequency, _ = own.mean("frequency_hz")
    damping, _ = own.mean("damping_ratio")
    assert frequency == pytest.approx(FREQUENCY, rel=1e-3)
    assert damping == pytest.approx(DAMPING, rel=0.02)


@pytest.mark.parametrize(
    ("scatter", "late", "shuffled", "word"),
    [(0.0, 0.0, False, ""), (0.0, 3.0, True, ""), (0.25, 0.0, False, "interpolated at even times")],
)
def test_an_imu_in_mcap(tmp_path: Path, scatter: float, late: float, shuffled: bool, word: str) -> None:
    bag = write(tmp_path / "imu", imu, "sensor_msgs/msg/Imu", scatter=scatter, late=late, shuffled=shuffled)
    run, own = found(bag, "/sensor.linear_acceleration.z")
    check(own)
    assert run.sample_rate == pytest.approx(RATE, rel=1e-4)
    assert word in " ".join(run.notes)
    assert ("scatter by" in " ".join(run.notes)) == (scatter > 0.0)


def test_a_wrench_in_a_compressed_database(tmp_path: Path) -> None:
    bag = write(
        tmp_path / "wrench", wrench, "geometry_msgs/msg/WrenchStamped", plugin=StoragePlugin.SQLITE3,
        compression=CompressionMode.FILE,
    )  # fmt: skip
    (table,) = bag_tables(bag)
    assert dict(zip(table.names, table.units, strict=True))["/sensor.wrench.force.y"] == "N"
    _, own = found(bag, "/sensor.wrench.force.y")
    check(own)
    assert own.unit == "N"


def test_an_unknown_type_by_its_definition(tmp_path: Path) -> None:
    store = store_with(GAUGE, "lab_msgs/msg/Gauge")
    bag = write(tmp_path / "gauge", gauge, "lab_msgs/msg/Gauge", store=store, compression=CompressionMode.MESSAGE,
                plugin=StoragePlugin.SQLITE3)  # fmt: skip
    assert [name for table in bag_tables(bag) for name in table.names] == [
        "/sensor.deflection", "/sensor.counter", "/sensor.others.1", "/sensor.others.2", "/sensor.others.3"
    ]  # fmt: skip
    run, own = found(bag, "/sensor.deflection", quantity="displacement", unit="m")
    check(own)
    assert run.channels[0].data[0] == pytest.approx(1e-3)


def test_an_array_without_stamps_has_the_log_times_as_clock(tmp_path: Path) -> None:
    bag = write(tmp_path / "array", multi, "std_msgs/msg/Float64MultiArray", late=0.3)
    (table,) = bag_tables(bag)
    assert table.names == ("/sensor.data.1", "/sensor.data.2")
    run, own = found(bag, "/sensor.data.1", quantity="acceleration", unit="m/s^2")
    check(own)
    assert "the signals are smoother at even times" in " ".join(run.notes)
    assert run.clock_std > 0.0


@pytest.mark.parametrize("compression", [CompressionMode.STORAGE, CompressionMode.FILE])
def test_compressed_mcap(tmp_path: Path, compression: CompressionMode) -> None:
    _, own = found(write(tmp_path / "imu", imu, "sensor_msgs/msg/Imu", compression=compression), IMU_COLUMN)
    check(own)


def test_a_split_bag_is_one_recording(tmp_path: Path) -> None:
    whole = write(tmp_path / "whole", imu, "sensor_msgs/msg/Imu", seconds=4.0)
    folder = tmp_path / "split"
    folder.mkdir()
    (file,) = whole.glob("*.mcap")
    with file.open("rb") as data:
        messages = list(make_reader(data).iter_messages())
    for number, part in enumerate((messages[:700], messages[700:])):
        with (folder / f"split_{number}.mcap").open("wb") as out:
            writer = McapWriter(out)
            writer.start(profile="ros2", library="other")
            schema, channel, _ = part[0]
            own = writer.register_schema(schema.name, schema.encoding, schema.data)
            key = writer.register_channel(channel.topic, channel.message_encoding, own, channel.metadata)
            for _, _, message in part:
                writer.add_message(key, message.log_time, message.data, message.publish_time)
            writer.finish()
    (table,), (expected,) = bag_tables(folder), bag_tables(whole)
    assert table.rows == 2000
    for one, other in zip(table.columns, expected.columns, strict=True):
        assert (one == other).all()


def test_joints_are_named_and_blocks_of_samples_unfolded(tmp_path: Path) -> None:
    def joints(store: Any, stamp: int, value: float) -> Any:
        values = np.array([value, 2.0 * value])
        return store.types["sensor_msgs/msg/JointState"](
            header(store, stamp), ["hip", "knee"], values, 3.0 * values, np.zeros(2)
        )

    def blocks(store: Any, stamp: int, value: float) -> Any:
        types = store.types
        dimension = types["std_msgs/msg/MultiArrayDimension"]
        layout = types["std_msgs/msg/MultiArrayLayout"]([dimension("samples", 4, 8), dimension("channels", 2, 2)], 0)
        data = np.array([[value, k] for k in range(4)]).ravel()
        return types["std_msgs/msg/Float64MultiArray"](layout, data)

    (table,) = bag_tables(write(tmp_path / "joints", joints, "sensor_msgs/msg/JointState", seconds=1.0))
    assert table.names[:3] == ("/sensor.position.hip", "/sensor.position.knee", "/sensor.velocity.hip")
    (table,) = bag_tables(write(tmp_path / "blocks", blocks, "std_msgs/msg/Float64MultiArray", seconds=1.0))
    assert table.names == ("/sensor.data.1", "/sensor.data.2")
    assert table.columns[1][:6].tolist() == [0.0, 1.0, 2.0, 3.0, 0.0, 1.0]
    assert table.step == pytest.approx(1.0 / (4.0 * RATE), rel=1e-4)


def test_two_topics_are_brought_to_one_clock(tmp_path: Path) -> None:
    store = store_with()
    folder = tmp_path / "two"
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        force = writer.add_connection("/wrench", "geometry_msgs/msg/WrenchStamped", typestore=store)
        motion = writer.add_connection("/imu", "sensor_msgs/msg/Imu", typestore=store)
        for k in range(3000):
            for connection, make, at in ((motion, imu, k / 1000.0), (force, wrench, k / 1000.0 + 3e-4)):
                if connection is force and k % 2:
                    continue
                stamp = BEGIN + round(1e9 * at)
                message = make(store, stamp, float(decay(np.array(at))))
                writer.write(connection, stamp, store.serialize_cdr(message, connection.msgtype))
    path = tmp_path / "s.yaml"
    channels = [
        {"column": "/wrench.wrench.force.y", "quantity": "force", "unit": "N", "point": 1},
        {"column": IMU_COLUMN.replace("sensor", "imu"), "quantity": "acceleration", "unit": "m/s^2", "point": 1},
    ]
    path.write_text(yaml.safe_dump({"file": "two", "channels": channels}))
    run = read_import(path)
    assert (run.sample_rate, run.samples) == (1000.0, 3000)
    assert "/wrench was interpolated at the times of /imu" in " ".join(run.notes)
    inner = slice(10, -10)
    apart = run.channels[0].data - (run.channels[1].data - 9.81)
    # The cubic through four samples of a sine, 0.002 s apart: its error is 3/128 (ω Δt)⁴.
    assert np.abs(apart[inner]).max() < 1.1 * 3.0 / 128.0 * (OMEGA * 0.002) ** 4


def test_lost_messages_are_marked(tmp_path: Path) -> None:
    bag = write(tmp_path / "imu", imu, "sensor_msgs/msg/Imu", lost=(100, 101, 102, 700))
    (table,) = bag_tables(bag)
    column = table.columns[table.names.index("/sensor.linear_acceleration.z")]
    assert np.flatnonzero(np.isnan(column)).tolist() == [100, 101, 102, 700]
    assert any("4 samples of /sensor of imu are missing at 2 places" in note for note in table.notes)


def test_extraction_points_to_the_import(tmp_path: Path) -> None:
    bag = write(tmp_path / "imu", imu, "sensor_msgs/msg/Imu", seconds=0.5)
    with pytest.raises(BenchError, match=r"none of the bench's topics.*sensor_msgs/msg/Imu.*import --init"):
        extract_bag(bag)


def test_a_bag_without_numbers_is_refused_with_its_topics(tmp_path: Path) -> None:
    def text(store: Any, stamp: int, value: float) -> Any:
        return store.types["std_msgs/msg/String"](f"{value}")

    bag = write(tmp_path / "text", text, "std_msgs/msg/String", seconds=0.5)
    with pytest.raises(BenchError, match=r"No topic.*has numbers.*/sensor \(std_msgs/msg/String, 250\)"):
        sidecar_templates(bag)


def test_a_cubic_is_interpolated_exactly_and_gaps_stay() -> None:
    time = np.cumsum(np.random.default_rng(2).uniform(0.8, 1.2, 40))
    time[20:] += 6.0
    places = np.linspace(time[0], time[-1], 211)
    values = interpolated(time, 1.0 + time - 0.1 * time**3, places)
    inside = (places > time[19]) & (places < time[20])
    assert np.isnan(values[inside]).all()
    assert values[~inside] == pytest.approx((1.0 + places - 0.1 * places**3)[~inside], rel=1e-9, abs=1e-7)


def test_late_stamps_of_even_samples_leave_the_signal_as_it_is() -> None:
    true = np.arange(2000) / RATE
    late = true + np.random.default_rng(3).uniform(0.0, 0.4, 2000) / RATE
    grid = even_grid(late, [decay(true)], "x", "log times")
    assert (grid.columns[0] == decay(true)).all()
    assert 1.0 / grid.step == pytest.approx(RATE, rel=3.0 * grid.std)
