"""Complex harmonics of sampled signals by order analysis on the oscillator's phase.

Every channel is fitted by least squares with {1, cos nθ, sin nθ}, n = 1..H, where θ is the excitation phase
at each sample. Over whole periods of an integer number of samples this equals the discrete Fourier transform;
it stays exact when a period is not an integer number of samples and when the frequency changes within the window.

Convention: x(t) = Re Σ ψ_n exp(i n θ); ψ_0 is real.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.numerics.arrays import ComplexArray, FloatArray, IntArray

_CHUNK = 4096  # samples whose rotations are held at a time: they fit in the cache
_LEAST_PIVOT = 1e-9  # of the normal matrix compared with the number of samples; below it the fit is not determined


@dataclass(frozen=True, eq=False)
class Moments:
    """Sums from which the least-squares fit follows, one set for each segment of a window.

    Sums of disjoint segments add up, so a window, its sub-windows and the window without one of them cost one
    pass over the samples.

    Attributes:
        basis: Σ exp(i n θ), shape ``(segments, 2H + 1)``.
        projections: Σ x exp(i n θ), shape ``(segments, channels, H + 1)``.
    """

    basis: ComplexArray
    projections: ComplexArray

    def total(self) -> Moments:
        """The sums over all segments, as one segment."""
        return Moments(self.basis.sum(axis=0, keepdims=True), self.projections.sum(axis=0, keepdims=True))

    def leave_one_out(self) -> Moments:
        """The sums over all segments but one, for each segment."""
        total = self.total()
        return Moments(total.basis - self.basis, total.projections - self.projections)


def segment_moments(cycles: FloatArray, data: FloatArray, harmonics: int, bounds: IntArray) -> Moments:
    """Sums for the fit of each segment of a window.

    Args:
        cycles: excitation phase at each sample, cycles, shape ``(samples,)``; need not be wrapped.
        data: shape ``(channels, samples)``.
        harmonics: H, at least 1.
        bounds: first sample of each segment and the end of the last, shape ``(segments + 1,)``, ascending.

    Returns:
        The sums, one set for each segment.
    """
    data = np.ascontiguousarray(data, dtype=np.float64)
    segments = len(bounds) - 1
    # Sums of cosines and sines, the real and imaginary parts of the result.
    basis = np.zeros((2, segments, 2 * harmonics + 1))
    projections = np.zeros((2, segments, data.shape[0], harmonics + 1))
    room = np.empty((2, 2 * harmonics + 1, _CHUNK))
    for first in range(int(bounds[0]), int(bounds[-1]), _CHUNK):
        chunk = slice(first, min(first + _CHUNK, int(bounds[-1])))
        rotations = _rotations(cycles[chunk], room)
        for segment in range(np.searchsorted(bounds, chunk.start, "right") - 1, np.searchsorted(bounds, chunk.stop)):
            start, stop = max(bounds[segment], chunk.start), min(bounds[segment + 1], chunk.stop)
            part = rotations[:, :, start - first : stop - first]
            basis[:, segment] += part.sum(axis=2)
            # Not matmul: its sums may depend on the number of threads, and live and offline must agree to the bit.
            projections[:, segment] += np.einsum("cs,khs->kch", data[:, start:stop], part[:, : harmonics + 1])
    return Moments(basis[0] + 1j * basis[1], projections[0] + 1j * projections[1])


def solve_moments(moments: Moments) -> ComplexArray:
    """Complex harmonics 0..H of every channel in every segment.

    Args:
        moments: sums of :func:`segment_moments`.

    Returns:
        ψ in the unit of the data, shape ``(segments, channels, H + 1)``.

    Raises:
        BenchError: the samples do not determine the harmonics (too few samples in a period or in the
            segment).
    """
    gram = _normal_matrices(moments.basis)
    right = np.empty((*moments.projections.shape[:2], gram.shape[1]))
    right[..., 0] = moments.projections[..., 0].real
    right[..., 1::2] = moments.projections[..., 1:].real
    right[..., 2::2] = moments.projections[..., 1:].imag
    try:
        pivots = np.diagonal(np.linalg.cholesky(gram), axis1=1, axis2=2) ** 2
        regular = bool((pivots > _LEAST_PIVOT * gram[:, :1, 0]).all())
    except np.linalg.LinAlgError:
        regular = False
    if not regular:
        raise BenchError(
            f"The samples do not determine {moments.projections.shape[-1] - 1} harmonics; use fewer harmonics, more "
            "samples in a period or more periods."
        )
    solved = np.linalg.solve(gram, right.transpose(0, 2, 1)).transpose(0, 2, 1)
    amplitudes: ComplexArray = np.zeros(moments.projections.shape, dtype=np.complex128)
    amplitudes[..., 0] = solved[..., 0]
    amplitudes[..., 1:] = solved[..., 1::2] - 1j * solved[..., 2::2]
    return amplitudes


def harmonic_amplitudes(cycles: FloatArray, data: FloatArray, harmonics: int) -> ComplexArray:
    """Complex harmonics 0..H of every channel over the whole stretch (method, eq. 2).

    Args:
        cycles: excitation phase at each sample, cycles, shape ``(samples,)``.
        data: shape ``(channels, samples)``.
        harmonics: H, at least 1.

    Returns:
        ψ in the unit of the data, shape ``(channels, H + 1)``.

    Raises:
        BenchError: the samples do not determine the harmonics.

    Examples:
        A mean value, a cosine and a third harmonic that lags by a quarter of its period, over two and a half periods:

        >>> cycles = np.linspace(0.0, 2.5, 500, endpoint=False)
        >>> phase = 2.0 * np.pi * cycles
        >>> signal = 0.5 + 3.0 * np.cos(phase) + 0.2 * np.sin(3.0 * phase)
        >>> abs(harmonic_amplitudes(cycles, signal[None, :], 3)).round(9)
        array([[0.5, 3. , 0. , 0.2]])
        >>> round(float(np.angle(harmonic_amplitudes(cycles, signal[None, :], 3)[0, 3], deg=True)))
        -90
    """
    bounds = np.array([0, cycles.shape[0]], dtype=np.int64)
    amplitudes: ComplexArray = solve_moments(segment_moments(cycles, data, harmonics, bounds))[0]
    return amplitudes


def whole_period_bounds(cycles: FloatArray, periods: int, segments: int) -> IntArray:
    """Bounds of segments of whole periods.

    Args:
        cycles: unwrapped ascending phase at each sample, cycles, shape ``(samples,)``.
        periods: whole periods in the stretch.
        segments: number of segments, at most ``periods``; their lengths differ by at most one period.

    Returns:
        Sample bounds, shape ``(segments + 1,)``.
    """
    edges = cycles[0] + np.array([round(periods * k / segments) for k in range(1, segments)], dtype=np.float64)
    # A sample that lies on the edge but for rounding opens the next segment.
    inner = np.searchsorted(cycles, edges - 1e-9)
    return np.concatenate(([0], inner, [cycles.shape[0]])).astype(np.int64)


def resolvable_harmonics(wanted: int, samples_per_period: float) -> int:
    """How many of the wanted harmonics lie below 0.45 times the sampling rate."""
    return max(0, min(wanted, math.floor(0.45 * samples_per_period)))


def synthesise(cycles: FloatArray, amplitudes: ComplexArray) -> FloatArray:
    """Signal of given harmonics: Re Σ ψ_n exp(i n θ).

    Args:
        cycles: phase, cycles, shape ``(samples,)``.
        amplitudes: ψ_0..ψ_H, shape ``(H + 1,)``.

    Returns:
        Shape ``(samples,)``.
    """
    rotation = np.exp(2j * np.pi * (cycles - np.floor(cycles)))
    total = np.zeros(cycles.shape[0], dtype=np.complex128)
    for amplitude in amplitudes[::-1]:
        total = total * rotation + amplitude
    return np.ascontiguousarray(total.real)


def _rotations(cycles: FloatArray, out: FloatArray) -> FloatArray:
    """cos nθ and sin nθ of every order n that ``out`` has room for.

    Args:
        cycles: phase, cycles, shape ``(samples,)``.
        out: where they go, shape ``(2, orders, at least samples)``.

    Returns:
        The part of ``out`` that was written, shape ``(2, orders, samples)``.
    """
    rotations = out[:, :, : cycles.shape[0]]
    cosines, sines = rotations
    angle = 2.0 * np.pi * (cycles - np.floor(cycles))
    cosines[0] = 1.0
    sines[0] = 0.0
    np.cos(angle, out=cosines[1])
    np.sin(angle, out=sines[1])
    known, last = 1, out.shape[1] - 1
    while known < last:  # orders 1..k give k + 1..2k, so that rounding grows with the logarithm of the order
        new = slice(known + 1, min(2 * known, last) + 1)
        first = slice(1, new.stop - known)
        np.multiply(cosines[known], cosines[first], out=cosines[new])
        cosines[new] -= sines[known] * sines[first]
        np.multiply(sines[known], cosines[first], out=sines[new])
        sines[new] += cosines[known] * sines[first]
        known = new.stop - 1
    return rotations


def _normal_matrices(basis: ComplexArray) -> FloatArray:
    """Gram matrices of 1, cos θ, sin θ, cos 2θ, ...; products of two of these are sums over n ± m.

    Args:
        basis: Σ exp(i n θ), shape ``(segments, 2H + 1)``.

    Returns:
        Shape ``(segments, 2H + 1, 2H + 1)``.
    """
    harmonics = (basis.shape[1] - 1) // 2
    order = np.arange(harmonics + 1)
    plus = basis[:, order[:, None] + order]
    minus = basis[:, np.abs(order[:, None] - order)]
    sign = np.sign(order[:, None] - order)  # Σ exp(-i n θ) is the conjugate of Σ exp(i n θ)
    gram = np.empty((basis.shape[0], 2 * harmonics + 2, 2 * harmonics + 2))
    gram[:, 0::2, 0::2] = 0.5 * (minus.real + plus.real)
    gram[:, 1::2, 1::2] = 0.5 * (minus.real - plus.real)
    gram[:, 1::2, 0::2] = 0.5 * (plus.imag + sign * minus.imag)
    gram[:, 0::2, 1::2] = gram[:, 1::2, 0::2].transpose(0, 2, 1)
    kept = np.delete(np.arange(2 * harmonics + 2), 1)  # sin 0θ is not an unknown
    return gram[:, kept[:, None], kept]
