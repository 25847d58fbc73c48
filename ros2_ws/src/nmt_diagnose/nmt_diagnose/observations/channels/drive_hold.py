"""What a drive that goes straight from sample to sample does to measured responses.

Simulated rigs interpolate the drive linearly and have no anti-aliasing filters. Referred to the samples of the drive,
the sampled response at f is Σ_m sinc²(f/f_h + m) H(f + m f_h), with f_h the rate of the interpolation: the response
itself, smaller by sinc², and images of the drive around multiples of f_h. The images are taken out with the model's
response up there, where they matter only for accelerations and forces (up to 1e-2 near their zeros).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from nmt_core.numerics.arrays import FloatArray
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.observations.model_view import ModelView

_IMAGES = (-1, 1, -2, 2, -3, 3, -4, 4)


def hold_factor(frequency_hz: FloatArray | float, rate_hz: float) -> FloatArray:
    """Fundamental of the interpolated drive over that of its samples, sinc²(f / f_h); 1 where the rate is infinite."""
    if math.isinf(rate_hz):
        return np.ones_like(np.asarray(frequency_hz, dtype=np.float64))
    return np.asarray(np.sinc(np.asarray(frequency_hz) / rate_hz) ** 2, dtype=np.float64)


def image_responses(
    view: ModelView,
    channels: Sequence[MeasuredChannel],
    frequency_hz: FloatArray,
    rate_hz: float,
    terms: Sequence[complex] = (1.0,),
) -> NDArray[np.complex128]:
    """What images add to the response to a drive at each frequency, shape (channels, frequencies).

    ``terms`` are the samples' complex amplitudes at each exciter, V.
    """
    result = np.zeros((len(channels), frequency_hz.size), dtype=np.complex128)
    if math.isinf(rate_hz):
        return result
    conjugate = [complex(term).conjugate() for term in terms]
    for order in _IMAGES:
        place = frequency_hz + order * rate_hz
        # An image below zero is the conjugate drive above it.
        shape = np.sinc(np.abs(place) / rate_hz) ** 2
        above = view.responses(channels, np.abs(place), terms) * shape
        below = np.conj(view.responses(channels, np.abs(place), conjugate) * shape)
        result += np.where(place > 0.0, above, below)
    return np.nan_to_num(result)
