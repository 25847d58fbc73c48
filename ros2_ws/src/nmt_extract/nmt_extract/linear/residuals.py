"""What the modes outside the fitted ones add to the receptance: lower and upper residual."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.numerics.arrays import ComplexArray, FloatArray


@dataclass(frozen=True, eq=False)
class Residuals:
    """x/F = modes + lower/(−ω²) + upper at the response points, force at the drive point.

    Attributes:
        lower: 1/kg, shape ``(points,)``: modes below (a free body has φ φ_d there).
        upper: m/N, shape ``(points,)``: modes above.
        band_hz: where they were fitted and hold.
    """

    lower: ComplexArray
    upper: ComplexArray
    band_hz: tuple[float, float]

    def receptance(self, frequency_hz: FloatArray) -> ComplexArray:
        """Contribution at frequencies, m/N, shape ``(points, frequencies)``."""
        omega = 2.0 * np.pi * np.asarray(frequency_hz)
        return np.asarray(-self.lower[:, np.newaxis] / omega**2 + self.upper[:, np.newaxis])


def modal_receptance(
    products: FloatArray, omega_r: float, damping_ratio: float, frequency_hz: FloatArray
) -> ComplexArray:
    """Receptance of one mode, φ φ_d / (ω_r² − ω² + 2 i ζ ω_r ω), m/N, shape ``(points, frequencies)``.

    Args:
        products: φ φ_d, 1/kg, shape ``(points,)``.
        omega_r: rad/s.
        damping_ratio: 1.
        frequency_hz: Hz.
    """
    omega = 2.0 * np.pi * np.asarray(frequency_hz)
    shape = 1.0 / (omega_r**2 - omega**2 + 2j * damping_ratio * omega_r * omega)
    return np.asarray(np.asarray(products)[:, np.newaxis] * shape)


def fit_residuals(
    frequency_hz: FloatArray,
    receptance: ComplexArray,
    variance: FloatArray,
    modes: Sequence[tuple[FloatArray, float, float]],
    band_hz: tuple[float, float],
) -> Residuals:
    """Least squares of the measured receptance without the modes.

    Lines near a resonance count little: there the modes' own errors and the window's leakage (2 % of the modes'
    receptance are assumed) exceed the residuals.

    Args:
        frequency_hz: lines, Hz.
        receptance: measured, m/N, shape ``(points, lines)``.
        variance: of the measured receptance, shape ``(points, lines)``.
        modes: (φ φ_d, ω_r, ζ) of the modes to take out.
        band_hz: lines to use.

    Raises:
        BenchError: fewer than four lines in the band.
    """
    use = (frequency_hz >= band_hz[0]) & (frequency_hz <= band_hz[1])
    if np.count_nonzero(use) < 4:
        raise BenchError(
            f"There are fewer than four spectral lines between {band_hz[0]:.4g} and {band_hz[1]:.4g} Hz for the "
            "residuals; record longer."
        )
    lines = frequency_hz[use]
    omega = 2.0 * np.pi * lines
    fitted = np.zeros((receptance.shape[0], lines.size), dtype=np.complex128)
    for products, omega_r, damping_ratio in modes:
        fitted += modal_receptance(products, omega_r, damping_ratio, lines)
    rest = receptance[:, use] - fitted
    weights = 1.0 / np.sqrt(variance[:, use] + (0.02 * np.abs(fitted)) ** 2 + 1e-30)
    lower = np.empty(receptance.shape[0], dtype=np.complex128)
    upper = np.empty_like(lower)
    middle = float(np.mean(omega)) ** 2
    for row in range(receptance.shape[0]):
        matrix = np.column_stack([-middle / omega**2, np.ones_like(omega)]) * weights[row][:, np.newaxis]
        solution, *_ = np.linalg.lstsq(matrix.astype(np.complex128), rest[row] * weights[row], rcond=None)
        lower[row], upper[row] = solution[0] * middle, solution[1]
    return Residuals(lower, upper, band_hz)
