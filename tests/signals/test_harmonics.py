from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from extract.synthetic import signal
from hypothesis import given, settings
from hypothesis import strategies as st

from nmt_core.errors import BenchError
from nmt_signals.harmonics import (
    harmonic_amplitudes,
    resolvable_harmonics,
    segment_moments,
    solve_moments,
    synthesise,
    whole_period_bounds,
)


def random_amplitudes(seed: int, harmonics: int, channels: int = 3) -> np.ndarray:
    random = np.random.default_rng(seed)
    amplitudes = random.normal(size=(channels, harmonics + 1)) + 1j * random.normal(size=(channels, harmonics + 1))
    amplitudes[:, 0] = amplitudes[:, 0].real
    return amplitudes


@pytest.mark.parametrize(("periods", "length"), [(7, 40), (3, 27), (20, 13)])
def test_equals_fft_over_whole_periods_of_whole_samples(periods, length):
    data = np.random.default_rng(3).normal(size=(2, periods * length))
    cycles = np.arange(periods * length) / length
    spectrum = np.fft.rfft(data) / data.shape[1]
    expected = 2.0 * spectrum[:, : 6 * periods : periods]
    expected[:, 0] /= 2.0
    np.testing.assert_allclose(harmonic_amplitudes(cycles, data, 5), expected, atol=1e-14)


@given(
    seed=st.integers(0, 2**32 - 1),
    harmonics=st.integers(1, 12),
    samples_per_period=st.floats(30.0, 700.0),
    periods=st.floats(3.0, 9.0),
    start=st.floats(-5.0, 5.0),
)
@settings(max_examples=60, deadline=None)
def test_recovers_harmonics_without_whole_samples_or_periods(seed, harmonics, samples_per_period, periods, start):
    amplitudes = random_amplitudes(seed, harmonics)
    cycles = start + np.arange(int(periods * samples_per_period)) / samples_per_period
    data = np.array([signal(cycles, row) for row in amplitudes])
    np.testing.assert_allclose(harmonic_amplitudes(cycles, data, harmonics), amplitudes, atol=1e-11)


@given(seed=st.integers(0, 2**32 - 1), frequencies=st.lists(st.floats(15.0, 30.0), min_size=20, max_size=40))
@settings(max_examples=30, deadline=None)
def test_exact_when_the_frequency_jumps_between_blocks(seed, frequencies):
    steps = np.repeat(frequencies, 150) / 10_000.0
    cycles = np.concatenate(([0.0], np.cumsum(steps)[:-1]))
    amplitudes = random_amplitudes(seed, 6)
    data = np.array([signal(cycles, row) for row in amplitudes])
    np.testing.assert_allclose(harmonic_amplitudes(cycles, data, 6), amplitudes, atol=1e-10)


def test_white_noise_averages_as_theory_says():
    """Variance of Re ψ_n over N samples of white noise is 2 σ²/N."""
    random = np.random.default_rng(0)
    samples = 3000
    cycles = np.arange(samples) * 0.00731
    values = harmonic_amplitudes(cycles, random.normal(size=(400, samples)), 4)[:, 1:]
    variance = np.var(np.concatenate((values.real.ravel(), values.imag.ravel())))
    assert variance == pytest.approx(2.0 / samples, rel=0.1)


@given(st.integers(0, 2**32 - 1), st.lists(st.integers(1, 1999), min_size=1, max_size=6, unique=True))
@settings(max_examples=30, deadline=None)
def test_moments_add_up_over_any_cut(seed, cuts):
    data = np.random.default_rng(seed).normal(size=(2, 2000))
    cycles = np.arange(2000) * 0.0123
    bounds = np.array([0, *sorted(cuts), 2000])
    cut = solve_moments(segment_moments(cycles, data, 5, bounds).total())[0]
    np.testing.assert_allclose(cut, harmonic_amplitudes(cycles, data, 5), rtol=0, atol=1e-13)


