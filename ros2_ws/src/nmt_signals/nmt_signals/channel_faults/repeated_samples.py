"""Samples that a converter, its driver or a network lost: the one before stands in their place."""

from __future__ import annotations

import numpy as np

from nmt_core.numerics.arrays import FloatArray
from nmt_signals.thresholds import CHANNEL_FAULTS


def repeated_share(*windows: FloatArray) -> float:
    """Share of steep places at which the sample before was recorded again: values that a converter lost.

    Where the neighbours on both sides differ much, two equal samples are no chance, unless the converter is coarse:
    then the smallest steps are there as often.

    Args:
        windows: samples of one channel, (n,) each; what is lost is counted over all of them. Where there are several,
            half of them have to show it: one alone tells of an accident.
    """
    counts = [_counted(samples) for samples in windows]
    repeated, by_chance, steep = (sum(count[k] for count in counts) for k in range(3))
    showing = sum(count[0] > CHANNEL_FAULTS.repeats_crowding * count[1] for count in counts)
    if (
        repeated < CHANNEL_FAULTS.repeats_fewest
        or repeated <= CHANNEL_FAULTS.repeats_crowding * by_chance
        or 2 * showing < len(counts)
    ):
        return 0.0
    share = repeated / steep
    return share if share >= CHANNEL_FAULTS.repeats_least_share else 0.0


def _counted(samples: FloatArray) -> tuple[float, float, float]:
    """Repeats at steep places of a window, how many of them chance would make, and number of steep places."""
    steps = np.diff(samples)
    if steps.size < 3:
        return 0.0, 0.0, 0.0
    around = np.abs(samples[3:] - samples[:-3])
    # What a limiter clips stays at its ends.
    inside = (samples[1:-2] > samples.min()) & (samples[1:-2] < samples.max())
    steep = inside & (around > CHANNEL_FAULTS.repeats_steepness * float(np.sqrt(np.mean(around**2))))
    if not steep.any() or np.unique(samples).size < 0.2 * samples.size:
        return 0.0, 0.0, 0.0
    between = np.abs(steps[1:-1])
    smallest = float(between[between > 0.0].min(initial=np.inf))
    repeated = float(np.sum(steep & (between == 0.0)))
    by_chance = 0.5 * float(np.sum(steep & (between > 0.0) & (between < 1.5 * smallest)))
    return repeated, by_chance, float(steep.sum())
