"""Samples with stamps at other times."""

from __future__ import annotations

import numpy as np

from nmt_core.numerics.arrays import FloatArray

_GAP = 1.75  # steps: a sample is missing, or stamps scatter by three quarters of a step


def interpolated(time: FloatArray, values: FloatArray, places: FloatArray, step: float | None = None) -> FloatArray:
    """Values at other times, by the cubic through the four samples about each; NaN beyond them and in gaps.

    Args:
        time: ascending, s, shape ``(n,)``, n at least 4.
        values: shape ``(n,)``.
        places: s, shape ``(m,)``.
        step: usual step of the stamps, s; None = the median. Two that are further apart than 1.75 of it leave a gap.
    """
    good = np.isfinite(values)
    time, values = time[good], values[good]
    if time.size < 4:
        return np.full(places.size, np.nan)
    typical = float(np.median(np.diff(time))) if step is None else step
    right = np.clip(np.searchsorted(time, places), 1, time.size - 1)
    first = np.clip(right - 2, 0, time.size - 4)
    near = time[first[:, None] + np.arange(4)]
    result = np.zeros(places.size)
    for k in range(4):
        weight = np.ones(places.size)
        for j in range(4):
            if j != k:
                weight = weight * (places - near[:, j]) / (near[:, k] - near[:, j])
        result += weight * values[first + k]
    off_stamp = np.minimum(places - time[right - 1], time[right] - places) > 1e-3 * typical
    gap = off_stamp & (time[right] - time[right - 1] > _GAP * typical)
    outside = (places < time[0] - 0.5 * typical) | (places > time[-1] + 0.5 * typical)
    return np.where(gap | outside, np.nan, result)
