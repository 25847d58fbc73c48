"""Further logs: the same friction from another drive and encoder, held-out torque, and values that do not agree."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from robots.simulated_joint import GRAVITY, LENGTH, MASS, log_columns, robot_file

pytest.importorskip("mujoco", reason="mujoco is not installed: robots are not tested")

from nmt_core.errors import BenchError
from nmt_robots.log.proposal import propose_sidecar
from nmt_robots.report.robot_page import robot_page
from nmt_robots.verdict.other_logs import diagnose_robot_by_logs, model_of_other_log
from nmt_robots.verdict.robot_diagnosis import ComparedTerm, RobotDiagnosis


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
    places = [
        page.index(words) for words in ("elbow: Coulomb friction 0.9", "No fault was found.", 'id="joints"', 'id="log"')
    ]
    assert places == sorted(places)
    assert 'id="others"' in page
    assert "agrees" in page


@pytest.mark.campaign
def test_another_friction_does_not_agree(tmp_path: Path) -> None:
    (other,) = by_two(tmp_path, 0.9, 0.5).others
    assert [term.agrees for term in other.terms] == [False]
    _, model, left = other.left["elbow"]
    assert left > model


@pytest.mark.campaign
def test_a_known_mass_hung_on_stands_in_the_model_of_the_second_log(tmp_path: Path) -> None:
    mass = 0.7
    robot, loaded = robot_file(tmp_path), tmp_path / "loaded.xml"
    loaded.write_text(robot.read_text().replace(f'mass="{MASS}"', f'mass="{MASS + mass}"'))
    first, second = tmp_path / "one.npz", tmp_path / "two.npz"
    np.savez(first, **log_columns(coulomb=0.9))
    np.savez(
        second,
        **log_columns(
            coulomb=0.9, armature=0.03 + mass * LENGTH**2, rate_hz=250.0,
            more=lambda q, v: mass * GRAVITY * LENGTH * np.sin(q),
        ),
    )  # fmt: skip
    logs = []
    for data, model in ((first, robot), (second, loaded)):
        logs.append(data.with_suffix(".yaml"))
        logs[-1].write_text(propose_sidecar(data, model, tmp_path).text)
    (other,) = diagnose_robot_by_logs(robot, logs).others
    assert other.model == "loaded.xml"
    assert "with its own model loaded.xml" in other.sentence
    assert [(term.words, term.agrees) for term in other.terms] == [("Coulomb friction", True)]
    _, model_leaves, left = other.left["elbow"]
    assert left < 0.7 * model_leaves


def test_a_model_of_its_own_is_another_than_that_of_the_first_log(tmp_path: Path) -> None:
    robot = robot_file(tmp_path)
    newer, old = tmp_path / "newer.xml", tmp_path / "old.xml"
    for path in (newer, old):
        path.write_text(robot.read_text())
    head = "robot_log: 1\ndata: log.npz\njoints: [elbow]\ntime: {column: time}\nposition: {column: pos}\n"
    for name, key in (("one", "robot: old.xml\n"), ("two", "robot: old.xml\n"), ("three", "robot: newer.xml\n"),
                      ("four", ""), ("five", "robot: absent.xml\n")):  # fmt: skip
        (tmp_path / f"{name}.yaml").write_text(head + key)
    one, two, three, four, five = (tmp_path / f"{name}.yaml" for name in ("one", "two", "three", "four", "five"))
    assert model_of_other_log(robot, one, two) == robot
    assert model_of_other_log(robot, one, three) == newer
    assert model_of_other_log(robot, one, four) == robot
    assert model_of_other_log(robot, tmp_path / "log.npz", two) == old
    with pytest.raises(BenchError, match=r"the robot .*absent\.xml does not exist"):
        model_of_other_log(robot, one, five)


@pytest.mark.parametrize(("apart", "agrees"), [(0.199, True), (0.201, False), (float("nan"), False)])
def test_two_values_agree_within_two_of_their_uncertainties(apart: float, agrees: bool) -> None:
    term = ComparedTerm("elbow", "Coulomb friction", "N·m", (1.0, 0.06), (1.0 + apart, 0.08))
    assert term.agrees is agrees
