"""Control of the force's harmonics in whole tests of the beam, against EPMC and against the same test without it."""

from __future__ import annotations

import cmath
import json
import math
from pathlib import Path

import numpy as np
import pytest
from tiers import with_quick

from nmt_core.errors import BenchError
from nmt_core.messages.records import DriveCommand, LoopStatus
from nmt_core.vocabulary import PointStatus
from nmt_rig.reference import compute_reference
from nmt_session import Session, plan_nodes, plan_test

ONSET = (0.2, 0.3308, 0.7)  # V at point 2: sticking, onset of slip, slipping


def run(levels=ONSET, **settings):
    """Points of a test, its drive commands and the reasons that the loop gave."""
    drives, reasons = [], []

    def listen(topic, record):
        if isinstance(record, DriveCommand):
            drives.append(record)
        elif isinstance(record, LoopStatus) and record.reason:
            reasons.append(record.reason)

    plan = plan_test("beam", levels, window_periods=20, **settings)
    with Session(plan, record=False, listener=listen) as session:
        result = session.run()
    return plan, result, drives, reasons


def errors(plan, points):
    """Relative errors of frequency and damping against EPMC."""
    amplitudes = np.array([point.modal_amplitude for point in points])
    order = np.argsort(amplitudes)
    reference = compute_reference(plan.rig, 15, amplitudes[order])
    omega, damping = np.empty(order.size), np.empty(order.size)
    omega[order], damping[order] = reference.omega_rad_s, reference.damping_ratio
    return (
        np.array([point.omega_rad_s for point in points]) / omega - 1.0,
        np.array([point.damping_ratio for point in points]) / damping - 1.0,
    )


def harmonics(point):
    size = np.abs(point.force_harmonics)
    return size[2:] / size[1]


def test_harmonics_vanish_and_with_them_the_error_of_damping():
    plan, result, drives, reasons = run(harmonics_control=9)
    assert all(point.status is PointStatus.OK for point in result.points)
    assert max(harmonics(point).max() for point in result.points) < 0.005
    frequency, damping = errors(plan, result.points)
    assert np.abs(damping).max() < 0.005
    assert np.abs(frequency).max() < 6e-4
    assert any("force harmonics up to 9 within" in reason for reason in reasons)
    assert all(len(drive.terms) == 8 for drive in drives if drive.amplitude > 0)
    assert drives[-1].terms == ()

    plain_plan, plain, plain_drives, _ = run()
    assert harmonics(plain.points[1]).max() > 0.04
    assert errors(plain_plan, plain.points)[1][1] < -0.04
    assert all(drive.terms == () for drive in plain_drives)
    periods = 40 * len(ONSET) / 22.2
    assert result.bench_time < plain.bench_time + periods


def test_levels_for_comparison_are_without_control():
    plan, result, drives, _ = run((0.3308, 0.7), harmonics_control="auto", compare=2)
    assert plan.asked.levels == (0.3308, 0.3308, 0.7)
    assert plan.asked.levels_without == {0}
    assert plan.asked.goal["levels_without"] == [0]
    without, controlled, last = result.points
    assert harmonics(without).max() > 0.04
    assert harmonics(controlled).max() < 0.005
    assert harmonics(last).max() < 0.005
    assert controlled.damping_ratio > 1.02 * without.damping_ratio
    assert any(drive.amplitude > 0 and not any(abs(term.value) for term in drive.terms) for drive in drives)


def test_the_modal_target_gives_harmonics_the_power_that_the_mode_needs():
    plan, result, _, _ = run(harmonics_control=9, harmonics_target="modal", overrides=["extraction.linear_modes=3"])
    assert all(point.status is PointStatus.OK for point in result.points)
    frequency, damping = errors(plan, result.points)
    assert np.abs(damping).max() < 0.003
    assert np.abs(frequency).max() < 6e-4
    slipping = result.points[2]
    linear = plan.used_linear
    order = np.arange(1, slipping.harmonics + 1)
    motion = slipping.shape_harmonics[1:]
    modal = np.abs(motion @ np.linalg.pinv(linear.shape_matrix).T) ** 2
    velocity = 1j * order * motion[:, slipping.points.index(2)]
    power = (slipping.force_harmonics[1:] * velocity.conj()).real
    needed = order**2 * modal.sum(axis=1)
    for n in (3, 5):  # a harmonic counts as settled within 0.3 % of the fundamental, and these have 0.7 and 0.4 %
        assert power[n - 1] / power[0] == pytest.approx(needed[n - 1] / needed[0], rel=0.15)


