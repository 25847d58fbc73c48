"""Derivatives of the poles of a rig, local forces at rest, by anything that its matrices depend on.

Of (s² M + s C + K) x = 0 with yᵀ (s² M + s C + K) = 0 follows ds = −yᵀ (s² dM + s dC + dK) x / yᵀ (2 s M + C) x
(Lancaster, Lambda-Matrices and Vibrating Systems, 1966, section 4.5; the matrices need not be symmetric): no
eigenproblem is solved again.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_diagnose.prediction.rig_parts import RigParts

# Steps of inverse iteration: at a pole the first reaches rounding but from a start that has nothing of its shape.
_INVERSE_STEPS = 2


class RestingMatrices(NamedTuple):
    """Mass, damping and stiffness (n, n) of a rig with its local forces at rest."""

    mass: FloatArray
    damping: FloatArray
    stiffness: FloatArray

    @classmethod
    def of(cls, parts: RigParts) -> RestingMatrices:
        """Those of a rig that was taken apart."""
        r = parts.coordinates
        forces, motions = parts.inputs[:, :r], parts.rows.displacement[:r]
        stiffness, damping = parts.resting
        system = parts.system
        return cls(
            system.mass,
            system.damping + (forces * damping) @ motions,
            system.stiffness + (forces * stiffness) @ motions,
        )

    def dynamic(self, s: complex) -> ComplexArray:
        """s² M + s C + K, (n, n)."""
        return np.asarray(s * (s * self.mass + self.damping) + self.stiffness, dtype=np.complex128)

    def sizes(self, size: float) -> FloatArray:
        """Sizes of the terms of ``dynamic`` at an s of some size, (n, n)."""
        mass, damping, stiffness = map(np.abs, self)
        return np.asarray(size**2 * mass + size * damping + stiffness)

    def minus(self, other: RestingMatrices) -> RestingMatrices:
        """The difference to the matrices of another rig."""
        return RestingMatrices(*(a - b for a, b in zip(self, other, strict=True)))


class PoleSlopes:
    """Derivatives of some poles.

    Args:
        matrices: of the rig.
        poles: its poles (k,), rad/s.

    Raises:
        LinAlgError: there are no vectors of a pole.
    """

    def __init__(self, matrices: RestingMatrices, poles: ComplexArray) -> None:
        size = matrices.mass.shape[0]
        # A start that no mode is free of, the same at every call.
        start = np.asarray(np.random.default_rng(size).standard_normal((size,)), dtype=np.complex128)
        self._poles = poles
        right, left, steepness = [], [], []
        for pole in poles:
            dynamic, sizes = matrices.dynamic(complex(pole)), matrices.sizes(abs(pole))
            x, y = _null_vector(dynamic, sizes, start), _null_vector(dynamic.T, sizes.T, start)
            right.append(x)
            left.append(y)
            steepness.append(y @ (2.0 * pole * matrices.mass + matrices.damping) @ x)
        self._right, self._left = np.reshape(right, (-1, size)), np.reshape(left, (-1, size))
        self._steepness = np.array(steepness)

    def along(self, change: RestingMatrices) -> ComplexArray:
        """Change of the poles (k,), rad/s, to first order in a change of the matrices."""
        by_power = [np.sum((self._left @ matrix) * self._right, axis=1) for matrix in change]
        s = self._poles
        return np.asarray(-(s**2 * by_power[0] + s * by_power[1] + by_power[2]) / self._steepness)


def _null_vector(matrix: ComplexArray, sizes: FloatArray, start: ComplexArray) -> ComplexArray:
    """Vector (n,) of unit size that a matrix, singular but for rounding, takes to nothing.

    ``sizes`` (n, n) are those of the terms that its entries are sums of: rows of currents are many orders smaller than
    those of springs, and a row whose terms cancel holds only rounding.
    """
    scaled = matrix / np.max(sizes, axis=1)[:, None]
    # A pivot that is zero by chance.
    scaled = scaled + np.finfo(np.float64).eps * np.eye(scaled.shape[0])
    vector = start
    for _ in range(_INVERSE_STEPS):
        solved = np.linalg.solve(scaled, vector)
        vector = np.asarray(solved / np.linalg.norm(solved), dtype=np.complex128)
    return vector
