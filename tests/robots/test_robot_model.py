"""A robot's torque against the closed form of a pendulum, and files that are refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from robots.simulated_joint import rigid_torque, robot_file

from nmt_core.errors import BenchError

pytest.importorskip("mujoco", reason="mujoco is not installed: robots are not tested")

from nmt_robots.model.robot_model import RobotModel


def test_torque_is_that_of_a_pendulum_without_friction_and_armature(tmp_path: Path) -> None:
    model = RobotModel(robot_file(tmp_path))
    q, v, a = (np.array([[x], [y]]) for x, y in ((0.3, -1.0), (2.0, 0.5), (4.0, -7.0)))
    torque = model.torque(("elbow",), q, v, a)
    np.testing.assert_allclose(torque, rigid_torque(q, a), rtol=1e-9)


def test_what_the_file_says_of_its_drive_is_kept_aside(tmp_path: Path) -> None:
    (joint,) = RobotModel(robot_file(tmp_path, armature=0.05, damping=0.3, coulomb=0.7)).joints
    assert (joint.armature, joint.damping, joint.coulomb) == (0.05, 0.3, 0.7)
    assert (joint.lower, joint.upper, joint.effort) == (-3.0, 3.0, 40.0)


def test_an_urdf_file_is_a_robot_too(tmp_path: Path) -> None:
    path = tmp_path / "arm.urdf"
    path.write_text(
        '<robot name="arm"><link name="base"/><link name="link"><inertial><origin xyz="0 0 -0.5"/><mass value="2"/>'
        '<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial><visual><geometry>'
        '<mesh filename="package://arm/link.dae"/></geometry></visual></link><joint name="swing" type="revolute">'
        '<parent link="base"/><child link="link"/><axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="9" '
        'velocity="3"/><dynamics damping="0.3" friction="0.2"/></joint></robot>'
    )
    model = RobotModel(path)
    (joint,) = model.joints
    assert (joint.name, joint.damping, joint.coulomb, joint.effort) == ("swing", 0.3, 0.2, 9.0)
    still = np.zeros((1, 1))
    np.testing.assert_allclose(model.torque(("swing",), still + 0.5, still, still), 2 * 9.81 * 0.5 * np.sin(0.5))


def test_a_base_that_yields_takes_inertia_from_the_joint(tmp_path: Path) -> None:
    text = robot_file(tmp_path).read_text()
    text = text.replace('<body name="arm">', '<body name="base"><freejoint/><geom type="sphere" size="0.1" mass="3"/>'
                        '<body name="arm">').replace("</body>", "</body></body>", 1)  # fmt: skip
    path = tmp_path / "floating.xml"
    path.write_text(text)
    model = RobotModel(path)
    assert model.floating
    assert model.names == ("elbow",)
    still, fast = np.zeros((1, 1)), np.ones((1, 1))
    held = model.torque(("elbow",), still, still, fast)[0, 0]
    free = model.torque(("elbow",), still, still, fast, yielding=True)[0, 0]
    assert 0.0 < free < 0.8 * held
    # At rest it carries its weight all the same.
    np.testing.assert_allclose(
        model.torque(("elbow",), fast, still, still), model.torque(("elbow",), fast, still, still, yielding=True)
    )


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("<rig/>", "neither MJCF nor URDF"),
        ('<mujoco><worldbody><body><joint type="ball"/><geom size="1"/></body></worldbody></mujoco>', "not a hinge"),
        ("<mujoco><worldbody/></mujoco>", "no joint"),
        ("<mujoco><worldbody><body></worldbody></mujoco>", "cannot be read as a robot"),
    ],
)
def test_what_is_no_robot_is_refused(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "robot.xml"
    path.write_text(text)
    with pytest.raises(BenchError, match=words):
        RobotModel(path)


@pytest.mark.parametrize(
    ("constraint", "words"),
    [
        ('<connect body1="arm" anchor="0 0 0"/>', "closes a loop"),
        ('<weld body1="arm"/>', "closes a loop"),
        ('<joint joint1="elbow"/>', "couples joint elbow to a constant"),
        ('<joint joint1="knee" joint2="elbow"/>', "names joint 'knee', which is not in the file"),
    ],
)
def test_loops_are_refused_without_the_advice_to_open_them(tmp_path: Path, constraint: str, words: str) -> None:
    text = robot_file(tmp_path).read_text()
    path = tmp_path / "loop.xml"
    path.write_text(text.replace("</mujoco>", f"<equality>{constraint}</equality></mujoco>"))
    with pytest.raises(BenchError, match=words) as refusal:
        RobotModel(path).chosen(("elbow",))
    assert "take the constraint" not in str(refusal.value)
