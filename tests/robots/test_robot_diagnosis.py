"""Planted friction is found, a held and a late command is named, a healthy log keeps silent."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from robots.simulated_joint import diagnosed_pendulum, log_columns, robot_file

from nmt_core.errors import BenchError

pytest.importorskip("mujoco", reason="mujoco is not installed: robots are not tested")

from nmt_robots.log.proposal import propose_sidecar
from nmt_robots.log_faults.finding import Finding
from nmt_robots.report.robot_files import write_robot_diagnosis
from nmt_robots.verdict.robot_diagnosis import RobotDiagnosis, diagnose_robot, no_claims_because

pytestmark = pytest.mark.usefixtures("module_undrawn")


def diagnosed(folder: Path, columns: dict[str, Any], **model: float) -> RobotDiagnosis:
    path = folder / "log.npz"
    np.savez(path, **columns)
    return diagnose_robot(robot_file(folder, **model), path)


def term(diagnosis: RobotDiagnosis, key: str) -> Any:
    return next(term for term in diagnosis.joints[0].terms if term.key == key)


def test_a_healthy_log_keeps_silent() -> None:
    diagnosis = diagnosed_pendulum()
    (joint,) = diagnosis.joints
    assert not joint.differs
    assert joint.cause == "as in the model"
    # A plain look: where the model leaves half of the torque, nothing being claimed is not being alike.
    strayed = replace(joint, unchanged=0.5 * joint.torque)
    assert strayed.cause == "not known"
    assert strayed.difference == "not known: the model leaves 50 % of the torque, no cause is claimed"
    # Where the fitted terms leave little, those that take the torque are listed, each once, and no others.
    shares = {"viscous": 0.4, "armature": 0.2}
    fitted = tuple(replace(term, share=shares.get(term.key, 0.0)) for term in joint.terms)
    listed = replace(strayed, terms=fitted).difference
    assert listed.startswith("open: ")
    assert listed.endswith("would take the 50 % of the torque that the model leaves, none for certain")
    assert "viscous friction" in listed
    assert "armature" in listed
    assert "Coulomb" not in listed
    assert (
        "0 of 1 joints differ from the model, cause named; 1 more, cause open."
        in replace(diagnosis, joints=(strayed,)).verdict
    )
    assert not [finding for finding in diagnosis.findings if finding.fault]
    assert joint.left < 0.05 * joint.torque


def test_planted_coulomb_friction_is_found() -> None:
    diagnosis = diagnosed_pendulum(coulomb=0.9)
    found = term(diagnosis, "coulomb")
    assert found.differs
    assert found.value == pytest.approx(0.9, rel=0.1)
    assert abs(found.value - 0.9) < 3.0 * found.std
    assert diagnosis.joints[0].cause == "Coulomb friction"
    (joint,) = diagnosis.joints
    assert joint.closed > 0.5
    # Friction that the file lacks is a square wave: what the model leaves is its rms.
    assert joint.unchanged == pytest.approx(0.9 - found.in_model, rel=0.15)
    assert (
        f"the model misses the computed torque by {joint.unchanged:.3g} N·m (rms over the joints) as given, by "
        f"{joint.left:.3g} N·m with the changes. No fault was found in the log." in diagnosis.verdict
    )


def test_planted_armature_is_found(tmp_path: Path) -> None:
    found = term(diagnosed(tmp_path, log_columns(armature=0.09)), "armature")
    assert found.differs
    assert found.value == pytest.approx(0.09, rel=0.1)


def test_a_command_held_over_rows_is_named(tmp_path: Path) -> None:
    diagnosis = diagnosed(tmp_path, log_columns(held=5))
    (finding,) = [finding for finding in diagnosis.findings if finding.key == "command_held"]
    assert finding.size == pytest.approx(5.0)
    assert "held" in {reading.command for reading in diagnosis.as_well}
    assert not diagnosis.joints[0].differs


def test_files_are_written_and_the_robot_has_what_was_found(tmp_path: Path) -> None:
    diagnosis = diagnosed_pendulum(coulomb=0.9)
    write_robot_diagnosis(diagnosis, tmp_path)
    text = (tmp_path / "robot.xml").read_text()
    assert f'frictionloss="{term(diagnosis, "coulomb").value:.5g}"' in text
    assert "(was 0.5) -->" in text
    assert "elbow,Coulomb friction," in (tmp_path / "joints.csv").read_text()
    assert 'id="log"' in (tmp_path / "report.html").read_text()


def test_the_control_law_in_a_column_is_no_torque(tmp_path: Path) -> None:
    columns = log_columns()
    columns["tau_des"] = columns["kp"] * (columns["des_pos"] - columns["pos"]) - columns["kd"] * columns["vel"]
    np.savez(tmp_path / "log.npz", **columns)
    text = propose_sidecar(tmp_path / "log.npz", robot_file(tmp_path), tmp_path).text
    assert "tau_des is the control law of the drives itself" in text


def test_missing_gains_and_unknown_joints_are_a_sentence(tmp_path: Path) -> None:
    columns = log_columns()
    del columns["kp"], columns["kd"]
    with pytest.raises(BenchError, match=r"gains.kp"):
        diagnosed(tmp_path, columns)
    path = tmp_path / "log.yaml"
    path.write_text("robot_log: 1\ndata: log.npz\njoints: [knee]\ntime: {column: time}\nposition: {column: pos}\n"
                    "command: {position: des_pos}\ngains: {kp: 60.0, kd: 1.5}\n")  # fmt: skip
    with pytest.raises(BenchError, match=r"no joint knee; its joints are elbow"):
        diagnose_robot(robot_file(tmp_path), path)


def test_a_joint_that_stands_still_is_a_sentence(tmp_path: Path) -> None:
    columns = log_columns()
    columns["pos"][:] = 0.3
    with pytest.raises(BenchError, match="no joint moves"):
        diagnosed(tmp_path, columns)


@pytest.mark.parametrize(
    ("key", "size", "stops"),
    [("clock_factor", 1.03, False), ("clock_factor", 0.95, True), ("clock_factor", 1.05, True), ("order", 1.0, True)],
)
def test_a_wrong_clock_or_order_leaves_nothing_to_be_claimed(key: str, size: float, stops: bool) -> None:
    """A factor within the tolerances of the bodies' torque stops nothing."""
    assert bool(no_claims_because([Finding(key, "", size, 0.001, "1")])) is stops
    assert no_claims_because([Finding(key, "", size, fault=False)]) == ""
