"""What clipping and a coarse converter make of the harmonics of a channel."""

from __future__ import annotations

import numpy as np
from scipy.special import ndtr

from nmt_core.blocks import FloatArray
from nmt_diagnose.twin.linear_model import ComplexArray
from nmt_rig.model.fourier_basis import FourierBasis

SAMPLES = 512
# Beyond this many steps of amplitude the staircase adds less than a hundredth of a step to any harmonic.
COARSE = 64.0
# Deviations of the noise within which it reaches a clipping level often enough to matter.
NOISE_REACH = 4.0


def recorded_harmonics(amplitudes: ComplexArray, limits: FloatArray, basis: FourierBasis) -> ComplexArray:
    """Harmonics (c, n_orders) of the recorded values of channels with harmonics ``amplitudes`` before the converter.

    Args:
        amplitudes: (c, n_orders).
        limits: (c, 3) clipping level, quantisation step, noise deviation before the converter.
        basis: orders.
    """
    result = amplitudes
    if not (np.any(np.isfinite(limits[:, 0])) or np.any(limits[:, 1] > 0.0)):
        return result
    for index, (level, step, noise) in enumerate(limits):
        peak = float(np.sum(np.abs(amplitudes[index]))) + NOISE_REACH * noise
        clips = peak > level
        coarse = step > 0.0 and np.abs(amplitudes[index]).max() < COARSE * step and noise < 0.7 * step
        if not (clips or coarse):
            continue
        if result is amplitudes:
            result = amplitudes.copy()
        values = basis.sampled(SAMPLES) @ basis.to_real(amplitudes[index])
        if clips:
            values = expected_clipped(values, level, noise)
        if coarse:
            values = expected_quantised(values, step, noise)
        projection = 2.0 / SAMPLES * (basis.sampled(SAMPLES).T @ values)
        projection[0] *= 0.5
        result[index] = basis.to_complex(projection)
    return result


def expected_clipped(values: FloatArray, level: float, noise: float) -> FloatArray:
    """Mean of clip(value + noise, ±level) over Gaussian noise of the given deviation."""
    if not noise > 0.0:
        return np.asarray(np.clip(values, -level, level))
    above, below = (level - values) / noise, (-level - values) / noise
    inside = ndtr(above) - ndtr(below)
    density = (np.exp(-0.5 * below**2) - np.exp(-0.5 * above**2)) / np.sqrt(2.0 * np.pi)
    return np.asarray(level * (ndtr(-above) - ndtr(below)) + values * inside + noise * density)


def expected_quantised(values: FloatArray, step: float, noise: float) -> FloatArray:
    """Mean of step · round((value + noise) / step) over Gaussian noise of the given deviation (Widrow's series)."""
    if noise < 0.1 * step:
        return np.asarray(step * np.round(values / step))
    result = values.copy()
    for k in range(1, 8):
        damped = np.exp(-2.0 * (np.pi * k * noise / step) ** 2)
        result += (-1.0) ** k * step / (np.pi * k) * damped * np.sin(2.0 * np.pi * k * values / step)
    return result
