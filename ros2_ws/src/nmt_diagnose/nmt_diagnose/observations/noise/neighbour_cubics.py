"""Points of a course beside the cubics through their four neighbours: what is smooth leaves little there."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nmt_core.numerics.arrays import FloatArray, IntArray

_NEAR = np.array([-2, -1, 1, 2])


class NeighbourCubics(NamedTuple):
    """For k points of a course, from the third to the last but two.

    Attributes:
        middle: (k,) their positions.
        near: (k, 4) positions of their neighbours.
        weights: (k, 4) of the neighbours' values in the cubic at the point (Lagrange).
    """

    middle: IntArray
    near: IntArray
    weights: FloatArray


def neighbour_cubics(x: FloatArray) -> NeighbourCubics:
    """Of places in ascending order, shape (n,); points with neighbours at one place are left out."""
    middle = np.arange(2, x.size - 2)
    near = middle[:, None] + _NEAR
    gaps = x[near][:, :, None] - x[near][:, None, :]
    gaps[:, range(4), range(4)] = 1.0
    good = np.all(gaps != 0.0, axis=(1, 2))
    middle, near, gaps = middle[good], near[good], gaps[good]
    offsets = np.repeat((x[middle][:, None] - x[near])[:, None, :], 4, axis=1)
    offsets[:, range(4), range(4)] = 1.0
    return NeighbourCubics(middle, near, np.prod(offsets, axis=2) / np.prod(gaps, axis=2))
