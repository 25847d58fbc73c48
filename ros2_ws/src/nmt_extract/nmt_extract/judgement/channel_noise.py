"""Noise of the channels, and whether that of one alone has risen."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_signals.harmonics import Moments

_NOISE_JUMP, _NOISE_SHARE = 10.0, 0.05  # over the level before; of the channel's rms


def noise_rms(data: FloatArray, moments: Moments, amplitudes: ComplexArray) -> FloatArray:
    """What no harmonic explains.

    Args:
        data: shape ``(channels, samples)``.
        moments: of the parts of the window; a level that still changes from part to part is not noise.
        amplitudes: harmonics 0..H of each part, shape ``(parts, channels, H + 1)``.

    Returns:
        rms, shape ``(channels,)``.
    """
    total = np.einsum("ij,ij->i", data, data)
    explained = (amplitudes * moments.projections).real.sum(axis=(0, 2))
    return np.asarray(np.sqrt(np.maximum(total - explained, 0.0) / data.shape[1]))


def unrepeated_rms(residual: FloatArray, samples_per_period: float) -> float:
    """What of a residual does not come again a period later, rms: noise, but no harmonic of however high an order.

    Args:
        residual: of one channel, shape ``(samples,)``, more than one period.
        samples_per_period: need not be whole.
    """
    place = np.arange(residual.size - int(np.ceil(samples_per_period)), dtype=np.float64)
    later = np.interp(place + samples_per_period, np.arange(residual.size), residual)
    return float(np.sqrt(0.5 * np.mean((later - residual[: place.size]) ** 2)))


def noise_jumps(
    noise: FloatArray, rms: FloatArray, before: FloatArray, rows: Sequence[int], unrepeated: Callable[[int], float]
) -> Mapping[int, str]:
    """Rows whose noise alone has risen since the level before, with the words why.

    Args:
        noise, rms, before: of each row: what no harmonic explains, all, and the noise of the level before.
        rows: that are judged.
        unrepeated: rms of the part that does not repeat a period later, by row: slip has harmonics beyond those fitted.
    """
    rise = {row: noise[row] / max(before[row], 1e-6 * rms[row], 1e-300) for row in rows}
    found = {}
    for row in rows:
        usual = float(np.median([rise[other] for other in rows if other != row] or [1.0]))
        jumped = rise[row] > _NOISE_JUMP * max(usual, 1.0) and noise[row] > _NOISE_SHARE * rms[row]
        if jumped and unrepeated(row) > 0.5 * noise[row]:
            found[row] = f"has {100.0 * noise[row] / rms[row]:.0f} % of noise, much more than at the level before"
    return found
