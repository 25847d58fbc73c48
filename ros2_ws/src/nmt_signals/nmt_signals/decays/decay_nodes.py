"""Instantaneous frequency and decay rate of a slowly varying amplitude, with honest uncertainties.

The decay is cut into segments of equal steps of ln A that do not overlap. In each, phase and ln A are polynomials of
time. Their noise is that of white noise behind the window of the demodulation, as large as the residuals of the highest
degree show it: the window's overlap correlates neighbouring periods, and whatever else scatters (another mode, the
hammer, hum) counts. The degree is that of the least expected error, noise and bias together.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import BSpline
from scipy.linalg import toeplitz

from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_signals.decays.decay_signal import SlowAmplitude
from nmt_signals.thresholds import DECAYS

# Degrees of the phase over a segment: odd ones, so that the middle is a frequency.
_DEGREES = (1, 3, 5)
# Periods that a degree of the polynomial takes.
_PERIODS_PER_DEGREE = 2
# Periods of a segment where the decay is fast.
_SEGMENT_FEWEST_PERIODS = 4
SEGMENT_MOST_PERIODS = 7
"""Periods of a segment of a decay that is not fast."""
# Fall of the amplitude in a segment that is shorter.
_SEGMENT_LOG_STEP = 1.2
# What rings with the mode may take so long to fade.
_SETTLING_PERIODS = (0, 1, 2, 3, 4, 6, 8, 10)
# Range below the largest amplitude in which segments are half as long.
_LARGE_LOG_RANGE = 1.0

_BOXCARS = 4


@dataclass(frozen=True)
class DecaySegment:
    """Periods of one segment and the noise of its amplitudes.

    Attributes:
        first, stop: periods.
        noise: standard deviation of one part of the complex amplitude, from the residuals of this segment alone.
        degrees_of_freedom: of these residuals, in units of independent values.
    """

    first: int
    stop: int
    noise: float
    degrees_of_freedom: float


@dataclass(frozen=True)
class Node:
    """What a segment says of its middle.

    Attributes:
        period: its middle.
        time_s: from the first sample, s.
        amplitude: of the fundamental, in the channel's unit.
        log_std: of its logarithm.
        omega, omega_std: angular frequency, rad/s.
        rate, rate_std: −d ln A/dt, 1/s.
        first, stop: periods of the segment.
    """

    period: int
    time_s: float
    amplitude: float
    log_std: float
    omega: float
    omega_std: float
    rate: float
    rate_std: float
    first: int
    stop: int

    @property
    def damping(self) -> float:
        """Damping ratio, the decay rate over ω."""
        return self.rate / self.omega


def span(slow: SlowAmplitude, skipped: int) -> tuple[int, int]:
    """First period of the free decay and the one behind its last that stands out of the noise.

    An amplitude that grows at first is that before the impact; then the whole window has to lie behind its largest.
    """
    size = np.abs(slow.values)
    if size.size < _SEGMENT_FEWEST_PERIODS:
        return 0, 0
    top = int(np.argmax(size))
    first = top + 2 * slow.width + 1 if size[0] < 0.5 * size[top] else skipped
    noise = _noise_of(slow)
    strong = size > DECAYS.node_sigmas * noise
    strong[: top + 1] = True
    stop = int(np.argmin(strong)) if not strong.all() else size.size
    return first, stop


def _noise_of(slow: SlowAmplitude) -> float:
    """Standard deviation of the complex amplitudes in the last quarter, from their second differences."""
    apart = _BOXCARS * slow.width
    tail = slow.values[-max(slow.values.size // 4, 3 * apart) :]
    if tail.size <= 2 * apart:
        return 0.0
    difference = np.abs(tail[2 * apart :] - 2.0 * tail[apart:-apart] + tail[: -2 * apart])
    # The median of the size of a complex Gaussian is √ln 2 of its standard deviation.
    return float(np.median(difference)) / math.sqrt(6.0 * math.log(2.0))


def nodes(slow: SlowAmplitude, wanted: int, skipped: int) -> list[Node]:
    """Frequency and decay rate at up to ``wanted`` amplitudes, from large to small.

    Args:
        slow: the decay.
        wanted: amplitudes.
        skipped: periods at the beginning that are not free yet.
    """
    first, stop = span(slow, skipped)
    segments = [_segment(slow, low, high) for low, high in _cut(slow, first, stop, wanted)]
    if not segments:
        return []
    if _unsettled(slow, first, stop):
        # What rings bends the whole segment; its residuals show only a part of that.
        segments[0] = replace(segments[0], noise=DECAYS.unsettled_ratio * segments[0].noise)
    # Few values know their scatter badly: none has less noise than the typical segment.
    typical = float(np.median([segment.noise for segment in segments]))
    if not math.isfinite(typical):
        return []
    return [_node(slow, segment, typical) for segment in segments]


def _cut(slow: SlowAmplitude, first: int, stop: int, wanted: int) -> list[tuple[int, int]]:
    """Segments of equal steps of ln A, none shorter than a few periods; a beginning that rings is one of its own."""
    if stop - first < _SEGMENT_FEWEST_PERIODS * slow.width:
        return []
    falling = np.minimum.accumulate(slow.log[first:stop])
    per_period = max(float(falling[0] - falling[-1]) / (stop - first), 1e-9)
    shortest = slow.width * int(
        np.clip(
            math.ceil(_SEGMENT_LOG_STEP / per_period),
            _SEGMENT_FEWEST_PERIODS,
            SEGMENT_MOST_PERIODS,
        )
    )
    found: list[tuple[int, int]] = []
    low = first
    unsettled = _unsettled(slow, first, stop)
    if unsettled and stop - first > unsettled + 2 * shortest:
        low = first + max(unsettled, shortest)
        found.append((first, low))
    for mark in _marks(float(falling[low - first]), float(falling[-1]), wanted - len(found)):
        high = first + int(np.searchsorted(-falling, -mark))
        if high - low >= shortest:
            found.append((low, high))
            low = high
    if stop - low >= shortest:
        found.append((low, stop))
    elif found:
        found[-1] = (found[-1][0], stop)
    return found


def _marks(top: float, end: float, wanted: int) -> FloatArray:
    """Values of ln A at which segments end, falling: equal steps, and steps of half of that where A is largest.

    Contacts and slip show there alone, over few periods.
    """
    steps = np.linspace(top, end, wanted + 1)
    halves = 0.5 * (steps[1:] + steps[:-1])
    return np.sort(np.concatenate((steps[1:-1], halves[halves > top - _LARGE_LOG_RANGE])))[::-1]


def _unsettled(slow: SlowAmplitude, first: int, stop: int) -> int:
    """Periods after which residuals are no more than a few times those of ten periods later.

    In a fast decay they may as well be the bend of a friction that ends; there nothing is said.
    """
    length = 2 * SEGMENT_MOST_PERIODS * slow.width
    if (
        stop - first < length + _SETTLING_PERIODS[-1]
        or slow.log[first] - slow.log[first + length] > DECAYS.fast_log_fall
    ):
        return 0
    noise = [_segment(slow, first + late, first + late + length).noise for late in _SETTLING_PERIODS]
    return next(
        late
        for late, residual in zip(_SETTLING_PERIODS, noise, strict=True)
        if residual <= DECAYS.unsettled_ratio * noise[-1]
    )


def _design(slow: SlowAmplitude, first: int, stop: int) -> tuple[FloatArray, float, float]:
    """Legendre polynomials of scaled time (k, 6), the middle and half of the time."""
    t = slow.time_s[first:stop]
    middle, half = 0.5 * (t[0] + t[-1]), 0.5 * (t[-1] - t[0])
    return np.polynomial.legendre.legvander((t - middle) / half, _DEGREES[-1]), middle, half


def _degrees(periods: int, width: int) -> list[int]:
    """Degrees that a segment can bear."""
    return [d for d in _DEGREES if periods > _PERIODS_PER_DEGREE * d * width] or [1]


def correlation(count: int, width: float) -> FloatArray:
    """Correlation of demodulated white noise, (count, count): the window, ``width`` values a boxcar, with itself."""
    spline = BSpline.basis_element(np.arange(-_BOXCARS, _BOXCARS + 1.0), extrapolate=False)
    lags = np.nan_to_num(spline(np.arange(count) / width))
    return np.asarray(toeplitz(lags / lags[0]))


def _fit(design: FloatArray, weights: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Coefficients of a weighted fit, and the matrix that gives them from the values."""
    pseudo = np.linalg.pinv(design * weights[:, np.newaxis]) * weights
    return pseudo @ values, pseudo


