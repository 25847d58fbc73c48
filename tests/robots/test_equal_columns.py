"""Causes that no log of a kind parts bear one name: in the verdict, on the page, in tables and in the robot's file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from robots.simulated_joint import log_columns, robot_file
from tiers import with_quick

pytest.importorskip("mujoco", reason="mujoco is not installed: robots are not tested")

from nmt_robots.log_faults.drive import computed_by_law
from nmt_robots.mechanics import ladder
from nmt_robots.mechanics.ladder import JointProblem
from nmt_robots.mechanics.motion import Motion, motion_of
from nmt_robots.mechanics.readings import DriveSignals
from nmt_robots.model.robot_model import RobotModel
from nmt_robots.report.robot_files import write_robot_diagnosis
from nmt_robots.thresholds import THRESHOLDS
from nmt_robots.verdict.robot_diagnosis import RobotDiagnosis, diagnose_robot, read_log

pytestmark = pytest.mark.usefixtures("module_undrawn")

SIDECAR = """robot_log: 1
data: log.npz
joints: [elbow]
time: {column: time}
position: {column: pos}
velocity: {column: vel}
command: {position: des_pos}
"""
GAINS, TORQUE = "gains: {kp: 60.0, kd: 1.5}\n", "torque: {column: tau}\n"
BOTH = "viscous friction or velocity gain of the drive"


def written(folder: Path, sidecar: str, law: float = 1e-3, **joint: float) -> tuple[Path, Path]:
    """A robot and the sidecar of a log whose torque is the control law of the drive within a share."""
    columns: dict[str, Any] = log_columns(**joint)
    torque = 60.0 * (columns["des_pos"] - columns["pos"]) - 1.5 * columns["vel"]
    rng = np.random.default_rng(1)
    columns["tau"] = torque * (1.0 + law * rng.standard_normal(torque.shape))
    np.savez(folder / "log.npz", **columns)
    (folder / "log.yaml").write_text(SIDECAR + sidecar)
    return robot_file(folder), folder / "log.yaml"


def diagnosed(folder: Path, sidecar: str, law: float = 1e-3, **joint: float) -> RobotDiagnosis:
    return diagnose_robot(*written(folder, sidecar, law, **joint))


@pytest.fixture(scope="module")
def motion(tmp_path_factory: pytest.TempPathFactory) -> Motion:
    model, sidecar = written(tmp_path_factory.mktemp("motion"), GAINS)
    return motion_of(RobotModel(model), read_log(sidecar, model))


@pytest.mark.parametrize(
    "sidecar", with_quick([GAINS, TORQUE], TORQUE), ids=["stated to be computed", "found to be computed"]
)
def test_damping_is_one_class_with_the_gain_that_makes_the_same_torque(tmp_path: Path, sidecar: str) -> None:
    diagnosis = diagnosed(tmp_path, sidecar, damping=0.9)
    assert diagnosis.log.is_arithmetic
    assert ("torque_is_law" in {finding.key for finding in diagnosis.findings}) is (sidecar == TORQUE)
    assert diagnosis.joints[0].cause == BOTH
    write_robot_diagnosis(diagnosis, tmp_path)
    assert f",{BOTH}," in (tmp_path / "joints.csv").read_text().replace("elbow", "")
    assert "velocity gain of the drive,yes" in (tmp_path / "changes.csv").read_text()
    assert "(was 0.2; or velocity gain of the drive) -->" in (tmp_path / "robot.xml").read_text()
    page = (tmp_path / "report.html").read_text()
    assert BOTH in page
    assert "velocity gain or viscous friction" in page


@pytest.mark.parametrize(
    "sidecar", with_quick([GAINS, TORQUE], GAINS), ids=["stated to be computed", "found to be computed"]
)
def test_armature_and_inertia_of_a_single_link_are_one_class(tmp_path: Path, sidecar: str) -> None:
    (joint,) = diagnosed(tmp_path, sidecar, armature=0.09).joints
    assert joint.cause == "armature or inertia of its links"


def test_a_torque_that_was_measured_leaves_damping_alone(tmp_path: Path) -> None:
    diagnosis = diagnosed(tmp_path, TORQUE, law=0.03, damping=0.9)
    assert not diagnosis.log.is_arithmetic
    assert diagnosis.joints[0].cause == "viscous friction"


def test_efficiency_and_friction_by_load_are_one_effect(motion: Motion) -> None:
    problem = JointProblem(motion, 0, DriveSignals(np.ones(len(motion.q))))
    (effect,) = [effect for effect in problem.library if effect.key == "load_friction"]
    assert effect.words == "friction by load or efficiency"


def test_a_commanded_speed_parts_gain_and_damping(motion: Motion) -> None:
    """Beside a commanded speed the gain is a rival of its own; its column's angle to the joint's speed decides."""
    torque = np.random.default_rng(2).standard_normal(len(motion.q))
    for share, apart in ((0.0, False), (2.0, True)):
        speed_error = share * np.roll(motion.v[:, 0], 400) - motion.v[:, 0]
        problem = JointProblem(motion, 0, DriveSignals(torque, torque, speed_error))
        assert ("kd" in {rival.shape for rival in problem.rivals}) is apart


@pytest.mark.parametrize("limit", ["alike", "equal"])
def test_columns_are_named_together_above_their_cosine(
    motion: Motion, monkeypatch: pytest.MonkeyPatch, limit: str
) -> None:
    problem = JointProblem(motion, 0, DriveSignals(np.ones(len(motion.q))))
    coulomb = problem.usual[0]
    monkeypatch.setattr(ladder, "THRESHOLDS", replace(THRESHOLDS, alike=0.0, equal=0.0))
    cosines = ladder._alike(problem, problem.usual, coulomb)
    words = "friction that grows with the root of speed"
    assert 0.5 < cosines[words] < 0.999
    for change, together in ((-1e-3, True), (1e-3, False)):
        limits = {"alike": 0.0, "equal": 0.0, limit: cosines[words] + change}
        monkeypatch.setattr(ladder, "THRESHOLDS", replace(THRESHOLDS, **limits))
        share = ladder._shares(problem, problem.usual, problem.fit(problem.usual), named=True)[0]
        assert (words in getattr(share, limit)) is together
    assert (THRESHOLDS.alike, THRESHOLDS.equal) == (0.95, 0.99)


@pytest.mark.parametrize(("share", "computed"), [(0.85, True), (1.15, False)])
def test_a_torque_is_the_law_below_its_limit(tmp_path: Path, share: float, computed: bool) -> None:
    model, sidecar = written(tmp_path, TORQUE, law=0.0)
    log = read_log(sidecar, model)
    assert log.torque is not None
    wave = np.sqrt(2.0) * np.sin(700.0 * log.time)[:, None]
    torque = log.torque + share * THRESHOLDS.exact * float(np.std(log.torque)) * wave
    changed, _ = computed_by_law(replace(log, torque=torque), RobotModel(model).joints)
    assert changed.is_arithmetic is computed
    if computed:
        assert changed.position_gain == pytest.approx([60.0], rel=1e-3)
        assert changed.velocity_gain == pytest.approx([1.5], rel=1e-2)
