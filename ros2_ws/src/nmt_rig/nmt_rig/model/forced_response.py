"""Forced periodic responses by harmonic balance: the drive is a force, or a voltage through the shaker.

The drive is a pure tone u cos(ω t); with a shaker the stinger force follows from the motion, higher
harmonics included.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.numerics.arrays import ComplexArray, FloatArray, IntArray
from nmt_core.numerics.kernels import njit
from nmt_rig.model.aft import LocalForces, LocalTables, scaled_local_forces
from nmt_rig.model.assembly import ElectromechanicalSystem
from nmt_rig.model.continuation import Branch, StepControl, follow_branch, solve_at_parameter
from nmt_rig.model.exciter import Exciter
from nmt_rig.model.fourier_basis import FourierBasis
from nmt_rig.model.harmonic_balance import (
    ModalImpedance,
    ModalTables,
    OutputTables,
    harmonic_responses,
    local_balance,
    transfer_matrices,
)


@dataclass(frozen=True)
class PeriodicResponse:
    """One periodic response.

    Attributes:
        angular_frequency: ω, rad/s.
        drive_amplitude: u, V with a shaker, else N.
        orders: (n_orders,) harmonic orders.
        unknowns: (n_orders, n) complex amplitudes of all unknowns q of the system (m, A).
        force: (n_orders,) complex amplitudes of the force on the structure at the drive point, N.
        local_displacement: (r, size) real Fourier coefficients of the local coordinates, m.
    """

    angular_frequency: float
    drive_amplitude: float
    orders: IntArray
    unknowns: ComplexArray
    force: ComplexArray
    local_displacement: FloatArray


class ForcedProblem:
    """Harmonic balance of structure, local elements and exciter under a tone at the drive.

    The scaled unknowns are w_n / (compliance · u), coordinate by coordinate, with the compliance (m/V or
    m/N) of the linear system at ``reference_frequency``.

    Args:
        system: structure with its local elements, with or without shaker.
        basis: harmonic orders.
        reference_frequency: rad/s, scales ω and the displacements; usually the linear frequency of the mode.

    Raises:
        BenchError: the reference frequency is not positive, or the system has forces that harmonic balance does not
            cover (couplings, nonlinear elements behind the force sensor).
    """

    def __init__(
        self,
        system: ElectromechanicalSystem,
        basis: FourierBasis,
        reference_frequency: float,
    ) -> None:
        if not (np.isfinite(reference_frequency) and reference_frequency > 0.0):
            raise BenchError(f"the reference frequency must be positive, got {reference_frequency} rad/s.")
        if system.couplings:
            raise BenchError(
                "harmonic balance does not cover forces of two arguments: a varying force factor, Bouc-Wen or LuGre "
                "friction; leave them out of the model."
            )
        if any(system.on_exciter):
            raise BenchError(
                "harmonic balance does not cover nonlinear elements on the side of the exciter; put them on the side "
                "of the structure or leave them out."
            )
        self.system = system
        self.basis = basis
        self.reference_frequency = float(reference_frequency)
        self.local = LocalForces.gather(system.elements, basis, system.selector(system.drive_point))
        self.with_every_port = ModalImpedance.with_every_port(system)
        self.impedance = self.with_every_port.worthwhile()
        shapes = self.impedance.shapes
        displacement, velocity, acceleration = force_rows(system)
        r = self.local.coordinates
        inputs = np.column_stack((self.local.directions.T, system.input_vector))
        self.input_columns: FloatArray = inputs
        self._inputs = np.ascontiguousarray(shapes.T @ inputs)
        nothing = np.zeros((r + 1, system.size))
        position_rows = np.vstack((self.local.directions, system.selector(system.drive_point)))
        rows = [
            np.ascontiguousarray(np.vstack((own, force_row)) @ shapes)
            for own, force_row in ((position_rows, displacement), (nothing, velocity), (nothing, acceleration))
        ]
        feedthrough = np.zeros((r + 2, r + 1))
        feedthrough[r + 1, r] = system.force.feedthrough
        self._outputs = OutputTables(rows[0], rows[1], rows[2], feedthrough)

        amplitudes, _ = system.response(self.reference_frequency)
        compliance = float(np.max(np.abs(self.local.directions @ amplitudes)))
        self.compliance = compliance if compliance > 0.0 else 1.0

    def linear_start(self, angular_frequency: float) -> FloatArray:
        """Scaled local unknowns of the system linearised at rest, at ω (rad/s)."""
        amplitudes, _ = self.system.response(angular_frequency)
        local = np.zeros((self.local.coordinates, self.basis.orders.size), dtype=np.complex128)
        local[:, self.basis.fundamental] = self.local.directions @ amplitudes / self.compliance
        return self.basis.to_real(local).ravel()

    def evaluate(
        self, local: FloatArray, angular_frequency: float, log_drive: float
    ) -> tuple[FloatArray, FloatArray, ComplexArray, ComplexArray]:
        """Residual of the local balance and the fundamental at the drive point.

        Args:
            local: (r · size,) scaled local unknowns.
            angular_frequency: ω, rad/s.
            log_drive: log10 u.

        Returns:
            residual (r · size,); its Jacobian (r · size, r · size + 2) with respect to the local unknowns, ω
            and log10 u; [x_1, F_1] / (compliance · u) of the drive point (2,), and their Jacobian (2, r ·
            size + 2).
        """
        result: tuple[FloatArray, FloatArray, ComplexArray, ComplexArray] = _forced_residual(
            local,
            angular_frequency,
            log_drive,
            self.compliance,
            self.impedance.tables,
            self._inputs,
            self._outputs,
            self.basis.fundamental,
            self.local.tables,
        )
        return result

    def response(self, local: FloatArray, angular_frequency: float, log_drive: float) -> PeriodicResponse:
        """All unknowns and the drive-point force of a solution (scaled local unknowns, ω, log10 u)."""
        drive = 10.0**log_drive
        displacement = local.reshape(self.local.coordinates, self.basis.size) * self.compliance * drive
        force = self.local.forces(displacement, angular_frequency)[0]
        inputs = np.zeros((self.basis.orders.size, self.local.coordinates + 1), dtype=np.complex128)
        inputs[:, :-1] = -self.basis.to_complex(force).T
        inputs[self.basis.fundamental, -1] = drive
        unknowns = harmonic_responses(self.impedance, self.basis, angular_frequency, 0.0, self.input_columns, inputs)
        rows = force_rows(self.system)
        s = 1j * self.basis.orders * angular_frequency
        stinger = unknowns @ rows[0] + s * (unknowns @ rows[1]) + s**2 * (unknowns @ rows[2])
        stinger = stinger + self.system.force.feedthrough * inputs[:, -1]
        return PeriodicResponse(float(angular_frequency), drive, self.basis.orders, unknowns, stinger, displacement)


def force_rows(
    system: ElectromechanicalSystem, exciter: Exciter | None = None
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Displacement, velocity and acceleration rows (n,) of an exciter's force, of the first unless one is given.

    With a shaker the coil's equation of motion is subtracted: the force then follows from current and
    inertia instead of the tiny deformation of the coil's stiff suspension, which would cost six digits.
    """
    port = exciter or system.exciters[0]
    output, coil = port.force, port.coil
    if coil is None:
        return output.displacement, output.velocity, output.acceleration
    return (
        output.displacement - system.stiffness[coil],
        output.velocity - system.damping[coil],
        output.acceleration - system.mass[coil],
    )


