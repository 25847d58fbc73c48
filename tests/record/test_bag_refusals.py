from __future__ import annotations

import sqlite3

import pytest
import yaml

from nmt_core.errors import BenchError
from nmt_record import Bag, BagWriter


def missing(folder, make_bag):
    return folder / "nowhere"


def empty_folder(folder, make_bag):
    (folder / "bad").mkdir()
    return folder / "bad"


def empty_file(folder, make_bag):
    (folder / "bad.mcap").touch()
    return folder / "bad.mcap"


def magic_only(folder, make_bag):
    (folder / "bad.mcap").write_bytes(b"\x89MCAP0\r\n")
    return folder / "bad.mcap"


def part_of_the_magic(folder, make_bag):
    (folder / "bad.mcap").write_bytes(b"\x89MC")
    return folder / "bad.mcap"


def ros1_file(folder, make_bag):
    (folder / "old.bag").write_bytes(b"#ROSBAG V2.0\n" + bytes(100))
    return folder / "old.bag"


def ros1_folder(folder, make_bag):
    (folder / "old").mkdir()
    (folder / "old" / "old.bag").write_bytes(b"#ROSBAG V2.0\n" + bytes(100))
    return folder / "old"


def text_file(folder, make_bag):
    (folder / "notes.txt").write_text("not a bag, but long enough to be one")
    return folder / "notes.txt"


def folder_of_texts(folder, make_bag):
    (folder / "notes").mkdir()
    (folder / "notes" / "notes.txt").write_text("not a bag")
    return folder / "notes"


def file_of_the_bag_missing(folder, make_bag):
    path = make_bag()
    (path / "bag_0.mcap").unlink()
    return path


def sqlite_of_something_else(folder, make_bag):
    connection = sqlite3.connect(folder / "other.db3")
    connection.execute("create table birds (name text)")
    connection.commit()
    connection.close()
    return folder / "other.db3"


def sqlite_cut_off(folder, make_bag):
    (folder / "cut.db3").write_bytes(b"SQLite format 3\0" + bytes(50))
    return folder / "cut.db3"


def metadata_of_another_storage(folder, make_bag):
    path = make_bag()
    text = (path / "metadata.yaml").read_text().replace("storage_identifier: mcap", "storage_identifier: sqlite3")
    (path / "metadata.yaml").write_text(text)
    return path


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (missing, "There is no bag at"),
        (empty_folder, "is empty; nothing was recorded"),
        (empty_file, "is empty; nothing was recorded"),
        (magic_only, "cut off before its first whole chunk"),
        (part_of_the_magic, "ends after 3 bytes"),
        (ros1_file, "is a ROS 1 bag; convert it"),
        (ros1_folder, "holds a ROS 1 bag; convert it"),
        (text_file, "is not a bag; a rosbag2 folder or an .mcap file is needed"),
        (folder_of_texts, "is not a bag; a rosbag2 folder or an .mcap file is needed"),
        (file_of_the_bag_missing, "lacks its file bag_0.mcap"),
        (sqlite_of_something_else, "cannot be opened"),
        (sqlite_cut_off, "cannot be opened"),
        (metadata_of_another_storage, "cannot be opened"),
    ],
)
def test_what_is_no_bag_is_refused_in_a_sentence(tmp_path, make_bag, make, sentence):
    with pytest.raises(BenchError) as caught:
        Bag.open(make(tmp_path, make_bag))
    text = str(caught.value)
    assert sentence in text
    assert text.endswith(".")
    assert "\n" not in text


@pytest.mark.parametrize("content", ["", "nonsense: [", "- 1\n- 2", "rosbag2_bagfile_information: 5", "\x00\x01"])
def test_damaged_metadata_does_not_hide_the_bag(make_bag, content):
    path = make_bag(blocks=5)
    (path / "metadata.yaml").write_text(content)
    assert Bag.open(path).topics["displacement"][1] == 5


def test_the_file_the_metadata_and_the_folder_of_the_run_open_the_same_bag(make_bag, tmp_path):
    path = make_bag(blocks=5)
    for name in (path / "bag_0.mcap", path / "metadata.yaml", tmp_path):
        assert Bag.open(name).topics["displacement"][1] == 5


def test_ros1_messages_in_mcap_are_refused(tmp_path):
    from mcap.writer import Writer

    with (tmp_path / "old.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start("ros1")
        channel = writer.register_channel("/force", "ros1", writer.register_schema("a/B", "ros1msg", b"int32 x"))
        writer.add_message(channel, 0, b"\0\0\0\0", 0)
        writer.finish()
    with pytest.raises(BenchError, match="holds 'ros1' messages on topic 'force'"):
        Bag.open(tmp_path / "old.mcap")


def test_messages_that_do_not_fit_their_definition(tmp_path):
    writer = BagWriter(tmp_path / "bag")
    writer.add_topic("force", "nmt_msgs/msg/SampleBlock")
    writer.write("force", b"\0\1\0\0" + b"\xff" * 40)
    writer.close()
    bag = Bag.open(tmp_path / "bag")
    with pytest.raises(BenchError, match="A message of topic 'force'"):
        list(bag.messages(["force"]))
    with pytest.raises(BenchError, match="topic 'force'"):
        list(bag.blocks("force", first_sample=3))


@pytest.mark.parametrize("text", ["{", "[1]", "nan nan"])
def test_run_description_that_is_no_object(tmp_path, text):
    with pytest.raises(BenchError, match="run_json"):
        BagWriter(tmp_path / "bag", run_json=text)
    assert not (tmp_path / "bag").exists()


def test_folder_that_cannot_be_made(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(BenchError, match="cannot be created: Not a directory"):
        BagWriter(tmp_path / "file" / "bag")


def test_custom_data_speaks_where_the_start_record_is_missing(make_bag, tmp_path):
    path = make_bag(blocks=2, records=False)
    information = yaml.safe_load((path / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert "run.json" in information["custom_data"]
    bag = Bag.open(path)
    assert bag.run_start["run_id"] == "run-7"
    assert "it has no stop record" in bag.loss
