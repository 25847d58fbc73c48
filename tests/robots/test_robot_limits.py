"""Limits of a robot's diagnosis: each decision changes where its limit moves past what was measured."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from robots.simulated_joint import diagnosed_pendulum, log_columns, robot_file
from tiers import with_quick

pytest.importorskip("mujoco", reason="mujoco is not installed: robots are not tested")

from nmt_robots.log.joint_log import JointLog
from nmt_robots.log_faults import rows, velocity
from nmt_robots.log_faults.drive import reading_findings
from nmt_robots.mechanics import shared_reading
from nmt_robots.mechanics.ladder import JointMechanics
from nmt_robots.mechanics.motion import Motion
from nmt_robots.mechanics.readings import Reading
from nmt_robots.mechanics.shared_reading import ReadingScores
from nmt_robots.thresholds import THRESHOLDS
from nmt_robots.verdict import joint_verdict
from nmt_robots.verdict.robot_diagnosis import RobotDiagnosis, diagnose_robot


@pytest.fixture
def rubbing() -> RobotDiagnosis:
    """A pendulum with 0.9 N·m of Coulomb friction where its model has 0.5."""
    return diagnosed_pendulum(coulomb=0.9)


def verdict_with(diagnosis: RobotDiagnosis, monkeypatch: pytest.MonkeyPatch, **limits: float) -> bool:
    """Whether the joint's Coulomb friction differs under other limits."""
    monkeypatch.setattr(joint_verdict, "THRESHOLDS", replace(THRESHOLDS, **limits))
    joint = diagnosis.joints[0]
    assert isinstance(joint.mechanics, JointMechanics)
    plain = (joint.torque, joint.as_logged)
    nothing = np.zeros(len(diagnosis.motion.q))
    verdict = joint_verdict.joint_verdict(joint.joint, diagnosis.motion, 0, [joint.mechanics], plain, nothing)
    return bool(next(term.differs for term in verdict.terms if term.key == "coulomb"))


def _share(diagnosis: RobotDiagnosis) -> float:
    return diagnosis.joints[0].terms[0].share


def _certainty(diagnosis: RobotDiagnosis) -> float:
    assert diagnosis.joints[0].mechanics is not None
    (share,) = [item for item in diagnosis.joints[0].mechanics.shares if item.effect.key == "coulomb"]
    return (share.size - 0.5) / max(share.size_std, 0.05)


def _certainty_over_readings(diagnosis: RobotDiagnosis) -> float:
    """With one reading alone, as the limit is asked there."""
    assert diagnosis.joints[0].mechanics is not None
    (share,) = [item for item in diagnosis.joints[0].mechanics.shares if item.effect.key == "coulomb"]
    return (share.size - 0.5) / share.size_std


@pytest.mark.parametrize(
    ("limit", "measured"),
    [("smallest_share", _share), ("certain", _certainty), ("certain_over_readings", _certainty_over_readings)],
)
def test_a_claim_ends_at_its_limit(
    rubbing: RobotDiagnosis, monkeypatch: pytest.MonkeyPatch, limit: str, measured: Callable[[RobotDiagnosis], float]
) -> None:
    value = measured(rubbing)
    assert verdict_with(rubbing, monkeypatch, **{limit: 0.98 * value})
    assert not verdict_with(rubbing, monkeypatch, **{limit: 1.02 * value})


def test_what_stays_silences_no_cause(rubbing: RobotDiagnosis, monkeypatch: pytest.MonkeyPatch) -> None:
    assert verdict_with(rubbing, monkeypatch, unexplained=1e-6)


@pytest.mark.parametrize(("share", "cause"), [(0.11, "not known"), (0.01, "as in the model")])
def test_a_term_that_the_model_lacks_and_that_takes_much_leaves_a_joint_open(
    rubbing: RobotDiagnosis, share: float, cause: str
) -> None:
    verdict = rubbing.joints[0]
    assert verdict.mechanics is not None
    term = next(term for term in verdict.terms if term.key == "armature")
    mechanics = replace(verdict.mechanics, new=frozenset({"armature"}))
    terms = (replace(term, share=share, differs=False),)
    opened = replace(verdict, mechanics=mechanics, terms=terms, unchanged=0.12 * verdict.torque)
    assert opened.cause == cause
    assert ("armature would take" in opened.difference) is (cause == "not known")


