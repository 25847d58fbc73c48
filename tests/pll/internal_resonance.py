"""The shipped rig with a 1:3 internal resonance: its phase-resonant backbone by a balance of its own."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
from independent.harmonic_continuation import CubicModes, PhaseBranch, Solution

HIGHEST = 3.0e-3  # m


def system(factor: float) -> CubicModes:
    """The numbers of the rig file; ``factor`` times 1 % damping."""
    omega = 2.0 * math.pi * np.array([20.0, 61.2, 160.0])
    return CubicModes(
        omega, np.full(3, 0.01 * factor), np.array([1.0, -0.9, 0.8]), np.array([0.6, 0.5, -0.6]), 1.0e8, 11
    )


@cache
def backbone(factor: float) -> tuple[PhaseBranch, tuple[Solution, ...], np.ndarray]:
    """The branch, its solutions from 0.01 N up to 3 mm, and the drive point's amplitudes of them (m)."""
    modes = system(factor)
    branch = PhaseBranch(modes, 90.0, 1e-3)
    series = np.zeros((modes.orders.size, 3), complex)
    series[0, 0] = -0.01j * modes.drive_shape[0] / (2.0 * modes.zeta[0] * modes.omega[0] ** 2)
    start = Solution(series, float(modes.omega[0]), 0.01)
    found = branch.follow(start, 0.1, lambda item: abs(modes.drive_point(item.series, 1)) > HIGHEST)
    return branch, tuple(found), np.array([abs(modes.drive_point(item.series, 1)) for item in found])


def at_amplitude(factor: float, amplitude: float) -> list[Solution]:
    """All solutions at an amplitude of the drive point, m."""
    branch, found, amplitudes = backbone(factor)
    crossed = np.flatnonzero(np.diff(np.sign(amplitudes - amplitude)))
    return [branch.at_amplitude(found[place], amplitude) for place in crossed]


def folds(factor: float) -> tuple[list[float], list[float]]:
    """Forces (N) and amplitudes (m) at which the backbone turns back."""
    _, found, amplitudes = backbone(factor)
    force = np.array([item.force for item in found])
    turned = [np.flatnonzero(np.diff(np.sign(np.diff(values)))) + 1 for values in (force, amplitudes)]
    return [float(force[place]) for place in turned[0]], [float(amplitudes[place]) for place in turned[1]]
