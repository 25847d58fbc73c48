"""Nonlinear modes of damped systems: extended periodic motion concept (EPMC) by harmonic balance.

Periodic solutions of M ẍ + C ẋ + K x + g(x, ẋ) − ξ M ẋ = 0 (paper eq. 2, method.md 1) as a function of the
modal amplitude q, q² = ψ̃₁ᴴ M ψ̃₁; δ̃ = ξ / (2 ω̃).

The fundamental of one modal coordinate, a = η_m, stays an unknown next to the local displacements: on Z_1 its
diagonal entry gets an artificial stiffness iκ whose force iκ a is handed back as input. Without it the
condensation would divide by zero where the local forces vanish (linear limit, full slip).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import eigh

from nmt_core.errors import BenchError
from nmt_core.numerics.arrays import ComplexArray, FloatArray, IntArray
from nmt_core.numerics.kernels import njit
from nmt_rig.model.aft import LocalForces, LocalTables, ScaledForces, scaled_local_forces
from nmt_rig.model.continuation import (
    Branch,
    NotConvergedError,
    follow_branch,
    solve_at_parameter,
)
from nmt_rig.model.fourier_basis import FourierBasis
from nmt_rig.model.harmonic_balance import (
    ModalImpedance,
    ModalTables,
    OutputTables,
    harmonic_responses,
    local_balance,
    modal_inverse,
    transfer_matrices,
)
from nmt_rig.model.linear_modes import without_rounding
from nmt_rig.model.local_elements.element import LocalElement
from nmt_rig.model.structure import Structure


@dataclass(frozen=True)
class EpmcBackbone:
    """Nonlinear mode as a function of the modal amplitude.

    Attributes:
        modal_amplitude: (k,) q, m√kg.
        omega_rad_s: (k,) ω̃, rad/s.
        damping_ratio: (k,) δ̃.
        orders: (n_orders,) harmonic orders of the shapes.
        normalised_shape: (k, n_orders, n) φ̃_n on all degrees of freedom, 1/√kg, with φ̃₁ᴴ M φ̃₁ = 1.
        branch: the continuation's own points.
        single_valued: q grows along the whole branch, up to the largest one requested.
    """

    modal_amplitude: FloatArray
    omega_rad_s: FloatArray
    damping_ratio: FloatArray
    orders: IntArray
    normalised_shape: ComplexArray
    branch: Branch
    single_valued: bool


class EpmcProblem:
    """EPMC residual of one structure with local elements.

    The unknown vector is z = [w_n / q (real coefficients, coordinate by coordinate), Re a / q, Im a / q, ω /
    ω_0, ξ / ω_0, log10 q] with ω_0 the sticking linear frequency.

    Args:
        structure: linear part, symmetric matrices.
        elements: local elements with directions of shape (n,).
        basis: harmonic orders.
        mode: number of the linear (sticking) mode the nonlinear mode starts from, from 0.

    Raises:
        BenchError: the structure has no such mode, or its matrices are not symmetric.
    """

    def __init__(
        self,
        structure: Structure,
        elements: Sequence[LocalElement],
        basis: FourierBasis,
        mode: int = 0,
    ) -> None:
        for name in ("mass", "damping", "stiffness"):
            matrix = getattr(structure, name)
            if not np.allclose(matrix, matrix.T, rtol=1e-9, atol=1e-12 * float(np.abs(matrix).max(initial=0.0))):
                raise BenchError(
                    f"the {name} matrix of the structure must be symmetric for the EPMC reference; check the rig file."
                )
        if not 0 <= mode < structure.size:
            raise BenchError(f"mode {mode + 1} does not exist: the structure has {structure.size} modes.")
        idle = np.zeros(structure.size)
        idle[0] = 1.0
        self.structure = structure
        self.basis = basis
        self.local = LocalForces.gather(elements, basis, idle)
        self.impedance = ModalImpedance.of(structure)

        stiffness, damping = structure.stiffness.copy(), structure.damping.copy()
        for element in elements:
            outer = np.outer(element.direction, element.direction)
            stiffness += element.linear_stiffness * outer
            damping += element.linear_damping * outer
        squares, vectors = eigh(stiffness, structure.mass)
        squares = without_rounding(squares, vectors, stiffness)
        # Without supports the mean position is not determined, and order 0 has no solution of its own.
        self.floats = bool(np.any(squares == 0.0) and 0 in basis.orders)
        if squares[mode] <= 0.0:
            raise BenchError(f"mode {mode + 1} is a rigid-body mode; choose an elastic mode for the reference.")
        self.linear_frequency = float(np.sqrt(squares[mode]))
        self.linear_shape: FloatArray = vectors[:, mode]
        participation = self.impedance.shapes.T @ structure.mass @ self.linear_shape
        self.retained_mode = int(np.argmax(np.abs(participation)))
        if participation[self.retained_mode] < 0.0:
            self.linear_shape = -self.linear_shape
            participation = -participation
        self._linear_amplitude = float(participation[self.retained_mode])
        self._linear_excitation = float(self.linear_shape @ damping @ self.linear_shape)
        self.shift = 2j * self.linear_frequency**2
        rows = np.zeros((self.local.coordinates + 1, len(self.impedance.mass)))
        rows[:-1] = self.local.directions @ self.impedance.shapes
        rows[-1, self.retained_mode] = 1.0
        nothing = np.zeros(rows.shape)
        self._inputs = np.ascontiguousarray(rows.T)
        self._rows = OutputTables(rows, nothing, nothing, np.zeros((len(rows), len(rows))))

    def linear_start(self, log_amplitude: float) -> FloatArray:
        """z of the sticking linear mode at log10 q."""
        r, size = self.local.coordinates, self.basis.size
        local = np.zeros((r, size))
        local[:, self.basis.offsets[self.basis.fundamental]] = self.local.directions @ self.linear_shape
        excitation = self._linear_excitation / self.linear_frequency
        return np.concatenate((local.ravel(), [self._linear_amplitude, 0.0, 1.0, excitation, log_amplitude]))

    def is_linear_at(self, log_amplitude: float) -> bool:
        """Whether the local forces of the sticking linear mode at log10 q are linear within 1 %."""
        r, size = self.local.coordinates, self.basis.size
        z = self.linear_start(log_amplitude)
        local = z[: r * size].reshape(r, size) * 10.0**log_amplitude
        force, _, _ = self.local.forces(local, self.linear_frequency)
        small = 1e-9
        expected = self.local.forces(local * small, self.linear_frequency)[0] / small
        scale = max(float(np.abs(expected).max()), self.linear_frequency**2 * 10.0**log_amplitude)
        return bool(np.abs(force - expected).max() <= 0.01 * scale)

    def __call__(self, z: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Residual (n,) and Jacobian (n, n + 1) at z (n + 1,)."""
        residual, jacobian, _ = self._evaluate(z)
        return residual, jacobian

    def _evaluate(self, z: FloatArray) -> tuple[FloatArray, FloatArray, ComplexArray]:
        """Residual, Jacobian and modal fundamental η_1 / q (n_modes,) at z."""
        result: tuple[FloatArray, FloatArray, ComplexArray] = _epmc_residual(
            z,
            self.linear_frequency,
            self.shift,
            self.retained_mode,
            self._inputs,
            self._rows,
            self.impedance.tables,
            self.basis.fundamental,
            self.local.tables,
        )
        return result

    def shapes_at(self, z: FloatArray) -> ComplexArray:
        """Normalised shape harmonics φ̃_n on all degrees of freedom, (n_orders, n), at a solution z."""
        r, size = self.local.coordinates, self.basis.size
        amplitude = 10.0 ** z[-1]
        omega, excitation = z[r * size + 2] * self.linear_frequency, z[r * size + 3] * self.linear_frequency
        force = self.local.forces(z[: r * size].reshape(r, size) * amplitude, omega)[0]
        amplitudes = self.basis.to_complex(-force / amplitude).T
        first = self.basis.fundamental
        shapes = harmonic_responses(
            self.impedance, self.basis, omega, excitation, self.local.directions.T, amplitudes, first
        )
        _, _, modal = self._evaluate(z)
        shapes[first] = self.impedance.shapes @ modal
        return shapes


