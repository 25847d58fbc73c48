"""The step of the converter that recorded a channel, as the samples themselves show it."""

from __future__ import annotations

import numpy as np

from nmt_core.numerics.arrays import FloatArray

_LOOKED_AT = 8192
_FEWEST_VALUES = 8
# Share of a step by which rounding of the numbers may move a value, and smallest step of a range.
_OFF = 0.02
_FINEST = 1e-7


def converter_step(samples: FloatArray) -> float:
    """Distance of the values of a staircase, in their unit; 0 where the samples lie on no staircase.

    The staircase may have any offset. Steps finer than 1e-7 of the range count as none.

    Args:
        samples: finite values, shape (samples,).
    """
    values = np.unique(samples[:_LOOKED_AT])
    span = float(values[-1] - values[0])
    apart = np.diff(values)
    apart = apart[apart > _FINEST * span]
    if apart.size < _FEWEST_VALUES - 1:
        return 0.0
    # The smallest distance is known to rounding only; the whole range counts many steps of it.
    near = float(np.median(apart[apart < 1.5 * apart.min()]))
    step = span / round(span / near)
    places = (values - values[0]) / step
    return step if np.abs(places - np.round(places)).max() < _OFF else 0.0
