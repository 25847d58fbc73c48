"""A robot's file: torque against the equations of motion of random chains, and what hostile or odd files do."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from robots.changed_robot_files import MJCF, scaled_numbers
from robots.simulated_joint import robot_file
from tiers import with_quick

from nmt_core.errors import BenchError

pytest.importorskip("mujoco", reason="mujoco is not installed: robots are not tested")

from nmt_robots.model.robot_model import RobotModel
from nmt_robots.model.robot_simulation import RobotSimulation
from nmt_robots.verdict.file_findings import file_findings

GRAVITY = np.array([0.0, 0.0, -9.81])


def turn(angles: Any) -> Any:
    """Rotation of roll, pitch and yaw."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(angles), np.sin(angles)
    about_x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    about_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    about_z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return about_z @ about_y @ about_x


def about(axis: Any, angle: float) -> Any:
    """Rotation about an axis, by Rodrigues' formula."""
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross


class Chain:
    """A chain of links with random origins, axes and inertias, some impossible, and fixed links without any.

    Torque is that of Lagrange's equations, all derivatives by differences of kinetic and potential energy.
    """

    def __init__(self, random: np.random.Generator) -> None:
        self.kinds = [str(kind) for kind in random.choice(["revolute", "continuous", "prismatic", "fixed"], 5)]
        self.kinds[1] = "revolute"
        count = len(self.kinds)
        self.origins, self.angles = random.normal(0, 0.2, (count, 3)), random.normal(0, 1.0, (count, 3))
        axes = random.normal(0, 1.0, (count, 3))
        self.axes = axes / np.linalg.norm(axes, axis=1)[:, None]
        self.masses, self.centres = random.uniform(0.2, 2.0, count), random.normal(0, 0.1, (count, 3))
        self.masses[2] = 0.0
        self.turns = random.normal(0, 1.0, (count, 3))
        parts = random.normal(0, 0.05, (count, 3, 3))
        second = parts @ parts.transpose(0, 2, 1)
        self.moments = np.trace(second, axis1=1, axis2=2)[:, None, None] * np.eye(3) - second
        self.moments[3] = np.diag([0.01, -0.002, 0.05])
        self.moments[2] = 0.0
        self.movers = [n for n, kind in enumerate(self.kinds) if kind != "fixed"]
        self.names = tuple(f"joint {n}" for n in self.movers)

    def text(self) -> str:
        """As URDF."""

        def words(values: Any) -> str:
            return " ".join(f"{x:.17g}" for x in values)

        parts = ['<link name="base"/>']
        for n, kind in enumerate(self.kinds):
            (xx, xy, xz), (_, yy, yz), (_, _, zz) = self.moments[n]
            inertial = (
                f'<inertial><origin xyz="{words(self.centres[n])}" rpy="{words(self.turns[n])}"/>'
                f'<mass value="{self.masses[n]:.17g}"/><inertia ixx="{xx:.17g}" ixy="{xy:.17g}" ixz="{xz:.17g}" '
                f'iyy="{yy:.17g}" iyz="{yz:.17g}" izz="{zz:.17g}"/></inertial>'
            )
            parent = f"link {n - 1}" if n else "base"
            parts.append(
                f'<link name="link {n}">{inertial if self.masses[n] else ""}</link>'
                f'<joint name="joint {n}" type="{kind}">'
                f'<origin xyz="{words(self.origins[n])}" rpy="{words(self.angles[n])}"/><parent link="{parent}"/>'
                f'<child link="link {n}"/><axis xyz="{words(self.axes[n])}"/></joint>'
            )
        return f'<?xml version="1.0"?><robot name="chain">{"".join(parts)}</robot>'

    def _poses(self, q: Any) -> list[tuple[Any, Any]]:
        """Rotation of each link, and its centre."""
        rotation, place, found = np.eye(3), np.zeros(3), []
        moved = dict(zip(self.movers, q, strict=True))
        for n, kind in enumerate(self.kinds):
            place = place + rotation @ self.origins[n]
            rotation = rotation @ turn(self.angles[n])
            if kind == "prismatic":
                place = place + rotation @ self.axes[n] * moved[n]
            elif kind != "fixed":
                rotation = rotation @ about(self.axes[n], moved[n])
            found.append((rotation, place + rotation @ self.centres[n]))
        return found

    def mass_matrix(self, q: Any) -> Any:
        """Of generalised coordinates, by differences of the poses."""
        step, count = 1e-6, len(q)
        total = np.zeros((count, count))
        columns = []
        for k in range(count):
            shift = np.eye(count)[k] * step
            columns.append((self._poses(q + shift), self._poses(q - shift)))
        for n, (rotation, _) in enumerate(self._poses(q)):
            linear, angular = np.zeros((3, count)), np.zeros((3, count))
            for k, (ahead, behind) in enumerate(columns):
                linear[:, k] = (ahead[n][1] - behind[n][1]) / (2 * step)
                spin = (ahead[n][0] - behind[n][0]) / (2 * step) @ rotation.T
                angular[:, k] = spin[2, 1], spin[0, 2], spin[1, 0]
            frame = rotation @ turn(self.turns[n])
            total += self.masses[n] * linear.T @ linear + angular.T @ frame @ self.moments[n] @ frame.T @ angular
        return total

    def torque(self, q: Any, v: Any, a: Any) -> Any:
        """Lagrange's equations of one state."""

        def potential(at: Any) -> float:
            return -float(
                sum(m * GRAVITY @ centre for m, (_, centre) in zip(self.masses, self._poses(at), strict=True))
            )

        step = 1e-4
        gradient, change = [], np.zeros((len(q), len(q)))
        for k in range(len(q)):
            shift = np.eye(len(q))[k] * step
            slope = (self.mass_matrix(q + shift) - self.mass_matrix(q - shift)) / (2 * step)
            change += slope * v[k]
            gradient.append((potential(q + shift) - potential(q - shift)) / (2 * step) - 0.5 * v @ slope @ v)
        return self.mass_matrix(q) @ a + change @ v + np.array(gradient)


