"""Decays that are over after a few half swings, about any rest, with few samples a period."""

from __future__ import annotations

import math

import numpy as np
import pytest

from nmt_core.errors import BenchError
from nmt_core.vocabulary import Quantity
from nmt_extract.decays.free_decay import FreeDecay, channel_decay
from nmt_signals.decays.decay_signal import Ridge, slow_amplitude
from nmt_signals.decays.half_cycles import half_cycle_nodes, strongest_frequency, undriven_from

HZ = 0.7


def exponential(periods: float, per_period: float, ratio: float, rest: float = 0.0) -> np.ndarray:
    time = np.arange(int(periods * per_period)) / (per_period * HZ)
    omega = 2.0 * math.pi * HZ
    return rest + np.exp(omega * (-ratio * time)) * np.cos(omega * time + 0.4)


def coulomb(swings: int, per_period: float, drop: float) -> np.ndarray:
    """Each half swing about a rest displaced by half of ``drop``, until it stops: the closed form of dry friction."""
    half = 0.5 * per_period
    n = np.arange(int(swings * half))
    k = np.floor(n / half)
    sign = np.where(k % 2 == 0, 1.0, -1.0)
    return sign * (0.5 * drop) + (1.0 - 0.5 * drop - k * drop) * np.cos(math.pi * n / half)


def read(values: np.ndarray, per_period: float) -> FreeDecay:
    decay = channel_decay(values, per_period * HZ, Quantity.DISPLACEMENT, (1, "x1", "m"), 0.0)
    assert decay.reason == ""
    return decay


@pytest.mark.parametrize("rest", [0.0, 3.0, -0.4])
@pytest.mark.parametrize("periods", [2.8, 3.2, 6.0])
def test_a_few_swings_have_their_frequency_and_damping(periods: float, rest: float) -> None:
    rng = np.random.default_rng(2)
    values = exponential(periods, 400.0, 0.02, rest)
    decay = read(values + 1e-3 * rng.standard_normal(values.size), 400.0)
    np.testing.assert_allclose(decay.frequency_hz, HZ, rtol=4e-3)
    np.testing.assert_allclose(decay.damping_ratio, 0.02, rtol=0.1)
    assert np.all(np.abs(decay.damping_ratio - 0.02) < 4.0 * decay.damping_ratio_std)


@pytest.mark.parametrize("per_period", [10.3, 14.7, 21.0])
def test_ten_samples_a_period_are_enough(per_period: float) -> None:
    decay = read(exponential(7.0, per_period, 0.02, 0.3), per_period)
    np.testing.assert_allclose(decay.frequency_hz, HZ, rtol=2.5e-3)
    np.testing.assert_allclose(decay.damping_ratio, 0.02, rtol=0.025)


def test_a_straight_envelope_is_told_from_an_exponential_one() -> None:
    """Dry friction takes the same from each swing: the decay rate goes with one over the amplitude."""
    straight = half_cycle_nodes(coulomb(9, 200.0, 0.1), 200.0 * HZ, HZ)
    rates = np.array([node.rate for node in straight])
    amplitudes = np.array([node.amplitude for node in straight])
    np.testing.assert_allclose(rates * amplitudes, 2.0 * HZ * 0.1, rtol=0.03)
    bent = half_cycle_nodes(exponential(4.6, 200.0, 0.03), 200.0 * HZ, HZ)
    np.testing.assert_allclose([node.rate for node in bent], 0.03 * 2.0 * math.pi * HZ, rtol=0.03)


def test_a_decay_shorter_than_a_window_is_refused_by_its_sentence() -> None:
    """Fourteen periods carry one and two boxcars of the window, but not four of four periods."""
    values = exponential(14.0, 20.0, 0.003)
    ridge = Ridge(np.array([0.0, 20.0]), np.array([HZ, HZ]), np.ones(2), np.ones(2, dtype=bool))
    with pytest.raises(BenchError, match="too few for a window of 16"):
        slow_amplitude(values, 20.0 * HZ, ridge, 4)
    np.testing.assert_allclose(read(values, 20.0).frequency_hz, HZ, rtol=2e-3)


def test_the_strongest_line_is_found_about_any_rest() -> None:
    for periods in (2.2, 3.7, 9.0):
        found = strongest_frequency(exponential(periods, 30.0, 0.02, 50.0), 30.0 * HZ)
        assert found == pytest.approx(HZ, rel=0.12)


def test_a_decay_begins_where_its_drive_has_come_to_rest() -> None:
    """A bench ends a drive by a ramp; a voltage of noise, and one that drives on, end nothing."""
    ramp = np.r_[np.ones(30), np.linspace(1.0, 0.0, 11), np.zeros(159)]
    noise = 1e-4 * np.random.default_rng(1).standard_normal(200)
    assert undriven_from([]) == 0
    assert undriven_from([np.zeros(200)]) == 0
    assert undriven_from([noise]) == 0
    assert undriven_from([np.ones(200)]) == 0
    assert undriven_from([ramp, 0.5 * ramp + noise]) == 40
