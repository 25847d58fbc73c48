from __future__ import annotations

import contextlib
import errno
import io
import os
import shutil
import signal
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from rosbags.rosbag2 import Reader

from nmt_core.errors import BenchError
from nmt_record import Bag, BagWriter
from nmt_record.bag.bag_writer import Storage, open_unbuffered
from nmt_record.bag.bench_topics import SAMPLE_BLOCK

SETTINGS = settings(
    max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow]
)


def opened(path):
    """The bag, or the sentence that refuses it."""
    try:
        return Bag.open(path)
    except BenchError as error:
        return str(error)


def first_samples(bag):
    return [block.first_sample for block in bag.blocks("displacement")] if "displacement" in bag.topics else []


def run_python(code, *arguments):
    paths = os.pathsep.join(p for p in sys.path if p)
    return subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(code), *map(str, arguments)],
        env={**os.environ, "PYTHONPATH": paths},
        stdout=subprocess.PIPE,
        text=True,
    )


def test_killed_writer_loses_less_than_a_second(tmp_path, make_block):
    (tmp_path / "block").write_bytes(make_block(0))
    process = run_python(
        """
        import sys, time
        from pathlib import Path
        from nmt_record.bag.bag_writer import BagWriter, Storage
        writer = BagWriter(sys.argv[1], run_json='{"run_id": "r"}', storage=Storage(chunk_messages=100_000))
        writer.add_topic("displacement", "nmt_msgs/msg/SampleBlock")
        raw = Path(sys.argv[2]).read_bytes()
        for index in range(4_000):
            now = time.time_ns()
            writer.write("displacement", raw, now)
            print(index, now, flush=True)
            time.sleep(0.002)
        """,
        tmp_path / "bag",
        tmp_path / "block",
    )
    lines = []
    for line in process.stdout:
        lines.append(line)
        if len(lines) == 600:
            process.send_signal(signal.SIGKILL)
            break
    lines += process.stdout.readlines()
    process.stdout.close()
    assert process.wait() == -signal.SIGKILL
    last_index, last_time = (int(part) for part in lines[-1].split())
    bag = Bag.open(tmp_path / "bag")
    times = [received for _, received, _, _ in bag.raw_messages(["displacement"])]
    assert 0 < len(times) <= last_index + 2
    assert last_time - times[-1] < 1_000_000_000
    assert bag.run_start == {"run_id": "r"}
    assert "was not closed" in bag.loss
    assert "the last sample in it is 19 (0.002 s of bench time)" in bag.loss


@SETTINGS
@given(data=st.data())
def test_cut_at_any_byte(make_bag, tmp_path, data):
    for name in ("bag", "cut", "repaired"):
        shutil.rmtree(tmp_path / name, ignore_errors=True)
    path = make_bag(blocks=23, per_chunk=4)
    whole = (path / "bag_0.mcap").read_bytes()
    size = data.draw(st.integers(0, len(whole) - 1))
    cut = tmp_path / "cut"
    cut.mkdir()
    (cut / "cut_0.mcap").write_bytes(whole[:size])
    bag = opened(cut)
    if isinstance(bag, str):
        # Nothing but the start of the file: no chunk is whole.
        assert size < 8_000
        assert "\n" not in bag
        return
    samples = first_samples(bag)
    # Witness: the chunks (of four blocks each) that end before the cut, by the index of the whole file.
    chunks = make_reader(io.BytesIO(whole)).get_summary().chunk_indexes
    kept = sum(1 for chunk in chunks[1:] if chunk.chunk_start_offset + chunk.chunk_length <= size)
    assert samples == list(range(0, 20 * min(4 * kept, 23), 20))
    if bag.run_stop is not None:
        assert len(samples) == 23
    assert "was not closed" in bag.loss
    assert "\n" not in bag.loss
    if samples:
        assert f"the last sample in it is {samples[-1] + 19} " in bag.loss
    fixed = Bag.open(bag.repair(tmp_path / "repaired"))
    assert fixed.loss == bag.loss  # a repaired bag still says what it lacks
    assert fixed.lost_spans == ()
    assert first_samples(fixed) == samples
    assert fixed.run_start == bag.run_start
    assert fixed.rig_yaml == bag.rig_yaml
    assert fixed.run_stop["exit"]["state"] == ("done" if bag.run_stop else "repaired")
    with Reader(tmp_path / "repaired") as reader:
        assert reader.message_count == sum(count for _, count in fixed.topics.values())


