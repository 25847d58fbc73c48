"""A robot simulated forward by MuJoCo: its rigid bodies, with armature, damping and dry friction of each joint."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from nmt_robots.model.robot_model import Array, RobotModel, compiled, mujoco_library


class RobotSimulation:
    """The named joints of a robot in motion; all others and a base that floats stand still.

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
        model = self._model = compiled(mujoco, robot.path, robot.text, names)
        model.opt.timestep = step_s
        model.opt.integrator = int(mujoco.mjtIntegrator.mjINT_IMPLICITFAST)
        flags = mujoco.mjtDisableBit
        model.opt.disableflags |= int(flags.mjDSBL_CONTACT | flags.mjDSBL_LIMIT | flags.mjDSBL_AUTORESET)
        model.opt.disableflags &= ~int(flags.mjDSBL_FRICTIONLOSS)
        model.dof_solref[:] = (2.0 * step_s, 1.0)
        numbers = [mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name) for name in names]
        self._places, self._dofs = model.jnt_qposadr[numbers], model.jnt_dofadr[numbers]
        for name, factor in (heavier or {}).items():
            model.body_mass[model.jnt_bodyid[numbers[list(names).index(name)]]] *= factor
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
        self._data.qpos[self._places] = position
        self._data.qvel[self._dofs] = speed
        self._data.qacc_warmstart[:] = 0.0
        self._mujoco.mj_forward(self._model, self._data)

    def body_torques(self) -> tuple[Array, Array]:
        """J each, N·m: torque of the bodies at rest in this pose, and what motion adds to it."""
        mujoco, model, still = self._mujoco, self._model, self._still
        gravity, moving = np.empty(model.nv), np.empty(model.nv)
        still.qpos[:] = self._data.qpos
        mujoco.mj_fwdPosition(model, still)
        mujoco.mj_rne(model, still, 0, gravity)
        mujoco.mj_rne(model, self._data, 1, moving)
        return gravity[self._dofs], (moving - gravity)[self._dofs]

    def advance(self, torque: Array, dry: Array) -> None:
        """One step under torques (J, N·m) and limits of dry friction (J, N·m)."""
        self._data.qfrc_applied[self._dofs] = torque
        self._model.dof_frictionloss[self._dofs] = dry
        self._mujoco.mj_step(self._model, self._data)
