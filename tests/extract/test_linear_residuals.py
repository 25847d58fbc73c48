"""Residuals of the modes that were not fitted."""

from __future__ import annotations

import numpy as np
import pytest

from nmt_core.errors import BenchError
from nmt_extract.linear.residuals import fit_residuals, modal_receptance

FREQUENCY = np.arange(250.0, 480.0, 0.25)
TARGET = (np.array([0.2, -0.1]), 2 * np.pi * 370.0, 0.001)


def test_receptance_of_a_mode_is_that_of_a_mass_on_a_spring():
    k, m, c = 1.0e5, 0.5, 3.0
    omega = 2 * np.pi * FREQUENCY
    exact = 1.0 / (k - m * omega**2 + 1j * c * omega)
    mode = modal_receptance(np.array([1 / m]), np.sqrt(k / m), c / (2 * np.sqrt(k * m)), FREQUENCY)
    np.testing.assert_allclose(mode[0], exact, rtol=1e-12)


def test_lower_and_upper_residual_are_recovered_exactly():
    lower, upper = np.array([0.196, -0.05 + 0.01j]), np.array([2e-8, -1e-8 + 1e-9j])
    omega = 2 * np.pi * FREQUENCY
    data = modal_receptance(*TARGET, FREQUENCY) - lower[:, None] / omega**2 + upper[:, None]
    found = fit_residuals(FREQUENCY, data, np.full(data.shape, 1e-18), [TARGET], (280.0, 460.0))
    np.testing.assert_allclose(found.lower, lower, rtol=1e-6)
    np.testing.assert_allclose(found.upper, upper, rtol=1e-4, atol=1e-12)
    np.testing.assert_allclose(found.receptance(FREQUENCY) + modal_receptance(*TARGET, FREQUENCY), data, rtol=1e-6)


def test_a_free_body_shows_its_mass_as_lower_residual_and_a_high_mode_its_flexibility_as_upper():
    mass, high = 5.1, (np.array([0.05]), 2 * np.pi * 8000.0, 0.01)
    target = (np.array([0.2]), *TARGET[1:])
    data = modal_receptance(*target, FREQUENCY) - 1 / mass / (2 * np.pi * FREQUENCY) ** 2
    data = data + modal_receptance(*high, FREQUENCY)
    found = fit_residuals(FREQUENCY, data, np.full(data.shape, 1e-20), [target], (280.0, 460.0))
    assert found.lower[0] == pytest.approx(1 / mass, rel=2e-3)
    assert found.upper[0] == pytest.approx(high[0][0] / high[1] ** 2, rel=0.02)


def test_errors_of_the_mode_near_its_peak_hardly_touch_the_residuals():
    lower = np.array([0.196, 0.1])
    data = 1.003 * modal_receptance(*TARGET, FREQUENCY) - lower[:, None] / (2 * np.pi * FREQUENCY[None]) ** 2
    found = fit_residuals(FREQUENCY, data, np.full(data.shape, 1e-18), [TARGET], (280.0, 460.0))
    band = (FREQUENCY > 350) & (FREQUENCY < 390)
    rest = found.receptance(FREQUENCY)[:, band] * (2 * np.pi * FREQUENCY[band]) ** 2
    assert np.max(np.abs(rest + lower[:, None])) < 0.02


def test_an_empty_band_is_refused():
    with pytest.raises(BenchError, match="fewer than four"):
        fit_residuals(FREQUENCY, np.zeros((1, FREQUENCY.size)), np.ones((1, FREQUENCY.size)), [], (1.0, 2.0))
