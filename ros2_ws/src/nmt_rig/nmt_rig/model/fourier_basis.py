"""Real Fourier basis of the harmonic balance.

A periodic signal x(t) = Re Σ_n ψ_n exp(i n ω t) is stored by real coefficients, order by order: one mean
value for n = 0, otherwise (c_n, s_n) with x = Σ c_n cos(nθ) + s_n sin(nθ) and ψ_n = c_n − i s_n (θ = ω t).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.numerics.arrays import ComplexArray, FloatArray, IntArray


@dataclass(frozen=True)
class FourierBasis:
    """Harmonic orders kept by the harmonic balance, ascending and unique.

    Attributes:
        orders: (n_orders,) harmonic orders, e.g. 0, 1, …, H or 1, 3, …, H.
        offsets: (n_orders,) position of each order's first real coefficient.
        size: number of real coefficients of one signal.
    """

    orders: IntArray
    offsets: IntArray
    size: int

    @classmethod
    def up_to(cls, harmonics: int, odd_only: bool = False) -> FourierBasis:
        """Orders 0 … ``harmonics``, or only the odd ones (then without mean).

        Raises:
            BenchError: ``harmonics`` is smaller than one.
        """
        if harmonics < 1:
            raise BenchError(f"harmonics must be at least 1, got {harmonics}; give the highest harmonic order to keep.")
        return cls.of(range(1, harmonics + 1, 2) if odd_only else range(harmonics + 1))

    @classmethod
    def of(cls, orders: range | list[int] | tuple[int, ...]) -> FourierBasis:
        """Basis of the given orders; the fundamental (order 1) must be among them.

        Raises:
            BenchError: an order is negative, or the fundamental is missing.
        """
        kept = np.unique(np.asarray(list(orders), dtype=np.int64))
        if kept.size == 0 or kept[0] < 0 or 1 not in kept:
            raise BenchError(f"harmonic orders {list(orders)} must be non-negative and contain 1.")
        widths = np.where(kept == 0, 1, 2)
        offsets = np.concatenate(([0], np.cumsum(widths)[:-1])).astype(np.int64)
        return cls(kept, offsets, int(widths.sum()))

    @cached_property
    def fundamental(self) -> int:
        """Position of order 1 in ``orders``."""
        return int(np.flatnonzero(self.orders == 1)[0])

    @cached_property
    def _sines(self) -> tuple[IntArray, IntArray]:
        """Positions of the orders above 0, and of their sine coefficients."""
        above = np.flatnonzero(self.orders > 0)
        return above, self.offsets[above] + 1

    def to_complex(self, coefficients: FloatArray) -> ComplexArray:
        """Complex amplitudes ψ_n (…, n_orders) of real coefficients (…, size)."""
        amplitudes = np.empty((*coefficients.shape[:-1], self.orders.size), dtype=np.complex128)
        above, sines = self._sines
        amplitudes.real = coefficients[..., self.offsets]
        amplitudes.imag = 0.0
        amplitudes.imag[..., above] = -coefficients[..., sines]
        return amplitudes

    def to_real(self, amplitudes: ComplexArray) -> FloatArray:
        """Real coefficients (…, size) of complex amplitudes ψ_n (…, n_orders)."""
        coefficients = np.empty((*amplitudes.shape[:-1], self.size))
        above, sines = self._sines
        coefficients[..., self.offsets] = amplitudes.real
        coefficients[..., sines] = -amplitudes.imag[..., above]
        return coefficients

    def sampled(self, samples: int) -> FloatArray:
        """Basis functions at θ_j = 2π j / samples: (samples, size), read-only."""
        found = self._sampled.get(samples)
        if found is None:
            found = self._sampled[samples] = self.at(2.0 * np.pi * np.arange(samples) / samples)
            found.setflags(write=False)
        return found

    @cached_property
    def _sampled(self) -> dict[int, FloatArray]:
        """What has been sampled so far, by the number of samples."""
        return {}

    def at(self, angles: FloatArray) -> FloatArray:
        """Basis functions at the angles θ (rad): (n_angles, size)."""
        values = np.empty((angles.size, self.size))
        for order, offset in zip(self.orders, self.offsets, strict=True):
            values[:, offset] = np.cos(order * angles)
            if order:
                values[:, offset + 1] = np.sin(order * angles)
        return values

    def sampled_slope(self, samples: int) -> FloatArray:
        """Derivatives d/dθ of the basis functions at θ_j = 2π j / samples: (samples, size)."""
        angles = 2.0 * np.pi * np.arange(samples) / samples
        values = np.zeros((samples, self.size))
        for order, offset in zip(self.orders, self.offsets, strict=True):
            if order:
                values[:, offset] = -order * np.sin(order * angles)
                values[:, offset + 1] = order * np.cos(order * angles)
        return values
