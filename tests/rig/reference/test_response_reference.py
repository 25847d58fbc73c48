"""Response curves of a model: against a harmonic balance that shares no code, and Floquet multipliers."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from independent.harmonic_continuation import CubicModes, PhaseBranch, Solution
from scipy.optimize import minimize_scalar

from nmt_core.errors import BenchError
from nmt_report.curve_figures import reference_sentences
from nmt_rig.model.floquet import floquet_multipliers
from nmt_rig.response_reference import reference_responses, response_problem
from nmt_rig.rig import load_rig

OMEGA, LENGTH, FORCE = math.sqrt(16000.0), 1e-3, 16.0
ONE = np.array([1.0])
BALANCE = CubicModes(ONE, np.array([0.01]), ONE, ONE, 1.0, 11)


@pytest.fixture(scope="module")
def curve():
    return reference_responses(load_rig("strong_cubic"), [0.32], 9, (12.0, 40.0), 250)[0]


def at_lag(lag_deg: float, frequency_hz: float, response: float) -> Solution:
    """The independent balance at a lag, near a point."""
    series = np.zeros((BALANCE.orders.size, 1), complex)
    series[0, 0] = response / LENGTH * np.exp(-1j * math.radians(lag_deg))
    start = Solution(series, 2.0 * math.pi * frequency_hz / OMEGA, 0.32 / FORCE)
    return PhaseBranch(BALANCE, lag_deg, 1.0).at_force(start, 0.32 / FORCE)


def test_every_point_is_one_of_the_independent_balance(curve):
    for k in np.linspace(1, curve.lag.size - 2, 12).astype(int):
        found = at_lag(math.degrees(curve.lag[k]), curve.frequency_hz[k], curve.response[k])
        assert found.omega_b * OMEGA / (2.0 * math.pi) == pytest.approx(curve.frequency_hz[k], rel=1e-5)
        assert abs(found.series[0, 0]) * LENGTH == pytest.approx(curve.response[k], rel=1e-5)


def test_folds_are_where_the_frequency_of_the_independent_balance_turns(curve):
    assert len(curve.folds) == 2
    for sign, (frequency, response, lag) in zip((-1.0, 1.0), curve.folds, strict=True):
        lag_deg = math.degrees(lag)
        best = minimize_scalar(
            lambda x, s=sign, f=frequency, r=response: s * at_lag(x, f, r).omega_b,
            bounds=(lag_deg - 2.0, lag_deg + 2.0),
            method="bounded",
            options={"xatol": 1e-3},
        )
        assert sign * best.fun * OMEGA / (2.0 * math.pi) == pytest.approx(frequency, rel=1e-6)
        assert best.x == pytest.approx(lag_deg, abs=0.05)


def test_between_the_folds_and_only_there_a_multiplier_is_beyond_the_unit_circle(curve):
    rising = curve.curve.branch.tangents[:, -1] > 0.0
    assert np.array_equal(curve.stable, rising)
    assert 50 < np.count_nonzero(~curve.stable) < curve.stable.size - 50


def test_multipliers_of_a_linear_rig_are_those_of_its_poles():
    problem, omega = response_problem(load_rig("strong_cubic", ["local_elements.0.stiffness_n_m3=1e-3"]), 3)
    (curve,) = reference_responses(
        load_rig("strong_cubic", ["local_elements.0.stiffness_n_m3=1e-3"]), [1.0], 3, (18.0, 19.0), 10
    )
    response = curve.curve.responses[0]
    period = 2.0 * math.pi / response.angular_frequency
    poles = omega * (-0.01 + 1j * math.sqrt(1.0 - 0.01**2)) * np.array([1.0, 0.0])[:1]
    expected = np.exp(np.array([poles[0], poles[0].conjugate()]) * period)
    found = floquet_multipliers(problem.system, response)
    assert sorted(found, key=lambda z: z.imag) == pytest.approx(sorted(expected, key=lambda z: z.imag), rel=1e-6)


def test_the_largest_multiplier_is_the_growth_of_a_perturbation_in_time(curve):
    k = int(np.flatnonzero(~curve.stable)[np.count_nonzero(~curve.stable) // 2])
    found = at_lag(math.degrees(curve.lag[k]), curve.frequency_hz[k], curve.response[k])
    start = BALANCE.start_state(found.series, found.omega_b)
    columns = []
    for unit in np.eye(2):
        ends = [BALANCE.simulate(start + sign * 1e-5 * unit, found.omega_b, found.force, 1)[1] for sign in (1.0, -1.0)]
        columns.append((ends[0] - ends[1]) / 2e-5)
    expected = np.abs(np.linalg.eigvals(np.array(columns).T)).max()
    assert expected == pytest.approx(curve.largest_multiplier[k], rel=1e-3)


def test_friction_has_folds_and_no_multipliers():
    (curve,) = reference_responses(load_rig("beam"), [0.3], 3, (15.0, 26.0), 60)
    assert curve.stable.all()
    assert np.isnan(curve.largest_multiplier).all()
    with pytest.raises(BenchError, match="slider has a memory"):
        floquet_multipliers(response_problem(load_rig("beam"), 3)[0].system, curve.curve.responses[0])


def test_a_tip_is_an_inner_largest_response_only(curve):
    (inner,) = reference_sentences([curve])
    assert "its tip is" in inner
    inside = replace(
        curve, frequency_hz=curve.frequency_hz[:30], response=curve.response[:30], stable=curve.stable[:30]
    )
    assert np.argmax(inside.response) == 29  # still rising where the band ends
    (edge,) = reference_sentences([inside])
    assert "tip" not in edge
    assert "its largest response" in edge


def test_several_exciters_are_refused():
    with pytest.raises(BenchError, match="one force at one point"):
        reference_responses(load_rig("beam_two_shakers"), [0.3])
