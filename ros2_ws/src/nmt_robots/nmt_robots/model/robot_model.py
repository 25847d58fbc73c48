"""A robot from MJCF or URDF by MuJoCo: its joints and the torque that its rigid bodies need.

Meshes are not needed where inertias come from the file. Damping, friction and armature of the file are kept aside and
are not in the torque, so that they are not counted twice.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from nmt_core.errors import BenchError
from nmt_rig.rig import ROBOT_ENDINGS
from nmt_robots.model.compilation import RobotFile, compiled, read_robot
from nmt_robots.model.coupling import Array, Follower, followers

_NOTHING = np.empty(0)
"""Stand-in for features that an older MuJoCo lacks."""

_OF_SLIDES = (
    (r"N·m", "N"), (r"kg·m²", "kg"), (r"\bmrad\b", "mm"), (r"(?<![a-z])rad(?![a-z])", "m"), (r"\btorque\b", "force"),
    (r"\ban angle\b", "a distance"), (r"\bangle\b", "position"),
)  # fmt: skip
"""Units and words of joints that turn, and those of joints that slide."""

_MOST_TESTS = 200_000_000
"""Of pairs of shapes that are looked at for contacts, over all poses."""


def is_robot_file(name: str | Path) -> bool:
    """Whether a model is a robot's file and no rig."""
    return Path(name).suffix.lower() in ROBOT_ENDINGS


@dataclass(frozen=True)
class Joint:
    """One moving joint.

    Attributes:
        name: in the file.
        turns: whether it turns; else it slides, and all units are those of a slide.
        lower, upper: range, rad or m; infinite without one.
        effort: largest torque of its drive, N·m or N; infinite where the file says none.
        armature: kg·m² or kg.
        damping: N·m·s/rad or N·s/m.
        coulomb: frictionloss, N·m or N.
        gear: of its actuator.
    """

    name: str
    turns: bool
    lower: float
    upper: float
    effort: float
    armature: float
    damping: float
    coulomb: float
    gear: float = 1.0

    def units(self, text: str) -> str:
        """A text about a joint that turns, in the units and words of this joint."""
        if self.turns:
            return text
        for turning, sliding in _OF_SLIDES:
            text = re.sub(turning, sliding, text)
        return text

    @property
    def effort_unit(self) -> str:
        """Unit of the effort of its drive: N·m, or N of a joint that slides."""
        return self.units("N·m")


def effort_units(joints: Sequence[Joint]) -> str:
    """Unit that heads a column of the efforts of several joints."""
    slides = [not joint.turns for joint in joints]
    return "N·m" if not any(slides) else "N" if all(slides) else "N·m; N of a slide"


def rms_by_unit(joints: Sequence[Joint], values: Sequence[float]) -> dict[str, float]:
    """Rms of efforts over joints, those that turn and those that slide apart, by unit."""
    units = [joint.effort_unit for joint in joints]
    of_units = {unit: [value for value, of in zip(values, units, strict=True) if of == unit] for unit in units}
    return {unit: float(np.sqrt(np.mean(np.square(of_unit)))) for unit, of_unit in of_units.items()}


def rms_text(by_unit: dict[str, float]) -> str:
    """Efforts by unit in words, as ``3.2 N·m and 1.1 N``."""
    return " and ".join(f"{value:.3g} {unit}" for unit, value in by_unit.items())


@dataclass(frozen=True, eq=False)
class Frames:
    """Bodies and joints in each of N poses, in the world.

    Attributes:
        position: N × bodies × 3, m.
        turn: N × bodies × 3 × 3; columns are the axes of a body.
        axis, anchor: N × joints × 3.
    """

    position: Array
    turn: Array
    axis: Array
    anchor: Array


@dataclass(frozen=True, eq=False)
class End:
    """A point of a robot that its last joints carry farthest.

    Attributes:
        name: of its body.
        body: number of it.
        point: 3, in the body's frame, m.
    """

    name: str
    body: int
    point: Array


@dataclass(frozen=True, eq=False)
class BodyChange:
    """A body that is not as in the file.

    Attributes:
        body: its number.
        mass: kg.
        centre: 3, in its frame, m.
        inertia: 3 × 3 about the centre, kg·m².
    """

    body: int
    mass: float
    centre: Array
    inertia: Array


