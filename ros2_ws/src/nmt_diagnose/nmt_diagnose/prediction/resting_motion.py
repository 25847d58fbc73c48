"""Motions of the model linearised at rest: what a measurement moves, as far as no solution is needed for it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.linalg import eigh

from nmt_core.numerics.arrays import FloatArray
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.prediction.parts_cache import PartsCache, Setup
from nmt_diagnose.prediction.prediction_settings import PredictionSettings
from nmt_diagnose.prediction.rig_parts import RigParts, resting_tangent
from nmt_diagnose.prediction.rig_tables import GAIN
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_rig.model.fourier_basis import FourierBasis
from nmt_rig.rig import Rig
from nmt_rig.rig_model import build_system

Motion = tuple[RigParts, float, float, np.ndarray, np.ndarray]
"""Parts of a rig, ω (rad/s), drive, channel amplitudes and unknowns."""


def resting_response(parts: RigParts, omega: float) -> tuple[np.ndarray, np.ndarray]:
    """Unknowns and channels per unit of input, of the system linearised at rest."""
    system, rows, r = parts.system, parts.rows, parts.coordinates
    tangent = resting_tangent(parts, 0j).real
    stiffness = system.stiffness + sum(
        value * np.outer(direction, direction)
        for value, direction in zip(tangent, parts.inputs.T[: parts.coordinates], strict=True)
    )
    q = np.linalg.solve(stiffness + 1j * omega * system.damping - omega**2 * system.mass, system.input_vector + 0j)
    s = 1j * omega
    y = (rows.displacement + s * rows.velocity + s * s * rows.acceleration)[r:] @ q + rows.feedthrough[r:, r]
    return q, y * parts.channels[:, GAIN]


def motion_at_amplitudes(
    rig: Rig,
    drive_points: tuple[int, ...],
    given: MeasuredChannel,
    amplitudes: FloatArray,
    channels: tuple[MeasuredChannel, ...],
    settings: PredictionSettings,
    frequency_hz: float,
) -> list[Motion]:
    """Largest and smallest of the amplitudes of a channel, through the system linearised at rest at its resonance."""
    cache = PartsCache(settings)
    channel = next((c for c in channels if c.name == given.name), None)
    every = channels if channel is not None else (*channels, given)
    parts = cache.parts(rig, Setup(drive_points, False, every, FourierBasis.up_to(1)))
    resting = resting_frequencies(rig)
    omega = 2.0 * np.pi * nearest_frequency(resting, frequency_hz)
    q, y = resting_response(parts, omega)
    size = abs(y[[c.name for c in every].index(given.name)])
    found: list[Motion] = []
    for amplitude in (float(np.max(amplitudes)), float(np.min(amplitudes))):
        scale = amplitude / max(size, 1e-300)
        found.append((parts, omega, scale / parts.input_per_volt[0], y[: len(channels)] * scale, q * scale))
    return found


def noise_motion(
    rig: Rig,
    drive_point: int,
    channels: tuple[MeasuredChannel, ...],
    settings: PredictionSettings,
    omega: FloatArray,
    rms: float,
    ideal_force: bool,
) -> list[Motion]:
    """Rms of flat noise over the lines through the system linearised at rest."""
    cache = PartsCache(settings)
    parts = cache.parts(rig, Setup((drive_point,), ideal_force, channels, FourierBasis.up_to(1)))
    system = parts.system
    squares = np.zeros(len(channels))
    q_squares = np.zeros(system.size)
    weights = np.gradient(omega) if omega.size > 1 else np.ones(1)
    weights = weights / weights.sum()
    peak, top = omega[0], -1.0
    for w, weight in zip(omega, weights, strict=True):
        q, y = resting_response(parts, w)
        squares += weight * np.abs(y) ** 2
        q_squares += weight * np.abs(q) ** 2
        largest = float(np.max(np.abs(q[: system.structure_size])))
        if largest > top:
            top, peak = largest, w
    scale = rms * parts.input_per_volt[0]
    amplitudes = np.sqrt(squares).astype(complex) * scale
    return [(parts, float(peak), rms, amplitudes, np.sqrt(q_squares) * scale)]


def all_unknowns(
    parts: RigParts, omega: float, amplitudes: np.ndarray, channels: tuple[MeasuredChannel, ...]
) -> np.ndarray:
    """All unknowns, from the linearised system scaled to the largest probe."""
    system = parts.system
    tangent = np.abs(resting_tangent(parts, 1j * omega))
    impedance = system.stiffness + 1j * omega * system.damping - omega**2 * system.mass
    for value, direction in zip(tangent, parts.inputs.T[: parts.coordinates], strict=True):
        impedance = impedance + value * np.outer(direction, direction)
    q = np.linalg.solve(impedance, system.input_vector.astype(complex))
    probe = max(
        (i for i, channel in enumerate(channels) if channel.name.startswith("probe ")),
        key=lambda i: abs(amplitudes[i]),
    )
    return np.asarray(q * abs(amplitudes[probe]) / abs(system.motion(channels[probe].point, q)))


def resting_frequencies(rig: Rig) -> FloatArray:
    """Frequencies of the modes at rest, friction sticking, exciter attached, Hz; those of a free body left out."""
    system = build_system(rig)
    n = system.mechanical_size
    stiffness = system.sticking_stiffness()[:n, :n]
    squares = eigh(0.5 * (stiffness + stiffness.T), system.mass[:n, :n], eigvals_only=True)
    result: FloatArray = np.sqrt(squares[squares > 1e-9 * squares[-1]]) / (2.0 * np.pi)
    return result


def nearest_frequency(resting: FloatArray, frequency_hz: float) -> float:
    """The resting frequency nearest to another one, Hz; that one itself where nothing swings."""
    return float(resting[np.argmin(np.abs(np.log(resting / frequency_hz)))]) if resting.size else frequency_hz


def mode_under_test(rig: Rig) -> float:
    """Resting frequency of the mode that the rig file says is tested, Hz."""
    frequencies = resting_frequencies(rig)
    if not frequencies.size:
        return 1.0
    return float(frequencies[min(max(rig.test.mode, 1), frequencies.size) - 1])


def ratio_if_far_off(ratios: Sequence[float]) -> float:
    """Median of measured motions over those of a model; 1 where the model is off by less than a factor, or without."""
    ratio, limit = float(np.median(ratios)) if ratios else 1.0, THRESHOLDS.prediction.far_off_ratio
    return ratio if ratio > 0.0 and not 1.0 / limit <= ratio <= limit else 1.0
