"""A robot from MJCF or URDF by MuJoCo: its joints and the torque that its rigid bodies need.

Meshes are not needed: inertias come from the file. Damping, friction and armature of the file are kept aside and are
not in the torque, so that they are not counted twice.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.files.hardened import read_text
from nmt_rig.rig import ROBOT_ENDINGS

Array = np.ndarray[Any, Any]


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


class RobotModel:
    """A robot whose rigid-body torque can be asked for.

    Args:
        path: of an MJCF or URDF file.

    Raises:
        BenchError: MuJoCo is missing, the file is no robot, or it has closed loops or ball joints.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)
        mujoco = mujoco_library()
        self.text = read_text(self.path, "robot file")
        self._model = compiled(mujoco, self.path, self.text)
        self._mujoco = mujoco
        self.floating = bool(self._model.njnt and int(self._model.jnt_type[0]) == int(mujoco.mjtJoint.mjJNT_FREE))
        self.joints = tuple(self._joint(index) for index in range(int(self.floating), self._model.njnt))
        self._first_position, self._first_speed = (7, 6) if self.floating else (0, 0)
        self._refuse_what_is_no_tree_of_drives()
        self._model.dof_damping[:] = 0.0
        self._model.dof_frictionloss[:] = 0.0
        self._model.dof_armature[:] = 0.0
        flags = mujoco.mjtDisableBit
        self._model.opt.disableflags |= int(flags.mjDSBL_CONTACT | flags.mjDSBL_LIMIT | flags.mjDSBL_FRICTIONLOSS)
        self._data = mujoco.MjData(self._model)

    @property
    def name(self) -> str:
        """Of the file."""
        return self.path.stem

    @property
    def names(self) -> tuple[str, ...]:
        """Of the joints, in the order of the model."""
        return tuple(joint.name for joint in self.joints)

    def chosen(self, names: tuple[str, ...]) -> tuple[Joint, ...]:
        """Joints by name.

        Raises:
            BenchError: the model has no such joint.
        """
        by_name = {joint.name: joint for joint in self.joints}
        unknown = [name for name in names if name not in by_name]
        if unknown:
            raise BenchError(
                f"{self.path} has no joint {', '.join(unknown)}; its joints are {', '.join(self.names)}. Name the "
                "columns of the log in the sidecar (key joints)."
            )
        return tuple(by_name[name] for name in names)

    def torque(
        self, names: tuple[str, ...], q: Array, v: Array, a: Array, yielding: bool = False, heavier: str = ""
    ) -> Array:
        """Torque of the rigid bodies and springs, without damping, friction and armature of the drives.

        Joints of the model that are not named stand still where its own pose has them. So does a base that floats,
        unless it yields: then it is carried against gravity alone, and what the limbs do pushes it away.

        Args:
            names: J joints of the columns.
            q, v, a: rows × J: angle, speed, acceleration in rad, rad/s, rad/s².
            yielding: whether a base that floats gives way. Its speed stays out of account.
            heavier: joint whose link has twice its mass, at the same centre; empty = none.

        Returns:
            rows × J, N·m.
        """
        mujoco, model, data = self._mujoco, self._model, self._data
        columns = np.array([self.names.index(name) for name in names])
        mujoco.mj_resetData(model, data)
        body = int(model.jnt_bodyid[self.names.index(heavier) + int(self.floating)]) if heavier else 0
        model.body_mass[body] *= 2.0
        result = np.empty(q.shape)
        positions, speeds = columns + self._first_position, columns + self._first_speed
        angles, rates, changes, found = data.qpos, data.qvel, data.qacc, data.qfrc_inverse
        for row in range(len(q)):
            angles[positions] = q[row]
            rates[speeds] = v[row]
            changes[speeds] = a[row]
            mujoco.mj_inverse(model, data)
            result[row] = found[speeds]
            if yielding and self.floating:
                result[row] += self._given_way(speeds)
        model.body_mass[body] *= 0.5
        return result

    def _given_way(self, speeds: Array) -> Array:
        """Change of the joints' torque as the base moves freely under what the limbs do, beside its weight."""
        mujoco, model, data = self._mujoco, self._model, self._data
        mass = np.zeros((6, model.nv))
        for place, unit in enumerate(np.eye(6, model.nv)):
            mujoco.mj_mulM(model, data, mass[place], unit)
        pushed = np.array(data.qfrc_inverse[:6])
        kept = np.array(data.qvel), np.array(data.qacc)
        data.qvel[:], data.qacc[:] = 0.0, 0.0
        mujoco.mj_inverse(model, data)
        pushed -= data.qfrc_inverse[:6]
        data.qvel[:], data.qacc[:] = kept
        return np.asarray(-mass[:, speeds].T @ np.linalg.solve(mass[:, :6], pushed))

    def positions(self, names: tuple[str, ...], pose: Array) -> tuple[Array, Array]:
        """Anchors of all named joints (J × 3, m) and of their parents' anchors, in one pose (J)."""
        mujoco, model, data = self._mujoco, self._model, self._data
        columns = np.array([self.names.index(name) for name in names])
        mujoco.mj_resetData(model, data)
        data.qpos[columns + self._first_position] = pose
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        numbers = columns + int(self.floating)
        anchors = np.array(data.xanchor[numbers])
        before = []
        for number in numbers:
            body = model.body_parentid[model.jnt_bodyid[number]]
            held = model.body_jntadr[body]
            moving = held >= 0 and int(model.jnt_type[held]) != int(mujoco.mjtJoint.mjJNT_FREE)
            before.append(data.xanchor[held] if moving else data.xpos[body])
        return anchors, np.array(before)

    def touching(self, names: tuple[str, ...], q: Array) -> tuple[float, tuple[str, str]]:
        """Share of poses (rows × J) in which the model's shapes touch, and the two bodies that do so most often.

        Meshes are not among the shapes. Joints that are not named and a base that floats are where the file has them.
        """
        mujoco, model, data = self._mujoco, self._model, self._data
        columns = np.array([self.names.index(name) for name in names]) + self._first_position
        flag = int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
        model.opt.disableflags &= ~flag
        mujoco.mj_resetData(model, data)
        pairs: list[tuple[str, str]] = []
        poses = 0
        for row in q:
            data.qpos[columns] = row
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_collision(model, data)
            poses += int(data.ncon > 0)
            for contact in range(data.ncon):
                bodies = (int(model.geom_bodyid[geom]) for geom in data.contact[contact].geom)
                first, second = (mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_BODY, body) for body in bodies)
                pairs.append((first or "a body without a name", second or "a body without a name"))
        model.opt.disableflags |= flag
        return poses / max(len(q), 1), max(set(pairs), key=pairs.count) if pairs else ("", "")

    def _joint(self, number: int) -> Joint:
        """What the file says of a joint."""
        mujoco, model = self._mujoco, self._model
        kind = mujoco.mjtJoint(int(model.jnt_type[number]))
        name = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_JOINT, number) or f"joint{number}"
        if kind not in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE):
            raise BenchError(f"{self.path}: joint {name} is no hinge or slide; only those can be diagnosed.")
        place = model.jnt_dofadr[number]
        limited = bool(model.jnt_limited[number])
        lower, upper = (float(x) for x in model.jnt_range[number]) if limited else (-np.inf, np.inf)
        effort, gear = np.inf, 1.0
        if model.jnt_actfrclimited[number]:
            effort = float(np.max(np.abs(model.jnt_actfrcrange[number])))
        for drive in range(model.nu):
            transmits = int(model.actuator_trntype[drive]) == int(mujoco.mjtTrn.mjTRN_JOINT)
            if not transmits or model.actuator_trnid[drive, 0] != number:
                continue
            gear = float(model.actuator_gear[drive, 0])
            plain_motor = int(model.actuator_biastype[drive]) == int(mujoco.mjtBias.mjBIAS_NONE)
            if model.actuator_ctrllimited[drive] and plain_motor:
                scale = abs(gear * float(model.actuator_gainprm[drive, 0]))
                effort = min(effort, scale * float(np.max(np.abs(model.actuator_ctrlrange[drive]))))
            if model.actuator_forcelimited[drive]:
                effort = min(effort, abs(gear) * float(np.max(np.abs(model.actuator_forcerange[drive]))))
        return Joint(
            name,
            bool(kind == mujoco.mjtJoint.mjJNT_HINGE),
            lower,
            upper,
            effort,
            float(model.dof_armature[place]),
            float(np.ravel(model.dof_damping[place])[0]),
            float(model.dof_frictionloss[place]),
            gear,
        )

    def _refuse_what_is_no_tree_of_drives(self) -> None:
        """Raise where inverse dynamics of a tree would be wrong."""
        if self._model.neq:
            raise BenchError(
                f"{self.path} has closed loops or coupled joints (equality constraints), whose torque the angles alone "
                "do not tell; take the constraints out of the file or log the joints of an open chain."
            )
        if not self.joints:
            alone = "a free body alone" if self.floating else "no joint that moves"
            raise BenchError(
                f"{self.path} has {alone}; a robot needs hinges or slides whose positions are in the log. A body on "
                "springs is a rig."
            )


