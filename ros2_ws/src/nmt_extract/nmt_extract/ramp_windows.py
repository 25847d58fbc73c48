"""Damping along a slow ramp of the level, without waiting for a steady state.

While the amplitude changes, the exciter's power goes into dissipation and into the energy of the mode. With
the modal energy E = ω̃² q² / 2 the balance is P₁ = dE/dt + ξ E, so ξ = (P₁ − dE/dt) / E; at constant level
this is eq. 4 of the method. It holds as long as the amplitude changes little over a period and the loop keeps
phase resonance.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from nmt_core.blocks import FloatArray, Quantity
from nmt_core.errors import BenchError
from nmt_core.linear_description import LinearDescription
from nmt_extract.harmonics import segment_moments, solve_moments, whole_period_bounds
from nmt_extract.modal import modal_quantities
from nmt_extract.window import Window


@dataclass(frozen=True, eq=False)
class RampPoints:
    """Modal properties along a ramp; every array has one value for each inner sub-window.

    Attributes:
        time: middle of the sub-window, s since the first sample of the window.
        omega_rad_s: ω̃, rad/s.
        modal_amplitude: q, m√kg.
        self_excitation: ξ from the power balance, rad/s.
        damping_ratio: δ̃ = ξ / (2 ω̃).
        active_power: P₁, W.
        energy_rate: dE/dt, W.
    """

    time: FloatArray
    omega_rad_s: FloatArray
    modal_amplitude: FloatArray
    self_excitation: FloatArray
    damping_ratio: FloatArray
    active_power: FloatArray
    energy_rate: FloatArray


def ramp_points(window: Window, linear: LinearDescription, periods: int = 4, harmonics: int = 1) -> RampPoints:
    """Modal properties of consecutive sub-windows of a stretch whose level changes slowly.

    Args:
        window: stretch with known excitation phase and displacement sensors at all points of the linear
            modes.
        linear: linear modes Φ.
        periods: whole periods of a sub-window.
        harmonics: harmonics fitted in each sub-window.

    Returns:
        One value for each inner sub-window.

    Raises:
        BenchError: the phase is not known, sensors are missing, or the stretch holds fewer than three
            sub-windows.
    """
    if window.cycles is None:
        raise BenchError(
            "The excitation's phase is not known, so a ramp cannot be evaluated; record it with the bench."
        )
    force = _row(window, Quantity.FORCE, linear.drive_point)
    drive = _row(window, Quantity.DISPLACEMENT, linear.drive_point)
    rows = [_row(window, Quantity.DISPLACEMENT, point) for point in linear.points]
    whole = math.floor(window.end_cycles - float(window.cycles[0]) + 1e-9)
    parts = whole // periods
    if parts < 3:
        raise BenchError(
            f"The stretch holds {whole} periods; a ramp needs three sub-windows of {periods} periods at least."
        )
    kept = int(np.searchsorted(window.cycles, window.cycles[0] + parts * periods - 1e-9))
    cycles = window.cycles[:kept]
    bounds = whole_period_bounds(cycles, parts * periods, parts)
    amplitudes = solve_moments(segment_moments(cycles, window.data[:, :kept], harmonics, bounds))
    # Phase advance of each sub-window, from its first sample to the first of the next.
    edges = np.append(window.cycles, window.end_cycles)[bounds]
    omega = 2.0 * np.pi * np.diff(edges) / (np.diff(bounds) / window.sample_rate)
    acceleration = -((np.arange(harmonics + 1) * omega[:, np.newaxis]) ** 2) * amplitudes[:, drive]
    values = modal_quantities(
        omega,
        amplitudes[:, force],
        amplitudes[:, drive],
        acceleration,
        amplitudes[:, rows, 1],
        linear.shape_matrix,
        linear.target_mode,
    )
    time = np.asarray(0.5 * (bounds[1:] + bounds[:-1]) / window.sample_rate, dtype=np.float64)
    energy = 0.5 * (omega * values.modal_amplitude) ** 2
    rate = np.gradient(energy, time)
    inner = slice(1, -1)
    excitation = ((values.active_power - rate) / energy)[inner]
    return RampPoints(
        time=time[inner],
        omega_rad_s=omega[inner],
        modal_amplitude=values.modal_amplitude[inner],
        self_excitation=excitation,
        damping_ratio=excitation / (2.0 * omega[inner]),
        active_power=values.active_power[inner],
        energy_rate=rate[inner],
    )


def _row(window: Window, quantity: Quantity, point: int) -> int:
    for row, channel in enumerate(window.channels):
        if channel.quantity is quantity and channel.point == point:
            return row
    raise BenchError(f"A ramp needs a {quantity.name.lower()} channel at point {point}; there is none.")
