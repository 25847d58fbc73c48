"""What clipping and a coarse converter make of the harmonics of a channel."""

from __future__ import annotations

import numpy as np
from scipy.special import ndtr

from nmt_core.arrays import ComplexArray, FloatArray
from nmt_rig.model.fourier_basis import FourierBasis

SAMPLES = 512
# Beyond this many steps of amplitude the staircase adds less than a hundredth of a step to any harmonic.
COARSE = 64.0
# Deviations of the noise within which it reaches a clipping level often enough to matter.
NOISE_REACH = 4.0


def recorded_harmonics(amplitudes: ComplexArray, limits: FloatArray, basis: FourierBasis) -> ComplexArray:
    """Harmonics (…, c, n_orders) of the recorded values of channels with harmonics ``amplitudes`` before the converter.

    Args:
        amplitudes: (…, c, n_orders).
        limits: (c, 3) clipping level, quantisation step, noise deviation before the converter.
        basis: orders.
    """
    level, step, noise = limits.T
    if not (np.any(np.isfinite(level)) or np.any(step > 0.0)):
        return amplitudes
    sizes = np.abs(amplitudes)
    clips = sizes.sum(axis=-1) + NOISE_REACH * noise > level
    coarse = (step > 0.0) & (sizes.max(axis=-1) < COARSE * step) & (noise < 0.7 * step)
    result = amplitudes.copy()
    for index in map(tuple, np.argwhere(clips | coarse)):
        own = limits[index[-1]]
        values = basis.sampled(SAMPLES) @ basis.to_real(amplitudes[index])
        if clips[index]:
            values = expected_clipped(values, own[0], own[2])
        if coarse[index]:
            values = expected_quantised(values, own[1], own[2])
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
