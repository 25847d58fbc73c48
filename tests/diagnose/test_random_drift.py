"""Random tests of a rig that warms up meanwhile: the estimate is a mean over the test."""

from __future__ import annotations

import math

import numpy as np
import pytest
from diagnose.predicted_tests import rows_of
from diagnose.test_stepped_sine import CHANNEL, DAMPER, OMEGA, oscillator
from scipy.integrate import quad

from nmt_diagnose.measurements.random_responses import RandomResponses
from nmt_diagnose.observations.observables import Part
from nmt_diagnose.prediction.forward import Forward
from nmt_rig.rig import Rig

START, STOP = 5.0, 65.0


def drifting(rate: float) -> Rig:
    rig = oscillator()
    return rig.model_copy(update={"drift": rig.drift.model_copy(update={"stiffness_per_s": rate})})


def estimate(hz: float, rate: float) -> complex:
    """Mean over the test of 1 / (k(t) − ω² + i c ω), by quadrature (SciPy)."""
    omega = 2.0 * math.pi * hz

    def response(t: float) -> complex:
        return 1.0 / (OMEGA**2 * (1.0 + rate * t) - omega**2 + 1j * DAMPER * omega)

    parts = [quad(lambda t, k=k: (response(t).real, response(t).imag)[k], START, STOP)[0] for k in (0, 1)]
    return complex(*parts) / (STOP - START)


@pytest.mark.parametrize("rate", [0.0, 2e-4, -4e-4])
def test_the_mean_of_the_closed_form(rate: float) -> None:
    # 2e-4 per second for a minute is 0.6 % of the frequency, more than half the width of the resonance.
    lines = np.linspace(48.0, 52.0, 41)
    test = RandomResponses("noise", 1, (CHANNEL,), "voltage", lines, 0.1, "none", 1e-3, START, STOP)
    table = [(0, k, 0, 1, part) for k in range(lines.size) for part in (Part.REAL, Part.IMAG)]
    rows = rows_of(table)
    values = Forward([test], rows).predict(drifting(rate)).values
    found = values[rows.part == Part.REAL] + 1j * values[rows.part == Part.IMAG]
    expected = np.array([estimate(hz, rate) for hz in lines])
    largest = np.abs(expected).max()
    assert np.abs(found - expected).max() < 2e-4 * largest
    middle = np.array(
        [1.0 / (OMEGA**2 * (1.0 + 35.0 * rate) - (2 * np.pi * f) ** 2 + 2j * np.pi * f * DAMPER) for f in lines]
    )
    if rate:
        assert np.abs(middle - expected).max() > 0.02 * largest


def test_a_test_of_no_length_is_that_of_its_moment() -> None:
    lines = np.array([49.5, 50.5])
    table = [(0, k, 0, 1, part) for k in range(2) for part in (Part.REAL, Part.IMAG)]
    both = [
        Forward(
            [RandomResponses("noise", 1, (CHANNEL,), "voltage", lines, 0.1, "none", 1e-3, start, stop)], rows_of(table)
        )
        .predict(drifting(1e-4))
        .values
        for start, stop in ((20.0, 20.0), (20.0 - 1e-6, 20.0 + 1e-6))
    ]
    assert both[0] == pytest.approx(both[1], rel=1e-8)
