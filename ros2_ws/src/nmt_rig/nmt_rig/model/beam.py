"""Beam of Euler-Bernoulli elements; its cantilever is the specimen of the virtual experiment (paper section 3)."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
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


@dataclass(frozen=True)
class Supports:
    """What holds the ends of a beam besides its boundary.

    Attributes:
        clamp_rotational_stiffness: N m/rad of each clamp; None = rigid.
        clamp_lateral_stiffness: N/m of each clamp; None = rigid.
        suspension_stiffness, suspension_damping: soft springs (N/m) and dampers (N s/m) that carry the two ends of a
            free-free beam; 0 = none, with two rigid-body modes at zero frequency.
    """

    clamp_rotational_stiffness: float | None = None
    clamp_lateral_stiffness: float | None = None
    suspension_stiffness: float = 0.0
    suspension_damping: float = 0.0

    def check(self, boundary: Boundary) -> None:
        """Refuse what is not positive, and what a beam with these ends does not have.

        Raises:
            ValueError: with the name of the setting.
        """
        for name in ("clamp_rotational_stiffness", "clamp_lateral_stiffness"):
            clamp = getattr(self, name)
            if clamp is not None and not clamp > 0:
                raise ValueError(f"{name} must be positive, got {clamp}")
        for name in ("suspension_stiffness", "suspension_damping"):
            value = getattr(self, name)
            if not value >= 0:
                raise ValueError(f"{name} must not be negative, got {value}")
            if value and boundary != "free-free":
                raise ValueError(f"{name} belongs to a free-free beam; this one is {boundary}")
        if "clamped" not in boundary and (self.clamp_rotational_stiffness or self.clamp_lateral_stiffness):
            raise ValueError(f"a {boundary} beam has no clamp; leave out the clamp's stiffness")


RIGID = Supports()
"""Rigid clamps, and nothing that carries a free-free beam."""


def euler_bernoulli_beam(
    length: float,
    width: float,
    height: float,
    youngs_modulus: float,
    density: float,
    elements: int,
    stiffness_damping: float = 0.0,
    refinement: int = 1,
    boundary: Boundary = "clamped-free",
    supports: Supports = RIGID,
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
        boundary: left and right end.
        supports: springs and dampers at the ends.

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
    ):
        if not value > 0:
            raise ValueError(f"{name} must be positive, got {value}")
    if not stiffness_damping >= 0:
        raise ValueError(f"stiffness_damping must not be negative, got {stiffness_damping}")
    supports.check(boundary)
    ends = boundary.split("-")
    if "free" not in ends and elements < 2:
        raise ValueError(f"a {boundary} beam needs at least 2 elements to have a point that moves, got {elements}")
    inertia = width * height**3 / 12.0
    mass_e, stiffness_e = element_matrices(
        length / (elements * refinement), youngs_modulus * inertia, density * width * height
    )
    mass, stiffness = _chain_of(mass_e, stiffness_e, elements * refinement)
    damping = stiffness_damping * stiffness
    fixed = _held(ends, supports, stiffness, damping)
    free = [index for index in range(mass.shape[0]) if index not in fixed]
    kept = np.ix_(free, free)
    place = {index: position for position, index in enumerate(free)}
    nodes = range(0 if boundary == "free-free" else 1, elements + 1 if ends[1] == "free" else elements)
    points = {number: place[2 * node * refinement] for number, node in enumerate(nodes, start=1)}
    rotations = {number: index + 1 for number, index in points.items()}
    translation = np.zeros(mass.shape[0])
    translation[0::2] = 1.0
    return Structure(
        mass[kept].copy(),
        damping[kept].copy(),
        stiffness[kept].copy(),
        points,
        rotations,
        base_load=(mass @ translation)[free],
    )


def _chain_of(mass_e: Array, stiffness_e: Array, count: int) -> tuple[Array, Array]:
    """Mass and stiffness of equal elements in a row."""
    n = 2 * (count + 1)
    mass, stiffness = np.zeros((n, n)), np.zeros((n, n))
    for e in range(count):
        dofs = slice(2 * e, 2 * e + 4)
        mass[dofs, dofs] += mass_e
        stiffness[dofs, dofs] += stiffness_e
    return mass, stiffness


def _held(ends: Collection[str], supports: Supports, stiffness: Array, damping: Array) -> set[int]:
    """Degrees of freedom that the ends hold rigidly; springs and dampers of the supports are added in place."""
    fixed = set()
    for end, lateral in zip(ends, (0, stiffness.shape[0] - 2), strict=True):
        if end == "clamped":
            springs = supports.clamp_lateral_stiffness, supports.clamp_rotational_stiffness
            for index, spring in enumerate(springs, start=lateral):
                stiffness[index, index] += spring or 0.0
                if spring is None:
                    fixed.add(index)
        elif end == "pinned":
            fixed.add(lateral)
        stiffness[lateral, lateral] += supports.suspension_stiffness
        damping[lateral, lateral] += supports.suspension_damping
    return fixed
