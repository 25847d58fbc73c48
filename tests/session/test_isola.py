"""An isola: foretold by the force surface of held responses, reached by a release and measured, as whole tests."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from nmt_core.errors import BenchError
from nmt_core.vocabulary import PointStatus
from nmt_extract.curves.force_surface import ForceSurface
from nmt_extract.curves.response_curve import response_curves
from nmt_laboratories.forced_balance import OneElement, chain_of_one
from nmt_session import Session, plan_test

DAMPING = 2.5298221281347035
SQUARE, FOURTH = -4.0e6 * DAMPING, 2.56e12 * DAMPING
"""Losses that fall with the amplitude from 0.66 mm on and rise again from 1.2 mm on; they never feed the motion."""
ELEMENTS = (
    "local_elements=[{name: hardening, kind: cubic_spring, point: 1, stiffness_n_m3: 4.3e8}, {name: losses, "
    f"kind: polynomial_damper, point: 1, damping_ns_m: 0.0, damping_ns_m3: {SQUARE}, damping_ns_m5: {FOURTH}}}]"
)
BALANCE: OneElement = chain_of_one(
    16000.0, DAMPING, lambda w, v: 4.3e8 * w**3 + (SQUARE * w**2 + FOURTH * w**4) * v, samples=128, highest=9
)


def measure(levels, **settings):
    plan = plan_test(
        "strong_cubic", levels, overrides=[ELEMENTS], test="response_curve", window_periods=12, ramp=0.3, **settings
    )
    with Session(plan, record=False) as session:
        result = session.run()
    assert all(point.status is PointStatus.OK for point in result.points), [p.reason for p in result.points]
    return result.points


def orbit(lag: float, force: float, omega: float, response: float):
    given = np.zeros(BALANCE.orders.size, complex)
    given[0] = force
    return BALANCE.at_lag(lag, given, omega, response * np.exp(-1j * lag))


def birth() -> float:
    """Least force of the balance at phase resonance over the amplitude, N."""
    found = minimize_scalar(
        lambda response: BALANCE.at_response(0.5 * math.pi, response, 128.3, 0.09)[1],
        bounds=(1.0e-3, 1.4e-3), method="bounded", options={"xatol": 1e-7},
    )  # fmt: skip
    return float(found.fun)


@pytest.mark.campaign
def test_a_branch_that_rest_does_not_lead_to_is_foretold_reached_and_measured():
    held = measure(np.linspace(1.05, 1.4, 4) * 1e-3, control="response", lag_deg=(76.0, 104.0), spacing=0.17)
    (isola,) = ForceSurface.of(response_curves(held)).isolas()
    assert isola.birth_force == pytest.approx(birth(), rel=0.02)
    force = 1.2 * isola.birth_force
    rest = measure([force], lag_deg=(88.0, 92.0), spacing=1.0)
    assert max(abs(point.shape_harmonics[1, 0]) for point in rest) < 0.5e-3  # from below it is never found
    reached = measure([force], lag_deg=(76.0, 104.0), release=1.3e-3, spacing=0.25)
    assert len(reached) > 2
    for point in reached:
        lag, response = 0.5 * math.pi + point.phase_error, abs(point.shape_harmonics[1, 0])
        expected = orbit(lag, point.force_n, point.omega_rad_s, response)
        assert response > 1.2e-3
        assert point.frequency_hz == pytest.approx(expected.omega / (2.0 * math.pi), rel=1e-3)
        assert response == pytest.approx(expected.response, rel=4e-3)  # which settles as slowly as the losses grow
        assert point.force_n == pytest.approx(force, rel=1e-3)


def test_a_release_is_refused_where_it_has_no_sense():
    with pytest.raises(BenchError, match="no release is needed"):
        plan_test("strong_cubic", [1e-3], test="response_curve", control="response", release=1e-3)
    with pytest.raises(BenchError, match="must not be negative"):
        plan_test("strong_cubic", [0.3], test="response_curve", release=-1e-3)
