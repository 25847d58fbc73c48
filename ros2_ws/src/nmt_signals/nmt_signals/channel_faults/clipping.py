"""Where a limiter, a stop or the end of a converter's range cuts the samples of a channel.

Two things show it. Behind the last thing that adds noise, the cut samples have one and the same value: of any signal.
Before it, the top is flat within the noise, and its edges are those of a sine cut so: of a periodic signal.
"""

from __future__ import annotations

import math

import numpy as np

from nmt_core.numerics.arrays import FloatArray
from nmt_signals.thresholds import CHANNEL_FAULTS


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
    if (
        count < CHANNEL_FAULTS.clipped_fewest_samples
        or visits < CHANNEL_FAULTS.clipped_fewest_visits
        or count == samples.size
    ):
        return False
    # Every value is at least as far from the end as the wanted number of others: only those are sorted.
    away = np.abs(samples[~at] - end)
    wanted = min(away.size, max(CHANNEL_FAULTS.clipped_neighbours, 2 * count))
    _, numbers = np.unique(np.partition(away, wanted - 1)[:wanted], return_counts=True)
    return count >= CHANNEL_FAULTS.clipped_crowding * int(numbers[: CHANNEL_FAULTS.clipped_neighbours].max())
