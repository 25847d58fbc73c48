from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.signal import lsim
from unit.extract.synthetic import OMEGA, RATE, linear_description, lock_event

from nmt_core.blocks import Quantity
from nmt_core.errors import BenchError
from nmt_extract.ramp_windows import ramp_points
from nmt_extract.window import Channel, Window

ZETA, MASS = 0.01, 0.5
LINEAR = linear_description(
    np.array([[1.0 / math.sqrt(MASS)]]), points=(2,), frequencies_rad_s=(OMEGA,), damping_ratios=(ZETA,)
)


def ramp(samples=60_000, growth=0.6):
    """Linear oscillator driven at its frequency with a rising force, integrated numerically."""
    time = np.arange(samples) / RATE
    force = (1.0 + growth * time) * np.cos(OMEGA * time)
    system = ([1.0 / MASS], [1.0, 2.0 * ZETA * OMEGA, OMEGA**2])
    _, response, _ = lsim(system, force, time)
    cycles = OMEGA * time / (2.0 * np.pi)
    channels = (Channel("f2", Quantity.FORCE, 2), Channel("x2", Quantity.DISPLACEMENT, 2))
    end = OMEGA * samples / RATE / (2.0 * np.pi)
    return Window(lock_event(0, samples, 0), RATE, channels, np.array([force, response]), cycles, end)


def test_damping_of_a_transient_is_that_of_the_oscillator():
    points = ramp_points(ramp(), LINEAR)
    late = points.time > 0.5
    # From the first periods on, far from the steady state, the balance holds; without dE/dt it does not.
    np.testing.assert_allclose(points.damping_ratio[late], ZETA, rtol=0.03)
    naive = points.active_power / (points.omega_rad_s * points.modal_amplitude) ** 2 * 2 / (2 * points.omega_rad_s)
    assert np.abs(naive[late] / ZETA - 1.0).max() > 0.3
    np.testing.assert_allclose(points.omega_rad_s, OMEGA, rtol=1e-9)


def test_what_cannot_be_evaluated_is_told():
    window = ramp(2000)
    with pytest.raises(BenchError, match="needs three sub-windows"):
        ramp_points(window, LINEAR)
    with pytest.raises(BenchError, match="no"):
        ramp_points(window, linear_description())
    blind = Window(window.lock, RATE, window.channels, window.data, None, math.nan)
    with pytest.raises(BenchError, match="not known"):
        ramp_points(blind, LINEAR)
