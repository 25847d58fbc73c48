"""Samples that a converter, its driver or a network lost: the one before stands in their place."""

from __future__ import annotations

import numpy as np

from nmt_core.blocks import FloatArray

# Fewest repeated samples and their least share; steps of the signal, over the typical one, from which a repeat is none
# of the signal's own.
_FEWEST_REPEATS, _REPEATS_SHARE, _STEEP = 5, 1e-3, 0.5
# Where noise and a coarse converter make repeats, they make as many steps of one value up, and as many down. Repeats
# that are this many times as many are no chance.
_CROWDED = 3.0


def repeated_share(samples: FloatArray) -> float:
    """Share of steep places at which the sample before was recorded again: values that a converter lost.

    Where the neighbours on both sides differ much, two equal samples are no chance, unless the converter is coarse:
    then the smallest steps are there as often.

    Args:
        samples: (n,) of one channel.
    """
    steps = np.diff(samples)
    if steps.size < 3:
        return 0.0
    around = np.abs(samples[3:] - samples[:-3])
    # What a limiter clips stays at its ends.
    inside = (samples[1:-2] > samples.min()) & (samples[1:-2] < samples.max())
    steep = inside & (around > _STEEP * float(np.sqrt(np.mean(around**2))))
    if not steep.any() or np.unique(samples).size < 0.2 * samples.size:
        return 0.0
    between = np.abs(steps[1:-1])
    smallest = float(between[between > 0.0].min(initial=np.inf))
    repeated = int(np.sum(steep & (between == 0.0)))
    by_chance = 0.5 * int(np.sum(steep & (between > 0.0) & (between < 1.5 * smallest)))
    if repeated <= _CROWDED * by_chance:
        return 0.0
    share = repeated / int(steep.sum())
    return share if repeated >= _FEWEST_REPEATS and share >= _REPEATS_SHARE else 0.0
