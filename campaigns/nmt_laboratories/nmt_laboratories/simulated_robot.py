"""A robot in MuJoCo behind drives, encoders and a logger, with causes of a gap put into it.

The links are MuJoCo's. Friction is its constraint on a degree of freedom, whose limit is set anew in every step, so a
joint sticks as it should. A transmission that gives way has the motor as a state of its own, and the encoder is on it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np

Array = Any
STEP_S = 5e-4
SECONDS = 20.0


@dataclass(frozen=True)
class Cause:
    """What differs from the model, or what is wrong with the log.

    Attributes:
        name: of the cause.
        joint: its number; −1 = all.
        sizes: by name.
    """

    name: str
    joint: int
    sizes: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Chain:
    """Drive and logger.

    Attributes:
        drive_steps, log_steps: steps of the simulation between two of the drive and of the log.
        current_s: time constant of the current loop, s.
        speed_s: that of the filter of the logged speed, s.
        counts: of the encoder per turn.
        measured: whether a torque was measured.
        noise: of that torque, as a share of its standard deviation.
    """

    drive_steps: int
    log_steps: int
    current_s: float
    speed_s: float
    counts: float
    measured: bool
    noise: float


def robot_text(names: tuple[str, ...], axes: tuple[str, ...], links: list[dict[str, Any]]) -> str:
    """A chain of links as MJCF."""
    text, ends = "", ""
    for name, axis, link in zip(names, axes, links, strict=True):
        diagonal = " ".join(f"{x:.6g}" for x in link["inertia"])
        centre = " ".join(f"{x:.6g}" for x in link["centre"])
        text += (
            f'<body name="{name}_link" pos="0 0 {-link["before"]:.4g}">'
            f'<inertial pos="{centre}" mass="{link["mass"]:.6g}" diaginertia="{diagonal}"/>'
            f'<joint name="{name}" axis="{axis}" range="{-link["reach"]:g} {link["reach"]:g}" '
            f'armature="{link["armature"]:.6g}" damping="{link["damping"]:.6g}" '
            f'frictionloss="{link["coulomb"]:.6g}" solreffriction="0.002 1"/>'
        )
        ends += "</body>"
    return (
        '<mujoco model="laboratory"><compiler angle="radian"/>'
        f'<option timestep="{STEP_S}" integrator="implicitfast"/><worldbody>{text}{ends}</worldbody></mujoco>'
    )


def command_of(time_s: Array, centres: Array, rng: Any) -> Array:
    """Chirps to 4 Hz with a peak speed of at most 3 rad/s, and slow sines, out of phase between the joints; rad."""
    columns = []
    for joint, centre in enumerate(centres):
        rate = 0.1 + (0.19 + 0.01 * joint) * time_s
        phase = 2.0 * np.pi * np.cumsum(rate) * (time_s[1] - time_s[0])
        slow = 0.4 * np.sin(2.0 * np.pi * (0.13 + 0.04 * joint) * time_s + rng.uniform(0, 6))
        fade = np.minimum(0.4, 3.0 / (2.0 * np.pi * rate))
        columns.append(centre + slow + fade * np.sin(phase + rng.uniform(0, 6)))
    return np.column_stack(columns)


class Robot:
    """The robot as it is.

    Args:
        text: MJCF.
        causes: what is in it.
        gains: of the drives, kp and kd, as they are.
        chain: drive and logger.
    """

    def __init__(self, text: str, causes: list[Cause], gains: tuple[Array, Array], chain: Chain) -> None:
        self._model = mujoco.MjModel.from_xml_string(text)
        self._model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_LIMIT)
        self._data = mujoco.MjData(self._model)
        self._kp, self._kd = gains
        self._chain = chain
        self._coulomb = np.array(self._model.dof_frictionloss)
        self._by_name = {cause.name: cause for cause in causes}
        self._bristle = 0.0
        moved = [cause for cause in causes if cause.name in ("elastic", "backlash")]
        self._gives = moved[0] if moved else None
        if self._gives is not None:
            joint = self._gives.joint
            self._rotor = float(self._model.dof_armature[joint])
            self._rotor_damping = float(np.ravel(self._model.dof_damping[joint])[0])
            self._model.dof_armature[joint] = 0.0
            self._model.dof_damping[joint] = 0.02
            self._coulomb[joint] = 0.0
            self._rotor_coulomb = float(np.array(mujoco.MjModel.from_xml_string(text).dof_frictionloss)[joint])
            self._angle = self._speed = 0.0

    def run(self, command: Array) -> tuple[Array, Array, Array, Array]:
        """Encoder's angle and speed, torque in the joint and that the drive meant, N × J each, at every step."""
        chain, data, model = self._chain, self._data, self._model
        count, joints = command.shape
        q, v, acting_log, meant_log = (np.empty((count, joints)) for _ in range(4))
        data.qpos[:] = command[0]
        if self._gives is not None:
            self._angle = float(command[0, self._gives.joint])
        meant, acting = np.zeros(joints), np.zeros(joints)
        share = STEP_S / (chain.current_s + STEP_S)
        limit = self._limits(joints)
        for row in range(count):
            angle, speed = self._encoder()
            if row % chain.drive_steps == 0:
                meant = self._kp * (command[row] - angle) - self._kd * speed
            acting = acting + share * (np.clip(meant, -limit, limit) - acting)
            q[row], v[row], acting_log[row], meant_log[row] = angle, speed, acting, meant
            driven = acting if self._gives is None else self._transmitted(acting)
            self._friction(row * STEP_S, driven)
            data.qfrc_applied[:] = driven - self._further(row)
            mujoco.mj_step(model, data)
        return q, v, acting_log, meant_log

    def _limits(self, joints: int) -> Array:
        limit = np.full(joints, np.inf)
        if "saturation" in self._by_name:
            limit[self._by_name["saturation"].joint] = self._by_name["saturation"].sizes["limit"]
        return limit

    def _encoder(self) -> tuple[Array, Array]:
        angle, speed = self._data.qpos.copy(), self._data.qvel.copy()
        if self._gives is not None:
            angle[self._gives.joint], speed[self._gives.joint] = self._angle, self._speed
        return angle, speed

    def _transmitted(self, acting: Array) -> Array:
        """Torque on the links, with the motor's step."""
        assert self._gives is not None
        joint, sizes = self._gives.joint, self._gives.sizes
        twist = self._angle - float(self._data.qpos[joint])
        turning = self._speed - float(self._data.qvel[joint])
        half = 0.5 * sizes.get("gap", 0.0)
        beyond = twist - half if twist > half else twist + half if twist < -half else 0.0
        passed = sizes["stiffness"] * beyond + (sizes["damper"] * turning if beyond or half == 0.0 else 0.0)
        free = self._speed + STEP_S * (acting[joint] - passed - self._rotor_damping * self._speed) / self._rotor
        slowed = STEP_S * self._rotor_coulomb / self._rotor
        self._speed = float(np.sign(free) * max(abs(free) - slowed, 0.0))
        self._angle += STEP_S * self._speed
        driven = acting.copy()
        driven[joint] = passed
        return driven

    def _friction(self, time_s: float, driven: Array) -> None:
        """Set the limits of dry friction for the next step."""
        limits = self._coulomb.copy()
        for name, cause in self._by_name.items():
            joint, sizes = cause.joint, cause.sizes
            v, q = float(self._data.qvel[joint]), float(self._data.qpos[joint])
            if name == "stribeck":
                limits[joint] *= 1.0 + sizes["excess"] * np.exp(-((v / sizes["speed"]) ** 2))
            elif name == "load_friction":
                limits[joint] += sizes["share"] * abs(driven[joint])
            elif name == "efficiency":
                lost = 1.0 - sizes["eta"] if driven[joint] * v > 0.0 else 1.0 / sizes["eta"] - 1.0
                limits[joint] += lost * abs(driven[joint])
            elif name == "temperature":
                limits[joint] += sizes["friction"] * np.exp(-time_s / 6.0)
            elif name == "band":
                limits[joint] += sizes["friction"] * float(np.sin(3.0 * q + 1.0) > 0.5)
        self._model.dof_frictionloss[:] = limits

    def _further(self, row: int) -> Array:
        """Torques that act against the drive beside friction."""
        torque = np.zeros(self._model.nv)
        for name, cause in self._by_name.items():
            joint, sizes = cause.joint, cause.sizes
            q = float(self._data.qpos[joint])
            if name == "spring":
                torque[joint] += sizes["stiffness"] * (q - sizes["rest"])
            elif name == "ripple":
                torque[joint] += sizes["torque"] * np.sin(sizes["order"] * q + 0.7)
            elif name == "end_stop":
                torque[joint] += sizes["stiffness"] * max(q - sizes["angle"], 0.0)
            elif name == "hose":
                step = sizes["stiffness"] * float(self._data.qvel[joint]) * STEP_S
                self._bristle = float(np.clip(self._bristle + step, -sizes["torque"], sizes["torque"]))
                torque[joint] += self._bristle
        return torque


