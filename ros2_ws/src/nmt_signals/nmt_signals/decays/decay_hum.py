"""Lines of the mains next to a free decay: the demodulation passes what lies near the mode, and it would beat with it.

The mode's slow amplitude and phase are taken as smooth, so smooth that they cannot follow the beat. What the samples
are next to it holds the line, which has constant amplitude: it is fitted by weighted least squares, mainly where the
mode is small, taken out, and the mode is found anew.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.numerics.arrays import FloatArray
from nmt_signals.channel_faults.mains_lines import MAINS_HZ
from nmt_signals.decays.decay_nodes import span
from nmt_signals.decays.decay_signal import Ridge, SlowAmplitude, slow_amplitude
from nmt_signals.thresholds import DECAYS

# Orders of the mains that are taken out of a decay: supplies make the first three.
_MAINS_ORDERS = (1, 2, 3)
# Over the mode's frequency, the widest band of the demodulation.
_BAND_RATIOS = (0.5, 1.5)
# Numbers of the smooth course of the mode next to the hum, but for a constant.
_MOST_DEGREE = 7
# Passes between hum and mode.
_PASSES = 4

# Of the duration of a decay.
_SLOPE_STEP = 1e-6

_WANDERS_HZ = np.linspace(-0.06, 0.06, 13)


@dataclass(frozen=True)
class Hum:
    """A line that was taken out.

    Attributes:
        frequency_hz: Hz.
        amplitude: in the channel's unit.
        std: standard uncertainty of the amplitude.
    """

    frequency_hz: float
    amplitude: float
    std: float


def without_hum(
    samples: FloatArray, sample_rate: float, ridge: Ridge, switched_off: int
) -> tuple[FloatArray, tuple[Hum, ...]]:
    """Samples of a decay without the lines of the mains that its demodulation would pass.

    Args:
        samples: without mean, shape (n,).
        sample_rate: Hz.
        ridge: of the mode.
        switched_off: periods at the beginning that are not free yet.

    Returns:
        The samples, shape (n,), and the lines that were taken out; the samples as they are where no line stands out, or
        where they are too close to the mode to be separated from it.
    """
    low, high = np.quantile(ridge.frequency_hz[ridge.clear], (0.02, 0.98))
    lines = [
        order * hz
        for hz in MAINS_HZ
        for order in _MAINS_ORDERS
        if _BAND_RATIOS[0] * low < order * hz < _BAND_RATIOS[1] * high and order * hz < 0.5 * sample_rate
    ]
    clean, found = samples, tuple[Hum, ...]()
    if not lines:
        return samples, ()
    for _ in range(_PASSES):
        try:
            slow = slow_amplitude(clean, sample_rate, ridge, 1)
        except BenchError:
            return samples, ()
        mode = _smooth(slow, lines, samples.size, sample_rate, switched_off, bool(found))
        if mode is None:
            return samples, ()
        signal, size, first, lines = mode
        fitted, found = _lines_in(samples - signal, size, sample_rate, lines, first)
        if not found:
            return samples, ()
        clean = samples - fitted
    return clean, found


def _smooth(
    slow: SlowAmplitude, lines: list[float], count: int, sample_rate: float, switched_off: int, apart: bool
) -> tuple[FloatArray, FloatArray, int, list[float]] | None:
    """The mode sample by sample.

    Args:
        slow: of the mode.
        lines: Hz.
        count: samples.
        sample_rate: Hz.
        switched_off: periods at the beginning that are not free yet.
        apart: the lines are known to beat with the mode; without them less of the decay stands out.

    Returns:
        Mode and its amplitude, each (count,), the first sample where they hold, and the lines with the mode; None
        where the decay does not stand out for some beats with any of the lines.
    """
    first, stop = span(slow, switched_off)
    if stop - first < _MOST_DEGREE:
        return None
    time, turned = slow.time_s[first:stop], slow.phase[first:stop]
    hertz = np.gradient(turned, time) / (2.0 * math.pi)
    # A frequency that moves with the amplitude may pass a line, or end at it.
    duration = float(time[-1] - time[0])
    near = {line: float(np.quantile(np.abs(hertz - line), DECAYS.hum_passing_share)) * duration for line in lines}
    lines = [line for line in lines if apart or near[line] > DECAYS.hum_fewest_beats]
    if not lines:
        return None
    degree = min(_MOST_DEGREE, *(int(np.mean(np.abs(hertz - line)) * duration) for line in lines))
    weights = np.abs(slow.values[first:stop])
    all_times = np.arange(count) / sample_rate
    log = _continued(time, slow.log[first:stop], weights, degree, all_times)
    phase = _continued(time, turned, weights, degree, all_times)
    size = np.exp(np.minimum(log, slow.log.max() + 1.0))
    return size * np.cos(phase), size, int(np.searchsorted(all_times, time[0])), lines


def _continued(time: FloatArray, values: FloatArray, weights: FloatArray, degree: int, at: FloatArray) -> FloatArray:
    """A smooth course at times, continued along straight lines beyond those that it was fitted to.

    It is linear in time plus a polynomial of an amplitude that falls exponentially: a frequency or damping that depends
    on the amplitude changes fast at first.
    """
    duration = float(time[-1] - time[0])
    rate = max(math.log(weights[0] / weights[-1]), 1.0)

    def basis(t: FloatArray) -> FloatArray:
        share = (t - time[0]) / duration
        return np.column_stack((share, np.polynomial.legendre.legvander(2.0 * np.exp(-rate * share) - 1.0, degree - 1)))

    fitted, *_ = np.linalg.lstsq(basis(time) * weights[:, np.newaxis], values * weights, rcond=None)
    inside = np.clip(at, time[0], time[-1])
    step = _SLOPE_STEP * duration
    ahead = basis(inside + step) @ fitted
    found = basis(inside) @ fitted
    return np.asarray(found + (ahead - found) / step * (at - inside))


def _lines_in(
    residual: FloatArray, size: FloatArray, sample_rate: float, lines: Sequence[float], first: int
) -> tuple[FloatArray, tuple[Hum, ...]]:
    """What the lines make of all samples, and those that stand out."""
    noise = float(np.median(np.abs(residual[-max(residual.size // 4, 1) :]))) / 0.6745
    weights = 1.0 / np.hypot(max(noise, 1e-300), DECAYS.hum_roughness * size)
    weights[:first] = 0.0
    time = np.arange(residual.size) / sample_rate
    result, found = np.zeros(residual.size), []
    for line in lines:
        best: tuple[float, float, FloatArray, FloatArray, float] | None = None
        for shift in _WANDERS_HZ:
            angle = 2.0 * math.pi * (line + shift) * time
            design = np.stack((np.cos(angle), np.sin(angle)), axis=1)
            weighted = design * weights[:, np.newaxis]
            solution, *_ = np.linalg.lstsq(weighted, (residual - result) * weights, rcond=None)
            gain = float(np.sum((weighted @ solution) ** 2))
            if best is None or gain > best[0]:
                std = math.sqrt(float(np.linalg.inv(weighted.T @ weighted).diagonal().max()))
                best = gain, float(line + shift), np.asarray(solution), np.asarray(design @ solution), std
        assert best is not None
        _, hertz, solution, values, std = best
        amplitude = math.hypot(*solution)
        if amplitude > DECAYS.hum_sigmas * std:
            result += values
            found.append(Hum(float(hertz), amplitude, std))
    return result, tuple(found)
