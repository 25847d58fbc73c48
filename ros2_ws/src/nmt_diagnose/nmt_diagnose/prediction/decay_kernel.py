"""Compiled residual of a free decay: harmonic balance at complex frequency.

Within one period a slowly decaying motion is a copy of the one before times exp(−κ 2π): its orders move with
s_n = i n ω − κ ω. Unknowns are z = [w (r · size), ω, κ]; one channel has the given fundamental amplitude. A fictitious
drive holds that amplitude and has to vanish, which it does at the pole of the linear system and, with local forces, at
its continuation over amplitude.
"""

from __future__ import annotations

import numpy as np

from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_core.numerics.kernels import njit
from nmt_diagnose.prediction.linear_model import transfer_at
from nmt_diagnose.prediction.periodic_kernel import (
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
from nmt_rig.model.aft import LocalTables


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
    orders, offsets = tables.orders, tables.offsets
    count = orders.size
    r = model.inputs.shape[1] - 1
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
            set_residual(residual, z, o * size + offset, output_of(t, o, t[o, r] * h, g, offset, order), order)
            set_jacobian(jacobian, o * size + offset, column, order)
    return residual, jacobian


@njit(cache=True)
def closure(z: FloatArray, amplitude: float, channel: int, rig: RigTables) -> tuple[complex, float]:
    """Given fundamental of a channel before its sensor, and what makes the drive that has to vanish dimensionless.

    Args:
        z: unknowns.
        amplitude: of the channel, as recorded.
    """
    model, channels = rig.model, rig.channels
    ratio, omega = z[z.size - 1], z[z.size - 2]
    true = amplitude / abs(sensor_gain(1j * omega, channels[channel])[0])
    # Change of 1/T per relative change of s, at the nearest pole.
    s = omega * (1j - ratio)
    r = model.inputs.shape[1] - 1
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
    size = rig.local.offsets[-1] + 2
    output = rig.model.inputs.shape[1] - 1 + channel
    for level in range(z.shape[0]):
        unknowns = z[level]
        true, weight = closure(unknowns, amplitudes[level], channel, rig)
        residual, jacobian = evaluate_decay(unknowns, true, weight, output, rig)
        result[level] = unknowns - newton_step(jacobian, residual, unknowns, size)
    return result


@njit(cache=True)
def _drive(true: complex, output: int, t: ComplexArray, g: FloatArray, offset: int) -> complex:
    """The fictitious drive that holds an output; it vanishes, but not its response at a pole of the linear system."""
    h = true
    for j in range(t.shape[1] - 1):
        h += t[output, j] * phasor(g, j, offset, 1)
    return complex(h / t[output, t.shape[1] - 1])


@njit(cache=True)
def _pole_amounts(unknowns: FloatArray, true: complex, output: int, rig: RigTables) -> ComplexArray:
    """Fundamental of each pole of the linear model, (k,)."""
    model, _, factor, tables = rig
    poles, inputs = model.poles, model.inputs
    offset, size = _fundamental(tables), tables.offsets[-1] + 2
    r = inputs.shape[1] - 1
    omega = unknowns[-2]
    s = omega * (1j - unknowns[-1])
    g = local_amounts(unknowns[: r * size].copy().reshape(r, size), omega, factor, tables)
    t, _ = transfer_at(s, model, r + 1)
    h = _drive(true, output, t, g, offset)
    result = np.empty(poles.size, dtype=np.complex128)
    for k in range(poles.size):
        total = inputs[k, r] * h
        for j in range(r):
            total -= inputs[k, j] * phasor(g, j, offset, 1)
        result[k] = total / (s - poles[k])
    return result


@njit(cache=True)
def _fundamental(tables: LocalTables) -> int:
    """Where the fundamental is among the coefficients of one coordinate."""
    orders, offsets = tables.orders, tables.offsets
    for n in range(orders.size):
        if orders[n] == 1:
            return int(offsets[n])
    return int(offsets[0])


@njit(cache=True)
def observed_ratios(z: FloatArray, amplitudes: FloatArray, channel: int, rig: RigTables) -> FloatArray:
    """Damping ratios (levels,) as the amplitude of the channel itself decays.

    Solutions take all amplitudes to decay alike. But the shape and the frequency of a nonlinear mode change with the
    amplitude A as it decays: each pole of the linear model has y' = λ y + b f with an amplitude y(A) of its own, so
    that (s − λ) y = b f + α (dy/d ln A − y) for A' = −α A; outputs that are time derivatives change alike. That moves
    all outputs by α D, and κ with them. With one degree of freedom it is 2 ω A' + ω' A = −2 α₀ ω A, the slow form of
    its equation of motion.

    Args:
        z: unknowns (levels, nz).
        amplitudes: (levels,) of the channel.
    """
    result = np.empty(z.shape[0])
    model, tables = rig.model, rig.local
    poles, displacement, velocity, acceleration = model.poles, model.displacement, model.velocity, model.acceleration
    offset, size = _fundamental(tables), tables.offsets[-1] + 2
    r = model.inputs.shape[1] - 1
    output = r + channel
    step = 1e-3
    for level in range(z.shape[0]):
        unknowns = z[level]
        omega = unknowns[-2]
        s = omega * (1j - unknowns[-1])
        true, weight = closure(unknowns, amplitudes[level], channel, rig)
        residual, jacobian = evaluate_decay(unknowns, true, weight, output, rig)
        moved, _ = evaluate_decay(unknowns, true * (1.0 + 1e-5), weight, output, rig)
        along = newton_step(jacobian, (residual - moved) / 1e-5, unknowns, size)
        amounts = _pole_amounts(unknowns, true, output, rig)
        later = _pole_amounts(unknowns + step * along, true * (1.0 + step), output, rig)
        t, _ = transfer_at(s, model, r + 1)
        shift = np.zeros(r + 1, dtype=np.complex128)
        for o in range(r + 1):
            row = o if o < r else output
            for k in range(poles.size):
                out = displacement[row, k] + s * (velocity[row, k] + s * acceleration[row, k])
                by_s = velocity[row, k] + 2.0 * s * acceleration[row, k]
                change_of_shape = (later[k] - amounts[k]) / step - amounts[k]
                shift[o] += (out / (s - poles[k]) - by_s) * change_of_shape
                shift[o] -= 1j * acceleration[row, k] * along[-2] * amounts[k]
        change = np.zeros(unknowns.size)
        held = -shift[r] / t[output, r]
        change[r * size], change[r * size + 1] = held.real * weight, held.imag * weight
        for o in range(r):
            value = shift[o] + t[o, r] * held
            change[o * size + offset], change[o * size + offset + 1] = -value.real, value.imag
        result[level] = unknowns[-1] / (1.0 + omega * newton_step(jacobian, change, unknowns, size)[-1])
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
    offset, size = _fundamental(tables), tables.offsets[-1] + 2
    r = model.inputs.shape[1] - 1
    result = np.empty((z.shape[0], places.size), dtype=np.complex128)
    for level in range(z.shape[0]):
        unknowns = z[level]
        omega, ratio = unknowns[-2], unknowns[-1]
        s = omega * (1j - ratio)
        g = local_amounts(unknowns[: r * size].copy().reshape(r, size), omega, factor, tables)
        t, _ = transfer_at(s, model, r + 1)
        true = amplitudes[level] / abs(sensor_gain(1j * omega, channels[channel])[0]) + 0j
        drive = _drive(true, r + channel, t, g, offset)
        for k in range(places.size):
            row = r + places[k]
            motion = output_of(t, row, t[row, r] * drive, g, offset, 1)
            result[level, k] = motion * sensor_gain(s, channels[places[k]])[0]
        first = result[level, 0]
        for k in range(places.size):
            result[level, k] /= first
    return result