def _segment(slow: SlowAmplitude, first: int, stop: int) -> DecaySegment:
    design, _, _ = _design(slow, first, stop)
    size = np.abs(slow.values[first:stop])
    degree = _degrees(stop - first, slow.width)[-1]
    basis = design[:, : degree + 1]
    noise = correlation(stop - first, slow.width / slow.stride) / np.outer(size, size)
    squares, degrees_of_freedom = 0.0, 0.0
    for values in (slow.log[first:stop], slow.phase[first:stop]):
        solution, pseudo = _fit(basis, size, values)
        left = size * (values - basis @ solution)
        maker = (np.eye(size.size) - basis @ pseudo) * size[:, np.newaxis]
        squares += float(left @ left)
        degrees_of_freedom += float(np.sum((maker @ noise) * maker))
    return DecaySegment(
        first,
        stop,
        math.sqrt(squares / degrees_of_freedom) if degrees_of_freedom > 1e-6 else math.inf,
        degrees_of_freedom,
    )


def _node(slow: SlowAmplitude, segment: DecaySegment, typical: float) -> Node:
    first, stop = segment.first, segment.stop
    design, middle, half = _design(slow, first, stop)
    size = np.abs(slow.values[first:stop])
    own_noise = segment.noise if math.isfinite(segment.noise) else typical
    covariance = (
        correlation(stop - first, slow.width / slow.stride) / np.outer(size, size) * max(own_noise, typical) ** 2
    )
    degrees = _degrees(stop - first, slow.width)
    log, log_std, rate, rate_std = _middle(design, size, slow.log[first:stop], covariance, degrees)
    _, _, omega, omega_std = _middle(design, size, slow.phase[first:stop], covariance, degrees)
    period = int(np.argmin(np.abs(slow.time_s[first:stop] - middle))) + first
    rate, omega = -rate / half, omega / half
    # The window averages exp(−αt) to more than its middle, by its transfer function at an imaginary frequency.
    x = math.pi * slow.width * abs(rate / omega)
    swelling = (math.sinh(x) / x) ** _BOXCARS if x > 1e-6 else 1.0
    return Node(
        period, middle, math.exp(log) / swelling, log_std, omega, omega_std / half, rate, rate_std / half, first, stop
    )


