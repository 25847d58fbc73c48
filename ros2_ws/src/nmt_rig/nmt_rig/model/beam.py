"""Cantilever of Euler-Bernoulli beam elements (the specimen of the virtual experiment, paper section 3)."""

from __future__ import annotations

import numpy as np

from nmt_rig.model.structure import Array, Structure


def element_matrices(length: float, bending_stiffness: float, mass_per_length: float) -> tuple[Array, Array]:
    """Consistent mass and stiffness matrix (4, 4) of a plane Euler-Bernoulli element.

    Degrees of freedom: lateral displacement and rotation of the first node, then of the second.

    Args:
        length: m.
        bending_stiffness: E I, N m².
        mass_per_length: rho A, kg/m.
    """
    a = length
    stiffness = (bending_stiffness / a**3) * np.array(
        [
            [12.0, 6 * a, -12.0, 6 * a],
            [6 * a, 4 * a * a, -6 * a, 2 * a * a],
            [-12.0, -6 * a, 12.0, -6 * a],
            [6 * a, 2 * a * a, -6 * a, 4 * a * a],
        ]
    )
    mass = (mass_per_length * a / 420.0) * np.array(
        [
            [156.0, 22 * a, 54.0, -13 * a],
            [22 * a, 4 * a * a, 13 * a, -3 * a * a],
            [54.0, 13 * a, 156.0, -22 * a],
            [-13 * a, -3 * a * a, -22 * a, 4 * a * a],
        ]
    )
    return mass, stiffness


def euler_bernoulli_cantilever(
    length: float,
    width: float,
    height: float,
    youngs_modulus: float,
    density: float,
    elements: int,
    stiffness_damping: float = 0.0,
    refinement: int = 1,
    clamp_rotational_stiffness: float | None = None,
    clamp_lateral_stiffness: float | None = None,
) -> Structure:
    """Clamped-free beam that bends over its `height`.

    Points 1..elements are the ends of equal parts of the length, from the clamp outward.

    Args:
        length: m.
        width: m, across the bending direction.
        height: m, in the bending direction.
        youngs_modulus: Pa.
        density: kg/m³.
        elements: number of equal parts between points, at least 1.
        stiffness_damping: beta in C = beta K of the beam (without the clamp's springs), s.
        refinement: finite elements a part.
        clamp_rotational_stiffness: N m/rad of a compliant clamp; None = rigid.
        clamp_lateral_stiffness: N/m of a compliant clamp; None = rigid.

    Returns:
        Structure with 2 degrees of freedom (lateral displacement, rotation) for each free node; those of a compliant
        clamp come first.

    Raises:
        ValueError: a dimension that is not positive, or negative damping.
    """
    for name, value in (
        ("length", length),
        ("width", width),
        ("height", height),
        ("youngs_modulus", youngs_modulus),
        ("density", density),
        ("elements", elements),
        ("refinement", refinement),
        ("clamp_rotational_stiffness", 1.0 if clamp_rotational_stiffness is None else clamp_rotational_stiffness),
        ("clamp_lateral_stiffness", 1.0 if clamp_lateral_stiffness is None else clamp_lateral_stiffness),
    ):
        if not value > 0:
            raise ValueError(f"{name} must be positive, got {value}")
    if not stiffness_damping >= 0:
        raise ValueError(f"stiffness_damping must not be negative, got {stiffness_damping}")
    inertia = width * height**3 / 12.0
    mass_e, stiffness_e = element_matrices(
        length / (elements * refinement), youngs_modulus * inertia, density * width * height
    )
    count = elements * refinement
    n = 2 * (count + 1)
    mass = np.zeros((n, n))
    stiffness = np.zeros((n, n))
    for e in range(count):
        dofs = slice(2 * e, 2 * e + 4)
        mass[dofs, dofs] += mass_e
        stiffness[dofs, dofs] += stiffness_e
    damping = stiffness_damping * stiffness
    springs = clamp_lateral_stiffness, clamp_rotational_stiffness
    for index, spring in enumerate(springs):
        stiffness[index, index] += spring or 0.0
    free = [index for index, spring in enumerate(springs) if spring is not None] + list(range(2, n))
    kept = np.ix_(free, free)
    offset = len(free) - n
    points = {node: 2 * node * refinement + offset for node in range(1, elements + 1)}
    rotations = {node: index + 1 for node, index in points.items()}
    return Structure(mass[kept].copy(), damping[kept].copy(), stiffness[kept].copy(), points, rotations)
