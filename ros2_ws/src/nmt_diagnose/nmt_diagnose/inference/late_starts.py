"""Where a search may begin when channels are late by more than the model's own parameters can hide.

A delay of a millisecond turns a response at 600 Hz by more than half a turn. The model alone then gives up a mode
rather than the phase, and about such a fit no direction leads back. But the phases of responses lie on straight lines
over the frequency: the delay is where most of them agree.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from nmt_core.arrays import FloatArray
from nmt_diagnose.observations.conditions import RandomTest, SteppedSineTest
from nmt_diagnose.observations.observables import Observations, Part

DELAYS = ("channel_skew", "shared_delay")
"""Effects that turn phases in proportion to the frequency."""
_LONGEST = 0.02  # s
_STEP = np.pi / 8.0
# Mean cosine of what is left of the phases that a delay turns: by how much it must grow.
_BETTER = 0.15


def late_starts(
    observations: Observations, difference: FloatArray, slopes: Sequence[FloatArray], most: int
) -> list[tuple[int, float]]:
    """Delays and their strengths at which phases of frequency responses agree with the model, best first.

    Args:
        observations: the real side.
        difference: measured minus predicted by the model as given, shape (m,).
        slopes: of each delay the change of the observables per strength, shape (m,).
        most: how many.

    Returns:
        Number of the delay and strength; empty where none is better than no delay.
    """
    rows = observations.rows
    swept = [k for k, test in enumerate(observations.tests) if isinstance(test, RandomTest | SteppedSineTest)]
    phases = np.isin(rows.test, swept) & (rows.part == Part.PHASE) & np.isfinite(difference)
    found = []
    for number, slope in enumerate(slopes):
        mine = phases & np.isfinite(slope) & (np.abs(slope) > 0.0)
        if not mine.any():
            continue
        own, left = slope[mine], difference[mine]
        seconds = float(np.median(np.abs(own) / (2.0 * np.pi * rows.frequency_hz[mine])))
        count = int(np.ceil(_LONGEST / seconds * float(np.max(np.abs(own))) / _STEP))
        strengths = np.linspace(-_LONGEST, _LONGEST, 2 * count + 1) / seconds
        agreement = np.array([float(np.cos(left - own * strength).sum()) for strength in strengths])
        gain = agreement - float(np.cos(left).sum())
        best = int(np.argmax(gain))
        if gain[best] > _BETTER * own.size:
            found.append((float(gain[best]), number, float(strengths[best])))
    return [(number, strength) for _, number, strength in sorted(found, reverse=True)[:most]]
