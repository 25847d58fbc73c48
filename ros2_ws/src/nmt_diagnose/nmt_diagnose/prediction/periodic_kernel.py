"""Compiled harmonic balance of a rig with its Jacobian: one residual, closed in one of three ways.

Unknowns are z = [w (r · size), x, y]: real Fourier coefficients of the local coordinates, and two more. Order n moves
with s_n = i n ω − κ ω (the mean with 0), and for every order

    w_n + T^{wg}(s_n) g_n(w) − T^{wu}(s_n) u_n a = 0,

where u_n is what a unit of the drive a makes of the inputs. Two rows close it; which ones is data, see `Closing`:

========== =========== ======================================================================================
``kind``   x, y        given
========== =========== ======================================================================================
``LOCKED`` ω, ln a     phase between two channels, and the amplitude of the drive or of a channel
``DRIVEN`` Re a, Im a  frequency, and the complex amplitude of the drive or of a channel
``FREE``   ω, κ        amplitude of a channel; the drive that holds it has to vanish
========== =========== ======================================================================================

With a response given a driven motion is as mild as a linear one: no folds, because a curve of force over response has
none. Within one period a slowly decaying motion is a copy of the one before times exp(−κ 2π); the drive that holds its
amplitude vanishes at the pole of the linear system and, with local forces, at its continuation over amplitude.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_core.numerics.kernels import njit
from nmt_diagnose.prediction.linear_model import add_response
from nmt_diagnose.prediction.rig_tables import Forces, RigTables, any_nonlinear, harmonic_forces, sensor_gain

# Position of the fundamental, and of its first coefficient: the first order is 0.
FUNDAMENTAL = 1
# Ways to close the balance.
LOCKED, DRIVEN, FREE = 0, 1, 2
# Index in the place of a channel where the drive has the given amplitude.
DRIVE_HELD = -1
# Columns of the targets of a level, see :func:`target_rows`.
AMPLITUDE, PHASE, OMEGA, WEIGHT = 0, 1, 2, 3

_HALVINGS = 8


class Closing(NamedTuple):
    """The rows that close the balance.

    Attributes:
        kind: ``LOCKED``, ``DRIVEN`` or ``FREE``.
        held: ``DRIVE_HELD``, or the channel whose fundamental has the given amplitude.
        force, response: channels whose phase was controlled.
        power: order of time derivative from that response to a velocity (1, 0, −1).
    """

    kind: int
    held: int
    force: int = 0
    response: int = 0
    power: int = 0


class Limits(NamedTuple):
    """How Newton's method goes.

    Attributes:
        iterations: at most.
        tolerance: of the last step, relative to the solution.
        largest_step: of ln ω and of κ; a longer one is shortened.
    """

    iterations: int
    tolerance: float
    largest_step: float = 0.05


class OrderTransfers(NamedTuple):
    """T of the linear part at every order.

    Attributes:
        acting: orders (n_orders,) that the drive or local forces act at: at others nothing responds, and T is 0.
        values: (n_orders, r + c, r + exciters): of all outputs where the channels are wanted, else of coordinates; of
            exciters where they drive.
        slopes: derivatives by s; empty = not wanted.
    """

    acting: np.ndarray
    values: ComplexArray
    slopes: ComplexArray


class Balance(NamedTuple):
    """The balance at some unknowns.

    Attributes:
        residual: (nz,).
        jacobian: (nz, nz); empty = not wanted.
        channels: fundamentals (c, 1) after the sensors, of ``LOCKED`` all orders (c, n_orders).
        slopes: their derivatives by the unknowns, (c, ·, nz).
        forces: coefficients of the local forces (r, size).
    """

    residual: FloatArray
    jacobian: FloatArray
    channels: ComplexArray
    slopes: ComplexArray
    forces: FloatArray


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


def target_rows(amplitude: Any, phase: float = 0.0, omega: Any = 0.0) -> FloatArray:
    """What is given for a level, (4,), or for several, (levels, 4): amplitude, phase in rad, ω in rad/s."""
    result = np.zeros((*np.shape(amplitude), WEIGHT + 1))
    result[..., AMPLITUDE], result[..., PHASE], result[..., OMEGA] = amplitude, phase, omega
    return result


@njit(cache=True, forceinline=True)
def motion_of(z: FloatArray, closing: Closing, targets: FloatArray) -> tuple[float, float]:
    """Angular frequency ω, rad/s, and decay κ."""
    if closing.kind == DRIVEN:
        return targets[OMEGA], 0.0
    return z[z.size - 2], z[z.size - 1] if closing.kind == FREE else 0.0


@njit(cache=True, forceinline=True)
def rates(order: int, omega: float, decay: float, kind: int) -> tuple[complex, complex, complex]:
    """s of one order, and its derivatives by the last two unknowns."""
    by_omega = 1j * order - (decay if order > 0 else 0.0)
    if kind == DRIVEN:
        return by_omega * omega, 0j, 0j
    return by_omega * omega, by_omega, complex(-omega if kind == FREE and order > 0 else 0.0)


@njit(cache=True)
def forces_of(z: FloatArray, closing: Closing, targets: FloatArray, rig: RigTables, sloped: bool) -> Forces:
    """Local forces at some unknowns."""
    size = rig.local.offsets[-1] + 2
    displacement = z[: z.size - 2].copy().reshape((z.size - 2) // size, size)
    found: Forces = harmonic_forces(displacement, motion_of(z, closing, targets)[0], rig.factor, rig.local, sloped)
    return found


@njit(cache=True)
def transfers(
    z: FloatArray, closing: Closing, targets: FloatArray, drive: ComplexArray, acting: np.ndarray, rig: RigTables,
    sloped: bool,
) -> OrderTransfers:  # fmt: skip
    """T at every order that acts; arguments as of `OrderTransfers` and :func:`balance`."""
    model, orders = rig.model, rig.local.orders
    omega, decay = motion_of(z, closing, targets)
    outputs, columns = model.feedthrough.shape
    r = columns - drive.shape[1]
    values = np.zeros((orders.size, outputs, columns), dtype=np.complex128)
    slopes = np.zeros((orders.size if sloped else 0, outputs, columns), dtype=np.complex128)
    for n in range(orders.size):
        if acting[n]:
            s, _, _ = rates(orders[n], omega, decay, closing.kind)
            every = closing.kind == LOCKED or n == FUNDAMENTAL
            # Most orders are not driven, and the response to the drive is not wanted.
            add_response(s, model, n, outputs if every else r, columns if np.any(drive[n]) else r, values, slopes)
    return OrderTransfers(acting, values, slopes)


@njit(cache=True)
def acting_orders(drive: ComplexArray, g: FloatArray, rig: RigTables, varying: bool) -> np.ndarray:
    """Orders (n_orders,) that the drive or local forces g (r, size) act at, or may act at where the forces vary."""
    offsets = rig.local.offsets
    result = np.full(offsets.size, varying and any_nonlinear(rig.factor, rig.local))
    for n in range(offsets.size):
        result[n] |= np.any(drive[n]) or np.any(g[:, offsets[n]]) or (n > 0 and np.any(g[:, offsets[n] + 1]))
    return result


@njit(cache=True)
def amplitude_of_drive(
    z: FloatArray, g: FloatArray, closing: Closing, targets: FloatArray, drive: ComplexArray, t: OrderTransfers
) -> complex:
    """The amplitude a; of a free motion what would hold the amplitude of the channel."""
    last, r = z.size - 1, g.shape[0]
    if closing.kind == LOCKED:
        return complex(np.exp(z[last]))
    if closing.kind == DRIVEN:
        return complex(z[last - 1], z[last])
    values, row = t.values[FUNDAMENTAL], r + closing.held
    alone = output_of(values, row, 0j, g, FUNDAMENTAL, FUNDAMENTAL)
    return complex((targets[AMPLITUDE] - alone) / driven_by(values, row, r, drive[FUNDAMENTAL]))


@njit(cache=True, forceinline=True)
def set_slopes(
    column: ComplexArray, o: int, n: int, order: int, a: complex, a_slopes: ComplexArray, by: tuple[complex, complex],
    forces: Forces, drive: ComplexArray, t: OrderTransfers,
) -> None:  # fmt: skip
    """Slopes (nz,) of output o at one order for those of the amplitude of the drive.

    Args:
        by: derivatives of s by the last two unknowns; they are 0 where the frequency is given.
    """
    r, size = forces.amounts.shape
    local, offset = r * size, max(0, 2 * order - 1)
    column[:] = 0.0
    unit = driven_by(t.values[n], o, r, drive[n])
    if unit != 0.0:
        for b in range(column.size):
            column[b] = unit * a_slopes[b]
    if t.slopes.shape[0] > 0:
        by_s = output_of(t.slopes[n], o, driven_by(t.slopes[n], o, r, drive[n]) * a, forces.amounts, offset, order)
        column[local] += by[0] * by_s
        column[local + 1] += by[1] * by_s
        for j in range(r):
            column[local] -= t.values[n, o, j] * phasor(forces.by_omega, j, offset, order)
    add_force_slopes(column, t.values[n], o, forces.slopes, offset, order)


@njit(cache=True)
def drive_slopes(
    a: complex, forces: Forces, closing: Closing, by: tuple[complex, complex], drive: ComplexArray, t: OrderTransfers
) -> ComplexArray:
    """Derivatives (nz,) of :func:`amplitude_of_drive` by the unknowns."""
    r, size = forces.amounts.shape
    local = r * size
    result = np.zeros(local + 2, dtype=np.complex128)
    if closing.kind == LOCKED:
        result[local + 1] = a
    elif closing.kind == DRIVEN:
        result[local], result[local + 1] = 1.0, 1j
    else:
        # The held output stays as it is.
        row, still = r + closing.held, np.zeros(local + 2, dtype=np.complex128)
        set_slopes(result, row, FUNDAMENTAL, FUNDAMENTAL, a, still, by, forces, drive, t)
        result /= -driven_by(t.values[FUNDAMENTAL], row, r, drive[FUNDAMENTAL])
    return result


@njit(cache=True)
def close(
    a: complex, channels: ComplexArray, drive_log: float, closing: Closing, targets: FloatArray
) -> tuple[float, float]:
    """What the two closing rows are off by, for channels (c, ·).

    Args:
        a: amplitude of the drive.
        drive_log: ln of it where it is locked.
    """
    if closing.kind == FREE:
        vanishing = a * targets[WEIGHT]
        return vanishing.real, vanishing.imag
    if closing.kind == DRIVEN:
        off = (a if closing.held == DRIVE_HELD else channels[closing.held, 0]) - targets[AMPLITUDE]
        return off.real, off.imag
    product = channels[closing.force, FUNDAMENTAL] * np.conj(channels[closing.response, FUNDAMENTAL])
    # velocity = (iω)^power response: a quarter turn per derivative.
    angle = np.angle(product) - 0.5 * np.pi * closing.power - targets[PHASE]
    angle -= 2.0 * np.pi * np.round(angle / (2.0 * np.pi))
    log = drive_log if closing.held == DRIVE_HELD else np.log(np.abs(channels[closing.held, FUNDAMENTAL]))
    return angle, log - np.log(targets[AMPLITUDE])


@njit(cache=True)
def close_slopes(
    a_slopes: ComplexArray, channels: ComplexArray, slopes: ComplexArray, closing: Closing, targets: FloatArray,
    jacobian: FloatArray,
) -> None:  # fmt: skip
    """Slopes of :func:`close`, the last two rows of a Jacobian, by those of the drive (nz,) and channels (c, ·, nz)."""
    held, force, response = closing.held, closing.force, closing.response
    last = jacobian.shape[0] - 1
    for b in range(last + 1):
        if closing.kind == LOCKED:
            jacobian[last - 1, b] = (
                slopes[force, FUNDAMENTAL, b] / channels[force, FUNDAMENTAL]
                - slopes[response, FUNDAMENTAL, b] / channels[response, FUNDAMENTAL]
            ).imag
            if held == DRIVE_HELD:
                jacobian[last, b] = 1.0 if b == last else 0.0
            else:
                jacobian[last, b] = (slopes[held, FUNDAMENTAL, b] / channels[held, FUNDAMENTAL]).real
        else:
            row = slopes[held, 0, b] if closing.kind == DRIVEN and held != DRIVE_HELD else a_slopes[b]
            if closing.kind == FREE:
                row *= targets[WEIGHT]
            jacobian[last - 1, b], jacobian[last, b] = row.real, row.imag


@njit(cache=True)
def balance(
    z: FloatArray, forces: Forces, closing: Closing, targets: FloatArray, drive: ComplexArray, t: OrderTransfers,
    rig: RigTables,
) -> Balance:  # fmt: skip
    """The balance for known local forces and transfers.

    Args:
        z: unknowns (nz,).
        forces: of the coordinates; with slopes where the Jacobian is wanted.
        closing, targets: what closes it, and the numbers given for it.
        drive: (n_orders, exciters) harmonics of the inputs for a unit of the drive.
        t: with slopes where the Jacobian is wanted and the frequency is not given.
        rig: the rig.
    """
    g, orders, offsets = forces.amounts, rig.local.orders, rig.local.offsets
    (r, size), c, sloped = g.shape, rig.channels.shape[0], forces.slopes.size > 0
    local, last = r * size, r * size + 1
    omega, decay = motion_of(z, closing, targets)
    residual, jacobian = np.zeros(z.size), np.zeros((z.size, z.size) if sloped else (0, 0))
    spread = orders.size if closing.kind == LOCKED else 1
    channels = np.zeros((c, spread), dtype=np.complex128)
    slopes = np.zeros((c, spread, z.size if sloped else 0), dtype=np.complex128)
    column, a_slopes = np.zeros(z.size, dtype=np.complex128), np.zeros(0, dtype=np.complex128)
    a = amplitude_of_drive(z, g, closing, targets, drive, t)
    if sloped:
        _, by_x, by_y = rates(FUNDAMENTAL, omega, decay, closing.kind)
        a_slopes = drive_slopes(a, forces, closing, (by_x, by_y), drive, t)
    for n in range(orders.size):
        order, offset = orders[n], offsets[n]
        s, by_x, by_y = rates(order, omega, decay, closing.kind)
        if not t.acting[n]:
            for o in range(r):
                set_residual(residual, z, o * size + offset, 0j, order)
                if sloped:
                    for row in range(o * size + offset, o * size + offset + (2 if order > 0 else 1)):
                        jacobian[row, row] = 1.0
            continue
        # The Jacobian of a free motion needs no channels.
        every = closing.kind == LOCKED or (n == FUNDAMENTAL and not (sloped and closing.kind == FREE))
        for o in range(r + c if every else r):
            value = output_of(t.values[n], o, driven_by(t.values[n], o, r, drive[n]) * a, g, offset, order)
            if sloped:
                set_slopes(column, o, n, order, a, a_slopes, (by_x, by_y), forces, drive, t)
            if o < r:
                set_residual(residual, z, o * size + offset, value, order)
                if sloped:
                    set_jacobian(jacobian, o * size + offset, column, order)
                continue
            gain, gain_slope = sensor_gain(s, rig.channels[o - r])
            place = n if closing.kind == LOCKED else 0
            channels[o - r, place] = gain * value
            if sloped:
                slopes[o - r, place] = gain * column
                slopes[o - r, place, local] += by_x * gain_slope * value
                slopes[o - r, place, last] += by_y * gain_slope * value
    residual[local], residual[last] = close(a, channels, z[last], closing, targets)
    if sloped:
        close_slopes(a_slopes, channels, slopes, closing, targets, jacobian)
    return Balance(residual, jacobian, channels, slopes, g)


@njit(cache=True)
def evaluate(
    z: FloatArray, closing: Closing, targets: FloatArray, drive: ComplexArray, rig: RigTables, sloped: bool
) -> Balance:
    """The balance at some unknowns, with its Jacobian if wanted; arguments as of :func:`balance`."""
    forces = forces_of(z, closing, targets, rig, sloped)
    acting = acting_orders(drive, forces.amounts, rig, sloped)
    t = transfers(z, closing, targets, drive, acting, rig, sloped and closing.kind != DRIVEN)
    found: Balance = balance(z, forces, closing, targets, drive, t, rig)
    return found


@njit(cache=True)
def channels_of(
    z: FloatArray, closing: Closing, targets: FloatArray, drive: ComplexArray, rig: RigTables
) -> ComplexArray:
    """Channels (levels, c, ·) of several levels; arguments as of :func:`stepped`."""
    spread = drive.shape[0] if closing.kind == LOCKED else 1
    result = np.empty((z.shape[0], rig.channels.shape[0], spread), dtype=np.complex128)
    for level in range(z.shape[0]):
        result[level] = evaluate(z[level], closing, targets[level], drive, rig, False).channels
    return result


@njit(cache=True)
def scales(z: FloatArray, closing: Closing, targets: FloatArray, size: int) -> tuple[FloatArray, FloatArray]:
    """Size of the unknowns (nz,), of which a coordinate has ``size``, and one over that of the residuals."""
    scale = np.ones(z.size)
    local = z.size - 2
    for first in range(0, local, size):
        largest = np.max(np.abs(z[first : first + size]))
        if largest > 0.0:
            scale[first : first + size] = largest
    weights = 1.0 / scale
    if closing.kind == DRIVEN:
        amplitude = np.hypot(z[local], z[local + 1])
        scale[local:] = amplitude if amplitude > 0.0 else 1.0
        weights[local:] = 1.0 / max(abs(targets[AMPLITUDE]), 1e-300)
    else:
        scale[local] = z[local]
    return scale, weights


@njit(cache=True)
def scaled(matrix: FloatArray, rows: FloatArray, columns: FloatArray) -> FloatArray:
    """A matrix with its rows and columns multiplied."""
    result = np.empty(matrix.shape)
    for i in range(rows.size):
        for j in range(columns.size):
            result[i, j] = matrix[i, j] * rows[i] * columns[j]
    return result


@njit(cache=True)
def inverted(jacobian: FloatArray, scale: FloatArray, weights: FloatArray) -> FloatArray:
    """Inverse (nz, nz) of a Jacobian for the :func:`scales` of its columns and rows."""
    found: FloatArray = scaled(np.linalg.inv(scaled(jacobian, weights, scale)), scale, weights)
    return found


@njit(cache=True)
def scaled_solve(jacobian: FloatArray, right: FloatArray, scale: FloatArray, weights: FloatArray) -> FloatArray:
    """Jacobian⁻¹ right (nz,) likewise."""
    return np.linalg.solve(scaled(jacobian, weights, scale), right * weights) * scale


@njit(cache=True)
def at_pole(z: FloatArray, closing: Closing, targets: FloatArray, rig: RigTables) -> bool:
    """Whether a free motion is a pole of the linear system to the last bit, where T is infinite."""
    if closing.kind != FREE:
        return False
    omega, decay = motion_of(z, closing, targets)
    s, _, _ = rates(FUNDAMENTAL, omega, decay, closing.kind)
    return bool(np.any(rig.model.poles == s))


@njit(cache=True)
def newton(
    z: FloatArray, closing: Closing, targets: FloatArray, drive: ComplexArray, rig: RigTables, limits: Limits
) -> tuple[bool, FloatArray, Balance]:
    """Damped Newton iteration from z; arguments as of :func:`balance`.

    Returns:
        Whether it converged, z, and the balance there; of a free motion at the last but one.
    """
    z, local, first = z.copy(), z.size - 2, z[z.size - 2]
    scale, weights = scales(z, closing, targets, rig.local.offsets[-1] + 2)
    forces, fixed = forces_of(z, closing, targets, rig, True), closing.kind == DRIVEN
    acting = acting_orders(drive, forces.amounts, rig, True)
    t = transfers(z, closing, targets, drive, acting, rig, not fixed)
    here = balance(z, forces, closing, targets, drive, t, rig)
    error = np.linalg.norm(here.residual * weights)
    for _ in range(limits.iterations):
        if not np.isfinite(error):
            break
        step = scaled_solve(here.jacobian, -here.residual, scale, weights)
        length, fraction = np.linalg.norm(step / scale), 1.0
        if not fixed:
            # A longer step leaves the resonance.
            moved = abs(step[local]) / z[local]
            if closing.kind == FREE:
                moved = max(moved, abs(step[local + 1]))
            if moved > limits.largest_step:
                fraction = limits.largest_step / moved
        accepted = False
        for _ in range(_HALVINGS):
            trial = z + fraction * step
            if closing.kind == FREE:
                if not 0.5 * first < trial[local] < 2.0 * first:
                    return False, trial, here
                if moved < limits.tolerance or at_pole(trial, closing, targets, rig):
                    return True, trial, here
            if not fixed:
                t = transfers(trial, closing, targets, drive, acting, rig, True)
            here = balance(trial, forces_of(trial, closing, targets, rig, True), closing, targets, drive, t, rig)
            after = np.linalg.norm(here.residual * weights)
            # A free motion's steps are short enough as they are.
            accepted = bool(
                closing.kind == FREE or after < error * (1.0 - 0.1 * fraction) or after < 1e-10
                or length < limits.tolerance
            )  # fmt: skip
            if accepted:
                break
            fraction *= 0.5
        # Where no shorter step is better, the shortest is taken all the same: it may cross a kink.
        z, error = trial, after
        near = fraction == 1.0 and length < limits.tolerance * (1.0 + np.linalg.norm(z / scale))
        if accepted and closing.kind != FREE and (near or error < 1e-12):
            return True, z, here
    return False, z, here


@njit(cache=True)
def resting_response(
    s: complex, stiffness: FloatArray, damping: FloatArray, drive: ComplexArray, rig: RigTables
) -> tuple[ComplexArray, ComplexArray]:
    """Coordinates (r,) and channels (c,) before their sensors of the system linearised at rest, per unit of the drive.

    Args:
        s: complex frequency.
        stiffness, damping: (r,) tangents of the local forces.
        drive: (exciters,) inputs for a unit of the drive.
        rig: the rig.
    """
    outputs, columns = rig.model.feedthrough.shape
    r = columns - drive.size
    every, none = np.zeros((1, outputs, columns), dtype=np.complex128), np.zeros((0, 0, 0), dtype=np.complex128)
    add_response(s, rig.model, 0, outputs, columns, every, none)
    values = every[0]
    tangent = stiffness + s * damping
    closed, driven = np.empty((r, r), dtype=np.complex128), np.empty(outputs, dtype=np.complex128)
    for i in range(r):
        for j in range(r):
            closed[i, j] = values[i, j] * tangent[j]
        closed[i, i] += 1.0
    for o in range(outputs):
        driven[o] = driven_by(values, o, r, drive)
    w: ComplexArray = np.linalg.solve(closed, driven[:r].copy()).astype(np.complex128)
    for o in range(r, outputs):
        for j in range(r):
            driven[o] -= values[o, j] * (tangent[j] * w[j])
    return w, driven[r:].copy()


@njit(cache=True)
def resting_angles(
    omegas: FloatArray, stiffness: FloatArray, damping: FloatArray, drive: ComplexArray, rig: RigTables,
    closing: Closing, phase: float,
) -> FloatArray:  # fmt: skip
    """Angle of the phase condition, rad (k,), of the system linearised at rest.

    Args:
        omegas: angular frequencies, rad/s (k,).
        stiffness, damping, drive, rig: as for `resting_response`.
        closing: channels and power of the condition.
        phase: that is wanted, rad.
    """
    angles = np.empty(omegas.size)
    for k in range(omegas.size):
        s = 1j * omegas[k]
        channels = resting_response(s, stiffness, damping, drive, rig)[1]
        force = channels[closing.force] * sensor_gain(s, rig.channels[closing.force])[0]
        response = channels[closing.response] * sensor_gain(s, rig.channels[closing.response])[0]
        angles[k] = np.angle(force * np.conj(response) * np.exp(-1j * (0.5 * np.pi * closing.power + phase)))
    return angles


@njit(cache=True)
def stepped(
    z: FloatArray, closing: Closing, targets: FloatArray, drive: ComplexArray, rig: RigTables
) -> tuple[FloatArray, ComplexArray]:
    """Unknowns (levels, nz) and channels (levels, c, ·) after one Newton step of each level with its own Jacobian.

    Args:
        z: unknowns (levels, nz).
        closing, drive, rig: as of :func:`balance`.
        targets: of each level (levels, 4).
    """
    moved = np.empty(z.shape)
    spread = drive.shape[0] if closing.kind == LOCKED else 1
    channels = np.empty((z.shape[0], rig.channels.shape[0], spread), dtype=np.complex128)
    for level in range(z.shape[0]):
        at = evaluate(z[level], closing, targets[level], drive, rig, True)
        scale, weights = scales(z[level], closing, targets[level], rig.local.offsets[-1] + 2)
        step = scaled_solve(at.jacobian, -at.residual, scale, weights)
        moved[level], channels[level] = z[level] + step, followed(at.channels, at.slopes, step)
    return moved, channels


@njit(cache=True)
def followed(channels: ComplexArray, slopes: ComplexArray, step: FloatArray) -> ComplexArray:
    """Channels (c, ·) after a step (nz,) by their slopes (c, ·, nz)."""
    result = channels.copy()
    for c in range(slopes.shape[0]):
        for n in range(slopes.shape[1]):
            for b in range(step.size):
                result[c, n] += slopes[c, n, b] * step[b]
    return result


@njit(cache=True)
def carried(
    z: FloatArray, positions: np.ndarray, kept: np.ndarray, fresh: np.ndarray, closing: Closing, targets: FloatArray,
    drive: ComplexArray, rig: RigTables,
) -> FloatArray:  # fmt: skip
    """Unknowns of another rig on the coordinates of this one; new coordinates move as the others make them.

    Args:
        z: unknowns of the other rig.
        positions, kept: of the unknowns that both have, in those of this rig and of the other.
        fresh: positions of the rest of this rig's.
        closing, targets, drive, rig: as of :func:`balance`.
    """
    here = np.zeros(positions.size + fresh.size)
    for k in range(positions.size):
        here[positions[k]] = z[kept[k]]
    if fresh.size > 0:
        residual = evaluate(here, closing, targets, drive, rig, False).residual
        for k in fresh:
            here[k] = -residual[k]
    return here


@njit(cache=True)
def advance(
    z: FloatArray, forces: FloatArray, shared: tuple[np.ndarray, np.ndarray, np.ndarray], inverses: FloatArray,
    slopes: ComplexArray, closing: Closing, targets: FloatArray, drives: ComplexArray, rig: RigTables,
) -> tuple[FloatArray, ComplexArray]:  # fmt: skip
    """One Newton step to the solutions of a slightly different rig with the Jacobians of the solved one.

    By the implicit function theorem the change is right to first order. Coordinates that the solved rig lacks have
    forces of the order of the change: to first order they move as the others make them, and what their forces do is in
    the residuals of the others.

    Args:
        z, inverses, slopes: solutions of the neighbouring rig (levels, …).
        forces: (levels, r, size) its local forces where elements and frequencies are the same; without levels
            otherwise.
        shared: positions of the unknowns that both rigs have in those of this one and of the solved one, and positions
            of the others in those of this one.
        closing, rig: as of :func:`balance`.
        targets, drives: of each level, (levels, 4) and (levels, n_orders, exciters); of one drive it is that of all.

    Returns:
        z (levels, nz) and channels (levels, c, ·).
    """
    positions, kept, fresh = shared
    levels, nz = z.shape[0], positions.size + fresh.size
    moved = np.full((levels, nz), np.nan)
    channels = np.full((levels, slopes.shape[1], slopes.shape[2]), np.nan + 0j)
    for level in range(levels):
        if not np.isfinite(z[level, 0]):
            continue
        row, drive = targets[level], drives[min(level, drives.shape[0] - 1)]
        here = carried(z[level], positions, kept, fresh, closing, row, drive, rig)
        if forces.shape[0] > 0:
            g = Forces(forces[level], np.zeros((0, 0, 0)), np.zeros((0, 0)))
        else:
            g = forces_of(here, closing, row, rig, False)
        acting = acting_orders(drive, g.amounts, rig, False)
        at = balance(here, g, closing, row, drive, transfers(here, closing, row, drive, acting, rig, False), rig)
        known = np.zeros(z.shape[1])
        for k in range(positions.size):
            known[kept[k]] = at.residual[positions[k]]
        step = -inverses[level] @ known
        for k in range(positions.size):
            here[positions[k]] += step[kept[k]]
        moved[level] = here
        channels[level] = followed(at.channels, slopes[level], step)
    return moved, channels