@njit(cache=True)
def _forced_residual(
    local_unknowns: FloatArray,
    omega: float,
    log_drive: float,
    compliance: float,
    linear: ModalTables,
    inputs: FloatArray,
    outputs: OutputTables,
    fundamental: int,
    tables: LocalTables,
) -> tuple[FloatArray, FloatArray, ComplexArray, ComplexArray]:
    """Compiled body of ``ForcedProblem.evaluate``."""
    orders, offsets = tables.orders, tables.offsets
    r = inputs.shape[1] - 1
    local = local_unknowns.size
    size = local // r
    amplitude = compliance * 10.0**log_drive
    displacement = local_unknowns.copy().reshape(r, size)
    forces = scaled_local_forces(displacement, amplitude, omega, tables)
    force, derivative, by_frequency, by_scale = forces

    transfers = transfer_matrices(omega, 0.0, orders, linear, inputs, outputs, 0j, -1)
    residual = np.zeros(local)
    jacobian = np.zeros((local, local + 2))
    local_balance(displacement, forces, transfers, orders, offsets, residual, jacobian, local, -1, local + 1)
    offset = offsets[fundamental]
    t, t_omega = transfers.transfer[fundamental], transfers.by_frequency[fundamental]
    for i in range(r):
        row = i * size + offset
        residual[row] -= t[i, r].real / compliance
        residual[row + 1] += t[i, r].imag / compliance
        jacobian[row, local] -= t_omega[i, r].real / compliance
        jacobian[row + 1, local] += t_omega[i, r].imag / compliance

    drive_point = np.zeros(2, dtype=np.complex128)
    drive_point_jacobian = np.zeros((2, local + 2), dtype=np.complex128)
    for k in range(2):
        i = r + k
        drive_point[k] = t[i, r] / compliance
        drive_point_jacobian[k, local] = t_omega[i, r] / compliance
        for j in range(r):
            g = force[j, offset] - 1j * force[j, offset + 1]
            g_omega = by_frequency[j, offset] - 1j * by_frequency[j, offset + 1]
            g_scale = by_scale[j, offset] - 1j * by_scale[j, offset + 1]
            drive_point[k] -= t[i, j] * g
            drive_point_jacobian[k, local] -= t_omega[i, j] * g + t[i, j] * g_omega
            drive_point_jacobian[k, local + 1] -= t[i, j] * g_scale
            for b in range(size):
                change = derivative[j, offset, b] - 1j * derivative[j, offset + 1, b]
                drive_point_jacobian[k, j * size + b] -= t[i, j] * change
    return residual, jacobian, drive_point, drive_point_jacobian


