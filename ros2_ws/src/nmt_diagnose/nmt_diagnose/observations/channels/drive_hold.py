"""What a drive that goes straight from sample to sample does to measured responses.

Simulated rigs interpolate the drive linearly and have no anti-aliasing filters. Referred to the samples of the drive,
the sampled response at f is Σ_m sinc²(f/f_h + m) H(f + m f_h), with f_h the rate of the interpolation: the response
itself, smaller by sinc², and images of the drive around multiples of f_h. The images are taken out with the model's
response up there, where they matter only for accelerations and forces (up to 1e-2 near their zeros).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nmt_core.numerics.arrays import FloatArray
from nmt_diagnose.observations.conditions import MeasuredChannel
from nmt_diagnose.observations.model_view import ModelView

_IMAGES = (-1, 1, -2, 2, -3, 3, -4, 4)


def hold_factor(frequency_hz: FloatArray | float, rate_hz: float) -> FloatArray:
    """Fundamental of the interpolated drive over that of its samples, sinc²(f / f_h); 1 where the rate is infinite."""
    if math.isinf(rate_hz):
        return np.ones_like(np.asarray(frequency_hz, dtype=np.float64))
    return np.asarray(np.sinc(np.asarray(frequency_hz) / rate_hz) ** 2, dtype=np.float64)


def image_responses(
    view: ModelView, channels: Sequence[MeasuredChannel], frequency_hz: FloatArray, rate_hz: float
) -> NDArray[np.complex128]:
    """What images add to the response to 1 V at each frequency, shape (channels, frequencies)."""
    return _images(view, channels, frequency_hz, rate_hz, _IMAGES, lambda share: np.sinc(share) ** 2)


def _images(
    view: ModelView,
    channels: Sequence[MeasuredChannel],
    frequency_hz: FloatArray,
    rate_hz: float,
    orders: Sequence[int],
    shape: Callable[[FloatArray], NDArray[Any]],
) -> NDArray[np.complex128]:
    result = np.zeros((len(channels), frequency_hz.size), dtype=np.complex128)
    if math.isinf(rate_hz):
        return result
    for order in orders:
        place = frequency_hz + order * rate_hz
        values = view.responses(channels, np.abs(place)) * shape(np.abs(place) / rate_hz)
        result += np.where(place > 0.0, values, np.conj(values))
    return np.nan_to_num(result)
