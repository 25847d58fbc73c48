"""Causes that are needed beside the tolerances of the model: found where they are planted, refused where impossible."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from robots.simulated_joint import log_columns, robot_file
from tiers import with_quick

pytest.importorskip("mujoco", reason="mujoco is not installed: robots are not tested")

from nmt_robots.log_faults.repair import unwrapped
from nmt_robots.mechanics import joint_space, ladder
from nmt_robots.mechanics.columns import JointEffect
from nmt_robots.mechanics.ladder import JointProblem, explain
from nmt_robots.mechanics.motion import motion_of
from nmt_robots.mechanics.readings import DriveSignals, DriveTorque, Reading
from nmt_robots.model.robot_model import RobotModel
from nmt_robots.thresholds import THRESHOLDS
from nmt_robots.verdict.joint_verdict import by_shared_delay, values_in_model
from nmt_robots.verdict.other_logs import diagnose_robot_by_logs
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
    found = explain(problem(tmp_path, lambda q, v: 3.0 * (q - 1.0)), IN_MODEL)
    assert found.causes == ("spring",)
    assert found.choice.probability["spring"] > 0.9


def test_a_cause_that_is_left_out_has_its_place_taken(tmp_path: Path) -> None:
    found = explain(problem(tmp_path, lambda q, v: 3.0 * (q - 1.0)), IN_MODEL, without=frozenset({"spring"}))
    assert "spring" not in found.causes
    assert {"offset", "mass_centre"} & set(found.causes)


def test_a_constant_torque_is_named_with_its_share(tmp_path: Path) -> None:
    np.savez(tmp_path / "log.npz", **log_columns(more=lambda q, v: 1.5))
    joint = diagnose_robot(robot_file(tmp_path), tmp_path / "log.npz").joints[0]
    term = joint.terms[0]
    assert term.key == "offset"
    assert term.differs
    assert term.value == pytest.approx(1.5, abs=3.0 * term.std)
    assert joint.adequate


@pytest.mark.campaign
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
    """Friction that shrinks under load is not an efficiency."""
    asked = problem(tmp_path, lambda q, v: -0.1 * abs(3.53 * np.sin(q)) * np.sign(v))
    assert "load_friction" not in explain(asked, IN_MODEL).causes


def test_a_limit_of_the_torque_takes_all_that_is_beyond_it(tmp_path: Path) -> None:
    asked = problem(tmp_path)
    limit = float(np.quantile(np.abs(asked.torque), 0.8))
    beyond = np.sign(asked.torque) * np.maximum(np.abs(asked.torque) - limit, 0.0)
    every_row = np.zeros_like(asked._every)
    every_row[asked.rows] = beyond
    effect = JointEffect("saturation", "", "1", every_row[:, None], True, "", 1.5, True, 0.5)
    asked._filtered[id(effect)] = beyond[:, None]
    clean = asked.left.copy()
    for share, credible in ((0.1, False), (1.0, True)):
        asked.left = clean + share * beyond
        assert asked.credible(list(asked.usual), effect) is credible


def test_nothing_is_expected_to_leave_less_than_the_errors_of_the_bodies(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Friction at twice its tolerance is a cause only if what the bodies leave over counts for little."""
    asked = problem(tmp_path)
    off = {**IN_MODEL, "coulomb": 0.4}
    assert explain(asked, off).causes == ()
    monkeypatch.setattr(joint_space, "THRESHOLDS", replace(THRESHOLDS, smallest_floor=1e-3))
    assert explain(asked, {**IN_MODEL, "coulomb": 0.3}).causes == ("coulomb",)


