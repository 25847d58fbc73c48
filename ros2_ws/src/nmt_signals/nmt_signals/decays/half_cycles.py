"""Frequency and decay rate from the turning points of a decay that is over after a few periods.

Three turning points x₀, x₁, x₂ at t₀, t₁, t₂ make one node: ω = 2π/(t₂ − t₀), swings A₀ = |x₁ − x₀|/2 and
A₁ = |x₂ − x₁|/2, decay rate 2 ln(A₀/A₁)/(t₂ − t₀) by the logarithmic decrement, amplitude √(A₀ A₁). An offset of the
channel drops out, and so does the displaced rest of dry friction. Nodes follow each other without overlap.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from scipy.signal import savgol_filter

from nmt_core.errors import BenchError
from nmt_core.numerics.arrays import FloatArray
from nmt_signals.band_limited import finer
from nmt_signals.decays.decay_nodes import Node
from nmt_signals.thresholds import DECAYS

# Smoothing before turning points are searched for.
_SMOOTHING_PERIODS = 0.2
# Either side of a turning point that the parabola is fitted to: a sine is one there within 0.4 %.
_VERTEX_HALF_WIDTH_PERIODS = 0.1
# Of the largest voltage, below which a drive is over.
_OFF = 0.01
# Times that the piece is centred on its vertex.
_VERTEX_PASSES = 3


def undriven_from(voltages: Iterable[FloatArray]) -> int:
    """The first sample of a decay at which its drive has come to rest; 0 without a drive that ends.

    Args:
        voltages: of the exciters, each of shape (n,). A bench ends a drive by a ramp; a voltage that is above a
            hundredth of its largest value in the second half of the decay is noise, or drives on.
    """
    begin = 0
    for voltage in voltages:
        size = np.abs(voltage)
        driven = np.flatnonzero(size > _OFF * np.nanmax(size, initial=0.0))
        if driven.size and driven[-1] < size.size // 2:
            begin = max(begin, int(driven[-1]) + 1)
    return begin


def half_cycle_nodes(samples: FloatArray, sample_rate: float, frequency_hz: float) -> list[Node]:
    """Nodes from large to small amplitude.

    Args:
        samples: of a displacement or velocity, shape (n,).
        sample_rate: Hz.
        frequency_hz: of the mode, to some ten percent.

    Raises:
        BenchError: too few samples a period, less than a period, or too few turning points.
    """
    period = sample_rate / frequency_hz
    if period < DECAYS.turning_fewest_samples:
        raise BenchError(
            f"{period:.2g} samples a period are too few for turning points; {DECAYS.turning_fewest_samples} are needed"
        )
    if samples.size < period:
        raise BenchError(f"its {samples.size} samples are less than a period of the mode at {frequency_hz:.4g} Hz")
    factor = math.ceil(DECAYS.turning_fine_samples / period)
    time, value, time_std, value_std = _turning_points(
        finer(samples, factor)[: (samples.size - 1) * factor + 1], factor * period
    )
    # Interpolated samples are no more independent values than those that were measured.
    time, time_std, value_std = time / factor, time_std / math.sqrt(factor), value_std * math.sqrt(factor)
    swing = 0.5 * np.abs(np.diff(value))
    nodes = []
    for k in range(0, swing.size - 1, 2):
        lasting = (time[k + 2] - time[k]) / sample_rate
        omega = 2.0 * math.pi / lasting
        fall = math.log(swing[k] / swing[k + 1])
        noise = 0.5 * math.hypot(
            value_std[k] / swing[k],
            value_std[k + 1] * (1.0 / swing[k] + 1.0 / swing[k + 1]),
            value_std[k + 2] / swing[k + 1],
        )
        # The rate changes over the node: ln of the swings stands for it to the second order of their fall.
        rate_std = 2.0 / lasting * math.hypot(noise, fall**3 / 24.0)
        omega_std = omega * math.hypot(time_std[k], time_std[k + 2]) / sample_rate / lasting
        amplitude = math.sqrt(swing[k] * swing[k + 1])
        nodes.append(
            Node(
                k // 2, time[k + 1] / sample_rate, amplitude, 0.5 * noise, omega, omega_std, 2.0 * fall / lasting,
                rate_std, k // 2, k // 2 + 1,
            )
        )  # fmt: skip
    if swing.size < DECAYS.turning_fewest_swings:
        raise BenchError(
            f"it turns {time.size} times before it rests or noise covers it, and "
            f"{DECAYS.turning_fewest_swings + 1} are needed"
        )
    return nodes


def strongest_frequency(samples: FloatArray, sample_rate: float) -> float:
    """Frequency of the strongest line of a decay of a few periods about any rest, Hz, to some ten percent.

    Args:
        samples: shape (n,).
        sample_rate: Hz.
    """
    motion = np.diff(samples) * np.hanning(samples.size + 1)[1:-1]
    size = 8 * samples.size
    power = np.abs(np.fft.rfft(motion, size))
    return float(np.argmax(power[1:]) + 1) * sample_rate / size


def _turning_points(samples: FloatArray, period: float) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Times in samples and values of the turning points of the decay, and their standard uncertainties, each (k,)."""
    length = max(5, 2 * int(0.5 * _SMOOTHING_PERIODS * period) + 1)
    smooth = savgol_filter(samples, length, 3)
    noise = float(np.std(samples - smooth))
    slope = savgol_filter(samples, length, 3, deriv=1)
    half = max(3, round(_VERTEX_HALF_WIDTH_PERIODS * period))
    places = np.flatnonzero(np.diff(np.signbit(slope)))
    places = places[(places >= half) & (places < samples.size - half)]
    largest = 0.5 * float(np.ptp(smooth))
    kept: list[int] = []
    for place in places:
        if kept:
            apart = 0.5 * abs(smooth[place] - smooth[kept[-1]])
            near = (
                DECAYS.turning_interval_periods[0] * period
                <= place - kept[-1]
                <= DECAYS.turning_interval_periods[1] * period
            )
            if not near or apart < max(DECAYS.turning_sigmas * noise, DECAYS.turning_smallest_share * largest):
                if len(kept) > 2:
                    break
                kept = []
        kept.append(int(place))
    # Behind the last one it may rest.
    found = [_vertex(samples[k - half : k + half + 1], k) for k in kept[:-1]]
    time, value, time_std, value_std = np.array(found).reshape(-1, 4).T
    return time, value, time_std, value_std


def _vertex(values: FloatArray, middle: int) -> tuple[float, float, float, float]:
    """Place and value of the extreme of samples about one of them, with standard uncertainties.

    Two half parabolas with one vertex: dry friction changes its sign there, and the curvature with it.
    """
    x = np.arange(values.size) - 0.5 * (values.size - 1)
    at, solution, norms = 0.0, np.zeros(4), np.zeros(4)
    for _ in range(_VERTEX_PASSES):
        apart = x - at
        columns = np.stack((np.ones_like(x), apart, np.minimum(apart, 0.0) ** 2, np.maximum(apart, 0.0) ** 2), axis=1)
        inverse = np.linalg.pinv(columns)
        solution = inverse @ values
        scatter = math.sqrt(float(np.sum((values - columns @ solution) ** 2)) / max(1, values.size - 4))
        norms = scatter * np.linalg.norm(inverse, axis=1)
        at -= float(solution[1] / (solution[2] + solution[3]))
    return middle + at, float(solution[0]), float(norms[1] / abs(solution[2] + solution[3])), float(norms[0])
