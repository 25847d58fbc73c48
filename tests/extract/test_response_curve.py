"""Folds, tip and stability of response curves, against the closed form of a mode with a hardening backbone."""

from __future__ import annotations

import math
import sys
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq

from nmt_core.messages.modal_point import ModalPoint
from nmt_core.vocabulary import PointStatus
from nmt_extract.curves.response_curve import curve_sentences, is_of_curve, response_curves

OMEGA, ZETA, LEVEL, CUBIC = 120.0, 0.01, 2.0, 0.1
LARGEST = LEVEL / (2.0 * ZETA * OMEGA**2)


def omega_of(lag):
    """Frequency at a lag, rad/s: a = a₀ sin ϑ, ω = ω₀ (1 + c sin²ϑ) − ζ ω₀ cot ϑ."""
    return OMEGA * (1.0 + CUBIC * np.sin(lag) ** 2) - ZETA * OMEGA / np.tan(lag)


def point(lag: float, index: int, level: float = LEVEL, cubic_std: float = 0.0) -> ModalPoint:
    omega, response = float(omega_of(lag)), LARGEST * math.sin(lag)
    phase = lag - 0.5 * math.pi
    return ModalPoint(
        index, PointStatus.OK, "", level, "N", omega_rad_s=omega, frequency_hz=omega / (2.0 * math.pi),
        frequency_hz_std=cubic_std, force_n=level, phase_error=phase, modal_amplitude=response,
        active_power=0.5 * omega * response * level * math.cos(phase), held_phase=phase,
    )  # fmt: skip


def slope(lag: float) -> float:
    """dω/dϑ, rad/s a rad."""
    return OMEGA * CUBIC * math.sin(2.0 * lag) + ZETA * OMEGA / math.sin(lag) ** 2


LAGS = np.radians(np.linspace(15.0, 170.0, 40))
POINTS = [point(lag, index) for index, lag in enumerate(LAGS)]


def test_folds_are_where_the_frequency_turns():
    (curve,) = response_curves(POINTS)
    exact = [brentq(slope, 1.6, 2.0), brentq(slope, 2.5, 3.1)]
    assert [fold.lag for fold in curve.folds] == pytest.approx(exact, abs=3e-3)
    for fold, lag in zip(curve.folds, exact, strict=True):
        assert fold.frequency_hz == pytest.approx(omega_of(lag) / (2.0 * math.pi), rel=2e-5)
        assert abs(fold.lag - lag) < 4.0 * fold.lag_std + 1e-4


def test_the_tip_is_at_phase_resonance():
    (curve,) = response_curves(POINTS)
    assert curve.tip is not None
    assert curve.tip.lag == pytest.approx(0.5 * math.pi, abs=2e-3)
    assert curve.tip.response == pytest.approx(LARGEST, rel=1e-5)


def test_stability_changes_at_the_folds_and_is_left_open_near_them():
    (curve,) = response_curves(POINTS)
    first, second = (fold.lag for fold in curve.folds)
    expected = (curve.lag < first) | (curve.lag > second)
    known = np.isfinite(curve.stable)
    assert np.array_equal(curve.stable[known] == 1.0, expected[known])
    assert known.sum() >= curve.lag.size - 4


def test_uncertain_frequencies_make_uncertain_folds():
    sharp, dull = (
        response_curves([replace(item, frequency_hz_std=std) for item in POINTS])[0].folds[0] for std in (0.0, 0.01)
    )
    assert dull.frequency_hz_std > 0.009
    assert dull.lag_std > 3.0 * sharp.lag_std


@pytest.mark.parametrize("count", [6, 8, 10, 14, 22])
def test_a_coarse_fold_is_as_uncertain_as_its_spacing_makes_it(count, monkeypatch):
    """Of 40 curves with even and uneven lags few places are beyond two uncertainties, and none is stated blindly."""
    generator = np.random.default_rng(count)
    errors = []
    for _ in range(40):
        monkeypatch.setattr(sys.modules[__name__], "CUBIC", 10 ** generator.uniform(-1.6, -0.5))
        monkeypatch.setattr(sys.modules[__name__], "ZETA", 10 ** generator.uniform(-2.5, -1.6))
        low, high = np.radians(generator.uniform(5, 40)), np.radians(generator.uniform(140, 175))
        even = np.linspace(low, high, count)
        lags = even + generator.choice([0.0, 0.3]) * (even[1] - even[0]) * generator.uniform(-1, 1, count)
        (curve,) = response_curves([point(lag, index) for index, lag in enumerate(lags)])
        grid = np.linspace(lags[0], lags[-1], 2001)
        rises = np.array([slope(lag) for lag in grid]) > 0.0
        exact = [brentq(slope, grid[k], grid[k + 1]) for k in np.flatnonzero(rises[1:] != rises[:-1])]
        for fold in curve.folds:
            lag = min(exact, key=lambda place, fold=fold: abs(place - fold.lag))
            hertz = omega_of(lag) / (2.0 * math.pi)
            errors.append(((fold.lag - lag) / fold.lag_std, (fold.frequency_hz - hertz) / fold.frequency_hz_std))
    beyond = np.abs(errors)
    assert len(errors) > 15
    assert np.mean(beyond > 2.0, axis=0).max() < 0.15
    assert beyond.max() < 15.0


def test_a_curve_that_was_stopped_says_so_and_no_tries():
    cut = replace(
        POINTS[12], status=PointStatus.REJECTED, reason="The loop did not hold its lock (the drive goes to zero)."
    )
    (curve,) = response_curves([*POINTS[:12], cut])
    sentences = curve_sentences([curve])
    assert curve.missing == ()
    assert sentences[-1].startswith("At 2 N the test ended at the point at")
    assert not any("tried" in sentence for sentence in sentences)
    lost = replace(POINTS[5], status=PointStatus.NOT_LOCKED, reason="No lock.")
    (curve,) = response_curves([*POINTS[:5], lost, *POINTS[6:]])
    assert "tried once. At the first: No lock." in curve_sentences([curve])[-1]


def test_curves_are_told_apart_by_their_level_and_measured_backwards():
    other = [point(lag, 100 + index, 1.0) for index, lag in enumerate(LAGS[::-1])]
    first, second = response_curves([*POINTS, *other])
    assert (first.level, second.level) == (2.0, 1.0)
    assert np.all(np.diff(second.lag) > 0.0)
    assert len(curve_sentences([first, second])) == 2


def test_points_at_phase_resonance_are_no_curve():
    assert not is_of_curve([replace(POINTS[0], held_phase=0.0)])
    assert is_of_curve(POINTS)
    few = response_curves(POINTS[:3])[0]
    assert few.folds == ()
    assert np.isnan(few.stable).all()
