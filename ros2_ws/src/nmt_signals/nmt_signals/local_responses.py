"""Frequency responses at chosen lines of one record, free of leakage.

Around each line response and reference are fitted with H(f) U + T(f), where the frequency response H and the leakage T
are polynomials over a few neighbouring lines of one Fourier transform of the whole window (local polynomial method: R.
Pintelon, J. Schoukens, 2012, System Identification, 2nd ed., section 7.2). Several references have an H each. On a
resonance that is narrower than these lines polynomials are wrong by percents. Where the responses of all channels show
one, both are over 1 + a x, with x the place among the lines and the same a for all channels (local rational method: T.
McKelvey, G. Guérin, 2012, 16th IFAC Symposium on System Identification). Averaged spectra would leave leakage as noise
that all channels share; here sensor noise and nonlinear distortions are what remains, and the residual of the fit tells
how large they are.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.signal import csd, welch

from nmt_core.numerics.arrays import BoolArray, ComplexArray, FloatArray, IntArray
from nmt_signals.thresholds import SIGNAL_FITS

# How often the place of a resonance within the lines is improved.
_POLE_STEPS = 8
# Step by which the places are increased until enough lines are apart.
_MORE_MARKS = 20
# Probability that noise has a coherence beyond which the phase counts.
_CHANCE = 1e-3
# How many of these steps are linear.
_LINEAR_STEPS = 3

ORDER = 4
"""Degree of the local polynomials."""
REACH = 10
"""Lines on either side that a local fit uses."""
OFFSETS = np.arange(-REACH, REACH + 1)
_PLACE = OFFSETS / REACH
_POWERS = _PLACE[:, np.newaxis] ** np.arange(ORDER + 1)


@dataclass(frozen=True, eq=False)
class LocalResponses:
    """Frequency responses at some lines of a Fourier transform.

    Attributes:
        estimate: responses, shape (channels, lines).
        noise: variance of the noise in the responses' lines, same shape.
        factor: from there to the variance of the estimate, shape (lines,).
        resonance: variance that the uncertain place of a resonance adds, shape (channels, lines).
        resonant: lines that have a resonance nearby, shape (lines,).
        degrees_of_freedom: of ``noise``.
    """

    estimate: ComplexArray
    noise: FloatArray
    factor: FloatArray
    resonance: FloatArray
    resonant: BoolArray
    degrees_of_freedom: int


def local_responses(
    reference: FloatArray, responses: FloatArray, bins: IntArray, resonant: BoolArray | None = None
) -> LocalResponses:
    """Frequency responses at some lines of the Fourier transform.

    Args:
        reference: samples of the reference, shape (n,), or of several, shape (references, n): responses are those to
            the first, with what the others do taken out.
        responses: samples of the responses, shape (channels, n).
        bins: lines, each at least ``REACH`` from the ends of the transform.
        resonant: lines that have a resonance nearby, shape (lines,); None = those where the responses show one.
    """
    u = np.fft.rfft(reference)
    y = np.fft.rfft(responses, axis=-1)
    near = bins[:, np.newaxis] + OFFSETS
    return local_fits(u[..., near], np.moveaxis(y[:, near], 0, -1), resonant)


def local_fits(u: ComplexArray, y: ComplexArray, resonant: BoolArray | None = None) -> LocalResponses:
    """Frequency responses from what lies around some lines.

    Args:
        u: lines of the reference about each of them, shape (lines, 2 REACH + 1), or of several, (references, lines, …).
        y: lines of the responses, shape (lines, 2 REACH + 1, channels).
        resonant: as for `local_responses`.
    """
    lines, _, channels = y.shape
    u = u.reshape(-1, lines, OFFSETS.size)
    found = LocalResponses(
        np.empty((channels, lines), dtype=np.complex128),
        np.empty((channels, lines)),
        np.empty(lines),
        np.zeros((channels, lines)),
        np.zeros(lines, dtype=np.bool_),
        2 * (OFFSETS.size - (1 + u.shape[0]) * (ORDER + 1)),
    )
    for number in range(lines):
        local_fit = _LocalFit(u[:, number], y[number], 0j)
        if resonant is None or resonant[number]:
            pole = _resonance(local_fit)
            if (
                resonant is not None
                or pole.log_likelihood > local_fit.log_likelihood + SIGNAL_FITS.local_resonance_gain
            ):
                local_fit = pole
                found.resonant[number] = True
                found.resonance[:, number] = local_fit.resonance_variance()
        found.estimate[:, number] = local_fit.coefficients[0]
        found.noise[:, number] = local_fit.noise
        found.factor[number] = local_fit.factor
    return found


class _LocalFit:
    """Least-squares fit about one line: (H U + T) / A, with H and T polynomials and A = 1 + a x.

    Args:
        u: references, shape (references, n).
        y: responses, shape (n, channels).
        a: coefficient of the resonance; 0 = none.
    """

    def __init__(self, u: ComplexArray, y: ComplexArray, a: complex) -> None:
        self.u, self.y, self.a = u, y, a
        self._below = 1.0 + a * _PLACE
        design = np.concatenate((*(row[:, np.newaxis] * _POWERS for row in u), _POWERS), axis=1)
        design = design / self._below[:, np.newaxis]
        scale = np.linalg.norm(design, axis=0)
        self._q, r = np.linalg.qr(design / scale)
        self._back = np.linalg.inv(r) / scale[:, np.newaxis]
        projected = np.conj(self._q.T) @ y
        self.coefficients = self._back @ projected
        self._fitted = self._q @ projected
        self._residual = y - self._fitted
        squares = np.maximum((np.abs(self._residual) ** 2).sum(axis=0), 1e-300)
        left = design.shape[0] - design.shape[1]
        self.noise = squares / (left - (1.0 / y.shape[1] if a else 0.0))
        self.factor = float((np.abs(self._back[0]) ** 2).sum())
        self.log_likelihood = -left * float(np.log(squares).sum())

    def _across(self, column: ComplexArray) -> ComplexArray:
        """What the polynomials cannot make of columns, shape (n, channels)."""
        return np.asarray(column - self._q @ (np.conj(self._q.T) @ column))

    def linear_pole(self) -> complex:
        """The coefficient that leaves least of A Y − H U − T, over the present A (Sanathanan and Koerner)."""
        projected = self._across(self.y / self._below[:, np.newaxis])
        slope = self._across(self.y * (_PLACE / self._below)[:, np.newaxis])
        return -self._along(slope, projected)[0]

    def better_pole(self) -> complex:
        """The coefficient after a step of Gauss and Newton."""
        return self.a + self._along(self._slope(), -self._residual)[0]

    def resonance_variance(self) -> FloatArray:
        """Variance of the responses at the line that comes from that of the resonance, shape (channels,)."""
        _, information = self._along(self._slope(), self._residual)
        moved = self._back[0] @ (np.conj(self._q.T) @ self._moved())
        result: FloatArray = np.abs(moved) ** 2 / max(information, 1e-300)
        return result

    def _moved(self) -> ComplexArray:
        """Minus the change of the fit by a, its polynomials kept, shape (n, channels)."""
        return np.asarray(self._fitted * (_PLACE / self._below)[:, np.newaxis])

    def _slope(self) -> ComplexArray:
        """Minus the change of the fit by a, shape (n, channels)."""
        return self._across(self._moved())

    def _along(self, slope: ComplexArray, projected: ComplexArray) -> tuple[complex, float]:
        """Weighted least-squares coefficient of a slope in the residual, and the information on it."""
        weights = 1.0 / np.maximum(self.noise, 1e-300)
        information = float((weights * (np.abs(slope) ** 2).sum(axis=0)).sum())
        product = complex((weights * (np.conj(slope) * projected).sum(axis=0)).sum())
        return product / max(information, 1e-300), information


def _resonance(plain: _LocalFit) -> _LocalFit:
    """The fit with the resonance that suits all responses best."""
    best = plain
    for turn in range(_POLE_STEPS):
        linear = turn < _LINEAR_STEPS
        found = _LocalFit(plain.u, plain.y, best.linear_pole() if linear else best.better_pole())
        if not np.isfinite(found.log_likelihood) or found.log_likelihood <= best.log_likelihood:
            if linear:
                continue
            break
        best = found
    return best


def choose_bins(reference: FloatArray, response: FloatArray, sample_rate: float, wanted: int) -> IntArray:
    """Lines evenly spread over decades and over turns of the phase beyond those by noise, within the driven band.

    Args:
        reference: samples, shape (n,).
        response: samples of the drive-point response, shape (n,).
        sample_rate: Hz.
        wanted: most lines.

    Returns:
        Lines of the Fourier transform of the whole, ascending, far enough apart to be nearly independent; may be empty.
    """
    size = reference.size
    segment = max(256, size // 12)
    if size < segment:
        return np.zeros(0, dtype=np.int64)
    frequency, power = welch(reference, sample_rate, nperseg=segment)
    _, cross = csd(reference, response, sample_rate, nperseg=segment)
    driven = (
        (power > SIGNAL_FITS.driven_share * power[1:].max())
        & (frequency > 0.0)
        & (frequency < SIGNAL_FITS.highest_share * sample_rate)
    )
    if not driven.any():
        return np.zeros(0, dtype=np.int64)
    low, high = frequency[driven][0], frequency[driven][-1]
    frequency_hz = np.arange(size // 2 + 1) * sample_rate / size
    inside = np.flatnonzero((frequency_hz >= low) & (frequency_hz <= high))
    inside = inside[(inside > REACH) & (inside < frequency_hz.size - REACH - 1)]
    if inside.size < 2:
        return np.zeros(0, dtype=np.int64)
    _, answered = welch(response, sample_rate, nperseg=segment)
    coherence = np.abs(cross) ** 2 / np.maximum(power * answered, 1e-300)
    steps = _turns(cross, coherence, 2 * size // segment - 1)
    turns = np.interp(frequency_hz[inside], frequency, np.concatenate(([0.0], np.cumsum(steps))))
    # A resonance (a turn by π) has as many lines as a factor of four in frequency.
    way = np.log(frequency_hz[inside] / frequency_hz[inside[0]]) + turns * math.log(4.0) / math.pi
    found = _apart(inside, way, wanted)
    # On narrow resonances lines would lie too near each other: as many more are spread over the rest.
    for marks in range(wanted + _MORE_MARKS, 4 * wanted, _MORE_MARKS):
        more = _apart(inside, way, marks)
        if more.size > wanted:
            break
        found = more
    return found


def _apart(inside: IntArray, way: FloatArray, marks: int) -> IntArray:
    """Lines at even distances along the way, without those too near the one before."""
    picked = inside[np.searchsorted(way, np.linspace(way[0], way[-1], marks)).clip(0, inside.size - 1)]
    result: list[int] = []
    for line in map(int, picked):
        if not result or line - result[-1] > REACH:
            result.append(line)
    return np.array(result, dtype=np.int64)


def _turns(cross: ComplexArray, coherence: FloatArray, averages: int) -> FloatArray:
    """Turns of the phase from line to line, rad, less twice what noise turns it (Bendat and Piersol, Random Data, 9.2).

    Where noise alone would be as coherent once in a thousand lines, the phase says nothing.

    Args:
        cross: spectrum of reference and response, (n,).
        coherence: γ² of them, (n,).
        averages: segments of which they are the means.

    Returns:
        Not negative, (n - 1,).
    """
    smooth = np.convolve(cross, np.array([0.25, 0.5, 0.25]), mode="same")
    steps = np.abs(np.angle(smooth[1:] * np.conj(smooth[:-1])))
    by_chance = 1.0 - _CHANCE ** (1.0 / max(averages - 1, 1))
    variance = (1.0 - np.minimum(coherence, 1.0)) / (2.0 * averages * np.maximum(coherence, 1e-12))
    variance[coherence < by_chance] = np.inf
    return np.asarray(np.maximum(steps - 2.0 * np.sqrt(variance[1:] + variance[:-1]), 0.0))