def test_leave_one_out_equals_fit_without_the_segment():
    data = np.random.default_rng(5).normal(size=(2, 1200))
    cycles = np.arange(1200) * 0.0123
    bounds = np.array([0, 300, 700, 1200])
    rest = solve_moments(segment_moments(cycles, data, 3, bounds).leave_one_out())
    keep = np.r_[0:300, 700:1200]
    orders = np.outer(np.arange(1, 4), 2.0 * np.pi * cycles[keep])
    basis = np.vstack((np.ones(keep.size), np.cos(orders), np.sin(orders))).T
    witness = np.linalg.lstsq(basis, data[:, keep].T, rcond=None)[0]
    np.testing.assert_allclose(rest[1][:, 0].real, witness[0], atol=1e-12)
    np.testing.assert_allclose(rest[1][:, 1:], (witness[1:4] - 1j * witness[4:]).T, atol=1e-12)


def test_same_bits_on_every_call():
    data = np.random.default_rng(7).normal(size=(4, 5003))
    cycles = np.arange(5003) * 0.00221
    first = harmonic_amplitudes(cycles, data, 10)
    assert all(harmonic_amplitudes(cycles.copy(), data.copy(), 10).tobytes() == first.tobytes() for _ in range(3))


def test_whole_period_bounds_cut_at_whole_periods():
    cycles = 0.3 + np.arange(90131) * 0.002219
    bounds = whole_period_bounds(cycles, 200, 10)
    assert bounds[0] == 0
    assert bounds[-1] == 90131
    at_cuts = (cycles[bounds[1:-1]] - 0.3) / 20.0
    np.testing.assert_allclose(at_cuts, np.arange(1, 10), atol=0.002219 / 20.0)
    assert np.all(at_cuts >= np.arange(1, 10) - 1e-9)


def test_synthesise_is_the_inverse():
    cycles = np.arange(500) * 0.0231
    amplitudes = random_amplitudes(1, 5)[0]
    np.testing.assert_allclose(synthesise(cycles, amplitudes), signal(cycles, amplitudes), atol=1e-13)


def test_too_few_samples_are_refused_with_a_sentence():
    with pytest.raises(BenchError, match="do not determine 10 harmonics"):
        harmonic_amplitudes(np.arange(40) / 8.0, np.ones((1, 40)), 10)


def test_resolvable_harmonics():
    assert resolvable_harmonics(10, 450.0) == 10
    assert resolvable_harmonics(10, 10.0) == 4
    assert resolvable_harmonics(10, 2.0) == 0


@pytest.mark.parametrize("offset", range(1, 9))
def test_same_bits_wherever_the_data_lie_in_memory(offset):
    """Live and offline extraction must agree to the bit, whatever memory each was given."""
    random = np.random.default_rng(11)
    data, cycles = random.normal(size=(3, 9001)), np.arange(9001) * 0.00321
    moved = np.empty(data.size + offset)[offset:].reshape(data.shape)
    moved[:] = data
    shifted = np.empty(cycles.size + offset)[offset:]
    shifted[:] = cycles
    bounds = np.array([0, 1000, 4097, 9001])
    first, second = segment_moments(cycles, data, 7, bounds), segment_moments(shifted, moved, 7, bounds)
    assert first.basis.tobytes() == second.basis.tobytes()
    assert first.projections.tobytes() == second.projections.tobytes()
    assert solve_moments(first).tobytes() == solve_moments(second).tobytes()


def test_sums_equal_their_definition():
    random = np.random.default_rng(12)
    data, cycles = random.normal(size=(2, 9001)), 3.7 + np.arange(9001) * 0.00321
    bounds = np.array([5, 1000, 1000, 4097, 8999])
    found = segment_moments(cycles, data, 6, bounds)
    for segment, (start, stop) in enumerate(pairwise(bounds)):
        rotation = np.exp(2j * np.pi * np.outer(np.arange(13), cycles[start:stop]))
        np.testing.assert_allclose(found.basis[segment], rotation.sum(axis=1), atol=1e-9)
        np.testing.assert_allclose(found.projections[segment], data[:, start:stop] @ rotation[:7].T, atol=1e-9)