def test_a_changed_sample_is_noticed_by_the_checksum(make_bag, make_block):
    path = make_bag(blocks=12, per_chunk=4)
    file = path / "bag_0.mcap"
    content = bytearray(file.read_bytes())
    position = content.index(make_block(20 * 6)) + 200  # in the second chunk of samples
    content[position] ^= 1
    file.write_bytes(content)
    for end, about_the_end in ((None, ""), (-1, "is cut off")):  # by the index, and without one
        file.write_bytes(content[:end])
        bag = Bag.open(path)
        assert first_samples(bag) == [0, 20, 40, 60, 160, 180, 200, 220]
        (span,) = bag.lost_spans
        assert span.samples == {"displacement": (80, 160)}
        assert span.touches(0, 81)
        assert span.touches(159, 400)
        assert not span.touches(0, 80)
        assert not span.touches(160, 400)
        assert "is damaged, 1 part of it could not be read" in bag.loss
        assert "the checksum of a chunk is wrong" in bag.loss
        assert "samples 80 to 159 of displacement" in bag.loss
        assert about_the_end in bag.loss
        assert "\n" not in bag.loss


class FullDisk:
    """A file on a disk that takes so many bytes and no more."""

    def __init__(self, path: Path, room: int) -> None:
        self._file = open_unbuffered(path)
        self._room = room

    def write(self, data):
        room = self._room - self._file.tell()
        if room <= 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return self._file.write(data[:room])

    def __getattr__(self, name):
        return getattr(self._file, name)


@SETTINGS
@given(room=st.integers(0, 30_000))
def test_full_disk_keeps_the_whole_chunks(make_block, tmp_path, room):
    path = tmp_path / "full"
    shutil.rmtree(path, ignore_errors=True)
    refusal = None
    try:
        writer = BagWriter(
            path,
            run_json='{"run_id": "r"}',
            storage=Storage(chunk_messages=4, flush_interval=60.0),
            open_file=lambda p: FullDisk(p, room),
        )
    except BenchError as error:
        refusal = str(error)
    if refusal is not None:
        assert "cannot be created: No space left on device" in refusal
        assert not path.exists()
        return
    writer.add_topic("displacement", SAMPLE_BLOCK)
    failure = None
    try:
        for index in range(40):
            writer.write("displacement", make_block(20 * index))
        writer.close()
    except BenchError as error:
        failure = str(error)
    bag = Bag.open(path)
    samples = first_samples(bag)
    assert samples == list(range(0, 20 * len(samples), 20))
    if failure is None:
        assert writer.state == "closed"
        assert bag.loss is None
        assert len(samples) == 40
        return
    assert writer.state == "failed"
    assert failure == writer.failure
    assert "No space left on device" in failure
    assert len(samples) % 4 == 0 or len(samples) == 40
    assert sum(writer.counts.values()) == sum(count for _, count in bag.topics.values())
    assert "was not closed" in bag.loss
    with pytest.raises(BenchError, match="No space left"):
        writer.write("displacement", make_block(0))
    writer.close()  # nothing more to do


def test_full_disk_leaves_a_regular_file(make_block, tmp_path):
    """With room for the shortest end, readers of others open what a full disk left."""
    writer = BagWriter(tmp_path / "bag", storage=Storage(chunk_messages=4), open_file=lambda p: FullDisk(p, 20_000))
    writer.add_topic("displacement", SAMPLE_BLOCK)
    for index in range(400):
        with contextlib.suppress(BenchError):
            writer.write("displacement", make_block(20 * index))
    assert writer.state == "failed"
    with Reader(tmp_path / "bag") as reader:
        read = [raw for c, _, raw in reader.messages() if c.topic == "/displacement"]
    assert len(read) == writer.counts["displacement"] > 0
    with (tmp_path / "bag" / "bag_0.mcap").open("rb") as file:
        assert sum(1 for _ in make_reader(file).iter_messages(topics=["/displacement"])) == len(read)
    metadata = yaml.safe_load((tmp_path / "bag" / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert "No space left" in metadata["custom_data"]["failure"]


def test_limit_on_the_size_of_files(make_block, tmp_path):
    (tmp_path / "block").write_bytes(make_block(0))
    process = run_python(
        """
        import resource, sys
        from pathlib import Path
        from nmt_core.errors import BenchError
        from nmt_record.bag.bag_writer import BagWriter, Storage
        writer = BagWriter(sys.argv[1], storage=Storage(chunk_messages=7))
        writer.add_topic("displacement", "nmt_msgs/msg/SampleBlock")
        raw = Path(sys.argv[2]).read_bytes()
        resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, 50_000))
        try:
            for _ in range(1_000):
                writer.write("displacement", raw)
        except BenchError as error:
            print(error)
            sys.exit(2)
        """,
        tmp_path / "bag",
        tmp_path / "block",
    )
    said, _ = process.communicate()
    assert process.returncode == 2
    assert "File too large" in said
    bag = Bag.open(tmp_path / "bag")
    assert bag.topics["displacement"][1] > 50
    assert "the recorder could not write on" in bag.loss
