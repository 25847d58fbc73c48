"""A joint that slides has forces in N and lengths in m or mm, in all that a person or a program reads."""

from __future__ import annotations

import io
import re
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="mujoco is not installed: robots are not tested")

from rich.console import Console

from nmt_bench.commands.robot_diagnosis import _show
from nmt_robots.model.robot_model import Joint, RobotModel, effort_units, rms_by_unit
from nmt_robots.report.robot_files import write_robot_diagnosis
from nmt_robots.verdict.other_logs import diagnose_robot_by_logs

MASS, COULOMB, DAMPING, ARMATURE, SPRING, STEP_S = 2.0, 6.0, 10.0, 0.5, 60.0, 0.002
LIFT = f"""<mujoco><worldbody><body name="carriage"><inertial pos="0 0 0" mass="{MASS}" diaginertia="0.01 0.01 0.01"/>
<joint name="lift" type="slide" axis="0 0 1" range="-1 1" damping="{DAMPING}" armature="{ARMATURE}" frictionloss="1"/>
</body></worldbody></mujoco>"""
OF_ANGLES = re.compile(r"N·m|mrad|kg·m²|(?<![a-z])rad(?![a-z])")


@pytest.mark.usefixtures("undrawn")
def test_no_size_of_a_slide_is_one_of_an_angle(tmp_path: Path) -> None:
    time = STEP_S * np.arange(12000)
    phase = 2.0 * np.pi * (0.2 * time + 0.02 * time**2)
    q = 0.3 * np.sin(phase) + 0.1 * np.sin(0.37 * phase)
    v = np.gradient(q, STEP_S)
    force = (MASS + ARMATURE) * np.gradient(v, STEP_S) + MASS * 9.81 + COULOMB * np.sign(v) + DAMPING * v + SPRING * q
    path = tmp_path / "lift.xml"
    path.write_text(LIFT)
    rng = np.random.default_rng(1)
    columns = {"time": time, "position": (q + 1e-6 * rng.standard_normal(len(q)))[:, None], "torque": force[:, None]}
    np.savez(tmp_path / "log.npz", **columns, names=np.array(["lift"]))
    diagnosis = diagnose_robot_by_logs(path, [tmp_path / "log.npz"])
    (joint,) = diagnosis.joints
    found = {term.key: term for term in joint.terms if term.differs}
    assert {"coulomb", "spring"} <= set(found)
    assert (found["coulomb"].unit, found["spring"].unit) == ("N", "N/m")
    assert found["coulomb"].value == pytest.approx(COULOMB, rel=0.05)
    folder = tmp_path / "out"
    folder.mkdir()
    write_robot_diagnosis(diagnosis, folder)
    stream = io.StringIO()
    _show(diagnosis, Console(file=stream, width=200))
    texts = {file.name: file.read_text() for file in folder.iterdir() if file.suffix != ".yaml"}
    texts["terminal"] = stream.getvalue()
    for name, text in texts.items():
        assert not OF_ANGLES.findall(text), name
    assert "N (was 1" in texts["robot.xml"]
    assert "model misses the force by" in texts["terminal"]


def test_efforts_of_both_kinds_are_kept_apart() -> None:
    turning, sliding = (Joint(name, name == "arm", -1.0, 1.0, 1.0, 0.0, 0.0, 0.0) for name in ("arm", "lift"))
    assert rms_by_unit([turning, turning, sliding], [3.0, 4.0, 20.0]) == pytest.approx({"N·m": 12.5**0.5, "N": 20.0})
    assert effort_units([turning]) == "N·m"
    assert effort_units([sliding]) == "N"
    assert effort_units([turning, sliding]) == "N·m; N of a slide"
    text = "2 N·m·s²/rad², 1 N·m·√(s/rad), 3 kg·m²·s, 4 mrad, 0.1 rad/s, gradually"
    assert sliding.units(text) == "2 N·s²/m², 1 N·√(s/m), 3 kg·s, 4 mm, 0.1 m/s, gradually"
    assert turning.units(text) == text


def test_a_push_reaches_other_joints_by_the_inertia_between_them(tmp_path: Path) -> None:
    path = tmp_path / "lift.xml"
    path.write_text(LIFT.replace(
        "</body></worldbody>", '<body pos="1 0 0"><inertial pos="1 0 0" mass="1" diaginertia="0.1 0.1 0.1"/>'
        '<joint name="arm" axis="0 1 0"/></body></body></worldbody>'))  # fmt: skip
    robot = RobotModel(path)
    # Level, the arm's inertia is 1 · 1² + 0.1, that of the lift 2 + 1, and what they share −1 · 1.
    found = robot.coupling(("lift", "arm"), np.zeros((1, 2)))
    assert found == pytest.approx(np.array([[1.0, 1.0 / 1.1], [1.0 / 3.0, 1.0]]))
