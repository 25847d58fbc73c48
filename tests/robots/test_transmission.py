"""A pendulum behind a spring or a gap, simulated here with a motor of its own: named with its size, and only there."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from robots.simulated_joint import GRAVITY, INERTIA, LENGTH, MASS, log_columns, robot_file
from tiers import with_quick

pytest.importorskip("mujoco", reason="mujoco is not installed: robots are not tested")

from nmt_robots.log_faults.finding import Finding
from nmt_robots.verdict import robot_diagnosis, transmission_verdict
from nmt_robots.verdict.robot_diagnosis import RobotDiagnosis, diagnose_robot

ARMATURE, DAMPING, COULOMB = 0.03, 0.2, 0.5


@cache
def log_behind(stiffness: float, gap: float, damper: float) -> dict[str, Any]:
    """A log of 24 s at 500 Hz of the motor; its drive runs at the same rate, the bodies at 8 kHz."""
    fine, rate = 16, 500
    step, rows = 1.0 / (rate * fine), 24 * rate
    time = np.arange(rows) / rate
    phase = 2.0 * np.pi * (0.2 * time + 0.08 * time**2)
    command = 0.5 * np.sin(phase) + 0.3 * np.sin(0.23 * phase + 1.0)
    kp, kd = 60.0, 1.5
    inertia = INERTIA + MASS * LENGTH**2
    q, v = np.empty(rows), np.empty(rows)
    commanded = command.tolist()
    motor = link = commanded[0]
    motor_speed = link_speed = 0.0
    for row in range(rows):
        q[row], v[row] = motor, motor_speed
        torque = kp * (commanded[row] - motor) - kd * motor_speed
        for _ in range(fine):
            twist = motor - link
            beyond = twist - min(max(twist, -0.5 * gap), 0.5 * gap)
            passed = stiffness * beyond + (damper * (motor_speed - link_speed) if beyond or not gap else 0.0)
            link_speed += step * (passed - MASS * GRAVITY * LENGTH * math.sin(link)) / inertia
            link += step * link_speed
            free = motor_speed + step * (torque - passed - DAMPING * motor_speed) / ARMATURE
            slowed = step * COULOMB / ARMATURE
            motor_speed = math.copysign(max(abs(free) - slowed, 0.0), free)
            motor += step * motor_speed
    q = q + 1e-5 * np.random.default_rng(7).standard_normal(rows)
    return {
        "time": time, "pos": q[:, None], "vel": v[:, None], "des_pos": command[:, None],
        "kp": np.array([kp]), "kd": np.array([kd]),
    }  # fmt: skip


def diagnosed(folder: Path, columns: dict[str, Any]) -> RobotDiagnosis:
    np.savez(folder / "log.npz", **columns)
    return diagnose_robot(robot_file(folder, ARMATURE, DAMPING, COULOMB), folder / "log.npz")


def test_a_transmission_that_gives_way_is_named_with_its_stiffness(tmp_path: Path) -> None:
    (joint,) = diagnosed(tmp_path, log_behind(70.0, 0.0, 0.2)).joints
    assert joint.terms[0].key == "elastic"
    assert joint.terms[0].differs
    assert joint.terms[0].value == pytest.approx(70.0, rel=0.2)
    assert abs(joint.terms[0].value - 70.0) < 3.0 * joint.terms[0].std
    assert joint.left < 0.5 * joint.plain
    assert joint.cause == "elastic transmission, stiffness"


def test_backlash_is_named_with_its_gap(tmp_path: Path) -> None:
    (joint,) = diagnosed(tmp_path, log_behind(2000.0, 0.03, 2.0)).joints
    assert joint.terms[0].key == "backlash"
    assert joint.terms[0].value == pytest.approx(0.03, rel=0.2)


def test_a_rigid_joint_has_none_whatever_its_friction(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    every = replace(transmission_verdict.THRESHOLDS, may_give_way=0.0)
    monkeypatch.setattr(transmission_verdict, "THRESHOLDS", every)
    (joint,) = diagnosed(tmp_path, log_columns(coulomb=0.9)).joints
    assert joint.cause == "Coulomb friction"


@pytest.mark.parametrize("limits", with_quick([{"gives_way": 0.02}, {"may_give_way": 0.9}], {"gives_way": 0.02}))
def test_what_is_not_looked_into_is_not_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, limits: dict[str, float]
) -> None:
    monkeypatch.setattr(transmission_verdict, "THRESHOLDS", replace(transmission_verdict.THRESHOLDS, **limits))
    (joint,) = diagnosed(tmp_path, log_behind(70.0, 0.0, 0.2)).joints
    assert joint.cause != "elastic transmission, stiffness"


def test_nothing_is_named_beside_a_clock_that_is_off(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    late = Finding("torque_lag", "The torque is late.", 0.008, 0.001, "s", 0.5)
    monkeypatch.setattr(robot_diagnosis, "reading_findings", lambda *_, **__: [late])
    monkeypatch.setattr(robot_diagnosis, "_understood", _plain_reading(robot_diagnosis._understood))
    (joint,) = diagnosed(tmp_path, log_behind(70.0, 0.0, 0.2)).joints
    assert not joint.differs
    assert "is not reported with the log's fault" in joint.remains


def _plain_reading(understood: Any) -> Any:
    """The same with the best reading first, so that findings on it are taken."""

    def changed(motion: Any, drive: Any, scores: Any, *more: Any) -> Any:
        readings, results = understood(motion, drive, scores, *more)
        return [scores.best, *readings], results

    return changed
