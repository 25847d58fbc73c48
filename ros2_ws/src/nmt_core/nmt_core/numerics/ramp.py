"""Half-cosine transitions between amplitudes."""

from __future__ import annotations

import numpy as np

from nmt_core.numerics.arrays import FloatArray


def half_cosine(fraction: FloatArray) -> FloatArray:
    """Weight of the target amplitude along a half-cosine transition.

    Args:
        fraction: elapsed share of the transition; clipped to [0, 1]. Any shape.

    Returns:
        ``(1 - cos(π fraction)) / 2``, same shape; 0 at the start, 1 at the end, zero slope at both.
    """
    return np.asarray(0.5 - 0.5 * np.cos(np.pi * np.clip(fraction, 0.0, 1.0)), dtype=np.float64)
