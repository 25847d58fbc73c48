"""One verdict on each window: where its edges are, what each fault does to it, and how little is kept for it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from extract.synthetic import RATE, Stream
from hypothesis import given, settings
from hypothesis import strategies as st

from nmt_core.messages.blocks import BlockFlag, OscillatorPhase, Quantity, SampleBlock
from nmt_core.vocabulary import LoopState, TestKind
from nmt_record.windows.sample_table import SampleTable
from nmt_record.windows.topic_blocks import ExcitationPhase, TopicBlocks, TopicStretch, phase_reference
from nmt_record.windows.window_policy import POLICIES, Consequence, NamedWindow, WindowFault, WindowFinding, judge

BLOCK = 50
TOPICS = ("force", "displacement")


def blocks_of(topic: str, samples: int = 1000) -> list[SampleBlock]:
    stream = Stream([0, 1j], [[0, 1.0]] * 4, samples=samples, block=BLOCK)
    return stream.blocks(topic)


FORCE = blocks_of("force")
DISPLACEMENT = blocks_of("displacement")


def table_of(force=FORCE, displacement=DISPLACEMENT, window=None, states=(), **options):
    """The only window of two streams."""
    table = SampleTable(TOPICS, require_loop_state=bool(states), **options)
    table.add_window("key", window or NamedWindow(200, 400))
    for topic, blocks in (("force", force), ("displacement", displacement)):
        for block in blocks:
            table.add_block(topic, block)
    for last_sample, state in states:
        table.add_state(last_sample, state)
    table.finish()
    (cut,) = table.take()
    assert cut.key == "key"
    return cut


def flagged(indices, flag=BlockFlag.LIMIT, blocks=FORCE):
    return [replace(b, flags=int(flag)) if i in indices else b for i, b in enumerate(blocks)]


@given(
    first=st.integers(0, 900),
    samples=st.integers(1, 400),
    bad=st.sets(st.integers(0, 19), max_size=4),
    missing=st.booleans(),
)
@settings(max_examples=200, deadline=None)
def test_a_window_is_spoiled_by_exactly_the_blocks_that_share_a_sample_with_it(first, samples, bad, missing):
    """Witness: every sample of every block, marked one by one."""
    spoiled = np.zeros(2000, dtype=bool)
    for index in bad:
        spoiled[index * BLOCK : (index + 1) * BLOCK] = True
    spoiled[1000:] = True  # nothing was recorded there
    force = [b for i, b in enumerate(FORCE) if i not in bad] if missing else flagged(bad)
    cut = table_of(force, window=NamedWindow(first, samples))
    inside = spoiled[first : first + samples]
    assert (cut.verdict.fault is not None) == bool(inside.any())
    if not inside.any():
        assert (cut.verdict.first_sample, cut.verdict.samples) == (first, samples)
        data = np.full((1, samples), math.nan)
        cut.stretches[0].copy_data(data)
        whole = np.concatenate([block.data for block in FORCE], axis=1)
        np.testing.assert_array_equal(data, whole[:, first : first + samples])


@pytest.mark.parametrize(
    ("index", "window", "spoils"),
    [
        (3, NamedWindow(200, 400), False),  # samples 150 to 199
        (3, NamedWindow(199, 400), True),
        (12, NamedWindow(200, 400), False),  # samples 600 to 649
        (12, NamedWindow(200, 401), True),
        (4, NamedWindow(249, 10), True),
        (4, NamedWindow(250, 10), False),
    ],
)
def test_edges_of_a_window(index, window, spoils):
    assert (table_of(flagged({index}), window=window).verdict.fault is WindowFault.LIMIT) == spoils
    holed = [block for number, block in enumerate(FORCE) if number != index]
    assert (table_of(holed, window=window).verdict.fault is WindowFault.MISSING) == spoils
    # The block after the window need not come; that of its last sample must.
    ended = table_of(FORCE[:12], window=NamedWindow(200, 400))
    assert ended.verdict.fault is None
    assert table_of(FORCE[:12], window=NamedWindow(200, 401)).verdict.fault is WindowFault.INCOMPLETE


@pytest.mark.parametrize(("lost", "spoils"), [(198, False), (199, False), (200, True), (598, True), (649, True)])
def test_the_lock_must_hold_from_the_first_to_the_last_sample(lost, spoils):
    """A state belongs to the block that ends with its sample: that after the last sample counts, if it is over it."""
    states = [(lost, LoopState.LOCK_LOST), (700 if lost > 199 else 649, LoopState.LOCKED)]
    cut = table_of(window=NamedWindow(200, 400, lock_sample=199), states=states)
    assert (cut.verdict.fault is WindowFault.LOST_LOCK) == spoils


@pytest.mark.parametrize(("sample", "spoils"), [(598, True), (599, False), (649, False)])
def test_the_block_that_ends_the_window_may_show_the_next_level(sample, spoils):
    """What the loop does after that block takes effect after it."""
    states = [(199, LoopState.LOCKED), (sample, LoopState.ACQUIRING), (700, LoopState.ACQUIRING)]
    cut = table_of(window=NamedWindow(200, 400, lock_sample=199), states=states)
    assert (cut.verdict.fault is WindowFault.LOST_LOCK) == spoils
    given_up = [(199, LoopState.LOCKED), (sample, LoopState.LOCK_LOST), (700, LoopState.LOCK_LOST)]
    assert table_of(window=NamedWindow(200, 400), states=given_up).verdict.fault is WindowFault.LOST_LOCK
    # A test that is not locked to a phase is only lost when it is given up.
    stepped = NamedWindow(200, 400, kind=TestKind.STEPPED_SINE)
    assert table_of(window=stepped, states=states).verdict.fault is None
    assert table_of(window=stepped, states=given_up).verdict.fault is WindowFault.LOST_LOCK


FAULTY = {
    WindowFault.LIMIT: flagged({8}),
    WindowFault.WATCHDOG: flagged({8}, BlockFlag.WATCHDOG),
    WindowFault.STOPPED: flagged({8}, BlockFlag.STOP),
    WindowFault.OVERLOAD: flagged({8}, BlockFlag.OVERLOAD),
    WindowFault.MISSING: [block for number, block in enumerate(FORCE) if number != 8],
    WindowFault.REPEATED: [*FORCE[:9], FORCE[8], *FORCE[9:]],
    WindowFault.CHANNELS: [replace(b, channels=("f9",)) if i == 8 else b for i, b in enumerate(FORCE)],
    WindowFault.RATE: [replace(b, sample_rate=2.0 * RATE) if i == 8 else b for i, b in enumerate(FORCE)],
    WindowFault.PHASE_JUMP: [
        replace(b, oscillator=b.oscillator._replace(cycles=0.123)) if i == 8 else b for i, b in enumerate(FORCE)
    ],
    WindowFault.SILENT: [
        replace(b, oscillator=OscillatorPhase(b.oscillator.cycles, 0.0)) if i == 8 else b for i, b in enumerate(FORCE)
    ],
}


@pytest.mark.parametrize("fault", list(FAULTY))
@pytest.mark.parametrize("kind", [TestKind.PHASE_RESONANCE, TestKind.STEPPED_SINE])
def test_what_spoils_a_window_of_a_steady_state(fault, kind):
    verdict = table_of(FAULTY[fault], window=NamedWindow(200, 400, kind=kind)).verdict
    assert verdict.fault is fault
    assert verdict.samples == 0
    assert verdict.reason.endswith(".")


@pytest.mark.parametrize("fault", list(FAULTY))
def test_a_sweep_can_be_used_up_to_its_fault(fault):
    verdict = table_of(FAULTY[fault], window=NamedWindow(200, 400, kind=TestKind.SWEEP)).verdict
    if fault is WindowFault.SILENT:
        # Silence is not a fault of a sweep; that the phase has gone on meanwhile is.
        assert (verdict.fault, verdict.samples) == (WindowFault.PHASE_JUMP, 250)
    else:
        assert (verdict.fault, verdict.first_sample) == (fault, 200)
        # A doubled block is all right until it comes again.
        assert verdict.samples == 200


def test_the_earliest_fault_ends_a_sweep():
    force = flagged({10}, BlockFlag.OVERLOAD, FAULTY[WindowFault.LIMIT])
    displacement = flagged({6}, BlockFlag.WATCHDOG, DISPLACEMENT)
    verdict = table_of(force, displacement, NamedWindow(200, 400, kind=TestKind.SWEEP)).verdict
    assert (verdict.fault, verdict.samples) == (WindowFault.WATCHDOG, 100)


def test_random_excitation_can_be_used_in_its_longest_part():
    holed = [block for number, block in enumerate(FORCE) if number not in (5, 16)]
    window = NamedWindow(100, 800, kind=TestKind.RANDOM)
    verdict = table_of(holed, window=window).verdict
    assert (verdict.fault, verdict.first_sample, verdict.samples) == (WindowFault.MISSING, 300, 500)
    halved = [block for number, block in enumerate(FORCE) if number not in (9,)]
    assert table_of(halved, window=NamedWindow(100, 750, kind=TestKind.RANDOM)).verdict.samples == 0
    for fault in (WindowFault.PHASE_JUMP, WindowFault.SILENT):
        assert table_of(FAULTY[fault], window=window).verdict.fault is None
    assert table_of(FAULTY[WindowFault.OVERLOAD], window=window).verdict.samples == 0


def test_faults_of_topics_that_a_window_does_not_need_cost_channels_only():
    window = NamedWindow(200, 400)
    finding = WindowFinding(WindowFault.OVERLOAD, "A voltage was too large.", 300, "voltage", 350)
    assert judge(window, [finding], TOPICS).fault is None
    assert window.policy.effect(finding, TOPICS) is Consequence.CHANNELS
    assert judge(window, [finding], (*TOPICS, "voltage")).fault is WindowFault.OVERLOAD
    unit = WindowFinding(WindowFault.UNIT, "The unit is odd.", 200, "force")
    assert judge(window, [unit], TOPICS).fault is None
    assert judge(window, [unit], TOPICS, every_channel=True).fault is WindowFault.UNIT
    # What spoils the window itself is said first, whoever asks.
    both = [unit, finding._replace(topic="force")]
    assert judge(window, both, TOPICS, every_channel=True) == judge(window, both, TOPICS)


def test_every_kind_says_what_every_fault_does():
    for kind in TestKind:
        assert set(POLICIES[kind].effects) == set(WindowFault)
    assert POLICIES[TestKind.UNKNOWN].effects == POLICIES[TestKind.PHASE_RESONANCE].effects
    record = POLICIES[TestKind.RECORD].effects
    assert record[WindowFault.LIMIT] is Consequence.CHANNELS
    assert record[WindowFault.INCOMPLETE] is Consequence.WINDOW


def shifted(blocks, by, since):
    return [replace(b, first_sample=b.first_sample - by) if b.first_sample >= since else b for b in blocks]


@pytest.mark.parametrize("by", [20, 150, 300])
def test_a_clock_that_is_set_back_spoils_what_was_not_complete(by):
    """150 samples are three blocks, 20 less than one."""
    force = shifted(FORCE, by, 650)
    assert table_of(force, window=NamedWindow(200, 400)).verdict.fault is None
    assert table_of(force, window=NamedWindow(200, 450)).verdict.fault is None
    spoiled = table_of(force, window=NamedWindow(700, 60)).verdict
    assert spoiled.fault is WindowFault.SET_BACK
    assert f"set back from sample 650 to {650 - by}" in spoiled.reason
    # In whichever order the streams arrive.
    table = SampleTable(TOPICS, require_loop_state=False)
    table.add_window(1, NamedWindow(200, 400))
    for topic, blocks in (("displacement", DISPLACEMENT), ("force", force)):
        for block in blocks:
            table.add_block(topic, block)
    assert [cut.verdict.fault for cut in table.take()] == [None]


def test_one_block_out_of_order_is_no_clock_that_was_set_back():
    for extra in ([FORCE[9]], [FORCE[3]], [FORCE[0]]):
        force = [*FORCE[:10], *extra, *FORCE[10:]]
        assert table_of(force, window=NamedWindow(600, 300)).verdict.fault is None
        assert table_of(force, window=NamedWindow(200, 400)).verdict.fault is WindowFault.REPEATED


def test_a_source_that_begins_anew_is_a_new_acquisition_in_streams_and_none_in_recordings():
    for one_acquisition in (False, True):
        table = SampleTable(TOPICS, require_loop_state=False, one_acquisition=one_acquisition)
        table.add_window("old", NamedWindow(600, 600))
        for topic, blocks in (("force", FORCE), ("displacement", DISPLACEMENT)):
            for block in [*blocks, *blocks[:10]]:
                table.add_block(topic, block)
        table.add_window("new", NamedWindow(100, 400))
        table.add_window("later", NamedWindow(600, 300))
        for topic, blocks in (("force", FORCE), ("displacement", DISPLACEMENT)):
            for block in blocks[10:]:
                table.add_block(topic, block)
        table.finish()
        faults = {cut.key: cut.verdict.fault for cut in table.take()}
        if one_acquisition:
            # The samples of the first acquisition are the only ones of that name.
            assert faults == {"old": WindowFault.SET_BACK, "new": None, "later": None}
        else:
            assert faults == {"old": WindowFault.NEW_ACQUISITION, "new": None, "later": None}


def test_only_the_blocks_of_a_window_are_looked_at():
    """Whatever is kept from before: the search is not a walk."""
    decoded = []

    def decode(block):
        decoded.append(block.first_sample)
        return block

    table = SampleTable(("force",), decode, require_loop_state=False)
    records = TopicBlocks("force")
    for index in range(5000):
        block = replace(FORCE[0], first_sample=BLOCK * index)
        table.add_record("force", block.first_sample, BLOCK, block)
        records.add(block.first_sample, block.first_sample + BLOCK, block)
    table.add_window(0, NamedWindow(200_010, 100))
    assert decoded == [200_000, 200_050, 200_100]
    assert [record.first for record in records.over(200_010, 200_110)] == decoded
    records.forget(200_050)
    assert len(records) == 5000 - 4001
    assert [record.first for record in records.over(0, 200_110)] == [200_050, 200_100]


def test_the_phase_goes_on_across_a_gap_and_is_quadratic_in_a_sweep():
    rate, start = -40.0, 60.0
    time = np.arange(1001) / RATE
    cycles = 0.4 + start * time + 0.5 * rate * time**2
    blocks = [
        replace(
            block,
            oscillator=OscillatorPhase(cycles[block.first_sample] % 1.0, start + rate * time[block.first_sample], rate),
        )
        for block in FORCE
        if block.first_sample not in (400, 450)
    ]
    records = TopicBlocks("force")
    for block in blocks:
        records.add(block.first_sample, block.end_sample, block)
    stretch = TopicStretch.of("force", 110, 800, records.over(110, 910))
    phase = ExcitationPhase(stretch)
    got = phase.cycles()
    missing = np.isnan(got)
    assert np.flatnonzero(missing).tolist() == list(range(290, 390))
    offset = np.round(got[0] - cycles[110])
    np.testing.assert_allclose(got[~missing], cycles[110:910][~missing] + offset, atol=1e-6)
    assert phase.end_cycles() == pytest.approx(cycles[910] + offset, abs=1e-6)
    assert list(phase.findings()) == []
    assert [finding[2:] for finding in stretch.findings] == [(400, "force", 500)]


def test_a_phase_that_runs_backwards_is_a_jump():
    backwards = [
        replace(b, oscillator=b.oscillator._replace(rate_hz_s=-2.0 * b.oscillator.frequency_hz * RATE / BLOCK))
        if i == 8
        else b
        for i, b in enumerate(FORCE)
    ]
    assert table_of(backwards).verdict.fault is WindowFault.PHASE_JUMP


def test_the_force_says_the_phase():
    stretches = [TopicStretch("displacement", 0, 1, (), ()), TopicStretch("force", 0, 1, (), ())]
    assert phase_reference(stretches).topic == "force"
    assert phase_reference(stretches[:1]).topic == "displacement"
    assert DISPLACEMENT[0].quantity is Quantity.DISPLACEMENT
