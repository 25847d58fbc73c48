"""Windows of a log in simulation against a plain one of other code: semi-implicit Euler in closed form."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from robots.simulated_joint import INERTIA, LENGTH, MASS, diagnosed_pendulum, log_columns, robot_file
from robots.test_transmission import ARMATURE, COULOMB, DAMPING, log_behind
from tiers import with_quick

pytest.importorskip("mujoco", reason="mujoco is not installed: robots are not tested")

from nmt_robots.mechanics.columns import JointEffect, rival_effects
from nmt_robots.mechanics.ladder import first_of_last_part
from nmt_robots.mechanics.motion import motion_of
from nmt_robots.mechanics.readings import DriveSignals, Reading
from nmt_robots.mechanics.transmission import Transmission
from nmt_robots.model.robot_model import RobotModel
from nmt_robots.report.robot_files import write_robot_diagnosis
from nmt_robots.verdict.joint_verdict import unjudged
from nmt_robots.verdict.replay import ChangedJoint, PredictedMotion, Replay, Simulated, driven_by, replayed
from nmt_robots.verdict.robot_diagnosis import read_log

LATE = Reading(torque_lag_s=0.001)
"""A drive that holds its torque over rows of 2 ms."""
MEASURED = """robot_log: 1
data: log.npz
joints: [elbow]
time: {column: time}
position: {column: pos}
velocity: {column: vel}
torque: {column: tau}
"""
AS_IN_THE_MODEL = ChangedJoint(ARMATURE, DAMPING, COULOMB)


class Replayed:
    """A log of the pendulum that is simulated."""

    def __init__(self, folder: Path, columns: dict[str, Any], sidecar: str = "") -> None:
        np.savez(folder / "log.npz", **columns)
        if sidecar:
            (folder / "log.yaml").write_text(sidecar)
        self.robot = RobotModel(robot_file(folder))
        self.log = read_log(folder / ("log.yaml" if sidecar else "log.npz"), self.robot.path)
        self.motion = motion_of(self.robot, self.log)
        self.first = first_of_last_part(self.motion)
        self.driven = driven_by(self.log, LATE)

    def misses(self, joint: ChangedJoint) -> Any:
        """Simulated less measured position in the last part, rad."""
        rows = self.log.rows - self.first
        found = Simulated(self.robot, self.log, self.motion, self.driven, [joint]).window(self.first, rows)
        return (found - self.log.position[self.first :])[:, 0]

    def effect(self, key: str, shape: str = "") -> JointEffect:
        signals = DriveSignals(*(np.zeros(self.log.rows) for _ in range(3)))
        effects = rival_effects(self.motion, 0, signals)
        return next(effect for effect in effects if (effect.key, effect.shape) == (key, shape))


def rms(values: Any) -> float:
    return float(np.sqrt(np.mean(values**2)))


def test_friction_as_it_is_gives_the_motion_as_it_is(tmp_path: Path) -> None:
    replayed = Replayed(tmp_path, log_columns(coulomb=0.9))
    assert rms(replayed.misses(replace(AS_IN_THE_MODEL, coulomb=0.9))) < 3e-4
    assert rms(replayed.misses(AS_IN_THE_MODEL)) > 3e-3
    # Only what no value has seen is replayed: of 24 s the last 30 % of the rows that move.
    assert 5.5 < replayed.motion.step_s * (replayed.log.rows - replayed.first) < 8.5


BEYOND_THE_FORMAT = [
    ("spring", "", [3.0], lambda q, v: 3.0 * q),
    ("stribeck", "0.2 rad/s", [1.2], lambda q, v: np.sign(v) * 1.2 * np.exp(-abs(v) / 0.2)),
    ("ripple", "12 per turn", [0.6, -0.3], lambda q, v: 0.6 * np.cos(12 * q) - 0.3 * np.sin(12 * q)),
    ("gravity_scale", "", [0.3], lambda q, v: 0.3 * MASS * 9.81 * LENGTH * np.sin(q)),
    ("viscous_by_direction", "", [0.2], lambda q, v: 0.2 * abs(v)),
]


@pytest.mark.parametrize(("key", "shape", "values", "more"), with_quick(BEYOND_THE_FORMAT, *BEYOND_THE_FORMAT[:2]))
def test_what_the_format_has_no_word_for_is_simulated(
    tmp_path: Path, key: str, shape: str, values: list[float], more: Any
) -> None:
    replayed = Replayed(tmp_path, log_columns(more=more))
    further = [(replayed.effect(key, shape), np.array(values))]
    if key == "spring":
        # Its column is about the middle of the motion: the offset has what that is off from its rest.
        rest_n_m = 3.0 * float(np.mean(replayed.motion.q))
        further.append((replace(replayed.effect("spring"), key="offset", law=lambda _: (1.0,)), np.array([rest_n_m])))
    missed = rms(replayed.misses(replace(AS_IN_THE_MODEL, further=tuple(further))))
    assert missed < 5e-4
    assert missed < 0.5 * rms(replayed.misses(AS_IN_THE_MODEL))


def test_a_gain_of_the_drive_acts_in_its_law(tmp_path: Path) -> None:
    columns = log_columns()
    columns |= {"kp": columns["kp"] / 1.4, "kd": columns["kd"] / 1.4}
    replayed = Replayed(tmp_path, columns)
    assert rms(replayed.misses(replace(AS_IN_THE_MODEL, further=((replayed.effect("gain"), np.array([0.4])),)))) < 3e-4
    assert rms(replayed.misses(AS_IN_THE_MODEL)) > 3e-3


@pytest.mark.parametrize(
    ("stiffness", "gap", "damper"), with_quick([(70.0, 0.0, 0.2), (2000.0, 0.03, 2.0)], (2000.0, 0.03, 2.0))
)
def test_a_link_behind_its_transmission_is_simulated_with_its_motor(
    tmp_path: Path, stiffness: float, gap: float, damper: float
) -> None:
    replayed = Replayed(tmp_path, log_behind(stiffness, gap, damper))
    inertia = INERTIA + MASS * LENGTH**2
    ratio = damper / (2.0 * np.sqrt(stiffness * inertia))
    found = Transmission(stiffness, 0.0, ratio, inertia, gap, 0.0, replayed.motion, 0.0, 0.0, 0.0)
    missed = rms(replayed.misses(replace(AS_IN_THE_MODEL, transmission=found)))
    assert missed < 0.25 * rms(replayed.misses(AS_IN_THE_MODEL))


def test_a_measured_torque_acts_in_windows(tmp_path: Path) -> None:
    columns = log_columns(coulomb=0.9)
    columns["tau"] = 60.0 * (columns["des_pos"] - columns["pos"]) - 1.5 * columns["vel"]
    replayed_log = Replayed(tmp_path, columns, MEASURED)
    joints = [unjudged(joint, 1.0) for joint in replayed_log.robot.joints]
    robot, log, motion = replayed_log.robot, replayed_log.log, replayed_log.motion
    found = replayed((robot, log), (robot, log), motion, [LATE], joints, [])
    assert "measured torque" in found.how
    assert found.horizons_s == (0.2, 0.5, 1.0)
    # The pendulum's friction is 0.4 N·m more than the model's: where the joint does not turn back, the error grows with
    # the square of time.
    inertia = INERTIA + MASS * LENGTH**2 + ARMATURE
    simulated = Simulated(robot, log, motion, driven_by(log, LATE), [replace(AS_IN_THE_MODEL, coulomb=0.9)])
    right = np.array([simulated.window(row, 101)[:, 0] for row in found.starts])
    wrong = np.abs(found.by_model.missed[:, 100, 0])
    assert np.max(wrong) == pytest.approx(0.4 / inertia * 0.2**2 / 2.0, rel=0.2)
    assert rms(right - found.measured[:, :101, 0]) < 0.05 * rms(wrong)
    assert simulated._simulation.free_inertia() == pytest.approx([inertia])
    # The tool is the pendulum's centre: an angle times its length.
    assert found.tool == "tool point (arm)"
    after = found.after(found.by_model, 0.2)
    assert after[1] == pytest.approx(LENGTH * after[0][0], rel=0.02)


def test_a_last_part_that_is_too_short_for_a_window_is_said(tmp_path: Path) -> None:
    columns = {name: values[:1000] if len(values) > 1000 else values for name, values in log_columns().items()}
    short = Replayed(tmp_path, columns)
    joints = [unjudged(joint, 1.0) for joint in short.robot.joints]
    found = replayed((short.robot, short.log), (short.robot, short.log), short.motion, [LATE], joints, [])
    assert found.horizons_s == (0.2, 0.5)
    assert "too short for windows of 1 s" in found.sentence


def test_a_late_loop_begins_with_the_torque_of_the_motion_before(tmp_path: Path) -> None:
    replayed_log = Replayed(tmp_path, log_columns(lag_s=0.02))
    replayed_log.driven = driven_by(replayed_log.log, Reading(command_lag_s=0.02, torque_lag_s=0.001))
    assert rms(replayed_log.misses(AS_IN_THE_MODEL)[:50]) < 2e-4
    # The whole loop late: without the torque of before, its first torque would act over all of the delay.
    late = Reading(torque_lag_s=0.03)
    first = replayed_log.first
    driven = driven_by(replayed_log.log, late)
    simulated = Simulated(replayed_log.robot, replayed_log.log, replayed_log.motion, driven, [AS_IN_THE_MODEL])
    steps = simulated._by_log(first + np.arange(-60, 0) / 4.0)
    law = (60.0 * (replayed_log.log.position_command - replayed_log.motion.q) - 1.5 * replayed_log.motion.v)[:, 0]
    assert steps[:, 0] == pytest.approx(np.interp(first + np.arange(-60, 0) / 4.0, np.arange(len(law)), law))


def test_a_motion_that_runs_away_is_no_number(tmp_path: Path) -> None:
    replayed = Replayed(tmp_path, log_columns())
    driven = replace(replayed.driven, gains=(np.array([-500.0]), np.array([0.0])))
    replayed.driven = driven
    assert np.isnan(rms(replayed.misses(AS_IN_THE_MODEL)))


@pytest.mark.usefixtures("undrawn")
def test_a_diagnosis_replays_its_log_and_has_it_on_the_page(tmp_path: Path) -> None:
    diagnosis = diagnosed_pendulum(coulomb=0.9)
    assert diagnosis.replay is not None
    assert diagnosis.replay.changed == {"elbow": "Coulomb friction"}
    (before,), tool = diagnosis.replay.after(diagnosis.replay.by_model, 0.5)
    (after,), tool_after = diagnosis.replay.after(diagnosis.replay.by_changed, 0.5)
    assert after < 0.2 * before
    assert tool_after < 0.2 * tool
    write_robot_diagnosis(diagnosis, tmp_path)
    page = (tmp_path / "report.html").read_text()
    assert page.index('id="replay"') < page.index('id="joints"')
    assert "as changed, after 0.5 s" in page
    assert '"rms_as_changed"' in (tmp_path / "diagnosis.json").read_text()


def test_the_sentence_keeps_angles_and_slides_apart() -> None:
    def off(*missed: float) -> PredictedMotion:
        values = np.broadcast_to(np.array(missed), (2, 60, 3))
        return PredictedMotion(values, values, np.full((2, 60, 1), 0.005), np.array([60, 60]))

    by_model = off(0.03, 0.04, 0.002)
    replay = Replay("", ("elbow", "wrist", "lift"), (True, True, False), "tool point (hand)", 0.01, np.arange(2),
                    np.zeros((2, 60, 3)), by_model, by_model, {})  # fmt: skip
    assert replay.sentence == (
        "Simulated for 0.5 s from measured states, off by (rms): tool point (hand) 5 mm as given; "
        "revolute joints 35.4 mrad as given; sliding joints 2 mm as given. "
    )
    early = replace(by_model, lasted=np.array([60, 30]))
    assert "tool point (hand) > 5 mm as given" in replace(replay, by_model=early, by_changed=early).sentence


def test_each_limb_has_an_end(tmp_path: Path) -> None:
    path = tmp_path / "two.xml"
    path.write_text(
        """<mujoco><worldbody><body name="hip"><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
        <joint name="hip" axis="0 1 0"/>
        <body name="left" pos="0 1 0"><inertial pos="0 0 -0.2" mass="1" diaginertia="1 1 1"/>
        <joint name="left" axis="0 1 0"/>
        <body name="foot" pos="0 0 -0.5"><inertial pos="0 0 0" mass="0.1" diaginertia="0.01 0.01 0.01"/></body></body>
        <body name="right" pos="0 -1 0"><inertial pos="0 0 -0.3" mass="1" diaginertia="1 1 1"/>
        <joint name="right" type="slide" axis="0 0 1"/></body>
        </body></worldbody></mujoco>"""
    )
    robot = RobotModel(path)
    names = ("hip", "left", "right")
    ends = robot.ends(names)
    assert [end.name for end in ends] == ["foot", "right"]
    places = robot.places(ends, names, np.array([[0.0, np.pi / 2.0, 0.1], [np.nan, 0.0, 0.0]]))
    assert places[0] == pytest.approx(np.array([[-0.5, 1.0, 0.0], [0.0, -1.0, -0.2]]), abs=1e-12)
    assert np.all(np.isnan(places[1]))
