"""Cases of robots: how answers are classed, and that a run is resumed and tabulated."""

from __future__ import annotations

import csv
import sys
from pathlib import Path

import pytest

from nmt_blind.campaign.robot_case import Claims, Planted, RobotCase, judge_robot
from nmt_blind.campaign.robot_run import run_robots, summary_lines, write_robot_tables

COULOMB = Planted("coulomb", "joint", "knee", ("coulomb",), ("stribeck",), 0.8)
LATE = Planted("command_late", "log", "", ("command_lag", "torque_lag"), ())
HEAT = Planted("temperature", "joint", "knee", (), ())
FINE = RobotCase(Path("fine"), "healthy", ())
RUBBING = RobotCase(Path("rubbing"), "effect", (COULOMB,))
LATE_LOG = RobotCase(Path("late"), "log", (LATE,))
BOTH = RobotCase(Path("both"), "two", (COULOMB, LATE))
WARM = RobotCase(Path("warm"), "unknown", (HEAT,))


GEARED = RobotCase(
    Path("geared"), "log", (Planted("torque_constant", "log", "knee", ("gain", "torque constant of knee"), ()),)
)
EITHER = (("knee", frozenset({"gain", "link_mass"})),)


def stating(
    *terms: str, log: tuple[str, ...] = (), classes: tuple[tuple[str, frozenset[str]], ...] = (), shared: str = ""
) -> Claims:
    """Claims of terms such as ``coulomb@knee``, findings of all joints, classes, and words for the bodies."""
    pairs = [term.split("@") for term in terms]
    return Claims(
        tuple((joint, key) for key, joint in pairs), tuple(((), key) for key in log),
        {("knee", "coulomb"): (0.9, 0.05)}, classes, frozenset({shared} - {""}),
    )  # fmt: skip


@pytest.mark.parametrize(
    ("case", "claims", "outcome"),
    [
        (FINE, stating(), "right"),
        (FINE, stating(log=("velocity_late",)), "right"),
        (FINE, stating(log=("torque_lag",)), "confidently wrong"),
        (FINE, stating("spring@knee"), "confidently wrong"),
        (RUBBING, stating("coulomb@knee"), "right"),
        (RUBBING, stating("stribeck@knee", "coulomb@knee"), "hedged"),
        (RUBBING, stating("coulomb@knee", log=("torque_lag",)), "hedged"),
        (RUBBING, stating("coulomb@knee", "spring@hip"), "hedged wrong"),
        (RUBBING, stating(), "hedged wrong"),
        (RUBBING, stating("coulomb@hip"), "confidently wrong"),
        (LATE_LOG, stating(log=("torque_lag",)), "right"),
        (LATE_LOG, stating("viscous@knee", log=("torque_lag",)), "confidently wrong"),
        (LATE_LOG, stating(), "hedged wrong"),
        (BOTH, stating("coulomb@knee", log=("command_lag",)), "right"),
        (BOTH, stating("coulomb@knee"), "hedged"),
        (WARM, stating("coulomb@knee"), "right"),
        (WARM, stating("spring@knee"), "confidently wrong"),
        (GEARED, stating(classes=EITHER), "hedged"),
        (GEARED, stating(log=("gain",)), "right"),
        (GEARED, stating(shared="torque constant of knee"), "right"),
        (GEARED, stating(shared="torque constant of hip"), "confidently wrong"),
        (RUBBING, stating("coulomb@knee", shared="body of shin"), "hedged wrong"),
        (RUBBING, stating("coulomb@knee", classes=EITHER), "hedged wrong"),
        (FINE, stating(classes=EITHER), "hedged wrong"),
        (WARM, stating(classes=EITHER), "hedged wrong"),
    ],
)
def test_answers_are_classed(case: RobotCase, claims: Claims, outcome: str) -> None:
    assert judge_robot(case, claims).outcome == outcome


def test_a_value_is_compared_in_its_own_uncertainty() -> None:
    assert judge_robot(RUBBING, stating("coulomb@knee")).deviation == pytest.approx(2.0)


@pytest.mark.campaign
def test_a_case_is_diagnosed_once_and_tabulated(tmp_path: Path) -> None:
    pytest.importorskip("mujoco", reason="mujoco is not installed: robots are not tested")
    from nmt_laboratories.laboratory_four import make_case

    name = make_case(tmp_path / "four", 33)
    command = (sys.executable, "-m", "nmt_bench")
    progress: list[tuple[int, int]] = []
    for _ in range(2):
        lines = run_robots(
            tmp_path / "four", tmp_path / "out", command, progress=lambda done, total, _: progress.append((done, total))
        )
    assert progress == [(0, 1), (1, 1), (1, 1)]
    (line,) = lines
    assert (line.case, line.answer.outcome, line.truth) == (name, "right", "armature@drive")
    assert abs(line.answer.deviation) < 3.0
    assert "effect, 1 cases, diagnosis: right 1" in "\n".join(summary_lines(lines))
    table, _ = write_robot_tables(lines, tmp_path / "out")
    with table.open() as file:
        assert next(csv.DictReader(file))["outcome"] == "right"
