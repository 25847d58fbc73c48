"""Four arms that are meant to be alike, one of which rubs three times as much: from two logs to the page."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from robots.simulated_joint import INERTIA, LENGTH, MASS, log_columns

pytest.importorskip("mujoco", reason="mujoco is not installed: robots are not tested")

from nmt_bench.cli import main
from nmt_core.errors import BenchError
from nmt_robots.verdict.alike_joints import PlacedJoint, read_joint_table

pytestmark = pytest.mark.usefixtures("module_undrawn")

ARMS = ("a", "b", "c", "d")
BODY = f"""<body name="arm_NAME" pos="0 PLACE 0">
  <inertial pos="0 0 {-LENGTH}" mass="{MASS}" diaginertia="{INERTIA} {INERTIA} {INERTIA}"/>
  <joint name="NAME_elbow" type="hinge" axis="0 1 0" range="-3 3" armature="0.03" damping="0.2" frictionloss="0.5"/>
</body>"""


def four_arms(folder: Path) -> Path:
    """The robot's file."""
    bodies = "".join(BODY.replace("NAME", name).replace("PLACE", str(k)) for k, name in enumerate(ARMS))
    motors = "".join(f'<motor joint="{name}_elbow" ctrlrange="-40 40"/>' for name in ARMS)
    path = folder / "arms.xml"
    path.write_text(
        f'<mujoco model="arms"><compiler angle="radian"/><worldbody>{bodies}</worldbody>'
        f"<actuator>{motors}</actuator></mujoco>"
    )
    return path


def log_of(path: Path, coulomb: tuple[float, ...], noise: float) -> None:
    """A log of all arms."""
    logs = [log_columns(coulomb=value, noise=noise, rate_hz=250.0) for value in coulomb]
    columns = {name: np.hstack([log[name] for log in logs]) for name in ("pos", "vel", "des_pos", "kp", "kd")}
    np.savez(path, time=logs[0]["time"], **columns)


def test_the_arm_that_rubs_more_is_named_and_repeats_tell_scatter(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    robot, table = four_arms(tmp_path), tmp_path / "arms.csv"
    log_of(tmp_path / "one.npz", (0.9, 0.92, 3.0, 0.91), 1e-5)
    log_of(tmp_path / "two.npz", (0.91, 0.9, 3.02, 0.92), 1e-5)
    table.write_text("joint,unit,part\n" + "".join(f"{name}_elbow,arm {name},elbow\n" for name in ARMS))
    logs = ["--real", str(tmp_path / "one.npz"), "--real", str(tmp_path / "two.npz")]
    out = tmp_path / "out"
    words = ["diagnose", "--quiet", "--model", str(robot), *logs, "--group", str(table), "--out", str(out)]
    assert main(words) == 0
    printed = capsys.readouterr().out
    assert "Units: 4 units of 1 part: odd is arm c (elbow: Coulomb friction)" in printed
    assert "Units: elbow: all 4 units: one effect for all, Coulomb friction." in printed
    assert "arm c differs from its sisters in elbow: Coulomb friction by" in printed.replace("\n", " ")
    group = json.loads((out / "diagnosis.json").read_text())["group"]
    friction = next(item for item in group["quantities"] if item["name"] == "elbow: Coulomb friction")
    assert [each["unit"] for each in friction["components"]["odd"]] == ["arm c"]
    assert friction["components"]["within_std"] < 0.1
    by_unit = {each["unit"]: each["value"] for each in friction["components"]["units"]}
    assert by_unit["arm a"] == pytest.approx(0.905, rel=0.1)
    assert by_unit["arm c"] == pytest.approx(3.01, rel=0.1)
    page = (out / "units.html").read_text()
    assert "elbow: Coulomb friction" in page
    assert 'href="report.html"' in page


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "joint, unit, part"),
        ("recording,unit\n", "joint, unit, part"),
        ("joint,unit,part\nx,left,hip\n", "line 2: the log has no joint 'x'; it has hip_left, hip_right"),
        ("joint,unit,part\nhip_left,left\n", "2 cells for 3 columns"),
        ("joint,unit,part\nhip_left,left,hip\nhip_left,left,hip\n", "line 3: a joint stands there once"),
        ("joint,unit,part\nhip_left,,hip\n", "line 2: a joint stands there once, with its unit and part"),
        ("joint,unit,part\nhip_left,left,hip\n", "two units or more"),
    ],
)
def test_tables_that_are_wrong_are_named(tmp_path: Path, text: str, says: str) -> None:
    (tmp_path / "table.csv").write_text(text)
    with pytest.raises(BenchError, match=says):
        read_joint_table(tmp_path / "table.csv", ("hip_left", "hip_right"))


def test_a_table_of_joints_is_read(tmp_path: Path) -> None:
    (tmp_path / "table.csv").write_text("unit,part,joint\nleft,hip,hip_left\n\nright,hip,hip_right\n")
    assert read_joint_table(tmp_path / "table.csv", ("hip_left", "hip_right")) == {
        "hip_left": PlacedJoint("left", "hip"), "hip_right": PlacedJoint("right", "hip"),
    }  # fmt: skip
