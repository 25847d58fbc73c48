"""A log of joints as arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

Array = np.ndarray[Any, Any]


@dataclass(frozen=True, eq=False)
class JointLog:
    """What was logged of J joints in N rows.

    Attributes:
        source: file.
        joints: names, one for each column.
        time: N, s, as the log has it.
        position: N × J, rad (m of a slide).
        velocity: N × J, rad/s; None where it was not logged.
        position_command: N × J, rad; None without one.
        velocity_command: N × J, rad/s; None = zero.
        torque_command: N × J, N·m, added by the drive to its control law; None = zero.
        torque: N × J, N·m, measured; None where it follows from the control law.
        position_gain, velocity_gain: J, N·m/rad and N·m·s/rad; None where they are not known.
        position_units: of each joint, as the log was stated to have its positions; empty where nothing was stated.
        notes: sentences on how it was read.
    """

    source: str
    joints: tuple[str, ...]
    time: Array
    position: Array
    velocity: Array | None = None
    position_command: Array | None = None
    velocity_command: Array | None = None
    torque_command: Array | None = None
    torque: Array | None = None
    position_gain: Array | None = None
    velocity_gain: Array | None = None
    position_units: tuple[str, ...] = ()
    notes: tuple[str, ...] = field(default=())

    @property
    def rows(self) -> int:
        """N."""
        return len(self.time)

    @property
    def step_s(self) -> float:
        """Mean time between rows, s."""
        return float(self.time[-1] - self.time[0]) / (self.rows - 1)

    @property
    def is_arithmetic(self) -> bool:
        """Whether the torque is computed by the control law, because none was measured."""
        return self.torque is None


def control_law(terms: Sequence[Array], torque: Array) -> tuple[float, Array]:
    """Whether a torque is a sum of terms and a constant, each N × J.

    Returns:
        Share that the sum leaves of it, the median of the joints, infinite where none has one; coefficients J × K.
    """
    left, gains = [], np.zeros((torque.shape[1], len(terms)))
    for joint, acting in enumerate(torque.T):
        matrix = np.column_stack([*(term[:, joint] for term in terms), np.ones(len(acting))])
        size = float(np.std(acting))
        if size > 0.0 and np.all(np.isfinite(matrix)):
            solution = np.linalg.lstsq(matrix, acting, rcond=None)[0]
            left.append(float(np.std(acting - matrix @ solution)) / size)
            gains[joint] = solution[:-1]
    return float(np.median(left)) if left else float("inf"), gains
