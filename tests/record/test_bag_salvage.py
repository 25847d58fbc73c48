"""Damaged and cut bags: what is good is read, what is lost is named, and nothing else is said."""

from __future__ import annotations

import io
import json
import random

import pytest
import yaml
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from rosbags.rosbag2 import Reader

from nmt_core.errors import BenchError
from nmt_record import Bag
from nmt_record.bag.bag_writer import COMPRESSIONS, Storage
from nmt_record.bag.bench_topics import SAMPLE_BLOCK
from nmt_record.bag.mcap_file import McapFile

BLOCKS, PER_CHUNK, SAMPLES = 30, 3, 20


def firsts(bag):
    return [block.first_sample for block in bag.blocks("displacement")] if bag.topics.get("displacement") else []


def start_is_whole(chunks, size):
    """Whether the chunk with the start record, the first one, ends before ``size``."""
    return chunks[0].chunk_start_offset + chunks[0].chunk_length <= size


def lost_samples(bag):
    """Samples that the bag says it has lost, the end of a cut bag not among them."""
    lost = set()
    for span in bag.lost_spans:
        first, stop = span.samples.get("displacement", (0, 0))
        lost.update(range(first, stop if stop >= 0 else BLOCKS * SAMPLES))
    return lost


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_flips_cost_one_chunk_at_most(make_bag, tmp_path, compression):
    path = make_bag(blocks=BLOCKS, per_chunk=PER_CHUNK, storage={"compression": compression})
    whole = (path / "bag_0.mcap").read_bytes()
    everything = [SAMPLES * index for index in range(BLOCKS)]
    generator = random.Random(f"flips {compression}")
    losses = 0
    target = path / "bag_0.mcap"
    for _ in range(120):
        content = bytearray(whole)
        position = generator.randrange(len(content))
        content[position] ^= 1 << generator.randrange(8)
        target.write_bytes(content)
        bag = Bag.open(path)
        read = firsts(bag)
        missing = sorted(set(everything) - set(read))
        assert read == [first for first in everything if first not in missing]
        assert len(missing) in (0, PER_CHUNK)
        assert {first // SAMPLES // PER_CHUNK for first in missing} == {m // SAMPLES // PER_CHUNK for m in missing[:1]}
        # What it says is what is missing: no more, no less.
        assert lost_samples(bag) == {first + k for first in missing for k in range(SAMPLES)}
        if missing:
            assert "is damaged" in bag.loss
            losses += 1
        assert bag.run_start["run_id"] == "run-7"
        assert bag.loss is None or "is cut" not in bag.loss
    assert losses > 40


def test_cuts_keep_every_whole_chunk_and_say_where_the_recording_ends(make_bag, tmp_path):
    whole = (make_bag(blocks=BLOCKS, per_chunk=PER_CHUNK) / "bag_0.mcap").read_bytes()
    chunks = make_reader(io.BytesIO(whole)).get_summary().chunk_indexes
    generator = random.Random("cuts")
    target = tmp_path / "cut.mcap"
    for _ in range(90):
        size = generator.randrange(len(whole))
        target.write_bytes(whole[:size])
        kept = sum(1 for chunk in chunks[1:] if chunk.chunk_start_offset + chunk.chunk_length <= size)
        if kept == 0 and not start_is_whole(chunks, size):
            with pytest.raises(BenchError, match=r"cut off|nothing was recorded"):
                Bag.open(target)
            continue
        bag = Bag.open(target)
        read = firsts(bag)
        assert read == [SAMPLES * index for index in range(min(kept * PER_CHUNK, BLOCKS))]
        assert bag.lost_spans == ()
        assert "is cut off" in bag.loss
        if read:
            assert f"the last sample in it is {read[-1] + SAMPLES - 1} " in bag.loss


def test_flips_and_cuts_together(make_bag, tmp_path):
    """Without an index a chunk whose content is damaged is passed by its length."""
    whole = (make_bag(blocks=BLOCKS, per_chunk=PER_CHUNK) / "bag_0.mcap").read_bytes()
    chunks = make_reader(io.BytesIO(whole)).get_summary().chunk_indexes
    begin = chunks[2].chunk_start_offset  # the topic is described in the chunk before
    generator = random.Random("both")
    target = tmp_path / "both.mcap"
    for _ in range(50):
        size = generator.randrange(begin + 1, len(whole))
        content = bytearray(whole[:size])
        position = generator.randrange(begin, size)
        content[position] ^= 1 << generator.randrange(8)
        target.write_bytes(content)
        bag = Bag.open(target)
        kept = sum(1 for chunk in chunks[1:] if chunk.chunk_start_offset + chunk.chunk_length <= size)
        uncut = [SAMPLES * index for index in range(min(kept * PER_CHUNK, BLOCKS))]
        read = firsts(bag)
        assert set(read) <= set(uncut)
        assert len(uncut) - len(read) in (0, PER_CHUNK)
        assert bag.loss is not None


def test_without_an_index_a_damaged_head_is_the_end(make_bag, tmp_path):
    whole = (make_bag(blocks=BLOCKS, per_chunk=PER_CHUNK) / "bag_0.mcap").read_bytes()
    chunks = make_reader(io.BytesIO(whole)).get_summary().chunk_indexes
    content = bytearray(whole[: chunks[-1].chunk_start_offset])
    for place in (0, 4):  # operation code and length
        damaged = content.copy()
        damaged[chunks[4].chunk_start_offset + place] ^= 0x40
        (tmp_path / "head.mcap").write_bytes(damaged)
        bag = Bag.open(tmp_path / "head.mcap")
        assert firsts(bag) == [SAMPLES * index for index in range(3 * PER_CHUNK)]
        assert "is cut off" in bag.loss


def test_metadata_may_be_damaged_anywhere(make_bag):
    path = make_bag(blocks=6, per_chunk=PER_CHUNK)
    target = path / "metadata.yaml"
    whole = target.read_bytes()
    generator = random.Random("metadata")
    for _ in range(60):
        content = bytearray(whole)
        content[generator.randrange(len(content))] ^= 1 << generator.randrange(8)
        target.write_bytes(content)
        assert firsts(Bag.open(path)) == [0, 20, 40, 60, 80, 100]


def test_a_damaged_start_is_told_by_what_the_file_says_of_itself(make_bag):
    """The start record is in the first chunk, and again in the description that rosbag2 keeps in the file."""
    path = make_bag(blocks=6, per_chunk=PER_CHUNK)
    file = path / "bag_0.mcap"
    content = bytearray(file.read_bytes())
    content[content.index(b"run-7")] ^= 1
    file.write_bytes(content)
    for name in (path, file):
        bag = Bag.open(name)
        assert bag.run_start["run_id"] == "run-7"
        assert bag.rig_yaml == "name: beam\n"
        assert firsts(bag) == [0, 20, 40, 60, 80, 100]
        assert "messages: 1 of run_record" in bag.loss


@pytest.mark.parametrize("place", [*range(8), -1, -8])
def test_a_damaged_byte_of_the_magic_does_not_make_it_another_file(make_bag, place):
    path = make_bag(blocks=6, per_chunk=PER_CHUNK)
    file = path / "bag_0.mcap"
    content = bytearray(file.read_bytes())
    content[place] ^= 4
    file.write_bytes(content)
    bag = Bag.open(path)
    assert firsts(bag) == [0, 20, 40, 60, 80, 100]
    assert bag.lost_spans == ()
    assert bag.loss is None or "its messages were found without it" in bag.loss


def test_repair_writes_a_regular_bag_that_says_what_it_lacks(make_bag, make_block, tmp_path):
    path = make_bag(blocks=12, per_chunk=4)
    file = path / "bag_0.mcap"
    content = bytearray(file.read_bytes())
    content[content.index(make_block(20 * 6)) + 200] ^= 1
    file.write_bytes(content)
    broken = Bag.open(path)
    fixed = Bag.open(broken.repair(tmp_path / "fixed"))
    assert firsts(fixed) == firsts(broken) == [0, 20, 40, 60, 160, 180, 200, 220]
    assert fixed.loss == broken.loss
    (span,) = fixed.lost_spans
    assert span.samples == {"displacement": (80, 160)}
    assert span.messages == {"displacement": 4}
    assert fixed.run_stop == broken.run_stop
    with Reader(tmp_path / "fixed") as reader:  # another implementation of rosbag2
        assert reader.message_count == 8 + 2
    information = yaml.safe_load((tmp_path / "fixed" / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    record = json.loads(information["custom_data"]["repair.json"])
    assert record["kept"] == {"run_record": 2, "displacement": 8}
    # A second repair keeps the record of the first.
    again = Bag.open(fixed.repair(tmp_path / "again"))
    assert again.loss == broken.loss
    assert again.lost_spans == fixed.lost_spans


def test_a_whole_bag_is_repaired_to_itself(make_bag, tmp_path):
    bag = Bag.open(make_bag(blocks=7))
    fixed = Bag.open(bag.repair(tmp_path / "fixed"))
    assert fixed.loss is None
    assert list(fixed.raw_messages()) == list(bag.raw_messages())


@pytest.mark.parametrize("compression", COMPRESSIONS)
@pytest.mark.parametrize("limit", [{"split_bytes": 2_000}, {"split_duration": 8e-6}, {}])
def test_compression_and_splitting_change_no_message(make_bag, tmp_path, compression, limit):
    plain = Bag.open(make_bag("plain", blocks=BLOCKS, per_chunk=PER_CHUNK))
    path = make_bag("other", blocks=BLOCKS, per_chunk=PER_CHUNK, storage={"compression": compression, **limit})
    files = sorted(path.glob("*.mcap"))
    assert (len(files) > 1) == bool(limit)
    bag = Bag.open(path)
    assert bag.loss is None
    samples = list(plain.raw_messages(["displacement"]))
    assert list(bag.raw_messages(["displacement"])) == samples
    assert bag.run_start == plain.run_start
    assert bag.run_stop == plain.run_stop
    with Reader(path) as reader:
        assert [raw for c, _, raw in reader.messages() if c.topic == "/displacement"] == [raw for *_, raw in samples]
    information = yaml.safe_load((path / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert information["relative_file_paths"] == [f"other_{index}.mcap" for index in range(len(files))]
    assert sum(item["message_count"] for item in information["files"]) == information["message_count"] == BLOCKS + 2
    for file in files:  # each is a bag of its own
        assert Bag.open(file).topics


def test_a_file_of_a_split_bag_that_was_cut_is_not_the_end_of_the_others(make_bag):
    path = make_bag(blocks=BLOCKS, per_chunk=PER_CHUNK, storage={"split_bytes": 4_000})
    middle = path / "bag_1.mcap"
    middle.write_bytes(middle.read_bytes()[:2_000])
    bag = Bag.open(path)
    read = firsts(bag)
    assert read[0] == 0
    assert read[-1] == SAMPLES * (BLOCKS - 1)
    assert "is damaged" in bag.loss
    assert "of bag_1.mcap" in bag.loss
    lost = {SAMPLES * index for index in range(BLOCKS)} - set(read)
    assert lost_samples(bag) == {first + k for first in lost for k in range(SAMPLES)}


def test_an_unknown_compression_is_refused():
    with pytest.raises(BenchError, match="choose none, zstd, lz4"):
        Storage(compression="gzip")


@pytest.mark.parametrize("compression", [CompressionType.ZSTD, CompressionType.LZ4])
def test_a_chunk_that_unpacks_to_more_than_it_says_is_left_out(tmp_path, make_block, compression):
    """Memory is taken for what a chunk says, not for what its compressed data would fill."""
    target = tmp_path / "bomb.mcap"
    with target.open("wb") as file:
        writer = Writer(file, chunk_size=2**62, compression=compression)
        writer.start("ros2")
        schema = writer.register_schema(SAMPLE_BLOCK, "ros2msg", b"uint8[] data")
        channel = writer.register_channel("/force", "cdr", schema)
        writer.add_message(channel, 0, bytes(40_000_000), 0)
        writer.finish()
    bag = McapFile.open(target)
    stretch = bag.stretches[0]
    name, packed, size = stretch.packing
    assert size > 40_000_000
    for claimed in (1_000, 2**40):
        forged = type(stretch)(stretch.offset, stretch.length, True, stretch.channels, (name, packed, claimed))
        bag.stretches[0] = forged
        (lost,) = bag.parts()
        assert "checksum" in lost.reason or "claims to unpack" in lost.reason
