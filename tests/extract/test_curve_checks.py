"""Plain looks at response curves: two curves each that tempt to a statement and are none, two that are it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.optimize import fsolve

from nmt_core.messages.modal_point import ModalPoint
from nmt_core.vocabulary import PointStatus
from nmt_extract.curves import curve_checks
from nmt_extract.curves.force_surface import ForceSurface, surface_sentences
from nmt_extract.curves.response_curve import ResponseCurve, curve_sentences, response_curves
from nmt_extract.judgement.window_judge import is_settled, settling_part

OMEGA, ZETA, UNIT = 126.5, 0.01, 1e-3
LAGS = np.radians(np.arange(15.0, 170.0, 5.0))


def measured(omega, response, lags=LAGS, relative_std=3e-4, noise=0.0) -> ResponseCurve:
    """A curve at a held force of 1 N with its frequencies as measured."""
    omega = omega * (1.0 + noise * np.random.default_rng(5).standard_normal(lags.size))
    points = []
    for index, (lag, w, a) in enumerate(zip(lags, omega, response, strict=True)):
        phase = float(lag) - 0.5 * math.pi
        hertz = float(w) / (2.0 * math.pi)
        points.append(
            ModalPoint(
                index, PointStatus.OK, "", 1.0, "N", omega_rad_s=float(w), frequency_hz=hertz,
                frequency_hz_std=relative_std * hertz, force_n=1.0, phase_error=phase, modal_amplitude=float(a),
                active_power=0.5 * float(w) * float(a) * math.cos(phase), held_phase=phase,
            )
        )  # fmt: skip
    (curve,) = response_curves(points)
    return curve


def two_sided_stop(force: float, clearance: float = 1.0, stiffness: float = 0.3):
    """Frequency and amplitude over the lag of a mode between two elastic stops, by a balance of one harmonic.

    The stop's describing function is 1 + k N(a) with N = 1 − (2/π) (arcsin(g/a) + g/a √(1 − (g/a)²)) beyond the gap g.
    """
    found = []
    start = np.array([1.0, 0.5])
    for lag in LAGS:

        def balance(x, lag=lag):
            ratio = min(clearance / max(abs(x[1]), 1e-9), 1.0)
            stop = 1.0 - 2.0 / math.pi * (math.asin(ratio) + ratio * math.sqrt(1.0 - ratio**2))
            z = 1.0 + stiffness * stop - x[0] ** 2 + 2j * ZETA * 5.0 * x[0]
            return [abs(z) * x[1] - force, math.atan2(z.imag, z.real) - lag]

        start = fsolve(balance, start)
        found.append(start.copy())
    return np.array(found)


def hardening(lags, cubic, zeta=ZETA):
    """ω(ϑ) and a(ϑ) of a mode whose frequency grows with its squared amplitude, 1 at resonance."""
    return OMEGA * (1.0 + cubic * np.sin(lags) ** 2) - zeta * OMEGA / np.tan(lags), np.sin(lags)


@pytest.mark.court(not_said=("fold", "unstable"))
def test_a_frequency_that_rises_everywhere_has_no_fold():
    stop = two_sided_stop(0.11)
    assert np.all(np.diff(stop[:, 0]) > 0.0)  # the balance is monotone
    assert np.ptp(stop[:, 1]) > 0.5  # and the stop is hit
    curve = measured(OMEGA * stop[:, 0], stop[:, 1], noise=2e-4)
    assert curve.folds == ()
    assert not np.any(curve.stable == 0.0)
    (sentence,) = curve_sentences([curve])
    assert "no fold" in sentence
    assert "unstable" not in sentence


@pytest.mark.court(not_said=("fold", "unstable"))
def test_knots_of_an_interpolation_are_no_fold():
    omega, response = hardening(LAGS, 0.0)
    omega = omega + 0.002 * OMEGA * np.isin(np.arange(LAGS.size), (14, 15))  # a step up: splines overshoot beside it
    curve = measured(omega, response, relative_std=1e-3)
    assert curve.folds == ()
    assert not np.any(curve.stable == 0.0)


@pytest.mark.court(said=("fold", "unstable"))
@pytest.mark.parametrize("cubic", [0.1, -0.08])
def test_a_fold_lies_between_the_measured_points_that_are_named(cubic):
    curve = measured(*hardening(LAGS, cubic), noise=1e-4)
    fine = np.radians(np.linspace(15.0, 165.0, 20001))
    omega = hardening(fine, cubic)[0]
    exact = fine[1:-1][np.diff(np.sign(np.diff(omega))) != 0.0]
    assert len(curve.folds) == exact.size == 2
    for fold, lag in zip(curve.folds, exact, strict=True):
        assert fold.lag_before < lag < fold.lag_after
        true = float(np.interp(lag, fine, omega)) / (2.0 * math.pi)
        assert abs(fold.frequency_hz - true) < 3.0 * fold.frequency_hz_std
    slope = np.gradient(hardening(fine, cubic)[0], fine)
    rising = np.interp(curve.lag, fine, slope) > 0.0
    known = np.isfinite(curve.stable)
    assert np.array_equal(curve.stable[known] == 1.0, rising[known])
    assert np.count_nonzero(curve.stable == 0.0) > 0


@pytest.mark.court(not_said="unstable")
def test_points_in_the_noise_of_a_flat_branch_are_left_open():
    omega, response = hardening(LAGS, 0.0, zeta=1e-5)
    curve = measured(omega, response, relative_std=1e-3, noise=1e-3)
    assert not np.any(curve.stable == 0.0)


def held(amplitude: float, damping, centre, width: float = 0.015, std: float = 0.0) -> ResponseCurve:
    """Frequencies about resonance at a held response; damping c(a) and centre frequency ω(a) of 1 kg."""
    omega = centre(amplitude) * np.linspace(1.0 - width, 1.0 + width, 9)
    z = centre(amplitude) ** 2 - omega**2 + 1j * omega * damping(amplitude)
    z = z * (1.0 + std * np.random.default_rng(round(1e6 * amplitude)).standard_normal(9))
    zero, response, force = np.zeros(9), np.full(9, amplitude), amplitude * np.abs(z)
    return ResponseCurve(
        amplitude, "m", np.angle(z), zero, omega / (2.0 * math.pi), zero, response, zero, force, zero, ()
    )  # fmt: skip


def viscous(amplitude: float) -> float:
    return 2.0 * ZETA * OMEGA


def falling(amplitude: float) -> float:
    """Losses that fall with the amplitude and rise again."""
    a = amplitude / UNIT
    return 2.0 * ZETA * OMEGA * (1.0 - 1.2 * a**2 + 0.4 * a**4)


def stiffening(amplitude: float) -> float:
    return OMEGA * math.sqrt(1.0 + 0.75 * (amplitude / UNIT) ** 2)


def nearly_linear(amplitude: float) -> float:
    return OMEGA * math.sqrt(1.0 + 0.02 * (amplitude / UNIT) ** 2)


@pytest.mark.court(not_said="isola")
@pytest.mark.parametrize("centre", [stiffening, nearly_linear])
def test_of_viscous_damping_no_isola_is_foretold(centre):
    """F_min(A) = c Ω A rises with the amplitude."""
    curves = [held(a, viscous, centre, std=3e-3) for a in UNIT * np.geomspace(0.2, 1.2, 6)]
    assert ForceSurface.of(curves).isolas() == ()
    assert not any("isola is born" in sentence for sentence in surface_sentences(curves))


@pytest.mark.court(said="isola")
@pytest.mark.parametrize("centre", [stiffening, nearly_linear])
def test_an_isola_on_which_a_held_amplitude_lies_is_named(centre):
    curves = [held(a, falling, centre) for a in UNIT * np.linspace(0.2, 1.7, 11)]
    (isola,) = ForceSurface.of(curves).isolas()
    amplitudes = UNIT * np.linspace(0.8, 1.6, 4001)
    least = np.array([a * falling(a) * centre(a) for a in amplitudes])  # F at phase resonance
    assert isola.birth_force == pytest.approx(least[1:-1].min(), rel=2e-2)
    assert isola.response == pytest.approx(float(amplitudes[np.argmin(least)]), rel=3e-2)


@pytest.mark.court(not_said="force surface")
@pytest.mark.parametrize("count", [5, 6])
def test_nothing_is_said_of_the_force_where_measured_frequencies_do_not_overlap(count):
    apart = [held(a, viscous, stiffening) for a in UNIT * np.geomspace(0.2, 1.2, count)]
    surface = ForceSurface.of(apart)
    assert surface.unknown_between
    between = 0.5 * (surface.amplitude[:-1] + surface.amplitude[1:])
    middle = surface.band_hz.mean(axis=1)
    frequency = 0.5 * (middle[:-1] + middle[1:])
    assert not surface.is_known(frequency, between)[list(surface.unknown_between)].any()
    assert any("do not overlap" in sentence for sentence in surface_sentences(apart))


@pytest.mark.court(said="force surface")
@pytest.mark.parametrize("count", [11, 14])
def test_a_force_between_overlapping_frequencies_is_known_and_right(count):
    near = [held(a, viscous, nearly_linear) for a in UNIT * np.linspace(0.2, 1.7, count)]
    surface = ForceSurface.of(near)
    assert surface.unknown_between == ()
    assert not any("do not overlap" in sentence for sentence in surface_sentences(near))
    response = 0.5 * (surface.amplitude[:-1] + surface.amplitude[1:])
    frequency = surface.band_hz.mean(axis=1)[:-1]
    assert surface.is_known(frequency, response).all()
    omega = 2.0 * math.pi * frequency
    centre = np.array([nearly_linear(a) for a in response])
    exact = response * np.abs(centre**2 - omega**2 + 1j * omega * viscous(0.0))
    assert surface.force(frequency, response) == pytest.approx(exact, rel=2e-3)


def settled(growth, rate):
    """At 1 % damping and 126.5 rad/s the decay is 1.265 1/s."""
    decay = ZETA * OMEGA
    found = is_settled(growth / decay, rate / decay / OMEGA, ZETA)
    remark = settling_part({"damping_ratio": ZETA, "omega_rad_s": OMEGA, "modal_amplitude": 1.0}, growth, rate)
    assert ("has not settled" in remark.sentence) is not found
    return found


@pytest.mark.court(not_said="settled")
@pytest.mark.parametrize(("growth", "rate"), [(0.05, 0.0), (0.0, 0.5)])
def test_a_point_that_still_moves_has_not_settled(growth, rate):
    assert not settled(growth, rate)


@pytest.mark.court(said="settled")
@pytest.mark.parametrize(("growth", "rate"), [(0.0, 0.0), (0.001, 0.005)])
def test_a_point_that_hardly_moves_has_settled(growth, rate):
    assert settled(growth, rate)


def test_no_line_is_drawn_where_a_lag_was_not_held():
    lag = np.array([0.5, 1.0, 1.5, 2.0])
    assert curve_checks.gaps(lag, np.array([1.2])).tolist() == [False, True, False]
    assert curve_checks.gaps(lag[::-1], np.array([])).tolist() == [False, False, False]
