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
from nmt_diagnose.twin.periodic_kernel import harmonic_forces, local_amounts, sensor_gain
from nmt_rig.model.aft import LocalTables


@njit(cache=True)
def evaluate_decay(
    z: FloatArray,
    amplitude: complex,
    weight: float,
    output: int,
    poles: ComplexArray,
    displacement_rows: ComplexArray,
    velocity_rows: ComplexArray,
    acceleration_rows: ComplexArray,
    inputs: ComplexArray,
    feedthrough: ComplexArray,
    factor: FloatArray,
    tables: LocalTables,
) -> tuple[FloatArray, FloatArray]:
    """Residual (nz,) and Jacobian (nz, nz).

    Args:
        z: unknowns.
        amplitude: given fundamental of an output, before its sensor.
        weight: makes the drive that has to vanish dimensionless.
        output: row of that output in the linear model.
        factor: G, G b₁, G b₂.
    """
    orders, offsets = tables[0], tables[1]
    count = orders.size
    r = inputs.shape[1] - 1
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
        s = by_omega * omega
        t, slope = transfer_at(
            s, poles, displacement_rows, velocity_rows, acceleration_rows, inputs, feedthrough,
            r + 1 if order == 1 else r,
        )  # fmt: skip
        h = 0.0 + 0.0j
        if order == 1:
            value = amplitude + 0.0j
            drive[:] = 0.0
            for j in range(r):
                amount = g[j, offset] - 1j * g[j, offset + 1]
                value += t[output, j] * amount
                drive[local] += slope[output, j] * by_omega * amount
                drive[local] += t[output, j] * (g_omega[j, offset] - 1j * g_omega[j, offset + 1])
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
            value = 0.0 + 0.0j
            if order == 1:
                value = t[o, r] * h
                for b in range(nz):
                    column[b] = t[o, r] * drive[b]
                column[local] += slope[o, r] * by_omega * h
                column[local + 1] += slope[o, r] * by_ratio * h
            for j in range(r):
                if order == 0:
                    value -= t[o, j] * g[j, offset]
                    column[local] -= t[o, j] * g_omega[j, offset]
                    for b in range(local):
                        column[b] -= t[o, j] * dg[j, offset, b]
                    continue
                amount = g[j, offset] - 1j * g[j, offset + 1]
                value -= t[o, j] * amount
                column[local] -= slope[o, j] * by_omega * amount
                column[local] -= t[o, j] * (g_omega[j, offset] - 1j * g_omega[j, offset + 1])
                column[local + 1] -= slope[o, j] * by_ratio * amount
                for b in range(local):
                    column[b] -= t[o, j] * (dg[j, offset, b] - 1j * dg[j, offset + 1, b])
            row = o * size + offset
            residual[row] = z[row] - value.real
            for b in range(nz):
                jacobian[row, b] = -column[b].real
            jacobian[row, row] += 1.0
            if order > 0:
                residual[row + 1] = z[row + 1] + value.imag
                for b in range(nz):
                    jacobian[row + 1, b] = column[b].imag
                jacobian[row + 1, row + 1] += 1.0
    return residual, jacobian


@njit(cache=True)
def closure(
    z: FloatArray,
    amplitude: float,
    output: int,
    chain: FloatArray,
    poles: ComplexArray,
    displacement_rows: ComplexArray,
    velocity_rows: ComplexArray,
    acceleration_rows: ComplexArray,
    inputs: ComplexArray,
    feedthrough: ComplexArray,
) -> tuple[complex, float]:
    """Given fundamental of an output before its sensor, and what makes the drive that has to vanish dimensionless.

    Args:
        z: unknowns.
        amplitude: of the recorded channel.
        output: row of that output in the linear model.
        chain: its sensor, (4,).
    """
    ratio, omega = z[z.size - 1], z[z.size - 2]
    true = amplitude / abs(sensor_gain(1j * omega, chain[0], chain[1], chain[2], chain[3])[0])
    # Change of 1/T per relative change of s, at the nearest pole.
    s = omega * (1j - ratio)
    r = inputs.shape[1] - 1
    t, slope = transfer_at(
        s * (1.0 + 1e-6), poles, displacement_rows, velocity_rows, acceleration_rows, inputs, feedthrough, r + 1
    )
    return true + 0j, 1.0 / (abs(slope[output, r] / t[output, r] ** 2 * s) * true)


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
def stepped_decays(
    z: FloatArray,
    amplitudes: FloatArray,
    output: int,
    chain: FloatArray,
    poles: ComplexArray,
    displacement_rows: ComplexArray,
    velocity_rows: ComplexArray,
    acceleration_rows: ComplexArray,
    inputs: ComplexArray,
    feedthrough: ComplexArray,
    factor: FloatArray,
    tables: LocalTables,
) -> FloatArray:
    """Unknowns (levels, nz) after one Newton step from ``z``; other arguments as for :func:`closure`."""
    result = np.empty(z.shape)
    size = tables[1][-1] + 2
    for level in range(z.shape[0]):
        own = z[level]
        true, weight = closure(
            own, amplitudes[level], output, chain, poles, displacement_rows, velocity_rows, acceleration_rows, inputs,
            feedthrough,
        )  # fmt: skip
        residual, jacobian = evaluate_decay(
            own, true, weight, output, poles, displacement_rows, velocity_rows, acceleration_rows, inputs, feedthrough,
            factor, tables,
        )  # fmt: skip
        result[level] = own - newton_step(jacobian, residual, own, size)
    return result


