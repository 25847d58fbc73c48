"""Turns, degrees, repeated and missing rows, order and sign of columns: named, and mended where that can be."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from robots.simulated_joint import log_columns, robot_file

pytest.importorskip("mujoco", reason="mujoco is not installed: robots are not tested")

from nmt_robots.log.joint_log import JointLog
from nmt_robots.log_faults.assignment import assignment_findings
from nmt_robots.log_faults.repair import (
    alternation,
    in_radians,
    on_even_clock,
    stale_rows,
    steps_by_motion,
    time_by_motion,
    time_with_missing_rows,
    unwrapped,
    with_fresh_rows,
)
from nmt_robots.mechanics.motion import motion_of
from nmt_robots.model.robot_model import RobotModel
from nmt_robots.verdict.robot_diagnosis import diagnose_robot

CHAIN = """<mujoco><compiler angle="radian"/><worldbody><body><inertial pos="0 0 -0.15" mass="2"
 diaginertia="0.02 0.02 0.005"/><joint name="shoulder" axis="0 1 0" range="-3 3"/><body pos="0 0 -0.3"><inertial
 pos="0 0 -0.1" mass="0.8" diaginertia="0.005 0.005 0.001"/><joint name="elbow" axis="0 1 0" range="-3 3"/>
 </body></body></worldbody></mujoco>"""


def chain(folder: Path) -> RobotModel:
    path = folder / "chain.xml"
    path.write_text(CHAIN)
    return RobotModel(path)


def motion_log(time: Any, centre: float = 0.0) -> JointLog:
    """Two joints in motion in closed form."""
    rates = 2.0 * np.pi * np.array([0.9, 1.7])
    phase = time[:, None] * rates
    q = centre + 0.5 * np.sin(phase) + 0.2 * np.sin(0.3 * phase)
    v = 0.5 * rates * np.cos(phase) + 0.06 * rates * np.cos(0.3 * phase)
    step = 2.0 * np.pi / 2**16
    return JointLog("log", ("shoulder", "elbow"), time, np.round(q / step) * step, v, q)


def even(rows: int = 4000) -> Any:
    return 0.002 * np.arange(rows)


def test_turns_are_joined_within_the_range_of_the_joint(tmp_path: Path) -> None:
    joints = tuple(replace(joint, lower=0.0, upper=6.0) for joint in chain(tmp_path).joints)
    log = motion_log(even(), centre=np.pi)
    wrapped = replace(log, position=(log.position + np.pi) % (2 * np.pi) - np.pi)
    mended, (finding,) = unwrapped(wrapped, joints)
    assert finding.key == "wrap"
    np.testing.assert_allclose(mended.position, log.position, atol=1e-9)
    np.testing.assert_allclose(mended.position_command, log.position_command, atol=1e-9)
    assert unwrapped(log, joints) == (log, [])


def test_degrees_are_told_by_the_ranges_of_the_joints(tmp_path: Path) -> None:
    joints = chain(tmp_path).joints
    log = motion_log(even())
    assert log.velocity is not None
    degrees = replace(log, position=np.degrees(log.position), velocity=np.degrees(log.velocity))
    mended, (finding,) = in_radians(degrees, joints)
    assert finding.key == "degrees"
    np.testing.assert_allclose(mended.position, log.position)
    np.testing.assert_allclose(mended.velocity, log.velocity)
    # A speed that was in rad/s stays.
    mended, _ = in_radians(replace(degrees, velocity=log.velocity), joints)
    np.testing.assert_allclose(mended.velocity, log.velocity)
    assert in_radians(log, joints) == (log, [])


def test_repeated_rows_are_filled_in() -> None:
    log = motion_log(even())
    assert log.velocity is not None
    position, velocity = log.position.copy(), log.velocity.copy()
    again = np.arange(50, 3900, 13)
    position[again], velocity[again] = position[again - 1], velocity[again - 1]
    repeated = replace(log, position=position, velocity=velocity)
    moving = np.abs(velocity) > 0.1
    stale = stale_rows(repeated, moving)
    assert set(stale) <= set(again)
    assert len(stale) > 0.95 * len(again)
    mended = with_fresh_rows(repeated, stale)
    assert np.max(np.abs(mended.position[stale] - log.position[stale])) < 2e-4
    assert len(stale_rows(log, moving)) == 0


def test_rows_that_are_missing_on_an_even_clock_are_counted() -> None:
    rng = np.random.default_rng(3)
    kept = rng.uniform(size=4000) > 0.07
    log = motion_log(even()[kept])
    hidden = replace(log, time=even(int(np.sum(kept))))
    time, missing = time_with_missing_rows(hidden)
    assert missing == pytest.approx(np.sum(~kept), rel=0.03)
    assert time[-1] == pytest.approx(log.time[-1] - log.time[0], rel=0.003)
    assert time_with_missing_rows(motion_log(even()))[1] == 0


def test_a_clock_that_jitters_is_read_off_the_motion() -> None:
    rng = np.random.default_rng(4)
    true = even() + 0.0006 * rng.uniform(-1.0, 1.0, 4000)
    hidden = replace(motion_log(true), time=even())
    inner = slice(200, 3800)
    before = np.std((true - even())[inner])
    assert np.std((true - time_by_motion(hidden))[inner]) < 0.4 * before
    mended = on_even_clock(hidden, true)
    ideal = motion_log(true[0] + mended.time)
    assert np.max(np.abs(mended.position - ideal.position)[inner]) < 3e-4


def test_rows_in_turn_are_told_by_one_joint_whose_single_rows_do_not_tell() -> None:
    true = even() + np.where(np.arange(4000) % 2, 0.0004, 0.0)
    coarse = 2.0 * np.pi / 2**11
    log = replace(motion_log(true), time=even())
    one = replace(log, joints=("shoulder",), position=np.round(log.position[:, :1] / coarse) * coarse,
                  velocity=log.velocity[:, :1], position_command=log.position_command[:, :1])  # fmt: skip
    assert np.median(steps_by_motion(one)[1]) > 0.3
    apart, std = alternation(one)
    assert apart == pytest.approx(0.2, abs=3.0 * std)
    assert std < 0.01
    time = time_by_motion(one)
    mended = on_even_clock(one, time)
    assert mended.step_s == pytest.approx(0.002, rel=1e-3)
    inner = slice(200, 3800)
    assert np.std((time - true)[inner]) < 0.5 * np.std((even() - true)[inner])
    assert alternation(motion_log(even()))[0] == 0.0


def torque_of(model: RobotModel, log: JointLog) -> Any:
    motion = motion_of(model, log)
    return motion, model.torque(log.joints, motion.q, motion.v, motion.a) + 0.3 * np.sign(motion.v) + 0.2 * motion.v


def test_columns_in_the_place_of_each_other_are_told(tmp_path: Path) -> None:
    model, log = chain(tmp_path), motion_log(even(2500))
    _, torque = torque_of(model, log)
    exchanged = replace(log, position=log.position[:, ::-1])
    (finding,) = assignment_findings(model, exchanged, motion_of(model, exchanged), torque[:, ::-1])
    assert (finding.key, finding.joints) == ("order", ("shoulder", "elbow"))


def test_a_joint_that_turns_the_other_way_is_told(tmp_path: Path) -> None:
    model, log = chain(tmp_path), motion_log(even(2500))
    motion, torque = torque_of(model, log)
    turn = np.array([1.0, -1.0])
    turned = replace(log, position=log.position * turn)
    (finding,) = assignment_findings(model, turned, motion_of(model, turned), torque * turn)
    # Parallel joints: the other one turned is the mirror image.
    assert (finding.key, finding.joints) == ("joint_sign", ("shoulder", "elbow"))
    assert assignment_findings(model, log, motion, torque) == []


def test_degrees_and_a_hidden_gain_are_the_log_and_no_friction(tmp_path: Path) -> None:
    columns = log_columns()
    columns |= {name: np.degrees(columns[name]) for name in ("pos", "des_pos", "vel")}
    columns["kp"] = columns["kp"] / 1.4
    np.savez(tmp_path / "log.npz", **columns)
    (tmp_path / "log.yaml").write_text(
        "robot_log: 1\ndata: log.npz\njoints: [elbow]\ntime: {column: time}\nposition: {column: pos}\n"
        "velocity: {column: vel}\ncommand: {position: des_pos}\ngains: {kp: kp, kd: kd}\n"
    )
    diagnosis = diagnose_robot(robot_file(tmp_path), tmp_path / "log.yaml")
    faults = {finding.key: finding for finding in diagnosis.findings if finding.fault}
    assert set(faults) == {"degrees", "gain"}
    assert faults["gain"].size == pytest.approx(60.0 * (1.0 - 1.0 / 1.4), rel=0.25)
    assert not diagnosis.joints[0].differs
