"""The replay of a log against a plain simulation that shares no code with it: semi-implicit Euler in closed form."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from robots.simulated_joint import INERTIA, LENGTH, MASS, diagnosed_pendulum, log_columns, robot_file
from robots.test_transmission import ARMATURE, COULOMB, DAMPING, log_behind

pytest.importorskip("mujoco", reason="mujoco is not installed: robots are not tested")

from nmt_robots.mechanics.columns import Effect, rival_effects
from nmt_robots.mechanics.ladder import first_of_last_part
from nmt_robots.mechanics.motion import motion_of
from nmt_robots.mechanics.readings import DriveSignals, Reading
from nmt_robots.mechanics.transmission import Transmission
from nmt_robots.model.robot_model import RobotModel
from nmt_robots.report.robot_files import write_robot_diagnosis
from nmt_robots.report.robot_page import distance
from nmt_robots.verdict.replay import ChangedJoint, JointReplay, Replay, Simulated, driven_by
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
        found = Simulated(self.robot, self.log, self.motion, self.driven, [joint]).positions(self.first)
        return (found - self.log.position[self.first :])[:, 0]

    def effect(self, key: str, shape: str = "") -> Effect:
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


@pytest.mark.parametrize(
    ("key", "shape", "values", "more"),
    [
        ("spring", "", [3.0], lambda q, v: 3.0 * q),
        ("stribeck", "0.2 rad/s", [1.2], lambda q, v: np.sign(v) * 1.2 * np.exp(-abs(v) / 0.2)),
        ("ripple", "12 per turn", [0.6, -0.3], lambda q, v: 0.6 * np.cos(12 * q) - 0.3 * np.sin(12 * q)),
        ("gravity_scale", "", [0.3], lambda q, v: 0.3 * MASS * 9.81 * LENGTH * np.sin(q)),
        ("viscous_by_direction", "", [0.2], lambda q, v: 0.2 * abs(v)),
    ],
)
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


@pytest.mark.parametrize(("stiffness", "gap", "damper"), [(70.0, 0.0, 0.2), (2000.0, 0.03, 2.0)])
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
    replayed = Replayed(tmp_path, columns, MEASURED)
    assert replayed.driven.window == 125
    missed = replayed.misses(replace(AS_IN_THE_MODEL, coulomb=0.9))
    as_given = replayed.misses(AS_IN_THE_MODEL)
    assert rms(missed) < 0.2 * rms(as_given)
    # Each window starts from the measured motion.
    assert np.max(np.abs(as_given[::125])) < 1e-3


def test_a_motion_that_runs_away_is_no_number(tmp_path: Path) -> None:
    replayed = Replayed(tmp_path, log_columns())
    driven = replace(replayed.driven, gains=(np.array([-500.0]), np.array([0.0])))
    replayed.driven = driven
    assert np.isnan(rms(replayed.misses(AS_IN_THE_MODEL)))


def test_a_diagnosis_replays_its_log_and_has_it_on_the_page(tmp_path: Path) -> None:
    diagnosis = diagnosed_pendulum(coulomb=0.9)
    assert diagnosis.replay is not None
    assert diagnosis.replay.changed == {"elbow": "Coulomb friction"}
    (joint,) = diagnosis.replay.joints
    assert joint.after < 0.2 * joint.before
    write_robot_diagnosis(diagnosis, tmp_path)
    page = (tmp_path / "report.html").read_text()
    assert 'id="replay"' in page
    assert "changed model misses" in page
    assert '"rms_changed"' in (tmp_path / "diagnosis.json").read_text()


def test_the_page_keeps_angles_and_slides_apart() -> None:
    def joint(name: str, missed: float) -> JointReplay:
        return JointReplay(name, np.zeros(3), np.full(3, missed), np.zeros(3))

    replay = Replay("", np.arange(3.0), (joint("elbow", 0.03), joint("wrist", 0.04), joint("lift", 0.002)), {})
    assert distance(replay, "before", {"elbow", "wrist"}) == "misses the measured motion by 35.4 mrad and 2 mm rms"
    assert distance(replay, "before", {"elbow", "wrist", "lift"}) == "misses the measured motion by 28.9 mrad rms"
    away = replace(replay, joints=(joint("elbow", 0.03), joint("lift", np.nan)))
    assert distance(away, "before", {"elbow"}) == "runs away"
