"""Causes that are needed beside the tolerances of the model: found where they are planted, refused where impossible."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from robots.simulated_joint import log_columns, robot_file

pytest.importorskip("mujoco", reason="mujoco is not installed: robots are not tested")

from nmt_robots.log_faults.repair import unwrapped
from nmt_robots.mechanics import ladder
from nmt_robots.mechanics.ladder import JointProblem
from nmt_robots.mechanics.motion import motion_of
from nmt_robots.mechanics.readings import DriveSignals, DriveTorque, Reading
from nmt_robots.model.robot_model import RobotModel
from nmt_robots.thresholds import THRESHOLDS
from nmt_robots.verdict.joint_verdict import by_shared_delay, values_in_model
from nmt_robots.verdict.robot_diagnosis import diagnose_robot, read_log

IN_MODEL = {"coulomb": 0.5, "viscous": 0.2, "armature": 0.03}


def problem(folder: Path, more: Callable[[float, float], float] | None = None) -> JointProblem:
    """The pendulum with a further torque of q and v that its model lacks."""
    np.savez(folder / "log.npz", **log_columns(more=more))
    model = RobotModel(robot_file(folder))
    log, _ = unwrapped(read_log(folder / "log.npz", model.path), model.joints)
    motion = motion_of(model, log)
    return JointProblem(motion, 0, DriveSignals(DriveTorque(log).torque(Reading())[:, 0]), log.joints)


def test_a_spring_brings_its_rest_with_it(tmp_path: Path) -> None:
    """Its rest at 1 rad is an offset of 3 N·m, far beyond the tolerance of one."""
    needed, _ = problem(tmp_path, lambda q, v: 3.0 * (q - 1.0)).needed(IN_MODEL)
    assert needed[0].key == "spring"


def test_a_spring_of_the_file_is_none_that_is_missing(tmp_path: Path) -> None:
    np.savez(tmp_path / "log.npz", **log_columns(more=lambda q, v: 3.0 * (q - 1.0)))
    file = robot_file(tmp_path)
    bare = diagnose_robot(file, tmp_path / "log.npz").joints[0]
    assert "spring" in bare.cause
    text = file.read_text()
    assert text.count("armature=") == 1
    file.write_text(text.replace("armature=", 'stiffness="3.0" springref="1.0" armature='))
    joint = diagnose_robot(file, tmp_path / "log.npz").joints[0]
    assert joint.cause == "as in the model"
    assert joint.unchanged < 0.2 * bare.unchanged


def test_friction_that_falls_with_speed_is_found_within_the_tolerances(tmp_path: Path) -> None:
    np.savez(tmp_path / "log.npz", **log_columns(more=lambda q, v: np.sign(v) * 1.2 * np.exp(-abs(v) / 0.2)))
    diagnosis = diagnose_robot(robot_file(tmp_path), tmp_path / "log.npz")
    assert diagnosis.joints[0].terms[0].key == "stribeck"


def test_friction_never_drives(tmp_path: Path) -> None:
    """Friction that shrinks under load is no efficiency."""
    asked = problem(tmp_path, lambda q, v: -0.1 * abs(3.53 * np.sin(q)) * np.sign(v))
    needed, _ = asked.needed(IN_MODEL)
    assert "load_friction" not in {effect.key for effect in needed}
    rival = next(effect for effect in asked.rivals if effect.key == "load_friction")
    assert not ladder._earns_its_place(asked, list(asked.usual), rival)


def test_a_limit_of_the_torque_takes_all_that_is_beyond_it(tmp_path: Path) -> None:
    asked = problem(tmp_path)
    limit = float(np.quantile(np.abs(asked.torque), 0.8))
    beyond = np.sign(asked.torque) * np.maximum(np.abs(asked.torque) - limit, 0.0)
    every_row = np.zeros_like(asked._every)
    every_row[asked._rows] = beyond
    effect = ladder.Effect("saturation", "", "1", every_row[:, None], True, "", 1.5, True, 0.5)
    asked._filtered[id(effect)] = beyond[:, None]
    clean = asked.left.copy()
    for share, earned in ((0.1, False), (1.0, True)):
        asked.left = clean + share * beyond
        assert ladder._earns_its_place(asked, list(asked.usual), effect) is earned


def test_nothing_is_expected_to_leave_less_than_the_errors_of_the_bodies(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Friction at twice its tolerance is a cause only if what the bodies leave over counts for little."""
    asked = problem(tmp_path)
    off = {**IN_MODEL, "coulomb": 0.4}
    assert asked.needed(off)[0] == []
    monkeypatch.setattr(ladder, "THRESHOLDS", replace(THRESHOLDS, smallest_floor=1e-3))
    assert asked.needed({**IN_MODEL, "coulomb": 0.3})[0]


