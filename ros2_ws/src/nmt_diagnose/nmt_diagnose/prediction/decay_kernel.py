"""Compiled damping of free decays: how the amplitude of one channel decays while the shape changes with it.

The motions themselves are those of :mod:`nmt_diagnose.prediction.periodic_kernel`, closed as ``FREE``.
"""

from __future__ import annotations

import numpy as np

from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_core.numerics.kernels import njit
from nmt_diagnose.prediction.linear_model import add_response
from nmt_diagnose.prediction.periodic_kernel import (
    AMPLITUDE,
    FUNDAMENTAL,
    WEIGHT,
    Closing,
    amplitude_of_drive,
    evaluate,
    forces_of,
    motion_of,
    phasor,
    rates,
    scaled_solve,
    scales,
    transfers,
)
from nmt_diagnose.prediction.rig_tables import RigTables, sensor_gain


@njit(cache=True)
def free_rows(z: FloatArray, amplitudes: FloatArray, closing: Closing, rig: RigTables) -> FloatArray:
    """What is given for decays, (levels, 4): the amplitude before the sensor, and what makes the drive dimensionless.

    Args:
        z: unknowns (levels, nz).
        amplitudes: (levels,) of the channel, as recorded.
        closing: of which channel.
        rig: the rig.
    """
    result = np.zeros((z.shape[0], WEIGHT + 1))
    outputs, columns = rig.model.feedthrough.shape
    row, r = outputs - rig.channels.shape[0] + closing.held, outputs - rig.channels.shape[0]
    for level in range(z.shape[0]):
        omega, decay = motion_of(z[level], closing, result[level])
        true = amplitudes[level] / abs(sensor_gain(1j * omega, rig.channels[closing.held])[0])
        # Change of 1/T per relative change of s, at the nearest pole.
        s = omega * (1j - decay)
        both = np.zeros((2, 1, outputs, columns), dtype=np.complex128)
        add_response(s * (1.0 + 1e-6), rig.model, 0, row + 1, r + 1, both[0], both[1])
        t, slope = both[0, 0, row, r], both[1, 0, row, r]
        result[level, AMPLITUDE], result[level, WEIGHT] = true, 1.0 / (abs(slope / t**2 * s) * true)
    return result


@njit(cache=True)
def _pole_amounts(
    z: FloatArray, closing: Closing, targets: FloatArray, drive: ComplexArray, rig: RigTables
) -> ComplexArray:
    """Fundamental of each pole of the linear model, (k,)."""
    poles, inputs = rig.model.poles, rig.model.inputs
    g = forces_of(z, closing, targets, rig, False).amounts
    omega, decay = motion_of(z, closing, targets)
    s, _, _ = rates(FUNDAMENTAL, omega, decay, closing.kind)
    t = transfers(z, closing, targets, drive, np.arange(rig.local.orders.size) == FUNDAMENTAL, rig, False)
    h = amplitude_of_drive(z, g, closing, targets, drive, t)
    result = np.empty(poles.size, dtype=np.complex128)
    for k in range(poles.size):
        total = inputs[k, g.shape[0]] * h
        for j in range(g.shape[0]):
            total -= inputs[k, j] * phasor(g, j, FUNDAMENTAL, FUNDAMENTAL)
        result[k] = total / (s - poles[k])
    return result


@njit(cache=True)
def observed_ratios(
    z: FloatArray, closing: Closing, targets: FloatArray, drive: ComplexArray, rig: RigTables
) -> FloatArray:
    """Damping ratios (levels,) as the amplitude of the channel itself decays.

    Solutions take all amplitudes to decay alike. But the shape and the frequency of a nonlinear mode change with the
    amplitude A as it decays: each pole of the linear model has y' = λ y + b f with an amplitude y(A) of its own, so
    that (s − λ) y = b f + α (dy/d ln A − y) for A' = −α A; outputs that are time derivatives change alike. That moves
    all outputs by α D, and κ with them. With one degree of freedom it is 2 ω A' + ω' A = −2 α₀ ω A, the slow form of
    its equation of motion.

    Args:
        z: unknowns (levels, nz).
        closing, targets: of the channel, and :func:`free_rows` of the levels.
        drive: inputs for a unit of the drive.
        rig: the rig.
    """
    model, step = rig.model, 1e-3
    size, r = rig.local.offsets[-1] + 2, model.feedthrough.shape[0] - rig.channels.shape[0]
    output = r + closing.held
    result = np.empty(z.shape[0])
    only = np.arange(rig.local.orders.size) == FUNDAMENTAL
    for level in range(z.shape[0]):
        unknowns, row = z[level], targets[level]
        omega, decay = motion_of(unknowns, closing, row)
        s = omega * (1j - decay)
        at, more, later = evaluate(unknowns, closing, row, drive, rig, True), row.copy(), row.copy()
        scale, weights = scales(unknowns, closing, row, size)
        more[AMPLITUDE] *= 1.0 + 1e-5
        later[AMPLITUDE] *= 1.0 + step
        off = evaluate(unknowns, closing, more, drive, rig, False).residual
        along = scaled_solve(at.jacobian, (at.residual - off) / 1e-5, scale, weights)
        amounts = _pole_amounts(unknowns, closing, row, drive, rig)
        changed = _pole_amounts(unknowns + step * along, closing, later, drive, rig)
        t = transfers(unknowns, closing, row, drive, only, rig, False).values[FUNDAMENTAL]
        shift = np.zeros(r + 1, dtype=np.complex128)
        for o in range(r + 1):
            place = o if o < r else output
            for k in range(model.poles.size):
                velocity, acceleration = model.velocity[place, k], model.acceleration[place, k]
                out = model.displacement[place, k] + s * (velocity + s * acceleration)
                change_of_shape = (changed[k] - amounts[k]) / step - amounts[k]
                shift[o] += (out / (s - model.poles[k]) - velocity - 2.0 * s * acceleration) * change_of_shape
                shift[o] -= 1j * acceleration * along[-2] * amounts[k]
        change = np.zeros(unknowns.size)
        held = -shift[r] / t[output, r]
        change[r * size], change[r * size + 1] = held.real * row[WEIGHT], held.imag * row[WEIGHT]
        for o in range(r):
            value = shift[o] + t[o, r] * held
            change[o * size + FUNDAMENTAL], change[o * size + FUNDAMENTAL + 1] = -value.real, value.imag
        result[level] = decay / (1.0 + omega * scaled_solve(at.jacobian, change, scale, weights)[-1])
    return result