@pytest.mark.parametrize("seed", with_quick(range(100), 0, 1, 2))
def test_torque_of_any_chain_is_that_of_lagranges_equations(tmp_path: Path, seed: int) -> None:
    random = np.random.default_rng(seed)
    chain = Chain(random)
    path = tmp_path / "chain.urdf"
    path.write_text(chain.text())
    model = RobotModel(path)
    assert model.names == chain.names
    assert list(model.facts["impossible"]) == ["link 3"]
    q, v, a = random.normal(0, 1, (3, len(chain.names)))
    np.testing.assert_allclose(
        model.torque(chain.names, q[None], v[None], a[None])[0], chain.torque(q, v, a), rtol=1e-4, atol=1e-5
    )


ARM = """<robot name="arm"><link name="base"/>
<link name="upper"><inertial><origin xyz="0.2 0 0"/><mass value="1.5"/>
<inertia ixx="0.01" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="tool"><inertial><origin xyz="0.1 0 0"/><mass value="0.8"/>
<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="lift" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
<limit lower="-2" upper="2" effort="30" velocity="3"/></joint>
<joint name="level" type="revolute"><origin xyz="0.4 0 0"/><parent link="upper"/><child link="tool"/>
<axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="0" velocity="3"/>MIMIC</joint></robot>"""


def arm(folder: Path, mimic: str) -> RobotModel:
    """Two links of which the second may be coupled."""
    path = folder / "arm.urdf"
    path.write_text(ARM.replace("MIMIC", mimic))
    return RobotModel(path)


def test_a_coupled_joint_moves_with_its_master_and_gives_it_its_torque(tmp_path: Path) -> None:
    free, coupled = arm(tmp_path, ""), arm(tmp_path, '<mimic joint="lift" multiplier="-0.7" offset="0.3"/>')
    rows = np.random.default_rng(2).normal(0, 1, (3, 20, 1))
    both = np.array([1.0, -0.7]), np.array([0.0, 0.3])
    q, v, a = rows[0] * both[0] + both[1], rows[1] * both[0], rows[2] * both[0]
    power = free.torque(("lift", "level"), q, v, a) @ both[0]
    np.testing.assert_allclose(coupled.torque(("lift",), *rows)[:, 0], power, rtol=1e-9, atol=1e-12)
    # Both in the log: the torque is the master's, and the other's drive has none.
    np.testing.assert_allclose(
        coupled.torque(("lift", "level"), q, v, a), np.column_stack([power, 0 * power]), atol=1e-9
    )
    # Only the one that follows is in the log.
    np.testing.assert_allclose(
        coupled.torque(("level",), q[:, 1:], v[:, 1:], a[:, 1:])[:, 0], power / -0.7, rtol=1e-9, atol=1e-12
    )
    sentences = {item.key: item.sentence for item in file_findings(coupled, ("lift",))}
    assert sentences["file_coupled"].startswith("level moves -0.7 times as far as lift")