@pytest.mark.parametrize("excess", with_quick([0.0, 0.5], 0.5))
def test_friction_that_a_file_lacks_is_named_whole(tmp_path: Path, excess: float) -> None:
    """Coulomb and viscous friction together look like friction with the root of speed to a first step alone."""
    np.savez(tmp_path / "log.npz", **log_columns(coulomb=0.5 + excess))
    diagnosis = diagnose_robot(robot_file(tmp_path, damping=0.0, coulomb=0.0), tmp_path / "log.npz")
    terms = {term.key: term for term in diagnosis.joints[0].terms if term.differs}
    assert set(terms) == {"coulomb", "viscous"}
    assert abs(terms["coulomb"].value - 0.5 - excess) < 3.0 * terms["coulomb"].std
    assert abs(terms["viscous"].value - 0.2) < 3.0 * terms["viscous"].std


def test_friction_of_a_file_that_the_robot_lacks_is_named(tmp_path: Path) -> None:
    np.savez(tmp_path / "log.npz", **log_columns(coulomb=0.0, damping=0.0))
    diagnosis = diagnose_robot(robot_file(tmp_path, damping=0.6), tmp_path / "log.npz")
    terms = {term.key: term for term in diagnosis.joints[0].terms if term.differs}
    assert set(terms) == {"coulomb", "viscous"}
    assert terms["coulomb"].value == pytest.approx(0.0, abs=0.03)


def test_a_claim_has_to_hold_on_the_last_part_of_the_log(tmp_path: Path) -> None:
    """Friction that only the first part of the log has leaves more on the last with it than without it."""
    asked = problem(tmp_path)
    rows = len(asked.left)
    asked.left = asked.left + np.where(np.arange(rows) < 0.65 * rows, 0.8, -0.3) * asked.columns([asked.usual[0]])[:, 0]
    found = explain(asked, IN_MODEL)
    assert found.causes == ("changing_friction",)
    assert found.lost == {"changing_friction"}
    assert explain(problem(tmp_path), {**IN_MODEL, "coulomb": 0.1}).lost == frozenset()


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
    # One joint whose damping is off by itself is not a delay of all.
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


def test_friction_that_falls_with_speed_is_told_over_the_speeds_of_the_log(tmp_path: Path) -> None:
    """A bell of friction: its height at rest lies outside of the log, its fall between two speeds of it does not."""
    np.savez(tmp_path / "log.npz", **log_columns(more=lambda q, v: np.sign(v) * 1.2 * np.exp(-((v / 0.25) ** 2))))
    diagnosis = diagnose_robot(robot_file(tmp_path), tmp_path / "log.npz")
    (term,) = [term for term in diagnosis.joints[0].terms if term.differs]
    slow, fast = (float(word) for word in term.words.split(" from ")[1].split(" rad/s")[0].split(" to "))
    fall = 1.2 * (np.exp(-((slow / 0.25) ** 2)) - np.exp(-((fast / 0.25) ** 2)))
    assert 0.06 <= slow < 0.25 < 0.5 < fast
    assert abs(term.value - fall) < 2.5 * term.std < 0.3


@pytest.mark.parametrize("late", [0.3, 0.9])
def test_friction_that_changes_over_the_log_is_no_constant(tmp_path: Path, late: float) -> None:
    """A drive that warms within 8 s from 0.9 N·m: told with both ends, and silent where it does not change."""
    asked = problem(tmp_path)
    rows = np.flatnonzero(asked.rows)
    speed = np.sign(asked.motion.v[rows, 0])
    change = (late - 0.5) + (0.9 - late) * np.exp(-rows * asked.motion.step_s / 8.0)
    asked.left = asked.left + change * speed
    found = explain(asked, IN_MODEL)
    share = found.share("changing_friction")
    if late == 0.9:
        assert found.causes == ("coulomb",)
        return
    assert share is not None
    assert share.stated is not None
    start, end = (float(word) for word in share.stated.words.split(" from ")[1].split(" N·m")[0].split(" to "))
    assert start == pytest.approx(0.9, abs=0.05)
    assert end == pytest.approx(late + 0.6 * np.exp(-3.0), abs=0.04)
    assert abs(share.stated.size - (start - end)) < 0.03