def _middle(
    design: FloatArray, weights: FloatArray, values: FloatArray, covariance: FloatArray, degrees: list[int]
) -> tuple[float, float, float, float]:
    """Value and slope in the middle, each with its standard uncertainty, by the degree of least expected error."""
    best: tuple[float, float, float, float] | None = None
    least = math.inf
    reference, pseudo_reference = 0.0, np.zeros(0)
    for degree in reversed(degrees):
        basis = design[:, : degree + 1]
        solution, pseudo = _fit(basis, weights, values)
        at = np.polynomial.legendre.legvander(np.zeros(1), degree)[0]
        slope_of = np.array(
            [np.polynomial.legendre.legval(0.0, np.polynomial.legendre.legder(row)) for row in np.eye(degree + 1)]
        )
        row = slope_of @ pseudo
        slope = float(slope_of @ solution)
        variance = float(row @ covariance @ row)
        if best is None:
            reference, pseudo_reference = slope, row
        apart = row - pseudo_reference
        bias = max(0.0, (slope - reference) ** 2 - float(apart @ covariance @ apart))
        if variance + bias < least:
            least = variance + bias
            spread = at @ pseudo
            best = float(at @ solution), math.sqrt(float(spread @ covariance @ spread)), slope, math.sqrt(least)
    assert best is not None
    return best


def ratio_at(node: Node, slow: SlowAmplitude, other: ComplexArray) -> tuple[complex, float]:
    """Amplitude of another channel over this one's at a node, and the relative standard uncertainty of each part.

    Args:
        node: of ``slow``.
        slow: the decay of the reference.
        other: amplitudes of the other channel on the same phase, shape of ``slow.values``.
    """
    first, stop = node.first, node.stop
    ratio = other[first:stop] / slow.values[first:stop]
    design, _, _ = _design(slow, first, stop)
    basis = design[:, :2]
    weights = np.abs(slow.values[first:stop])
    pseudo = _fit(basis, weights, weights)[1]
    at = pseudo[0]
    value = complex(at @ ratio)
    left = np.abs((ratio - basis @ (pseudo @ ratio)) * weights)
    degrees_of_freedom = max(1.0, (stop - first) / slow.width - 4.0)
    variance = 0.5 * float(left @ left) / degrees_of_freedom
    covariance = correlation(stop - first, slow.width / slow.stride) / np.outer(weights, weights) * variance
    return value, math.sqrt(float(at @ covariance @ at)) / max(abs(value), 1e-300)