def test_a_simulated_coupling_has_the_inertia_and_weight_of_both_links(tmp_path: Path) -> None:
    model = arm(tmp_path, '<mimic joint="lift" multiplier="-0.7" offset="0.3"/>')
    simulation = RobotSimulation(model, ("lift",), 2e-4)
    pose, still, one = np.array([0.4]), np.zeros((1, 1)), np.ones((1, 1))
    weight = model.torque(("lift",), pose[None], still, still)[0]
    inertia = model.torque(("lift",), pose[None], still, one)[0] - weight
    simulation.set_joints(np.zeros(1), np.zeros(1))
    simulation.reset(pose, np.zeros(1))
    np.testing.assert_allclose(simulation.body_torques()[0], weight, rtol=1e-9)
    for _ in range(50):
        simulation.advance(weight + 0.2 * inertia, np.zeros(1))
    np.testing.assert_allclose(simulation.speed, 0.2 * 50 * 2e-4, rtol=0.02)


def test_the_same_coupling_in_mjcf(tmp_path: Path) -> None:
    text = """<mujoco><worldbody><body name="upper"><joint name="lift" axis="0 1 0"/><inertial pos="0.2 0 0" mass="1.5"
    diaginertia="0.01 0.02 0.02"/><body name="tool" pos="0.4 0 0"><joint name="level" axis="0 1 0"/><inertial
    pos="0.1 0 0" mass="0.8" diaginertia="0.01 0.01 0.01"/></body></body></worldbody>
    <equality><joint joint1="level" joint2="lift" polycoef="0.3 -0.7"/></equality></mujoco>"""
    (tmp_path / "arm.xml").write_text(text)
    rows = np.random.default_rng(3).normal(0, 1, (3, 5, 1))
    urdf = arm(tmp_path, '<mimic joint="lift" multiplier="-0.7" offset="0.3"/>')
    model = RobotModel(tmp_path / "arm.xml")
    np.testing.assert_allclose(model.torque(("lift",), *rows), urdf.torque(("lift",), *rows), rtol=1e-9)


def test_joints_that_are_not_in_the_log_are_held_and_named(tmp_path: Path) -> None:
    model = arm(tmp_path, "")
    sentences = {item.key: item.sentence for item in file_findings(model, ("lift",))}
    assert "held where the file has them: level" in sentences["file_held"]
    assert "no friction, no damping and no armature for lift" in sentences["file_no_friction"]
    sentences = {item.key: item.sentence for item in file_findings(model, ("level",))}
    assert sentences["file_zero_limits"].endswith("no limit: level.")
    assert model.chosen(("level",))[0].effort == np.inf


SCENE = """<mujoco><option gravity="0 -1.7 -9.6"/><worldbody><light/>
<body name="cup"><freejoint/><geom size="0.05"/></body>
<body name="arm" gravcomp="1"><joint name="elbow" axis="0 1 0" armature="0.1"/><inertial pos="0 0 -0.3" mass="1.2"
diaginertia="0.02 0.02 0.02"/></body></worldbody><actuator><position joint="elbow" forcerange="-40 40"/>
<velocity joint="elbow" forcerange="-1.5 1.5"/><motor joint="elbow" gear="10" ctrlrange="-0.2 0.2"/></actuator>
<keyframe/><visual/></mujoco>"""


def test_facts_of_a_scene_are_said_before_the_fit(tmp_path: Path) -> None:
    path = tmp_path / "scene.xml"
    path.write_text(SCENE)
    model = RobotModel(path)
    assert not model.floating
    assert model.joints[0].effort == pytest.approx(40.0 + 1.5 + 2.0)
    still = np.zeros((1, 1))
    # Weight is the drive's, whatever the file has the simulator carry.
    np.testing.assert_allclose(model.torque(("elbow",), still + 0.5, still, still), 1.2 * 9.6 * 0.3 * np.sin(0.5))
    sentences = {item.key: item.sentence for item in file_findings(model, ("elbow",))}
    assert set(sentences) == {"file_gravcomp", "file_free_objects", "file_left_out", "file_tilted_base"}
    assert "arm" in sentences["file_gravcomp"]
    assert "cup" in sentences["file_free_objects"]
    assert all(name in sentences["file_left_out"] for name in ("<keyframe>", "<visual>", "<light>"))
    assert "10°" in sentences["file_tilted_base"]


