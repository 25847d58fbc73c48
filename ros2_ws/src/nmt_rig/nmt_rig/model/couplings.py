"""Forces that depend on two observed quantities: varying force factor, Bouc-Wen and LuGre friction.

A coupling enters the system as M q̈ + C q̇ + K q + column · f(y₁, y₂) = b · input. What it observes are rows of
displacements and velocities. Friction with an internal state keeps it as an unknown of the system without inertia.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nmt_rig.model.structure import Array

FORCE_FACTOR = 1
BOUC_WEN = 2
LUGRE = 3
COUPLING_PARAMETERS = 4


@dataclass(frozen=True)
class Coupling:
    """One force of two arguments.

    Attributes:
        kind: FORCE_FACTOR: G (b₁ y₁ + b₂ y₁²) y₂ with parameters G, b₁, b₂;
            BOUC_WEN: v |z / z_y|ⁿ (b sign(v z) + 1 - b) of (v, z) with z_y, n, b;
            LUGRE: σ₀ |v| z / s(v), s = F_C + (F_S - F_C) exp(-(v / v_S)²), of (v, z) with σ₀, F_C, F_S, v_S.
        column: (n,) rows of the system it acts on.
        displacement_rows, velocity_rows: (2, n) y = displacement_rows · q + velocity_rows · q̇.
        parameters: (COUPLING_PARAMETERS,) in the order above, zeros behind.
    """

    kind: int
    column: Array
    displacement_rows: Array
    velocity_rows: Array
    parameters: Array


def coupling_parameters(*values: float) -> Array:
    """(COUPLING_PARAMETERS,) with zeros behind the values."""
    result = np.zeros(COUPLING_PARAMETERS)
    result[: len(values)] = values
    return result
