from __future__ import annotations

import json
import time
from pathlib import Path

import numpy as np
import pytest
import yaml
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from rosbags.highlevel import AnyReader
from rosbags.interfaces import Nodetype, QosDurability, QosHistory, QosReliability
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as RosbagsWriter

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_record import Bag, BagWriter
from nmt_record.bag.bench_topics import BENCH_TOPICS, SAMPLE_BLOCK
from nmt_record.bag.mcap_file import McapFile

SHARE = Path(__file__).parents[2] / "ros2_ws" / "install" / "nmt_msgs" / "share" / "nmt_msgs" / "msg"


def arbitrary(store, message_type, rng):
    """A message with every field filled."""

    def value(kind, detail):
        if kind == Nodetype.NAME:
            return arbitrary(store, detail, rng)
        if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE):
            (inner, inner_detail), count = detail
            items = [value(inner, inner_detail) for _ in range(count if kind == Nodetype.ARRAY else 3)]
            numeric = inner == Nodetype.BASE and inner_detail[0] != "string"
            return np.array(items, dtype=inner_detail[0]) if numeric else items
        name = detail[0]
        if name == "string":
            return "t" + "ü" * int(rng.integers(0, 9))
        if name == "bool":
            return bool(rng.integers(2))
        if name.startswith("float"):
            return float(np.dtype(name).type(rng.standard_normal()))
        return int(rng.integers(0, 100))

    fields = store.typestore.fielddefs[message_type][1]
    return store.typestore.types[message_type](**{name: value(*description) for name, description in fields})


def plain(message):
    if hasattr(message, "__msgtype__"):
        return {name: plain(getattr(message, name)) for name in message.__dataclass_fields__ if name != "__msgtype__"}
    if isinstance(message, np.ndarray):
        return message.tolist()
    return [plain(item) for item in message] if isinstance(message, list) else message


@pytest.fixture
def every_type(tmp_path, store):
    """A bag with one message on each topic of the bench, and the messages."""
    rng = np.random.default_rng(3)
    written = {}
    writer = BagWriter(tmp_path / "all")
    for topic in BENCH_TOPICS:
        if topic.name == "run_record":
            continue
        writer.add_topic(topic.name, topic.message_type, topic.service)
        written[topic.name] = arbitrary(store, topic.message_type, rng)
        writer.write_message(topic.name, written[topic.name])
    writer.close("done", "all levels", stamp_ns=1_500_000_000, gaps={})
    return writer.path, written


def test_every_message_type_comes_back_as_written(every_type):
    path, written = every_type
    bag = Bag.open(path)
    read = {topic: message for topic, _, message in bag.messages() if topic != "run_record"}
    assert set(read) == {topic.name for topic in BENCH_TOPICS} - {"run_record"}
    for topic, message in written.items():
        assert plain(read[topic]) == plain(message)
    assert bag.loss is None


def test_rosbags_reads_the_folder(every_type, store):
    path, written = every_type
    with AnyReader([path]) as reader:
        topics = {connection.topic: connection for connection in reader.connections}
        assert set(topics) == {f"/{topic.name}" for topic in BENCH_TOPICS}
        for connection, _, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            if connection.topic != "/run_record":
                assert plain(message) == plain(written[connection.topic[1:]])
        for topic in BENCH_TOPICS:
            assert topics[f"/{topic.name}"].digest == store.definition(topic.message_type).type_hash
        (qos,) = topics["/drive"].ext.offered_qos_profiles
        assert (qos.history, qos.reliability, qos.durability) == (
            QosHistory.KEEP_ALL,
            QosReliability.RELIABLE,
            QosDurability.VOLATILE,
        )
        (qos,) = topics["/run_state"].ext.offered_qos_profiles
        assert (qos.history, qos.depth, qos.durability) == (QosHistory.KEEP_LAST, 1, QosDurability.TRANSIENT_LOCAL)


