"""Complex harmonics of sampled signals by order analysis on the oscillator's phase.

Every channel is fitted by least squares with {1, cos nθ, sin nθ}, n = 1..H, where θ is the excitation phase
at each sample. Over whole periods of an integer number of samples this equals the discrete Fourier transform;
it stays exact when a period is no integer number of samples and when the frequency changes within the window.

Convention: x(t) = Re Σ ψ_n exp(i n θ); ψ_0 is real.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nmt_core.blocks import FloatArray
from nmt_core.errors import BenchError

ComplexArray = NDArray[np.complex128]
IndexArray = NDArray[np.int64]

_LANES = 8


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


def segment_moments(cycles: FloatArray, data: FloatArray, harmonics: int, bounds: IndexArray) -> Moments:
    """Sums for the fit of each segment of a window.

    Args:
        cycles: excitation phase at each sample, cycles, shape ``(samples,)``; need not be wrapped.
        data: shape ``(channels, samples)``.
        harmonics: H, at least 1.
        bounds: first sample of each segment and the end of the last, shape ``(segments + 1,)``, ascending.

    Returns:
        The sums, one set for each segment.
    """
    basis, projections = _compiled(_segment_moments)(
        np.ascontiguousarray(cycles, dtype=np.float64),
        np.ascontiguousarray(data, dtype=np.float64),
        int(harmonics),
        np.ascontiguousarray(bounds, dtype=np.int64),
    )
    return Moments(basis, projections)


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
    amplitudes, regular = _compiled(_solve_moments)(moments.basis, moments.projections)
    if not regular:
        harmonics = moments.projections.shape[-1] - 1
        raise BenchError(
            f"The samples do not determine {harmonics} harmonics; use fewer harmonics, more samples in a "
            "period or "
            "more periods."
        )
    result: ComplexArray = amplitudes
    return result


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
    """
    bounds = np.array([0, cycles.shape[0]], dtype=np.int64)
    amplitudes: ComplexArray = solve_moments(segment_moments(cycles, data, harmonics, bounds))[0]
    return amplitudes


def whole_period_bounds(cycles: FloatArray, periods: int, segments: int) -> IndexArray:
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


def compile_kernels() -> None:
    """Compile (or load from the cache) what the first window would otherwise wait for."""
    cycles = np.arange(64) / 16.0
    harmonic_amplitudes(cycles, np.zeros((1, 64)), 2)


@cache
def _compiled(kernel: Callable[..., Any]) -> Callable[..., Any]:
    """The kernel as machine code. numba is imported here: reading results needs no kernel and starts twice as fast."""
    import numba

    compiled: Callable[..., Any] = numba.njit(cache=True)(kernel)
    return compiled


