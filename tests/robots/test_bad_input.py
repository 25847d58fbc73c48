"""What cannot be diagnosed is refused with what is needed; what is doubtful is said: units, free bodies, contacts."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from robots.simulated_joint import log_columns, robot_file

from nmt_core.errors import BenchError

pytest.importorskip("mujoco", reason="mujoco is not installed: robots are not tested")

from nmt_robots.model.robot_model import RobotModel
from nmt_robots.verdict import robot_diagnosis
from nmt_robots.verdict.robot_diagnosis import RobotDiagnosis, diagnose_robot, read_log

SIDECAR = "robot_log: 1\ndata: log.npz\njoints: [elbow]\ntime: {column: time}\nposition: {column: pos}\n"
LAW = "command: {position: des_pos}\ngains: {kp: 60.0, kd: 1.5}\n"


def refused(folder: Path, sidecar: str, columns: dict[str, Any] | None = None) -> str:
    """Sentence of a refusal."""
    np.savez(folder / "log.npz", **(columns or log_columns()))
    (folder / "log.yaml").write_text(sidecar)
    with pytest.raises(BenchError) as refusal:
        diagnose_robot(robot_file(folder), folder / "log.yaml")
    return str(refusal.value)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("gains: {kp: 60.0, kd: 1.5}\n", "", "give gains.kp and gains.kd"),
        ("command: {position: des_pos}\n", "", "command.position in the sidecar"),
        ("column: pos}", "column: pos, unit: mm}", "positions in mm, but elbow turns: give rad, deg or turn"),
        ("column: pos}", "column: pos, unit: grad}", "position.unit"),
        ("[elbow]", "[elbow, wrist]", "has 1 columns and the sidecar names 2 joints"),
        ("[elbow]", "[knee]", "its joints are elbow. Name the columns of the log in the sidecar"),
    ],
)
def test_each_mistake_is_one_sentence(tmp_path: Path, old: str, new: str, words: str) -> None:
    assert words in refused(tmp_path, (SIDECAR + LAW).replace(old, new))


def test_degrees_of_a_slide_are_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "log.npz", **log_columns())
    (tmp_path / "log.yaml").write_text((SIDECAR + LAW).replace("column: pos}", "column: pos, unit: deg}"))
    slide = tmp_path / "slide.xml"
    slide.write_text(robot_file(tmp_path).read_text().replace('type="hinge"', 'type="slide"'))
    with pytest.raises(BenchError, match="positions in deg, but elbow slides: give m, cm or mm"):
        diagnose_robot(slide, tmp_path / "log.yaml")


def test_a_joint_that_sticks_throughout_says_what_it_needs(tmp_path: Path) -> None:
    sentence = refused(tmp_path, SIDECAR + LAW, log_columns(coulomb=60.0))
    assert "Command more than its breakaway torque" in sentence


@pytest.mark.parametrize(("share", "judged"), [(0.05, True), (0.99, False)])
def test_a_joint_has_to_move_in_a_share_of_the_rows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, share: float, judged: bool
) -> None:
    from nmt_robots.mechanics import motion

    monkeypatch.setattr(motion, "THRESHOLDS", replace(motion.THRESHOLDS, moving_rows=share))
    np.savez(tmp_path / "log.npz", **log_columns())
    if judged:
        robot = RobotModel(robot_file(tmp_path))
        assert motion.motion_of(robot, read_log(tmp_path / "log.npz", robot.path)).moves.all()
    else:
        with pytest.raises(BenchError, match="no joint moves"):
            diagnose_robot(robot_file(tmp_path), tmp_path / "log.npz")


def test_a_free_body_alone_is_no_robot(tmp_path: Path) -> None:
    path = tmp_path / "body.xml"
    path.write_text('<mujoco><worldbody><body><freejoint/><geom size="0.1"/></body></worldbody></mujoco>')
    with pytest.raises(BenchError, match="a free body alone; a robot needs hinges or slides"):
        RobotModel(path)


def with_changed_model(folder: Path, old: str, new: str) -> RobotDiagnosis:
    np.savez(folder / "log.npz", **log_columns())
    path = folder / "changed.xml"
    path.write_text(robot_file(folder).read_text().replace(old, new, 1))
    return diagnose_robot(path, folder / "log.npz")


def test_a_floating_base_says_what_would_tell(tmp_path: Path) -> None:
    text = robot_file(tmp_path).read_text()
    free = text.replace('<body name="arm">', '<body><freejoint/><geom size="0.1" mass="3"/><body name="arm">')
    diagnosis = with_changed_model(tmp_path, text, free.replace("</body>", "</body></body>", 1))
    (finding,) = [finding for finding in diagnosis.findings if finding.key == "base"]
    assert "An IMU on the base would tell" in finding.sentence


def test_shapes_that_touch_are_said(tmp_path: Path) -> None:
    ball = f'<geom size="0.05" pos="0 0 {-0.3}" mass="0"/>'
    floor = '<worldbody><geom type="plane" size="2 2 0.1" pos="0 0 -0.3"/>'
    text = robot_file(tmp_path).read_text()
    touching = text.replace('<geom type="mesh" mesh="absent"/>', ball).replace("<worldbody>", floor)
    (finding,) = [f for f in with_changed_model(tmp_path, text, touching).findings if f.key == "contact"]
    assert "world and arm touch in the model" in finding.sentence
    assert not finding.fault
    # A floor that is farther away is not touched.
    apart = touching.replace('pos="0 0 -0.3"/>', 'pos="0 0 -0.5"/>', 1)
    assert not [f for f in with_changed_model(tmp_path, text, apart).findings if f.key == "contact"]
    assert robot_diagnosis.THRESHOLDS.moving_rows == 0.1


def test_joints_are_a_row_each(tmp_path: Path) -> None:
    """The pendulum side by side; the same log in each column."""
    inner = robot_file(tmp_path).read_text().split("<worldbody>")[1].split("</worldbody>")[0]
    inner = inner.replace('<geom type="mesh" mesh="absent"/>', "")
    bodies = "".join(
        inner.replace('name="arm"', f'pos="{n} 0 0" name="arm{n}"').replace("elbow", f"elbow{n}") for n in range(2)
    )
    path = tmp_path / "two.xml"
    path.write_text(f'<mujoco><compiler angle="radian"/><worldbody>{bodies}</worldbody></mujoco>')
    columns = log_columns(coulomb=0.9, rate_hz=250.0)
    for name in ("pos", "vel", "des_pos"):
        columns[name] = np.repeat(columns[name], 2, axis=1)
    columns |= {name: np.repeat(columns[name], 2) for name in ("kp", "kd")}
    np.savez(tmp_path / "log.npz", **columns)
    assert [joint.cause for joint in diagnose_robot(path, tmp_path / "log.npz").joints] == ["Coulomb friction"] * 2
