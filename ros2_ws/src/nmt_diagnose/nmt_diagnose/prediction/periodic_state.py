"""Solutions of periodic motions, and what of them another rig shares."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_diagnose.prediction.rig_parts import IDLE


@dataclass(frozen=True)
class PeriodicState:
    """Solution of one level, or of one amplitude of a decay.

    Attributes:
        z: unknowns of the kernel.
        keys: identity of the coordinates in z.
        drive: commanded amplitude, V (N where the force is held); of a decay that of the channel.
        channels: harmonics (c, n_orders) before the converter; of a decay none.
    """

    z: FloatArray
    keys: tuple[str, ...]
    drive: float
    channels: ComplexArray

    @property
    def omega(self) -> float:
        """True angular frequency, rad/s."""
        return float(self.z[-2])


def has_coordinates(before: Sequence[str], keys: Sequence[str]) -> bool:
    """Whether a rig has all coordinates with a force that another has."""
    return all(key in keys or key == IDLE for key in before)


def shared_unknowns(
    before: Sequence[str], keys: Sequence[str], size: int
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Unknowns, coordinate by coordinate and then two, that a rig shares with one that was solved before.

    Args:
        before, keys: coordinates of the solved rig and of the other.
        size: unknowns of a coordinate.

    Returns:
        Their positions in those of the other rig and of the solved one, and positions of the rest of the other's.
    """
    if tuple(before) == tuple(keys):
        every = np.arange(len(keys) * size + 2)
        return every, every, every[:0]
    pairs = [(list(keys).index(key), j) for j, key in enumerate(before) if key in keys]
    block, ends = np.arange(size), np.arange(2)
    shared_positions = np.concatenate([*(i * size + block for i, _ in pairs), len(keys) * size + ends])
    kept = np.concatenate([*(j * size + block for _, j in pairs), len(before) * size + ends])
    return shared_positions, kept, np.setdiff1d(np.arange(len(keys) * size + 2), shared_positions)
