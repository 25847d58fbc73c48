from __future__ import annotations

import math

import pytest

from nmt_core.errors import BenchError
from nmt_core.kinds import GOAL_FIELDS, KINDS, goal_fields, kind_class, kind_of_goal
from nmt_core.vocabulary import TestKind

RANDOM = {"test": TestKind.RANDOM, "band_low_hz": 10.0, "band_high_hz": 2000.0, "duration": 20.0}
SWEEP = {"test": TestKind.SWEEP, "rate_hz_s": -0.2, "frequency_end_hz": 350.0}


@pytest.mark.parametrize(
    ("fields", "frequencies"),
    [
        ({}, ()),
        ({}, (22.0, 22.0)),
        (RANDOM, ()),
        (SWEEP, (390.0, 380.0)),
        ({"test": TestKind.STEPPED_SINE}, (21.0, 22.0)),
        ({"test": TestKind.RING_DOWN, "duration": 2.0}, ()),
    ],
)
def test_what_a_bench_can_do_passes_and_goes_through_messages(fields, frequencies):
    kind = kind_of_goal({"test": TestKind.PHASE_RESONANCE, **fields})
    kind.check(frequencies, 2, 1, 10_000.0)
    assert kind_of_goal(goal_fields(kind)) == kind
    assert set(goal_fields(kind)) == {*GOAL_FIELDS, "test"}


@pytest.mark.parametrize(
    ("fields", "frequencies", "control", "sentence"),
    [
        ({**RANDOM, "band_high_hz": 5000.0}, (), 1, "half the sample rate, 5000 Hz"),
        ({**RANDOM, "band_low_hz": 0.0}, (), 1, "must lie between 0"),
        ({**RANDOM, "band_low_hz": 2000.0}, (), 1, "lower edge first"),
        ({**RANDOM, "duration": 0.0}, (), 1, "random test needs a duration"),
        ({**RANDOM, "duration": -1.0}, (), 1, "random test needs a duration"),
        ({**RANDOM, "duration": math.inf}, (), 1, "must be finite"),
        (RANDOM, (), 3, "levels of voltage"),
        (RANDOM, (22.0, 23.0), 1, "no frequencies"),
        ({**SWEEP, "rate_hz_s": 0.0}, (390.0, 390.0), 1, "rate other than 0"),
        ({**SWEEP, "rate_hz_s": 0.2}, (390.0, 390.0), 1, "mind its sign"),
        ({**SWEEP, "frequency_end_hz": 6000.0}, (390.0, 390.0), 1, "sweep's end of 6000 Hz"),
        (SWEEP, (), 1, "needs a frequency"),
        (SWEEP, (350.0, 390.0), 1, "does not lead from 350 to 350"),
        (SWEEP, (390.0,), 1, "1 frequencies for 2 levels"),
        ({"test": TestKind.STEPPED_SINE}, (21.0, 5000.0), 1, "frequency of 5000 Hz"),
        ({"test": TestKind.STEPPED_SINE}, (21.0, math.nan), 1, "frequency of nan Hz"),
        ({"test": TestKind.RING_DOWN}, (), 1, "ring down test needs a duration"),
        ({"test": TestKind.SELF_EXCITED, "duration": 5.0}, (), 1, "levels of the response"),
        ({"test": TestKind.SELF_EXCITED, "duration": 0.0}, (), 2, "self excited test needs a duration"),
        ({"test": TestKind.RECORD}, (), 1, "does no record test"),
        ({"duration": 3.0}, (), 1, "phase resonance test has no duration"),
        ({**SWEEP, "band_low_hz": 10.0}, (390.0, 390.0), 1, "sweep test has no band_low_hz"),
    ],
)
def test_what_it_cannot_do_is_refused_in_a_sentence(fields, frequencies, control, sentence):
    with pytest.raises(BenchError, match=sentence):
        kind_of_goal({"test": TestKind.PHASE_RESONANCE, **fields}).check(frequencies, 2, control, 10_000.0)


def test_every_number_has_a_class_and_an_old_recording_is_phase_resonance():
    assert set(KINDS) == {kind for kind in TestKind if kind}
    assert kind_class(TestKind.UNKNOWN) is KINDS[TestKind.PHASE_RESONANCE]


@pytest.mark.parametrize(
    ("name", "given", "sentence"),
    [
        ("phase_resonance", {"harmonics_control": 1}, "from 2 to 50, 0 for none or auto, got 1"),
        ("phase_resonance", {"harmonics_control": "many"}, "is not a number"),
        ("phase_resonance", {"method": "envelope"}, "A phase resonance test has no method"),
        ("self_excited", {"refinement": 0.001}, "A self excited test has no refinement"),
        ("secondary_resonance", {}, "needs the resonance, 3:1 or 1:3"),
        ("random", {"band_hz": (1.0,)}, "lower and an upper edge, got 1"),
    ],
)
def test_settings_of_another_kind_and_words_nobody_knows_are_refused(name, given, sentence):
    with pytest.raises(BenchError, match=sentence):
        KINDS[TestKind.named(name)].spelled(**given)


def test_a_subharmonic_needs_its_release_before_the_run():
    kind = KINDS[TestKind.SECONDARY_RESONANCE].spelled(resonance="1:3")
    with pytest.raises(BenchError, match="give --release"):
        kind.check((), 1, 3, 10_000.0)


def test_kinds_by_number_and_name():
    assert TestKind.of(0) is TestKind.PHASE_RESONANCE
    assert [TestKind.of(int(kind)) for kind in TestKind if kind] == [kind for kind in TestKind if kind]
    assert TestKind.named("ring_down") is TestKind.RING_DOWN
    with pytest.raises(BenchError, match="kind 99 is not known"):
        TestKind.of(99)
    with pytest.raises(BenchError, match="'unknown' is not known; use phase_resonance, random"):
        TestKind.named("unknown")
