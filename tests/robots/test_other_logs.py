"""Further logs: the same friction from another drive and encoder, held-out torque, and values that do not agree."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from robots.simulated_joint import log_columns, robot_file

pytest.importorskip("mujoco", reason="mujoco is not installed: robots are not tested")

from nmt_robots.report.robot_page import robot_page
from nmt_robots.verdict.other_logs import ComparedTerm
from nmt_robots.verdict.robot_diagnosis import RobotDiagnosis, diagnose_robot_by_logs


def by_two(folder: Path, first: float, second: float) -> RobotDiagnosis:
    """Two logs with their own Coulomb friction, the second of a drive at half the rate and a noisier encoder."""
    np.savez(folder / "one.npz", **log_columns(coulomb=first))
    np.savez(folder / "two.npz", **log_columns(coulomb=second, rate_hz=250.0, noise=3e-5))
    return diagnose_robot_by_logs(robot_file(folder), [folder / "one.npz", folder / "two.npz"])


def test_the_same_friction_agrees_and_closes_the_other_log(tmp_path: Path) -> None:
    diagnosis = by_two(tmp_path, 0.9, 0.9)
    (other,) = diagnosis.others
    (term,) = other.terms
    assert (term.words, term.agrees) == ("Coulomb friction", True)
    torque, model, left = other.left["elbow"]
    assert left < 0.75 * model < torque
    assert "1 of 1 differing values agree within 2 ±" in other.sentence
    page = robot_page(diagnosis)
    assert 'id="others"' in page
    assert "agrees" in page


def test_another_friction_does_not_agree(tmp_path: Path) -> None:
    (other,) = by_two(tmp_path, 0.9, 0.5).others
    assert [term.agrees for term in other.terms] == [False]
    _, model, left = other.left["elbow"]
    assert left > model


@pytest.mark.parametrize(("apart", "agrees"), [(0.199, True), (0.201, False), (float("nan"), False)])
def test_two_values_agree_within_two_of_their_uncertainties(apart: float, agrees: bool) -> None:
    term = ComparedTerm("elbow", "Coulomb friction", "N·m", (1.0, 0.06), (1.0 + apart, 0.08))
    assert term.agrees is agrees