class _Point(NamedTuple):
    """Where the residual is asked for.

    Attributes:
        local: number of local unknowns; behind them are Re a / q, Im a / q, ω, ξ and log10 q.
        size: coefficients of one coordinate.
        offset: of the fundamental among them.
        omega, excitation: ω and ξ, rad/s.
        fundamental: a / q of the retained mode.
    """

    local: int
    size: int
    offset: int
    omega: float
    excitation: float
    fundamental: complex


@njit(cache=True, forceinline=True)
def _phasor(coefficients: FloatArray, j: int, offset: int) -> complex:
    """Complex amplitude of the fundamental of coordinate j."""
    return complex(coefficients[j, offset] - 1j * coefficients[j, offset + 1])


@njit(cache=True)
def _add_forces_on_mode(
    point: _Point,
    t: ComplexArray,
    t_omega: ComplexArray,
    t_xi: ComplexArray,
    forces: ScaledForces,
    terms: tuple[complex, complex, complex],
    jacobian: FloatArray,
) -> tuple[complex, complex, complex]:
    """Take what the local forces do to the retained mode from three terms: its motion, and that by ω and by ξ.

    The derivatives by the local unknowns and log10 q are added to the Jacobian.
    """
    local, offset = point.local, point.offset
    term, term_omega, term_xi = terms
    force, by_displacement, by_frequency, by_scale = forces
    i = t.shape[0] - 1
    for j in range(i):
        g = _phasor(force, j, offset)
        g_omega = _phasor(by_frequency, j, offset)
        term -= t[i, j] * g
        term_omega -= t_omega[i, j] * g + t[i, j] * g_omega
        term_xi -= t_xi[i, j] * g
        scale = t[i, j] * _phasor(by_scale, j, offset)
        jacobian[local, local + 4] += scale.real
        jacobian[local + 1, local + 4] += scale.imag
        for b in range(point.size):
            change = t[i, j] * (by_displacement[j, offset, b] - 1j * by_displacement[j, offset + 1, b])
            jacobian[local, j * point.size + b] += change.real
            jacobian[local + 1, j * point.size + b] += change.imag
    return term, term_omega, term_xi