def test_a_reading_that_is_a_little_worse_fits_as_well_up_to_its_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    readings = (Reading(), Reading(torque_lag_s=0.002))
    relative = np.array([0.010, 0.0105])
    groups = np.tile(relative[:, None], (1, 4))
    scores = ReadingScores(readings, relative, groups, groups, 0.002)
    for limit, count in ((0.051, 2), (0.049, 1)):
        monkeypatch.setattr(shared_reading, "THRESHOLDS", replace(THRESHOLDS, fits_as_well=limit))
        assert len(scores.fit_as_well()) == count


@pytest.mark.parametrize(
    ("factor", "named"), with_quick([(1.0 + 0.8 * 0.02, False), (1.0 + 1.3 * 0.02, True)], (1.0 + 1.3 * 0.02, True))
)
def test_a_factor_of_a_speed_is_told_beyond_its_limit(tmp_path: Path, factor: float, named: bool) -> None:
    assert velocity.THRESHOLDS.velocity_gain == 0.02
    columns: dict[str, Any] = log_columns()
    columns["vel"] = factor * columns["vel"]
    np.savez(tmp_path / "log.npz", **columns)
    diagnosis = diagnose_robot(robot_file(tmp_path), tmp_path / "log.npz")
    assert bool([finding for finding in diagnosis.findings if finding.key == "velocity_factor"]) is named


@pytest.mark.parametrize(("lag_s", "named"), [(0.9 * THRESHOLDS.lag_s, False), (1.2 * THRESHOLDS.lag_s, True)])
def test_a_delay_is_told_beyond_its_limit(lag_s: float, named: bool) -> None:
    readings = tuple(Reading(torque_lag_s=lag) for lag in (0.0, 0.001, 0.002, 0.003))
    relative = np.array([0.01 * (1.0 + ((reading.torque_lag_s - lag_s) / 5e-4) ** 2) for reading in readings])
    scores = ReadingScores(readings, relative, np.tile(relative[:, None], (1, 4)), relative[:, None], 0.001)
    assert bool([item for item in reading_findings(scores, 0.001) if item.key == "torque_lag"]) is named
    assert THRESHOLDS.lag_s == 0.001


@pytest.mark.parametrize(("lag_s", "both"), [(0.001, False), (0.002, True)])
def test_a_delay_beyond_its_limit_widens_what_the_other_kind_says(lag_s: float, both: bool) -> None:
    readings = (Reading(), Reading(torque_lag_s=lag_s), Reading(command_lag_s=lag_s))
    relative = np.array([0.03, 0.01, 0.02])
    scores = ReadingScores(readings, relative, np.tile(relative[:, None], (1, 4)), relative[:, None], 0.001)
    assert (readings[2] in scores.fit_as_well()) is both


@pytest.mark.parametrize(("mean_rows", "named"), [(1.4, False), (1.6, True)])
def test_a_command_is_held_from_its_limit_on(mean_rows: float, named: bool) -> None:
    assert THRESHOLDS.held_rows == 1.5
    apart = np.tile(np.repeat([1, 2], np.rint([10 * (2 - mean_rows), 10 * (mean_rows - 1)]).astype(int)), 100)
    command = np.repeat(np.arange(len(apart)), apart)[:, None].astype(float)
    time = 0.002 * np.arange(len(command))
    log = JointLog("log", ("elbow",), time, command, position_command=command)
    assert bool([finding for finding in rows._command(log) if finding.key == "command_held"]) is named


@pytest.mark.parametrize(("share", "judged"), [(0.11, True), (0.09, False)])
def test_a_joint_is_judged_from_its_share_of_moving_rows_on(share: float, judged: bool) -> None:
    assert THRESHOLDS.moving_rows == 0.1
    moving = (np.arange(1000) < 1000 * share)[:, None]
    still = np.zeros((1000, 1))
    motion = Motion(0.002, 11, still, still, still, still, still, still, moving, np.zeros(1000, dtype=int))
    assert bool(motion.moves[0]) is judged