class RobotModel:
    """A robot whose rigid-body torque can be asked for.

    Args:
        path: of an MJCF or URDF file.

    Raises:
        BenchError: MuJoCo is missing, the file is not a robot, it has closed loops, or a mesh that gives mass is
            missing.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)
        self.changes: tuple[BodyChange, ...] = ()
        self.changed_gravity: Array | None = None
        mujoco = self._mujoco = mujoco_library()
        self.file: RobotFile = read_robot(self.path)
        model, self.facts = compiled(mujoco, self.file)
        self._model = model
        kinds = [mujoco.mjtJoint(int(kind)) for kind in model.jnt_type]
        free = [number for number, kind in enumerate(kinds) if kind == mujoco.mjtJoint.mjJNT_FREE]
        self.floating = bool(free)
        self._base = int(model.jnt_dofadr[free[0]]) if free else 0
        single = (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)
        numbers = [number for number, kind in enumerate(kinds) if kind in single]
        self._numbers = {_joint_name(mujoco, model, number): number for number in numbers}
        self.joints = tuple(self._joint(number) for number in numbers)
        self._others = {
            **{_joint_name(mujoco, model, n): "ball" for n, kind in enumerate(kinds) if n not in {*numbers, *free}},
            **self.file.others,
        }
        self._refuse_without_drives(len(free))
        for what in ("damping", "dampingpoly", "frictionloss", "armature"):
            getattr(model, f"dof_{what}", _NOTHING)[:] = 0.0
        for what in ("damping", "dampingpoly", "frictionloss"):
            getattr(model, f"tendon_{what}", _NOTHING)[:] = 0.0
        flags = mujoco.mjtDisableBit
        model.opt.disableflags |= int(flags.mjDSBL_CONTACT | flags.mjDSBL_LIMIT | flags.mjDSBL_FRICTIONLOSS)
        self._data = mujoco.MjData(model)

    def with_bodies(self, changes: Sequence[BodyChange], gravity: Array | None = None) -> RobotModel:
        """The robot with some bodies and, where it is given, gravity (m/s²) changed."""
        found = copy(self)
        found.changes, found.changed_gravity = tuple(changes), gravity
        found._model = copy(self._model)
        found.change(found._model)
        found._data = self._mujoco.MjData(found._model)
        return found

    def change(self, model: Any) -> None:
        """Put the changed bodies and gravity into a model of the same file."""
        for item in self.changes:
            moments, axes = np.linalg.eigh(item.inertia)
            axes[:, 2] *= np.sign(np.linalg.det(axes))
            turn = np.empty(4)
            self._mujoco.mju_mat2Quat(turn, axes.ravel())
            model.body_mass[item.body], model.body_ipos[item.body] = item.mass, item.centre
            model.body_inertia[item.body], model.body_iquat[item.body] = moments, turn
            # Else the frame of the inertia is taken for that of the body where the file has it so.
            model.body_sameframe[item.body] = 0
        if self.changed_gravity is not None:
            model.opt.gravity[:] = self.changed_gravity

    @property
    def name(self) -> str:
        """Of the file."""
        return self.path.stem

    @property
    def text(self) -> str:
        """Of the file."""
        return self.file.text

    @property
    def names(self) -> tuple[str, ...]:
        """Of the joints, in the order of the model."""
        return tuple(self._numbers)

    @property
    def drive_gains(self) -> list[tuple[str, float, float]]:
        """Joint, position gain and speed gain of drives that hold positions, N·m/rad and N·m·s/rad (N/m, N·s/m)."""
        model, affine = self._model, int(self._mujoco.mjtBias.mjBIAS_AFFINE)
        held = {
            int(model.actuator_trnid[drive, 0]): np.array(model.actuator_biasprm[drive])
            * float(model.actuator_gear[drive, 0]) ** 2
            for drive in range(model.nu)
            if int(model.actuator_trntype[drive]) == int(self._mujoco.mjtTrn.mjTRN_JOINT)
            and int(model.actuator_biastype[drive]) == affine
        }
        stated = ((name, held[number]) for name, number in self._numbers.items() if number in held)
        return [(name, -float(bias[1]), -float(bias[2])) for name, bias in stated if bias[1] < 0.0]

    def chosen(self, names: tuple[str, ...]) -> tuple[Joint, ...]:
        """Joints by name.

        Raises:
            BenchError: the model has no such joint, or couples it by more than a ratio.
        """
        by_name = {joint.name: joint for joint in self.joints}
        for name in names:
            if name in self._others:
                raise BenchError(
                    f"{self.path}: joint {name} is not a hinge or slide ({self._others[name]}); only those can be "
                    "diagnosed."
                )
        unknown = [name for name in names if name not in by_name]
        if unknown:
            raise BenchError(
                f"{self.path} has no joint {', '.join(unknown)}; its joints are {', '.join(self.names)}. Name the "
                "columns of the log in the sidecar (key joints)."
            )
        for item in self.file.couplings:
            if not item.is_ratio and {item.joint, item.master} & set(names):
                by = f"to {item.master} by a polynomial" if item.master else "to a constant"
                raise BenchError(
                    f"{self.path} couples joint {item.joint} {by}; only couplings by a ratio and an offset are read, "
                    "so the torque of these joints is not known: leave them out of the log's sidecar if they stand."
                )
        return tuple(by_name[name] for name in names)

    def followers(self, names: Sequence[str]) -> list[Follower]:
        """Joints that move with some joints."""
        ratios = [item for item in self.file.couplings if item.is_ratio]
        references = {name: float(self._model.qpos0[self._model.jnt_qposadr[n]]) for name, n in self._numbers.items()}
        return followers(ratios, names, references)

    def bodies_of(self, joint: str) -> Array:
        """Numbers of the bodies that are one with a joint's link."""
        body = self._model.jnt_bodyid[self._numbers[joint]]
        return np.flatnonzero(self._model.body_weldid == self._model.body_weldid[body])

    def at_rest(self) -> tuple[Any, Any]:
        """MuJoCo's model, and its data in the file's own pose."""
        self._mujoco.mj_resetData(self._model, self._data)
        self._mujoco.mj_kinematics(self._model, self._data)
        return self._model, self._data

    def sliding(self) -> list[bool]:
        """Whether each joint of MuJoCo's model slides, by its number."""
        return [int(kind) == int(self._mujoco.mjtJoint.mjJNT_SLIDE) for kind in self._model.jnt_type]

    def numbers_of(self, names: Sequence[str]) -> list[int]:
        """Numbers of joints in MuJoCo's model."""
        return [self._numbers[name] for name in names]

    def body_joints(self, names: Sequence[str]) -> dict[int, list[str]]:
        """Joints among some by the number of the body that they move."""
        found: dict[int, list[str]] = {}
        for name in names:
            found.setdefault(int(self._model.jnt_bodyid[self._numbers[name]]), []).append(name)
        return found

    def body_name(self, body: int) -> str:
        """Of a body, or of the joint that moves it."""
        mujoco, model = self._mujoco, self._model
        joint = int(model.body_jntadr[body])
        name = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_BODY, body)
        return str(name or (_joint_name(mujoco, model, joint) if joint >= 0 else f"body {body}"))

    def frames(self, names: Sequence[str], q: Array) -> Frames:
        """Where all bodies and joints are in each pose.

        Args:
            names: J joints that move, followers among them.
            q: rows × J.
        """
        mujoco, model, data = self._mujoco, self._model, self._data
        mujoco.mj_resetData(model, data)
        places = model.jnt_qposadr[self.numbers_of(names)]
        rows = len(q)
        found = Frames(
            np.empty((rows, model.nbody, 3)), np.empty((rows, model.nbody, 3, 3)), np.empty((rows, model.njnt, 3)),
            np.empty((rows, model.njnt, 3)),
        )  # fmt: skip
        angles, position, turn = data.qpos, data.xpos, data.xmat.reshape(-1, 3, 3)
        axis, anchor = data.xaxis, data.xanchor
        for row in range(rows):
            angles[places] = q[row]
            mujoco.mj_kinematics(model, data)
            found.position[row], found.turn[row] = position, turn
            found.axis[row], found.anchor[row] = axis, anchor
        return found

    def ends(self, names: Sequence[str]) -> list[End]:
        """Behind each named joint that carries no other named one: the farthest origin or centre of a body."""
        model, data = self.at_rest()
        moved = [int(model.jnt_bodyid[number]) for number in self.numbers_of(names)]
        above = {body: {body} for body in range(model.nbody)}
        for body in range(1, model.nbody):
            above[body] |= above[int(model.body_parentid[body])]
        carrying = {other for body in moved for other in above[body] - {body}}
        found = []
        for name, root in zip(names, moved, strict=True):
            if root in carrying:
                continue
            anchor = data.xanchor[self._numbers[name]]
            points = [
                (float(np.linalg.norm(data.xpos[body] + data.xmat[body].reshape(3, 3) @ point - anchor)), body, point)
                for body in range(model.nbody)
                if root in above[body]
                for point in (np.zeros(3), np.array(model.body_ipos[body]))
            ]
            _, body, point = max(points, key=lambda item: item[0])
            found.append(End(self.body_name(body), body, point))
        return found

    def places(self, ends: Sequence[End], names: Sequence[str], q: Array) -> Array:
        """Where ends of the robot are in each pose (rows × J), rows × ends × 3, m; NaN where the pose is."""
        everyone, ratios, offsets = self.with_followers(names)
        frames = self.frames(everyone, np.nan_to_num(q) @ ratios + offsets)
        found = np.stack([frames.position[:, end.body] + frames.turn[:, end.body] @ end.point for end in ends], axis=1)
        found[np.any(np.isnan(q), axis=1)] = np.nan
        return found

    def torque(
        self, names: tuple[str, ...], q: Array, v: Array, a: Array, yielding: bool = False, heavier: str = ""
    ) -> Array:
        """Torque of the rigid bodies and springs, without damping, friction and armature of the drives.

        Joints of the model that are not named stand still where its own pose has them, but for those that follow a
        named one: their torque is its. So does a base that floats, unless it yields: then it is carried against gravity
        alone, and what the limbs do pushes it away.

        Args:
            names: J joints of the columns.
            q, v, a: rows × J: angle, speed, acceleration in rad, rad/s, rad/s².
            yielding: whether a base that floats gives way. Its speed stays out of account.
            heavier: joint whose link has twice its mass, at the same centre; empty = none.

        Returns:
            rows × J, N·m.
        """
        mujoco, model, data = self._mujoco, self._model, self._data
        mujoco.mj_resetData(model, data)
        bodies = self.bodies_of(heavier) if heavier else np.empty(0, dtype=int)
        positions, speeds, ratios, offsets = self._places(names)
        angles, rates, changes = (np.tile(values, (len(q), 1)) for values in (data.qpos, data.qvel, data.qacc))
        angles[:, positions], rates[:, speeds], changes[:, speeds] = q @ ratios + offsets, v @ ratios, a @ ratios
        forces = np.empty_like(rates)
        model.body_mass[bodies] *= 2.0
        pose, speed, change, force = data.qpos, data.qvel, data.qacc, data.qfrc_inverse
        for row in range(len(q)):
            pose[:], speed[:], change[:] = angles[row], rates[row], changes[row]
            mujoco.mj_inverse(model, data)
            forces[row] = force
            if yielding and self.floating:
                forces[row, speeds] += self._given_way(speeds)
        model.body_mass[bodies] *= 0.5
        return np.asarray(forces[:, speeds] @ self.shares(names).T)

    def coupling(self, names: Sequence[str], poses: Array) -> Array:
        """J × J: torque at one joint over that which accelerates another, rms over poses (rows × J)."""
        mujoco, model, data = self._mujoco, self._model, self._data
        speeds, ratios = self._places(names)[1:3]
        squares, moved = np.zeros((len(names), len(names))), np.zeros((len(names), model.nv))
        moved[:, speeds] = ratios
        pushed = np.empty_like(moved)
        for pose in poses:
            self._put(names, pose)
            mujoco.mj_crb(model, data)
            for result, unit in zip(pushed, moved, strict=True):
                mujoco.mj_mulM(model, data, result, unit)
            inertia = moved @ pushed.T
            squares += (inertia / np.maximum(np.diag(inertia), 1e-12)) ** 2
        return np.asarray(np.sqrt(squares / max(len(poses), 1)))

    def with_followers(self, names: Sequence[str]) -> tuple[tuple[str, ...], Array, Array]:
        """The named joints and those F that follow them without being named; ratios, J × (J + F), and offsets."""
        moved = [item for item in self.followers(names) if item.joint not in names]
        everyone = (*names, *(item.joint for item in moved))
        ratios, offsets = np.eye(len(names), len(everyone)), np.zeros(len(everyone))
        for column, item in enumerate(moved, len(names)):
            ratios[list(names).index(item.driver), column] = item.ratio
            offsets[column] = item.offset
        return everyone, ratios, offsets

    def _places(self, names: Sequence[str]) -> tuple[Array, Array, Array, Array]:
        """Addresses of position and speed of the named joints and their followers, ratios and offsets."""
        everyone, ratios, offsets = self.with_followers(names)
        numbers = [self._numbers[name] for name in everyone]
        return self._model.jnt_qposadr[numbers], self._model.jnt_dofadr[numbers], ratios, offsets

    def shares(self, names: Sequence[str]) -> Array:
        """J × (J + F): by how much the torque of each of these joints is that of a named one."""
        shares, place = self.with_followers(names)[1], list(names).index
        for item in self.followers(names):
            if item.joint in names:
                shares[:, place(item.joint)] = 0.0
                shares[place(item.driver), place(item.joint)] = item.ratio
        return shares

    def _given_way(self, speeds: Array) -> Array:
        """Change of the joints' torque as the base moves freely under what the limbs do, next to its weight."""
        mujoco, model, data = self._mujoco, self._model, self._data
        base = slice(self._base, self._base + 6)
        mass = np.zeros((6, model.nv))
        for place, unit in enumerate(np.eye(model.nv)[base]):
            mujoco.mj_mulM(model, data, mass[place], unit)
        pushed = np.array(data.qfrc_inverse[base])
        kept = np.array(data.qvel), np.array(data.qacc)
        data.qvel[:], data.qacc[:] = 0.0, 0.0
        mujoco.mj_inverse(model, data)
        pushed -= data.qfrc_inverse[base]
        data.qvel[:], data.qacc[:] = kept
        return np.asarray(-mass[:, speeds].T @ np.linalg.solve(mass[:, base], pushed))

    def positions(self, names: tuple[str, ...], pose: Array) -> tuple[Array, Array]:
        """Anchors of all named joints (J × 3, m) and of their parents' anchors, in one pose (J)."""
        mujoco, model, data = self._mujoco, self._model, self._data
        self._put(names, pose)
        numbers = [self._numbers[name] for name in names]
        anchors = np.array(data.xanchor[numbers])
        before = []
        for number in numbers:
            body = model.body_parentid[model.jnt_bodyid[number]]
            held = model.body_jntadr[body]
            moving = held >= 0 and int(model.jnt_type[held]) != int(mujoco.mjtJoint.mjJNT_FREE)
            before.append(data.xanchor[held] if moving else data.xpos[body])
        return anchors, np.array(before)

    def _put(self, names: Sequence[str], pose: Array) -> None:
        """Move the bodies to a pose of the named joints (J)."""
        mujoco, model, data = self._mujoco, self._model, self._data
        places, _, ratios, offsets = self._places(names)
        mujoco.mj_resetData(model, data)
        data.qpos[places] = pose @ ratios + offsets
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)

    def touching(self, names: tuple[str, ...], q: Array) -> tuple[float, tuple[str, str]]:
        """Share of poses (rows × J) in which the model's shapes touch, and the two bodies that do so most often.

        Meshes are not among the shapes; where there are very many, fewer poses are looked at. Joints that are not named
        and a base that floats are where the file has them.
        """
        mujoco, model, data = self._mujoco, self._model, self._data
        flag = int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
        model.opt.disableflags &= ~flag
        pairs: list[tuple[str, str]] = []
        poses = 0
        tests = max(int(model.ngeom) ** 2, 1)
        q = q[:: -(-len(q) * tests // _MOST_TESTS)] if tests <= _MOST_TESTS and len(q) else q[:0]
        for row in q:
            self._put(names, row)
            mujoco.mj_collision(model, data)
            poses += int(data.ncon > 0)
            for contact in range(data.ncon):
                bodies = (int(model.geom_bodyid[geom]) for geom in data.contact[contact].geom)
                first, second = (mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_BODY, body) for body in bodies)
                pairs.append((first or "a body without a name", second or "a body without a name"))
        model.opt.disableflags |= flag
        return poses / max(len(q), 1), max(set(pairs), key=pairs.count) if pairs else ("", "")

    def tilt(self) -> tuple[str, float]:
        """The last body before the first branch or joint, and the angle of its z axis to gravity, rad; NaN without."""
        mujoco, model, data = self._mujoco, self._model, self._data
        mujoco.mj_resetData(model, data)
        mujoco.mj_kinematics(model, data)
        body = model.jnt_bodyid[next(iter(self._numbers.values()))]
        while body and (body == model.jnt_bodyid[next(iter(self._numbers.values()))] or model.body_jntnum[body]):
            if model.body_jntnum[body] and int(model.jnt_type[model.body_jntadr[body]]) == int(
                mujoco.mjtJoint.mjJNT_FREE
            ):
                break
            body = model.body_parentid[body]
        size = float(np.linalg.norm(model.opt.gravity))
        up = float(-data.xmat[body][[2, 5, 8]] @ model.opt.gravity) / size if size > 0.0 else np.nan
        return str(mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_BODY, body) or "base"), float(
            np.arccos(np.clip(up, -1, 1))
        )

    @property
    def gravity(self) -> float:
        """Of the file, m/s²."""
        off = int(self._model.opt.disableflags) & int(self._mujoco.mjtDisableBit.mjDSBL_GRAVITY)
        return 0.0 if off else float(np.linalg.norm(self._model.opt.gravity))

    def _joint(self, number: int) -> Joint:
        """What the file says of a joint."""
        mujoco, model = self._mujoco, self._model
        name = _joint_name(mujoco, model, number)
        place = model.jnt_dofadr[number]
        lower, upper = (float(x) for x in model.jnt_range[number]) if model.jnt_limited[number] else (-np.inf, np.inf)
        effort, gear = self._drives(number)
        if model.jnt_actfrclimited[number]:
            effort = min(effort, float(np.max(np.abs(model.jnt_actfrcrange[number]))))
        return Joint(
            name,
            int(model.jnt_type[number]) == int(mujoco.mjtJoint.mjJNT_HINGE),
            lower,
            upper,
            np.inf if name in self.file.unlimited else effort,
            float(model.dof_armature[place]),
            float(np.ravel(model.dof_damping[place])[0]),
            float(model.dof_frictionloss[place]),
            gear,
        )

    def _drives(self, number: int) -> tuple[float, float]:
        """Largest torque of all drives of a joint together, infinite without a limit, and the gear of the last."""
        mujoco, model = self._mujoco, self._model
        limits, gear = [], 1.0
        on_joints = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
        for drive in range(model.nu):
            if int(model.actuator_trntype[drive]) not in on_joints or model.actuator_trnid[drive, 0] != number:
                continue
            gear = float(model.actuator_gear[drive, 0])
            limit = np.inf
            kinds = int(model.actuator_biastype[drive]), int(model.actuator_gaintype[drive])
            plain_motor = kinds == (int(mujoco.mjtBias.mjBIAS_NONE), int(mujoco.mjtGain.mjGAIN_FIXED))
            if model.actuator_ctrllimited[drive] and plain_motor:
                limit = abs(float(model.actuator_gainprm[drive, 0])) * float(
                    np.max(np.abs(model.actuator_ctrlrange[drive]))
                )
            if model.actuator_forcelimited[drive]:
                limit = min(limit, float(np.max(np.abs(model.actuator_forcerange[drive]))))
            limits.append(abs(gear) * limit)
        return (float(sum(limits)) if limits else np.inf), gear

    def _refuse_without_drives(self, bases: int) -> None:
        """Raise where no joint can be diagnosed.

        Raises:
            BenchError: there is none, or several robots float.
        """
        if bases > 1:
            raise BenchError(f"{self.path} has {bases} robots whose bases float; keep the one of the log.")
        if self.joints:
            return
        for name, kind in self._others.items():
            raise BenchError(
                f"{self.path}: joint {name} is not a hinge or slide ({kind}); only those can be diagnosed."
            )
        alone = "a free body alone" if self.floating else "no joint that moves"
        raise BenchError(
            f"{self.path} has {alone}; a robot needs hinges or slides whose positions are in the log. A body on "
            "springs is a rig."
        )


def _joint_name(mujoco: Any, model: Any, number: int) -> str:
    return str(mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_JOINT, number) or f"joint{number}")


def mujoco_library() -> Any:
    """The library.

    Raises:
        BenchError: it is not installed.
    """
    try:
        import mujoco
    except ImportError:
        raise BenchError("Robots need the package mujoco, which is not installed; type: pip install mujoco.") from None
    # It writes warnings into MUJOCO_LOG.TXT of the folder where the command runs.
    mujoco.set_mju_user_warning(lambda _: None)
    return mujoco
