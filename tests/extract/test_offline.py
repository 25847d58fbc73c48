"""Extraction from real bags, written without ROS."""

from __future__ import annotations

import json
import math
from dataclasses import asdict

import pytest
from extract.synthetic import FREQUENCY, RATE, SETTINGS, Stream, in_phase_case, linear_description, lock_event

from nmt_core.errors import BenchError
from nmt_core.messages.records import LevelCommand, LoopStatus
from nmt_core.messages.wire import LEVEL, LOCK_EVENT, BlockWriter, write_status
from nmt_core.vocabulary import LoopState, PointStatus
from nmt_extract.extraction_settings import ExtractionSettings
from nmt_extract.extractor import Extractor
from nmt_extract.modal.table import read_json, write_results
from nmt_extract.offline import extract_bag
from nmt_record.bag.bag_reader import Bag
from nmt_record.bag.bag_writer import BagWriter, Storage

SAMPLES = round(5 * RATE / FREQUENCY)
LOCK = lock_event(400, SAMPLES, 5, sample=399)
RUN = {
    "run_id": "r1",
    "rig": "beam",
    "linear": asdict(linear_description()),
    "extraction": {"harmonics": 10, "topics": ["force", "displacement"]},
}
TOPICS = {
    "force": "nmt_msgs/msg/SampleBlock",
    "displacement": "nmt_msgs/msg/SampleBlock",
    "frequency": "nmt_msgs/msg/Frequency",
    "lock": "nmt_msgs/msg/LockEvent",
    "level": "nmt_msgs/msg/Level",
}


@pytest.fixture(scope="module")
def stream():
    force, shape = in_phase_case()
    return Stream([0, force], [[0, x] for x in shape], samples=4000, noise=0.01)


@pytest.fixture
def make_bag(tmp_path, stream):
    writers = []

    def make(run=RUN, lock=LOCK, states=None, leave_out=(), close=True, drop=()):
        blocks = BlockWriter("beam")
        writer = BagWriter(
            tmp_path / "bag", run_json=json.dumps(run) if run else "", rig_yaml="", storage=Storage(chunk_messages=4)
        )
        writers.append(writer)
        for topic, kind in TOPICS.items():
            writer.add_topic(topic, kind)

        def write(topic, raw):
            if topic not in leave_out:
                writer.write(topic, raw)

        write("level", LEVEL.write(LevelCommand(1, 0, 0.1, 0, 0.0)))
        for pair in zip(stream.blocks("force"), stream.blocks("displacement"), strict=True):
            for block in pair:
                if block.first_sample not in drop:
                    write(block.quantity.topic, blocks.write(block))
            last = pair[0].end_sample - 1
            if lock and last == lock.sample:
                write("lock", LOCK_EVENT.write(lock))
            state = (states or {}).get(last, LoopState.LOCKED)
            status = LoopStatus(last, 0, 0, state, 0.0, 0.0, 0.0, 0.0, "m", 0.0, reason="too noisy")
            write("frequency", write_status(status, RATE))
        if close:
            writer.close()
        else:
            writer.flush()
        return tmp_path / "bag"

    yield make
    for writer in writers:
        writer.close_quietly()


def expected_point(stream):
    extractor = Extractor(linear_description(), SETTINGS, require_loop_state=False)
    extractor.add_lock(LOCK)
    stream.feed(extractor)
    return extractor.take()[0]


def test_a_bag_gives_the_same_bits_as_the_blocks(make_bag, stream):
    result = extract_bag(make_bag())
    (point,) = result.points
    assert point.status is PointStatus.OK
    assert point.identical(expected_point(stream))
    assert result.loss is None
    assert result.run["run_id"] == "r1"
    assert result.counters["points"] == 1
    assert result.counters["blocks_force"] == 20


def test_topics_follow_from_the_bag_if_nobody_says(make_bag, stream):
    result = extract_bag(make_bag(run={**RUN, "extraction": {"harmonics": 10}}))
    assert result.settings.topics == ("force", "displacement")
    assert result.points[0].identical(expected_point(stream))


def test_given_modes_and_settings_take_precedence(make_bag):
    path = make_bag(run=None)
    with pytest.raises(BenchError, match="does not say which linear modes"):
        extract_bag(path)
    result = extract_bag(path, linear_description(), ExtractionSettings(harmonics=4, topics=("force", "displacement")))
    assert result.points[0].harmonics == 4


