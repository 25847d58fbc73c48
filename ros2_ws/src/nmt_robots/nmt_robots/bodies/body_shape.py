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


class BodyShapes:
    """Parameters of L links as functions of their ten numbers.

    Args:
        parameters: L × 10, of the file; mass, first moments, second moments about the origin.
        lengths: L, of the links, m.
    """

    def __init__(self, parameters: Array, lengths: Array) -> None:
        self.masses = np.array(parameters[:, 0])
        self.centres = parameters[:, 1:4] / np.maximum(self.masses, 1e-12)[:, None]
        inertia = parameters[:, [[4, 7, 8], [7, 5, 9], [8, 9, 6]]]
        half_trace = 0.5 * np.trace(inertia, axis1=1, axis2=2)
        outer = self.centres[:, :, None] * self.centres[:, None, :]
        spread = half_trace[:, None, None] * np.eye(3) - inertia - self.masses[:, None, None] * outer
        sizes, axes = np.linalg.eigh(spread)
        least = self.masses * (_SMALLEST * lengths) ** 2
        self._spread = (axes * np.maximum(sizes, least[:, None])[:, None, :]) @ np.swapaxes(axes, 1, 2)
        self._in_file = self._parameters(np.zeros((len(lengths), SHAPE)))

    def change(self, numbers: Array) -> Array:
        """L × 10: by how much the parameters differ from those of the numbers zero; numbers L × 10."""
        return self._parameters(numbers) - self._in_file

    def slopes(self, numbers: Array) -> Array:
        """L × 10 × 10: parameters per unit of each number, which is the last axis; numbers L × 10."""
        factor, centre, map_ = np.exp(numbers[:, 0]), self.centres + numbers[:, 1:4], _map(numbers)
        masses, first, second = (np.zeros((len(numbers), SHAPE, *more)) for more in ((), (3,), (3, 3)))
        stretched = factor[:, None, None] * self._spread @ np.swapaxes(map_, 1, 2)
        moment = (self.masses * factor)[:, None] * centre
        masses[:, 0], first[:, 0] = self.masses * factor, moment
        second[:, 0] = map_ @ stretched + moment[:, :, None] * centre[:, None, :]
        for axis in range(3):
            first[:, 1 + axis, axis] = masses[:, 0]
            second[:, 1 + axis, axis] += moment
            second[:, 1 + axis, :, axis] += moment
        for place, (row, column) in enumerate(zip(*_UPPER, strict=True)):
            second[:, 4 + place, row] += stretched[:, column]
            second[:, 4 + place, :, row] += stretched[:, column]
        return np.swapaxes(_packed(masses, first, second), 1, 2)

    def _parameters(self, numbers: Array) -> Array:
        factor, centre, map_ = np.exp(numbers[:, 0]), self.centres + numbers[:, 1:4], _map(numbers)
        mass = self.masses * factor
        spread = factor[:, None, None] * map_ @ self._spread @ np.swapaxes(map_, 1, 2)
        moment = mass[:, None] * centre
        return _packed(mass, moment, spread + moment[:, :, None] * centre[:, None, :])


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
    """3 × 3 of ten numbers, or of N × 10 of them."""
    found = np.zeros((*numbers.shape[:-1], 3, 3)) + np.eye(3)
    found[..., _UPPER[0], _UPPER[1]] += numbers[..., 4:]
    return found


def _packed(mass: Array, first: Array, second: Array) -> Array:
    """… × 10: parameters of masses (…), first moments (… × 3) and Σ m r rᵀ about the origin (… × 3 × 3)."""
    squares = second[..., [0, 1, 2], [0, 1, 2]]
    inertia = np.sum(squares, axis=-1, keepdims=True) - squares
    return np.concatenate([mass[..., None], first, inertia, -second[..., [0, 0, 1], [1, 2, 2]]], axis=-1)