def bristle(size: float, reach: float) -> Callable[[float, float], float]:
    """Friction of an elastic bristle whose foot is dragged along, of a joint that starts at 0.4 rad."""
    foot = [0.4]

    def torque(q: float, v: float) -> float:
        foot[0] = min(max(foot[0], q - reach), q + reach)
        return size * (q - foot[0]) / reach

    return torque


@pytest.mark.parametrize(
    ("reach", "noise"), with_quick([(0.001, 1e-5), (0.003, 1e-4), (0.05, 1e-4)], (0.003, 1e-4), (0.05, 1e-4))
)
def test_friction_that_builds_up_over_an_angle_is_told_with_it(tmp_path: Path, reach: float, noise: float) -> None:
    """The bristle is integrated with the motion, the diagnosis has its state from the logged angle alone."""
    np.savez(tmp_path / "log.npz", **log_columns(coulomb=0.0, noise=noise, more=bristle(0.5, reach)))
    diagnosis = diagnose_robot(robot_file(tmp_path), tmp_path / "log.npz")
    (joint,) = diagnosis.joints
    (term,) = [term for term in joint.terms if term.differs]
    assert term.text().startswith("friction builds up over")
    assert abs(term.value - 1e3 * reach) < 2.5 * term.std < max(0.4, 50.0 * reach)
    assert joint.left < 0.3 * joint.plain
    assert joint.mechanics is not None
    share = joint.mechanics.share("creep")
    assert share is not None
    assert share.size == pytest.approx(0.5, rel=0.06)


@pytest.mark.campaign
def test_a_replay_has_the_state_of_friction_that_builds_up(tmp_path: Path) -> None:
    np.savez(tmp_path / "log.npz", **log_columns(coulomb=0.0, more=bristle(1.5, 0.004)))
    diagnosis = diagnose_robot_by_logs(robot_file(tmp_path, coulomb=1.5), [tmp_path / "log.npz"])
    assert diagnosis.replay is not None
    off = [diagnosis.replay.after(item, 0.5)[1] for _, item in diagnosis.replay.models]
    assert off[1] < 0.2 * off[0]


def test_a_joint_that_sticks_does_not_creep(tmp_path: Path) -> None:
    asked = problem(tmp_path)
    assert np.array_equal(asked.rows, asked.motion.moving[:, 0])
    assert "creep" not in explain(asked, IN_MODEL).causes


def test_a_cause_that_leaves_much_is_named_in_part(tmp_path: Path) -> None:
    np.savez(tmp_path / "log.npz", **log_columns(coulomb=1.4, more=lambda q, v: 1.2 * np.sin(150.0 * q)))
    joint = diagnose_robot(robot_file(tmp_path), tmp_path / "log.npz").joints[0]
    assert not joint.adequate
    assert "coulomb" in {term.key for term in joint.terms if term.differs}
    assert "in part" in joint.difference
    assert joint.to_mapping()["adequate"] is False
    assert next(term for term in joint.to_mapping()["terms"] if term["key"] == "coulomb")["probability"] > 0.9


def test_what_a_file_does_not_state_is_read_off_the_log(tmp_path: Path) -> None:
    bare = robot_file(tmp_path, armature=0.0, damping=0.0, coulomb=0.0)
    np.savez(tmp_path / "log.npz", **log_columns(coulomb=0.15))
    joint = diagnose_robot(bare, tmp_path / "log.npz").joints[0]
    named = {term.key: term for term in joint.terms if term.differs}
    # Neither has to pay for itself as a cause: the joint has both, and the file says nothing of them.
    for key, true in (("coulomb", 0.15), ("viscous", 0.2)):
        assert abs(named[key].value - true) < 3.0 * named[key].std
    assert named["coulomb"].value == pytest.approx(0.15, rel=0.2)
    np.savez(tmp_path / "without.npz", **log_columns(coulomb=0.0, damping=0.0, armature=0.0))
    assert not diagnose_robot(bare, tmp_path / "without.npz").joints[0].differs
