"""What the page makes of samples, against closed forms, brute force and other methods."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal

from nmt_bench.page.channels import TopicSignals, channel_levels
from nmt_bench.page.decimation import Recent, Strip, min_max
from nmt_bench.page.signal_views import (
    amplitude_spectrum,
    harmonic_amplitudes,
    paired_periods,
    velocity_of,
    whole_periods,
)
from nmt_core.messages.blocks import OscillatorPhase, SampleBlock
from nmt_core.vocabulary import Quantity
from nmt_signals.frequency_responses import RunningFrf

RATE = 1000.0


def block(first: int, data: np.ndarray, quantity: Quantity = Quantity.FORCE, frequency: float = 0.0) -> SampleBlock:
    cycles = (first * frequency / RATE) % 1.0
    names = tuple(f"c{n}" for n in range(len(data)))
    return SampleBlock(
        first, RATE, quantity, quantity.unit, names, tuple(range(1, len(data) + 1)), data,
        OscillatorPhase(cycles, frequency),
    )  # fmt: skip


# -- thinning --------------------------------------------------------------------------------------------------------


@given(st.integers(0, 500), st.integers(1, 60), st.integers(0, 2**32 - 1))
@settings(max_examples=80, deadline=None)
def test_thinned_signals_keep_every_peak(samples: int, buckets: int, seed: int) -> None:
    data = np.random.default_rng(seed).standard_normal(samples)
    thin = min_max(data, buckets)
    assert thin.size <= max(2 * buckets, 0) or thin.size == samples <= 2 * buckets
    if samples <= 2 * buckets:
        assert np.array_equal(thin, data)
        return
    assert (thin.max(), thin.min()) == (data.max(), data.min())
    length = -(-samples // buckets)
    for n, (a, b) in enumerate(itertools.pairwise([*range(0, samples, length), samples])):
        pair = thin[2 * n : 2 * n + 2]
        assert sorted(pair) == [data[a:b].min(), data[a:b].max()]
        assert (pair[0] <= pair[1]) == (data[a:b].argmin() <= data[a:b].argmax())


@given(st.lists(st.tuples(st.integers(1, 40), st.integers(0, 30)), max_size=20), st.integers(1, 13), st.integers(2, 9))
@settings(max_examples=80, deadline=None)
def test_strips_hold_the_extremes_of_every_stretch(parts: list[tuple[int, int]], length: int, stretches: int) -> None:
    strip = Strip(2, length, stretches)
    known = np.full((2, 3000), np.nan)
    generator = np.random.default_rng(length)
    position = 0
    for samples, gap in parts:
        data = generator.standard_normal((2, samples))
        strip.add(position, data)
        known[:, position : position + samples] = data
        position += samples + gap
    first, low, high = strip.since(0)
    assert low.shape == high.shape == (2, max(0, strip.newest - first))
    assert low.shape[1] < stretches
    for n in range(low.shape[1]):
        stretch = known[:, (first + n) * length : (first + n + 1) * length]
        for row in range(2):
            seen = stretch[row][np.isfinite(stretch[row])]
            expected = (seen.min(), seen.max()) if seen.size else (math.nan, math.nan)
            assert (low[row, n], high[row, n]) == pytest.approx(expected, nan_ok=True)


@given(st.lists(st.tuples(st.integers(1, 50), st.booleans()), min_size=1, max_size=30), st.integers(1, 40))
@settings(max_examples=80, deadline=None)
def test_the_newest_samples_are_without_a_gap(parts: list[tuple[int, bool]], kept: int) -> None:
    recent = Recent(1, kept)
    position, whole = 0, np.zeros((1, 0))
    for samples, gap in parts:
        if gap:
            position += 7
            whole = np.zeros((1, 0))
        data = np.arange(position, position + samples, dtype=float)[np.newaxis]
        recent.add(position, data)
        whole = np.append(whole, data, axis=1)
        position += samples
        assert recent.end_sample == position
        assert np.array_equal(recent.last(kept), whole[:, -kept:])
        assert np.array_equal(recent.last(3), whole[:, -min(3, kept, whole.shape[1]) :])


# -- peaks, rms, levels ----------------------------------------------------------------------------------------------


def test_peak_and_rms_of_a_sine() -> None:
    time = np.arange(3000) / RATE
    data = np.vstack([2.0 * np.sin(2 * np.pi * 20.0 * time), np.full(3000, -3.0)])
    signals = TopicSignals(block(0, data[:, :20]))
    for first in range(0, 3000, 20):
        signals.add(block(first, data[:, first : first + 20]))
    assert signals.peak == pytest.approx([2.0, 3.0], rel=3e-3)  # no sample lies at the very crest
    assert signals.rms == pytest.approx([2.0 / math.sqrt(2.0), 3.0], rel=0.02)


def test_levels_of_a_channel_come_from_the_rig_file() -> None:
    limits = {
        "force_n": 10.0,
        "warning_share": 0.5,
        "channels": [{"channel": "f2", "abort_peak": 8.0, "abort_rms": 4.0, "warning_rms": 1.0}],
    }
    own = channel_levels(limits, Quantity.FORCE, "f2")
    assert (own.warning_peak, own.abort_peak, own.warning_rms, own.abort_rms) == (4.0, 8.0, 1.0, 4.0)
    other = channel_levels(limits, Quantity.FORCE, "f3")
    assert (other.warning_peak, other.abort_peak) == (5.0, 10.0)
    assert math.isnan(other.abort_rms)
    assert math.isnan(channel_levels(limits, Quantity.VOLTAGE, "u").abort_peak)


@pytest.mark.parametrize(
    "limits", [{}, {"force_n": "much"}, {"force_n": -1}, {"channels": 3}, {"channels": [None, {}]}]
)
def test_limits_that_make_no_sense_count_as_none(limits: dict[str, object]) -> None:
    assert math.isnan(channel_levels(limits, Quantity.FORCE, "f").abort_peak)


# -- periods, orbits, spectra ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("frequency", [20.0, 33.7, 61.3])
def test_whole_periods_begin_at_phase_zero_wherever_the_block_ends(frequency: float) -> None:
    signals = TopicSignals(block(0, np.zeros((1, 20)), frequency=frequency))
    for first in range(0, 1500, 20):
        time = (first + np.arange(20)) / RATE
        signals.add(block(first, np.cos(2 * np.pi * frequency * time)[np.newaxis], frequency=frequency))
        if first > 500:
            data, found = whole_periods(signals)
            assert found == frequency
            assert data.shape[1] == round(3 * RATE / frequency)
            expected = np.cos(2 * np.pi * frequency * np.arange(data.shape[1]) / RATE)
            assert np.abs(data[0] - expected).max() < 1.1 * np.pi * frequency / RATE  # half a sample


def test_an_orbit_takes_the_same_samples_of_both_topics() -> None:
    """The response lags by a quarter period, is newer, and its oscillator is told with another rounding."""
    force, response = (TopicSignals(block(0, np.zeros((1, 20)), frequency=f)) for f in (33.7, 33.700001))
    for first in range(0, 1500, 20):
        time = (first + np.arange(20)) / RATE
        if first < 1440:
            force.add(block(first, np.cos(2 * np.pi * 33.7 * time)[np.newaxis], frequency=33.7))
        response.add(block(first, np.sin(2 * np.pi * 33.7 * time)[np.newaxis], frequency=33.700001))
    forces, responses, frequency = paired_periods(force, response)
    assert frequency == 33.7
    assert forces.shape == responses.shape == (1, round(3 * RATE / 33.7))
    np.testing.assert_allclose(np.hypot(forces, responses), 1.0, atol=1e-9)
    still = TopicSignals(block(0, np.zeros((1, 20)), frequency=0.0))
    assert math.isnan(paired_periods(still, response)[2])


@pytest.mark.parametrize(
    ("quantity", "factor"),
    [
        (Quantity.DISPLACEMENT, 2j * np.pi * 20.0),
        (Quantity.VELOCITY, 1.0),
        (Quantity.ACCELERATION, 1 / (2j * np.pi * 20.0)),
    ],
)
def test_velocity_by_harmonics(quantity: Quantity, factor: complex) -> None:
    time = np.arange(150) / RATE
    given_ = np.real(np.exp(2j * np.pi * 20.0 * time)) + 5.0
    expected = np.real(factor * np.exp(2j * np.pi * 20.0 * time))
    assert velocity_of(given_, quantity, 3, 20.0) == pytest.approx(expected, abs=1e-9 * abs(factor) + 1e-12)


def test_amplitudes_of_lines() -> None:
    time = np.arange(4000) / RATE
    data = 3.0 * np.cos(2 * np.pi * 50.0 * time) + 0.2 * np.cos(2 * np.pi * 150.0 * time) + 9.0
    frequency, amplitude = amplitude_spectrum(data, RATE, 500.0)
    assert frequency.size <= 500
    found = harmonic_amplitudes(frequency, amplitude, 50.0)
    assert found[[0, 2]] == pytest.approx([3.0, 0.2], rel=1e-3)
    assert found[1] < 1e-3
    assert np.isnan(harmonic_amplitudes(frequency, amplitude, 100.0)[5:]).all()


def test_averaged_response_is_that_of_welch() -> None:
    generator = np.random.default_rng(1)
    force = generator.standard_normal(20_000)
    response = signal.lfilter([0.1], [1.0, -1.6, 0.9], force) + 0.1 * generator.standard_normal(20_000)
    running = RunningFrf(500, RATE)
    position = 0
    for size in generator.integers(1, 400, 200):
        part = slice(position, position + int(size))
        running.add(position, force[part], response[part])
        position = part.stop
    options = {"fs": RATE, "window": "hann", "nperseg": 500, "noverlap": 250, "detrend": "constant"}
    used = slice(0, 250 * (running.averages + 1))
    _, cross = signal.csd(force[used], response[used], **options)
    lines, auto = signal.welch(force[used], **options)
    _, coherence = signal.coherence(force[used], response[used], **options)
    frequency, magnitude, found = running.estimate(10.0, 400.0)
    band = (lines >= 10.0) & (lines <= 400.0)
    assert frequency == pytest.approx(lines[band])
    assert magnitude == pytest.approx(np.abs(cross / auto)[band], rel=1e-9)
    assert found == pytest.approx(coherence[band], rel=1e-9)


def test_a_gap_leaves_no_trace_in_the_averages() -> None:
    running = RunningFrf(100, RATE)
    data = np.random.default_rng(2).standard_normal(1000)
    running.add(0, data[:90], 2.0 * data[:90])
    running.add(500, data[:250], 2.0 * data[:250])
    assert running.averages == 4
    _, magnitude, coherence = running.estimate(0.0, 500.0)
    assert magnitude[1:] == pytest.approx(2.0)
    assert coherence[1:] == pytest.approx(1.0)
