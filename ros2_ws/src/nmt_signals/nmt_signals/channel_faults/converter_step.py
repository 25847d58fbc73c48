"""The step of the converter that recorded a channel, as the samples themselves show it."""

from __future__ import annotations

import numpy as np

from nmt_core.numerics.arrays import FloatArray
from nmt_signals.thresholds import CHANNEL_FAULTS


def converter_step(samples: FloatArray) -> float:
    """Distance of the values of a staircase, in their unit; 0 where the samples lie on no staircase.

    The staircase may have any offset. Steps finer than 1e-7 of the range count as none.

    Args:
        samples: finite values, shape (samples,).
    """
    values = np.unique(samples[: CHANNEL_FAULTS.step_samples])
    span = float(values[-1] - values[0])
    apart = np.diff(values)
    apart = apart[apart > CHANNEL_FAULTS.finest_step * span]
    if apart.size < CHANNEL_FAULTS.step_fewest_values - 1:
        return 0.0
    # The smallest distance is known to rounding only; the whole range counts many steps of it.
    near = float(np.median(apart[apart < 1.5 * apart.min()]))
    step = span / round(span / near)
    places = (values - values[0]) / step
    return step if np.abs(places - np.round(places)).max() < CHANNEL_FAULTS.step_rounding else 0.0
