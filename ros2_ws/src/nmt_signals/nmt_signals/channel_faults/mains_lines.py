"""Spectral lines that follow no excitation: the mains, with the harmonics of a steady oscillation or in silence."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_signals.thresholds import CHANNEL_FAULTS

# Order of the drive up to which a harmonic folded at half the rate may lie on the mains.
_HIGHEST_FOLDED_ORDER = 60

MAINS_HZ = (50.0, 60.0)
"""Frequencies of the mains, the one of most countries first, Hz."""
_NEIGHBOURS = np.concatenate((np.arange(-12, -1), np.arange(2, 13))).astype(np.float64)


@dataclass(frozen=True)
class Line:
    """Amplitudes of one line in all channels, in their units.

    Attributes:
        amplitudes: less what noise adds on average; below zero where there is less than that, shape (channels,).
        std: standard uncertainties, shape (channels,).
    """

    amplitudes: FloatArray
    std: FloatArray


def mains_line(
    cycles: FloatArray | None, data: FloatArray, sample_rate: float, harmonics: int, line_hz: float
) -> Line | None:
    """Amplitude of a line of the mains in a window of steady oscillation, or in silence.

    The line is fitted with the harmonics, in pieces short enough for a mains that wanders; its phase is free. The
    power that the noise of the neighbouring frequencies has is taken off: the amplitude is sign(P) √|P| of the
    remaining power P, so that windows without a line scatter about zero.

    Args:
        cycles: phase of the excitation, cycles, shape (samples,); None = there is none.
        data: samples, shape (channels, samples).
        sample_rate: Hz.
        harmonics: orders that are taken out.
        line_hz: Hz.

    Returns:
        The line; None where a harmonic, folded ones too, or zero lies within three lines of the spectrum, or the noise
        cannot be told.
    """
    samples = data.shape[1]
    if samples == 0:
        return None
    pieces = max(1, math.ceil(samples / sample_rate / CHANNEL_FAULTS.mains_longest_s))
    length = samples // pieces
    resolution = sample_rate / length
    orders = np.zeros(1)
    if line_hz > 0.5 * sample_rate - CHANNEL_FAULTS.mains_clearance_lines * resolution:
        return None
    if cycles is not None:
        fundamental = float(cycles[-1] - cycles[0]) / (samples - 1) * sample_rate
        orders = np.arange(math.ceil(line_hz / fundamental) + len(_NEIGHBOURS)) * fundamental
        # High orders of a joint that slips are folded at the sampling rate, and may come close to the line.
        high = np.arange(math.floor(0.5 * sample_rate / fundamental) + 1, _HIGHEST_FOLDED_ORDER + 1) * fundamental
        orders = np.concatenate((orders, np.abs(high - np.round(high / sample_rate) * sample_rate)))
    if np.abs(orders - line_hz).min() < CHANNEL_FAULTS.mains_clearance_lines * resolution:
        return None
    near = line_hz + _NEIGHBOURS * resolution
    clear = np.abs(near[:, None] - orders).min(axis=1) > resolution
    for other in MAINS_HZ:
        clear &= (other == line_hz) | (np.abs(near - other) > resolution)
    near = near[clear & (near > 0.0) & (near < 0.5 * sample_rate)]
    if near.size < CHANNEL_FAULTS.mains_fewest_neighbours:
        return None
    powers, noises = np.zeros(data.shape[0]), np.zeros(data.shape[0])
    for piece in range(pieces):
        part = slice(piece * length, (piece + 1) * length)
        turns = np.zeros(length) if cycles is None else cycles[part]
        taken_out = 0 if cycles is None else harmonics
        found = _between_harmonics(turns, data[:, part], taken_out, np.concatenate(([line_hz], near)) / sample_rate)
        power = np.abs(found) ** 2
        noise = power[:, 1:].mean(axis=1)
        powers += power[:, 0] - noise
        noises += noise
    powers, noises = powers / pieces, noises / pieces
    # Root mean square of the signed root without a line: of |P| over the mean noise, gamma distributed over the pieces.
    spread = math.sqrt(_mean_deviation(pieces))
    return Line(np.sign(powers) * np.sqrt(np.abs(powers)), spread * np.sqrt(noises))


def _between_harmonics(cycles: FloatArray, data: FloatArray, harmonics: int, per_sample: FloatArray) -> ComplexArray:
    """Complex amplitudes (channels, frequencies) of tones, each fitted with the harmonics."""
    steady = _tones(cycles, np.arange(1, harmonics + 1, dtype=np.float64))
    taken = np.concatenate((np.ones((1, cycles.size)), steady.real, steady.imag))
    tones = _tones(np.arange(cycles.size, dtype=np.float64), per_sample)
    factor = np.linalg.cholesky(taken @ taken.T)
    both = np.concatenate((tones.real, tones.imag))
    # What the harmonics take of tones and data comes off their products; nothing has the length of the samples.
    tones_taken = np.linalg.solve(factor, taken @ both.T)
    on_data = both @ data.T - tones_taken.T @ np.linalg.solve(factor, taken @ data.T)
    result = np.empty((data.shape[0], per_sample.size), dtype=np.complex128)
    for number in range(per_sample.size):
        pair = [number, number + per_sample.size]
        mine, off = both[pair], tones_taken[:, pair]
        cosine, sine = np.linalg.solve(mine @ mine.T - off.T @ off, on_data[pair])
        result[:, number] = cosine - 1j * sine
    return result


def _tones(turns: FloatArray, factors: FloatArray) -> ComplexArray:
    """exp(2πi factor · turns), shape (factors, samples); equal steps of the factors cost one product each."""
    result = np.empty((factors.size, turns.size), dtype=np.complex128)
    step, last = math.nan, np.zeros(0, dtype=np.complex128)
    for number, factor in enumerate(factors):
        change = factor - factors[number - 1] if number else math.nan
        if number and math.isclose(change, step, rel_tol=1e-9):
            result[number] = result[number - 1] * last
            continue
        result[number] = np.exp(2j * np.pi * factor * turns)
        if number:
            step, last = change, np.exp(2j * np.pi * change * turns)
    return result


def _mean_deviation(count: int) -> float:
    """Mean of |X − 1| of the mean X of ``count`` exponential variables of mean 1: 2 count^count e^−count / count!."""
    return 2.0 * math.exp(count * math.log(count) - count - math.lgamma(count + 1))
