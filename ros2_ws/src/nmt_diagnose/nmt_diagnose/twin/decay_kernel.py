"""Compiled residual of a free decay: harmonic balance at complex frequency.

Within one period a slowly decaying motion is a copy of the one before times exp(−κ 2π): its orders move with
s_n = i n ω − κ ω. Unknowns are z = [w (r · size), ω, κ]; one channel has the given fundamental amplitude. A fictitious
drive holds that amplitude and has to vanish, which it does at the pole of the linear system and, with local forces, at
its continuation over amplitude.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from nmt_core.arrays import ComplexArray, FloatArray
from nmt_diagnose.twin.linear_model import transfer_at
from nmt_diagnose.twin.periodic_kernel import (
    RigTables,
    add_force_slopes,
    harmonic_forces,
    local_amounts,
    output_of,
    phasor,
    sensor_gain,
    set_jacobian,
    set_residual,
)


@njit(cache=True)
def evaluate_decay(
    z: FloatArray, amplitude: complex, weight: float, output: int, rig: RigTables
) -> tuple[FloatArray, FloatArray]:
    """Residual (nz,) and Jacobian (nz, nz).

    Args:
        z: unknowns.
        amplitude: given fundamental of an output, before its sensor.
        weight: makes the drive that has to vanish dimensionless.
        output: row of that output in the linear model.
    """
    model, _, factor, tables = rig
    orders, offsets = tables[0], tables[1]
    count = orders.size
    r = model[4].shape[1] - 1
    size = offsets[count - 1] + 2
    local = r * size
    nz = local + 2
    omega, ratio = z[local], z[local + 1]
    displacement = z[:local].copy().reshape(r, size)
    g, dg, g_omega = harmonic_forces(displacement, omega, factor, tables)
    residual = np.zeros(nz)
    jacobian = np.zeros((nz, nz))
    column = np.zeros(nz, dtype=np.complex128)
    drive = np.zeros(nz, dtype=np.complex128)
    for n in range(count):
        order = orders[n]
        offset = offsets[n]
        decay = 0.0 if order == 0 else 1.0
        by_omega = 1j * order - ratio * decay
        by_ratio = -omega * decay
        t, slope = transfer_at(by_omega * omega, model, r + 1 if order == 1 else r)
        h = 0.0 + 0.0j
        if order == 1:
            value = amplitude + 0.0j
            drive[:] = 0.0
            for j in range(r):
                amount = phasor(g, j, offset, order)
                value += t[output, j] * amount
                drive[local] += slope[output, j] * by_omega * amount
                drive[local] += t[output, j] * phasor(g_omega, j, offset, order)
                drive[local + 1] += slope[output, j] * by_ratio * amount
                for b in range(local):
                    drive[b] += t[output, j] * (dg[j, offset, b] - 1j * dg[j, offset + 1, b])
            h = value / t[output, r]
            drive /= t[output, r]
            drive[local] -= h * slope[output, r] * by_omega / t[output, r]
            drive[local + 1] -= h * slope[output, r] * by_ratio / t[output, r]
            residual[local] = h.real * weight
            residual[local + 1] = h.imag * weight
            for b in range(nz):
                jacobian[local, b] = drive[b].real * weight
                jacobian[local + 1, b] = drive[b].imag * weight
        for o in range(r):
            column[:] = 0.0
            if order == 1:
                for b in range(nz):
                    column[b] = t[o, r] * drive[b]
                column[local] += slope[o, r] * by_omega * h
                column[local + 1] += slope[o, r] * by_ratio * h
            for j in range(r):
                amount = phasor(g, j, offset, order)
                column[local] -= slope[o, j] * by_omega * amount
                column[local] -= t[o, j] * phasor(g_omega, j, offset, order)
                column[local + 1] -= slope[o, j] * by_ratio * amount
            add_force_slopes(column, t, o, dg, offset, order)
            set_residual(residual, z, o * size + offset, output_of(t, o, h, g, offset, order), order)
            set_jacobian(jacobian, o * size + offset, column, order)
    return residual, jacobian


@njit(cache=True)
def closure(z: FloatArray, amplitude: float, channel: int, rig: RigTables) -> tuple[complex, float]:
    """Given fundamental of a channel before its sensor, and what makes the drive that has to vanish dimensionless.

    Args:
        z: unknowns.
        amplitude: of the channel, as recorded.
    """
    model, channels = rig[0], rig[1]
    ratio, omega = z[z.size - 1], z[z.size - 2]
    true = amplitude / abs(sensor_gain(1j * omega, channels[channel])[0])
    # Change of 1/T per relative change of s, at the nearest pole.
    s = omega * (1j - ratio)
    r = model[4].shape[1] - 1
    t, slope = transfer_at(s * (1.0 + 1e-6), model, r + 1)
    return true + 0j, 1.0 / (abs(slope[r + channel, r] / t[r + channel, r] ** 2 * s) * true)


@njit(cache=True)
def newton_step(jacobian: FloatArray, residual: FloatArray, z: FloatArray, size: int) -> FloatArray:
    """Jacobian⁻¹ residual (nz,), in the scale of the unknowns; ``size`` are those of one coordinate."""
    scale = np.ones(z.size)
    for first in range(0, z.size - 2, size):
        largest = np.max(np.abs(z[first : first + size]))
        if largest > 0.0:
            scale[first : first + size] = largest
    rows = 1.0 / scale
    rows[-2:] = 1.0
    scale[-2] = z[-2]
    system = np.empty(jacobian.shape)
    for i in range(z.size):
        for j in range(z.size):
            system[i, j] = jacobian[i, j] * scale[j] * rows[i]
    return scale * np.linalg.solve(system, residual * rows)


@njit(cache=True)
def stepped_decays(z: FloatArray, amplitudes: FloatArray, channel: int, rig: RigTables) -> FloatArray:
    """Unknowns (levels, nz) after one Newton step from ``z``; other arguments as for :func:`closure`."""
    result = np.empty(z.shape)
    size = rig[3][1][-1] + 2
    output = rig[0][4].shape[1] - 1 + channel
    for level in range(z.shape[0]):
        own = z[level]
        true, weight = closure(own, amplitudes[level], channel, rig)
        residual, jacobian = evaluate_decay(own, true, weight, output, rig)
        result[level] = own - newton_step(jacobian, residual, own, size)
    return result


@njit(cache=True)
def observed_ratios(
    z: FloatArray, amplitudes: FloatArray, derivatives: float, channel: int, rig: RigTables
) -> FloatArray:
    """Damping ratios (levels,) with the change of frequency over amplitude, for the amplitudes of the channel itself.

    Args:
        z: unknowns (levels, nz).
        amplitudes: (levels,) of the channel.
        derivatives: order of the time derivative from a displacement to what the channel measures.
    """
    result = np.empty(z.shape[0])
    size = rig[3][1][-1] + 2
    output = rig[0][4].shape[1] - 1 + channel
    step = 1e-5
    for level in range(z.shape[0]):
        own = z[level]
        true, weight = closure(own, amplitudes[level], channel, rig)
        residual, jacobian = evaluate_decay(own, true, weight, output, rig)
        moved, _ = evaluate_decay(own, true * (1.0 + step), weight, output, rig)
        slope = -newton_step(jacobian, (moved - residual) / step, own, size)[-2] / own[-2]
        # From the channel's amplitude to that of the displacement.
        slope = slope / (1.0 - derivatives * slope)
        result[level] = own[-1] * (1.0 + derivatives * slope) / (1.0 + 0.5 * slope)
    return result


@njit(cache=True)
def decay_shapes(
    z: FloatArray, amplitudes: FloatArray, channel: int, places: np.ndarray, rig: RigTables
) -> ComplexArray:
    """Fundamentals of some channels over that of the first of them, with their sensors, (levels, places).

    A sensor that is late sees an earlier, larger motion: its chain counts at the complex frequency of the decay.

    Args:
        z: unknowns (levels, nz).
        amplitudes: (levels,) of the channel whose amplitude is given.
        channel: its number.
        places: numbers of the channels.
    """
    model, channels, factor, tables = rig
    orders, offsets = tables[0], tables[1]
    size = offsets[-1] + 2
    offset = offsets[0]
    for n in range(orders.size):
        if orders[n] == 1:
            offset = offsets[n]
    r = model[4].shape[1] - 1
    result = np.empty((z.shape[0], places.size), dtype=np.complex128)
    for level in range(z.shape[0]):
        own = z[level]
        omega, ratio = own[-2], own[-1]
        s = omega * (1j - ratio)
        g = local_amounts(own[: r * size].copy().reshape(r, size), omega, factor, tables)
        t, _ = transfer_at(s, model, r + 1)
        drive = amplitudes[level] / abs(sensor_gain(1j * omega, channels[channel])[0]) + 0j
        for j in range(r):
            drive += t[r + channel, j] * phasor(g, j, offset, 1)
        drive /= t[r + channel, r]
        for k in range(places.size):
            motion = output_of(t, r + places[k], drive, g, offset, 1)
            result[level, k] = motion * sensor_gain(s, channels[places[k]])[0]
        first = result[level, 0]
        for k in range(places.size):
            result[level, k] /= first
    return result
