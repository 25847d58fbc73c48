"""Windows of a bag and their samples as arrays: kinds, faults, gaps, phase; bags from before there were kinds."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import BlockFlag, OscillatorPhase, Quantity, SampleBlock
from nmt_core.messages.records import LoopStatus
from nmt_core.messages.wire import BlockWriter, write_status
from nmt_core.vocabulary import TestKind
from nmt_record.bag.bag_reader import Bag
from nmt_record.bag.bag_writer import BagWriter
from nmt_record.bag.bench_topics import SAMPLE_BLOCK
from nmt_record.bag.message_definitions import DefinitionStore, MessageDefinition
from nmt_record.windows.segments import read_signals, segments

RATE, BLOCK = 1000.0, 100
LOCK = "nmt_msgs/msg/LockEvent"


def wave(first: int, row: int) -> np.ndarray:
    return np.sin(0.01 * (first + np.arange(BLOCK)) + row)


def phase(first: int, start_hz: float, rate: float) -> OscillatorPhase:
    time = first / RATE
    cycles = 0.3 + start_hz * time + 0.5 * rate * time**2
    return OscillatorPhase(cycles % 1.0, start_hz + rate * time, rate)


def write(
    path: Path, blocks: range = range(20), start_hz: float = 21.0, rate: float = 3.0, flags: int = 0, **options: float
) -> BagWriter:
    """Force at one point and motion at two; the writer is left open."""
    writer = BagWriter(path)
    for topic in ("force", "displacement"):
        writer.add_topic(topic, SAMPLE_BLOCK)
    bytes_of = BlockWriter("rig").write
    for number in blocks:
        first = number * BLOCK
        oscillator = phase(first, start_hz, rate)
        if "cycles" in options:
            oscillator = OscillatorPhase(options["cycles"], start_hz)
        force = SampleBlock(first, RATE, Quantity.FORCE, "N", ("f2",), (2,), wave(first, 0)[None], oscillator)
        rows = np.stack([wave(first, 1), wave(first, 2)])
        motion = SampleBlock(first, RATE, Quantity.DISPLACEMENT, "m", ("x2", "x4"), (2, 4), rows, oscillator, flags)
        writer.write("force", bytes_of(force), first, first)
        writer.write("displacement", bytes_of(motion), first, first)
    return writer


def lock_event(store: DefinitionStore, **fields: object) -> object:
    values = {
        "stamp": store.typestore.types["builtin_interfaces/msg/Time"](0, 0),
        "held_phase": 0.0, "level_index": 0, "level": 0.3, "level_unit": "N", "sample": 299, "frequency_hz": 21.0,
        "phase_error": math.nan, "window_first_sample": 350, "window_samples": 1230, "window_periods": 0, "test": 3,
        "response_order": 0, "force_order": 0, "perturbation": 0.0, "parameter": 0,
    }  # fmt: skip
    return store.typestore.types[LOCK](**{**values, **fields})


def test_samples_and_phase_are_contiguous_over_blocks(tmp_path):
    write(tmp_path / "bag").close()
    signals = read_signals(Bag.open(tmp_path / "bag"), 350, 1230)
    assert list(signals.channels) == ["f2", "x2", "x4"]
    index = 350 + np.arange(1230)
    for row, name in enumerate(signals.channels):
        assert np.array_equal(signals.channels[name], np.sin(0.01 * index + row))
        assert signals.channels[name].flags.c_contiguous
    assert signals.units == {"f2": "N", "x2": "m", "x4": "m"}
    assert signals.points == {"f2": 2, "x2": 2, "x4": 4}
    assert signals.named(Quantity.DISPLACEMENT) == ["x2", "x4"]
    assert signals.named(Quantity.DISPLACEMENT, 4) == ["x4"]
    assert (signals.sample_rate, signals.first_sample, signals.samples, signals.gaps) == (RATE, 350, 1230, ())
    time = index / RATE
    cycles = 0.3 + 21.0 * time + 1.5 * time**2
    assert signals.oscillator is not None
    assert 0.0 <= signals.oscillator[0] < 1.0
    assert np.allclose(signals.oscillator, cycles - math.floor(cycles[0]), atol=1e-9)


@pytest.mark.parametrize(
    ("missing", "expected"),
    [
        ((), [(0, 2000)]),
        ((0, 1, 19), [(200, 1900)]),
        ((3,), [(400, 2000)]),  # what comes before is less than half as long
        ((9,), [(0, 900), (1000, 2000)]),
    ],
)
def test_samples_without_a_run_are_records_of_what_is_whole(tmp_path, missing, expected):
    """Missing blocks and blocks with a NaN end a stretch alike, in any topic; as a bridge and a recorder write them."""
    for broken in ("left out", "not a number"):
        path = tmp_path / broken
        present = range(20) if broken == "not a number" else [n for n in range(20) if n not in missing]
        writer = write(path, blocks=present)
        if broken == "not a number":
            writer.close()
            writer = BagWriter(path.with_name("nan"))
            for topic in ("force", "displacement"):
                writer.add_topic(topic, SAMPLE_BLOCK)
            for topic in ("force", "displacement"):
                for block in Bag.open(path).blocks(topic):
                    data = block.data.copy()
                    if topic == "force" and block.first_sample // BLOCK in missing:
                        data[0, 7] = math.nan
                    raw = BlockWriter("rig").write(dataclasses.replace(block, data=data))
                    writer.write(topic, raw, block.first_sample, block.first_sample)
            path = path.with_name("nan")
        writer.close()
        found = segments(Bag.open(path))
        assert [(it.first_sample, it.end_sample) for it in found] == expected
        assert {it.kind for it in found} == {TestKind.RECORD}
        assert not any(it.fault for it in found)


def test_a_run_that_did_not_lock_is_no_record(tmp_path):
    run = write(tmp_path / "bag")
    run.add_topic("run_state", "nmt_msgs/msg/RunState")
    run.write("run_state", bytes(64), 0, 0)
    run.close()
    assert segments(Bag.open(tmp_path / "bag")) == []


def test_missing_blocks_are_named_and_do_not_cost_turns(tmp_path):
    write(tmp_path / "bag", blocks=range(2, 20), rate=0.0).close()
    bag = Bag.open(tmp_path / "bag")
    signals = read_signals(bag, 150, 500)
    assert signals.gaps == (("force", 150, 50), ("displacement", 150, 50))
    assert np.isnan(signals.channels["f2"][:50]).all()
    assert np.isfinite(signals.channels["f2"][50:]).all()
    holed = write(tmp_path / "holed", blocks=[*range(4), *range(9, 20)], rate=0.0)
    holed.close()
    signals = read_signals(Bag.open(tmp_path / "holed"), 0, 2000)
    assert signals.gaps[0] == ("force", 400, 500)
    assert signals.oscillator is not None
    present = np.isfinite(signals.oscillator)
    assert np.count_nonzero(~present) == 500
    assert np.allclose(signals.oscillator[present], (0.3 + 21.0 * np.arange(2000) / RATE)[present], atol=1e-9)
    with pytest.raises(BenchError, match="has no samples from 5000 to 5009"):
        read_signals(bag, 5000, 10)
    with pytest.raises(BenchError, match="at least one"):
        read_signals(bag, 0, 0)


@pytest.mark.parametrize("options", [{"cycles": math.nan}, {"cycles": 0.2, "start_hz": 0.0}])
def test_without_an_oscillator_there_is_no_phase(tmp_path, options):
    write(tmp_path / "bag", flags=int(BlockFlag.OVERLOAD), **options).close()
    signals = read_signals(Bag.open(tmp_path / "bag"), 0, 1000)
    assert signals.oscillator is None
    assert signals.flags == BlockFlag.OVERLOAD


def test_topics_of_two_rates_and_changing_channels_are_refused(tmp_path):
    bytes_of = BlockWriter("rig").write
    for name, sample_rate, channel in (("rates", 500.0, "x2"), ("names", RATE, "x9")):
        writer = write(tmp_path / name, blocks=range(2))
        topic = "acceleration" if name == "rates" else "displacement"
        quantity = Quantity[topic.upper()]
        writer.add_topic("acceleration", SAMPLE_BLOCK)
        odd = SampleBlock(200, sample_rate, quantity, quantity.unit, (channel,), (2,), np.zeros((1, BLOCK)))
        writer.write(topic, bytes_of(odd), 500, 500)
        writer.close()
    with pytest.raises(BenchError, match="'acceleration' was sampled at 500 Hz, 'force' at 1000 Hz"):
        read_signals(Bag.open(tmp_path / "rates"), 0, 300)
    with pytest.raises(BenchError, match=r"channels change within .* of 'displacement' at sample 200"):
        read_signals(Bag.open(tmp_path / "names"), 0, 300)


def test_segments_say_what_was_planned_and_what_went_wrong(tmp_path, store):
    writer = write(tmp_path / "bag")
    writer.add_topic("lock", LOCK)
    writer.add_topic("frequency", "nmt_msgs/msg/Frequency")
    for number, fields in enumerate(
        (
            {"window_samples": 750},
            {"level_index": 1, "window_first_sample": 1120, "window_samples": 300},
            {"level_index": 2, "window_first_sample": 1500, "window_samples": 800, "test": 2},
        )
    ):
        writer.write_message("lock", lock_event(store, **fields), receive_time_ns=3000 + number)
    for sample, state, reason in ((1099, 3, ""), (1199, 4, "a safety limit has tripped."), (1299, 4, "")):
        status = LoopStatus(sample, 1, 2, state, 21.0, 0.0, 1.0, 1.0, "m", 0.1, 0, reason)
        writer.write("frequency", write_status(status, RATE), 4000 + sample, sample)
    writer.close()
    whole, lost, short = segments(Bag.open(tmp_path / "bag"))
    assert (whole.kind, whole.level, whole.level_unit, whole.frequency_hz) == (TestKind.SWEEP, 0.3, "N", 21.0)
    assert (whole.first_sample, whole.samples, whole.end_sample, whole.fault) == (350, 750, 1100, "")
    assert (whole.usable_first_sample, whole.usable_samples) == (350, 750)
    reason = "The loop did not hold its lock over the window: lock lost at sample 1199 (a safety limit has tripped)"
    assert lost.fault == reason
    # The sweep can be used until it was given up.
    assert (lost.usable_first_sample, lost.usable_samples) == (1120, 79)
    assert short.kind is TestKind.RANDOM
    assert short.fault == "The window was never completed: 'force' ended after 500 of its 800 samples"
    assert short.usable_samples == 0


def test_bags_from_before_there_were_kinds_hold_phase_resonance(tmp_path, store):
    new = store.definition(LOCK)
    text = "\n".join(
        line
        for line in new.text.splitlines()
        if not line.lower().startswith(("uint8 test", "float64 held_phase", "float64 perturbation", "uint8 parameter"))
    )
    assert text.count("test") < new.text.count("test")
    writer = write(tmp_path / "bag")
    writer.add_topic("lock", LOCK, definition=MessageDefinition(text))
    raw = bytes(store.typestore.serialize_cdr(lock_event(store, window_periods=20), LOCK))
    writer.write("lock", raw[:-18], 3000, 3000)  # kind, held phase, perturbation and parameter are the last
    writer.close()
    bag = Bag.open(tmp_path / "bag")
    assert bag.lock_events()[0].test is TestKind.PHASE_RESONANCE
    (segment,) = segments(bag)
    assert (segment.kind, segment.periods) == (TestKind.PHASE_RESONANCE, 20)
