"""A channel in another unit or with the other sign is seen before a search, and no gap stands beside half a signal."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from diagnose.one_of_each_kind import KINDS, rig_of_kinds, with_chain
from moved_threshold import moved_threshold

from nmt_diagnose.diagnose import diagnose_observations
from nmt_diagnose.diagnosis_settings import DiagnosisSettings
from nmt_diagnose.ledger.diagnosis import Diagnosis, Verdict
from nmt_diagnose.ledger.plain_look import Factor, by_channel, factors, share_left
from nmt_diagnose.measurements.measurement import Observations, holds_amplitude, joined
from nmt_diagnose.observations.observables import Part
from nmt_diagnose.prediction.forward import Forward

CHANNEL = {
    "random responses": "x1",
    "random responses over force": "x1",
    "stepped responses": "a2",
    "free decay": "a2",
    "driven record": "x1",
    "imposed motion": "f1",
}
"""A channel of each kind whose amplitudes are not given."""
DEGREES = 180.0 / math.pi
FACTORS = (5.0, 20.0, DEGREES, 1000.0, -1.0, 9.80665, 1.0 / 9.80665)


@cache
def healthy(kind: str) -> Observations:
    """Noise as stated about what the model predicts."""
    observed = with_chain(KINDS[kind](rig_of_kinds()))
    noise = np.random.default_rng(1).standard_normal(len(observed.values))
    return replace(observed, values=observed.values + observed.std * noise)


def recorded(kind: str, factor: float) -> Observations:
    """The same with one channel larger, its noise too."""
    observed = healthy(kind)
    values, std, tests = observed.values.copy(), observed.std.copy(), list(observed.tests)
    for number, test in enumerate(tests):
        index = [channel.name for channel in test.channels].index(CHANNEL[kind])
        rows = (observed.rows.test == number) & (observed.rows.channel == index)
        values[rows & (observed.rows.part == Part.LOG_MAGNITUDE)] += math.log(abs(factor))
        values[rows & (observed.rows.part == Part.PHASE)] += math.pi * (factor < 0.0)
        samples = rows & (observed.rows.part == Part.SAMPLE)
        values[samples] *= factor
        std[samples] *= abs(factor)
        if holds_amplitude(test):
            column: Any = np.where(np.arange(len(test.channels)) == index, factor, 1.0)
            tests[number] = replace(test, measured=test.measured * column)  # type: ignore[type-var, attr-defined]
    return replace(observed, values=values, std=std, tests=tuple(tests))


def looked(observed: Observations) -> dict[str, float]:
    predicted = Forward(observed.tests, observed.rows).predict(rig_of_kinds()).values
    used = np.isfinite(observed.values)
    return {found.channel: found.factor for found in factors(observed, predicted, predicted, used)}


def diagnosed(observed: Observations) -> Diagnosis:
    settings = DiagnosisSettings(look_ahead=False)
    return diagnose_observations(rig_of_kinds(), observed, settings).diagnosis


@pytest.mark.parametrize("kind", CHANNEL)
def test_a_factor_is_seen_and_an_ordinary_gain_is_not(kind: str) -> None:
    for factor in (1.0, 1.02, 1.3, 2.0, 0.5):
        assert looked(recorded(kind, factor)) == {}, factor
    for factor in FACTORS:
        found = looked(recorded(kind, factor))
        assert found == {CHANNEL[kind]: pytest.approx(factor, rel=0.1)}, factor


@pytest.mark.parametrize(
    ("kind", "factor", "words"),
    [
        ("driven record", DEGREES, "x1 is 57.3 times what the model predicts: degrees that were read as radians?"),
        ("random responses", 1000.0, "x1 is 1000 times what the model predicts: thousandths of a unit"),
        ("imposed motion", -1.0, "f1 has the other sign than the model predicts; turn it, or its sensor."),
    ],
)
def test_units_and_signs_come_before_effects(kind: str, factor: float, words: str) -> None:
    found = diagnosed(recorded(kind, factor))
    assert found.verdict is Verdict.UNKNOWN
    assert words in found.sentences[0]
    assert found.ranking == ()
    assert [(it.detail, it.p) for it in found.where] == [(CHANNEL[kind], 1.0)]


def test_a_healthy_recording_has_no_gap() -> None:
    assert diagnosed(healthy("driven record")).verdict is Verdict.NONE


@pytest.mark.campaign
def test_no_gap_is_not_said_beside_half_a_signal() -> None:
    """A channel that shows something else than the model, in noise that is learnt from it."""
    observed = healthy("driven record")
    rows = (observed.rows.part == Part.SAMPLE) & (observed.rows.channel == 1)
    other = np.random.default_rng(2).permutation(observed.values[rows])
    values = observed.values.copy()
    values[rows] = other
    found = diagnosed(replace(observed, values=values))
    assert found.verdict is Verdict.UNKNOWN
    assert "of the signal of x1 in record" in found.sentences[0] or "x1" in found.where[0].detail


def test_a_stiffer_spring_is_no_unit() -> None:
    """Four times the force of a motion that the spring alone takes is told by the spring where a re-fit reaches it."""
    observed = recorded("imposed motion", 4.0)
    predicted = Forward(observed.tests, observed.rows).predict(rig_of_kinds()).values
    used, reached = np.isfinite(observed.values), observed.values.copy()
    assert [it.channel for it in factors(observed, predicted, predicted, used)] == ["f1"]
    assert factors(observed, predicted, reached, used) == ()
    turned = recorded("imposed motion", -4.0)
    assert factors(turned, predicted, turned.values, used)[0].factor < 0.0


@pytest.mark.parametrize("factor", [17.8, 20.0])
def test_a_factor_of_no_unit_is_that_of_every_test(factor: float) -> None:
    """Friction that a model lacks is many times its force in a slow test and few times in a fast one."""
    slow, fast = recorded("imposed motion", factor), healthy("imposed motion")
    assert looked(joined([slow, slow])) == {"f1": pytest.approx(factor, rel=0.1)}
    assert looked(joined([slow, fast])) == {}
    assert looked(joined([recorded("imposed motion", 1000.0), fast])) == {"f1": pytest.approx(1000.0, rel=0.1)}


def test_all_channels_over_the_voltage_are_a_matter_of_the_drive() -> None:
    """Half of the drive or a fifth is an amplifier or a source, which effects explain."""
    observed = healthy("random responses")
    smaller = observed.values - math.log(5.0) * (observed.rows.part == Part.LOG_MAGNITUDE)
    assert looked(replace(observed, values=smaller)) == {}


def test_damping_at_phase_resonance_is_no_unit() -> None:
    observed = healthy("locked windows")
    smaller = (observed.rows.part == Part.LOG_MAGNITUDE) & (observed.rows.channel == 1)
    assert looked(replace(observed, values=observed.values - math.log(4.0) * smaller)) == {}


def noisy(observed: Observations, sigmas: float) -> Observations:
    noise = np.random.default_rng(5).standard_normal(len(observed.values))
    return replace(observed, values=observed.values + sigmas * observed.std * noise)


def share(sigmas: float) -> float:
    """Share of its signal that a channel leaves whose recording has more noise than it shows of itself."""
    observed = noisy(healthy("driven record"), sigmas)
    predicted = Forward(observed.tests, observed.rows).predict(rig_of_kinds()).values
    return share_left(observed, predicted, np.isfinite(predicted))[0]


def decides(name: str) -> object:
    """What the plain look comes to where a threshold decides."""
    if name == "factor_ratio":
        return looked(recorded("driven record", 3.0)), looked(recorded("driven record", 2.0))
    if name == "factor_spread":
        observed = recorded("random responses", 20.0)
        rows = observed.rows
        tilt = 0.35 * np.cos(np.arange(len(rows))) * (rows.part == Part.LOG_MAGNITUDE)
        return [looked(replace(observed, values=observed.values + k * tilt)) != {} for k in (0.5, 2.0)]
    if name == "factor_correlation":
        observed = recorded("driven record", 20.0)
        return [looked(noisy(observed, sigmas)) != {} for sigmas in (30.0, 90.0)]
    if name == "factor_fewest_rows":
        observed = recorded("free decay", 20.0)
        return [looked(observed.take(observed.rows.level < few)) != {} for few in (2, 3, 5)]
    if name == "unexplained_noises":
        return [share(sigmas) > 0.0 for sigmas in (3.0, 8.0)]
    return diagnosed(noisy(healthy("driven record"), 80.0)).verdict, share(30.0) < 0.5


@pytest.mark.parametrize(
    "name",
    [
        "factor_ratio",
        "factor_spread",
        "factor_correlation",
        "factor_fewest_rows",
        "unexplained_share",
        "unexplained_noises",
    ],
)
def test_a_threshold_of_the_plain_look_decides(name: str) -> None:
    usual = {"factor_ratio": 2.5, "factor_spread": 0.2, "factor_correlation": 0.9, "factor_fewest_rows": 3}
    value = {**usual, "unexplained_share": 0.5, "unexplained_noises": 5.0}[name]
    more, less = (5, 1) if isinstance(value, int) else (2.0 * value, 0.5 * value)
    before = decides(name)
    with moved_threshold(f"verdict.{name}", value):
        assert decides(name) == before  # the values of this test are those of the program
    moved = []
    for other in (more, less):
        with moved_threshold(f"verdict.{name}", other):
            moved.append(decides(name))
    assert before not in moved or moved[0] != moved[1]


def test_a_channel_that_is_turned_in_several_tests_is_one_finding() -> None:
    found = [Factor(f"run {k}", "a2", -1.0 - 0.01 * k) for k in range(3)] + [Factor("run 0", "f1", 1000.0, True)]
    turned, force = by_channel(found)
    assert turned.sentence == "run 0 and 2 more: a2 has the other sign than the model predicts; turn it, or its sensor."
    assert (force.test, force.channel) == ("run 0", "f1")
    assert force.factor == pytest.approx(1000.0)