def test_files_of_a_result(make_bag, tmp_path):
    result = extract_bag(make_bag())
    write_results(result.points, tmp_path, result.inputs)
    (point,), inputs = read_json(tmp_path / "modal.json")
    assert point.identical(result.points[0])
    assert inputs["linear"]["drive_point"] == 2
    assert inputs["linear"]["force_per_volt"] is None
    assert inputs["extraction"]["harmonics"] == 10


def test_missing_blocks_reject_the_window(make_bag):
    (point,) = extract_bag(make_bag(drop=(1000,))).points
    assert point.status is PointStatus.REJECTED
    assert point.reason == "Samples 1000 to 1199 of 'force' are missing from the window."


def test_lost_lock_rejects_the_window(make_bag):
    (point,) = extract_bag(make_bag(states={999: LoopState.LOCK_LOST})).points
    assert point.status is PointStatus.REJECTED
    assert "lock lost at sample 999 (too noisy)" in point.reason


def test_bags_without_lock_events_are_refused_with_a_sentence(make_bag):
    with pytest.raises(BenchError, match="no level of the run locked"):
        extract_bag(make_bag(lock=None, states={199: LoopState.ACQUIRING}))


@pytest.mark.parametrize(
    ("leave_out", "sentence"),
    [
        (("lock", "frequency"), "has no 'lock' events, so no window to extract"),
        (("force",), "has no force .*without it a window tells no damping; .*diagnose --model"),
        (("force", "displacement"), "has no samples of force, displacement"),
    ],
)
def test_bags_that_lack_topics(make_bag, leave_out, sentence):
    with pytest.raises(BenchError, match=sentence):
        extract_bag(make_bag(leave_out=leave_out))


@pytest.mark.parametrize(
    "change", [{"linear": "none"}, {"linear": {"source": "model"}}, {"extraction": []}, {"extraction": {"h": 1}}]
)
def test_malformed_run_records(make_bag, change):
    path = make_bag(run={**RUN, **change})
    if change == {"extraction": []}:
        assert extract_bag(path).settings.topics == ("force", "displacement")
    else:
        with pytest.raises(BenchError):
            extract_bag(path)


def test_without_loop_states_a_bag_still_extracts(make_bag, stream):
    (point,) = extract_bag(make_bag(leave_out=("frequency",))).points
    assert point.identical(expected_point(stream))


def test_a_cut_off_bag_says_what_is_lost(make_bag):
    path = make_bag(close=False)
    result = extract_bag(path)
    assert result.loss is not None
    assert all(math.isfinite(point.damping_ratio) for point in result.points if point.status is PointStatus.OK)


def outcome(path):
    """The result of an extraction, or the sentence that refuses the bag."""
    try:
        return extract_bag(path)
    except BenchError as error:
        return str(error)


def test_a_bag_cut_before_its_first_lock_is_called_cut(make_bag, tmp_path):
    """Nobody knows whether a level locked in what is missing."""
    path = make_bag()
    whole = (path / "bag_0.mcap").read_bytes()
    verdicts = set()
    for size in range(9_000, len(whole), 1_500):
        (tmp_path / "cut.mcap").write_bytes(whole[:size])
        result = outcome(tmp_path / "cut.mcap")
        said = result if isinstance(result, str) else result.loss
        assert "is cut off" in said
        assert "locked" not in said
        verdicts.update(["refused"] if isinstance(result, str) else [point.status.name for point in result.points])
    assert verdicts >= {"refused", "REJECTED"}


def test_damage_rejects_the_window_it_falls_into_and_no_other(make_bag):
    path = make_bag()
    file = path / "bag_0.mcap"
    whole = file.read_bytes()
    sound = extract_bag(path).points[0]
    window = (LOCK.window_first_sample, LOCK.window_first_sample + LOCK.window_samples)
    seen = set()
    for position in range(12_000, len(whole) - 6_000, 1_700):
        damaged = bytearray(whole)
        damaged[position] ^= 16
        file.write_bytes(damaged)
        result = outcome(path)
        if isinstance(result, str):  # the lock event was in it
            assert "is damaged" in result
            assert "locked" not in result
            continue
        hit = any(span.touches(*window) for span in Bag.open(path).lost_spans)
        seen.add(hit)
        if hit:
            assert "is damaged" in result.loss
            assert result.points[0].status is PointStatus.REJECTED
        else:
            assert result.points[0].identical(sound)
    assert seen == {True, False}