def logged(
    motion: tuple[Array, Array, Array, Array], command: Array, chain: Chain, causes: list[Cause], rng: Any
) -> dict[str, Array]:
    """What the logger makes of it: time, q, dq, q_des and, where it was measured, tau."""
    q, v, acting, meant = motion
    by_name = {cause.name: cause for cause in causes}
    count, joints = q.shape
    rows = np.arange(0, count, chain.log_steps)
    if "clock_jitter" in by_name:
        room = by_name["clock_jitter"].sizes["share"] * chain.log_steps
        rows = rows + np.rint(rng.uniform(-room, room, len(rows))).astype(int)
    if "clock_alternating" in by_name:
        rows = rows + np.where(np.arange(len(rows)) % 2, max(1, chain.log_steps // 4), 0)
    rows = np.clip(rows, 0, count - 1)
    time = np.arange(len(rows)) * chain.log_steps * STEP_S
    if "clock_factor" in by_name:
        time = time * by_name["clock_factor"].sizes["factor"]
    filter_s = by_name["speed_filter"].sizes["time"] if "speed_filter" in by_name else chain.speed_s
    speed = np.empty_like(v)
    state, share = v[0], STEP_S / (filter_s + STEP_S)
    for row in range(count):
        state = state + share * (v[row] - state)
        speed[row] = state
    late = round(by_name["measurement_late"].sizes["delay"] / STEP_S) if "measurement_late" in by_name else 0
    motion_rows = np.clip(rows - late, 0, count - 1)
    step = 2.0 * np.pi / chain.counts
    columns = {
        "q": np.round(q[motion_rows] / step) * step,
        "dq": speed[motion_rows] + 0.003 * rng.standard_normal((len(rows), joints)),
        "q_des": command[rows],
        "tau": acting[rows] + chain.noise * np.std(acting, axis=0) * rng.standard_normal((len(rows), joints)),
    }
    if "torque_is_law" in by_name:
        columns["tau"] = meant[rows]
    if "torque_constant" in by_name:
        columns["tau"][:, by_name["torque_constant"].joint] /= by_name["torque_constant"].sizes["factor"]
    return {"time": time, **_spoiled(columns, by_name, rng)} if "rows_dropped" not in by_name else _dropped(
        {"time": time, **columns}, by_name["rows_dropped"].sizes["share"], rng
    )  # fmt: skip


def _dropped(columns: dict[str, Array], share: float, rng: Any) -> dict[str, Array]:
    """Rows left out, on a clock that says nothing of it."""
    kept = rng.uniform(size=len(columns["time"])) > share
    time = columns["time"][: int(np.count_nonzero(kept))]
    return {name: values[kept] for name, values in columns.items()} | {"time": time}


def _spoiled(columns: dict[str, Array], by_name: dict[str, Cause], rng: Any) -> dict[str, Array]:
    """Columns with the faults of a logger that has rows, order, sign or unit wrong."""
    motion = ("q", "dq", "q_des", "tau")
    if "rows_repeated" in by_name:
        again = np.flatnonzero(rng.uniform(size=len(columns["q"])) < by_name["rows_repeated"].sizes["share"])
        for row in again[again > 0]:
            for name in ("q", "dq", "tau"):
                columns[name][row] = columns[name][row - 1]
    if "joint_sign" in by_name:
        for name in motion:
            columns[name][:, by_name["joint_sign"].joint] *= -1.0
    if "speed_sign" in by_name:
        columns["dq"][:, by_name["speed_sign"].joint] *= -1.0
    if "order" in by_name:
        order = np.arange(columns["q"].shape[1])
        order[[-2, -1]] = order[[-1, -2]]
        columns |= {name: columns[name][:, order] for name in motion}
    if "speed_degrees" in by_name:
        columns["dq"] = np.degrees(columns["dq"])
    if "degrees" in by_name:
        columns |= {name: np.degrees(columns[name]) for name in ("q", "dq", "q_des")}
    if "wrap" in by_name:
        joint = by_name["wrap"].joint
        for name in ("q", "q_des"):
            columns[name][:, joint] = (columns[name][:, joint] + np.pi) % (2.0 * np.pi) - np.pi
    return columns
