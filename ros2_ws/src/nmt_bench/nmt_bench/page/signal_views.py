"""What is drawn of the newest samples: whole periods that stand still, orbits, spectra, averaged responses."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from nmt_bench.page.channels import TopicSignals
from nmt_core.numerics.arrays import FloatArray
from nmt_core.vocabulary import MOTIONS, Quantity

PERIODS = 3
HARMONICS = 10
_ORBIT_HARMONICS = 20
_MOST_LINES = 500


def whole_periods(signals: TopicSignals, periods: int = PERIODS) -> tuple[FloatArray, float]:
    """The newest whole periods of all channels, beginning where the excitation's phase is zero.

    Returns:
        Samples, shape ``(channels, samples)``, and the frequency in Hz. Without a periodic excitation the last tenth
        of a second and NaN.
    """
    frequency = signals.oscillator.frequency_hz
    rate = signals.sample_rate
    if not frequency > 0.0 or not math.isfinite(signals.oscillator.cycles):
        return signals.recent.last(round(0.1 * rate)), math.nan
    length = round(periods * rate / frequency)
    end = signals.recent.end_sample
    past = signals.phase_at(end) % 1.0 / frequency * rate
    taken = signals.recent.last(length + round(past))
    return (taken[:, :length], frequency) if taken.shape[1] >= length >= 8 else (taken[:, :0], frequency)


def paired_periods(
    force: TopicSignals, response: TopicSignals, periods: int = PERIODS
) -> tuple[FloatArray, FloatArray, float]:
    """The newest whole periods that two topics have in common, for an orbit: the same samples of both.

    Returns:
        Samples of all channels of either, ``(channels, samples)``, and the frequency in Hz; no samples and NaN where
        the excitation is not periodic, or where one of them does not reach far enough back.
    """
    none = np.zeros((0, 0)), np.zeros((0, 0)), math.nan
    frequency, rate = force.oscillator.frequency_hz, force.sample_rate
    if not frequency > 0.0 or not math.isfinite(force.oscillator.cycles) or response.sample_rate != rate:
        return none
    end = min(force.recent.end_sample, response.recent.end_sample)
    length = round(periods * rate / frequency)
    reach = length + round(force.phase_at(end) % 1.0 / frequency * rate)
    force_cut, response_cut = (
        signals.recent.last(reach + signals.recent.end_sample - end)[:, :length] for signals in (force, response)
    )
    if min(force_cut.shape[1], response_cut.shape[1]) < length or length < 8:
        return none
    return force_cut, response_cut, frequency


def deflection(periods_of: FloatArray, points: Sequence[int], periods: int = PERIODS) -> FloatArray:
    """Fundamental of every channel in phase with the largest one, over it: the shape at this moment.

    Args:
        periods_of: whole periods, ``(channels, samples)``.
        points: of the channels; channels of point 0 take no part.
        periods: how many there are.

    Returns:
        Shape ``(channels,)``, 1 for the largest; empty where nothing moves.
    """
    if periods_of.shape[1] <= 2 * periods:
        return np.empty(0)
    lines = np.fft.rfft(periods_of, axis=1)[:, periods] * (np.asarray(points) > 0)
    largest = lines[np.argmax(np.abs(lines))]
    return np.asarray((lines / largest).real, dtype=np.float64) if abs(largest) > 0.0 else np.empty(0)


def fundamental_amplitudes(periods_of: FloatArray, frequency: float, periods: int = PERIODS) -> FloatArray:
    """Amplitude of the fundamental of every channel, (channels,).

    Args:
        periods_of: whole periods, ``(channels, samples)``.
        frequency: Hz; NaN without a periodic excitation.
        periods: how many there are.

    Returns:
        In the unit of each channel; NaN without a periodic excitation or without samples.
    """
    samples = periods_of.shape[1]
    if not math.isfinite(frequency) or samples <= 2 * periods:
        return np.full(periods_of.shape[0], np.nan)
    return np.asarray(2.0 / samples * np.abs(np.fft.rfft(periods_of, axis=1)[:, periods]), dtype=np.float64)


def velocity_of(response: FloatArray, quantity: Quantity, periods: int, frequency: float) -> FloatArray:
    """Velocity of a periodic response by its harmonics.

    Args:
        response: displacement, velocity or acceleration over whole periods, (samples,).
        quantity: which of them.
        periods: how many there are.
        frequency: Hz.
    """
    spectrum = np.fft.rfft(response)
    kept = np.zeros_like(spectrum)
    orders = np.arange(1, _ORBIT_HARMONICS + 1)
    orders = orders[orders * periods < spectrum.size]
    power = 1 - MOTIONS[quantity]
    kept[orders * periods] = spectrum[orders * periods] * (2j * np.pi * orders * frequency) ** power
    return np.asarray(np.fft.irfft(kept, response.size), dtype=np.float64)


def amplitude_spectrum(data: FloatArray, sample_rate: float, highest_hz: float) -> tuple[FloatArray, FloatArray]:
    """Amplitudes of the lines of a Hann-windowed stretch.

    Args:
        data: (samples,).
        sample_rate: Hz.
        highest_hz: lines above are left out.

    Returns:
        Frequency (Hz) and amplitude in the unit of the data, the largest of neighbouring lines where there are many.
    """
    window = np.hanning(data.size + 1)[:-1]
    lines = np.fft.rfft(window * (data - data.mean()))
    amplitude: FloatArray = np.asarray(np.abs(lines) * (2.0 / window.sum()), dtype=np.float64)
    frequency = np.fft.rfftfreq(data.size, 1.0 / sample_rate).astype(np.float64)
    count = int(np.searchsorted(frequency, highest_hz, side="right"))
    frequency, amplitude = frequency[:count], amplitude[:count]
    if count > _MOST_LINES:
        starts = np.linspace(0, count, _MOST_LINES + 1).astype(np.int64)[:-1]
        return frequency[starts], np.maximum.reduceat(amplitude, starts)
    return frequency, amplitude


def harmonic_amplitudes(frequency: FloatArray, amplitude: FloatArray, fundamental: float) -> FloatArray:
    """Largest amplitude within half a line's distance or so of each harmonic, (HARMONICS,); NaN beyond the lines."""
    found = np.full(HARMONICS, np.nan)
    if frequency.size < 3 or not fundamental > 0.0:
        return found
    reach = 2.0 * (frequency[1] - frequency[0])
    for order in range(1, HARMONICS + 1):
        near = np.abs(frequency - order * fundamental) <= reach
        if order * fundamental <= frequency[-1] and near.any():
            found[order - 1] = amplitude[near].max()
    return found