@njit(cache=True)
def observed_ratios(
    z: FloatArray,
    amplitudes: FloatArray,
    derivatives: float,
    output: int,
    chain: FloatArray,
    poles: ComplexArray,
    displacement_rows: ComplexArray,
    velocity_rows: ComplexArray,
    acceleration_rows: ComplexArray,
    inputs: ComplexArray,
    feedthrough: ComplexArray,
    factor: FloatArray,
    tables: LocalTables,
) -> FloatArray:
    """Damping ratios (levels,) with the change of frequency over amplitude, for the amplitudes of the channel itself.

    Args:
        z: unknowns (levels, nz).
        amplitudes: (levels,) of the channel.
        derivatives: order of the time derivative from a displacement to what the channel measures.
    """
    result = np.empty(z.shape[0])
    size = tables[1][-1] + 2
    step = 1e-5
    for level in range(z.shape[0]):
        own = z[level]
        true, weight = closure(
            own, amplitudes[level], output, chain, poles, displacement_rows, velocity_rows, acceleration_rows, inputs,
            feedthrough,
        )  # fmt: skip
        residual, jacobian = evaluate_decay(
            own, true, weight, output, poles, displacement_rows, velocity_rows, acceleration_rows, inputs, feedthrough,
            factor, tables,
        )  # fmt: skip
        moved, _ = evaluate_decay(
            own, true * (1.0 + step), weight, output, poles, displacement_rows, velocity_rows, acceleration_rows,
            inputs, feedthrough, factor, tables,
        )  # fmt: skip
        slope = -newton_step(jacobian, (moved - residual) / step, own, size)[-2] / own[-2]
        # From the channel's amplitude to that of the displacement.
        slope = slope / (1.0 - derivatives * slope)
        result[level] = own[-1] * (1.0 + derivatives * slope) / (1.0 + 0.5 * slope)
    return result


@njit(cache=True)
def decay_shapes(
    z: FloatArray,
    amplitudes: FloatArray,
    output: int,
    chain: FloatArray,
    places: np.ndarray,
    chains: FloatArray,
    poles: ComplexArray,
    displacement_rows: ComplexArray,
    velocity_rows: ComplexArray,
    acceleration_rows: ComplexArray,
    inputs: ComplexArray,
    feedthrough: ComplexArray,
    factor: FloatArray,
    tables: LocalTables,
) -> ComplexArray:
    """Fundamentals of some outputs over that of the first of them, with their sensors, (levels, outputs).

    A sensor that is late sees an earlier, larger motion: its chain counts at the complex frequency of the decay.

    Args:
        z: unknowns (levels, nz).
        amplitudes: (levels,) of the channel whose amplitude is given.
        output, chain: its row in the linear model, and its sensor (4,).
        places: rows of the outputs in the linear model.
        chains: their sensors, (outputs, 4).
    """
    orders, offsets = tables[0], tables[1]
    size = offsets[-1] + 2
    offset = offsets[0]
    for n in range(orders.size):
        if orders[n] == 1:
            offset = offsets[n]
    r = inputs.shape[1] - 1
    result = np.empty((z.shape[0], places.size), dtype=np.complex128)
    for level in range(z.shape[0]):
        own = z[level]
        omega, ratio = own[-2], own[-1]
        g = local_amounts(own[: r * size].copy().reshape(r, size), omega, factor, tables)
        t, _ = transfer_at(
            omega * (1j - ratio), poles, displacement_rows, velocity_rows, acceleration_rows, inputs, feedthrough, r + 1
        )
        gain = sensor_gain(1j * omega, chain[0], chain[1], chain[2], chain[3])[0]
        drive = amplitudes[level] / abs(gain) + 0j
        for j in range(r):
            drive += t[output, j] * (g[j, offset] - 1j * g[j, offset + 1])
        drive /= t[output, r]
        for k in range(places.size):
            motion = t[places[k], r] * drive
            for j in range(r):
                motion -= t[places[k], j] * (g[j, offset] - 1j * g[j, offset + 1])
            gain = sensor_gain(omega * (1j - ratio), chains[k, 0], chains[k, 1], chains[k, 2], chains[k, 3])[0]
            result[level, k] = motion * gain
        first = result[level, 0]
        for k in range(places.size):
            result[level, k] /= first
    return result