@njit(cache=True)
def _add_fundamental(
    point: _Point,
    shift: complex,
    t: ComplexArray,
    t_omega: ComplexArray,
    t_xi: ComplexArray,
    forces: ScaledForces,
    residual: FloatArray,
    jacobian: FloatArray,
) -> None:
    """Add to the fundamental what the retained modal coordinate does, and set that coordinate's two equations.

    Args:
        t, t_omega, t_xi: (r + 1, r + 1) transfer matrix of the fundamental, and that by ω and ξ.
    """
    local, a = point.local, point.fundamental
    r = t.shape[0] - 1
    fed_back = shift * a
    for i in range(r + 1):
        from_mode = t[i, r] * shift
        c_row = i * point.size + point.offset if i < r else local
        s_row = c_row + 1
        sine_sign = -1.0 if i < r else 1.0  # coefficients (c, s) of w against (real, imaginary) parts of a
        terms = (t[i, r] * fed_back, t_omega[i, r] * fed_back, t_xi[i, r] * fed_back)
        if i == r:
            terms = _add_forces_on_mode(point, t, t_omega, t_xi, forces, terms, jacobian)
            residual[c_row] += a.real
            residual[s_row] += a.imag
            jacobian[c_row, local] += 1.0
            jacobian[s_row, local + 1] += 1.0
        term, term_omega, term_xi = terms
        residual[c_row] -= term.real
        residual[s_row] -= sine_sign * term.imag
        jacobian[c_row, local + 2] -= term_omega.real
        jacobian[s_row, local + 2] -= sine_sign * term_omega.imag
        jacobian[c_row, local + 3] -= term_xi.real
        jacobian[s_row, local + 3] -= sine_sign * term_xi.imag
        jacobian[c_row, local] -= from_mode.real
        jacobian[s_row, local] -= sine_sign * from_mode.imag
        jacobian[c_row, local + 1] += from_mode.imag
        jacobian[s_row, local + 1] -= sine_sign * from_mode.real


