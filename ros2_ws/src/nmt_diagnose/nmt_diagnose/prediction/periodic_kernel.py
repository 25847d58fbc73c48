"""Compiled residual of the phase-resonant harmonic balance, with its Jacobian, and the channels it predicts.

Unknowns are z = [w (r · size), ω, ln a]: real Fourier coefficients of the local coordinates, frequency, and the
amplitude of the drive. For every order n

    w_n + T_n^{wg} g_n(w) − T_n^{wu} u_n = 0,

closed by the phase between measured force and response at lock and by one amplitude that is given.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_core.numerics.kernels import njit
from nmt_diagnose.prediction.linear_model import LinearTables, response_at, transfer_at
from nmt_rig.model.aft import LocalTables, forces_alone, local_forces

# Columns of the table of sensor chains, see `rig_parts.channel_table`.
GAIN, DELAY, LOW_PASS, HIGH_PASS = 0, 1, 2, 3
# Places of G b₁ and G b₂ in the force factor.
FACTOR_LINEAR, FACTOR_QUADRATIC = 1, 2
# Position of the fundamental: the first order is 0.
FUNDAMENTAL = 1
# What is given besides the phase: ln of the drive's amplitude, or ln of the fundamental of one channel.
DRIVE_HELD = -1


class RigTables(NamedTuple):
    """What the kernels know of a rig, see `RigParts.kernel_tables`.

    Attributes:
        model: the linear part.
        channels: sensor chains of the channels (c, 4).
        factor: G, G b₁, G b₂.
        local: the local elements and their basis.
    """

    model: LinearTables
    channels: FloatArray
    factor: FloatArray
    local: LocalTables


class Control(NamedTuple):
    """What a level holds.

    Attributes:
        held_channel: ``DRIVE_HELD``, or the channel whose fundamental has the given amplitude.
        force, response: channels whose phase was controlled.
        power: order of time derivative from that response to a velocity (1, 0, −1).
    """

    held_channel: int
    force: int
    response: int
    power: int


@njit(cache=True)
def sensor_gain(s: complex, chain: FloatArray) -> tuple[complex, complex]:
    """Complex gain of a sensor's chain (4,) at s = iω, and its derivative with respect to s."""
    gain, delay, low_pass, high_pass = chain[GAIN], chain[DELAY], chain[LOW_PASS], chain[HIGH_PASS]
    low = 1.0 / (1.0 + s * low_pass)
    value = gain * np.exp(-s * delay) * low
    slope = value * (-delay - low_pass * low)
    if high_pass > 0.0:
        high = s / (s + high_pass)
        slope = slope * high + value * high_pass / (s + high_pass) ** 2
        value = value * high
    return value, slope


@njit(cache=True)
def channel_gains(s: complex, channels: FloatArray) -> ComplexArray:
    """Complex gains (c,) of the sensors' chains (c, 4) at s."""
    result = np.empty(channels.shape[0], dtype=np.complex128)
    for k in range(channels.shape[0]):
        result[k] = sensor_gain(s, channels[k])[0]
    return result


