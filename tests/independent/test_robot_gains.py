"""Logs of one joint under several gains agree where they name one cause and its sizes lie within their ±."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("mujoco", reason="mujoco is not installed: robots are not tested")

from nmt_laboratories.robot_gains import compared, make_logs
from nmt_robots.verdict.joint_verdict import JointTerm
from nmt_robots.verdict.robot_diagnosis import diagnose_robot


def named(key: str, value: float) -> JointTerm:
    return JointTerm(key, key, "N·m", value, 0.03, 0.0, 0.2, True)


def test_sizes_of_one_cause_are_compared_in_pairs() -> None:
    same, differences = compared([named("coulomb", 0.8), named("coulomb", 0.9), named("coulomb", 0.8)])
    assert same
    assert differences == pytest.approx([-0.1 / (0.03 * 2**0.5), 0.0, 0.1 / (0.03 * 2**0.5)])


def test_silence_and_another_cause_are_not_the_same() -> None:
    assert compared([named("coulomb", 0.8), None, named("coulomb", 0.8)]) == (False, pytest.approx([0.0]))
    assert compared([named("coulomb", 0.8), named("spring", 0.8)]) == (False, [])


@pytest.mark.campaign
def test_a_spring_is_named_whatever_the_lag_of_the_log(tmp_path: Path) -> None:
    """Half the gains, motion 20 ms late: a changed gain of the drive would take the lag's torque, and the spring."""
    case = make_logs(tmp_path, 12, 0.03)[0]
    (joint,) = diagnose_robot(case / "robot.xml", case / "log.yaml").joints
    (spring,) = [term for term in joint.terms if term.differs]
    assert spring.key == "spring"
    assert abs(spring.value - 4.0) < 2.0 * spring.std
