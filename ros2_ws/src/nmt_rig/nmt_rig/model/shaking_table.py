"""Shaking table: moves all supports of a structure together; its input is the acceleration it is asked for.

In motion relative to the table, M q̈ + C q̇ + K q + g = -p a with the table's acceleration a and the structure's
base load p (Chopra, Dynamics of Structures, section 13.1). The table is controlled or heavy: the structure does not act
back on it. Between the acceleration asked for, u, and a there may be

* a bandwidth, τ ẏ + y = u, τ = 1 / ω_b, and
* a suspension that centres the table, ẍ + 2 ζ ω_t ẋ + ω_t² x = y: a follows y far above ω_t only.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from nmt_rig.model.exciter import OutputRow
from nmt_rig.model.structure import Array, Structure


@dataclass(frozen=True)
class ShakingTable:
    """Table model and what is measured of it.

    Attributes:
        effective_mass: m_e of the force that stands for the base acceleration at the drive point, -m_e a, kg; negative
            where the mode moves against the table there.
        bandwidth: ω_b, rad/s; None = unlimited.
        suspension: ω_t, rad/s; None = free (its position is not modelled then).
        suspension_damping: ζ of the suspension.
        absolute: sensors see the motion of the table plus that relative to it; else the relative motion.

    Raises:
        ValueError: a value that is not finite or out of range.
    """

    effective_mass: float
    bandwidth: float | None = None
    suspension: float | None = None
    suspension_damping: float = 0.7
    absolute: bool = False

    def __post_init__(self) -> None:
        if not np.isfinite(self.effective_mass) or self.effective_mass == 0.0:
            raise ValueError(f"shaking table: effective_mass must be finite and not zero, got {self.effective_mass}")
        for name in ("bandwidth", "suspension"):
            value = getattr(self, name)
            if value is not None and not (np.isfinite(value) and value > 0.0):
                raise ValueError(f"shaking table: {name} must be positive, got {value}")
        if not (np.isfinite(self.suspension_damping) and self.suspension_damping >= 0.0):
            raise ValueError(f"shaking table: suspension_damping must not be negative, got {self.suspension_damping}")


@dataclass(frozen=True)
class BaseMotion:
    """Motion of the table among the outputs of a system.

    Attributes:
        acceleration: a as an output, m/s².
        index: unknown x of the table's position, None without a suspension.
        weights: point number -> share of the table's motion that a sensor there sees next to q.
    """

    acceleration: OutputRow
    index: int | None
    weights: dict[int, float]

    def moved(self, place: Array, size: int) -> BaseMotion:
        """The same among `size` unknowns, old unknown i being the new one place[i]."""
        index = None if self.index is None else int(place[self.index])
        return replace(self, acceleration=self.acceleration.moved(place, size), index=index)


def effective_mass(structure: Structure, shape: Array, drive_point: int) -> float:
    """m_e = φᵀ p / φ_d, kg: a force -m_e a at the drive point does the power on mode φ that the moving base does.

    Args:
        structure: with a base load.
        shape: (n,) mode shape, of any scale.
        drive_point: point d.

    Raises:
        ValueError: the structure has no base load, or the base does not excite the mode, or d is a node of it.
    """
    if structure.base_load is None:
        raise ValueError("the structure does not say how its base excites it")
    at_drive = float(structure.selector(drive_point) @ shape)
    load = float(structure.base_load @ shape)
    own_points = max((abs(float(structure.motion(p, shape))) for p in structure.point_numbers), default=0.0)
    modal_mass = float(shape @ structure.mass @ shape)
    if abs(at_drive) <= 1e-6 * own_points:
        raise ValueError(f"point {drive_point} is a node of the mode")
    if load * load <= 1e-12 * modal_mass * float(np.trace(structure.mass)):
        raise ValueError("a motion of the base does not excite the mode")
    return load / at_drive
