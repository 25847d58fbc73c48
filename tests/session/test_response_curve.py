"""Response curves as whole tests in one process: through both folds, against a balance that shares no code."""

from __future__ import annotations

import math

import numpy as np
import pytest
from independent.harmonic_continuation import CubicModes, PhaseBranch, Solution
from scipy.optimize import minimize_scalar

import nmt
from nmt_core.errors import BenchError
from nmt_core.kinds import ResponseCurveTest
from nmt_core.vocabulary import ControlKind, PointStatus, SteeringAct
from nmt_extract.curves.response_curve import response_curves
from nmt_extract.modal.table import write_results
from nmt_extract.offline import extract_bag
from nmt_laboratories.epmc_by_receptance import coulomb_force
from nmt_laboratories.forced_balance import cantilever, chain_of_one, cubic
from nmt_pll.thresholds import CURVE
from nmt_rig.linear_description import linear_description
from nmt_rig.rig import load_rig
from nmt_session import Session, plan_test
from nmt_session.curve_loop import curve_values

OMEGA, LENGTH, FORCE = math.sqrt(16000.0), 1e-3, 16.0
ONE = np.array([1.0])
BALANCE = CubicModes(ONE, np.array([0.01]), ONE, ONE, 1.0, 11)


def measure(folder, forces, **settings):
    """Points, acts of steering and bag of a run of the shipped rig."""
    acts = []
    settings = {"window_periods": 20, "ramp": 0.3, **settings}
    plan = plan_test("strong_cubic", forces, test="response_curve", **settings)

    def listen(topic, record):
        if topic == "steering":
            acts.append(record)

    with Session(plan, folder / "run", listener=listen) as session:
        result = session.run()
    return result, acts, folder / "run" / "bag"


def at_lag(lag: float, force: float, frequency_hz: float, response: float) -> Solution:
    """The independent balance at a lag (rad) and a force (N), near a point."""
    series = np.zeros((BALANCE.orders.size, 1), complex)
    series[0, 0] = response / LENGTH * np.exp(-1j * lag)
    start = Solution(series, 2.0 * math.pi * frequency_hz / OMEGA, force / FORCE)
    return PhaseBranch(BALANCE, math.degrees(lag), 1.0).at_force(start, force / FORCE)


def fold_hz(place, force: float, sign: float) -> float:
    """Frequency at which the independent balance turns, Hz."""
    best = minimize_scalar(
        lambda lag: sign * at_lag(lag, force, place.frequency_hz, place.response).omega_b,
        bounds=(place.lag - 0.1, place.lag + 0.1),
        method="bounded",
    )
    return sign * float(best.fun) * OMEGA / (2.0 * math.pi)


def test_a_hardening_curve_is_followed_through_both_folds(tmp_path):
    result, acts, bag = measure(tmp_path, [0.32], lag_deg=(70.0, 168.0), spacing=0.3, window_periods=12)
    points = result.points
    assert all(point.status is PointStatus.OK for point in points), [point.reason for point in points]
    for point in points:
        found = at_lag(0.5 * math.pi + point.phase_error, 0.32, point.frequency_hz, 0.8e-3)
        assert point.frequency_hz == pytest.approx(found.omega_b * OMEGA / (2.0 * math.pi), rel=1e-3)
        assert abs(point.shape_harmonics[1, 0]) == pytest.approx(abs(found.series[0, 0]) * LENGTH, rel=2e-3)
        assert point.force_n == pytest.approx(0.32, rel=1e-3)
    (curve,) = response_curves(points)
    upper, lower = curve.folds
    assert upper.frequency_hz == pytest.approx(fold_hz(upper, 0.32, -1.0), rel=2e-3)
    assert lower.frequency_hz == pytest.approx(fold_hz(lower, 0.32, 1.0), rel=2e-3)
    between = (curve.lag > upper.lag + 0.02) & (curve.lag < lower.lag - 0.02)
    outside = (curve.lag < upper.lag - 0.02) | (curve.lag > lower.lag + 0.02)
    assert np.all(curve.stable[between] == 0.0)
    assert between.sum() > 5
    assert np.all(curve.stable[outside] == 1.0)
    assert curve.tip is not None
    assert upper.lag > curve.tip.lag  # the tip is met first
    assert all(act.act is SteeringAct.CHANGE_LEVELS for act in acts)
    assert len(acts) == len(points) - 2
    again = extract_bag(bag).points
    assert all(one.identical(other) for one, other in zip(again, points, strict=True))
    write_results(points, tmp_path)
    (opened,) = nmt.open(tmp_path).response_curves
    assert np.array_equal(opened.lag, curve.lag)
    rows = (tmp_path / "response_curve.csv").read_text(encoding="utf-8").splitlines()
    assert len(rows) == len(points) + 1
    folds = (tmp_path / "response_folds.csv").read_text(encoding="utf-8").splitlines()
    assert [row.split(",")[2] for row in folds[1:]] == ["fold", "fold", "tip"]


