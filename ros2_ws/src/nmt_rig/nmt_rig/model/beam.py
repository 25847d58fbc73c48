"""Beam of Euler-Bernoulli elements; its cantilever is the specimen of the virtual experiment (paper section 3)."""

from __future__ import annotations

from typing import Literal

import numpy as np

from nmt_rig.model.structure import Array, Structure

Boundary = Literal["clamped-free", "clamped-clamped", "clamped-pinned", "pinned-pinned", "free-free"]
"""Ends of a beam, left and right."""


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


def euler_bernoulli_beam(
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
    boundary: Boundary = "clamped-free",
    suspension_stiffness: float = 0.0,
    suspension_damping: float = 0.0,
) -> Structure:
    """Uniform beam that bends over its `height`, in one piece from the left end to the right.

    Points are the ends of `elements` equal parts of the length that move, numbered from the left: the left end of a
    free-free beam is point 1, of all others the end of the first part is.

    Args:
        length: m.
        width: m, across the bending direction.
        height: m, in the bending direction.
        youngs_modulus: Pa.
        density: kg/m³.
        elements: number of equal parts between points, at least 1.
        stiffness_damping: beta in C = beta K of the beam (without the clamp's springs), s.
        refinement: finite elements a part.
        clamp_rotational_stiffness: N m/rad of each clamp; None = rigid.
        clamp_lateral_stiffness: N/m of each clamp; None = rigid.
        boundary: left and right end.
        suspension_stiffness, suspension_damping: soft springs (N/m) and dampers (N s/m) that carry the two ends of a
            free-free beam; 0 = none, with two rigid-body modes at zero frequency.

    Returns:
        Structure with the free degrees of freedom (lateral displacement, rotation) node by node; its base load is that
        of all supports moving together.

    Raises:
        ValueError: a dimension that is not positive, negative damping or suspension, fewer than two parts between two
            supports, or springs of an end that the beam does not have.
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
    for name, value in (("suspension_stiffness", suspension_stiffness), ("suspension_damping", suspension_damping)):
        if not value >= 0:
            raise ValueError(f"{name} must not be negative, got {value}")
        if value and boundary != "free-free":
            raise ValueError(f"{name} belongs to a free-free beam; this one is {boundary}")
    if "clamped" not in boundary and (clamp_rotational_stiffness or clamp_lateral_stiffness):
        raise ValueError(f"a {boundary} beam has no clamp; leave out the clamp's stiffness")
    ends = boundary.split("-")
    if "free" not in ends and elements < 2:
        raise ValueError(f"a {boundary} beam needs at least 2 elements to have a point that moves, got {elements}")
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
    fixed = set()
    for end, lateral in zip(ends, (0, n - 2), strict=True):
        if end == "clamped":
            for index, spring in ((lateral, clamp_lateral_stiffness), (lateral + 1, clamp_rotational_stiffness)):
                stiffness[index, index] += spring or 0.0
                if spring is None:
                    fixed.add(index)
        elif end == "pinned":
            fixed.add(lateral)
        stiffness[lateral, lateral] += suspension_stiffness
        damping[lateral, lateral] += suspension_damping
    free = [index for index in range(n) if index not in fixed]
    kept = np.ix_(free, free)
    place = {index: position for position, index in enumerate(free)}
    nodes = range(0 if boundary == "free-free" else 1, elements + 1 if ends[1] == "free" else elements)
    points = {number: place[2 * node * refinement] for number, node in enumerate(nodes, start=1)}
    rotations = {number: index + 1 for number, index in points.items()}
    translation = np.zeros(n)
    translation[0::2] = 1.0
    return Structure(
        mass[kept].copy(),
        damping[kept].copy(),
        stiffness[kept].copy(),
        points,
        rotations,
        base_load=(mass @ translation)[free],
    )
