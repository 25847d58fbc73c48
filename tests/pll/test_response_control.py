"""Levels of response amplitude through a 1:3 internal resonance, against an independent harmonic balance."""

from __future__ import annotations

import math

import numpy as np
import pytest
from pll.internal_resonance import at_amplitude, folds
from tiers import with_quick

from nmt_core.vocabulary import PointStatus
from nmt_pll.amplitude.response_control import ResponseController
from nmt_session import Session, plan_test

NOISE = [
    *(f"sensors.{row}.noise_psd=4.5e-16" for row in (1, 2, 3)),
    "sensors.0.noise_psd=2e-9",
    *(f"sensors.{row}.noise_correlation_time_s=1e-5" for row in range(4)),
]
"""The paper's lower noise on force and displacements."""


def measured(factor: float, levels: list[float], overrides: list[str] | None = None, **settings):
    """Modal points of the shipped rig at a damping of ``factor`` per cent."""
    changes = [f"structure.damping_factors=[{factor},{factor},{factor}]", *(overrides or [])]
    plan = plan_test("internal_resonance", levels, overrides=changes, control="response", window_periods=20, **settings)
    with Session(plan, record=False) as session:
        return session.run().points


def simulate(controller: ResponseController, slope: float, level: float, decay: float = 0.6) -> list[float]:
    """Amplitude of ȧ = −δ (f(a) − u) under control; around a = 1 the voltage needed changes by ``slope`` per a."""
    amplitude, voltage, course = 1.0, 1.0, []
    for _ in range(3000):
        needed = 1.0 + slope * (amplitude - 1.0)
        amplitude += 0.01 * decay * (voltage - needed)
        voltage = controller.update(level, amplitude, 2.5, decay, 0.01)
        course.append(amplitude)
    return course


@pytest.mark.parametrize("slope", [1.0, 0.0, -1.5], ids=["linear", "fold over the force", "beyond it"])
def test_an_amplitude_is_held_also_where_the_force_falls(slope):
    controller = ResponseController()
    controller.start(1.0)
    controller.aim(1.0)
    course = simulate(controller, slope, 1.1)
    assert course[-1] == pytest.approx(1.1, rel=1e-3)
    assert max(course) < 1.2


@pytest.mark.parametrize(("factor", "direction"), with_quick([(1.0, 1), (1.0, -1), (0.5, 1), (0.5, -1)], (0.5, -1)))
def test_the_levels_pass_an_internal_resonance(factor, direction):
    points = measured(factor, list(np.geomspace(0.6e-3, 2.7e-3, 8)[::direction]))
    assert all(point.status is PointStatus.OK for point in points)
    for point in points:
        (balance,) = at_amplitude(factor, point.level)
        assert point.omega_rad_s == pytest.approx(balance.omega_b, rel=5e-4)
        assert point.force_n == pytest.approx(balance.force, rel=0.02)


def test_at_a_fold_over_the_amplitude_the_levels_jump_once():
    levels = [1.2e-3, 1.6e-3, 1.8e-3, 1.9e-3, 2.05e-3, 2.4e-3]
    points = measured(0.2, levels)
    assert all(point.status is PointStatus.OK for point in points)
    branches = [at_amplitude(0.2, level) for level in levels]
    low, high = sorted(folds(0.2)[1])
    assert low < 1.8e-3
    assert 1.9e-3 < high < 2.05e-3
    for point, solutions in zip(points, branches, strict=True):
        first = solutions[0] if point.level < high else solutions[-1]
        assert point.omega_rad_s == pytest.approx(first.omega_b, rel=1e-3)


@pytest.mark.parametrize("latency", with_quick([0, 1, 3], 3))
def test_latency_and_noise_leave_the_levels_stable(latency):
    levels = [1.2e-3, 1.8e-3, 2.2e-3, 2.6e-3]
    points = measured(0.5, levels, NOISE, latency_blocks=latency)
    assert all(point.status is PointStatus.OK for point in points)
    for point in points:
        (balance,) = at_amplitude(0.5, point.level)
        assert point.omega_rad_s == pytest.approx(balance.omega_b, rel=1e-3)
        assert math.degrees(abs(point.phase_error)) < 0.3
