from __future__ import annotations

import math
import weakref
from dataclasses import replace

import numpy as np
import pytest
from extract.synthetic import FREQUENCY, POINTS, RATE, Stream, lock_event
from hypothesis import given, settings
from hypothesis import strategies as st

from nmt_core.messages.blocks import BlockFlag, OscillatorPhase, Quantity
from nmt_core.vocabulary import LoopState
from nmt_extract.modal.window import SpoiledWindow, Window, WindowAssembler
from nmt_record.windows.sample_table import SampleTable
from nmt_record.windows.topic_blocks import TopicBlocks

SAMPLES = round(5 * RATE / FREQUENCY)
LOCK = lock_event(300, SAMPLES, 5, sample=299)
TOPICS = ("force", "displacement")


@pytest.fixture
def stream():
    return Stream([0.1, 1j], [[0, x, 0.1 * x] for x in (1.0, 2.0, 3.0, 4.0)], samples=4000)


def feed(assembler, force, displacement, states=()):
    for pair in zip(force, displacement, strict=True):
        for block in pair:
            if block is not None:
                assembler.add_block(block.quantity.topic, block)
    for last_sample, state in states:
        assembler.add_state(last_sample, state, "phase error 9 deg." if state == LoopState.LOCK_LOST else "")


def only(assembler):
    windows = assembler.take()
    assembler.finish()
    windows += assembler.take()
    (window,) = windows
    return window


def cut(stream, lock=LOCK, change=None, topics=TOPICS):
    """The outcome after ``change`` has had its way with the displacement blocks."""
    blocks = stream.blocks("displacement")
    if change:
        blocks = change(blocks)
    assembler = WindowAssembler(topics, require_loop_state=False)
    assembler.add_lock(lock)
    feed(assembler, stream.blocks("force"), blocks)
    return only(assembler)


def test_a_window_is_the_samples_it_names(stream):
    window = cut(stream)
    assert isinstance(window, Window)
    np.testing.assert_array_equal(window.data[0], stream.force[0, 300 : 300 + SAMPLES])
    np.testing.assert_array_equal(window.data[1:], stream.response[:, 300 : 300 + SAMPLES])
    assert [(c.quantity, c.point) for c in window.channels] == [
        (Quantity.FORCE, 2),
        *((Quantity.DISPLACEMENT, point) for point in POINTS),
    ]
    difference = window.cycles - stream.cycles[300 : 300 + SAMPLES]
    np.testing.assert_allclose(difference, np.round(difference[0]), atol=1e-12)
    assert window.end_cycles - window.cycles[0] == pytest.approx(FREQUENCY * SAMPLES / RATE, abs=1e-11)


@given(st.integers(0, 1000), st.integers(1, 2000), st.sampled_from([1, 7, 50, 200, 999]), st.integers(0, 4000))
@settings(max_examples=30, deadline=None)
def test_any_cut_and_any_moment_of_the_lock_event(first, samples, size, when):
    stream = Stream([0.1, 1j], [[0, 1.0]] * 4, samples=4000, block=4000)
    assembler = WindowAssembler(TOPICS, require_loop_state=False)
    lock = lock_event(first, samples, 0)
    given_ = False
    for pair in zip(stream.blocks("force", size), stream.blocks("displacement", size), strict=True):
        if not given_ and pair[0].first_sample >= when:
            assembler.add_lock(lock)
            given_ = True
        for block in pair:
            assembler.add_block(block.quantity.topic, block)
    if not given_:
        assembler.add_lock(lock)
    window = only(assembler)
    np.testing.assert_array_equal(window.data[0], stream.force[0, first : first + samples])


@given(st.permutations(range(40)))
@settings(max_examples=25, deadline=None)
def test_the_order_between_streams_does_not_matter(order):
    """Any interleaving that keeps each stream's own order."""
    stream = Stream([0.1, 1j], [[0, 1.0]] * 4, samples=4000)
    queues = {"force": stream.blocks("force"), "displacement": stream.blocks("displacement")}
    picks = ["force" if index < 20 else "displacement" for index in order]
    assembler = WindowAssembler(TOPICS, require_loop_state=False)
    assembler.add_lock(LOCK)
    for topic in picks:
        assembler.add_block(topic, queues[topic].pop(0))
    window = only(assembler)
    np.testing.assert_array_equal(window.data, cut(stream).data)


def drop(index):
    return lambda blocks: [None if i == index else block for i, block in enumerate(blocks)]


def alter(index, **changes):
    return lambda blocks: [replace(block, **changes) if i == index else block for i, block in enumerate(blocks)]