def mujoco_library() -> Any:
    """The library.

    Raises:
        BenchError: it is not installed.
    """
    try:
        import mujoco
    except ImportError:
        raise BenchError("Robots need the package mujoco, which is not installed; type: pip install mujoco.") from None
    return mujoco


def compiled(mujoco: Any, path: Path, text: str, joints: Sequence[str] | None = None) -> Any:
    """The compiled model without its meshes.

    Args:
        mujoco: the library.
        path: of the file, for sentences.
        text: MJCF or URDF.
        joints: that move, without drives and sensors; all others stand still where the file has them. None = all.

    Raises:
        BenchError: MuJoCo refuses it.
    """
    if not re.search(r"<(mujoco|robot)\b", text):
        raise BenchError(f"{path} is neither MJCF nor URDF: it has no element <mujoco> or <robot>.")
    if re.search(r"<include\b", text):
        raise BenchError(f"{path} includes other files; save it as one file first (mujoco.mj_saveLastXML).")
    try:
        spec = mujoco.MjSpec.from_string(text)
        for geometry in list(spec.geoms):
            if geometry.meshname or geometry.type == mujoco.mjtGeom.mjGEOM_MESH:
                spec.delete(geometry)
        for kind in ("meshes", "skins", "textures", "hfields"):
            for item in list(getattr(spec, kind, ())):
                spec.delete(item)
        if joints is not None:
            _keep_only(spec, joints)
        return spec.compile()
    except (ValueError, RuntimeError) as error:
        lines = str(error).strip().splitlines()
        raise BenchError(f"{path} cannot be read as a robot: {lines[0] if lines else error}.") from error


def _keep_only(spec: Any, joints: Sequence[str]) -> None:
    """Leave bodies and the named joints."""
    for kind in ("keys", "sensors", "actuators", "tendons"):
        for item in list(getattr(spec, kind, ())):
            spec.delete(item)
    for number, joint in enumerate(list(spec.joints)):
        if (joint.name or f"joint{number}") not in joints:
            spec.delete(joint)