class _DriveHeld:
    """z = [local, ω / span] at constant drive amplitude."""

    def __init__(self, problem: ForcedProblem, log_drive: float, span: float) -> None:
        self.problem, self.log_drive, self.span = problem, log_drive, span

    def __call__(self, z: FloatArray) -> tuple[FloatArray, FloatArray]:
        residual, jacobian, _, _ = self.problem.evaluate(z[:-1], z[-1] * self.span, self.log_drive)
        columns = jacobian[:, :-1].copy()
        columns[:, -1] *= self.span
        return residual, columns

    def start(self, omega: float) -> FloatArray:
        return np.concatenate((self.problem.linear_start(omega), [omega / self.span]))

    def response(self, z: FloatArray) -> PeriodicResponse:
        return self.problem.response(z[:-1], z[-1] * self.span, self.log_drive)


class _ForceHeld:
    """z = [local, log10 u, ω / span] at constant amplitude of the fundamental force.

    The local unknowns are scaled by the drive, so log10 u follows them over decades without loss of scale.
    """

    def __init__(self, problem: ForcedProblem, force: float, span: float) -> None:
        self.problem, self.span = problem, span
        self.log_force = np.log10(force / problem.compliance)

    def __call__(self, z: FloatArray) -> tuple[FloatArray, FloatArray]:
        n = z.size - 2
        residual, jacobian, drive_point, drive_jacobian = self.problem.evaluate(z[:n], z[-1] * self.span, z[n])
        force = drive_point[1]
        condition = np.log10(abs(force)) + z[n] - self.log_force
        slope = (np.conj(force) * drive_jacobian[1]).real / (abs(force) ** 2 * np.log(10.0))
        slope[n + 1] += 1.0
        full = np.vstack((jacobian, slope))
        full = full[:, [*range(n), n + 1, n]]
        full[:, -1] *= self.span
        return np.append(residual, condition), full

    def start(self, omega: float) -> FloatArray:
        _, unit_force = self.problem.system.response(omega)
        log_drive = self.log_force + np.log10(self.problem.compliance) - np.log10(abs(unit_force))
        return np.concatenate((self.problem.linear_start(omega), [log_drive, omega / self.span]))

    def response(self, z: FloatArray) -> PeriodicResponse:
        return self.problem.response(z[:-2], z[-1] * self.span, z[-2])


