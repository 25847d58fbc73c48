"""What to move next: chosen by what is left open, inside the ranges of the joints, readable as files."""

from __future__ import annotations

import csv
import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from robots.simulated_joint import diagnosed_pendulum

pytest.importorskip("mujoco", reason="mujoco is not installed: robots are not tested")

from nmt_robots.report.robot_files import joint_trajectory, trajectory_csv
from nmt_robots.verdict.joint_verdict import JointTerm, unjudged
from nmt_robots.verdict.next_motion import STEP_S, NextMotion, next_motion
from nmt_robots.verdict.robot_diagnosis import RobotDiagnosis

pytestmark = pytest.mark.usefixtures("module_undrawn")


@pytest.fixture
def diagnosis() -> RobotDiagnosis:
    return diagnosed_pendulum()


def following(diagnosis: RobotDiagnosis, **changes: object) -> NextMotion:
    (verdict,) = diagnosis.joints
    joint = replace(verdict.joint, lower=-1.0, upper=1.2)
    changed = replace(verdict, **changes)
    return next_motion(diagnosis.motion, [joint], [changed], [diagnosis.reading])


def test_where_nothing_is_open_another_kind_of_motion_tests_the_answer(diagnosis: RobotDiagnosis) -> None:
    (request,) = following(diagnosis).requests
    assert request.kind == "triangle"
    assert "nothing is left open" in request.sentence


def test_a_joint_that_stood_still_is_moved(diagnosis: RobotDiagnosis) -> None:
    (verdict,) = diagnosis.joints
    still = unjudged(verdict.joint, 1.0)
    (request, *_) = next_motion(diagnosis.motion, [verdict.joint], [still], [diagnosis.reading]).requests
    assert (request.kind, request.why) == ("triangle", "it did not move enough")


def test_a_transmission_asks_for_reversals_and_two_amplitudes(diagnosis: RobotDiagnosis) -> None:
    term = JointTerm("backlash", "backlash", "rad", 0.02, 0.002, 0.0, 0.3, True)
    assert [request.kind for request in following(diagnosis, terms=(term,)).requests] == ["reversals", "chirp"]


def test_a_class_of_scale_and_mass_asks_for_poses(diagnosis: RobotDiagnosis) -> None:
    (verdict,) = diagnosis.joints
    found = next_motion(diagnosis.motion, [verdict.joint], [verdict], [diagnosis.reading], ["elbow"])
    assert found.requests[0].kind == "poses"


def test_readings_with_other_delays_ask_for_a_chirp(diagnosis: RobotDiagnosis) -> None:
    (verdict,) = diagnosis.joints
    late = replace(diagnosis.reading, torque_lag_s=0.004)
    found = next_motion(diagnosis.motion, [verdict.joint], [verdict], [diagnosis.reading, late])
    assert [request.kind for request in found.requests] == ["chirp"]


@pytest.mark.parametrize("kind", ["elastic", "not known"])
def test_all_stays_inside_the_range_and_the_speeds_of_the_log(diagnosis: RobotDiagnosis, kind: str) -> None:
    term = JointTerm(kind, kind, "", 50.0, 1.0, 0.0, 0.3, kind == "elastic")
    found = following(diagnosis, terms=(term,), unchanged=9.0)
    assert np.all((found.position > -1.0) & (found.position < 1.2))
    speed = np.gradient(found.position[:, 0], STEP_S)
    assert np.max(np.abs(speed)) < 1.2 * np.quantile(np.abs(diagnosis.motion.v), 0.99)
    # Parts begin and end in the same pose.
    starts = found.position[np.flatnonzero(np.diff(found.part, prepend=-1))]
    np.testing.assert_allclose(starts, np.broadcast_to(starts[0], starts.shape), atol=1e-6)


def test_a_slow_triangle_tells_friction_better(diagnosis: RobotDiagnosis) -> None:
    (request,) = following(diagnosis, unchanged=9.0).requests
    assert request.kind == "triangle"
    assert np.isfinite(request.gain)


def test_joints_in_phase_are_moved_apart(diagnosis: RobotDiagnosis) -> None:
    motion = diagnosis.motion
    twice = {
        name: np.repeat(getattr(motion, name), 2, axis=1) for name in ("q", "v", "a", "rigid", "gravity", "moving")
    }
    (verdict,) = diagnosis.joints
    joints = [replace(verdict.joint, name=name) for name in ("hip", "knee")]
    verdicts = [replace(verdict, joint=joint) for joint in joints]
    found = next_motion(replace(motion, **twice), joints, verdicts, [diagnosis.reading])
    assert [(request.kind, request.joints) for request in found.requests] == [("out_of_phase", ("hip", "knee"))]
    moved = found.position - found.position[0]
    assert abs(np.corrcoef(moved.T)[0, 1]) < 0.5


def test_files_hold_the_same_points(diagnosis: RobotDiagnosis) -> None:
    rows = list(csv.DictReader(io.StringIO(trajectory_csv(diagnosis.next))))
    message = yaml.safe_load(joint_trajectory(diagnosis.next))
    assert message["joint_names"] == ["elbow"]
    assert len(rows) == len(message["points"]) == len(diagnosis.next.time)
    assert float(rows[7]["elbow"]) == message["points"][7]["positions"][0]
    assert message["points"][7]["time_from_start"] == {"sec": 3, "nanosec": 70_000_000}


def test_they_are_written(tmp_path: Path, diagnosis: RobotDiagnosis) -> None:
    from nmt_robots.report.robot_files import write_robot_diagnosis

    write_robot_diagnosis(diagnosis, tmp_path)
    assert (tmp_path / "trajectory.csv").is_file()
    assert "What to move next" in (tmp_path / "report.html").read_text()
