"""The step of the converter that recorded a channel, as the samples themselves show it.

`converter_step` is sure: values of many neighbouring steps have to stand there. `resolution` is a lower bound for
uncertainties: the grid that all values lie on, even if they are always the same few.
"""

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


CONVERTER_BITS = 24
"""No converter resolves more: a stated uncertainty is never below what this resolution of the range allows."""
_OFF_GRID = 1e-3  # of a step: by how much values on a grid may be off it


def resolution(values: FloatArray) -> float:
    """Step of the grid on which the values of a channel lie, of its file or converter, in its unit; 0 = none seen."""
    finest = float(np.ptp(values)) / 2**CONVERTER_BITS
    steps = np.diff(np.unique(values[:4000]))
    steps = steps[steps > finest]
    if steps.size < 3:
        return 0.0
    # Where the same few values repeat, none may be one step beside another.
    for parts in range(1, 9):
        step = float(steps.min()) / parts
        ratio = steps / step
        on_grid = np.abs(ratio - np.round(ratio)) < np.maximum(_OFF_GRID * ratio / parts, 1e-6)
        if bool(on_grid.all()) and float(np.median(ratio)) < 1.0 / _OFF_GRID:
            return step
    return 0.0