@njit(cache=True)
def _set_modal_mass(
    point: _Point,
    shift: complex,
    retained_mode: int,
    local_rows: FloatArray,
    linear: ModalTables,
    forces: ScaledForces,
    residual: FloatArray,
    jacobian: FloatArray,
) -> ComplexArray:
    """Set the equation of the modal mass of the fundamental, η_1ᴴ η_1 = q²; returns η_1 / q (modes,)."""
    mass, damping, offset, excitation = linear.mass, linear.damping, point.offset, point.excitation
    force, by_displacement, by_frequency, by_scale = forces
    r, modes = local_rows.shape
    s = 1j * point.omega
    inverse = modal_inverse(s, excitation, shift, retained_mode, linear)
    forcing = np.zeros(modes, dtype=np.complex128)
    forcing[retained_mode] = shift * point.fundamental
    for j in range(r):
        g = _phasor(force, j, offset)
        for k in range(modes):
            forcing[k] -= local_rows[j, k] * g
    modal: ComplexArray = inverse @ forcing
    weights = np.conj(modal) @ inverse
    by_omega = 0j
    by_xi = 0j
    for k in range(modes):
        slope = 0j
        for m in range(modes):
            slope += (damping[k, m] - excitation * mass[k, m] + 2.0 * s * mass[k, m]) * modal[m]
        by_omega -= weights[k] * 1j * slope
        by_xi += weights[k] * s * modal[k]
    row, local, size = point.local + 2, point.local, point.size
    residual[row] = 0.5 * (np.sum(modal.real**2 + modal.imag**2) - 1.0)
    jacobian[row, local] = (weights[retained_mode] * shift).real
    jacobian[row, local + 1] = (weights[retained_mode] * shift * 1j).real
    for j in range(r):
        along = 0j
        for k in range(modes):
            along += weights[k] * local_rows[j, k]
        for b in range(size):
            change = by_displacement[j, offset, b] - 1j * by_displacement[j, offset + 1, b]
            jacobian[row, j * size + b] = jacobian[row, j * size + b] - (along * change).real
        by_omega -= along * _phasor(by_frequency, j, offset)
        jacobian[row, local + 4] -= (along * _phasor(by_scale, j, offset)).real
    jacobian[row, local + 2] = by_omega.real
    jacobian[row, local + 3] = by_xi.real
    return modal


