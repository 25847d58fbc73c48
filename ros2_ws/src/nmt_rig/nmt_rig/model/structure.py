"""Linear structure: mass, damping and stiffness matrices with numbered measurement points."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh

Array = NDArray[np.float64]


class PointMotion:
    """Motion of numbered points: an unknown of its own, or a combination of unknowns (a row of mode shapes)."""

    points: dict[int, int]
    shapes: dict[int, Array]

    @property
    def size(self) -> int:
        """Number of unknowns n."""
        raise NotImplementedError

    @property
    def point_numbers(self) -> tuple[int, ...]:
        """Numbers of all points, ascending."""
        return tuple(sorted({*self.points, *self.shapes}))

    def selector(self, point: int) -> Array:
        """Vector s of shape (n,) with lateral displacement of `point` = s · q; a unit vector for an unknown.

        Raises:
            KeyError: no such point exists.
        """
        if point in self.shapes:
            return self.shapes[point].copy()
        if point not in self.points:
            raise KeyError(f"no point {point}; the structure has points {list(self.point_numbers)}")
        vector = np.zeros(self.size)
        vector[self.points[point]] = 1.0
        return vector

    def motion(self, point: int, unknowns: NDArray[Any]) -> Any:
        """Lateral displacement of `point` from unknowns (n,) or (n, k): a number or (k,).

        Raises:
            KeyError: no such point exists.
        """
        return unknowns[self.points[point]] if point in self.points else self.selector(point) @ unknowns


@dataclass(frozen=True)
class Structure(PointMotion):
    """Linear part of a test structure, M q̈ + C q̇ + K q = force.

    Attributes:
        mass: (n, n) mass matrix, symmetric positive definite, kg (kg m² for rotations).
        damping: (n, n) viscous damping matrix, N s/m.
        stiffness: (n, n) stiffness matrix, N/m.
        points: point number -> index of the degree of freedom of its lateral displacement.
        rotations: point number -> index of the degree of freedom of its rotation, where points rotate.
        shapes: point number -> row (n,) of points that are no degree of freedom: displacement = row · q.
        base_load: (n,) p where the supports move together: with q relative to them, M q̈ + C q̇ + K q = -p a for a base
            acceleration a; M r + M_b of the usual notation, kg. None where it is not known.
        base_motion: point number -> displacement of the point, per displacement of the base, that is not in q; 1 where
            left out.

    Raises:
        ValueError: matrices of different sizes or not finite, mass not positive definite, point out of range.
    """

    mass: Array
    damping: Array
    stiffness: Array
    points: dict[int, int] = field(default_factory=dict)
    rotations: dict[int, int] = field(default_factory=dict)
    shapes: dict[int, Array] = field(default_factory=dict)
    base_load: Array | None = None
    base_motion: dict[int, float] = field(default_factory=dict)

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
        vectors = {f"shape at point {point}": row for point, row in self.shapes.items()}
        if self.base_load is not None:
            vectors["base load"] = self.base_load
        for what, vector in vectors.items():
            if vector.shape != (n,) or not np.all(np.isfinite(vector)):
                raise ValueError(f"the {what} must have {n} finite entries, got {vector}")
        try:
            np.linalg.cholesky(self.mass)
        except np.linalg.LinAlgError as error:
            raise ValueError("mass matrix must be symmetric positive definite") from error

    @property
    def size(self) -> int:
        """Number of degrees of freedom n."""
        return int(self.mass.shape[0])

    def direction(self, point: int, other_point: int | None = None, rotation: bool = False) -> Array:
        """Direction (n,) of a local element between `point` and `other_point` (the ground when None).

        Args:
            point, other_point: point numbers.
            rotation: of the rotations (rad) instead of the lateral displacements (m).

        Raises:
            KeyError: the structure has no such point, or it does not rotate.
        """
        vector = self.rotation_selector(point) if rotation else self.selector(point)
        if other_point is not None:
            vector = vector - (self.rotation_selector(other_point) if rotation else self.selector(other_point))
        return vector

    def rotation_selector(self, point: int) -> Array:
        """Unit vector s of shape (n,) with rotation of `point` = s · q.

        Raises:
            KeyError: the structure has no such point, or its points do not rotate.
        """
        if point not in self.rotations:
            raise KeyError(f"point {point} has no rotation; those with one are {sorted(self.rotations)}")
        vector = np.zeros(self.size)
        vector[self.rotations[point]] = 1.0
        return vector

    def with_masses(self, masses: Iterable[tuple[int, float]]) -> Structure:
        """The structure with masses (point number, kg) added to the lateral motion of points.

        Raises:
            KeyError: the structure has no such point.
            ValueError: negative masses that leave no positive definite mass matrix.
        """
        mass = self.mass.copy()
        load = None if self.base_load is None else self.base_load.copy()
        for point, value in masses:
            selector = self.selector(point)
            mass += value * np.outer(selector, selector)
            if load is not None:
                load += value * self.base_motion.get(point, 1.0) * selector
        return replace(self, mass=mass, base_load=load)

    def with_oscillator(self, point: int, mass: float, omega: float, damping_ratio: float) -> Structure:
        """The structure with a mass on a spring and a damper at a point, behind its degrees of freedom.

        Its motion is relative to the base, as that of the point. Of a base it takes the load of its mass.

        Args:
            point: number of the point that carries it.
            mass: m, kg.
            omega: √(k/m), rad/s.
            damping_ratio: c / (2 √(k m)).

        Raises:
            KeyError: the structure has no such point.
            ValueError: a mass that is not positive.
        """
        n = self.size
        across = np.append(self.selector(point), -1.0)

        def grown(matrix: Array, value: float) -> Array:
            wider = np.zeros((n + 1, n + 1))
            wider[:n, :n] = matrix
            return wider + value * np.outer(across, across)

        inertia = grown(self.mass, 0.0)
        inertia[n, n] = mass
        load = self.base_load
        if load is not None:
            load = np.append(load, mass * self.base_motion.get(point, 1.0))
        return replace(
            self, mass=inertia, damping=grown(self.damping, 2.0 * damping_ratio * omega * mass),
            stiffness=grown(self.stiffness, omega**2 * mass),
            shapes={number: np.append(row, 0.0) for number, row in self.shapes.items()}, base_load=load,
        )  # fmt: skip

    def with_loss_factor(self, loss_factor: float) -> Structure:
        """The structure with the viscous equivalent of hysteretic damping K (1 + iη) added.

        Each undamped mode gets ζ = η / 2, which loses at its frequency as much as iη does.
        """
        squares, weighted = self._undamped
        rates = loss_factor * np.sqrt(np.maximum(squares, 0.0))
        return replace(self, damping=self.damping + (weighted * rates) @ weighted.T)

    def with_damping_factors(self, factors: Sequence[float]) -> Structure:
        """The structure with the damping ratios of its undamped modes times ``factors``, lowest first.

        The last factor holds for all modes above, too. What the law of damping says of a mode is a guess until the mode
        is measured. What couples two modes takes the geometric mean of their factors: it stays a loss.
        """
        weighted = self._undamped[1]
        shapes = np.linalg.solve(self.mass, weighted)
        each = np.full(weighted.shape[1], float(factors[-1]))
        each[: len(factors)] = factors[: each.size]
        scaled = weighted * np.sqrt(each)
        return replace(self, damping=scaled @ (shapes.T @ self.damping @ shapes) @ scaled.T)

    def with_frequency_factors(self, factors: Sequence[float]) -> Structure:
        """The structure with the frequencies of its lowest undamped modes times ``factors``, shapes and damping kept.

        What mesh and reduction do to each mode next to the parameters of the model.
        """
        squares, weighted = self._undamped
        each = np.ones(squares.size)
        each[: len(factors)] = factors[: squares.size]
        return replace(self, stiffness=self.stiffness + (weighted * ((each**2 - 1.0) * squares)) @ weighted.T)

    @cached_property
    def _undamped(self) -> tuple[Array, Array]:
        """ω² (n,) of the undamped modes, ascending, and M φ (n, n) of their mass-normalised shapes."""
        squares, shapes = eigh(self.stiffness, self.mass)
        return squares, self.mass @ shapes
