"""Frequency responses from slow sweeps and stepped sines, by order analysis on the oscillator's phase.

In a sweep every channel is x(t) = Re Σ A_n(t) exp(i n θ(t)) with the recorded phase θ of the oscillator. The complex
amplitude A_n is found by demodulation and a symmetric low-pass window k,

    Â_n(t) = Σ_j k_j 2 x(t + τ_j) exp(−i n θ(t + τ_j)),      Σ k_j = 1, Σ k_j τ_j² = 0,

a four-term Blackman–Harris window made a kernel of fourth order. Its properties, all computed from k:

* bandwidth: modulations of A_n up to ``bandwidth_hz`` (−3 dB) pass; with the sweep rate r this is a resolution of the
  frequency axis, and the window of T seconds covers r T Hz;
* leakage: the other orders, at least one excitation frequency away, are more than 90 dB down if T spans 10 periods;
* bias: the leading term is μ₄ A⁗(t)/24 with μ₄ = Σ k τ⁴ < 0, the window's own smoothing; second-order smoothing is
  taken away by Σ k τ² = 0;
* noise: white noise of variance σ² gives Â a standard deviation 2σ √(Σ k²/2) in each of its two parts.

None of that is the difference between a sweep and a steady response. A resonance of decay δ passed at α = 2π r rad/s²
answers with H(Ω) − (i α/2) H″(Ω) + …: at the peak it lags by α/δ², and the peak is found α/δ late (rad/s). That part
is physics, present with any estimator.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_core.vocabulary import MOTIONS
from nmt_extract.judgement.uncertainty import jackknife_variance, sub_window_count
from nmt_signals.harmonics import (
    harmonic_amplitudes,
    resolvable_harmonics,
    segment_moments,
    solve_moments,
    whole_period_bounds,
)

if TYPE_CHECKING:
    from nmt_record.windows.segments import Signals

_BLACKMAN_HARRIS = (0.35875, -0.48829, 0.14128, -0.01168)
_LEAST_PERIODS = 10.0


@dataclass(frozen=True)
class OrderKernel:
    """Low-pass window of the demodulation.

    Attributes:
        weights: k, shape ``(2 m + 1,)``, symmetric, sum 1, second moment 0.
        sample_rate: Hz.
    """

    weights: FloatArray
    sample_rate: float

    @classmethod
    def of_length(cls, duration: float, sample_rate: float) -> OrderKernel:
        """Kernel over ``duration`` seconds.

        Raises:
            BenchError: fewer than nine samples.
        """
        half = round(0.5 * duration * sample_rate)
        if half < 4:
            raise BenchError(f"An order kernel of {duration:g} s has too few samples at {sample_rate:g} Hz.")
        place = np.arange(-half, half + 1) / (half + 1)
        window = sum(c * np.cos(np.pi * n * (place + 1.0)) for n, c in enumerate(_BLACKMAN_HARRIS))
        square = place**2
        moments = [float((window * square**n).sum()) for n in range(3)]
        # window · (a + b τ²) with zeroth moment 1 and second moment 0
        determinant = moments[0] * moments[2] - moments[1] ** 2
        weights = window * (moments[2] - moments[1] * square) / determinant
        return cls(np.asarray(weights, dtype=np.float64), sample_rate)

    @property
    def half(self) -> int:
        """m: samples to either side of the centre."""
        return int(self.weights.size // 2)

    @property
    def duration(self) -> float:
        """Length, s."""
        return self.weights.size / self.sample_rate

    @property
    def bandwidth_hz(self) -> float:
        """Modulation frequency at which the window is 3 dB down, Hz."""
        size = 1 << (3 + math.ceil(math.log2(self.weights.size)))
        gain = np.abs(np.fft.rfft(self.weights, size))
        below = int(np.argmax(gain < math.sqrt(0.5)))
        share = (gain[below - 1] - math.sqrt(0.5)) / (gain[below - 1] - gain[below])
        return float(below - 1 + share) * self.sample_rate / size


@dataclass(frozen=True, eq=False)
class SweptResponse:
    """Complex amplitudes along a sweep.

    Attributes:
        frequency_hz: excitation frequency, Hz, shape ``(k,)``, in the order of the sweep.
        sample: sample of each, shape ``(k,)``.
        channels: channel names.
        amplitudes: A_n relative to the oscillator's phase, shape ``(channels, H, k)``, orders 1..H,
            unit of the channel.
        noise: standard uncertainty of either part of A_1, shape ``(channels, k)``.
        kernel: the window used.
        rate_hz_s: sweep rate, Hz/s, with sign.
    """

    frequency_hz: FloatArray
    sample: FloatArray
    channels: tuple[str, ...]
    amplitudes: ComplexArray
    noise: FloatArray
    kernel: OrderKernel
    rate_hz_s: float

    def fundamental(self, channel: str) -> ComplexArray:
        """A_1 of a channel, shape ``(k,)``; KeyError-free: BenchError names the channels there are."""
        return np.asarray(self.amplitudes[self._row(channel), 0])

    def fundamental_noise(self, channel: str) -> FloatArray:
        """Standard uncertainty of either part of A_1 of a channel, shape ``(k,)``."""
        return np.asarray(self.noise[self._row(channel)])

    def _row(self, channel: str) -> int:
        try:
            return self.channels.index(channel)
        except ValueError:
            raise BenchError(f"The sweep has no channel '{channel}'; it has {', '.join(self.channels)}.") from None


def default_duration(frequency_hz: float, rate_hz_s: float) -> float:
    """Length of the kernel, s: a quarter of a second, at least 12 periods, at most what sweeps over 0.25 Hz."""
    least = 1.2 * _LEAST_PERIODS / frequency_hz
    return max(least, min(0.25, 0.25 / max(abs(rate_hz_s), 1e-9)))


def swept_response(
    cycles: FloatArray,
    data: FloatArray,
    channels: tuple[str, ...],
    sample_rate: float,
    points: int = 400,
    harmonics: int = 1,
    duration: float = 0.0,
    first_sample: int = 0,
) -> SweptResponse:
    """Complex amplitudes of every channel along a sweep.

    Args:
        cycles: unwrapped phase of the oscillator at each sample, cycles, shape ``(samples,)``.
        data: shape ``(channels, samples)``.
        channels: their names.
        sample_rate: Hz.
        points: number of frequencies, evenly spaced in time.
        harmonics: highest order.
        duration: length of the kernel, s; 0 = :func:`default_duration`.
        first_sample: sample of ``data[:, 0]``.

    Raises:
        BenchError: the stretch is not longer than the kernel, or its phase is not known.
    """
    samples = cycles.shape[0]
    if data.shape[1] != samples:
        raise BenchError("Phase and channels of the sweep have different lengths.")
    if samples < 16 or not np.all(np.isfinite(cycles)):
        raise BenchError("The excitation phase of the sweep is not known; a swept response needs it at every sample.")
    data = data - data.mean(axis=1, keepdims=True)
    middle = 0.5 * (samples - 1)
    time = (np.arange(samples) - middle) / sample_rate
    scale = max(abs(time[0]), 1e-12)
    quadratic = np.polynomial.polynomial.polyfit(time / scale, cycles, 2)
    frequency, rate = float(quadratic[1] / scale), float(2.0 * quadratic[2] / scale**2)
    kernel = OrderKernel.of_length(duration or default_duration(frequency, rate), sample_rate)
    if kernel.duration * frequency < _LEAST_PERIODS:
        raise BenchError(
            f"The kernel of {kernel.duration:g} s spans {kernel.duration * frequency:.1f} periods; it must span "
            f"{_LEAST_PERIODS:g} to keep the orders apart."
        )
    if samples <= kernel.weights.size:
        raise BenchError(
            f"The sweep lasts {samples / sample_rate:.2f} s, no longer than the {kernel.duration:.2f} s of the "
            "analysis window; sweep more slowly or over more frequencies."
        )
    half = kernel.half
    centres = np.unique(np.linspace(half, samples - 1 - half, points).round().astype(np.int64))
    orders = max(1, resolvable_harmonics(harmonics, sample_rate / frequency))
    amplitudes = np.empty((len(channels), orders, centres.size), dtype=np.complex128)
    noise = np.empty((len(channels), centres.size))
    offset_hz = _offset_hz(kernel)
    swing = np.exp(2j * np.pi * offset_hz * np.arange(-half, half + 1) / sample_rate)
    frequencies = np.empty(centres.size)
    for k, centre in enumerate(centres):
        part = slice(centre - half, centre + half + 1)
        turns = cycles[part] - math.floor(cycles[centre])
        base = np.exp(-2j * np.pi * turns)
        weights = 2.0 * kernel.weights
        window = data[:, part]
        factor = base.copy()
        for order in range(orders):
            amplitudes[:, order, k] = _weighted(window, weights * factor)
            if order == 0:
                sides = np.stack([_weighted(window, weights * factor * side) for side in (swing, swing.conj())])
                noise[:, k] = np.sqrt(np.mean(np.abs(sides) ** 2, axis=0) / 2.0)
            factor = factor * base
        frequencies[k] = (cycles[centre + half] - cycles[centre - half]) * sample_rate / (2 * half)
    width = max(1, centres.size // 10)
    smooth = np.ones(2 * width + 1)
    count = np.convolve(np.ones(centres.size), smooth, "same") if centres.size > 2 * width else None
    if count is not None:
        noise = np.sqrt(np.stack([np.convolve(row**2, smooth, "same") / count for row in noise]))
    else:
        noise = np.sqrt(np.mean(noise**2, axis=1, keepdims=True)).repeat(centres.size, axis=1)
    return SweptResponse(
        frequencies, (centres + first_sample).astype(np.float64), channels, amplitudes, noise, kernel, rate
    )


def _weighted(window: FloatArray, weights: ComplexArray) -> ComplexArray:
    """window @ weights; real products, since a real times a complex matrix would be multiplied without BLAS."""
    parts = window @ np.stack((weights.real, weights.imag), axis=1)
    return np.asarray(parts[:, 0] + 1j * parts[:, 1])


def _offset_hz(kernel: OrderKernel) -> float:
    """Distance from the line at which the noise next to it is looked at: outside the main lobe of the kernel, Hz."""
    return 8.0 / kernel.duration


@dataclass(frozen=True, eq=False)
class FrequencyResponseTable:
    """Responses per force at one level of a sweep or along the frequencies of a stepped sine.

    Attributes:
        level: what was held, in ``level_unit``.
        level_unit: N, V, m or m/s^2.
        rate_hz_s: sweep rate with its sign; 0 for stepped sines.
        frequency_hz: shape ``(k,)``.
        force_n: |F_1|, N, shape ``(k,)``.
        channels: names of the responses.
        frf: A_1/F_1, unit of the response per N, shape ``(channels, k)``.
        frf_std: standard uncertainty of either part of it, shape ``(channels, k)``.
        voltage_v: |u_1|, V, shape ``(k,)``; NaN where no voltage is recorded.
    """

    level: float
    level_unit: str
    rate_hz_s: float
    frequency_hz: FloatArray
    force_n: FloatArray
    channels: tuple[str, ...]
    frf: ComplexArray
    frf_std: FloatArray
    voltage_v: FloatArray

    def held_error(self) -> FloatArray:
        """Relative deviation of the force from a held force level, shape ``(k,)``; NaN if no force was held."""
        if self.level_unit != "N":
            return np.full_like(self.force_n, math.nan)
        return self.force_n / self.level - 1.0


def response_per_force(
    force: ComplexArray, force_std: FloatArray, responses: ComplexArray, responses_std: FloatArray
) -> tuple[ComplexArray, FloatArray]:
    """A/F and the standard uncertainty of either of its parts, first order.

    Args:
        force: shape ``(k,)``.
        force_std: standard uncertainty of either part, same shape.
        responses: shape ``(channels, k)``.
        responses_std: same shape.
    """
    ratio = responses / force
    std = np.hypot(responses_std, np.abs(ratio) * force_std) / np.abs(force)
    return ratio, std


def sweep_table(
    signals: Signals, level: float, level_unit: str, points: int = 400, duration: float = 0.0
) -> FrequencyResponseTable:
    """Responses per force along a recorded sweep.

    Args:
        signals: samples of the sweep with the oscillator's phase.
        level: what was held.
        level_unit: its unit.
        points: number of frequencies.
        duration: length of the kernel, s; 0 = default.

    Raises:
        BenchError: no phase, no force, gaps, or too short.
    """
    cycles, names, data = _require(signals)
    swept = swept_response(
        cycles, data, names, signals.sample_rate, points, duration=duration, first_sample=signals.first_sample
    )
    force_name, responses, voltage = _roles(signals)
    frf, std = response_per_force(
        swept.fundamental(force_name),
        swept.fundamental_noise(force_name),
        np.stack([swept.fundamental(name) for name in responses]),
        np.stack([swept.fundamental_noise(name) for name in responses]),
    )
    return FrequencyResponseTable(
        level,
        level_unit,
        swept.rate_hz_s,
        swept.frequency_hz,
        np.abs(swept.fundamental(force_name)),
        responses,
        frf,
        std,
        np.abs(swept.fundamental(voltage)) if voltage else np.full(swept.frequency_hz.size, math.nan),
    )


@dataclass(frozen=True, eq=False)
class SteppedPoint:
    """One frequency of a stepped sine: force, responses per force, uncertainties; units as in the table."""

    frequency_hz: float
    force_n: float
    channels: tuple[str, ...]
    frf: ComplexArray
    frf_std: FloatArray
    voltage_v: float


def stepped_point(signals: Signals, periods: int, frequency_hz: float, harmonics: int = 5) -> SteppedPoint:
    """Responses per force from one window of whole periods; uncertainties by the jackknife over its sub-windows.

    Raises:
        BenchError: no phase, no force, gaps, or fewer than three periods.
    """
    cycles, names, data = _require(signals)
    count = sub_window_count(periods)
    orders = max(1, resolvable_harmonics(harmonics, signals.sample_rate / frequency_hz))
    whole = harmonic_amplitudes(cycles, data, orders)[:, 1]
    force_name, responses, voltage = _roles(signals)
    rows = [names.index(name) for name in responses]
    force = names.index(force_name)
    frf = whole[rows] / whole[force]
    std = np.full(len(rows), math.nan)
    if count:
        moments = segment_moments(cycles, data, orders, whole_period_bounds(cycles, periods, count))
        parts = solve_moments(moments.leave_one_out())[:, :, 1]
        values = parts[:, rows] / parts[:, [force]]
        std = np.sqrt(jackknife_variance(values) / 2.0)
    return SteppedPoint(
        frequency_hz,
        float(abs(whole[force])),
        responses,
        frf,
        std,
        float(abs(whole[names.index(voltage)])) if voltage else math.nan,
    )


def stepped_table(points: list[SteppedPoint], level: float, level_unit: str) -> FrequencyResponseTable:
    """The points of one level as a table, in their order.

    Raises:
        BenchError: no points.
    """
    if not points:
        raise BenchError("No frequency of the stepped sine became stationary, so no response can be shown.")
    return FrequencyResponseTable(
        level,
        level_unit,
        0.0,
        np.array([point.frequency_hz for point in points]),
        np.array([point.force_n for point in points]),
        points[0].channels,
        np.stack([point.frf for point in points], axis=1),
        np.stack([point.frf_std for point in points], axis=1),
        np.array([point.voltage_v for point in points]),
    )


def _roles(signals: Signals) -> tuple[str, tuple[str, ...], str]:
    """Channel names of the force, of the motions and of the voltage (empty if there is none)."""
    kinds = signals.quantities
    force = [name for name in signals.channels if kinds[name] == Quantity.FORCE]
    responses = tuple(name for name in signals.channels if kinds[name] in MOTIONS)
    voltage = [name for name in signals.channels if kinds[name] == Quantity.VOLTAGE]
    if not force or not responses:
        raise BenchError("A response per force needs a force channel and a response; the recording has not both.")
    return force[0], responses, voltage[0] if voltage else ""


def _require(signals: Signals) -> tuple[FloatArray, tuple[str, ...], FloatArray]:
    if signals.oscillator is None or not np.all(np.isfinite(signals.oscillator)):
        raise BenchError("The recording does not know the phase of the excitation, which order analysis needs.")
    names = tuple(signals.channels)
    data = np.stack([signals.channels[name] for name in names])
    if not np.all(np.isfinite(data)):
        raise BenchError("Samples are missing in the stretch to be analysed; record it again or choose another.")
    return signals.oscillator, names, data
