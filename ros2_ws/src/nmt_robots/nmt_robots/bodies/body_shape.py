"""A link that is heavier, displaced or stretched: ten numbers that keep every body possible.

Each point r of the link moves to c + d + (1 + U)(r − c) about its centre c, and its mass grows by the factor e^x. U is
upper triangular. Whatever the numbers are, the moments of inertia are those of masses somewhere in space.
"""

from __future__ import annotations

import numpy as np

from nmt_robots.model.coupling import Array

SHAPE = 10
"""Numbers of a link: x, three of d (m), six of U by rows."""
_UPPER = np.triu_indices(3)
_SMALLEST = 0.03
"""Radius of gyration of an inertia that no body has, as a share of the link's length, at least."""


class BodyShape:
    """A link's parameters as a function of its ten numbers.

    Args:
        parameters: 10, of the file; mass, first moments, second moments about the origin.
        length: of the link, m.
    """

    def __init__(self, parameters: Array, length: float) -> None:
        self.mass = float(parameters.item(0))
        self.centre = np.asarray(parameters[1:4]) / max(self.mass, 1e-12)
        xx, yy, zz, xy, xz, yz = parameters[4:]
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        spread = 0.5 * np.trace(inertia) * np.eye(3) - inertia - self.mass * np.outer(self.centre, self.centre)
        sizes, axes = np.linalg.eigh(spread)
        least = self.mass * (_SMALLEST * length) ** 2
        self._spread = (axes * np.maximum(sizes, least)) @ axes.T
        self._in_file = self._parameters(np.zeros(SHAPE))

    def change(self, numbers: Array) -> Array:
        """By how much the ten parameters differ from those of the numbers zero."""
        return self._parameters(numbers) - self._in_file

    def slopes(self, numbers: Array) -> Array:
        """10 × 10: parameters per unit of each number."""
        factor = float(np.exp(numbers[0]))
        centre, map_ = self.centre + numbers[1:4], _map(numbers)
        mass, spread = self.mass * factor, factor * map_ @ self._spread @ map_.T
        second, first, masses = np.zeros((SHAPE, 3, 3)), np.zeros((SHAPE, 3)), np.zeros(SHAPE)
        masses[0], first[0], second[0] = mass, mass * centre, spread + mass * np.outer(centre, centre)
        axes = np.arange(3)
        first[1 + axes, axes] = mass
        second[1 + axes, axes] += mass * centre
        second[1 + axes, :, axes] += mass * centre
        rows, columns = _UPPER
        stretched = (factor * self._spread @ map_.T)[columns]
        second[4 + np.arange(6), rows] += stretched
        second[4 + np.arange(6), :, rows] += stretched
        return np.vstack([masses, first.T, _inertia(second)])

    def _parameters(self, numbers: Array) -> Array:
        mass, centre, spread = self.moved(numbers)
        return _packed(mass, mass * centre, spread + mass * np.outer(centre, centre))

    def moved(self, numbers: Array) -> tuple[float, Array, Array]:
        """Mass (kg), centre (3, m) and Σ m r rᵀ about it (3 × 3, kg·m²)."""
        factor, map_ = float(np.exp(numbers[0])), _map(numbers)
        return self.mass * factor, self.centre + numbers[1:4], factor * map_ @ self._spread @ map_.T


def moved_body(body: tuple[float, Array, Array], about: Array, numbers: Array) -> tuple[float, Array, Array]:
    """Mass, centre and inertia about it of one body of a link whose points all move so.

    Args:
        body: the same of the body as it is, in the link's frame.
        about: centre of the link, 3.
        numbers: 10, of the link.
    """
    mass, centre, inertia = body
    factor, map_ = float(np.exp(numbers[0])), _map(numbers)
    spread = 0.5 * np.trace(inertia) * np.eye(3) - inertia
    changed = factor * map_ @ spread @ map_.T
    return (
        mass * factor,
        about + numbers[1:4] + map_ @ (centre - about),
        np.trace(changed) * np.eye(3) - changed,
    )


def _map(numbers: Array) -> Array:
    found = np.eye(3)
    found[_UPPER] += numbers[4:]
    return found


def _packed(mass: float, first: Array, second: Array) -> Array:
    """Ten parameters of mass, first moments and Σ m r rᵀ about the origin."""
    return np.concatenate([[mass], first, _inertia(second)])


def _inertia(second: Array) -> Array:
    """Six numbers of the inertia of Σ m r rᵀ, of one (3 × 3) or of N (N × 3 × 3, then 6 × N)."""
    squares = second[..., [0, 1, 2], [0, 1, 2]].T
    return np.concatenate([np.sum(squares, axis=0) - squares, -second[..., [0, 0, 1], [1, 2, 2]].T])
