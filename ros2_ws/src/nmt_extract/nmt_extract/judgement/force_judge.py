"""Whether the gain of the force has changed: an exciter obeys its own law, whatever the structure does."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from nmt_core.messages.linear_description import LinearDescription
from nmt_core.numerics.arrays import ComplexArray, FloatArray

_GAIN = 0.25  # logarithm of the force over what voltage and response say of it
_GAIN_SUSPECT = 0.1  # the same where it was off at the level before
_EXCITER = 1e-3  # of the blocked force: what no linear exciter explains
_PRIOR = {"model": 0.1, "test": 0.2}  # of the exciter's impedance, by the source of the linear description
_SURE_FORCE = 3.0  # standard deviations; the gain must be off by _GAIN, too
_CLEAN, _ALIKE = 20.0, 0.15  # harmonics: over their standard deviation; of the factor that they have in common


class DriveState(NamedTuple):
    """Force and motion at the drive point in one window.

    Attributes:
        omega: rad/s.
        voltage: fundamental of the drive, V; NaN = not measured.
        force: harmonics 0..H, N.
        velocity: harmonics 0..H at the drive point, m/s.
        force_std, velocity_std: their standard uncertainties; NaN = not known.
        driven: whether the drive has harmonics as well.
    """

    omega: float
    voltage: complex
    force: ComplexArray
    velocity: ComplexArray
    force_std: FloatArray
    velocity_std: FloatArray
    driven: bool = False


def force_gain(
    drive: DriveState, before: Sequence[DriveState], linear: LinearDescription, suspect: bool = False
) -> float | None:
    """By which factor the gain of the force has changed, if the change is clear.

    Whatever the structure does, an exciter obeys F + Z v = K u: K is its blocked force per volt and
    Z = c + i (ω m - k/ω) its impedance. The levels before determine K, c and k, from the linear modes with and without
    the exciter as a start;
    K u - Z v is the force that this level must have. Where damping is so strong, or the exciter so much stronger, that
    this says nothing, the harmonics may: without voltage they have F/v = -Z(nω), level after level.

    Args:
        drive: the window that is judged.
        before: those of the run without a fault.
        linear: modes, moving mass and the mode with the exciter attached.
        suspect: the gain had changed at the level before; no sensor mends itself.

    Returns:
        Measured over expected force, off by more than a quarter; None = no such change.
    """
    if not before:
        return None
    gains = [
        _fundamental_gain(drive, before, linear, 0.0 if suspect else _SURE_FORCE),
        _harmonic_gain(drive, before[-1]),
    ]
    least = _GAIN_SUSPECT if suspect else _GAIN
    return next((gain for gain in gains if gain is not None and abs(math.log(gain)) > least), None)


def _fundamental_gain(
    drive: DriveState, before: Sequence[DriveState], linear: LinearDescription, sure: float
) -> float | None:
    """Force over K u - Z v; None where voltage and response do not determine it."""
    known = [state for state in before if math.isfinite(abs(state.voltage))]
    if not known or not math.isfinite(abs(drive.voltage)) or linear.drive_point_shape == 0.0:
        return None
    mass, moving = linear.drive_point_shape**-2, linear.moving_mass_kg
    omega, plant = linear.frequencies_rad_s[linear.target_mode], linear.plant_frequency_rad_s
    damping = 2.0 * linear.plant_damping_ratio * plant * (mass + moving)
    damping -= 2.0 * linear.damping_ratios[linear.target_mode] * omega * mass
    stiffness = plant**2 * (mass + moving) - omega**2 * mass
    size = abs(complex(damping, omega * moving - stiffness / omega))
    open_z = _PRIOR.get(linear.source, 0.2) * size + (plant / omega - 1.0) ** 2 * omega * (mass + moving)
    open_z = max(open_z, 1e-3 * 2.0 * linear.damping_ratios[linear.target_mode] * omega * mass)

    def fundamental(state: DriveState) -> tuple[complex, complex, float, float]:
        return (
            complex(state.force[1]),
            complex(state.velocity[1]),
            float(state.force_std[1]),
            float(state.velocity_std[1]),
        )

    def rows(states: Sequence[DriveState]) -> tuple[ComplexArray, ComplexArray, FloatArray]:
        """Factors of K, and of the excess of c and k/ω₀ over the start; F with the start; its deviation."""
        force, speed, force_std, speed_std = (np.array(each) for each in zip(*map(fundamental, states), strict=True))
        voltage, at = np.array([state.voltage for state in states]), np.array([state.omega for state in states])
        factors = np.stack([voltage, 1j * voltage, -speed * open_z, 1j * speed * open_z * omega / at], axis=1)
        impedance = damping + 1j * (at * moving - stiffness / at)
        value = force + impedance * speed
        # F is often the small difference of K u and Z v: the noise of v counts as well.
        std = _EXCITER * np.abs(value) + np.hypot(
            np.nan_to_num(force_std), np.abs(impedance) * np.nan_to_num(speed_std)
        )
        return factors, value, std

    def parts(values: ComplexArray) -> FloatArray:
        """Real and imaginary part of each row below each other."""
        return np.stack([values.real, values.imag], axis=1).reshape(2 * len(values), *values.shape[1:])

    factors, value, std = rows(known)
    matrix = np.concatenate([[[0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]], parts(factors / std[:, None])])
    scale = np.abs(matrix).max(axis=0)
    covariance = np.linalg.pinv((matrix / scale).T @ (matrix / scale)) / np.outer(scale, scale)
    solution = covariance @ (matrix.T @ np.concatenate([np.zeros(2), parts(value / std)]))
    (factors,), (value,), (std,) = rows([drive])
    two = np.array([factors.real, factors.imag])
    spread = math.hypot(std, math.sqrt(max(float(np.trace(two @ covariance @ two.T)), 0.0)))
    expected = complex(drive.force[1]) - (value - complex(factors @ solution))
    if abs(drive.force[1] - expected) < sure * spread or abs(expected) == 0.0:
        return None
    return float(abs(drive.force[1]) / abs(expected))


def _harmonic_gain(drive: DriveState, before: DriveState) -> float | None:
    """The factor that F/v has in common over the harmonics, against the level before; None where they do not agree.

    Nothing is known where the drive has harmonics itself.
    """
    if drive.driven or before.driven:
        return None
    count = min(drive.force.size, before.force.size)
    ratios = []
    for n in range(2, count):
        pairs = [
            (abs(values[n]), std[n])
            for state in (drive, before)
            for values, std in ((state.force, state.force_std), (state.velocity, state.velocity_std))
        ]
        if all(value > _CLEAN * std for value, std in pairs):
            ratios.append(drive.force[n] / drive.velocity[n] / (before.force[n] / before.velocity[n]))
    if len(ratios) < 2:
        return None
    gain = float(np.median(np.abs(ratios)))
    agree = all(abs(ratio / gain - 1.0) < _ALIKE for ratio in ratios)
    return gain if agree and abs(drive.omega / before.omega - 1.0) < _ALIKE else None
