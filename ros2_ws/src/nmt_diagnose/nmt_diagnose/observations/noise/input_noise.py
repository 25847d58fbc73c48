"""Noise of a measured input: what the model is driven by although the structure never was.

White noise of the input is incoherent with every response, by as much at every frequency. What else makes a response
incoherent, its own noise, nonlinear distortions, leakage of a resonance, comes on top and not everywhere. So the noise
is no larger than the least of S_uu (1 − γ²), γ² the coherence (Bendat and Piersol, Random Data (2010), ch. 9).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.signal import coherence, welch

from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_diagnose.thresholds import THRESHOLDS

_SEGMENTS = 16
_NEAREST, _FURTHEST = 1e-5, 0.3  # lines about a resonance, over its frequency


def input_noise_density(source: FloatArray, responses: FloatArray, sample_rate: float) -> float:
    """One-sided density of the white noise of an input, its unit squared per Hz.

    Args:
        source: samples of the input, (n,).
        responses: of the responses, (c, n).
        sample_rate: Hz.
    """
    segment = 2 ** max(6, int(np.log2(max(source.size // _SEGMENTS, 1))))
    averages = 2 * source.size // segment - 1
    if averages < THRESHOLDS.reading.record_fewest_averages:
        return 0.0
    _, power = welch(source - source.mean(), sample_rate, nperseg=segment)
    # Windows of Hann that overlap by half are as good as 0.95 of their number.
    count = 0.95 * averages
    incoherent = power
    for response in responses:
        with np.errstate(invalid="ignore", divide="ignore"):
            coherent = coherence(source - source.mean(), response - response.mean(), sample_rate, nperseg=segment)[1]
        part = power * (1.0 - np.nan_to_num(coherent)) * count / (count - 1.0)
        incoherent = np.minimum(incoherent, part)
    return float(np.quantile(incoherent[1:-1], THRESHOLDS.reading.record_noise_quantile))


def noise_lines(frequencies_hz: Sequence[float], sample_rate: float) -> FloatArray:
    """Lines that carry the integral over a frequency response up to half of the sampling rate, Hz, ascending.

    Args:
        frequencies_hz: of the model's modes.
        sample_rate: Hz.
    """
    count, highest = THRESHOLDS.reading.record_noise_lines, 0.5 * sample_rate
    apart = np.geomspace(_NEAREST, _FURTHEST, count)
    around = [f * np.concatenate((1.0 - apart, [1.0], 1.0 + apart)) for f in frequencies_hz]
    lines = np.unique(np.concatenate((highest * np.arange(1, count + 1) / count, *around)))
    return np.asarray(lines[(lines > 0.0) & (lines <= highest)])


def propagated_noise(density: float, responses: ComplexArray, frequency_hz: FloatArray) -> FloatArray:
    """Standard deviation of each response to a white input, (c,).

    Args:
        density: of the input, its unit squared per Hz.
        responses: frequency responses over the input, (c, lines); those that are not known count as none.
        frequency_hz: of the lines, ascending, Hz.
    """
    squares = np.nan_to_num(np.abs(responses) ** 2)
    return np.sqrt(density * np.trapezoid(squares, frequency_hz, axis=1))