@njit(cache=True)
def _epmc_residual(
    z: FloatArray,
    reference_frequency: float,
    shift: complex,
    retained_mode: int,
    inputs: FloatArray,
    rows: OutputTables,
    linear: ModalTables,
    fundamental: int,
    tables: LocalTables,
) -> tuple[FloatArray, FloatArray, ComplexArray]:
    """Residual, Jacobian and modal fundamental η_1 / q of the EPMC problem.

    Inputs and rows are the local coordinates and, behind them, the retained modal coordinate.
    """
    orders, offsets = tables.orders, tables.offsets
    local_rows = rows.displacement[:-1]
    r = local_rows.shape[0]
    unknowns = z.size - 1
    local = unknowns - 4
    omega, excitation = z[local + 2] * reference_frequency, z[local + 3] * reference_frequency
    a = z[local] + 1j * z[local + 1]
    point = _Point(local, local // r, offsets[fundamental], omega, excitation, a)
    displacement = z[:local].copy().reshape(r, point.size)
    forces = scaled_local_forces(displacement, 10.0 ** z[unknowns], omega, tables)
    transfers = transfer_matrices(omega, excitation, orders, linear, inputs, rows, shift, retained_mode)

    residual = np.zeros(unknowns)
    jacobian = np.zeros((unknowns, unknowns + 1))
    local_balance(displacement, forces, transfers, orders, offsets, residual, jacobian, local + 2, local + 3, unknowns)
    t, t_omega = transfers.transfer[fundamental], transfers.by_frequency[fundamental]
    t_xi = transfers.by_excitation[fundamental]
    _add_fundamental(point, shift, t, t_omega, t_xi, forces, residual, jacobian)
    modal = _set_modal_mass(point, shift, retained_mode, local_rows, linear, forces, residual, jacobian)

    # Phase of the motion: a is real.
    residual[local + 3] = a.imag
    jacobian[local + 3, local + 1] = 1.0

    # Derivatives with respect to the scaled frequencies.
    for row in range(unknowns):
        jacobian[row, local + 2] *= reference_frequency
        jacobian[row, local + 3] *= reference_frequency
    return residual, jacobian, modal


def epmc_backbone(
    structure: Structure,
    elements: Sequence[LocalElement],
    modal_amplitudes: FloatArray,
    basis: FourierBasis | None = None,
    mode: int = 0,
) -> EpmcBackbone:
    """Follow the nonlinear mode from its linear limit and evaluate it at given modal amplitudes.

    Args:
        structure, elements, mode: see ``EpmcProblem``.
        modal_amplitudes: (k,) positive, ascending q (m√kg).
        basis: harmonic orders; 0 … 7 when None.

    Raises:
        BenchError: amplitudes not positive and ascending.
        NotConvergedError: no solution found; the message says at which log10 q.
    """
    amplitudes = np.asarray(modal_amplitudes, dtype=np.float64)
    if amplitudes.size == 0 or not np.all(np.isfinite(amplitudes)) or amplitudes[0] <= 0.0:
        raise BenchError("modal amplitudes of the reference must be positive and finite; check the q range.")
    if np.any(np.diff(amplitudes) <= 0.0):
        raise BenchError("modal amplitudes of the reference must be ascending and different; check the q range.")
    basis = basis or FourierBasis.up_to(7)
    problem = EpmcProblem(structure, elements, basis, mode)
    logs = np.log10(amplitudes)
    first = float(logs[0])
    while not problem.is_linear_at(first) and first > logs[0] - 8.0:
        first -= 0.5
    try:
        start = solve_at_parameter(problem, problem.linear_start(first), what="nonlinear mode")
    except NotConvergedError as error:
        if not problem.floats:
            raise
        raise NotConvergedError(
            "the nonlinear mode of a structure that floats has no mean position; hold it by soft springs, as a rig "
            "hangs in its cords, or keep odd harmonics only."
        ) from error
    branch = follow_branch(problem, start, float(logs[-1]) + 1e-9, what="nonlinear mode")

    # First crossing of each amplitude; on a branch that folds in q the later ones are not reported.
    local = problem.local.coordinates * basis.size
    omega, excitation = np.empty(logs.size), np.empty(logs.size)
    shapes = np.empty((logs.size, basis.orders.size, structure.size), dtype=np.complex128)
    for k, value in enumerate(logs):
        guess = start if value == first else branch.at_parameter(float(value))
        z = solve_at_parameter(problem, guess, what="nonlinear mode")
        omega[k] = z[local + 2] * problem.linear_frequency
        excitation[k] = z[local + 3] * problem.linear_frequency
        shapes[k] = problem.shapes_at(z)
    return EpmcBackbone(
        modal_amplitude=amplitudes,
        omega_rad_s=omega,
        damping_ratio=excitation / (2.0 * omega),
        orders=basis.orders,
        normalised_shape=shapes,
        branch=branch,
        single_valued=branch.single_valued,
    )
