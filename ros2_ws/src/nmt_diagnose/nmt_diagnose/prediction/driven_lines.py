"""Compiled solution of driven motions at given frequencies, line by line; see `periodic_kernel`."""

from __future__ import annotations

import numpy as np

from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_core.numerics.kernels import njit
from nmt_diagnose.prediction.periodic_kernel import (
    AMPLITUDE,
    DRIVE_HELD,
    FUNDAMENTAL,
    OMEGA,
    Balance,
    Closing,
    Limits,
    inverted,
    newton,
    resting_response,
    scales,
)
from nmt_diagnose.prediction.rig_tables import RigTables, sensor_gain

_CLIMB_STEPS = 40
_LOWEST = 0.02


@njit(cache=True)
def driven_start(
    closing: Closing,
    targets: FloatArray,
    stiffness: FloatArray,
    damping: FloatArray,
    drive: ComplexArray,
    rig: RigTables,
) -> FloatArray:
    """Unknowns (nz,) of a driven motion of the system linearised at rest."""
    s = 1j * targets[OMEGA]
    w, channels = resting_response(s, stiffness, damping, drive[FUNDAMENTAL], rig)
    a = complex(targets[AMPLITUDE])
    if closing.held != DRIVE_HELD:
        a = a / (sensor_gain(s, rig.channels[closing.held])[0] * channels[closing.held])
    size = rig.local.offsets[-1] + 2
    z = np.zeros(w.size * size + 2)
    for i in range(w.size):
        z[i * size + FUNDAMENTAL] = (w[i] * a).real
        z[i * size + FUNDAMENTAL + 1] = -(w[i] * a).imag
    z[w.size * size], z[w.size * size + 1] = a.real, a.imag
    return z


@njit(cache=True)
def climb(
    closing: Closing, targets: FloatArray, stiffness: FloatArray, damping: FloatArray, drive: ComplexArray,
    rig: RigTables, limits: Limits,
) -> tuple[bool, FloatArray, Balance]:  # fmt: skip
    """Solve one driven motion up from a small amplitude, in steps that shrink where they fail."""
    share, reached, ratio = _LOWEST, 0.0, 4.0
    level = targets.copy()
    level[AMPLITUDE] = share * targets[AMPLITUDE]
    found = newton(driven_start(closing, level, stiffness, damping, drive, rig), closing, level, drive, rig, limits)
    trial = found
    for _ in range(_CLIMB_STEPS):
        if trial[0]:
            found, reached = trial, share
        elif reached == 0.0:
            break
        else:
            ratio = ratio**0.5
        if reached == 1.0:
            break
        share = min(1.0, reached * ratio)
        level[AMPLITUDE] = share * targets[AMPLITUDE]
        trial = newton(found[1] * (share / reached), closing, level, drive, rig, limits)
    return reached == 1.0, found[1], found[2]


@njit(cache=True)
def solve_lines(
    start: FloatArray, known: np.ndarray, closing: Closing, targets: FloatArray, stiffness: FloatArray,
    damping: FloatArray, drive: ComplexArray, rig: RigTables, limits: Limits,
) -> tuple[np.ndarray, FloatArray, FloatArray, FloatArray, ComplexArray, ComplexArray]:  # fmt: skip
    """Solve every driven motion for itself, from its start or from the system linearised at rest.

    Args:
        start: (lines, nz) unknowns to start from.
        known: (lines,) whether a line has a start.
        closing, targets: what closes the balance, and what is given for each line (lines, 4).
        stiffness, damping: (r,) tangents of the local forces at rest.
        drive: (n_orders, exciters) inputs for a unit of the drive.
        rig, limits: the rig, and how Newton's method goes.

    Returns:
        converged (lines,), z (lines, nz), local forces (lines, r, size), inverse Jacobians (lines, nz, nz), channels
        (lines, c, 1) and their slopes (lines, c, 1, nz).
    """
    (lines, nz), c = start.shape, rig.channels.shape[0]
    size = rig.local.offsets[-1] + 2
    good, solved = np.zeros(lines, dtype=np.bool_), np.full((lines, nz), np.nan)
    forces, inverses = np.zeros((lines, (nz - 2) // size, size)), np.zeros((lines, nz, nz))
    channels = np.full((lines, c, 1), np.nan + 0j)
    slopes = np.zeros((lines, c, 1, nz), dtype=np.complex128)
    for line in range(lines):
        level, done = targets[line], False
        if known[line]:
            done, z, at = newton(start[line], closing, level, drive, rig, limits)
        if not done:
            z = driven_start(closing, level, stiffness, damping, drive, rig)
            done, z, at = newton(z, closing, level, drive, rig, limits)
        if not done:
            done, z, at = climb(closing, level, stiffness, damping, drive, rig, limits)
        if done:
            good[line], solved[line], forces[line] = True, z, at.forces
            inverses[line] = inverted(at.jacobian, *scales(z, closing, level, size))
            channels[line], slopes[line] = at.channels, at.slopes
    return good, solved, forces, inverses, channels, slopes