def table(factor: complex) -> str:
    """Force per volt of the beam's model, times a factor, as the loop gets it."""
    plan = plan_nodes(plan_test("beam", [0.1], harmonics_control=9), Path("bag"), Path("rig.yaml"))
    rows = json.loads(plan.pll.force_per_volt_json)
    turned = [(frequency, complex(real, imag) * factor) for frequency, real, imag in rows]
    return json.dumps([[frequency, value.real, value.imag] for frequency, value in turned])


TURNED = cmath.rect(1.0, math.radians(-150))


@pytest.mark.parametrize(
    "factor", with_quick([cmath.rect(1.0, math.radians(60)), TURNED, 2.0, None], TURNED, None), ids=str
)
def test_a_force_per_volt_that_is_wrong_or_not_known_makes_no_difference_in_the_end(factor):
    known = "" if factor is None else table(factor)
    plan, result, drives, reasons = run(harmonics_control=9, node_values={"pll": {"force_per_volt_json": known}})
    assert all(point.status is PointStatus.OK for point in result.points)
    assert max(harmonics(point).max() for point in result.points) < 0.005
    assert np.abs(errors(plan, result.points)[1]).max() < 0.005
    assert not any("given up" in reason for reason in reasons)
    if factor is None:  # one harmonic at a time, 2 % of the drive
        first = [drive.terms for drive in drives if any(abs(term.value) for term in drive.terms)][:50]
        assert all(sum(abs(term.value) > 0 for term in terms) == 1 for terms in first)
        assert max(abs(term.value) for terms in first for term in terms) == pytest.approx(0.02 * ONSET[0])


@pytest.mark.parametrize("limit", with_quick([1.505, 1.56], 1.505))
def test_at_the_voltage_limit_harmonics_are_given_up_by_name_and_the_level_goes_on(limit):
    _, result, drives, reasons = run((0.3308, 1.5), harmonics_control=9, overrides=[f"limits.voltage_v={limit}"])
    assert [point.status for point in result.points] == [PointStatus.OK] * 2
    assert max(drive.amplitude + sum(abs(term.value) for term in drive.terms) for drive in drives) <= limit
    assert any("harmonic 3 given up: it would need more than" in reason for reason in reasons)
    assert not any(remark.startswith("Plant") for remark in result.remarks)


def test_the_slew_limit_bounds_the_sum():
    slew = 1.5 * 2 * math.pi * 22.2 * 1.12  # the beam's frequency is at most that of sticking
    _, result, drives, _ = run((0.3308, 1.5), harmonics_control=9, overrides=[f"limits.slew_v_s={slew}"])
    assert [point.status for point in result.points] == [PointStatus.OK] * 2
    assert not any(remark.startswith("Plant") for remark in result.remarks)
    assert any(abs(term.value) > 0 for drive in drives for term in drive.terms)


def test_a_dead_force_cell_ends_the_level_with_the_drive_at_zero():
    _, result, drives, reasons = run((0.3308,), harmonics_control=9, overrides=["sensors.0.gain=1e-9"])
    assert result.points[0].status is PointStatus.NOT_LOCKED
    assert any("floor" in reason for reason in reasons)
    assert drives[-1].amplitude == 0.0
    assert all(abs(term.value) == 0 for drive in drives for term in drive.terms)


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"harmonics_control": 1000}, "must be from 2 to 50"),
        ({"harmonics_control": -2}, "must be from 2 to 50"),
        ({"harmonics_control": "many"}, "is not a number"),
        ({"harmonics_control": 5, "harmonics_target": "velocity"}, "target 'velocity' is not known"),
        (
            {"harmonics_control": 5, "harmonics_target": "modal"},
            "needs a linear description of 3 modes, this one has 2",
        ),
        ({"compare": 2}, "needs control of the force's harmonics"),
        ({"harmonics_control": 5, "compare": -1}, "is not possible"),
        (
            {"harmonics_control": 5, "test": "random", "band_hz": (5.0, 50.0), "duration": 1.0},
            "has no harmonics_control",
        ),
    ],
)
def test_what_cannot_be_done_is_refused_with_a_sentence(settings, sentence):
    with pytest.raises(BenchError, match=sentence):
        Session(plan_test("beam", [0.1], **settings))


def test_a_rig_file_may_ask_for_it():
    plan = plan_test("beam", [0.1], overrides=["test.harmonics_control=auto"])
    assert plan.kind.controlled_harmonics == 1
    assert plan_test("beam", [0.1], overrides=["test.harmonics_control=7"]).kind.controlled_harmonics == 7
    off = plan_test("beam", [0.1], overrides=["test.harmonics_control=7"], harmonics_control=0)
    assert off.kind.controlled_harmonics == 0
    # Kinds of test that cannot do it go on without.
    plan_test("beam", [0.1], overrides=["test.harmonics_control=7"], test="random", band_hz=(5.0, 50.0), duration=1.0)