@pytest.mark.parametrize(
    "drive",
    [
        '<damper joint="elbow" kv="1" ctrlrange="0 1"/>', '<muscle joint="elbow"/>', '<dcmotor joint="elbow"/>',
        '<intvelocity joint="elbow" kp="1" actrange="-1 1"/>', '<motor joint="elbow" ctrlrange="0 0"/>',
    ],
)  # fmt: skip
def test_a_drive_whose_limit_is_not_stated_has_none(tmp_path: Path, drive: str) -> None:
    path = tmp_path / "scene.xml"
    path.write_text(SCENE.replace("<actuator>", f"<actuator>{drive}"))
    assert RobotModel(path).joints[0].effort == np.inf


BOX = np.array([[x, y, z] for x in (0.0, 0.2) for y in (-0.03, 0.03) for z in (-0.02, 0.02)])
FACES = ("1 2 4", "1 4 3", "5 7 8", "5 8 6", "1 5 6", "1 6 2", "3 4 8", "3 8 7", "1 3 7", "1 7 5", "2 6 8", "2 8 4")


def test_mass_in_a_mesh_is_kept_where_the_mesh_is_there(tmp_path: Path) -> None:
    text = (
        '<mujoco><compiler meshdir="parts"/><asset><mesh name="m" file="box.obj"/>'
        '<mesh name="n" file="no.obj"/></asset>'
        '<worldbody><body name="fore"><joint name="elbow" axis="0 1 0"/><geom type="mesh" mesh="m" mass="0.9"/>'
        '<geom type="mesh" mesh="n" mass="0"/></body></worldbody></mujoco>'
    )
    path = tmp_path / "robot.xml"
    path.write_text(text)
    with pytest.raises(BenchError, match="link fore has its mass in a mesh") as refusal:
        RobotModel(path)
    assert "box.obj" in str(refusal.value)
    (tmp_path / "parts").mkdir()
    lines = [f"v {x} {y} {z}" for x, y, z in BOX]
    lines += [f"f {face}" for face in FACES]
    (tmp_path / "parts" / "box.obj").write_text("\n".join(lines))
    still = np.zeros((1, 1))
    np.testing.assert_allclose(RobotModel(path).torque(("elbow",), still, still, still), -0.9 * 9.81 * 0.1, rtol=1e-6)
    (tmp_path / "parts" / "box.obj").unlink()
    os.mkfifo(tmp_path / "parts" / "box.obj")
    with pytest.raises(BenchError, match="pipe"):
        RobotModel(path)


HOSTILE = {
    "<INCLUDE file='x.xml'/>": "includes other files",
    "<worldbody><body><include file='/etc/passwd'/></body></worldbody>": "includes other files",
    "<asset><model name='x' file='x.xml'/></asset><worldbody><attach model='x' prefix='_'/></worldbody>": "<attach>",
    "<worldbody><replicate count='100000000'><geom size='1'/></replicate></worldbody>": "<replicate>",
    "<worldbody><flexcomp type='grid' count='999 999 999' name='f'/></worldbody>": "<flexcomp>",
    "<worldbody><composite type='cable' count='100000 1 1'/></worldbody>": "<composite>",
    "<worldbody><body pos='nan 0 0'><joint/></body></worldbody>": "pos of <body>: nan is not a number",
    "<option gravity='0 0 -inf'/>": "gravity of <option>",
    "<worldbody><body pos='1e308 0 0'><joint/></body></worldbody>": "is beyond every robot",
    "<worldbody><body><inertial pos='0 0 0' mass='1e300' diaginertia='1 1 1'/></body></worldbody>": "is beyond every",
    f"<worldbody>{'<body>' * 400}{'</body>' * 400}</worldbody>": "nested too deeply",
    f"<worldbody>{'<geom/>' * 60_000}</worldbody>": "too many elements",
}
HARMLESS = (
    "<asset><hfield name='h' nrow='100000' ncol='100000' size='1 1 1 1'/></asset>",
    "<size nkey='2000000000' memory='100G'/>",
    "<keyframe><key qpos='1 2 3'/></keyframe>",
    "<option timestep='nan' iterations='2000000000'/>",
    "<asset><texture name='t' type='2d' builtin='flat' width='100000' height='100000'/></asset>",
    "<extension><plugin plugin='mujoco.sdf.bolt'/></extension>",
    "<sensor><user name='u' dim='2000000000'/></sensor>",
)


@pytest.mark.parametrize(("part", "words"), HOSTILE.items())
def test_hostile_files_are_refused_in_a_sentence(tmp_path: Path, part: str, words: str) -> None:
    path = robot_file(tmp_path)
    path.write_text(path.read_text().replace("</mujoco>", f"{part}</mujoco>"))
    with pytest.raises(BenchError, match=words) as refusal:
        RobotModel(path)
    assert len(str(refusal.value).splitlines()) == 1


