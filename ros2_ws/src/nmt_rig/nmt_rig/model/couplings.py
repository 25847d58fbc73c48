"""Forces that depend on two observed quantities: varying force factor, Bouc-Wen and LuGre friction, slack sliders.

A coupling enters the system as M q̈ + C q̇ + K q + column · f(y₁, y₂) = b · input. What it observes are rows of
displacements and velocities. Friction with an internal state keeps it as an unknown of the system without inertia.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nmt_core.numerics.kernels import njit
from nmt_rig.model.structure import Array

FORCE_FACTOR = 1
BOUC_WEN = 2
LUGRE = 3
YIELD = 4
SLACK = 5
COUPLING_PARAMETERS = 4


@dataclass(frozen=True)
class Coupling:
    """One force of two arguments.

    Attributes:
        kind: FORCE_FACTOR: `force_factor`; BOUC_WEN: `bouc_wen` of (v, z); LUGRE: `lugre` of (v, z);
            YIELD: `yielding` of (v, z); SLACK: `slack` of z.
        column: (n,) rows of the system it acts on.
        displacement_rows, velocity_rows: (2, n) y = displacement_rows · q + velocity_rows · q̇.
        parameters: (COUPLING_PARAMETERS,) in the order of the formula, zeros behind.
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


Slopes = tuple[float, float, float]


@njit(cache=True, forceinline=True)
def force_factor(factor: float, linear: float, quadratic: float, x: float, y: float) -> Slopes:
    """G (b₁ x + b₂ x²) y with G, b₁, b₂."""
    share = x * (linear + quadratic * x)
    return factor * share * y, factor * (linear + 2.0 * quadratic * x) * y, factor * share


@njit(cache=True, forceinline=True)
def bouc_wen(yield_displacement: float, exponent: float, shape: float, v: float, z: float) -> Slopes:
    """v |z / z_y|ⁿ (b sign(v z) + 1 - b) with z_y, n, b."""
    reach = abs(z) / yield_displacement
    side = 1.0 if v * z > 0.0 else -1.0
    weight = shape * side + 1.0 - shape
    power = reach**exponent
    by_z = 0.0
    if z != 0.0:
        by_z = v * weight * exponent * power / z
    return v * power * weight, power * weight, by_z


@njit(cache=True, forceinline=True)
def lugre(stiffness: float, coulomb: float, static: float, stribeck: float, v: float, z: float) -> Slopes:
    """σ₀ |v| z / s(v), s = F_C + (F_S - F_C) exp(-(v / v_S)²), with σ₀, F_C, F_S, v_S."""
    ratio = v / stribeck
    bump = (static - coulomb) * np.exp(-ratio * ratio)
    level = coulomb + bump
    side = 1.0 if v > 0.0 else -1.0
    f = stiffness * abs(v) * z / level
    by_v = stiffness * z / level * (side + abs(v) * bump * 2.0 * ratio / (stribeck * level))
    return f, by_v, stiffness * abs(v) / level


_YIELDS_OVER = 0.01  # of the reach: a rate that jumped would have no tangent


@njit(cache=True, forceinline=True)
def yielding(reach: float, v: float, z: float) -> Slopes:
    """v where z is at its reach and v would take it further, 0 else; a straight line over the last percent."""
    side = 1.0 if v > 0.0 else -1.0
    share = (side * z / reach - 1.0) / _YIELDS_OVER + 1.0
    if share <= 0.0:
        return 0.0, 0.0, 0.0
    return v * share, share, v * side / (_YIELDS_OVER * reach)


@njit(cache=True, forceinline=True)
def slack(stiffness: float, gap: float, z: float) -> Slopes:
    """k (z ∓ g) beyond ±g with k, g."""
    side = 1.0 if z > 0.0 else -1.0
    beyond = side * z - gap
    if beyond <= 0.0:
        return 0.0, 0.0, 0.0
    return side * stiffness * beyond, stiffness, 0.0


@njit(cache=True)
def coupling_response(kind: int, p: Array, first: float, second: float) -> Slopes:
    """f, ∂f/∂y₁ and ∂f/∂y₂ of one coupling.

    Args:
        kind: code of the coupling.
        p: (COUPLING_PARAMETERS,) parameters.
        first, second: y₁ and y₂.
    """
    result: Slopes = 0.0, 0.0, 0.0
    if kind == FORCE_FACTOR:
        result = force_factor(p[0], p[1], p[2], first, second)
    elif kind == BOUC_WEN:
        result = bouc_wen(p[0], p[1], p[2], first, second)
    elif kind == LUGRE:
        result = lugre(p[0], p[1], p[2], p[3], first, second)
    elif kind == YIELD:
        result = yielding(p[0], first, second)
    elif kind == SLACK:
        result = slack(p[0], p[1], first)
    return result
