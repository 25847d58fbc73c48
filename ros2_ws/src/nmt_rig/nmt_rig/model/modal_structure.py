"""Structure given by its modes: natural frequencies, damping ratios, mode shapes at points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from nmt_rig.model.structure import Array, Structure


@dataclass(frozen=True)
class Mode:
    """One real mode.

    Attributes:
        frequency: ω, rad/s; 0 = rigid-body mode.
        damping_ratio: ζ.
        shape: displacement at the points, in any scale.
        modal_mass: φᵀ M φ in that scale, kg; 1 where the shape is mass-normalised.
        participation: Γ = φᵀ M r / (φᵀ M φ) for a motion r of the base, in the scale of the shape; None = not known.
    """

    frequency: float
    damping_ratio: float
    shape: tuple[float, ...]
    modal_mass: float = 1.0
    participation: float | None = None


def modal_structure(
    points: Sequence[int],
    modes: Sequence[Mode],
    residual_flexibility: Array | None = None,
    residual_frequency: float = 0.0,
    residual_damping_ratio: float = 0.0,
    base_motion: Sequence[float] | None = None,
) -> Structure:
    """Structure in modal coordinates of mass 1: η̈ + 2 ζ ω η̇ + ω² η = φᵀ f, points at Φ η.

    What modes above the measured ones contribute, the residual flexibility R (displacement per force, quasi-static), is
    kept as one mode at `residual_frequency` for each eigenvalue ρ > 0 of R, with the shape √ρ ω_R v: exact at zero
    frequency, too large by 1 / (1 - ω²/ω_R²) at ω (Ewins, Modal Testing, 2000, section 4.4).

    Args:
        points: point numbers.
        modes: at least one.
        residual_flexibility: (points, points) R, m/N, symmetric, positive semidefinite; None = none.
        residual_frequency: ω_R, rad/s, above all modes.
        residual_damping_ratio: ζ of these modes.
        base_motion: displacement of each point by that of the base; 1 when None.

    Returns:
        Structure whose base load is there if every mode says its participation; residual modes do not take part.

    Raises:
        ValueError: no modes or points, shapes of a wrong length, values out of range, a residual that is not symmetric
            or has a negative eigenvalue, or a residual frequency that does not lie above all modes.
    """
    n_points = len(points)
    if not modes or not n_points or len(set(points)) != n_points:
        raise ValueError("a modal model needs at least one mode, and points that differ from each other")
    frequencies, ratios, columns, loads = [], [], [], []
    for number, mode in enumerate(modes, start=1):
        if len(mode.shape) != n_points:
            raise ValueError(f"the shape of mode {number} must have {n_points} entries, got {len(mode.shape)}")
        if not (mode.frequency >= 0.0 and mode.damping_ratio >= 0.0 and mode.modal_mass > 0.0):
            raise ValueError(f"mode {number} needs a positive modal mass, and no negative frequency or damping ratio")
        frequencies.append(mode.frequency)
        ratios.append(mode.damping_ratio)
        columns.append(np.asarray(mode.shape) / np.sqrt(mode.modal_mass))
        loads.append(None if mode.participation is None else mode.participation * np.sqrt(mode.modal_mass))
    if residual_flexibility is not None:
        flexibility = np.asarray(residual_flexibility, dtype=float)
        if flexibility.shape != (n_points, n_points):
            raise ValueError(f"the residual flexibility must be {n_points} x {n_points}, got {flexibility.shape}")
        scale = float(np.max(np.abs(flexibility), initial=0.0))
        if not np.allclose(flexibility, flexibility.T, rtol=1e-6, atol=1e-9 * scale):
            raise ValueError("the residual flexibility must be symmetric")
        values, vectors = np.linalg.eigh(0.5 * (flexibility + flexibility.T))
        if np.any(values < -1e-6 * scale):
            raise ValueError("the residual flexibility must not have negative eigenvalues")
        if not residual_frequency > max(frequencies):
            raise ValueError("the frequency of the residual must lie above those of all modes")
        for value, vector in zip(values, vectors.T, strict=True):
            if value > 1e-12 * scale:
                frequencies.append(residual_frequency)
                ratios.append(residual_damping_ratio)
                columns.append(np.sqrt(value) * residual_frequency * vector)
                loads.append(0.0)
    omega, shapes = np.array(frequencies), np.array(columns).T
    known = [load for load in loads if load is not None]
    return Structure(
        mass=np.eye(omega.size),
        damping=np.diag(2.0 * np.array(ratios) * omega),
        stiffness=np.diag(omega**2),
        shapes={point: shapes[row].copy() for row, point in enumerate(points)},
        base_load=np.array(known) if len(known) == len(loads) else None,
        base_motion={} if base_motion is None else dict(zip(points, map(float, base_motion), strict=True)),
    )
