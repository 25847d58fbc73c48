"""Samples between samples, of a signal without power above half of the sampling rate."""

from __future__ import annotations

import numpy as np
from scipy.signal import resample

from nmt_core.numerics.arrays import FloatArray


def finer(samples: FloatArray, factor: int, padding: int | None = None) -> FloatArray:
    """Band-limited interpolation; sample k comes to stand at ``factor`` k.

    Args:
        samples: shape (n,).
        factor: number of times as many.
        padding: samples by which either end is reflected at most; None = all of them.

    Returns:
        Shape (factor n,); what is behind the last sample belongs to the reflection.
    """
    if factor <= 1:
        return samples
    size = samples.size - 1 if padding is None else min(padding, samples.size - 1)
    # Odd reflections at the ends: no step where the ends of the Fourier transform meet.
    head = 2.0 * samples[0] - samples[size:0:-1]
    tail = 2.0 * samples[-1] - samples[-2 : -size - 2 : -1]
    padded = np.concatenate((head, samples, tail))
    trend = np.linspace(padded[0], padded[-1], padded.size)
    fine = resample(padded - trend, padded.size * factor)
    fine = fine + np.interp(np.arange(fine.size) / factor, np.arange(padded.size), trend)
    return np.ascontiguousarray(fine[size * factor : (size + samples.size) * factor])
