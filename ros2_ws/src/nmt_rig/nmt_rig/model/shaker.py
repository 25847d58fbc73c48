"""Electrodynamic shaker: coil current, coil and table (paper section 3; parameters of a B&K 4808)."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np


@dataclass(frozen=True)
class ElectrodynamicShaker:
    """Voltage-driven shaker whose table is joined to the structure by a rigid stinger.

    The table rests on (table_stiffness, table_damping); the coil is carried by the table through
    (coil_stiffness, coil_damping) and driven by force_factor · current. Electrical side:
    L di/dt + R i + G ẋ_C = u.

    Where force_factor_linear or force_factor_quadratic is not zero, G varies with the coil's displacement:
    G (1 + b₁ x_C + b₂ x_C²), in the force as in the induced voltage.

    Units: kg, N/m, N s/m, N/A (equal to V s/m), H, Ω, 1/m, 1/m².

    Raises:
        ValueError: a parameter that is not finite; a mass, force factor, coil stiffness, inductance or
            resistance that is not positive; any other that is negative.
    """

    table_mass: float
    table_stiffness: float
    table_damping: float
    coil_mass: float
    coil_stiffness: float
    coil_damping: float
    force_factor: float
    inductance: float
    resistance: float
    force_factor_linear: float = 0.0
    force_factor_quadratic: float = 0.0

    def __post_init__(self) -> None:
        strictly = {"table_mass", "coil_mass", "coil_stiffness", "force_factor", "inductance", "resistance"}
        for entry in fields(self):
            value = getattr(self, entry.name)
            if not np.isfinite(value):
                raise ValueError(f"shaker: {entry.name} must be finite, got {value}")
            if entry.name in strictly and not value > 0:
                raise ValueError(f"shaker: {entry.name} must be positive, got {value}")
            if not value >= 0 and not entry.name.startswith("force_factor_"):
                raise ValueError(f"shaker: {entry.name} must not be negative, got {value}")

    @property
    def moving_mass(self) -> float:
        """Mass that moves with the drive point: table and coil (kg)."""
        return self.table_mass + self.coil_mass
