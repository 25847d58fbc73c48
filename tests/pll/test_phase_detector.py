"""Adaptive Fourier filter and phase error."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nmt_core.errors import BenchError
from nmt_pll.detection.phase_detector import AdaptiveFourierFilter, phase_error

RATE = 1e4
FREQUENCY = 22.0
CUTOFF = 20.0
BLOCK = 200


def signal(coefficients, cycles):
    """Re Σ c_n exp(2πi n cycles), n from 0."""
    order = np.arange(len(coefficients))[:, None]
    return (np.asarray(coefficients)[:, None] * np.exp(2j * np.pi * order * cycles)).real.sum(axis=0)


def run(tracker, channels, blocks, start=0.0, frequency=FREQUENCY):
    """Feed channels of constant coefficients; the coefficients after each block and the final phase."""
    history = []
    cycles = start
    for _ in range(blocks):
        phase = cycles + np.arange(BLOCK) * frequency / RATE
        data = np.stack([signal(coefficients, phase) for coefficients in channels])
        history.append(tracker.process(data, cycles, frequency).copy())
        cycles = math.fmod(cycles + BLOCK * frequency / RATE, 1.0)
    return np.array(history), cycles


def test_coefficients_are_those_of_a_least_squares_fit():
    rng = np.random.default_rng(1)
    channels = rng.standard_normal((3, 8)) + 1j * rng.standard_normal((3, 8))
    channels[:, 0] = channels[:, 0].real
    tracker = AdaptiveFourierFilter(3, 7, CUTOFF, RATE)
    history, end = run(tracker, channels, 60)

    phase = end - np.arange(BLOCK * 10, 0, -1) * FREQUENCY / RATE
    angle = 2 * np.pi * phase[:, None] * np.arange(1, 8)
    design = np.hstack([np.ones((len(phase), 1)), np.cos(angle), -np.sin(angle)])
    for channel, tracked in zip(channels, history[-1], strict=True):
        fit = np.linalg.lstsq(design, signal(channel, phase), rcond=None)[0]
        expected = np.concatenate([fit[:1], fit[1:8] + 1j * fit[8:]])
        np.testing.assert_allclose(tracked, expected, atol=1e-8)


@pytest.mark.parametrize("cutoff", [20.0, 5.0, 1.0])
def test_a_step_decays_with_the_cutoff(cutoff):
    tracker = AdaptiveFourierFilter(1, 3, cutoff, RATE)
    blocks = round(4.0 / cutoff * RATE / BLOCK)
    history, _ = run(tracker, [[0.0, 1.0 - 2.0j]], blocks)
    time = (np.arange(blocks) + 1) * BLOCK / RATE
    lag = np.abs(history[:, 0, 1] - (1.0 - 2.0j)) / abs(1.0 - 2.0j)
    # A low-pass to first order in ω_LP/ω, because the other harmonics take their share of the step.
    order = cutoff / (2 * np.pi * FREQUENCY)
    np.testing.assert_allclose(lag, np.exp(-cutoff * time), atol=order)
    decay = np.polyfit(time, np.log(lag), 1)[0]
    assert decay == pytest.approx(-cutoff, rel=0.6 * order)


def test_a_step_of_the_mean_decays_with_the_cutoff():
    cutoff = 2.0
    history, _ = run(AdaptiveFourierFilter(1, 3, cutoff, RATE), [[1.0]], 100)
    time = (np.arange(100) + 1) * BLOCK / RATE
    np.testing.assert_allclose(1.0 - history[:, 0, 0].real, np.exp(-cutoff * time), atol=0.02)


def test_harmonics_do_not_ripple_the_fundamental():
    channel = [[0.5, 1.0 + 0j, 0.4j, 0.3 + 0j, 0.0, -0.2j]]
    tracked, _ = run(AdaptiveFourierFilter(1, 5, CUTOFF, RATE), channel, 100)
    untracked, _ = run(AdaptiveFourierFilter(1, 1, CUTOFF, RATE), channel, 100)
    ripple = np.ptp(np.angle(tracked[-30:, 0, 1]))
    assert ripple < 1e-8
    assert np.ptp(np.angle(untracked[-30:, 0, 1])) > 1e4 * ripple  # a test that can fail


def test_a_change_of_frequency_with_known_phase_does_not_disturb():
    channels = [[0.1, 1.0 + 0.5j, 0.2j]]
    tracker = AdaptiveFourierFilter(1, 2, CUTOFF, RATE)
    before, cycles = run(tracker, channels, 60)
    after, _ = run(tracker, channels, 40, start=cycles, frequency=1.3 * FREQUENCY)
    np.testing.assert_allclose(after[:, 0], np.broadcast_to(before[-1, 0], after[:, 0].shape), atol=1e-7)


def test_a_sweep_is_followed():
    tracker = AdaptiveFourierFilter(1, 1, CUTOFF, RATE)
    time = np.arange(20_000) / RATE
    rate_hz_s = 3.0
    phase = FREQUENCY * time + 0.5 * rate_hz_s * time**2
    data = np.cos(2 * np.pi * phase + 0.4)[None]
    for first in range(0, 20_000, BLOCK):
        frequency = FREQUENCY + rate_hz_s * time[first]
        result = tracker.process(data[:, first : first + BLOCK], phase[first], frequency, rate_hz_s)
    assert result[0, 1] == pytest.approx(np.exp(0.4j), abs=1e-6)


def test_channels_do_not_mix():
    alone, _ = run(AdaptiveFourierFilter(1, 2, CUTOFF, RATE), [[0.0, 1j, 0.3]], 10)
    together, _ = run(AdaptiveFourierFilter(2, 2, CUTOFF, RATE), [[5.0, 7.0, -2.0], [0.0, 1j, 0.3]], 10)
    np.testing.assert_array_equal(together[:, 1], alone[:, 0])


def test_blocks_of_any_length_give_the_same():
    rng = np.random.default_rng(2)
    data = rng.standard_normal((2, 1200))
    results = []
    for length in (1, 7, 200, 1200):
        tracker = AdaptiveFourierFilter(2, 3, CUTOFF, RATE)
        for first in range(0, 1200, length):
            part = data[:, first : first + length]
            coefficients = tracker.process(part, first * FREQUENCY / RATE, FREQUENCY)
        results.append(coefficients.copy())
    for other in results[1:]:
        np.testing.assert_allclose(other, results[0], atol=1e-11)


def test_reset_forgets():
    tracker = AdaptiveFourierFilter(1, 2, CUTOFF, RATE)
    run(tracker, [[1.0, 1.0, 1.0]], 5)
    tracker.reset()
    assert not tracker.coefficients.any()


@pytest.mark.parametrize(
    ("harmonics", "cutoff", "rate", "words"),
    [
        (0, 20.0, 1e4, "at least the first harmonic"),
        (7, 700.0, 1e4, "not stable"),
        (7, 0.0, 1e4, "not stable"),
        (7, -1.0, 1e4, "not stable"),
        (7, math.nan, 1e4, "not stable"),
    ],
)
def test_filters_that_cannot_work_are_refused(harmonics, cutoff, rate, words):
    with pytest.raises(BenchError, match=words):
        AdaptiveFourierFilter(1, harmonics, cutoff, rate)


def test_a_filter_just_within_the_bound_stays_bounded():
    tracker = AdaptiveFourierFilter(1, 7, 0.99 * RATE / 2 / 7.5, RATE)
    noise = np.random.default_rng(3).standard_normal((1, 50_000))
    for first in range(0, 50_000, BLOCK):
        tracker.process(noise[:, first : first + BLOCK], first * FREQUENCY / RATE, FREQUENCY)
        assert np.abs(tracker.coefficients).max() < 10.0


def test_a_wrong_number_of_channels_is_refused():
    with pytest.raises(ValueError, match="expected 2 channels, got 1"):
        AdaptiveFourierFilter(2, 1, CUTOFF, RATE).process(np.zeros((1, 5)), 0.0, FREQUENCY)


LEADS = {"displacement": math.pi / 2, "velocity": 0.0, "acceleration": -math.pi / 2}


def oscillator(omega, quantity, resonance=100.0, damping=0.02):
    """Response of a linear oscillator of unit mass to a unit force."""
    displacement = 1.0 / (resonance**2 - omega**2 + 2j * damping * resonance * omega)
    return {"displacement": 1, "velocity": 1j * omega, "acceleration": -(omega**2)}[quantity] * displacement


@pytest.mark.parametrize("quantity", LEADS)
def test_zero_at_phase_resonance_positive_below_negative_above(quantity):
    lead = LEADS[quantity]
    turn = np.exp(0.7j)  # the phase of the drive does not matter
    assert phase_error(3.0 * turn, oscillator(100.0, quantity) * turn, lead) == pytest.approx(0.0, abs=1e-12)
    for omega, side in ((99.0, 1), (60.0, 1), (101.0, -1), (200.0, -1)):
        expected = np.angle(oscillator(omega, "velocity"))
        error = phase_error(3.0 * turn, oscillator(omega, quantity) * turn, lead)
        assert error == pytest.approx(expected, abs=1e-12)
        assert np.sign(error) == side


@given(
    st.floats(-math.pi, math.pi), st.floats(-math.pi, math.pi), st.floats(1e-6, 1e3), st.floats(1e-9, 1e3),
    st.sampled_from(list(LEADS.values())),
)  # fmt: skip
def test_is_the_phase_between_velocity_and_force(force, response, force_size, response_size, lead):
    error = phase_error(force_size * np.exp(1j * force), response_size * np.exp(1j * response), lead)
    assert -math.pi <= error <= math.pi
    turns = (error - (response + lead - force)) / (2 * math.pi)
    assert turns == pytest.approx(round(turns), abs=1e-9)
