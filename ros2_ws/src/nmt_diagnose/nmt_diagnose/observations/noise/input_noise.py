"""Noise of a measured input: it drives the model and never drove the structure.

White noise of the input is incoherent with every response, by as much at every frequency. What else makes a response
incoherent, its own noise, nonlinear distortions, leakage of a resonance, comes on top and not everywhere. So the noise
is at most the least of S_uu (1 − γ²), γ² the coherence (Bendat and Piersol, Random Data (2010), ch. 9). Propagated to a
response by the model, it is at most the incoherent part of that response at the lines that pass most of it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.signal import coherence, istft, stft, welch

from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_diagnose.thresholds import THRESHOLDS

_SEGMENTS = 16
_WIDEST_SHARE = 0.3  # of lines from a resonance, over its frequency
_FINEST_SHARE = 1e-5
_COMPARED_SHARE = 0.9  # share of the propagated noise whose lines are compared with the incoherent response
_PIECE = 64  # samples
_LOST = 1e-4  # of the lines of noise in pieces
_LOBE = 2  # lines of a spectrum over which its window spreads a resonance


class InputNoise(NamedTuple):
    """What of a record is incoherent.

    Attributes:
        density: of the white noise of the input, one-sided, its unit squared per Hz; 0 = not known.
        resolution_hz: of the lines.
        incoherent: density of each response that the input does not make, (c, lines) from 0 Hz on.
        known: samples of the input that are its noise alone, see :func:`noise_part`, (n,).
        left: density of the rest of the noise over that of all noise, (lines,).
    """

    density: float
    resolution_hz: float
    incoherent: FloatArray
    known: FloatArray = np.zeros(0)
    left: FloatArray = np.ones(1)


def input_noise(source: FloatArray, responses: FloatArray, sample_rate: float) -> InputNoise:
    """Noise of an input, estimated from its coherence with the responses.

    Args:
        source: samples of the input, (n,).
        responses: of the responses, (c, n).
        sample_rate: Hz.
    """
    segment = 2 ** max(6, int(np.log2(max(source.size // _SEGMENTS, 1))))
    averages = 2 * source.size // segment - 1
    if averages < THRESHOLDS.reading.record_fewest_averages:
        return InputNoise(0.0, sample_rate, np.zeros((responses.shape[0], 1)), np.zeros(source.size))
    # Windows of Hann that overlap by half are as good as 0.95 of their number.
    unbiased = 0.95 * averages / (0.95 * averages - 1.0)
    source = source - source.mean()
    least, incoherent = welch(source, sample_rate, nperseg=segment)[1], []
    power = least
    for response in responses - responses.mean(axis=1, keepdims=True):
        with np.errstate(invalid="ignore", divide="ignore"):
            coherent = coherence(source, response, sample_rate, nperseg=segment)[1]
        apart = (1.0 - np.nan_to_num(coherent)) * unbiased
        least = np.minimum(least, power * apart)
        incoherent.append(apart * welch(response, sample_rate, nperseg=segment)[1])
    density = float(np.quantile(least[1:-1], THRESHOLDS.reading.record_noise_quantile))
    known = noise_part(source, density, sample_rate)
    share = welch(known, sample_rate, nperseg=segment)[1] / density if density > 0.0 else np.zeros(1)
    return InputNoise(density, sample_rate / segment, np.array(incoherent), known, np.maximum(1.0 - share, 0.0))


def noise_part(source: FloatArray, density: float, sample_rate: float) -> FloatArray:
    """What of an input is noise, where and when it is no more than that: after a tap, off its band, (n,).

    Args:
        source: samples of the input, (n,).
        density: of its white noise, one-sided, its unit squared per Hz.
        sample_rate: Hz.
    """
    if not density > 0.0 or source.size < _PIECE:
        return np.zeros(source.size)
    _, _, pieces = stft(source - source.mean(), sample_rate, nperseg=_PIECE, scaling="psd")
    # Squares of lines of noise have an exponential distribution about half of the one-sided density.
    pieces[np.abs(pieces) ** 2 > -math.log(_LOST) * 0.5 * density] = 0.0
    return np.asarray(istft(pieces, sample_rate, nperseg=_PIECE, scaling="psd")[1][: source.size])


def noise_lines(frequencies_hz: Sequence[float], sample_rate: float, duration_s: float) -> FloatArray:
    """Lines that carry the integral over a frequency response up to half of the sampling rate, Hz, ascending.

    Nearer to a resonance than half a line of the whole record there is none: so long it takes to ring up.

    Args:
        frequencies_hz: of the model's modes.
        sample_rate: Hz.
        duration_s: of the record, s.
    """
    count, highest, nearest = THRESHOLDS.reading.record_noise_lines, 0.5 * sample_rate, 0.5 / duration_s
    around = []
    for f in frequencies_hz:
        apart = f * np.geomspace(_FINEST_SHARE, _WIDEST_SHARE, count)
        around += [f - apart, f + apart]
    lines = np.unique(np.concatenate((highest * np.arange(1, count + 1) / count, *around)))
    far = np.all(np.abs(lines[:, None] - np.asarray(frequencies_hz)[None, :]) >= nearest, axis=1)
    return np.asarray(lines[far & (lines >= nearest) & (lines <= highest)])


def propagated_noise(noise: InputNoise, responses: ComplexArray, frequency_hz: FloatArray) -> FloatArray:
    """Standard deviation of each response to the noise of the input that is not known, (c,).

    Args:
        noise: of the input.
        responses: frequency responses over the input, (c, lines); those that are not known count as none.
        frequency_hz: of the lines, ascending, Hz.
    """
    if not noise.density > 0.0 or frequency_hz.size < 2:
        return np.zeros(responses.shape[0])
    squares = noise.density * np.nan_to_num(np.abs(responses) ** 2, posinf=0.0)
    lines = noise.incoherent.shape[1]
    middle = 0.5 * (frequency_hz[1:] + frequency_hz[:-1])
    place = np.minimum(np.round(middle / noise.resolution_hz).astype(np.int64), lines - 1)
    left = noise.left[np.minimum(place, noise.left.size - 1)]
    parts = 0.5 * (squares[:, 1:] + squares[:, :-1]) * np.diff(frequency_hz) * left
    result = np.zeros(responses.shape[0])
    for number, part in enumerate(parts):
        by_line = np.bincount(place, part, lines)
        total = float(by_line.sum())
        order = np.argsort(-by_line, kind="stable")
        most = order[: int(np.searchsorted(np.cumsum(by_line[order]), _COMPARED_SHARE * total)) + 1]
        near = np.unique((most[:, None] + np.arange(-_LOBE, _LOBE + 1)).clip(0, lines - 1))
        present = float(noise.incoherent[number, near].sum()) * noise.resolution_hz / _COMPARED_SHARE
        result[number] = np.sqrt(min(total, present))
    return result