def test_a_perturbed_drive_tells_the_floquet_exponents_on_both_sides_of_a_fold(tmp_path):
    result, _, bag = measure(tmp_path, [0.32], lag_deg=(75.0, 135.0), spacing=1.0, floquet=True, window_periods=25)
    balance = chain_of_one(16000.0, 0.02 * OMEGA, cubic(1.6e10), samples=128)
    force = np.zeros(balance.orders.size, complex)
    force[0] = 0.32
    signs = set()
    for point in result.points:
        lag = 0.5 * math.pi + point.phase_error
        motion = abs(point.shape_harmonics[1, 0]) * np.exp(-1j * lag)
        orbit = balance.at_lag(lag, force, point.omega_rad_s, motion)
        assert point.frequency_hz == pytest.approx(orbit.omega / (2.0 * math.pi), rel=1e-3)  # as without perturbation
        assert abs(motion) == pytest.approx(orbit.response, rel=3e-3)
        first, second = balance.exponents(orbit)[:2]
        for measured, std, expected in (
            (point.floquet_growth, point.floquet_growth_std, first.real),
            (point.floquet_second_growth, point.floquet_second_growth_std, second.real),
            (point.floquet_frequency, point.floquet_frequency_std, abs(first.imag)),
        ):
            assert measured == pytest.approx(expected, abs=max(0.1 * abs(first), 2.0 * std))
        assert point.floquet_growth_std < 0.15 * abs(first)
        signs.add(point.floquet_growth > 0.0)
    assert signs == {True, False}
    (curve,) = response_curves(result.points)
    assert np.array_equal(curve.floquet_stable, (curve.growth < 0.0).astype(float))
    again = extract_bag(bag).points
    assert all(one.identical(other) for one, other in zip(again, result.points, strict=True))


@pytest.mark.campaign
def test_with_a_shaker_and_friction_the_curve_goes_to_its_other_side(tmp_path):
    plan = plan_test(
        "beam", [0.3], test="response_curve", window_periods=10, ramp=0.3, lag_deg=(130.0, 155.0), spacing=0.6,
        timeout=20.0, harmonics_control="auto",
    )  # fmt: skip
    with Session(plan, tmp_path) as session:
        result = session.run()
    assert all(point.status is PointStatus.OK for point in result.points), [point.reason for point in result.points]
    beam = cantilever(
        7, 0.7, 0.00527668, 0.01156978, 185.0e9, 7830.0, 1.0e-4, 3, 2,
        lambda w, v: coulomb_force(w, 8000.0, 1.0), highest=7, samples=512,
    )  # fmt: skip
    force = np.zeros(beam.orders.size, complex)
    for point in result.points:
        lag, response = 0.5 * math.pi + point.phase_error, abs(point.shape_harmonics[1, 0])
        force[0] = point.force_n
        orbit = beam.at_lag(lag, force, point.omega_rad_s, response * np.exp(-1j * lag))
        assert point.frequency_hz == pytest.approx(orbit.omega / (2.0 * math.pi), rel=1e-3)
        assert response == pytest.approx(orbit.response, rel=2e-3)


def test_at_a_held_response_the_force_is_that_of_the_balance(tmp_path):
    result, _, _ = measure(
        tmp_path, [0.5e-3], lag_deg=(60.0, 120.0), spacing=0.5, control="response", window_periods=12
    )
    for point in result.points:
        found = at_lag(0.5 * math.pi + point.phase_error, point.force_n, point.frequency_hz, 0.5e-3)
        assert point.frequency_hz == pytest.approx(found.omega_b * OMEGA / (2.0 * math.pi), rel=1e-3)
        assert abs(found.series[0, 0]) * LENGTH == pytest.approx(0.5e-3, rel=4e-3)


def test_light_damping_does_not_ask_for_endless_patience():
    light = linear_description(load_rig("strong_cubic", ["structure.ground_dampers_ns_m=[0.01]"]))
    usual = linear_description(load_rig("strong_cubic"))
    asked = [curve_values(ResponseCurveTest(), linear, {}, ControlKind.FORCE) for linear in (light, usual)]
    assert asked[0]["amplitude_tolerance"] == CURVE.least_tolerance == 5e-5
    assert asked[1]["amplitude_tolerance"] == pytest.approx(CURVE.steadiness * 2.0 * math.pi * 10.0 * 0.01, rel=1e-3)
    assert asked[1]["cutoff"] == pytest.approx(CURVE.cutoff_share * OMEGA, rel=1e-3)


def test_dead_time_bounds_the_cut_off():
    linear = linear_description(load_rig("strong_cubic"))
    found = curve_values(ResponseCurveTest(), linear, {}, ControlKind.FORCE, 0.02, 3)
    assert found["cutoff"] == pytest.approx(0.15 * OMEGA, rel=1e-3)  # never below the usual one
    assert curve_values(ResponseCurveTest(), linear, {"cutoff": 5.0}, ControlKind.FORCE)["cutoff"] == 5.0
    assert "cutoff" not in curve_values(ResponseCurveTest(), linear, {}, ControlKind.RESPONSE)


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"lag_deg": (0.0, 160.0)}, "says too little of the frequency"),
        ({"lag_deg": (90.0, 90.0)}, "from one lag to another"),
        ({"lag_deg": (20.0,)}, "a first and a last lag"),
        ({"spacing": 5.0}, "spacing of points"),
        ({"perturbation": 0.5}, "perturbation of the drive must be from 0"),
        ({"floquet": True, "window_periods": 19}, "at least 20 periods, got 19"),
        ({"control": "voltage"}, "levels of force or response"),
        ({"frequencies_hz": (20.0,)}, "follows from its lag"),
        ({"refinement": 1e-3}, "A response curve test has no refinement"),
    ],
)
def test_what_a_response_curve_cannot_be_is_refused(settings, sentence):
    with pytest.raises(BenchError, match=sentence):
        plan_test("strong_cubic", [0.3], test="response_curve", **settings)
