"""Response curves of two neighbouring modes, whose lag turns back between the folds over the frequency, too."""

from __future__ import annotations

import math

import numpy as np
import pytest

from nmt_core.errors import BenchError
from nmt_core.vocabulary import CurveParameter, PointStatus
from nmt_extract.curves.response_curve import ResponseCurve, response_curves
from nmt_extract.offline import extract_bag
from nmt_laboratories.forced_balance import OneElement, cubic, of_modes
from nmt_rig.linear_description import linear_description
from nmt_rig.rig import load_rig
from nmt_session import Session, plan_test
from nmt_session.curve_loop import has_neighbour

FORCE = 1.1
NEIGHBOURS = (
    "structure.points=[1,2]",
    "structure.modes=[{frequency_hz: 20.0, damping_ratio: 0.01, shape: [1.0, 1.0]}, "
    "{frequency_hz: 21.2, damping_ratio: 0.01, shape: [0.2, 0.5]}]",
    "structure.damping_factors=[1.0, 1.0]",
    "local_elements=[{name: hardening, kind: cubic_spring, point: 1, stiffness_n_m3: 1.0e9}]",
    "sensors=[{quantity: force, point: drive}, {quantity: displacement, point: 1}, {quantity: displacement, point: 2}, "
    "{quantity: voltage}]",
    "extraction.linear_modes=2",
    "pll.guard_high=1.6",
)
BALANCE: OneElement = of_modes(
    2.0 * math.pi * np.array([20.0, 21.2]), [0.01, 0.01], [1.0, 0.2], [1.0, 0.5], cubic(1.0e9), highest=7, samples=64
)


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    """Points and bag of the curve from beyond its folds to the far side of its tip."""
    folder = tmp_path_factory.mktemp("neighbours")
    plan = plan_test(
        "internal_resonance", [FORCE], overrides=NEIGHBOURS, test="response_curve", lag_deg=(165.0, 120.0),
        window_periods=12, ramp=0.3, timeout=20.0, spacing=0.25,
    )  # fmt: skip
    with Session(plan, folder) as session:
        result = session.run()
    return result.points, folder / "bag"


def the_curve(points) -> ResponseCurve:
    (curve,) = response_curves(points)
    return curve


@pytest.mark.campaign
def test_a_curve_that_turns_back_over_the_lag_is_followed_to_its_end(measured):
    points, bag = measured
    assert all(point.status is PointStatus.OK for point in points), [point.reason for point in points]
    curve = the_curve(points)
    assert curve.missing == ()
    assert curve.turns_back
    backwards = np.diff(curve.lag) < 0.0
    assert 0 < backwards.sum() < backwards.size
    assert {CurveParameter(point.parameter) for point in points} == set(CurveParameter)
    for point, lag, response in zip(curve.points, curve.lag, curve.response, strict=True):
        orbit, force = BALANCE.at_motion(point.omega_rad_s, response, FORCE, lag)
        assert force == pytest.approx(point.force_n, rel=4e-3)
        assert lag == pytest.approx(-float(np.angle(orbit.drive[0])), abs=math.radians(0.8))
    again = extract_bag(bag).points
    assert all(one.identical(other) for one, other in zip(again, points, strict=True))


@pytest.mark.campaign
def test_its_stability_is_that_of_the_variational_equation(measured):
    curve = the_curve(measured[0])
    assert len(curve.folds) == 1
    unstable = curve.stable == 0.0
    assert np.any((np.diff(curve.lag) < 0.0) & unstable[1:] & unstable[:-1])  # it turns where the frequency does, too
    for point, lag, response, stable in zip(curve.points, curve.lag, curve.response, curve.stable, strict=True):
        orbit, _ = BALANCE.at_motion(point.omega_rad_s, response, FORCE, lag)
        growth = BALANCE.exponents(orbit, 200)[0].real
        assert math.isnan(stable) or (stable == 1.0) == (growth < 0.0)


@pytest.mark.parametrize(("frequency", "shape", "near"), [(21.2, 0.5, True), (45.0, 0.5, False), (21.2, 0.01, False)])
def test_a_neighbouring_mode_is_one_within_the_filter_at_the_drive_point(frequency, shape, near):
    modes = (
        "structure.modes=[{frequency_hz: 20.0, damping_ratio: 0.01, shape: [1.0, 1.0]}, "
        f"{{frequency_hz: {frequency}, damping_ratio: 0.01, shape: [0.2, {shape}]}}]"
    )
    linear = linear_description(load_rig("internal_resonance", [NEIGHBOURS[0], modes, *NEIGHBOURS[2:]]))
    assert has_neighbour(linear) is near


def test_what_a_curve_is_stepped_along_can_be_named():
    plan = plan_test("strong_cubic", [0.3], test="response_curve")
    assert not plan.asked.kind.follows_secant
    plan = plan_test("strong_cubic", [0.3], test="response_curve", along="secant")
    assert plan.asked.kind.follows_secant
    plan = plan_test("internal_resonance", [0.3], overrides=NEIGHBOURS, test="response_curve")
    assert plan.asked.kind.follows_secant
    with pytest.raises(BenchError, match="auto or lag or secant"):
        plan_test("strong_cubic", [0.3], test="response_curve", along="frequency")
