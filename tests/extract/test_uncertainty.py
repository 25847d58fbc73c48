from __future__ import annotations

import math

import numpy as np
import pytest
from extract.synthetic import FREQUENCY, RATE, Stream, extract, in_phase_case, lock_event

from nmt_core.messages.modal_point import EVALUATED
from nmt_extract.judgement.uncertainty import jackknife, slope_uncertainty, sub_window_count


@pytest.mark.parametrize(("periods", "count"), [(200, 10), (80, 10), (20, 10), (19, 9), (6, 3), (5, 0), (3, 0)])
def test_number_of_sub_windows(periods, count):
    assert sub_window_count(periods) == count


def test_jackknife_of_a_mean_is_the_standard_error():
    values = np.random.default_rng(0).normal(size=12)
    rest = (values.sum() - values) / 11.0
    assert jackknife(rest, values.mean()) == pytest.approx(values.std(ddof=1) / math.sqrt(12.0), rel=1e-12)


def test_jackknife_sees_the_bias_of_a_square():
    """(mean)² of noise about zero: expectation σ²/K, all of it bias."""
    random = np.random.default_rng(1)
    biases = []
    for _ in range(3000):
        values = random.normal(size=10)
        rest = ((values.sum() - values) / 9.0) ** 2
        biases.append(9.0 * (rest.mean() - values.mean() ** 2))
    assert np.mean(biases) == pytest.approx(0.1, rel=0.1)
    # At a maximum the scatter is small beside the bias, and the uncertainty must not be.
    assert jackknife(np.full(10, 0.9), 0.91) == pytest.approx(0.09, rel=1e-9)


def test_slope_uncertainty_against_repetition():
    random = np.random.default_rng(2)
    time = np.arange(10.0)
    noise = random.normal(size=(4000, 10))
    slopes = [np.polyfit(time, row, 1)[0] for row in noise]
    stated = np.sqrt(np.mean([slope_uncertainty(time, row) ** 2 for row in noise]))
    assert stated == pytest.approx(np.std(slopes), rel=0.05)
    assert math.isnan(slope_uncertainty(time[:2], time[:2]))


NOISY = ("damping_ratio", "modal_amplitude", "force_n", "active_power", "phase_error", "self_excitation")
BIASED = ("pbmif", "gamma_force", "gamma_acceleration", "mac")


def test_the_uncertainty_of_every_quantity_is_held_against_repetitions():
    missing = set(EVALUATED) - {*NOISY, *BIASED, "apparent_power"}  # which is the active power over pbmif
    assert not missing, f"put {missing} into NOISY, or into BIASED where noise moves its mean"


@pytest.fixture(scope="module")
def monte_carlo():
    force, shape = in_phase_case()
    harmonics = np.array([0.0, force, 0.1j * force])
    rows = np.array([[1e-5, x, 0.05 * x, 0.01j * x] for x in shape])
    samples = round(40 * RATE / FREQUENCY)
    total = samples + 400

    def point(noise, seed, **changes):
        stream = Stream(harmonics, rows, samples=total, noise=noise, seed=seed, **changes)
        return extract(stream, lock_event(200, samples, 40))

    return point(0.0, 0), [point(0.03, seed) for seed in range(200)], point


def test_stated_uncertainty_equals_the_scatter_of_repetitions(monte_carlo):
    _, points, _ = monte_carlo
    for name in NOISY:
        scatter = np.std([getattr(point, name) for point in points])
        stated = np.sqrt(np.mean([getattr(point, f"{name}_std") ** 2 for point in points]))
        assert stated == pytest.approx(scatter, rel=0.2), name


@pytest.mark.parametrize("name", NOISY)
def test_coverage_of_one_and_two_standard_uncertainties(monte_carlo, name):
    """Student's t with nine degrees of freedom covers 65.7 and 92.3 %; 200 trials scatter by 3.4 %."""
    clean, points, _ = monte_carlo
    error = np.array([abs(getattr(point, name) - getattr(clean, name)) for point in points])
    stated = np.array([getattr(point, f"{name}_std") for point in points])
    assert 0.54 < np.mean(error <= stated) < 0.78
    assert np.mean(error <= 2.0 * stated) > 0.85


@pytest.mark.parametrize("name", BIASED)
def test_uncertainty_of_biased_indicators_covers_their_bias(monte_carlo, name):
    clean, points, _ = monte_carlo
    error = np.array([abs(getattr(point, name) - getattr(clean, name)) for point in points])
    stated = np.array([getattr(point, f"{name}_std") for point in points])
    assert np.mean(error <= 2.0 * stated) > 0.8
    assert np.median(stated) < 6.0 * np.median(error)


@pytest.mark.campaign
def test_fitted_frequency_is_covered(monte_carlo):
    *_, point = monte_carlo
    points = [point(0.03, seed, known_phase=False) for seed in range(100)]
    error = np.array([abs(item.frequency_hz - FREQUENCY) for item in points])
    phase = [item.damping_ratio * math.hypot(item.phase_error, item.phase_error_std) for item in points]
    stated = np.array(
        [FREQUENCY * math.sqrt((item.omega_rad_s_std / item.omega_rad_s) ** 2 - away**2)
         for item, away in zip(points, phase, strict=True)]
    )  # fmt: skip
    assert 0.5 < np.mean(error <= stated) < 0.82
    assert np.all(stated > 0.0)


def test_uncertainty_of_a_wandering_oscillator_frequency():
    """Independent frequencies in twenty blocks: the mean's uncertainty is their scatter over √20."""
    force, shape = in_phase_case()
    random = np.random.default_rng(4)
    ratios = []
    for _ in range(40):
        frequencies = FREQUENCY + 0.02 * random.normal(size=200)
        stream = Stream([0, force], [[0, x] for x in shape], samples=40_000, frequencies=tuple(frequencies))
        point = extract(stream, lock_event(0, 40_000, 89))
        assert point.frequency_hz == pytest.approx(frequencies.mean(), abs=1e-9)
        phase = point.damping_ratio * point.frequency_hz * math.hypot(point.phase_error, point.phase_error_std)
        ratios.append(math.sqrt(point.frequency_hz_std**2 - phase**2) / (0.02 / math.sqrt(200)))
    assert np.sqrt(np.mean(np.square(ratios))) == pytest.approx(1.0, rel=0.15)


def test_short_windows_state_no_uncertainty():
    force, shape = in_phase_case()
    samples = round(4 * RATE / FREQUENCY)
    point = extract(Stream([0, force], [[0, x] for x in shape], samples=3000), lock_event(100, samples, 4))
    assert point.damping_ratio == pytest.approx(0.012, rel=1e-9)
    assert math.isnan(point.damping_ratio_std)
    assert math.isnan(point.frequency_hz_std)


def test_modal_frequency_uncertainty_holds_the_missed_phase_resonance():
    """One degree of freedom off resonance by Δω: tan Δφ = Δω/(δ ω) to first order."""
    force, shape = in_phase_case(damping=0.01)
    off = 0.02
    point = extract(
        Stream([0, force * np.exp(1j * off)], [[0, x] for x in shape], samples=20_000),
        lock_event(0, round(40 * RATE / FREQUENCY), 40),
    )
    assert point.phase_error == pytest.approx(off, abs=1e-9)
    assert point.omega_rad_s_std == pytest.approx(0.01 * point.omega_rad_s * off, rel=1e-3)
