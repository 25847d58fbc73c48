"""The exciters' part in a linear modal test: the target mode with them attached, force per volt, moving mass."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np

from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_core.vocabulary import MOTIONS
from nmt_extract.linear.results import LinearMode, PlantEstimate
from nmt_signals.frequency_responses import FrfEstimate


class RecordWithVoltages(Protocol):
    """What is asked of a record with voltages."""

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of forces and responses, rows of the fits."""

    @property
    def force_rows(self) -> Sequence[int]:
        """Rows of the forces."""

    @property
    def drive_rows(self) -> Sequence[int]:
        """Rows of the responses at the exciters."""

    @property
    def quantities(self) -> Mapping[str, Quantity]:
        """Of the channels."""

    @property
    def sample_rate(self) -> float:
        """Hz."""


def plant_estimate(
    record: RecordWithVoltages, modes: tuple[LinearMode, ...], target: int, voltage_frfs: tuple[FrfEstimate, ...]
) -> PlantEstimate | None:
    """Pole of voltage to response next to the target, and what the exciters make there; None without a voltage.

    Args:
        record: the record's channels.
        modes: kept modes.
        target: index of the target mode.
        voltage_frfs: each voltage to forces and responses.
    """
    if not voltage_frfs:
        return None
    mode = modes[target]
    fit, drives = mode.fit, record.drive_rows
    at = fit.response(np.array([mode.frequency_hz]))[:, :, 0]
    forces = at[list(record.force_rows)]
    ratio = _isolating_voltages(forces, np.array([other.drive_shapes for other in modes]), target)
    eigenvalues = fit.eigenvalues
    driven = np.einsum("djp,j->dp", fit.residues[list(drives)], ratio)
    chosen = int(np.argmax(np.linalg.norm(driven, axis=0) / np.abs(eigenvalues)))
    eigenvalue = complex(eigenvalues[chosen])
    scale = 2.0 * math.pi * fit.half_width_hz
    std = scale * math.sqrt(max(fit.covariance[chosen, chosen].real, 0.0) / 2.0)
    omega = abs(eigenvalue)
    drive = record.outputs[drives[0]]
    power = MOTIONS[record.quantities[drive]]
    return PlantEstimate(
        frequency_hz=omega / (2.0 * math.pi),
        damping_ratio=-eigenvalue.real / omega,
        frequency_std=std / (2.0 * math.pi),
        damping_std=std / omega,
        force_per_volt=float(abs(forces[0] @ ratio)),
        displacement_per_volt=float(abs(at[drives[0]] @ ratio)) / mode.omega**power,
        moving_mass_kg=moving_mass(voltage_frfs[0], record.outputs[0], drive, power, record.sample_rate / 16.0),
    )


def _isolating_voltages(forces: ComplexArray, excited: FloatArray, target: int) -> ComplexArray:
    """Voltages over the first one that drive the target mode and, as far as they can, none of the others.

    Args:
        forces: per volt, shape ``(exciters, exciters)``.
        excited: modes at the exciters' points, shape ``(modes, exciters)``.
        target: index of the target mode.
    """
    wanted = np.linalg.pinv(excited)[:, target]
    answer, *_ = np.linalg.lstsq(np.column_stack([forces[:, 1:], -wanted]), -forces[:, 0], rcond=None)
    return np.concatenate([np.ones(1), answer[:-1]])


def moving_mass(frf: FrfEstimate, force: str, drive: str, power: int, highest_hz: float) -> float:
    """Moving mass of the exciter, kg, from voltage to force and voltage to drive-point response.

    An exciter gives the force it would give to a blocked table less what its own impedance takes:
    F = T u − Z x with T = g (1 + c s²) / (1 + s τ), Z = s² m + s d / (1 + s τ) + k. c allows for the roll-off of the
    converter's hold. With τ (inductance over resistance of the coil) on a grid the rest is linear; lines are weighted
    evenly over the logarithm of frequency. All damping is counted as electrical: mechanical damping d₀ adds d₀ τ to m
    (3 % for the virtual experiment's shaker).

    Args:
        frf: voltage to force and drive-point response.
        force, drive: their names.
        power: 0, 1 or 2: the response is a displacement, velocity or acceleration.
        highest_hz: lines to use, Hz.
    """
    use = frf.frequency_hz <= highest_hz
    frequency = frf.frequency_hz[use]
    s = np.asarray(2j * np.pi * frequency)
    left = frf.h1[frf.outputs.index(force)][use]
    motion = frf.h1[frf.outputs.index(drive)][use] / s**power
    weight = 1.0 / np.sqrt(frequency) / np.abs(left)
    target = np.concatenate([(left * weight).real, (left * weight).imag])
    best = (math.inf, 0.0)
    for tau in np.concatenate([[0.0], np.geomspace(1e-6, 1e-2, 81)]):
        coil = 1.0 / (1.0 + s * tau)
        matrix = (np.array([coil, coil * s**2, -motion * s**2, -motion * s * coil, -motion]) * weight).T
        stacked = np.vstack([matrix.real, matrix.imag])
        norm = np.linalg.norm(stacked, axis=0)
        solution, *_ = np.linalg.lstsq(stacked / norm, target, rcond=None)
        cost = float(np.sum((stacked / norm @ solution - target) ** 2))
        if cost < best[0]:
            best = (cost, float(solution[2] / norm[2]))
    return max(best[1], 0.0)