def test_what_the_torque_does_not_need_takes_neither_memory_nor_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    path = robot_file(tmp_path)
    path.write_text(path.read_text().replace("</mujoco>", f"{''.join(HARMLESS)}</mujoco>"))
    begun = time.monotonic()
    model = RobotModel(path)
    assert model.names == ("elbow",)
    assert time.monotonic() - begun < 20.0
    # Of a process of its own: other children of this one may have been larger.
    program = (
        "import resource, sys; from nmt_robots.model.robot_model import RobotModel; RobotModel(sys.argv[1]); "
        "print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)"
    )
    child = subprocess.run([sys.executable, "-c", program, path], capture_output=True, text=True, check=True)
    assert int(child.stdout) < 2**20  # KiB
    assert {"<size>", "<keyframe>", "<sensor>", "<extension>"} <= set(model.file.left_out)
    still = np.zeros((1, 1))
    with np.errstate(all="ignore"):
        model.torque(("elbow",), still, still + 1e300, still)
    assert sorted(item.name for item in tmp_path.iterdir()) == ["pendulum.xml"]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('<!DOCTYPE r [<!ENTITY a "b">]><robot name="x"/>', "declares a document type"),
        ('<robot><xacro:macro name="m"/></robot>', "expand it first: xacro"),
        ("<robot/>", "has 0 links without a parent"),
        ('<robot><link name="a"/><link name="a"/></robot>', "a second link has the name a"),
        (
            '<robot><link name="a"/><joint name="j" type="revolute"><parent link="a"/></joint></robot>',
            "has no child link",
        ),
        (ARM.replace("MIMIC", "").replace('type="revolute"', 'type="screw"', 1), "has the type 'screw'"),
        (ARM.replace("MIMIC", "").replace('xyz="0 1 0"', 'xyz="0 0 0"', 1), "axis of joint lift has no direction"),
        (ARM.replace("MIMIC", "").replace('value="1.5"', 'value="heavy"', 1), "line 2: value of <mass>: heavy is no"),
        (ARM.replace("MIMIC", "").replace('<child link="tool"/>', '<child link="upper"/>'), "has two parents"),
    ],
)
def test_what_is_wrong_in_a_urdf_is_one_sentence(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "robot.urdf"
    path.write_text(text)
    with pytest.raises(BenchError, match=words):
        RobotModel(path)


def direct_torque(text: str, names: tuple[str, ...], pose: Any) -> Any:
    """Torque by MuJoCo's own reader of the whole file, without what belongs to the drives."""
    import mujoco

    spec = mujoco.MjSpec.from_string(text)
    for geom in list(spec.geoms):
        if geom.meshname:
            spec.delete(geom)
    for mesh in list(spec.meshes):
        spec.delete(mesh)
    model = spec.compile()
    for values in (model.dof_damping, model.dof_dampingpoly, model.dof_frictionloss, model.dof_armature):
        values[:] = 0.0
    flags = mujoco.mjtDisableBit
    model.opt.disableflags |= int(flags.mjDSBL_CONTACT | flags.mjDSBL_LIMIT)
    data = mujoco.MjData(model)
    numbers = [model.joint(name).id for name in names]
    data.qpos[model.jnt_qposadr[numbers]] = pose
    data.qvel[model.jnt_dofadr[numbers]] = data.qacc[model.jnt_dofadr[numbers]] = pose
    mujoco.mj_inverse(model, data)
    return data.qfrc_inverse[model.jnt_dofadr[numbers]]


@pytest.mark.parametrize("seed", with_quick(range(10), 0))
def test_what_is_left_out_of_a_file_changes_no_torque(tmp_path: Path, seed: int) -> None:
    """MuJoCo's reading of the whole file is the witness, also of changed numbers."""
    pytest.importorskip("mujoco").set_mju_user_warning(lambda _: None)
    random, path, compared = np.random.default_rng(seed), tmp_path / "rich.xml", 0
    for number in range(5):
        text = MJCF if number == 0 else scaled_numbers(MJCF, random)
        path.write_text(text)
        try:
            model = RobotModel(path)
            model.chosen(model.names)
            expected = direct_torque(text, model.names, 0.3)
        except (BenchError, ValueError):
            continue
        pose = np.full((1, len(model.names)), 0.3)
        size = max(1.0, float(np.max(np.abs(expected))))
        np.testing.assert_allclose(
            model.torque(model.names, pose, pose, pose)[0], expected, atol=1e-9 * size, err_msg=text
        )
        compared += 1
    assert compared >= 3