def with_nan(blocks):
    data = blocks[5].data.copy()
    data[2, 17] = math.nan
    return alter(5, data=data)(blocks)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (drop(5), "Samples 1000 to 1199 of 'displacement' are missing"),
        (drop(1), "Samples 300 to 399 of 'displacement' are missing"),
        (drop(12), "Samples 2400 to 2552 of 'displacement' are missing"),
        (lambda blocks: [*blocks[:8], *[None] * 12], "'displacement' ended after 1300 of its 2253 samples"),
        (lambda blocks: [None] * 20, "no block of 'displacement' came"),
        (alter(5, first_sample=900), "repeats samples from 900"),
        (with_nan, "Channel 'd5' of 'displacement' has no valid value at sample 1017"),
        (alter(5, flags=int(BlockFlag.OVERLOAD)), "a converter was overloaded"),
        (alter(5, flags=int(BlockFlag.LIMIT)), "a safety limit had tripped"),
        (alter(5, flags=int(BlockFlag.WATCHDOG)), "the drive watchdog had tripped"),
        (alter(5, channels=("d2", "d4", "d5", "d7")), "The channels change within the window"),
        (alter(5, points=(2, 4, 5, 7)), "The channels change within the window"),
        (alter(5, sample_rate=5000.0), "The sampling rate is 5000 Hz"),
        (alter(5, unit="mm"), "The unit of 'displacement' is 'mm' instead of m"),
        (alter(5, quantity=Quantity.UNKNOWN), "The quantity of 'displacement' is unknown"),
    ],
)
def test_spoiled_windows_say_why(stream, change, reason):
    blocks = change(stream.blocks("displacement"))
    assembler = WindowAssembler(TOPICS, require_loop_state=False)
    assembler.add_lock(LOCK)
    for pair in zip(stream.blocks("force"), blocks, strict=True):
        for topic, block in zip(TOPICS, pair, strict=True):
            if block is not None:
                assembler.add_block(topic, block)
    window = only(assembler)
    assert isinstance(window, SpoiledWindow)
    assert reason in window.reason
    assert window.reason.endswith(".")


@pytest.mark.parametrize("index", [0, 14, 19])
def test_flaws_outside_the_window_do_no_harm(stream, index):
    assert isinstance(cut(stream, change=alter(index, flags=7)), Window)


def test_too_few_periods_and_too_many_samples(stream):
    assert "2 whole periods" in cut(stream, lock_event(0, 900, 2)).reason
    assembler = WindowAssembler(TOPICS, maximum_samples=1000)
    assembler.add_lock(LOCK)
    assert "2253 samples is not within 1..1000" in only(assembler).reason


def altered_phase(blocks, **changes):
    return [replace(b, oscillator=b.oscillator._replace(**changes)) if i == 5 else b for i, b in enumerate(blocks)]


@pytest.mark.parametrize(
    ("changes", "reason"), [({"cycles": 0.123}, "phase jumps"), ({"frequency_hz": 0.0}, "no periodic excitation")]
)
def test_excitation_that_is_not_continuous(stream, changes, reason):
    assembler = WindowAssembler(TOPICS, require_loop_state=False)
    assembler.add_lock(LOCK)
    feed(assembler, altered_phase(stream.blocks("force"), **changes), stream.blocks("displacement"))
    assert reason in only(assembler).reason


def test_an_unknown_phase_in_one_block_makes_the_phase_unknown(stream):
    assembler = WindowAssembler(TOPICS, require_loop_state=False)
    assembler.add_lock(LOCK)
    feed(assembler, altered_phase(stream.blocks("force"), cycles=math.nan), stream.blocks("displacement"))
    window = only(assembler)
    assert window.cycles is None


def test_a_swept_block_is_followed():
    """Frequency rate within blocks: phase is quadratic in time."""
    stream = Stream([0, 1j], [[0, 1.0]] * 4, samples=1000)
    rate, start = 30.0, 20.0
    time = np.arange(1001) / RATE
    cycles = start * time + 0.5 * rate * time**2
    force = [
        replace(b, oscillator=OscillatorPhase(cycles[b.first_sample] % 1.0, start + rate * time[b.first_sample], rate))
        for b in stream.blocks("force")
    ]
    assembler = WindowAssembler(TOPICS, require_loop_state=False)
    assembler.add_lock(lock_event(100, 800, 0))
    feed(assembler, force, stream.blocks("displacement"))
    window = only(assembler)
    np.testing.assert_allclose(window.cycles, cycles[100:900] - np.floor(cycles[0]), atol=1e-12)
    assert window.end_cycles == pytest.approx(cycles[900], abs=1e-12)


def states(changes=()):
    """A LoopState.LOCKED state for each block, but for the given ones."""
    table = dict.fromkeys(range(199, 4000, 200), LoopState.LOCKED)
    table.update(changes)
    return sorted(table.items())


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({}, ""),
        ({199: LoopState.ACQUIRING}, ""),
        ({999: LoopState.ACQUIRING}, "acquiring at sample 999"),
        ({999: LoopState.LOCK_LOST}, "lock lost at sample 999 (phase error 9 deg)."),
        ({399: LoopState.FIXED}, "fixed frequency at sample 399"),
        ({2599: LoopState.LOCK_LOST}, "lock lost at sample 2599"),
        ({2599: LoopState.ACQUIRING, 2799: LoopState.ACQUIRING}, ""),
        ({2799: LoopState.LOCK_LOST}, ""),
    ],
)
@pytest.mark.parametrize("states_first", [True, False])
def test_the_loop_must_hold_its_lock(stream, changes, reason, states_first):
    assembler = WindowAssembler(TOPICS)
    if states_first:
        for entry in states(changes):
            assembler.add_state(*entry, "phase error 9 deg." if entry[1] == LoopState.LOCK_LOST else "")
        assembler.add_lock(LOCK)
        feed(assembler, stream.blocks("force"), stream.blocks("displacement"))
    else:
        feed(assembler, stream.blocks("force"), stream.blocks("displacement"))
        assembler.add_lock(LOCK)
        feed(assembler, [], [], states(changes))
    window = only(assembler)
    if reason:
        assert reason in window.reason
    else:
        assert isinstance(window, Window)


