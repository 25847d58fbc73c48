"""Secondary resonances of the shipped rig under their loop, against an independent harmonic balance."""

from __future__ import annotations

import math

import numpy as np
import pytest
from pll.secondary_rig import FORCE, LENGTH, SecondaryRig, at_force
from tiers import with_quick

from nmt_core.errors import BenchError
from nmt_core.messages.secondary_resonance import resonance_named, resonance_of
from nmt_core.vocabulary import LoopState
from nmt_pll.thresholds import SECONDARY

NOISE = [
    "sensors.0.noise_psd=2e-9",
    "sensors.1.noise_psd=4.5e-16",
    *(f"sensors.{row}.noise_correlation_time_s=1e-5" for row in range(2)),
]
TIP = {0.6: 1.5026, 1.0: 2.3298}
"""Amplitudes of the tip of the isola, of the harmonic balance."""


@pytest.mark.parametrize(
    ("start", "latency", "overrides"),
    with_quick([(0.30, 0, []), (0.33, 0, []), (0.36, 1, NOISE), (0.40, 3, NOISE)], (0.30, 0, [])),
)
def test_the_superharmonic_resonance_is_tracked_from_each_start(start, latency, overrides):
    rig = SecondaryRig("3:1", overrides, latency)
    for place, force in enumerate((0.3, 0.5, 0.7, 1.0)):
        outcome = rig.run_level(force, start=0.0 if place else start)
        (balance,) = at_force("3:1", force)
        assert rig.base_frequency(outcome) == pytest.approx(balance.omega_b, rel=1e-4)
        newest = outcome.outputs[-1]
        assert newest.response_amplitude / LENGTH == pytest.approx(abs(balance.series[1, 0]), rel=5e-3)
        assert newest.force_amplitude == pytest.approx(force * FORCE, rel=5e-3)
        assert abs(math.degrees(newest.phase_error)) < 1.0


@pytest.mark.parametrize(
    ("force", "release", "latency", "overrides"),
    with_quick(
        [(0.6, 0.5, 0, []), (1.0, 0.4, 0, []), (1.0, 0.6, 0, NOISE), (1.0, 0.5, 1, []), (0.6, 0.5, 3, NOISE)],
        (0.6, 0.5, 0, []),
    ),
)
def test_a_release_reaches_the_tip_of_the_isola(force, release, latency, overrides):
    rig = SecondaryRig("1:3", overrides, latency)
    outcome = rig.run_level(force, seconds=150.0, release=release * TIP[force])
    tip = at_force("1:3", force)[0]
    assert abs(tip.series[0, 0]) == pytest.approx(TIP[force], rel=1e-3)
    assert rig.base_frequency(outcome) == pytest.approx(tip.omega_b, rel=1e-3)
    assert outcome.outputs[-1].response_amplitude / LENGTH == pytest.approx(TIP[force], rel=5e-3)
    assert outcome.lock is not None
    assert outcome.lock.periods % 3 == 0
    assert "release" in outcome.reasons[-1]


@pytest.mark.campaign
def test_nine_of_twelve_starts_reach_the_isola():
    reached = 0
    for start in range(12):
        changes = [*NOISE, f"seed={start + 1}"]
        rig = SecondaryRig("1:3", changes, block_samples=180 + 7 * start)
        outcome = rig.run_level(1.0, seconds=100.0, release=(0.4, 0.5, 0.6)[start % 3] * TIP[1.0])
        reached += outcome.lock is not None and outcome.outputs[-1].response_amplitude > 0.99 * TIP[1.0] * LENGTH
    assert reached >= 9


def test_on_the_isola_the_force_can_be_stepped_on():
    rig = SecondaryRig("1:3")
    rig.run_level(0.6, release=0.5 * TIP[0.6])
    outcome = rig.run_level(0.65, release=0.5 * TIP[0.6])
    assert rig.base_frequency(outcome) == pytest.approx(at_force("1:3", 0.65)[0].omega_b, rel=1e-3)
    assert all(item.frequency_hz > 60.0 for item in outcome.outputs)  # no second release


@pytest.fixture
def two_releases():
    usual = SECONDARY.release_ratios
    object.__setattr__(SECONDARY, "release_ratios", (1.0, 0.7))
    yield
    object.__setattr__(SECONDARY, "release_ratios", usual)


@pytest.mark.usefixtures("two_releases")
def test_below_the_isola_every_release_is_tried_and_the_drive_goes_to_zero():
    """Below F = 0.47 there is no isola: the response leaves after each release."""
    rig = SecondaryRig("1:3")
    outcome = rig.run_level(0.3, seconds=400.0, release=0.5)
    assert outcome.lock is None
    assert outcome.reasons[-1] == "the response has left the isola after 2 releases"
    assert outcome.outputs[-1].state is LoopState.LOCK_LOST
    assert outcome.outputs[-1].amplitude == 0.0


def test_without_a_release_rest_is_left_for_no_isola():
    rig = SecondaryRig("1:3")
    outcome = rig.run_level(0.6, seconds=10.0)
    assert outcome.lock is None
    assert outcome.outputs[-1].response_amplitude < 0.02 * LENGTH


def test_a_softening_spring_has_the_opposite_lag():
    offset = {"phase_offset_rad": math.pi}
    rig = SecondaryRig("3:1", ["local_elements.0.stiffness_n_m3=-1.6e9"], **offset)
    outcome = rig.run_level(0.2, start=0.33)
    assert outcome.lock is not None, outcome.reasons
    frequency = rig.base_frequency(outcome)
    assert frequency < 1.0 / 3.0
    response = outcome.outputs[-1].response_amplitude
    again = SecondaryRig("3:1", ["local_elements.0.stiffness_n_m3=-1.6e9"]).run_level(0.2, start=0.33, seconds=30.0)
    assert again.lock is None or again.outputs[-1].response_amplitude < 0.5 * response


def test_what_cannot_be_held_is_refused():
    with pytest.raises(BenchError, match="5:1 cannot be held; use 3:1 or 1:3"):
        resonance_of(5, 1)
    with pytest.raises(BenchError, match="'2:1' is not known; use 3:1 or 1:3"):
        resonance_named("2:1")
    rig = SecondaryRig("3:1")
    with pytest.raises(BenchError, match="needs no release"):
        rig.run_level(0.3, release=0.5)


def test_the_lag_is_counted_from_any_phase():
    """k arg F_ν − ν arg x_k does not change with the base phase."""
    rng = np.random.default_rng(1)
    for k, nu in ((3, 1), (1, 3)):
        force, response, shift = np.exp(2j * np.pi * rng.random(3))
        lag = force**k * np.conj(response) ** nu
        moved = (force * shift**nu) ** k * np.conj(response * shift**k) ** nu
        assert moved == pytest.approx(lag)
