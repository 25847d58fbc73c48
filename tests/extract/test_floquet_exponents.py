"""Floquet exponents from a perturbed window, against the poles of a linear system and a discrete one."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

from nmt_core.errors import BenchError
from nmt_extract.modal.floquet_exponents import floquet_exponents

RATE, OMEGA, DECAY, PERIODS = 5000.0, 126.0, 1.3, 30


def window(drive: float, share: float = 0.01, noise: float = 0.0, decay: float = DECAY):
    """Force, response, cycles, advance and duration of a mass of 1 kg driven at ``drive`` rad/s."""
    samples = round(PERIODS * 2.0 * math.pi / drive * RATE)
    before = 4 * samples
    t = np.arange(-before, samples) / RATE
    nu = 2.0 * math.pi * RATE / samples
    rng = np.random.default_rng(5)
    size = 1.0 + share * sum(
        math.sqrt(0.25) * np.cos(k * nu * t + p) for k, p in zip(range(1, 9), rng.random(8) * 6, strict=True)
    )
    phase = drive * t + share * np.sin(2.5 * nu * t)
    force = size * np.cos(phase)
    b, a, _ = cont2discrete(([1.0], [1.0, 2.0 * decay, OMEGA**2]), 1.0 / RATE, "foh")
    response = lfilter(b.ravel(), a, force)
    response = response + noise * np.abs(response).max() * rng.standard_normal(response.size)
    cycles = phase / (2.0 * math.pi)
    advance = cycles[-1] + drive / RATE / 2.0 / math.pi - cycles[before]
    return force[before:], response[before:], cycles[before:], advance, samples / RATE


@pytest.mark.parametrize("drive", [120.0, 125.0, 131.0])
def test_of_a_linear_system_they_are_its_poles_less_the_frequency(drive):
    found = floquet_exponents(*window(drive))
    assert found.growth == pytest.approx(-DECAY, abs=max(0.02 * DECAY, 2.0 * found.growth_std))
    assert found.second_growth == pytest.approx(-DECAY, abs=max(0.02 * DECAY, 2.0 * found.second_growth_std))
    expected = abs(math.sqrt(OMEGA**2 - DECAY**2) - drive)
    assert found.frequency == pytest.approx(expected, abs=max(0.02, 2.0 * found.frequency_std))


def test_noise_widens_the_uncertainty_and_stays_within_it():
    clean, noisy = (floquet_exponents(*window(124.0, noise=noise)) for noise in (0.0, 1e-3))
    assert noisy.growth_std > 3.0 * clean.growth_std
    assert abs(noisy.growth + DECAY) < 3.0 * noisy.growth_std
    assert noisy.growth_std < 0.3 * DECAY


def test_a_window_that_is_too_short_or_not_perturbed_tells_nothing():
    force, response, cycles, advance, duration = window(125.0)
    part = slice(0, force.size // 3)
    with pytest.raises(BenchError, match="need 20 periods in a window, this one has 10"):
        floquet_exponents(force[part], response[part], cycles[part], advance / 3.0, duration / 3.0)
    with pytest.raises(BenchError, match="samples in a period"):
        floquet_exponents(force[::30], response[::30], cycles[::30], advance, duration)
    with pytest.raises(BenchError, match="did not change"):
        floquet_exponents(0.0 * force, response, cycles, advance, duration)
