"""The analogue way from a sensor to its converter: first-order filters and a delay, for sampled signals.

Between samples the signal is taken as the polynomial through the last six samples; a filter's response to that is
exact. Relative error at ω for sampling intervals h: about 0.02 (ωh)⁶, i.e. 8e-8 at a fiftieth of the sample rate and
1e-3 at a tenth. The history before the first sample is zero: at rest. Such a polynomial rings about a step; a signal
with steps is taken as straight lines between its samples.
"""

from __future__ import annotations

import math

import numpy as np

from nmt_core.numerics.arrays import FloatArray
from nmt_core.numerics.kernels import njit

# Samples that the polynomial passes through.
NODES = 6


def lagrange_weights(positions: FloatArray, count: int = NODES) -> FloatArray:
    """(p, count) weights of samples k, k - 1, … for the values at k - positions (p,), in samples."""
    nodes = np.arange(count, dtype=np.float64)
    weights = np.ones((positions.size, count))
    for j in range(count):
        others = np.delete(nodes, j)
        weights[:, j] = np.prod((positions[:, None] - others) / (nodes[j] - others), axis=1)
    return weights


def low_pass_weights(rate: float, interval: float, count: int = NODES) -> tuple[FloatArray, float]:
    """One step of ẏ = rate (x - y) as y[k] = decay y[k - 1] + Σ weights[j] x[k - j].

    Args:
        rate: ω_c, rad/s.
        interval: sampling interval, s.
        count: samples that the polynomial passes through.

    Returns:
        weights (count,) and decay.
    """
    decay = math.exp(-rate * interval)
    nodes, shares = np.polynomial.legendre.leggauss(128)
    # Time before the newest sample, in samples.
    before = 0.5 * (1.0 - nodes)
    kernel = 0.5 * shares * rate * interval * np.exp(-rate * interval * before)
    weights = lagrange_weights(before, count).T @ kernel
    # A constant is to pass unchanged, whatever the quadrature.
    return weights * ((1.0 - decay) / weights.sum()), decay


@njit(cache=True)
def weigh(extended: FloatArray, weights: FloatArray, decay: float, last: float, result: FloatArray) -> float:
    """result[k] = decay · result[k - 1] + Σ_j weights[j] extended[k + m - 1 - j], m weights; returns the last value.

    Args:
        extended: (m - 1 + n,) history, then the present samples.
        weights: (m,); zeros in front of the others cost nothing.
        decay, last: of the recursion; last is the result before the first.
        result: (n,) overwritten.
    """
    m = weights.size
    first = 0
    while first < m - 1 and weights[first] == 0.0:
        first += 1
    value = last
    for k in range(result.size):
        total = decay * value
        for j in range(first, m):
            total += weights[j] * extended[k + m - 1 - j]
        value = total
        result[k] = value
    return value


class Filter:
    """A recursion over sampled values that remembers its history; independent of the block length, bit for bit."""

    def __init__(self, weights: FloatArray, decay: float = 0.0) -> None:
        self._weights = np.ascontiguousarray(weights)
        self._decay = decay
        self._last = 0.0
        self._history = np.zeros(weights.size - 1)

    def process(self, values: FloatArray) -> FloatArray:
        """The next (n,) values."""
        extended = np.concatenate([self._history, values])
        result = np.empty(values.size)
        self._last = weigh(extended, self._weights, self._decay, self._last, result)
        self._history = extended[values.size :]
        return result


class AnalogueChain:
    """Low-pass 1 / (1 + iω/ω_c), high-pass iω / (iω + ω_h), delay e^{-iωτ}, in this order; None or 0 = not there.

    Args:
        sample_rate: Hz.
        low_pass_hz, high_pass_hz: corner frequencies, Hz.
        delay: s; at least minus one sampling interval (a channel that leads is extrapolated).
        steps: the signal has steps between samples.

    Raises:
        ValueError: a delay that would need the future.
    """

    def __init__(
        self,
        sample_rate: float,
        low_pass_hz: float | None = None,
        high_pass_hz: float | None = None,
        delay: float = 0.0,
        steps: bool = False,
    ) -> None:
        interval = 1.0 / sample_rate
        samples = delay * sample_rate
        if samples < -1.0 - 1e-9:
            raise ValueError(f"a channel can lead by one sampling interval ({interval:g} s) at most, got {-delay:g} s")
        count = 2 if steps else NODES
        self._low = Filter(*low_pass_weights(2.0 * math.pi * low_pass_hz, interval, count)) if low_pass_hz else None
        self._high = Filter(*low_pass_weights(2.0 * math.pi * high_pass_hz, interval, count)) if high_pass_hz else None
        self._delay: Filter | None = None
        if delay != 0.0:
            # Between the two middle nodes where the history allows it.
            whole = max(math.floor(samples) - (count // 2 - 1), 0)
            weights = np.concatenate([np.zeros(whole), lagrange_weights(np.array([samples - whole]), count)[0]])
            self._delay = Filter(weights)
        self.plain = self._low is None and self._high is None and self._delay is None

    def process(self, values: FloatArray) -> FloatArray:
        """What the converter sees of the next (n,) values."""
        if self._low is not None:
            values = self._low.process(values)
        if self._high is not None:
            values = values - self._high.process(values)
        if self._delay is not None:
            values = self._delay.process(values)
        return values
