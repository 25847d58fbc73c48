"""A pendulum as MJCF and logs of it in closed form: motion is prescribed, torque follows from it."""

from __future__ import annotations

import math
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from nmt_robots.verdict.robot_diagnosis import RobotDiagnosis

MASS, LENGTH, INERTIA = 1.2, 0.3, 0.02
GRAVITY = 9.81
XML = f"""<mujoco model="pendulum">
  <compiler angle="radian"/>
  <worldbody>
    <body name="arm">
      <inertial pos="0 0 {-LENGTH}" mass="{MASS}" diaginertia="{INERTIA} {INERTIA} {INERTIA}"/>
      <joint name="elbow" type="hinge" axis="0 1 0" range="-3 3" ARMATURE/>
      <geom type="mesh" mesh="absent"/>
    </body>
  </worldbody>
  <asset><mesh name="absent" file="absent.stl"/></asset>
  <actuator><motor joint="elbow" ctrlrange="-40 40"/></actuator>
</mujoco>
"""


def robot_file(folder: Path, armature: float = 0.03, damping: float = 0.2, coulomb: float = 0.5) -> Path:
    """The pendulum's file."""
    path = folder / "pendulum.xml"
    words = f'armature="{armature}" damping="{damping}" frictionloss="{coulomb}"'
    path.write_text(XML.replace("ARMATURE", words))
    return path


def rigid_torque(q: Any, a: Any) -> Any:
    """Closed form."""
    return (INERTIA + MASS * LENGTH**2) * a + MASS * GRAVITY * LENGTH * np.sin(q)


def log_columns(
    armature: float = 0.03, damping: float = 0.2, coulomb: float = 0.5, held: int = 1, lag_s: float = 0.0,
    rate_hz: float = 500.0, noise: float = 1e-5, more: Any = None,
) -> dict[str, Any]:  # fmt: skip
    """A log of 24 s whose command is what a drive with known gains needs for the motion.

    Args:
        armature, damping, coulomb: of the real joint.
        held: rows that the logged command, and the drive, keep a value.
        lag_s: by how much the drive has its command later than the log.
        rate_hz: of the rows.
        noise: of the position, rad.
        more: further torque of q, v.
    """
    columns = _columns(armature, damping, coulomb, held, lag_s, rate_hz, noise, more)
    return {name: values.copy() for name, values in columns.items()}


@cache
def _columns(
    armature: float, damping: float, coulomb: float, held: int, lag_s: float, rate_hz: float, noise: float, more: Any
) -> dict[str, Any]:
    """Of :func:`log_columns`, simulated once."""
    fine = 4
    time = np.arange(int(24.0 * rate_hz * fine)) / (rate_hz * fine)
    phase = 2.0 * np.pi * (0.2 * time + 0.5 * 0.05 * time**2)
    kp, kd = 60.0, 1.5
    command = 0.4 + 0.5 * np.sin(phase) + 0.15 * np.sin(0.37 * phase + 1.0)
    step = held * fine
    drive = command[(np.arange(len(time)) // step) * step]
    shift = round(lag_s * rate_hz * fine)
    late = np.r_[np.full(shift, drive[0]), drive[: len(drive) - shift]] if shift else drive
    q, v = _simulated(time, late, kp, kd, armature, damping, coulomb, more)
    rng = np.random.default_rng(7)
    rows = slice(None, None, fine)
    position = q[rows] + noise * rng.standard_normal(len(q[rows]))
    return {
        "time": time[rows], "pos": position[:, None], "vel": v[rows][:, None], "des_pos": drive[rows][:, None],
        "kp": np.array([kp]), "kd": np.array([kd]),
    }  # fmt: skip


def _simulated(
    time: Any, command: Any, kp: float, kd: float, armature: float, damping: float, coulomb: float, more: Any
) -> tuple[Any, Any]:
    """Semi-implicit Euler; a joint that would change its direction within a step may stick instead."""
    step = time[1] - time[0]
    inertia = INERTIA + MASS * LENGTH**2 + armature
    q, v = np.empty(len(time)), np.empty(len(time))
    commanded, step = command.tolist(), float(step)
    angle, speed = commanded[0], 0.0
    torque = 0.0
    for row in range(len(time)):
        if row % 4 == 0:
            torque = kp * (commanded[row] - angle) - kd * speed
        q[row], v[row] = angle, speed
        others = torque - MASS * GRAVITY * LENGTH * math.sin(angle) - (more(angle, speed) if more else 0.0)
        free = speed + step * (others - damping * speed) / inertia
        limit = step * coulomb / inertia
        speed = math.copysign(max(abs(free) - limit, 0.0), free)
        angle += step * speed
    return q, v


_FOLDERS: list[TemporaryDirectory[str]] = []


@cache
def diagnosed_pendulum(**log: float) -> RobotDiagnosis:
    """The diagnosis of a log with these parameters by the pendulum's file, made once a process."""
    from nmt_robots.verdict.other_logs import diagnose_robot_by_logs

    _FOLDERS.append(TemporaryDirectory())
    folder = Path(_FOLDERS[-1].name)
    np.savez(folder / "log.npz", **log_columns(**log))  # type: ignore[arg-type]
    return diagnose_robot_by_logs(robot_file(folder), [folder / "log.npz"])