def test_without_the_loops_state_the_window_is_not_complete(stream):
    assembler = WindowAssembler(TOPICS)
    assembler.add_lock(LOCK)
    feed(assembler, stream.blocks("force"), stream.blocks("displacement"), states()[:8])
    assert assembler.take() == []
    assert "state did not come" in only(assembler).reason


def test_a_silent_topic_is_given_up_after_the_patience(stream):
    assembler = WindowAssembler(TOPICS, require_loop_state=False, patience_samples=1000)
    assembler.add_lock(LOCK)
    for block in stream.blocks("force"):
        assembler.add_block("force", block)
    (window,) = assembler.take()
    assert "no block of 'displacement' came" in window.reason


def test_the_memory_stays_bounded():
    assembler = WindowAssembler(("force",), history_samples=1000, require_loop_state=False)
    (block,) = Stream([0, 1j], [[0, 1.0]] * 4, samples=200).blocks("force")
    for index in range(1000):
        assembler.add_block("force", replace(block, first_sample=200 * index))
        assembler.add_state(200 * index + 199, LoopState.LOCKED)
    blocks, states_ = assembler.table.kept
    assert blocks <= 6
    assert states_ <= 6
    for first in (0, 200):
        assembler.add_block("force", replace(block, first_sample=first))
    assert assembler.table.kept[0] == 2
    assert assembler.table.gaps["force"] == 1


def test_many_channels_keep_a_shorter_history_but_a_second():
    data = np.zeros((100, 200))
    first = Stream([0, 1j], [[0, 1.0]] * 4, samples=200).blocks("force")[0]
    wide = replace(first, channels=tuple(f"f{k}" for k in range(100)), points=(0,) * 100, data=data)
    kept = {}
    for room in (800 * 1000, 800 * 10):
        table = SampleTable(("force",), require_loop_state=False, history_samples=100_000, history_bytes=room)
        for index in range(2000):
            table.add_block("force", replace(wide, first_sample=200 * index))
        kept[room] = 200 * table.kept[0]
    second = first.sample_rate
    assert kept[800 * 1000] == pytest.approx(max(1000, second), abs=400)
    assert kept[800 * 10] == pytest.approx(second, abs=400)


@pytest.mark.parametrize("rate", [math.nan, math.inf, 0.0, -1.0, 1e300])
def test_the_history_stands_blocks_of_any_rate(rate):
    (block,) = Stream([0, 1j], [[0, 1.0]] * 4, samples=200).blocks("force")[:1]
    table = SampleTable(("force", "displacement"), require_loop_state=False, history_samples=1000)
    empty = replace(block, channels=(), points=(), data=np.zeros((0, 200)))
    for index in range(20):
        table.add_block("force", replace(block, sample_rate=rate, first_sample=200 * index))
        table.add_block("displacement", replace(empty, sample_rate=rate, first_sample=200 * index))
    assert table.kept[0] <= 12


def test_samples_that_are_forgotten_are_let_go_at_once():
    blocks = TopicBlocks("force")
    (block,) = Stream([0, 1j], [[0, 1.0]] * 4, samples=200).blocks("force")[:1]
    held = []
    for index in range(100):  # too few for the list to be cut
        own = replace(block, first_sample=200 * index, data=block.data.copy())
        held.append(weakref.ref(own.data))
        blocks.add(200 * index, 200 * index + 200, own)
    del own
    blocks.forget(200 * 90)
    assert [reference() is not None for reference in held] == [False] * 90 + [True] * 10
    assert [record.first for record in blocks.over(0, 200 * 100)] == [200 * index for index in range(90, 100)]


def test_several_windows_at_once(stream):
    assembler = WindowAssembler(TOPICS, require_loop_state=False)
    for first in (100, 300, 1000):
        assembler.add_lock(lock_event(first, SAMPLES, 5))
    feed(assembler, stream.blocks("force"), stream.blocks("displacement"))
    assert [window.lock.window_first_sample for window in assembler.take()] == [100, 300, 1000]


def test_a_window_that_begins_before_the_first_sample_is_missing_samples(stream):
    assembler = WindowAssembler(TOPICS, require_loop_state=False)
    assembler.add_lock(LOCK)
    feed(assembler, stream.blocks("force")[3:], stream.blocks("displacement")[3:])
    assert "Samples 300 to 599 of 'force' are missing" in only(assembler).reason
