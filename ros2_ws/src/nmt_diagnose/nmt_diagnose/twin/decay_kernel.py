"""Compiled residual of a free decay: harmonic balance at complex frequency.

Within one period a slowly decaying motion is a copy of the one before times exp(−κ 2π): its orders move with
s_n = i n ω − κ ω. Unknowns are z = [w (r · size), ω, κ]; one channel has the given fundamental amplitude. A fictitious
drive holds that amplitude and has to vanish, which it does at the pole of the linear system and, with local forces, at
its continuation over amplitude.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from nmt_core.blocks import FloatArray
from nmt_diagnose.twin.linear_model import ComplexArray, transfer_at
from nmt_diagnose.twin.periodic_kernel import harmonic_forces
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
