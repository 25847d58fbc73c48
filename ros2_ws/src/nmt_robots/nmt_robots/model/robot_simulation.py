"""A robot simulated forward by MuJoCo: its rigid bodies, with armature, damping and dry friction of each joint."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from nmt_robots.model.compilation import compiled
from nmt_robots.model.coupling import Array
from nmt_robots.model.robot_model import RobotModel, mujoco_library


class RobotSimulation:
    """The named joints of a robot and their followers in motion; all others and a base that floats stand still.

    Contacts, limits and drives of the file are left out. Dry friction is MuJoCo's constraint, as stiff as the
    step allows, so that a joint sticks.

    Args:
        robot: whose bodies move.
        names: J joints.
        step_s: of the simulation, s.
        heavier: by joint, factor of the mass of its link.
    """

    def __init__(
        self, robot: RobotModel, names: Sequence[str], step_s: float, heavier: dict[str, float] | None = None
    ) -> None:
        mujoco = self._mujoco = mujoco_library()
        everyone, self._ratios, self._offsets = robot.with_followers(names)
        moved = [item for item in robot.followers(names) if item.joint not in names]
        model = self._model = compiled(mujoco, robot.file, names, moved)[0]
        model.opt.timestep = step_s
        model.opt.integrator = int(mujoco.mjtIntegrator.mjINT_IMPLICITFAST)
        flags = mujoco.mjtDisableBit
        model.opt.disableflags |= int(flags.mjDSBL_CONTACT | flags.mjDSBL_LIMIT | flags.mjDSBL_AUTORESET)
        model.opt.disableflags &= ~int(flags.mjDSBL_FRICTIONLOSS)
        model.dof_solref[:] = (2.0 * step_s, 1.0)
        model.eq_solref[:] = (2.0 * step_s, 1.0)
        getattr(model, "dof_dampingpoly", np.empty(0))[:] = 0.0
        numbers = [mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name) for name in everyone]
        self._all_places, self._all_dofs = model.jnt_qposadr[numbers], model.jnt_dofadr[numbers]
        self._places, self._dofs = self._all_places[: len(names)], self._all_dofs[: len(names)]
        followers = self._all_dofs[len(names) :]
        for values in (model.dof_damping, model.dof_armature, model.dof_frictionloss):
            values[followers] = 0.0
        robot.change(model)
        if robot.changes:
            mujoco.mj_setConst(model, mujoco.MjData(model))
        for name, factor in (heavier or {}).items():
            model.body_mass[robot.bodies_of(name)] *= factor
        self._data, self._still = mujoco.MjData(model), mujoco.MjData(model)

    @property
    def position(self) -> Array:
        """J, rad."""
        return np.array(self._data.qpos[self._places])

    @property
    def speed(self) -> Array:
        """J, rad/s."""
        return np.array(self._data.qvel[self._dofs])

    @property
    def acceleration(self) -> Array:
        """J, rad/s², of the last step."""
        return np.array(self._data.qacc[self._dofs])

    def set_joints(self, armature: Array, damping: Array) -> None:
        """Armature (kg·m²) and damping (N·m·s/rad) of each joint."""
        self._model.dof_armature[self._dofs] = armature
        self._model.dof_damping[self._dofs] = damping

    def reset(self, position: Array, speed: Array) -> None:
        """Start anew from angles (rad) and speeds (rad/s)."""
        self._data.qpos[self._all_places] = position @ self._ratios + self._offsets
        self._data.qvel[self._all_dofs] = speed @ self._ratios
        self._data.qacc_warmstart[:] = 0.0
        self._mujoco.mj_forward(self._model, self._data)

    def free_inertia(self) -> Array:
        """J, kg·m²: what a torque at a joint accelerates in this pose while the others are free, armature included."""
        inverse = np.empty((self._model.nv, self._model.nv))
        self._mujoco.mj_solveM(self._model, self._data, inverse, np.eye(self._model.nv))
        torques: Array = 1.0 / np.diag(inverse)[self._dofs]
        return torques

    def body_torques(self) -> tuple[Array, Array]:
        """J each, N·m: torque of the bodies at rest in this pose, and what motion adds to it."""
        mujoco, model, still = self._mujoco, self._model, self._still
        gravity, moving = np.empty(model.nv), np.empty(model.nv)
        still.qpos[:] = self._data.qpos
        mujoco.mj_fwdPosition(model, still)
        mujoco.mj_rne(model, still, 0, gravity)
        mujoco.mj_rne(model, self._data, 1, moving)
        dofs = self._all_dofs
        return self._ratios @ gravity[dofs], self._ratios @ (moving - gravity)[dofs]

    def advance(self, torque: Array, dry: Array) -> None:
        """One step under torques (J, N·m) and limits of dry friction (J, N·m)."""
        self._data.qfrc_applied[self._dofs] = torque
        self._model.dof_frictionloss[self._dofs] = dry
        self._mujoco.mj_step(self._model, self._data)