@dataclass(frozen=True)
class FrequencyResponse:
    """Branch of periodic responses over the frequency, in order along the arc (folds included).

    Attributes:
        responses: the periodic responses.
        branch: points of the continuation; the parameter is ω / ``span``.
        span: rad/s.
        system: what the branch was followed on, called by ``at``.
    """

    responses: tuple[PeriodicResponse, ...]
    branch: Branch
    span: float
    system: _DriveHeld | _ForceHeld

    @property
    def omega_rad_s(self) -> FloatArray:
        """(k,) excitation frequencies, rad/s."""
        return np.array([response.angular_frequency for response in self.responses])

    def amplitudes(self, index: int, order: int = 1) -> ComplexArray:
        """(k,) complex amplitudes of the unknown ``index`` in one harmonic order."""
        position = int(np.flatnonzero(self.responses[0].orders == order)[0])
        return np.array([response.unknowns[position, index] for response in self.responses])

    def at_point(self, point: int, order: int = 1) -> ComplexArray:
        """(k,) complex amplitudes of the displacement of a point in one harmonic order, m.

        Raises:
            KeyError: no such point exists.
        """
        position = int(np.flatnonzero(self.responses[0].orders == order)[0])
        unknowns = np.array([response.unknowns[position] for response in self.responses])
        result: ComplexArray = self.system.problem.system.motion(point, unknowns.T)
        return result

    def force_amplitudes(self, order: int = 1) -> ComplexArray:
        """(k,) complex amplitudes of the drive-point force in one harmonic order, N."""
        position = int(np.flatnonzero(self.responses[0].orders == order)[0])
        return np.array([response.force[position] for response in self.responses])

    def at(self, omega: float) -> tuple[PeriodicResponse, ...]:
        """Every periodic response of the branch at the frequency ω (rad/s), in order along the arc."""
        return tuple(
            self.system.response(solve_at_parameter(self.system, guess, what="forced response"))
            for guess in self.branch.passages(omega / self.span)
        )


def frequency_response(
    problem: ForcedProblem,
    amplitude: float,
    start: float,
    stop: float,
    held: Literal["drive", "force"] = "drive",
    points: int = 200,
) -> FrequencyResponse:
    """Frequency response at constant drive (voltage or force at the drive) or constant stinger force.

    Args:
        problem: system and harmonic orders.
        amplitude: held amplitude: of the drive (V with a shaker, else N), or of the fundamental drive-point
            force (N).
        start, stop: first and last frequency, rad/s; upwards or downwards.
        held: which amplitude stays constant.
        points: the longest step is set so that a branch has about this many points.

    Raises:
        BenchError: amplitude or frequencies not positive, or equal frequencies.
        NotConvergedError: the branch could not be followed.
    """
    if not (np.isfinite(amplitude) and amplitude > 0.0):
        raise BenchError(f"the amplitude of a frequency response must be positive, got {amplitude}.")
    if not (start > 0.0 and stop > 0.0 and start != stop):
        raise BenchError(f"a frequency response needs two different positive frequencies, got {start} and {stop}.")
    span = abs(stop - start)
    system: _DriveHeld | _ForceHeld
    if held == "drive":
        system = _DriveHeld(problem, float(np.log10(amplitude)), span)
    else:
        system = _ForceHeld(problem, amplitude, span)
    control = StepControl(first_step=1.0 / points, largest_step=1.5 / points)
    first = solve_at_parameter(system, system.start(start), what="forced response")
    branch = follow_branch(system, first, stop / span, control, what="frequency response")
    return FrequencyResponse(tuple(system.response(z) for z in branch.points), branch, span, system)