def _segment_moments(
    cycles: FloatArray, data: FloatArray, harmonics: int, bounds: IndexArray
) -> tuple[ComplexArray, ComplexArray]:
    segments = bounds.shape[0] - 1
    channels = data.shape[0]
    orders = 2 * harmonics + 1
    basis = np.zeros((segments, orders), dtype=np.complex128)
    projections = np.zeros((segments, channels, harmonics + 1), dtype=np.complex128)
    # Eight independent partial sums a quantity: they fill the vector registers without reordering any sum, so
    # the result is the same on every call.
    basis_cos = np.empty((orders, _LANES))
    basis_sin = np.empty((orders, _LANES))
    data_cos = np.empty((channels, harmonics + 1, _LANES))
    data_sin = np.empty((channels, harmonics + 1, _LANES))
    cos1 = np.empty(_LANES)
    sin1 = np.empty(_LANES)
    cos_n = np.empty(_LANES)
    sin_n = np.empty(_LANES)
    values = np.empty((channels, _LANES))
    for segment in range(segments):
        basis_cos[:] = 0.0
        basis_sin[:] = 0.0
        data_cos[:] = 0.0
        data_sin[:] = 0.0
        start = bounds[segment]
        stop = bounds[segment + 1]
        while start < stop:
            count = min(_LANES, stop - start)
            for lane in range(_LANES):
                cos1[lane] = 0.0
                sin1[lane] = 0.0
                cos_n[lane] = 0.0
                sin_n[lane] = 0.0
            for lane in range(count):
                phase = cycles[start + lane]
                theta = 2.0 * np.pi * (phase - np.floor(phase))
                cos1[lane] = np.cos(theta)
                sin1[lane] = np.sin(theta)
                cos_n[lane] = 1.0
            for channel in range(channels):
                for lane in range(_LANES):
                    values[channel, lane] = 0.0
                for lane in range(count):
                    values[channel, lane] = data[channel, start + lane]
            for order in range(orders):
                for lane in range(_LANES):
                    basis_cos[order, lane] += cos_n[lane]
                    basis_sin[order, lane] += sin_n[lane]
                if order <= harmonics:
                    for channel in range(channels):
                        for lane in range(_LANES):
                            data_cos[channel, order, lane] += values[channel, lane] * cos_n[lane]
                            data_sin[channel, order, lane] += values[channel, lane] * sin_n[lane]
                for lane in range(_LANES):
                    turned = cos_n[lane] * cos1[lane] - sin_n[lane] * sin1[lane]
                    sin_n[lane] = sin_n[lane] * cos1[lane] + cos_n[lane] * sin1[lane]
                    cos_n[lane] = turned
            start += count
        for order in range(orders):
            real = 0.0
            imag = 0.0
            for lane in range(_LANES):
                real += basis_cos[order, lane]
                imag += basis_sin[order, lane]
            basis[segment, order] = complex(real, imag)
        for channel in range(channels):
            for order in range(harmonics + 1):
                real = 0.0
                imag = 0.0
                for lane in range(_LANES):
                    real += data_cos[channel, order, lane]
                    imag += data_sin[channel, order, lane]
                projections[segment, channel, order] = complex(real, imag)
    return basis, projections


def _solve_moments(basis: ComplexArray, projections: ComplexArray) -> tuple[ComplexArray, bool]:
    segments, channels, terms = projections.shape
    harmonics = terms - 1
    size = 2 * harmonics + 1
    amplitudes = np.zeros((segments, channels, terms), dtype=np.complex128)
    gram = np.empty((size, size))
    right = np.empty(size)
    for segment in range(segments):
        sums = basis[segment]
        samples = sums[0].real
        # Unknowns 1, cos θ, sin θ, cos 2θ, ...; products of two basis functions are sums over n ± m.
        gram[0, 0] = samples
        for n in range(1, harmonics + 1):
            gram[2 * n - 1, 0] = sums[n].real
            gram[2 * n, 0] = sums[n].imag
            for m in range(1, n + 1):
                plus = sums[n + m]
                minus = sums[n - m]
                gram[2 * n - 1, 2 * m - 1] = 0.5 * (minus.real + plus.real)
                gram[2 * n, 2 * m] = 0.5 * (minus.real - plus.real)
                gram[2 * n, 2 * m - 1] = 0.5 * (plus.imag + minus.imag)
                gram[2 * n - 1, 2 * m] = 0.5 * (plus.imag - minus.imag)
            # The upper half is not read; sin n · cos n stands at (2n, 2n - 1).
        for j in range(size):
            for k in range(j):
                gram[j, j] -= gram[j, k] * gram[j, k]
            if not gram[j, j] > 1e-9 * samples:
                return amplitudes, False
            gram[j, j] = np.sqrt(gram[j, j])
            for i in range(j + 1, size):
                for k in range(j):
                    gram[i, j] -= gram[i, k] * gram[j, k]
                gram[i, j] /= gram[j, j]
        for channel in range(channels):
            row = projections[segment, channel]
            right[0] = row[0].real
            for n in range(1, terms):
                right[2 * n - 1] = row[n].real
                right[2 * n] = row[n].imag
            for i in range(size):
                for k in range(i):
                    right[i] -= gram[i, k] * right[k]
                right[i] /= gram[i, i]
            for i in range(size - 1, -1, -1):
                for k in range(i + 1, size):
                    right[i] -= gram[k, i] * right[k]
                right[i] /= gram[i, i]
            amplitudes[segment, channel, 0] = right[0]
            for n in range(1, terms):
                amplitudes[segment, channel, n] = complex(right[2 * n - 1], -right[2 * n])
    return amplitudes, True
