"""What a point of a response curve is held by, on a beam whose friction sticks: the answer is that of its model."""

from __future__ import annotations

import cmath
import math

import pytest
from pll.closed_loop import ClosedLoop, LevelOutcome
from scipy.optimize import brentq

from nmt_core.errors import BenchError
from nmt_core.vocabulary import CurveParameter, TestKind
from nmt_rig.rig_model import build_system

VOLTAGE = 0.02


@pytest.fixture(scope="module")
def loop() -> ClosedLoop:
    return ClosedLoop()


def answer(loop: ClosedLoop, omega: float) -> tuple[float, float]:
    """Phase by which the force leads the velocity (rad) and response (m) of the model at a frequency, rad/s."""
    system = build_system(loop.device.rig)
    q, force = system.response(omega)
    motion = q[system.points[2]]
    return cmath.phase(force / (1j * motion)), VOLTAGE * abs(motion)


def hold(loop: ClosedLoop, parameter: CurveParameter, omega: float, **fields: object) -> LevelOutcome:
    """The outcome of a level that is to be at the model's answer at ω (rad/s) unless the fields say otherwise."""
    phase, response = answer(loop, omega)
    settings = {"held_phase": phase, "held_response": response, "frequency_hz": omega / (2.0 * math.pi), **fields}
    return loop.run_level(VOLTAGE, test=TestKind.RESPONSE_CURVE, parameter=int(parameter), **settings)


def test_a_held_frequency_leaves_the_lag_to_the_structure(loop):
    omega = 1.01 * loop.linear.frequencies_rad_s[0]
    outcome = hold(loop, CurveParameter.FREQUENCY, omega)
    assert outcome.lock is not None, outcome.reason
    assert outcome.column("frequency_hz") == pytest.approx(omega / (2.0 * math.pi), rel=1e-9)
    phase, response = answer(loop, omega)
    assert outcome.lock.level.held_phase == pytest.approx(phase, abs=2e-3)  # the phase that was found
    assert outcome.column("response_amplitude").mean() == pytest.approx(response, rel=3e-3)


def test_a_secant_holds_the_combination_of_lag_and_response(loop):
    omega, weight = 0.99 * loop.linear.frequencies_rad_s[0], 1.0
    phase, response = answer(loop, omega)
    aside = 0.04  # of a point that is none of the curve
    outcome = hold(
        loop, CurveParameter.SECANT, omega, held_phase=phase + aside, held_response=response, phase_per_response=weight
    )
    assert outcome.lock is not None, outcome.reason

    def away(other: float) -> float:
        found = answer(loop, other)
        return found[0] - phase - aside + weight * math.log(found[1] / response)

    expected = brentq(away, 0.98 * omega, 1.01 * omega)
    assert outcome.column("frequency_hz").mean() * 2.0 * math.pi == pytest.approx(expected, rel=1e-4)
    assert outcome.lock.level.held_phase == pytest.approx(answer(loop, expected)[0], abs=3e-3)


def test_an_orbit_of_another_branch_is_no_lock():
    loop = ClosedLoop()
    omega = 1.01 * loop.linear.frequencies_rad_s[0]
    outcome = hold(loop, CurveParameter.FREQUENCY, omega, held_response=3.0 * answer(loop, omega)[1])
    assert outcome.lock is None
    assert "so this is another branch" in outcome.reason


def test_a_point_off_the_lag_needs_a_response(loop):
    with pytest.raises(BenchError, match="needs a response above 0, got 0"):
        hold(loop, CurveParameter.SECANT, 100.0, held_response=0.0)
