"""Compiled harmonic balance at given frequencies: forced steady states, line by line.

Unknowns of a line are z = [w (r · size), Re a, Im a]: real Fourier coefficients of the local coordinates and the
complex amplitude of the drive. For every order n

    w_n + T_n^{wg} g_n(w) − T_n^{wu} u_n = 0,   u_1 = a,

closed by one complex amplitude that is given: that of the drive, or the fundamental of a channel. With a response given
the equation is as mild as the linear one: no folds, because a curve of force over response has none.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_core.numerics.kernels import njit
from nmt_diagnose.prediction.linear_model import LinearTables, response_at
from nmt_diagnose.prediction.periodic_kernel import (
    RigTables,
    add_force_slopes,
    any_nonlinear,
    harmonic_forces,
    local_amounts,
    output_of,
    sensor_gain,
    set_jacobian,
    set_residual,
)
from nmt_rig.model.aft import LocalTables


class SolvedLine(NamedTuple):
    """Where Newton's iteration of one line ended.

    Attributes:
        converged: whether it is a solution.
        z: unknowns (nz,).
        forces: of the coordinates (r, size).
        inverse: of the Jacobian (nz, nz).
        channels, slopes: their fundamentals (c,) and the derivatives by the unknowns (c, nz).
    """

    converged: bool
    z: FloatArray
    forces: FloatArray
    inverse: FloatArray
    channels: ComplexArray
    slopes: ComplexArray


_HALVINGS = 8
_CLIMB_STEPS = 40
_LOWEST = 0.02


@njit(cache=True)
def transfers(omega: float, orders: np.ndarray, wanted: np.ndarray, model: LinearTables) -> ComplexArray:
    """T at i n ω for every order n that is wanted, (n_orders, outputs, r + 1), zeros for others.

    All of order 1, of others what local forces do.
    """
    outputs, columns = model.feedthrough.shape
    result = np.zeros((orders.size, outputs, columns), dtype=np.complex128)
    r = columns - 1
    for n in range(orders.size):
        if not wanted[n]:
            continue
        s = 1j * orders[n] * omega
        if orders[n] == 1:
            result[n] = response_at(s, model, outputs, columns)
        else:
            result[n, :r] = response_at(s, model, r, r)
    return result


@njit(cache=True)
def driven_orders(g: FloatArray, orders: np.ndarray, offsets: np.ndarray) -> np.ndarray:
    """Orders (n_orders,) that the drive or local forces g (r, size) act at: at others nothing responds."""
    result: np.ndarray = orders == 1
    for n in range(orders.size):
        for j in range(g.shape[0]):
            if g[j, offsets[n]] != 0.0 or (orders[n] > 0 and g[j, offsets[n] + 1] != 0.0):
                result[n] = True
    return result


@njit(cache=True)
def forced_orders(orders: np.ndarray, factor: FloatArray, tables: LocalTables) -> np.ndarray:
    """Orders (n_orders,) that may move: the first alone where no force is nonlinear."""
    result: np.ndarray = (orders == 1) | any_nonlinear(factor, tables)
    return result


@njit(cache=True)
def balance(
    z: FloatArray,
    g: FloatArray,
    held_channel: int,
    target: complex,
    omega: float,
    transfer: ComplexArray,
    orders: np.ndarray,
    offsets: np.ndarray,
    channels: FloatArray,
) -> tuple[FloatArray, ComplexArray]:
    """Residual (nz,) and fundamentals of the channels (c,) for known local forces g (r, size)."""
    r = transfer.shape[2] - 1
    c = channels.shape[0]
    size = offsets[orders.size - 1] + 2
    local = r * size
    a = z[local] + 1j * z[local + 1]
    residual = np.zeros(local + 2)
    measured = np.zeros(c, dtype=np.complex128)
    for n in range(orders.size):
        first = orders[n] == 1
        for o in range(r + c if first else r):
            value = output_of(transfer[n], o, transfer[n, o, r] * a if first else 0j, g, offsets[n], orders[n])
            if o < r:
                set_residual(residual, z, o * size + offsets[n], value, orders[n])
            else:
                measured[o - r] = sensor_gain(1j * omega, channels[o - r])[0] * value
    closure = a - target if held_channel < 0 else measured[held_channel] - target
    residual[local] = closure.real
    residual[local + 1] = closure.imag
    return residual, measured


@njit(cache=True)
def balance_slopes(
    dg: FloatArray,
    held_channel: int,
    omega: float,
    transfer: ComplexArray,
    orders: np.ndarray,
    offsets: np.ndarray,
    channels: FloatArray,
) -> tuple[FloatArray, ComplexArray]:
    """Jacobian (nz, nz) of :func:`balance`, and the derivatives of the channels (c, nz)."""
    r = transfer.shape[2] - 1
    c = channels.shape[0]
    size = offsets[orders.size - 1] + 2
    local = r * size
    nz = local + 2
    jacobian = np.zeros((nz, nz))
    slopes = np.zeros((c, nz), dtype=np.complex128)
    column = np.zeros(nz, dtype=np.complex128)
    for n in range(orders.size):
        first = orders[n] == 1
        for o in range(r + c if first else r):
            column[:] = 0.0
            if first:
                column[local] = transfer[n, o, r]
                column[local + 1] = 1j * transfer[n, o, r]
            add_force_slopes(column, transfer[n], o, dg, offsets[n], orders[n])
            if o < r:
                set_jacobian(jacobian, o * size + offsets[n], column, orders[n])
            else:
                slopes[o - r] = sensor_gain(1j * omega, channels[o - r])[0] * column
    if held_channel < 0:
        jacobian[local, local] = 1.0
        jacobian[local + 1, local + 1] = 1.0
    else:
        jacobian[local] = slopes[held_channel].real
        jacobian[local + 1] = slopes[held_channel].imag
    return jacobian, slopes


@njit(cache=True)
def linear_start(
    held_channel: int,
    target: complex,
    omega: float,
    stiffness: FloatArray,
    damping: FloatArray,
    transfer: ComplexArray,
    orders: np.ndarray,
    offsets: np.ndarray,
    channels: FloatArray,
) -> FloatArray:
    """Unknowns (nz,) of the system linearised at rest: local forces k w + d ẇ."""
    r = transfer.shape[2] - 1
    size = offsets[orders.size - 1] + 2
    one = 0
    for n in range(orders.size):
        if orders[n] == 1:
            one = n
    closed = np.zeros((r, r), dtype=np.complex128)
    tangent = np.empty(r, dtype=np.complex128)
    for j in range(r):
        tangent[j] = stiffness[j] + 1j * omega * damping[j]
    for i in range(r):
        for j in range(r):
            closed[i, j] = transfer[one, i, j] * tangent[j]
        closed[i, i] += 1.0
    w = np.linalg.solve(closed, transfer[one, :r, r].copy())
    a = target
    if held_channel >= 0:
        value = transfer[one, r + held_channel, r]
        for j in range(r):
            value -= transfer[one, r + held_channel, j] * tangent[j] * w[j]
        a = target / (sensor_gain(1j * omega, channels[held_channel])[0] * value)
    z = np.zeros(r * size + 2)
    for i in range(r):
        z[i * size + offsets[one]] = (w[i] * a).real
        z[i * size + offsets[one] + 1] = -(w[i] * a).imag
    z[r * size] = a.real
    z[r * size + 1] = a.imag
    return z


@njit(cache=True)
def _scales(z: FloatArray, target: complex, held_channel: int, r: int, size: int) -> tuple[FloatArray, FloatArray]:
    """Size of the unknowns, and one over that of the residuals."""
    scale = np.ones(z.size)
    for i in range(r):
        largest = 0.0
        for b in range(size):
            largest = max(largest, abs(z[i * size + b]))
        scale[i * size : (i + 1) * size] = largest if largest > 0.0 else 1.0
    drive = np.hypot(z[r * size], z[r * size + 1])
    scale[r * size :] = drive if drive > 0.0 else 1.0
    weights = 1.0 / scale
    weights[r * size :] = 1.0 / max(abs(target), 1e-300)
    return scale, weights


@njit(cache=True)
def newton_line(
    z: FloatArray,
    held_channel: int,
    target: complex,
    omega: float,
    transfer: ComplexArray,
    channels: FloatArray,
    factor: FloatArray,
    tables: LocalTables,
    iterations: int,
    tolerance: float,
) -> SolvedLine:
    """Damped Newton iteration of one line."""
    orders, offsets = tables.orders, tables.offsets
    r = transfer.shape[2] - 1
    size = offsets[orders.size - 1] + 2
    z = z.copy()
    nz = z.size
    scale, weights = _scales(z, target, held_channel, r, size)
    g, dg, _ = harmonic_forces(z[: r * size].copy().reshape(r, size), omega, factor, tables)
    residual, measured = balance(z, g, held_channel, target, omega, transfer, orders, offsets, channels)
    error = np.linalg.norm(residual * weights)
    inverse = np.zeros((nz, nz))
    slopes = np.zeros((channels.shape[0], nz), dtype=np.complex128)
    converged, done = False, False
    for _ in range(iterations):
        if not np.isfinite(error):
            break
        jacobian, slopes = balance_slopes(dg, held_channel, omega, transfer, orders, offsets, channels)
        for i in range(nz):
            for j in range(nz):
                jacobian[i, j] *= weights[i] * scale[j]
        inverse = np.linalg.inv(jacobian)
        for i in range(nz):
            for j in range(nz):
                inverse[i, j] *= scale[i] * weights[j]
        if converged:
            done = True
            break
        step = -inverse @ residual
        length = np.linalg.norm(step / scale)
        fraction = 1.0
        for _ in range(_HALVINGS):
            trial = z + fraction * step
            g, dg, _ = harmonic_forces(trial[: r * size].copy().reshape(r, size), omega, factor, tables)
            residual, measured = balance(trial, g, held_channel, target, omega, transfer, orders, offsets, channels)
            after = np.linalg.norm(residual * weights)
            if after < error * (1.0 - 0.1 * fraction) or after < 1e-10 or length < tolerance:
                break
            fraction *= 0.5
        # Where no shorter step is better, the shortest is taken all the same: it may cross a kink.
        z, error = trial, after
        converged = bool(fraction == 1.0 and (length < tolerance or error < 1e-11))
    return SolvedLine(done, z, g, inverse, measured, slopes)


@njit(cache=True)
def climb_line(
    held_channel: int,
    target: complex,
    omega: float,
    stiffness: FloatArray,
    damping: FloatArray,
    transfer: ComplexArray,
    channels: FloatArray,
    factor: FloatArray,
    tables: LocalTables,
    iterations: int,
    tolerance: float,
) -> SolvedLine:
    """Solve one line up from a small amplitude, in steps that shrink where they fail."""
    orders, offsets = tables.orders, tables.offsets
    share, reached, ratio = _LOWEST, 0.0, 4.0
    guess = linear_start(held_channel, share * target, omega, stiffness, damping, transfer, orders, offsets, channels)
    for _ in range(_CLIMB_STEPS):
        trial = newton_line(
            guess, held_channel, share * target, omega, transfer, channels, factor, tables, iterations, tolerance
        )
        if trial.converged or reached == 0.0:
            found = trial
        if trial.converged:
            reached = share
        elif reached == 0.0:
            break
        else:
            ratio = ratio**0.5
        if reached == 1.0:
            break
        share = min(1.0, reached * ratio)
        guess = found.z * (share / reached)
    return SolvedLine(reached == 1.0, found.z, found.forces, found.inverse, found.channels, found.slopes)


@njit(cache=True)
def solve_lines(
    start: FloatArray,
    known: np.ndarray,
    held_channel: int,
    target: ComplexArray,
    omega: FloatArray,
    stiffness: FloatArray,
    damping: FloatArray,
    rig: RigTables,
    iterations: int,
    tolerance: float,
) -> tuple[np.ndarray, FloatArray, FloatArray, FloatArray, ComplexArray, ComplexArray]:
    """Solve every line for itself, from its start or from the system linearised at rest.

    Args:
        start: (lines, nz) unknowns to start from.
        known: (lines,) whether a line has a start.
        held_channel: row of the channel whose fundamental is given; −1 = the amplitude of the drive is.
        target: (lines,) given complex amplitudes.
        omega: (lines,) true angular frequencies, rad/s.
        stiffness, damping: (r,) tangents of the local forces at rest.
        iterations, tolerance: of Newton's method.

    Returns:
        converged (lines,), z (lines, nz), local forces (lines, r, size), inverse Jacobians (lines, nz, nz), channels
        (lines, c) and their slopes (lines, c, nz).
    """
    model, channels, factor, tables = rig
    orders, offsets = tables.orders, tables.offsets
    lines, nz = start.shape
    c = channels.shape[0]
    r = model.inputs.shape[1] - 1
    size = offsets[orders.size - 1] + 2
    good = np.zeros(lines, dtype=np.bool_)
    solved = np.full((lines, nz), np.nan)
    forces = np.zeros((lines, r, size))
    inverses = np.zeros((lines, nz, nz))
    values = np.full((lines, c), np.nan + 0j)
    slopes = np.zeros((lines, c, nz), dtype=np.complex128)
    wanted = forced_orders(orders, factor, tables)
    for line in range(lines):
        w = omega[line]
        transfer = transfers(w, orders, wanted, model)
        done = False
        if known[line]:
            done, z, g, inverse, y, slope = newton_line(
                start[line], held_channel, target[line], w, transfer, channels, factor, tables, iterations, tolerance
            )
        if not done:
            z = linear_start(held_channel, target[line], w, stiffness, damping, transfer, orders, offsets, channels)
            done, z, g, inverse, y, slope = newton_line(
                z, held_channel, target[line], w, transfer, channels, factor, tables, iterations, tolerance
            )
        if not done:
            done, z, g, inverse, y, slope = climb_line(
                held_channel,
                target[line],
                w,
                stiffness,
                damping,
                transfer,
                channels,
                factor,
                tables,
                iterations,
                tolerance,
            )
        if done:
            good[line] = True
            solved[line] = z
            forces[line] = g
            inverses[line] = inverse
            values[line] = y
            slopes[line] = slope
    return good, solved, forces, inverses, values, slopes


@njit(cache=True)
def step_lines(
    z: FloatArray,
    forces: FloatArray,
    shared_positions: np.ndarray,
    kept: np.ndarray,
    fresh: np.ndarray,
    inverses: FloatArray,
    slopes: ComplexArray,
    held_channel: int,
    target: ComplexArray,
    omega: FloatArray,
    rig: RigTables,
) -> tuple[FloatArray, ComplexArray]:
    """One Newton step to the solutions of a slightly different rig with the Jacobians of the solved one.

    By the implicit function theorem the change is right to first order. Coordinates that the solved rig lacks have
    forces of the order of the change: to first order they move as the others make them, and what their forces do is in
    the residuals of the others.

    Args:
        z, inverses, slopes: solution of the neighbouring rig, as :func:`solve_lines` gives it.
        forces: (lines, r, size) its local forces where elements and frequencies are the same; without lines otherwise.
        shared_positions, kept: positions of the unknowns that both have, in those of this rig and of the solved one.
        fresh: positions of the others in those of this rig.

    Returns:
        z (lines, nz) and channels (lines, c).
    """
    model, channels, factor, tables = rig
    orders, offsets = tables.orders, tables.offsets
    lines = z.shape[0]
    c = channels.shape[0]
    r = model.inputs.shape[1] - 1
    size = offsets[orders.size - 1] + 2
    moved = np.full((lines, r * size + 2), np.nan)
    values = np.full((lines, c), np.nan + 0j)
    for line in range(lines):
        if not np.isfinite(z[line, 0]):
            continue
        w = omega[line]
        here = np.zeros(r * size + 2)
        for k in range(shared_positions.size):
            here[shared_positions[k]] = z[line, kept[k]]
        if forces.shape[0] > 0:
            g = forces[line]
        else:
            g = local_amounts(here[: r * size].copy().reshape(r, size), w, factor, tables)
        wanted = driven_orders(g, orders, offsets)
        transfer = transfers(w, orders, wanted, model)
        residual, y = balance(here, g, held_channel, target[line], w, transfer, orders, offsets, channels)
        if fresh.size > 0:
            for k in fresh:
                here[k] = -residual[k]
            g = local_amounts(here[: r * size].copy().reshape(r, size), w, factor, tables)
            more = driven_orders(g, orders, offsets)
            if np.any(more & ~wanted):
                transfer = transfers(w, orders, more, model)
            residual, y = balance(here, g, held_channel, target[line], w, transfer, orders, offsets, channels)
        known = np.zeros(z.shape[1])
        for k in range(shared_positions.size):
            known[kept[k]] = residual[shared_positions[k]]
        step = -inverses[line] @ known
        for k in range(shared_positions.size):
            here[shared_positions[k]] += step[kept[k]]
        for k in range(c):
            for b in range(step.size):
                y[k] += slopes[line, k, b] * step[b]
        moved[line] = here
        values[line] = y
    return moved, values
