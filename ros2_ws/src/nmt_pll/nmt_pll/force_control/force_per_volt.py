"""Force at every exciter per volt of every exciter, G(f): tables, and the gain of the fundamental near a resonance."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.files.hardened import json_value
from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_pll.thresholds import HARMONICS

ForcePerVolt = Callable[[FloatArray], ComplexArray]
"""G at frequencies in Hz (k,), N/V, shape (k, exciters, exciters); NaN where it is not known."""


def table_of(rows: Sequence[Sequence[float]], exciters: int = 1) -> ForcePerVolt:
    """G(f) from rows of frequency (Hz) and, row by row, real and imaginary parts of G (N/V); straight in between.

    It is NaN beyond the rows, and everywhere without any.

    Raises:
        BenchError: rows of another length, or numbers that are not finite.
    """
    columns = 1 + 2 * exciters**2
    ragged = any(len(row) != columns for row in rows)
    table = np.empty((0, columns)) if ragged or not rows else np.array(sorted(map(tuple, rows)), float)
    if ragged or not np.isfinite(table).all():
        raise BenchError(
            f"The force per volt of {exciters} exciter{'s' if exciters > 1 else ''} must be rows of {columns} finite "
            "numbers: frequency in Hz, then real and imaginary part in N/V, row by row."
        )
    frequency = table[:, 0].copy()
    elements = np.ascontiguousarray((table[:, 1::2] + 1j * table[:, 2::2]).T)

    def value(frequency_hz: FloatArray) -> ComplexArray:
        if not frequency.size:
            return np.full((*np.shape(frequency_hz), exciters, exciters), math.nan, complex)
        result = np.empty((len(frequency_hz), exciters**2), complex)
        for place, element in enumerate(elements):
            result[:, place] = np.interp(frequency_hz, frequency, element, math.nan, math.nan)
        return result.reshape(-1, exciters, exciters)

    return value


def table_from_json(text: str, exciters: int = 1) -> ForcePerVolt:
    """`table_of` the rows of a JSON text; an empty text knows nothing.

    Raises:
        BenchError: it is not JSON, or not such rows.
    """
    if not text:
        return table_of((), exciters)
    rows = json_value(text, "The force per volt")
    if not isinstance(rows, list) or not all(
        isinstance(row, list) and all(isinstance(x, int | float) for x in row) for row in rows
    ):
        raise BenchError("The force per volt (force_per_volt_json) must be a list of rows of numbers.")
    return table_of(rows, exciters)


def start_ratios(force_per_volt: ForcePerVolt, frequency_hz: float, forces: FloatArray) -> ComplexArray:
    """V_j / V_1 that make forces in this ratio; the first exciter alone where that cannot be, or is not known.

    Args:
        force_per_volt: G(f).
        frequency_hz: of the fundamental.
        forces: wanted, any unit, shape (exciters,).

    Returns:
        shape (exciters,).
    """
    gain = force_per_volt(np.array([frequency_hz]))[0]
    if np.isfinite(gain).all() and np.linalg.matrix_rank(gain) == forces.size:
        voltages = np.linalg.solve(gain, forces.astype(complex))
        if abs(voltages[0]) > 0.0:
            return np.asarray(voltages / voltages[0], dtype=np.complex128)
    return np.asarray(np.eye(1, forces.size)[0], dtype=np.complex128)


def fundamental_gain(
    force_per_volt: ForcePerVolt, frequency_hz: float, rate: float, ratios: ComplexArray
) -> ComplexArray:
    """Ĝ_j of the fundamentals of exciters 2, 3, …, N/V, shape (exciters,); 1 for the first, which others control.

    At resonance the force follows the voltage as (s + δ_s)/(s + δ_p), slowly with little and at once with much. Ĝ has
    the phase of the force per volt next to the resonance and the size

        |Ĝ_j| = max over |ν| ≥ κ of κ/|ν| Σ_i |G_ji(ω + ν) − ρ_j G_1i(ω + ν)|,   ρ = F*/F_1,

    so that the loop's gain is at most one from κ on, where filter and dead time count. Below, its phase stays within
    ±90° of an integrator's because exciter and structure are passive.

    Args:
        force_per_volt: G(f).
        frequency_hz: of the target mode.
        rate: κ, 1/s.
        ratios: ρ, shape (exciters,).

    Raises:
        BenchError: G is not known next to the resonance.
    """
    if ratios.size == 1:
        return np.ones(1, complex)
    least = rate / (2.0 * math.pi)
    away = np.geomspace(
        least, max(HARMONICS.resonance_band_ratio - 1.0, 2.0 * least / frequency_hz) * frequency_hz, 200
    )
    both = np.concatenate([frequency_hz - away[away < 0.5 * frequency_hz], frequency_hz + away])
    gains = force_per_volt(both)
    known = ~np.isnan(gains).any(axis=(1, 2))
    if not known.any():
        raise BenchError(
            f"Several exciters need their force per volt near {frequency_hz:.4g} Hz; give the linear description "
            "exciter_force_rows there, or run ./nmt linear."
        )
    off_resonance_hz = both[known][np.argmin(np.abs(both[known] - HARMONICS.resonance_band_ratio * frequency_hz))]
    rows = np.abs(gains[:, :, 1:] - ratios[:, None] * gains[:, :1, 1:]).sum(axis=2)
    size = (least / np.abs(both[known] - frequency_hz)[:, None] * rows[known]).max(axis=0)
    diagonal = np.diagonal(force_per_volt(np.array([off_resonance_hz]))[0])
    gain = np.asarray(size * diagonal / np.maximum(np.abs(diagonal), 1e-300), dtype=np.complex128)
    gain[0] = 1.0
    return gain
