"""Structures as a user's script assembles them: chains, rods, beams, membranes, plates, lumped or consistent mass."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.linalg import eigh

Array = NDArray[np.float64]
FIRST_HZ = 20.0
"""First frequency that the stiffness of each structure is scaled to."""
_KILOGRAMS = 2.0
_LENGTH_M = 0.6
_POISSON = 0.3


@dataclass(frozen=True)
class ElementStructure:
    """A structure that is held at one end or all around.

    Attributes:
        kind: chain, rod, beam, membrane or plate.
        elements: along each side.
        lumped: mass at the nodes, none on rotations.
    """

    kind: str
    elements: int
    lumped: bool

    @property
    def name(self) -> str:
        return f"{self.kind}_{self.elements}_{'lumped' if self.lumped else 'consistent'}"

    def matrices(self) -> tuple[Any, Any, NDArray[np.int64]]:
        """Mass (kg), stiffness (N/m), node and direction of each row; what is held is left out."""
        mass, stiffness, rows = _ASSEMBLED[self.kind](self.elements, self.lumped)
        mass, stiffness = sparse.csr_matrix(mass), sparse.csr_matrix(stiffness)
        n = mass.shape[0]
        # Of the inverse problem, in which rows without mass are no trouble.
        (largest,) = eigh(mass.toarray(), stiffness.toarray(), subset_by_index=[n - 1, n - 1], eigvals_only=True)
        return mass, stiffness * ((2.0 * np.pi * FIRST_HZ) ** 2 * largest), np.array(rows, dtype=np.int64)

    def write(self, folder: Path) -> Path:
        """Matrices and a rig of two points, with an ideal force at the first; returns the rig file."""
        mass, stiffness, rows = self.matrices()
        arrays: dict[str, Any] = {"rows": rows}
        for name, matrix in (("M", mass), ("K", stiffness)):
            arrays |= {f"{name}_{part}": getattr(matrix, part) for part in ("data", "indices", "indptr", "shape")}
        np.savez(folder / f"{self.name}.npz", **arrays)
        driven, other = _points_that_tell_modes_apart(mass, stiffness, rows)
        file = folder / f"{self.name}.yaml"
        file.write_text(
            f"name: {self.name}\n"
            "sample_rate_hz: 2000\n"
            f"structure:\n  kind: matrices\n  file: {self.name}.npz\n  modes: 5\n  damping_ratios: [0.01]\n"
            "  points_at:\n"
            f"  - {{point: 1, node: {driven}, direction: z}}\n  - {{point: 2, node: {other}, direction: z}}\n"
            "exciter: {kind: force, point: 1, newton_per_volt: 1.0}\n"
            "sensors:\n- {quantity: force, point: drive}\n- {quantity: displacement, point: 1}\n"
            "- {quantity: displacement, point: 2}\n- {quantity: voltage}\n"
            'test: {levels: "0.5,1"}\n',
            encoding="utf-8",
        )
        return file


def _points_that_tell_modes_apart(mass: Any, stiffness: Any, rows: NDArray[np.int64]) -> tuple[int, int]:
    """Node where the first mode moves most of those that move in the second, and one that tells the two apart.

    Near an edge or a nodal line the static deflection about the drive hides the mode: phase resonance lies elsewhere.
    """
    n = mass.shape[0]
    shapes = eigh(mass.toarray(), stiffness.toarray(), subset_by_index=[n - 2, n - 1])[1][:, ::-1]
    shapes = shapes[rows[:, 1] == 3]
    nodes = rows[rows[:, 1] == 3, 0]
    shares = np.abs(shapes) / np.abs(shapes).max(axis=0)
    drive = int(np.argmax(np.where(shares[:, 1] > 0.3, shares[:, 0], 0.0)))
    first, second = shapes[:, 0], shapes[:, 1]
    other = int(np.argmax(np.abs(first[drive] * second - first * second[drive])))
    return int(nodes[drive]), int(nodes[other])


def _line(element: Array, elements: int) -> Array:
    """Equal elements of two nodes one behind the other."""
    size = element.shape[0] // 2
    total = np.zeros((size * (elements + 1), size * (elements + 1)))
    for first in range(elements):
        part = slice(size * first, size * (first + 2))
        total[part, part] += element
    return total


def _chain(elements: int, lumped: bool) -> tuple[Array, Array, list[tuple[int, int]]]:
    """Equal masses; where the mass is consistent, a third of all mass is in the springs."""
    spring = np.array([[1.0, -1.0], [-1.0, 1.0]])
    masses = np.eye(elements + 1)
    if not lumped:
        masses = masses * (2.0 / 3.0) + _line(np.array([[2.0, 1.0], [1.0, 2.0]]) / 18.0, elements)
    rows = [(node + 1, 3) for node in range(1, elements + 1)]
    return (masses * _KILOGRAMS / elements)[1:, 1:], _line(spring, elements)[1:, 1:], rows


def _rod(elements: int, lumped: bool) -> tuple[Array, Array, list[tuple[int, int]]]:
    mass = np.eye(2) / 2.0 if lumped else np.array([[2.0, 1.0], [1.0, 2.0]]) / 6.0
    stiffness = np.array([[1.0, -1.0], [-1.0, 1.0]]) * elements
    rows = [(node + 1, 3) for node in range(1, elements + 1)]
    return _line(mass * _KILOGRAMS / elements, elements)[1:, 1:], _line(stiffness, elements)[1:, 1:], rows


def _hermite(length: float) -> dict[str, Array]:
    """Integrals of cubic shape functions over an element: of values, slopes, curvatures, curvature times value."""
    a = length
    values = np.array([[156, 22 * a, 54, -13 * a], [22 * a, 4 * a**2, 13 * a, -3 * a**2],
                       [54, 13 * a, 156, -22 * a], [-13 * a, -3 * a**2, -22 * a, 4 * a**2]]) * a / 420  # fmt: skip
    slopes = np.array([[36, 3 * a, -36, 3 * a], [3 * a, 4 * a**2, -3 * a, -(a**2)],
                       [-36, -3 * a, 36, -3 * a], [3 * a, -(a**2), -3 * a, 4 * a**2]]) / (30 * a)  # fmt: skip
    curvatures = np.array([[12, 6 * a, -12, 6 * a], [6 * a, 4 * a**2, -6 * a, 2 * a**2],
                           [-12, -6 * a, 12, -6 * a], [6 * a, 2 * a**2, -6 * a, 4 * a**2]]) / a**3  # fmt: skip
    # By parts: slope times value at the ends, less the integral of slopes.
    ends = np.zeros((4, 4))
    ends[1, 0], ends[3, 2] = -1.0, 1.0
    return {"value": values, "slope": slopes, "curvature": curvatures, "mixed": ends - slopes}


def _beam(elements: int, lumped: bool) -> tuple[Array, Array, list[tuple[int, int]]]:
    length = _LENGTH_M / elements
    parts = _hermite(length)
    mass = np.diag([0.5, 0.0, 0.5, 0.0]) * length if lumped else parts["value"]
    rows = [(node + 1, direction) for node in range(1, elements + 1) for direction in (3, 5)]
    weight = _KILOGRAMS / _LENGTH_M
    return weight * _line(mass, elements)[2:, 2:], _line(parts["curvature"], elements)[2:, 2:], rows


def _membrane(elements: int, lumped: bool) -> tuple[Any, Any, list[tuple[int, int]]]:
    """Rectangle of 1 to 1.3, held all around; bilinear elements."""
    inner = slice(1, elements)
    linear = _line(np.array([[2.0, 1.0], [1.0, 2.0]]) / 6.0 / elements, elements)
    share = np.diag(linear.sum(axis=1)) if lumped else linear
    slope = _line(np.array([[1.0, -1.0], [-1.0, 1.0]]) * elements, elements)
    linear, share, slope = (matrix[inner, inner] for matrix in (linear, share, slope))
    rows = [(100 * i + j, 3) for i in range(1, elements) for j in range(1, elements)]
    stiffness = sparse.kron(slope, linear) + 1.3**2 * sparse.kron(linear, slope)
    return _KILOGRAMS * sparse.kron(share, share), stiffness, rows


def _plate(elements: int, lumped: bool) -> tuple[Any, Any, list[tuple[int, int]]]:
    """Square, clamped at one edge; elements of Bogner, Fox and Schmit, products of cubic functions."""
    length = _LENGTH_M / elements
    one = {name: _line(part, elements) for name, part in _hermite(length).items()}
    nodes = elements + 1
    weights = np.zeros(2 * nodes)
    weights[::2] = length * np.array([0.5, *[1.0] * (elements - 1), 0.5])
    share = np.diag(weights) if lumped else one["value"]
    twist = sparse.kron(one["mixed"], one["mixed"].T)
    stiffness = (
        sparse.kron(one["curvature"], one["value"]) + sparse.kron(one["value"], one["curvature"])
        + _POISSON * (twist + twist.T) + 2.0 * (1.0 - _POISSON) * sparse.kron(one["slope"], one["slope"])
    )  # fmt: skip
    mass = _KILOGRAMS / _LENGTH_M**2 * sparse.kron(share, share)
    # Value, slope over y, slope over x, twist; 7 is a direction without a name.
    names = {(0, 0): 3, (0, 1): 4, (1, 0): 5, (1, 1): 7}
    rows = [(100 * (i // 2) + j // 2 + 1, names[i % 2, j % 2]) for i in range(2 * nodes) for j in range(2 * nodes)]
    free = np.arange(2 * 2 * nodes, (2 * nodes) ** 2)
    inner = slice(free[0], None)
    return mass.tocsr()[inner][:, inner], stiffness.tocsr()[inner][:, inner], rows[free[0] :]


_ASSEMBLED = {"chain": _chain, "rod": _rod, "beam": _beam, "membrane": _membrane, "plate": _plate}
_SIZES = {
    "chain": (9, 12, 30, 200), "rod": (8, 16, 40, 300), "beam": (8, 12, 25, 60), "membrane": (4, 8, 14, 30),
    "plate": (3, 5, 8, 12),
}  # fmt: skip
STRUCTURES = tuple(
    ElementStructure(kind, elements, lumped)
    for kind, sizes in _SIZES.items()
    for elements in sizes
    for lumped in (True, False)
)
"""Forty of them."""
