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


def flat_top(values: FloatArray, samples_per_period: float) -> float | None:
    """Where a signal is cut off.

    A cut leaves more samples within a small depth of the extreme than a sine has there, and fewer just below: its edges
    are as steep as those of a sine cut so. A body that comes to rest against friction approaches its rest slowly.

    Args:
        values: shape ``(samples,)``, whole periods.
        samples_per_period: of the fundamental.

    Returns:
        The value of the flat top, or None.
    """
    top, bottom = float(values.max()), float(values.min())
    half = 0.5 * (top - bottom)
    for extreme, depth in ((top, top - values), (bottom, values - bottom)):
        below = depth[depth > 1e-6 * half]
        if below.size == 0 or below.min() > CHANNEL_FAULTS.flat_depth * half:
            continue  # steps of a converter, or always the same few samples of a period: nothing is seen of the edge
        share = np.count_nonzero(depth <= CHANNEL_FAULTS.flat_depth * half) / values.size
        # A period of few samples, always the same ones, may hold its extreme twice.
        if share - 2.0 / samples_per_period <= CHANNEL_FAULTS.flat_share:
            continue
        edge = np.count_nonzero(depth <= CHANNEL_FAULTS.flat_edge_depth * half) / values.size - share
        cut = math.cos(math.pi * min(share, 0.5))
        steep = math.acos(
            cut * (1.0 - CHANNEL_FAULTS.flat_edge_depth) / (1.0 - CHANNEL_FAULTS.flat_depth)
        ) / math.pi - min(share, 0.5)
        # Where the samples of all periods fall on the same places, both edges may hold one of each period.
        repeats = abs(samples_per_period - round(samples_per_period)) < 1e-4 * samples_per_period
        if edge <= 1.5 * steep + (2.0 if repeats else 0.5) / samples_per_period:
            return extreme
    return None
