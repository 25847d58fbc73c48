"""Amplitudes of a locked window that had not settled: one transient, seen by all channels at one rate."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nmt_core.numerics.arrays import FloatArray
from nmt_diagnose.thresholds import THRESHOLDS

# How fast a transient may fall, over the window.
RATES = np.geomspace(0.5, 8.0, 25)
_EXACT_LOG_AMPLITUDE = 1e-12  # ln of an amplitude that is exact


@dataclass(frozen=True)
class Settling:
    """A transient of a window's amplitudes: ln of each is off by its size · exp(-rate · t), t from 0 to 1.

    Attributes:
        sizes: of each channel, shape (C,); 0 where none shows.
        rate: how fast it falls over the window.
        doubt: standard deviation of its mean over the window where it shows, relative to that mean; 1 = all of it.
    """

    sizes: FloatArray
    rate: float = 1.0
    doubt: float = 1.0

    @property
    def leans(self) -> FloatArray:
        """Mean over the window, shape (C,)."""
        result: FloatArray = self.sizes * _mean(self.rate)
        return result

    def excess(self, samples: int) -> FloatArray:
        """Of each amplitude over the settled one at each sample, relative, shape (C, samples)."""
        time = (np.arange(samples) + 0.5) / samples
        result: FloatArray = np.expm1(np.outer(self.sizes, np.exp(-self.rate * time)))
        return result


def _mean(rate: float) -> float:
    return float(-np.expm1(-rate) / rate)


def settling(logs: FloatArray, responses: NDArray[np.bool_]) -> Settling:
    """What falls exponentially in all channels at the rate that leaves least of their sub-windows.

    At phase resonance one mode carries the responses, so they share a size; a channel that is noisier than its
    transient takes that of the others. A channel that contradicts them has its own. The force has its own, too: it
    hardly follows the mode.

    Args:
        logs: ln of the amplitude in each sub-window, shape (K, C).
        responses: which channels are responses, shape (C,).

    Returns:
        The transient; sizes of zero where the sub-windows are fewer than six, or none shows.
    """
    count, channels = logs.shape
    if count < THRESHOLDS.noise.settling_fewest:
        return Settling(np.zeros(channels))
    time = (np.arange(count) + 0.5) / count
    values = logs - logs.mean(axis=0)
    tries = []
    for rate in RATES:
        falling = np.exp(-rate * time)
        falling -= falling.mean()
        power = float(falling @ falling)
        tried = falling @ values / power
        squares = ((values - np.outer(falling, tried)) ** 2).sum(axis=0) + _EXACT_LOG_AMPLITUDE**2
        tries.append((float(np.log(squares).sum()), tried, squares / (count - 2) / power))
    best = int(np.argmin([lost for lost, _, _ in tries]))
    _, sizes, variances = tries[best]
    common, shared = 0.0, np.zeros(channels, dtype=bool)
    if responses.any():
        weights = 1.0 / variances[responses]
        common = float(weights @ sizes[responses] / weights.sum())
        if common**2 * weights.sum() > THRESHOLDS.noise.settling_sigmas**2:
            shared = responses & ((sizes - common) ** 2 <= THRESHOLDS.noise.settling_sigmas**2 * variances)
    significant = sizes**2 > THRESHOLDS.noise.settling_sigmas**2 * variances
    found = np.where(shared, common, np.where(significant, sizes, 0.0))
    leading = int(np.argmax(np.abs(sizes) / np.sqrt(variances)))
    return Settling(found, float(RATES[best]), _doubt(tries, best, leading, count))


def _doubt(tries: list[tuple[float, FloatArray, FloatArray]], best: int, channel: int, count: int) -> float:
    """Relative standard deviation of a transient's mean in the channel that shows it best.

    By the rates that fit nearly as well; the slowest that is tried stands for all that is slower, which nothing bounds.
    """
    lost = np.array([cost for cost, _, _ in tries])
    weights = np.exp(-0.5 * (count - 2) * (lost - lost[best]))
    weights /= weights.sum()
    means = np.array([sizes[channel] * _mean(float(rate)) for rate, (_, sizes, _) in zip(RATES, tries, strict=True)])
    if best == 0 or means[best] == 0.0:
        return 1.0
    known = float(tries[best][2][channel]) * _mean(float(RATES[best])) ** 2
    spread = float(weights @ (means - means[best]) ** 2) + known
    return min(1.0, math.hypot(math.sqrt(spread) / abs(means[best]), THRESHOLDS.noise.settling_inexact))
