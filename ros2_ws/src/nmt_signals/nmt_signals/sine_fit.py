"""Excitation frequency of a periodic signal with an unrecorded phase.

A Gauss–Newton fit of a Fourier series with unknown frequency (the sine fit of IEEE 1057, with harmonics). The
harmonics are eliminated in every step (variable projection), so only the frequency is iterated.
"""

from __future__ import annotations

import math

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.numerics.arrays import FloatArray
from nmt_signals.harmonics import (
    harmonic_amplitudes,
    resolvable_harmonics,
    segment_moments,
    solve_moments,
    synthesise,
)
from nmt_signals.spectral_lines import strongest_line

# First piece of a sine of unknown frequency: its guess is right to a small part of a turn there.
_FIRST_PERIODS = 6.0
# Factor from piece to piece; the frequency is known to less than a turn of the next.
_GROWTH = 4.0
# Steps of a fit of frequency, amplitude and phase.
_STEPS = 30


def fit_frequency(signal: FloatArray, sample_rate: float, guess_hz: float, harmonics: int = 3) -> float:
    """Refine the frequency of a periodic signal.

    The fit starts on a few periods and lengthens them, so the guess may be off by several per cent.

    Args:
        signal: shape ``(samples,)``.
        sample_rate: Hz.
        guess_hz: Hz; NaN or 0 = take the strongest line of the spectrum.
        harmonics: harmonics of the fit.

    Returns:
        Frequency, Hz.

    Raises:
        BenchError: no periodic signal, or the fit does not converge.
    """
    if not np.ptp(signal) > 0.0:
        raise BenchError("The force is constant, so the excitation frequency cannot be found; check the force sensor.")
    frequency = guess_hz if math.isfinite(guess_hz) and guess_hz > 0.0 else strongest_line(signal, sample_rate)
    harmonics = max(1, resolvable_harmonics(harmonics, sample_rate / frequency))
    periods = _FIRST_PERIODS
    while True:
        samples = min(signal.shape[0], math.ceil(periods * sample_rate / frequency))
        complete = samples == signal.shape[0]
        start = (signal.shape[0] - samples) // 2
        frequency = _gauss_newton(signal[start : start + samples], sample_rate, frequency, harmonics)
        if complete:
            return frequency
        periods *= _GROWTH


def _gauss_newton(signal: FloatArray, sample_rate: float, frequency: float, harmonics: int) -> float:
    # Time about the middle: frequency and phase are then nearly uncorrelated.
    time = (np.arange(signal.shape[0]) - 0.5 * (signal.shape[0] - 1)) / sample_rate
    span = signal.shape[0] / sample_rate
    row = np.ascontiguousarray(signal, dtype=np.float64)[np.newaxis]
    bounds = np.array([0, signal.shape[0]], dtype=np.int64)
    orders = np.arange(harmonics + 1)
    start = frequency
    step = math.inf
    for _ in range(_STEPS):
        cycles = frequency * time
        amplitudes = harmonic_amplitudes(cycles, row, harmonics)[0]
        residual = row[0] - synthesise(cycles, amplitudes)
        slope = 2.0 * np.pi * time * synthesise(cycles, 1j * orders * amplitudes)
        moments = segment_moments(cycles, slope[np.newaxis], harmonics, bounds)
        explained = synthesise(cycles, solve_moments(moments)[0, 0])
        # The share of the slope that the harmonics cannot imitate.
        free = slope - explained
        previous, step = step, float((free * residual).sum() / (free * free).sum())
        frequency += step
        if not abs(frequency - start) * span < 1.5 or not frequency > 0.0:
            break
        # The phase at the ends of the stretch settles to rounding.
        if abs(step) * span < 1e-13 or (abs(step) * span < 1e-9 and abs(step) >= abs(previous)):
            return frequency
    raise BenchError(
        f"No steady sine near {start:.6g} Hz in the force; check the frequency that the window names and "
        "the force "
        "channel."
    )
