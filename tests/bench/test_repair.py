"""``./nmt repair`` from the command line."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from nmt_bench.cli import main
from nmt_record.bag.bag_reader import Bag
from nmt_record.bag.bag_writer import BagWriter, Storage
from nmt_record.bag.message_definitions import local_definitions


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    writer = BagWriter(tmp_path / "bag", run_json='{"run_id": "r"}', storage=Storage(chunk_messages=2))
    writer.add_topic("note", "std_msgs/msg/String")
    for index in range(10):
        writer.write("note", b"\0\1\0\0" + bytes([6, 0, 0, 0]) + b"note%d\0" % index, index)
    writer.close()
    return writer.path


def damage(bag: Path, word: bytes) -> None:
    file = bag / "bag_0.mcap"
    content = bytearray(file.read_bytes())
    content[content.index(word)] ^= 1
    file.write_bytes(content)


def test_losses_are_named_and_the_rest_is_a_bag(bag: Path, tmp_path: Path, capsys) -> None:
    damage(bag, b"note4")
    assert main(["repair", str(bag), "--out", str(tmp_path / "out")]) == 0
    said = capsys.readouterr().out
    assert "1 part of it could not be read" in said
    assert "2 of note" in said
    assert "8 of note" in said
    record = json.loads((tmp_path / "out" / "repair.json").read_text())
    assert record["kept"] == {"note": 8, "run_record": 2}
    assert record["lost"][0]["messages"] == {"note": 2}
    assert Bag.open(tmp_path / "out" / "bag").topics["note"][1] == 8


def test_a_cut_bag_gets_a_stop_record(bag: Path, tmp_path: Path, capsys) -> None:
    file = bag / "bag_0.mcap"
    content = file.read_bytes()
    file.write_bytes(content[: content.index(b"note7")])
    local_definitions.cache_clear()  # as in a process that has written no bag yet
    assert main(["repair", str(bag), "--out", str(tmp_path / "out")]) == 0
    assert "is cut off" in capsys.readouterr().out
    fixed = Bag.open(tmp_path / "out" / "bag")
    assert fixed.run_stop["exit"]["state"] == "repaired"
    assert fixed.topics["note"][1] > 4


def test_a_whole_bag_is_copied(bag: Path, tmp_path: Path, capsys) -> None:
    assert main(["repair", str(bag), "--out", str(tmp_path / "out")]) == 0
    assert "is whole" in capsys.readouterr().out
    assert list(Bag.open(tmp_path / "out" / "bag").raw_messages()) == list(Bag.open(bag).raw_messages())


def test_nothing_readable_is_refused_and_nothing_is_left(bag: Path, tmp_path: Path, capsys) -> None:
    file = bag / "bag_0.mcap"
    file.write_bytes(file.read_bytes()[:40])
    assert main(["repair", str(bag), "--out", str(tmp_path / "out")]) == 2
    assert "nothing in it can be read" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
