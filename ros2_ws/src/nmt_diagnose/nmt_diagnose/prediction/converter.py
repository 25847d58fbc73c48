"""What clipping and a coarse converter make of the harmonics of a channel."""

from __future__ import annotations

import numpy as np
from scipy.special import ndtr

from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_rig.model.fourier_basis import FourierBasis

SAMPLES = 512


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
    clips = sizes.sum(axis=-1) + THRESHOLDS.prediction.noise_reach_sigmas * noise > level
    coarse = (step > 0.0) & (sizes.max(axis=-1) < THRESHOLDS.prediction.coarse_steps * step) & (noise < 0.7 * step)
    result = amplitudes.copy()
    changed = clips | coarse
    if not changed.any():
        return result
    level, step, noise = (np.broadcast_to(array, sizes.shape[:-1])[changed][:, None] for array in (level, step, noise))
    clips, coarse = clips[changed], coarse[changed]
    waves = basis.sampled(SAMPLES)
    values = basis.to_real(amplitudes[changed]) @ waves.T
    values[clips] = expected_clipped(values[clips], level[clips], noise[clips])
    values[coarse] = expected_quantised(values[coarse], step[coarse], noise[coarse])
    projection = 2.0 / SAMPLES * (values @ waves)
    projection[:, 0] *= 0.5
    result[changed] = basis.to_complex(projection)
    return result


def expected_clipped(values: FloatArray, level: FloatArray | float, noise: FloatArray | float) -> FloatArray:
    """Mean of clip(value + noise, ±level) over Gaussian noise of the given deviation."""
    clipped = np.clip(values, -level, level)
    noisy = np.broadcast_to(np.asarray(noise) > 0.0, values.shape)
    if not noisy.any():
        return np.asarray(clipped)
    spread = np.where(np.asarray(noise) > 0.0, noise, 1.0)
    above, below = (level - values) / spread, (-level - values) / spread
    inside = ndtr(above) - ndtr(below)
    density = (np.exp(-0.5 * below**2) - np.exp(-0.5 * above**2)) / np.sqrt(2.0 * np.pi)
    mean = level * (ndtr(-above) - ndtr(below)) + values * inside + spread * density
    return np.where(noisy, mean, clipped)


def expected_quantised(values: FloatArray, step: FloatArray | float, noise: FloatArray | float) -> FloatArray:
    """Mean of step · round((value + noise) / step) over Gaussian noise of the given deviation (Widrow's series)."""
    smoothed = values.copy()
    for k in range(1, 8):
        damped = np.exp(-2.0 * (np.pi * k * noise / step) ** 2)
        smoothed += (-1.0) ** k * step / (np.pi * k) * damped * np.sin(2.0 * np.pi * k * values / step)
    return np.where(np.asarray(noise) < 0.1 * np.asarray(step), step * np.round(values / step), smoothed)
