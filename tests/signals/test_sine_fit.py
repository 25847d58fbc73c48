from __future__ import annotations

import numpy as np
import pytest
from extract.synthetic import signal
from hypothesis import given, settings
from hypothesis import strategies as st

from nmt_core.errors import BenchError
from nmt_signals.sine_fit import fit_frequency

RATE = 10_000.0


@given(
    frequency=st.floats(15.0, 400.0),
    offset=st.floats(0.97, 1.03),
    phase=st.floats(-3.0, 3.0),
    third=st.floats(0.0, 0.4),
)
@settings(max_examples=40, deadline=None)
def test_finds_the_frequency_to_rounding(frequency, offset, phase, third):
    cycles = frequency * np.arange(20_000) / RATE
    data = signal(cycles, np.array([0.7, np.exp(1j * phase), 0.0, third * 1j]))
    assert fit_frequency(data, RATE, frequency * offset) == pytest.approx(frequency, rel=1e-11)


@pytest.mark.parametrize("guess", [0.0, float("nan")])
def test_without_a_guess_takes_the_strongest_line(guess):
    data = signal(37.123 * np.arange(8000) / RATE, np.array([0.2, 1.0, 0.1, 0.3j]))
    assert fit_frequency(data, RATE, guess) == pytest.approx(37.123, rel=1e-10)


def test_noise_scatter_is_near_the_cramer_rao_bound():
    samples, sigma = 4000, 0.1
    random = np.random.default_rng(0)
    clean = signal(50.3 * np.arange(samples) / RATE, np.array([0.0, 1.0]))
    fits = [fit_frequency(clean + sigma * random.normal(size=samples), RATE, 50.0) for _ in range(150)]
    bound = np.sqrt(24.0 * sigma**2 / samples**3) * RATE / (2.0 * np.pi)
    assert np.std(fits) == pytest.approx(bound, rel=0.2)
    assert np.mean(fits) == pytest.approx(50.3, abs=4 * bound / np.sqrt(150))


def test_constant_and_noise_are_refused():
    with pytest.raises(BenchError, match="constant"):
        fit_frequency(np.ones(1000), RATE, 20.0)
    with pytest.raises(BenchError, match="No steady sine"):
        fit_frequency(np.cumsum(np.random.default_rng(1).normal(size=20_000)), RATE, 300.0)
