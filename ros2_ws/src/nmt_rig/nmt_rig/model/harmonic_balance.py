"""Harmonic balance condensed to the local coordinates.

For every harmonic order n, Z_n q_n + Σ_j d_j g_{j,n} = f_n with Z_n = K + s C − ξ s M + s² M, s = i n ω.
With the transfer matrix T_n from local forces and drive to local displacements, only w_n = d · q_n remains
unknown:

    w_n + T_n^{wg} g_n(w) − T_n^{wu} u_n = 0.

The linear part is kept in mass-normalised modal coordinates; where damping is proportional Z_n is diagonal
there. With an exciter or dampers it is diagonal but for a few ports Q,

    Z = D + Q Y Qᵀ,   Z⁻¹ = D⁻¹ − D⁻¹ Q (I + Y Qᵀ D⁻¹ Q)⁻¹ Y Qᵀ D⁻¹   (Woodbury).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.linalg import eigh

from nmt_core.numerics.arrays import ComplexArray, FloatArray, IntArray
from nmt_core.numerics.kernels import njit
from nmt_rig.model.aft import ScaledForces
from nmt_rig.model.assembly import ElectromechanicalSystem
from nmt_rig.model.damping_ports import MOST_PORTS, is_small, port_directions, split_damping
from nmt_rig.model.fourier_basis import FourierBasis
from nmt_rig.model.structure import Structure

_WORTH = 4
"""Unknowns for each port from which a system of the ports is solved in place of the whole."""


class Ports(NamedTuple):
    """An impedance that is diagonal but for a few ports; without ports it is to be taken as it is.

    Attributes:
        stiffness, damping: (N,) diagonals.
        directions: (N, m) of the ports.
        between_stiffness, between_damping: (m, m).
    """

    stiffness: FloatArray
    damping: FloatArray
    directions: FloatArray
    between_stiffness: FloatArray
    between_damping: FloatArray


class ModalTables(NamedTuple):
    """A `ModalImpedance` for compiled functions."""

    mass: FloatArray
    damping: FloatArray
    stiffness: FloatArray
    diagonal: bool
    ports: Ports


class OutputTables(NamedTuple):
    """Outputs y = (s² acceleration + s velocity + displacement) η + feedthrough · input; (o, N) and (o, p)."""

    displacement: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    feedthrough: FloatArray


class Responses(NamedTuple):
    """What an impedance Z of one order answers.

    Attributes:
        to_inputs: (N, p) Z⁻¹ inputs.
        to_rows: (o, N) rows Z⁻¹.
        mass: (N, p) M Z⁻¹ inputs.
        slope: (N, p) ∂Z/∂s Z⁻¹ inputs.
    """

    to_inputs: ComplexArray
    to_rows: ComplexArray
    mass: ComplexArray
    slope: ComplexArray


class Transfers(NamedTuple):
    """T, ∂T/∂ω and ∂T/∂ξ, each (n_orders, o, p)."""

    transfer: ComplexArray
    by_frequency: ComplexArray
    by_excitation: ComplexArray


@dataclass(frozen=True)
class ModalImpedance:
    """Linear part in modal coordinates η, q = shapes · η.

    Attributes:
        shapes: (n, N) mass-normalised shapes; unknowns without inertia (current) keep a coordinate of their
            own.
        mass, damping, stiffness: (N, N) in modal coordinates.
        diagonal: all three are diagonal (proportional damping, no shaker).
        ports: the same as diagonals and a few ports; none where it is diagonal, small or of another form.
    """

    shapes: FloatArray
    mass: FloatArray
    damping: FloatArray
    stiffness: FloatArray
    diagonal: bool
    ports: Ports

    @classmethod
    def of(cls, system: Structure | ElectromechanicalSystem) -> ModalImpedance:
        """Transform a structure, or a structure with exciter, to the modal coordinates of its undamped
        mechanical part."""
        return cls.with_every_port(system).worthwhile()

    def worthwhile(self) -> ModalImpedance:
        """The same, its ports only where a system of them is solved sooner than the whole."""
        ports = self.ports.directions.shape[1]
        few = 0 < ports <= MOST_PORTS and _WORTH * ports <= len(self.mass)
        return self if few and not self.diagonal else replace(self, ports=_without_ports(len(self.mass)))

    @cached_property
    def tables(self) -> ModalTables:
        """What compiled functions need of it."""
        return ModalTables(self.mass, self.damping, self.stiffness, self.diagonal, self.ports)

    @classmethod
    def with_every_port(cls, system: Structure | ElectromechanicalSystem) -> ModalImpedance:
        """The same with all the ports that a system has."""
        n = system.mass.shape[0]
        massless = np.flatnonzero(~system.mass.any(axis=1))
        inertial = np.flatnonzero(system.mass.any(axis=1))
        mass = system.mass[np.ix_(inertial, inertial)]
        stiffness = system.stiffness[np.ix_(inertial, inertial)]
        _, vectors = eigh(0.5 * (stiffness + stiffness.T), mass)
        shapes = np.zeros((n, n))
        shapes[np.ix_(inertial, np.arange(inertial.size))] = vectors
        for position, index in enumerate(massless, start=inertial.size):
            # √L i has the unit of a modal velocity: keeps the electrical rows as large as the mechanical
            # ones.
            shapes[index, position] = 1.0 / np.sqrt(system.damping[index, index] or 1.0)
        mass = np.diag((np.arange(n) < inertial.size).astype(np.float64))
        damping, stiffness = (shapes.T @ matrix @ shapes for matrix in (system.damping, system.stiffness))
        diagonal = massless.size == 0 and _is_diagonal(damping) and _is_diagonal(stiffness)
        ports = None
        if isinstance(system, ElectromechanicalSystem):
            ports = _ports(system, vectors, inertial, damping, stiffness)
        return cls(shapes, mass, damping, stiffness, diagonal, ports or _without_ports(n))


def _without_ports(size: int) -> Ports:
    return Ports(np.zeros(size), np.zeros(size), np.zeros((size, 0)), np.zeros((0, 0)), np.zeros((0, 0)))


def _ports(
    system: ElectromechanicalSystem, modes: FloatArray, inertial: IntArray, damping: FloatArray, stiffness: FloatArray
) -> Ports | None:
    """Ports of modal matrices, those without inertia among them; None where they do not give the matrices."""
    size, count = len(damping), inertial.size
    physical = port_directions(system, inertial)
    if physical is None:
        return None
    along, _ = np.linalg.qr(modes.T @ physical.T)
    found = split_damping(damping[:count, :count], along)
    if found is None:
        return None
    directions = np.zeros((size, along.shape[1] + size - count))
    directions[:count, : along.shape[1]] = along
    directions[count:, along.shape[1] :] = np.eye(size - count)
    own = np.diag(stiffness).copy(), np.concatenate([found[1], np.diag(damping)[count:]])
    between = []
    for matrix, diagonal in zip((stiffness, damping), own, strict=True):
        rest = matrix - np.diag(diagonal)
        between.append(directions.T @ rest @ directions)
        if not is_small(rest - directions @ between[-1] @ directions.T, matrix):
            return None
    return Ports(own[0], own[1], directions, *between)


def _is_diagonal(matrix: FloatArray) -> bool:
    diagonal = np.abs(np.diag(matrix))
    scale = np.sqrt(np.outer(diagonal, diagonal))
    rest = np.abs(matrix - np.diag(np.diag(matrix)))
    return bool(np.all(rest <= 1e-9 * scale + 1e-13 * diagonal.max(initial=0.0)))


@njit(cache=True)
def modal_inverse(
    s: complex,
    self_excitation: float,
    shift: complex,
    shifted_mode: int,
    modal: ModalTables,
) -> ComplexArray:
    """Inverse of Z = K + (C − ξ M) s + M s² (+ ``shift`` on the diagonal entry of ``shifted_mode`` if ≥
    0)."""
    mass, damping, stiffness, diagonal, _ = modal
    size = mass.shape[0]
    if diagonal:
        inverse = np.zeros((size, size), dtype=np.complex128)
        for k in range(size):
            z = stiffness[k, k] + (damping[k, k] - self_excitation * mass[k, k]) * s + mass[k, k] * s * s
            if k == shifted_mode:
                z += shift
            inverse[k, k] = 1.0 / z
        return inverse
    impedance = stiffness + (damping - self_excitation * mass) * s + mass * (s * s)
    if shifted_mode >= 0:
        impedance[shifted_mode, shifted_mode] += shift
    return np.ascontiguousarray(np.linalg.inv(impedance))


@njit(cache=True)
def diagonal_responses(
    s: complex, self_excitation: float, shift: complex, mode: int, modal: ModalTables, inputs: FloatArray,
    rows: ComplexArray,
) -> Responses:  # fmt: skip
    """Responses of a diagonal impedance; arguments as for `modal_inverse`."""
    mass, damping = modal.mass, modal.damping
    size, columns, outputs = mass.shape[0], inputs.shape[1], rows.shape[0]
    inverse = modal_inverse(s, self_excitation, shift, mode, modal)
    response = np.empty((size, columns), dtype=np.complex128)
    adjoint = np.empty((outputs, size), dtype=np.complex128)
    impedance_response = np.empty((size, columns), dtype=np.complex128)
    mass_response = np.empty((size, columns), dtype=np.complex128)
    for k in range(size):
        slope = damping[k, k] - self_excitation * mass[k, k] + 2.0 * s * mass[k, k]
        for j in range(columns):
            response[k, j] = inverse[k, k] * inputs[k, j]
            impedance_response[k, j] = slope * response[k, j]
            mass_response[k, j] = mass[k, k] * response[k, j]
        for i in range(outputs):
            adjoint[i, k] = rows[i, k] * inverse[k, k]
    return Responses(response, adjoint, mass_response, impedance_response)


@njit(cache=True)
def port_responses(
    s: complex, self_excitation: float, shift: complex, mode: int, modal: ModalTables, directions: ComplexArray,
    inputs: ComplexArray, rows: ComplexArray,
) -> Responses:  # fmt: skip
    """Responses of an impedance that is diagonal but for its ports (Woodbury).

    Args:
        s, self_excitation, shift, mode, modal: as for `modal_inverse`.
        directions: those of the ports.
        inputs, rows: as for `transfer_matrices` and `Responses`.
    """
    ports, masses = modal.ports, np.diag(modal.mass)
    count, size, columns, outputs = ports.directions.shape[1], masses.size, inputs.shape[1], rows.shape[0]
    directions_over = np.empty((size, count), dtype=np.complex128)
    damping = ports.damping
    own = ports.stiffness + (damping - self_excitation * masses) * s + masses * (s * s)
    if mode >= 0:
        own[mode] += shift
    response = np.empty((size, columns), dtype=np.complex128)
    adjoint = np.empty((outputs, size), dtype=np.complex128)
    for k in range(size):
        for j in range(count):
            directions_over[k, j] = directions[k, j] / own[k]
        for j in range(columns):
            response[k, j] = inputs[k, j] / own[k]
        for i in range(outputs):
            adjoint[i, k] = rows[i, k] / own[k]
    between = ports.between_stiffness + s * ports.between_damping
    unit = np.eye(count).astype(np.complex128)
    closed = np.linalg.solve(unit + between @ (directions.T @ directions_over), between)
    response -= directions_over @ (closed @ (directions.T @ response))
    adjoint -= ((adjoint @ directions) @ closed) @ directions_over.T
    mass_response = np.empty((size, columns), dtype=np.complex128)
    impedance_response = directions @ (ports.between_damping.astype(np.complex128) @ (directions.T @ response))
    for k in range(size):
        for j in range(columns):
            mass_response[k, j] = masses[k] * response[k, j]
            impedance_response[k, j] += damping[k] * response[k, j]
            impedance_response[k, j] += (2.0 * s - self_excitation) * mass_response[k, j]
    return Responses(response, adjoint, mass_response, impedance_response)


@njit(cache=True)
def full_responses(
    s: complex, self_excitation: float, shift: complex, mode: int, modal: ModalTables, inputs: ComplexArray,
    rows: ComplexArray,
) -> Responses:  # fmt: skip
    """Responses of an impedance of any form; arguments as for `modal_inverse`."""
    mass, damping = modal.mass, modal.damping
    impedance = modal.stiffness + (damping - self_excitation * mass) * s + mass * (s * s)
    if mode >= 0:
        impedance[mode, mode] += shift
    response = np.ascontiguousarray(np.linalg.solve(impedance, inputs))
    adjoint = np.ascontiguousarray(np.linalg.solve(impedance.T, rows.T).T)
    real, imag = np.ascontiguousarray(response.real), np.ascontiguousarray(response.imag)
    mass_response = mass @ real + 1j * (mass @ imag)
    damping_response = damping @ real + 1j * (damping @ imag)
    impedance_response = damping_response + (2.0 * s - self_excitation) * mass_response
    return Responses(response, adjoint, mass_response, impedance_response)


@njit(cache=True)
def transfer_matrices(
    angular_frequency: float,
    self_excitation: float,
    orders: IntArray,
    modal: ModalTables,
    inputs: FloatArray,
    out: OutputTables,
    shift: complex,
    shifted_mode: int,
) -> Transfers:
    """Transfer matrices of all orders and their derivatives.

    Args:
        angular_frequency: ω, rad/s.
        self_excitation: ξ, rad/s.
        modal: the linear part; its ports are taken in place of the matrices where there are any.
        inputs: (N, p) modal input vectors.
        shift, shifted_mode: modal stiffness added to one mode in order 1 only (−1: none).
    """
    shape = (orders.size, out.displacement.shape[0], inputs.shape[1])
    transfer = np.empty(shape, dtype=np.complex128)
    by_frequency = np.empty(shape, dtype=np.complex128)
    by_excitation = np.empty(shape, dtype=np.complex128)
    complex_inputs = inputs.astype(np.complex128)
    directions = np.ascontiguousarray(modal.ports.directions.astype(np.complex128))
    for position in range(orders.size):
        n = orders[position]
        s = 1j * n * angular_frequency
        mode = shifted_mode if n == 1 else -1
        rows = out.displacement + s * out.velocity + s * s * out.acceleration
        row_slopes = out.velocity + 2.0 * s * out.acceleration
        if modal.diagonal:
            found = diagonal_responses(s, self_excitation, shift, mode, modal, inputs, rows)
        elif directions.shape[1] > 0:
            found = port_responses(s, self_excitation, shift, mode, modal, directions, complex_inputs, rows)
        else:
            found = full_responses(s, self_excitation, shift, mode, modal, complex_inputs, rows)
        transfer[position] = rows @ found.to_inputs + out.feedthrough
        by_frequency[position] = (1j * n) * (row_slopes @ found.to_inputs - found.to_rows @ found.slope)
        by_excitation[position] = s * (found.to_rows @ found.mass)
    return Transfers(transfer, by_frequency, by_excitation)


@njit(cache=True)
def add_transferred(
    transfer: ComplexArray,
    coefficients: FloatArray,
    orders: IntArray,
    offsets: IntArray,
    result: FloatArray,
) -> None:
    """Add T_n x_n, order by order, to ``result`` (r_out, size); x in real coefficients (r_in, size)."""
    for position in range(orders.size):
        offset = offsets[position]
        for i in range(result.shape[0]):
            for j in range(coefficients.shape[0]):
                real = transfer[position, i, j].real
                if orders[position] == 0:
                    result[i, offset] += real * coefficients[j, offset]
                    continue
                imag = transfer[position, i, j].imag
                c = coefficients[j, offset]
                s = coefficients[j, offset + 1]
                result[i, offset] += real * c + imag * s
                result[i, offset + 1] += real * s - imag * c


@njit(cache=True)
def local_balance(
    displacement: FloatArray,
    forces: ScaledForces,
    transfers: Transfers,
    orders: IntArray,
    offsets: IntArray,
    residual: FloatArray,
    jacobian: FloatArray,
    frequency_column: int,
    excitation_column: int,
    scale_column: int,
) -> None:
    """Residual w_n + T_n g_n and its Jacobian, written to the first r · size rows.

    Columns 0 … r · size − 1 belong to w (coordinate by coordinate); the other columns receive the
    derivatives with respect to ω, ξ (−1: left out) and the scale of the force argument. ``forces`` are those of
    ``scaled_local_forces``.
    """
    force, force_derivative, force_by_frequency, force_by_scale = forces
    transfer, transfer_by_frequency, transfer_by_excitation = transfers
    count, size = displacement.shape
    balance = displacement.copy()
    add_transferred(transfer, force, orders, offsets, balance)
    by_frequency = np.zeros((count, size))
    add_transferred(transfer, force_by_frequency, orders, offsets, by_frequency)
    add_transferred(transfer_by_frequency, force, orders, offsets, by_frequency)
    by_scale = np.zeros((count, size))
    add_transferred(transfer, force_by_scale, orders, offsets, by_scale)
    by_excitation = np.zeros((count, size))
    if excitation_column >= 0:
        add_transferred(transfer_by_excitation, force, orders, offsets, by_excitation)
    for i in range(count):
        for a in range(size):
            row = i * size + a
            residual[row] = balance[i, a]
            jacobian[row, frequency_column] = by_frequency[i, a]
            jacobian[row, scale_column] = by_scale[i, a]
            if excitation_column >= 0:
                jacobian[row, excitation_column] = by_excitation[i, a]
    for position in range(orders.size):
        offset = offsets[position]
        for i in range(count):
            for j in range(count):
                real = transfer[position, i, j].real
                imag = transfer[position, i, j].imag
                for b in range(size):
                    column = j * size + b
                    cosine = force_derivative[j, offset, b]
                    if orders[position] == 0:
                        jacobian[i * size + offset, column] = real * cosine
                        continue
                    sine = force_derivative[j, offset + 1, b]
                    jacobian[i * size + offset, column] = real * cosine + imag * sine
                    jacobian[i * size + offset + 1, column] = real * sine - imag * cosine
    for row in range(count * size):
        jacobian[row, row] += 1.0


def harmonic_responses(
    impedance: ModalImpedance,
    basis: FourierBasis,
    angular_frequency: float,
    self_excitation: float,
    inputs: FloatArray,
    amplitudes: ComplexArray,
    skipped: int = -1,
) -> ComplexArray:
    """Amplitudes of all unknowns q, (n_orders, n), for complex input amplitudes (n_orders, p) on ``inputs``
    (n, p); zero at the position ``skipped``, where the self-excited mode may have no stiffness left."""
    result = np.zeros((basis.orders.size, impedance.shapes.shape[0]), dtype=np.complex128)
    modal_inputs = impedance.shapes.T @ inputs
    damping = impedance.damping - self_excitation * impedance.mass
    for position, order in enumerate(basis.orders):
        if position == skipped:
            continue
        s = 1j * order * angular_frequency
        given = modal_inputs @ amplitudes[position]
        if impedance.diagonal:
            modal = given / (np.diag(impedance.stiffness) + s * np.diag(damping) + s * s * np.diag(impedance.mass))
        elif impedance.ports.directions.shape[1]:
            modal = _solved(impedance, s, self_excitation, given)
        else:
            modal = np.linalg.solve(impedance.stiffness + s * damping + s * s * impedance.mass, given)
        result[position] = impedance.shapes @ modal
    return result


def _solved(impedance: ModalImpedance, s: complex, self_excitation: float, given: ComplexArray) -> ComplexArray:
    """Modal coordinates (N,) under forces (N,), by the ports."""
    ports, masses = impedance.ports, np.diag(impedance.mass)
    own = ports.stiffness + (ports.damping - self_excitation * masses) * s + masses * (s * s)
    over = ports.directions / own[:, None]
    between = ports.between_stiffness + s * ports.between_damping
    small = np.eye(len(between)) + between @ (ports.directions.T @ over)
    free = given / own
    result: ComplexArray = free - over @ np.linalg.solve(small, between @ (ports.directions.T @ free))
    return result