def test_mcap_reads_the_file_with_its_commented_definitions(every_type):
    path, _ = every_type
    with (path / "all_0.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
        seen = [(schema.name, channel.topic) for schema, channel, _ in reader.iter_messages()]
    assert len(seen) == len(BENCH_TOPICS) + 1  # two run records
    schemas = {schema.name: schema for schema in summary.schemas.values()}
    block = schemas[SAMPLE_BLOCK]
    assert block.encoding == "ros2msg"
    assert b"NaN = sample missing" in block.data
    assert b"MSG: std_msgs/Header" in block.data
    assert b"MSG: builtin_interfaces/Time" in block.data


def test_metadata_is_what_rosbag2_writes(make_bag):
    path = make_bag(blocks=3)
    information = yaml.safe_load((path / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert information["version"] == 9
    assert information["storage_identifier"] == "mcap"
    assert information["relative_file_paths"] == ["bag_0.mcap"]
    assert information["message_count"] == 5
    assert information["custom_data"]["rig.yaml"] == "name: beam\n"
    assert json.loads(information["custom_data"]["run.json"])["run_id"] == "run-7"
    counts = {t["topic_metadata"]["name"]: t["message_count"] for t in information["topics_with_message_count"]}
    assert counts == {"/run_record": 2, "/displacement": 3}


@pytest.mark.parametrize("message_type", sorted({t.message_type for t in BENCH_TOPICS if "nmt_msgs" in t.message_type}))
def test_type_hash_is_that_of_the_build(message_type, store):
    described = SHARE / f"{message_type.rpartition('/')[2]}.json"
    if not described.is_file():
        pytest.skip("nmt_msgs is not built")
    built = json.loads(described.read_text())["type_hashes"]
    expected = next(item["hash_string"] for item in built if item["type_name"] == message_type)
    assert store.definition(message_type).type_hash == expected


def test_start_record_is_on_disk_before_anything_else(make_bag):
    path = make_bag(blocks=0, close=False)
    bag = Bag.open(path)
    assert bag.run_start["extraction"]["harmonics"] == 5
    assert bag.rig_yaml == "name: beam\n"
    assert bag.run_stop is None
    assert "it holds no samples" in bag.loss


def test_stop_record_adds_exit_and_counts(every_type, make_bag):
    stop = Bag.open(every_type[0]).run_stop
    assert stop["exit"] == {"state": "done", "reason": "all levels"}
    assert stop["counts"]["force"] == 1
    stop = Bag.open(make_bag(blocks=7)).run_stop
    assert stop["run_id"] == "run-7"
    assert stop["counts"]["displacement"] == 7


def test_existing_folder_is_never_touched(make_bag, tmp_path):
    path = make_bag()
    before = {p.name: p.read_bytes() for p in path.iterdir()}
    with pytest.raises(BenchError, match="exists already"):
        BagWriter(path)
    with pytest.raises(BenchError, match="exists already"):
        Bag.open(path).repair(path)
    assert {p.name: p.read_bytes() for p in path.iterdir()} == before


def test_order_and_times(make_bag):
    bag = Bag.open(make_bag(blocks=12))
    times = [(received, published) for _, received, published, _ in bag.raw_messages(["/displacement"])]
    assert times == [(1_000 * i + 10, 2_000_000 * i) for i in range(12)]


def test_reception_times_never_go_back(tmp_path, make_block, monkeypatch):
    writer = BagWriter(tmp_path / "bag")
    writer.add_topic("force", SAMPLE_BLOCK)
    clock = iter([5_000, 4_000, 6_000])
    now = time.time_ns() + 10**9
    monkeypatch.setattr("nmt_record.bag.bag_writer.time.time_ns", lambda: now + next(clock))
    for index in range(3):
        writer.write("force", make_block(20 * index))
    monkeypatch.undo()
    writer.close()
    times = [received - now for _, received, _, _ in Bag.open(writer.path).raw_messages(["force"])]
    assert times == [5_000, 5_000, 6_000]


def test_blocks_are_those_written(make_bag):
    bag = Bag.open(make_bag(blocks=30))
    blocks = list(bag.blocks("displacement"))
    assert [block.first_sample for block in blocks] == list(range(0, 600, 20))
    block = blocks[7]
    assert block.quantity is Quantity.DISPLACEMENT
    assert (block.unit, block.channels, block.points, block.sample_rate) == ("m", ("x1", "x2"), (1, 2), 10_000.0)
    assert block.data.flags.aligned
    np.testing.assert_array_equal(block.data.ravel(), np.random.default_rng(140).standard_normal(40))
    cut = [block.first_sample for block in bag.blocks("displacement", first_sample=119, stop_sample=161)]
    assert cut == [100, 120, 140, 160]
    edge = [block.first_sample for block in bag.blocks("displacement", first_sample=120, stop_sample=160)]
    assert edge == [120, 140]


def test_topics_are_checked(make_bag):
    bag = Bag.open(make_bag())
    assert bag.topics == {"run_record": ("nmt_msgs/msg/RunRecord", 2), "displacement": (SAMPLE_BLOCK, 40)}
    bag.require_topics("displacement")
    with pytest.raises(BenchError, match=r"no messages on force, lock \(it has displacement, run_record\)"):
        bag.require_topics("force", "displacement", "lock")
    with pytest.raises(BenchError, match="not samples"):
        next(bag.blocks("run_record"))
    assert bag.lock_events() == []


def test_a_whole_file_is_opened_by_its_index(make_bag, monkeypatch):
    path = make_bag()
    monkeypatch.setattr(McapFile, "_scan", lambda *_: pytest.fail("scanned"))
    assert Bag.open(path).topics["displacement"][1] == 40


def test_unknown_topic_and_closed_bag_refuse_messages(tmp_path, make_block):
    writer = BagWriter(tmp_path / "bag")
    with pytest.raises(BenchError, match="made known"):
        writer.write("force", make_block(0))
    writer.close()
    writer.close()
    with pytest.raises(BenchError, match="closed"):
        writer.write("force", make_block(0))


@pytest.mark.parametrize("storage", [StoragePlugin.SQLITE3, StoragePlugin.MCAP])
def test_bags_of_others_are_read(tmp_path, store, make_block, storage):
    with RosbagsWriter(tmp_path / "foreign", version=9, storage_plugin=storage) as writer:
        connection = writer.add_connection("/force", SAMPLE_BLOCK, typestore=store.typestore)
        for index in range(6):
            writer.write(connection, 100 + index, make_block(20 * index))
    bag = Bag.open(tmp_path / "foreign")
    assert [block.first_sample for block in bag.blocks("force")] == list(range(0, 120, 20))
    assert bag.run_start is None
    assert bag.loss is None


@pytest.mark.parametrize("chunked", [True, False])
@pytest.mark.parametrize("compression", list(CompressionType))
def test_compressed_and_unchunked_files(tmp_path, store, make_block, compression, chunked):
    path = tmp_path / "foreign.mcap"
    with path.open("wb") as file:
        writer = Writer(file, compression=compression, use_chunking=chunked, chunk_size=2_000)
        writer.start("ros2")
        text = store.definition(SAMPLE_BLOCK).text
        schema = writer.register_schema(SAMPLE_BLOCK, "ros2msg", text.encode())
        channel = writer.register_channel("/force", "cdr", schema)
        for index in range(30):
            writer.add_message(channel, index, make_block(20 * index), index)
        writer.finish()
    bag = Bag.open(path)
    assert [block.first_sample for block in bag.blocks("force")] == list(range(0, 600, 20))
    assert bag.topics["force"] == (SAMPLE_BLOCK, 30)
    assert bag.loss is None
