"""Level at which a limiter or the end of a converter's range holds the samples of a channel."""

from __future__ import annotations

import numpy as np

from nmt_core.numerics.arrays import FloatArray

# Fewest samples at the level, and fewest times that the signal came to it.
_FEWEST, _VISITS = 6, 3
# Times as many samples at the level as at any of the values next to it. Of a sine in steps the last value holds at most
# 2.4 times as many as the one before: the arc sine of a step against that of two.
_CROWDED = 5.0
_NEXT = 8


def clipping_level(samples: FloatArray) -> float:
    """Largest magnitude at which samples stay again and again, in their unit; 0 where they turn back on their own.

    Noise and a fine converter spread the turning points of a signal over many values; what clips puts them into one.

    Args:
        samples: finite values, shape (samples,).
    """
    levels = [abs(end) for end in (float(samples.max()), float(samples.min())) if _holds(samples, end)]
    return max(levels, default=0.0)


def _holds(samples: FloatArray, end: float) -> bool:
    at = samples == end
    count = int(at.sum())
    visits = int(np.sum(at[1:] & ~at[:-1])) + int(at[0])
    if count < _FEWEST or visits < _VISITS or count == samples.size:
        return False
    # Every value is at least as far from the end as the wanted number of others: only those are sorted.
    away = np.abs(samples[~at] - end)
    wanted = min(away.size, max(_NEXT, 2 * count))
    _, numbers = np.unique(np.partition(away, wanted - 1)[:wanted], return_counts=True)
    return count >= _CROWDED * int(numbers[:_NEXT].max())