@njit(cache=True)
def factor_forces(
    coil: FloatArray,
    current: FloatArray,
    omega: float,
    factor: FloatArray,
    values: FloatArray,
    slopes: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Forces of the position-dependent part of the force factor, G(x) − G = G b₁ x + G b₂ x².

    Returns:
        coefficients of −(G(x) − G) i on the coil and of (G(x) − G) ẋ in the circuit (2, size), their derivatives with
        respect to coil displacement and current (2, size, 2 · size), and to ω (2, size).
    """
    linear, quadratic = factor[FACTOR_LINEAR], factor[FACTOR_QUADRATIC]
    size = coil.size
    samples = values.shape[0]
    force = np.zeros((2, size))
    derivative = np.zeros((2, size, 2 * size))
    by_frequency = np.zeros((2, size))
    for j in range(samples):
        x = 0.0
        i = 0.0
        dx = 0.0
        for a in range(size):
            x += values[j, a] * coil[a]
            i += values[j, a] * current[a]
            dx += slopes[j, a] * coil[a]
        change = linear * x + quadratic * x * x
        change_slope = linear + 2.0 * quadratic * x
        for a in range(size):
            weight = (2.0 if a > 0 else 1.0) * values[j, a] / samples
            force[0, a] -= weight * change * i
            force[1, a] += weight * change * omega * dx
            by_frequency[1, a] += weight * change * dx
            for b in range(size):
                derivative[0, a, b] -= weight * change_slope * i * values[j, b]
                derivative[0, a, size + b] -= weight * change * values[j, b]
                derivative[1, a, b] += weight * omega * (change_slope * dx * values[j, b] + change * slopes[j, b])
    return force, derivative, by_frequency


@njit(cache=True)
def harmonic_forces(
    displacement: FloatArray, omega: float, factor: FloatArray, tables: LocalTables
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Forces of all local coordinates: local elements first, then the nonlinear force factor if there is one.

    Args:
        displacement: (r, size) real Fourier coefficients of the coordinates.
        omega: rad/s.
        factor: G, G b₁, G b₂.
        tables: the local elements and their basis.

    Returns:
        Coefficients (r, size), and their derivatives by all coefficients (r, size, r · size) and by ω (r, size).
    """
    r, size = displacement.shape
    elements = tables.jenkins_start.size - 1
    g = np.zeros((r, size))
    dg = np.zeros((r, size, r * size))
    g_omega = np.zeros((r, size))
    force, derivative, by_frequency = local_forces(displacement[:elements], omega, tables)
    for i in range(elements):
        g[i] = force[i]
        g_omega[i] = by_frequency[i]
        for a in range(size):
            for b in range(size):
                dg[i, a, i * size + b] = derivative[i, a, b]
    if r > elements:
        pair, pair_derivative, pair_frequency = factor_forces(
            displacement[r - 2], displacement[r - 1], omega, factor, tables.values, tables.slopes
        )
        for i in range(2):
            g[r - 2 + i] = pair[i]
            g_omega[r - 2 + i] = pair_frequency[i]
            for a in range(size):
                for b in range(2 * size):
                    dg[r - 2 + i, a, (r - 2) * size + b] = pair_derivative[i, a, b]
    return g, dg, g_omega


@njit(cache=True)
def local_amounts(displacement: FloatArray, omega: float, factor: FloatArray, tables: LocalTables) -> FloatArray:
    """The coefficients (r, size) of :func:`harmonic_forces` without their derivatives."""
    r, size = displacement.shape
    elements = tables.jenkins_start.size - 1
    g = np.empty((r, size))
    g[:elements] = forces_alone(displacement[:elements], omega, tables)
    if r > elements:
        g[elements:] = factor_forces(
            displacement[r - 2], displacement[r - 1], omega, factor, tables.values, tables.slopes
        )[0]
    return g


@njit(cache=True)
def any_nonlinear(factor: FloatArray, tables: LocalTables) -> bool:
    """Whether any force of the local coordinates is there at all: those that are linear are not among them."""
    elements = tables.jenkins.shape[0] + tables.contacts.shape[0] + tables.kinds.size
    return bool(elements > 0 or factor[FACTOR_LINEAR] != 0.0 or factor[FACTOR_QUADRATIC] != 0.0)


@njit(cache=True, forceinline=True)
def phasor(coefficients: FloatArray, row: int, offset: int, order: int) -> complex:
    """Complex amplitude of one order of real Fourier coefficients (rows, size)."""
    if order == 0:
        return complex(coefficients[row, offset])
    return complex(coefficients[row, offset] - 1j * coefficients[row, offset + 1])


@njit(cache=True, forceinline=True)
def driven_by(transfer: ComplexArray, o: int, r: int, u: ComplexArray) -> complex:
    """What the inputs u (exciters,), behind r local forces, make of output o."""
    value = transfer[o, r] * u[0]
    for k in range(1, u.size):
        value += transfer[o, r + k] * u[k]
    return complex(value)


@njit(cache=True, forceinline=True)
def output_of(transfer: ComplexArray, o: int, driven: complex, g: FloatArray, offset: int, order: int) -> complex:
    """Output o at one order, of which the drive makes ``driven``, with the local forces g (r, size)."""
    value = driven
    for j in range(g.shape[0]):
        value -= transfer[o, j] * phasor(g, j, offset, order)
    return complex(value)


@njit(cache=True, forceinline=True)
def add_force_slopes(
    column: ComplexArray, transfer: ComplexArray, o: int, dg: FloatArray, offset: int, order: int
) -> None:
    """Add what derivatives of the local forces, dg (r, size, r · size), do to the slopes (nz,) of output o."""
    for j in range(dg.shape[0]):
        t = transfer[o, j]
        for b in range(dg.shape[2]):
            re = dg[j, offset, b]
            im = dg[j, offset + 1, b] if order > 0 else 0.0
            if re != 0.0 or im != 0.0:
                column[b] -= t * (re - 1j * im)


@njit(cache=True, forceinline=True)
def set_residual(residual: FloatArray, z: FloatArray, row: int, value: complex, order: int) -> None:
    """Difference of the unknowns of one order, from ``row`` on, from the displacement that they cause."""
    residual[row] = z[row] - value.real
    if order > 0:
        residual[row + 1] = z[row + 1] + value.imag


@njit(cache=True, forceinline=True)
def set_jacobian(jacobian: FloatArray, row: int, column: ComplexArray, order: int) -> None:
    """Slopes of :func:`set_residual` for the slopes (nz,) of that displacement."""
    for b in range(column.size):
        jacobian[row, b] = -column[b].real
    jacobian[row, row] += 1.0
    if order > 0:
        for b in range(column.size):
            jacobian[row + 1, b] = column[b].imag
        jacobian[row + 1, row + 1] += 1.0


@njit(cache=True)
def close(
    measured: ComplexArray, drive_log: float, control: Control, given_log: float, phase: float
) -> tuple[float, float]:
    """What phase (rad) and given amplitude (ln) are off by, for channels (c, n_orders)."""
    held_channel = control.held_channel
    product = measured[control.force, FUNDAMENTAL] * np.conj(measured[control.response, FUNDAMENTAL])
    # velocity = (iω)^power response: a quarter turn per derivative.
    angle = np.angle(product) - 0.5 * np.pi * control.power - phase
    angle -= 2.0 * np.pi * np.round(angle / (2.0 * np.pi))
    log_amplitude = drive_log if held_channel == DRIVE_HELD else np.log(np.abs(measured[held_channel, FUNDAMENTAL]))
    return angle, log_amplitude - given_log


@njit(cache=True)
def close_slopes(measured: ComplexArray, slopes: ComplexArray, control: Control, jacobian: FloatArray) -> None:
    """Slopes of :func:`close`, the last two rows of a Jacobian, by those of the channels (c, n_orders, nz)."""
    held_channel, force, response = control.held_channel, control.force, control.response
    nz = jacobian.shape[0]
    last = nz - 1
    for b in range(nz):
        jacobian[last - 1, b] = (
            slopes[force, FUNDAMENTAL, b] / measured[force, FUNDAMENTAL]
            - slopes[response, FUNDAMENTAL, b] / measured[response, FUNDAMENTAL]
        ).imag
    if held_channel == DRIVE_HELD:
        jacobian[last, last] = 1.0
    else:
        for b in range(nz):
            jacobian[last, b] = (slopes[held_channel, FUNDAMENTAL, b] / measured[held_channel, FUNDAMENTAL]).real


@njit(cache=True)
def evaluate(
    z: FloatArray,
    control: Control,
    given_log: float,
    phase: float,
    drive: ComplexArray,
    rig: RigTables,
) -> tuple[FloatArray, FloatArray, ComplexArray, ComplexArray]:
    """Residual (nz,), Jacobian (nz, nz), channels (c, n_orders) after their sensors, and their derivatives
    (c, n_orders, nz).

    Args:
        z: unknowns; the first order must be 0.
        control: what is held.
        given_log: ln of the given amplitude.
        phase: measured arg F₁ − arg(velocity₁), rad.
        drive: (n_orders, exciters) harmonics of the inputs for unit drive amplitude.
    """
    model, channels, factor, tables = rig
    orders, offsets = tables.orders, tables.offsets
    count = orders.size
    exciters = drive.shape[1]
    r = model.inputs.shape[1] - exciters
    c = channels.shape[0]
    size = offsets[count - 1] + 2
    local = r * size
    nz = local + 2
    omega = z[local]
    amplitude = np.exp(z[local + 1])

    displacement = z[:local].copy().reshape(r, size)
    g, dg, g_omega = harmonic_forces(displacement, omega, factor, tables)
    linear = not any_nonlinear(factor, tables)
    residual = np.zeros(nz)
    jacobian = np.zeros((nz, nz))
    measured = np.zeros((c, count), dtype=np.complex128)
    slopes = np.zeros((c, count, nz), dtype=np.complex128)
    column = np.zeros(nz, dtype=np.complex128)
    for n in range(count):
        order = orders[n]
        offset = offsets[n]
        s = 1j * order * omega
        u = amplitude * drive[n]
        quiet = not np.any(u)
        if linear and quiet:
            # Nothing acts at this order, and nothing responds.
            for o in range(r):
                for row in range(o * size + offset, o * size + offset + (2 if order > 0 else 1)):
                    residual[row] = z[row]
                    jacobian[row, row] = 1.0
            continue
        # Most orders are not driven, and the response to the drive is not wanted.
        transfer, transfer_slope = transfer_at(s, model, r if quiet else r + exciters)
        for o in range(r + c):
            driven = driven_by(transfer, o, r, u)
            value = output_of(transfer, o, driven, g, offset, order)
            column[:] = 0.0
            column[local] = driven_by(transfer_slope, o, r, u) * 1j * order
            column[local + 1] = driven
            for j in range(r):
                amount, faster = phasor(g, j, offset, order), phasor(g_omega, j, offset, order)
                column[local] -= 1j * order * transfer_slope[o, j] * amount + transfer[o, j] * faster
            add_force_slopes(column, transfer, o, dg, offset, order)
            if o < r:
                set_residual(residual, z, o * size + offset, value, order)
                set_jacobian(jacobian, o * size + offset, column, order)
            else:
                k = o - r
                gain, gain_slope = sensor_gain(s, channels[k])
                measured[k, n] = gain * value
                for b in range(nz):
                    slopes[k, n, b] = gain * column[b]
                slopes[k, n, local] += 1j * order * gain_slope * value

    residual[local], residual[local + 1] = close(measured, z[local + 1], control, given_log, phase)
    close_slopes(measured, slopes, control, jacobian)
    return residual, jacobian, measured, slopes


@njit(cache=True)
def newton(
    z: FloatArray,
    scale: FloatArray,
    iterations: int,
    tolerance: float,
    control: Control,
    given_log: float,
    phase: float,
    drive: ComplexArray,
    rig: RigTables,
) -> tuple[bool, FloatArray, FloatArray, ComplexArray, ComplexArray]:
    """Damped Newton iteration from z.

    Args:
        scale: (nz,) size of the unknowns; the residuals have the same, the phase 1.

    Returns:
        converged, z, Jacobian, channels and their derivatives at z.
    """
    z = z.copy()
    nz = z.size
    local = nz - 2
    weights = 1.0 / scale
    weights[local:] = 1.0
    residual, jacobian, measured, slopes = evaluate(z, control, given_log, phase, drive, rig)
    error = np.linalg.norm(residual * weights)
    for _ in range(iterations):
        if not np.isfinite(error):
            return False, z, jacobian, measured, slopes
        system = np.empty((nz, nz))
        for i in range(nz):
            for j in range(nz):
                system[i, j] = jacobian[i, j] * weights[i] * scale[j]
        step = np.linalg.solve(system, -residual * weights) * scale
        fraction = 1.0
        # A step of the frequency beyond a few percent leaves the resonance.
        largest = abs(step[local]) / z[local]
        if largest > 0.05:
            fraction = 0.05 / largest
        length = np.linalg.norm(step / scale)
        done = False
        for _ in range(8):
            trial = z + fraction * step
            residual, jacobian, measured, slopes = evaluate(trial, control, given_log, phase, drive, rig)
            after = np.linalg.norm(residual * weights)
            if after < error * (1.0 - 0.1 * fraction) or after < 1e-10 or length < tolerance:
                done = True
                break
            fraction *= 0.5
        # Where no shorter step is better, the shortest is taken all the same: it may cross a kink.
        z, error = trial, after
        if done and fraction == 1.0 and length < tolerance * (1.0 + np.linalg.norm(z / scale)):
            return True, z, jacobian, measured, slopes
        if done and error < 1e-12:
            return True, z, jacobian, measured, slopes
    return False, z, jacobian, measured, slopes


@njit(cache=True)
def residuals(
    z: FloatArray,
    control: Control,
    given_log: FloatArray,
    phase: FloatArray,
    drive: ComplexArray,
    rig: RigTables,
) -> tuple[FloatArray, ComplexArray]:
    """Residuals (levels, nz) and channels (levels, c, n_orders) of several levels of one rig, without derivatives.

    The arguments are those of ``evaluate``; ``z``, ``given_log``, ``phase`` and ``drive`` have an entry for each level.
    """
    model, channels, factor, tables = rig
    orders, offsets = tables.orders, tables.offsets
    count = orders.size
    exciters = drive.shape[2]
    r = model.inputs.shape[1] - exciters
    c = channels.shape[0]
    size = offsets[count - 1] + 2
    local = r * size
    levels = z.shape[0]
    residual = np.zeros((levels, local + 2))
    measured = np.zeros((levels, c, count), dtype=np.complex128)
    for level in range(levels):
        unknowns, left = z[level], residual[level]
        omega = unknowns[local]
        amplitude = np.exp(unknowns[local + 1])
        displacement = unknowns[:local].copy().reshape(r, size)
        g = local_amounts(displacement, omega, factor, tables)
        for n in range(count):
            order = orders[n]
            offset = offsets[n]
            s = 1j * order * omega
            u = amplitude * drive[level, n]
            quiet = not np.any(u)
            if quiet and not np.any(g[:, offset]) and (order == 0 or not np.any(g[:, offset + 1])):
                # Nothing acts at this order, and nothing responds.
                for o in range(r):
                    set_residual(left, unknowns, o * size + offset, 0j, order)
                continue
            transfer = response_at(s, model, r + c, r if quiet else r + exciters)
            for o in range(r + c):
                value = output_of(transfer, o, driven_by(transfer, o, r, u), g, offset, order)
                if o < r:
                    set_residual(left, unknowns, o * size + offset, value, order)
                else:
                    measured[level, o - r, n] = sensor_gain(s, channels[o - r])[0] * value
        left[local], left[local + 1] = close(
            measured[level], unknowns[local + 1], control, given_log[level], phase[level]
        )
    return residual, measured
