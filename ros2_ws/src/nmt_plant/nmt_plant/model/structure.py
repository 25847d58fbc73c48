"""Linear structure: mass, damping and stiffness matrices with numbered measurement points."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Structure:
    """Linear part of a test structure, M q̈ + C q̇ + K q = force.

    Attributes:
        mass: (n, n) mass matrix, symmetric positive definite, kg (kg m² for rotations).
        damping: (n, n) viscous damping matrix, N s/m.
        stiffness: (n, n) stiffness matrix, N/m.
        points: point number -> index of the degree of freedom of its lateral displacement.

    Raises:
        ValueError: matrices of different sizes or not finite, mass not positive definite, point out of range.
    """

    mass: Array
    damping: Array
    stiffness: Array
    points: dict[int, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        n = self.mass.shape[0]
        for name in ("mass", "damping", "stiffness"):
            matrix = getattr(self, name)
            if matrix.shape != (n, n):
                raise ValueError(f"{name} must be {n} x {n}, got {matrix.shape}")
            if not np.all(np.isfinite(matrix)):
                raise ValueError(f"{name} has entries that are not finite")
        for point, index in self.points.items():
            if not 0 <= index < n:
                raise ValueError(f"point {point} refers to degree of freedom {index}; there are {n}")
        try:
            np.linalg.cholesky(self.mass)
        except np.linalg.LinAlgError as error:
            raise ValueError("mass matrix must be symmetric positive definite") from error

    @property
    def size(self) -> int:
        """Number of degrees of freedom n."""
        return int(self.mass.shape[0])

    def selector(self, point: int) -> Array:
        """Unit vector s of shape (n,) with lateral displacement of `point` = s · q.

        Raises:
            KeyError: the structure has no such point.
        """
        if point not in self.points:
            raise KeyError(f"no point {point}; the structure has points {sorted(self.points)}")
        vector = np.zeros(self.size)
        vector[self.points[point]] = 1.0
        return vector

    def direction(self, point: int, other_point: int | None = None) -> Array:
        """Direction (n,) of a local element between `point` and `other_point` (the ground when None).

        Raises:
            KeyError: the structure has no such point.
        """
        vector = self.selector(point)
        if other_point is not None:
            vector = vector - self.selector(other_point)
        return vector