def test_what_is_needed_has_to_shrink_what_is_left(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = problem(tmp_path, lambda q, v: np.sign(v) * 0.5 * np.exp(-abs(v) / 0.2))
    rival = next(effect for effect in asked.rivals if (effect.key, effect.shape) == ("stribeck", "0.2 rad/s"))
    now = asked.held_out(list(asked.usual))
    after = asked.held_out([*asked.usual, rival])
    shrunk = 1.0 - max(after.interleaved / now.interleaved, after.last / now.last)
    assert shrunk > THRESHOLDS.needed_gain
    for limit, count in ((shrunk - 0.01, 1), (shrunk + 0.01, 0)):
        monkeypatch.setattr(ladder, "THRESHOLDS", replace(THRESHOLDS, needed_gain=limit, smallest_share=1.0))
        assert len(ladder._gains(asked, list(asked.usual), now, [rival], needed=True)) == count


def test_a_delay_that_joints_share_widens_damping_and_armature(tmp_path: Path) -> None:
    np.savez(tmp_path / "log.npz", **log_columns())
    log = read_log(tmp_path / "log.npz", robot_file(tmp_path))
    three = replace(
        log, joints=("a", "b", "c"), position_gain=np.array([80.0, 60.0, 40.0]), velocity_gain=np.full(3, 2.0)
    )
    mechanics = ladder.explain(problem(tmp_path), IN_MODEL)

    def delayed(*excess: float) -> dict[int, dict[str, float]]:
        viscous = mechanics.share("viscous")
        assert viscous is not None
        believed = [{**IN_MODEL, "viscous": viscous.size - value} for value in excess]
        return by_shared_delay(three, believed, dict.fromkeys(range(len(excess)), mechanics))

    shared = delayed(0.40, 0.31, 0.20)
    assert shared[0]["viscous"] == pytest.approx(80.0 * 0.005)
    assert shared[2]["armature"] == pytest.approx(2.0 * 0.005)
    # One joint whose damping is off by itself is no delay of all.
    assert delayed(0.8, 0.0, 0.0)[0]["viscous"] == 0.0
    assert delayed(0.4) == {}
    assert by_shared_delay(replace(three, torque=three.position), [IN_MODEL] * 2, {0: mechanics, 1: mechanics}) == {}


def test_a_speed_of_one_joint_with_a_factor_may_be_the_clock(tmp_path: Path) -> None:
    columns = log_columns()
    columns["vel"] = 1.08 * columns["vel"]
    np.savez(tmp_path / "log.npz", **columns)
    diagnosis = diagnose_robot(robot_file(tmp_path, armature=0.06), tmp_path / "log.npz")
    (finding,) = [finding for finding in diagnosis.findings if finding.key == "velocity_factor"]
    assert finding.instead == ("clock_factor",)
    assert not diagnosis.joints[0].differs


def test_the_model_keeps_its_values_apart(tmp_path: Path) -> None:
    (joint,) = RobotModel(robot_file(tmp_path)).joints
    assert values_in_model(joint) == IN_MODEL
