"""Phase-resonant backbone of the real single-point drive, and the method's own extraction from it.

The fundamental drive-point force leads the displacement by 90° (paper eq. 7); its higher harmonics are what
exciter and structure make of them. The modal properties extracted from these responses (paper eqs. 3, 4, 9)
are what a perfect test
would measure: their distance to the EPMC is the error of the method, a test's distance to them the error of
the test.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_rig.model.continuation import Branch, follow_branch, solve_at_parameter
from nmt_rig.model.forced_response import ForcedProblem, PeriodicResponse
from nmt_rig.model.rest_response import RestResponse

# Half width of the search for a linear phase resonance, relative to the reference frequency.
_BAND = 0.3
# Relative distance at which the ports' resonance is checked by the system's own solution.
_NEAR = 1e-6


@dataclass(frozen=True)
class ExtractedMode:
    """Modal properties of phase-resonant responses, by the method's equations.

    Attributes:
        drive_amplitude: (k,) drive, V with a shaker, else N.
        modal_amplitude: (k,) q from the estimated mass matrix, m√kg.
        omega_rad_s: (k,) ω̃, rad/s.
        damping_ratio: (k,) δ̃.
        force_n: (k,) |F_1|, N.
        pbmif: (k,) |P| / S over all harmonics.
        gamma_force, gamma_acceleration: (k,) fundamental content of force and drive-point acceleration.
        participation: (k, modes) complex Γ = Φ⁺ φ̃₁, phase relative to the drive-point displacement.
        full_modal_amplitude: (k,) q from the true mass matrix of the structure, m√kg.
        exact_damping_ratio: (k,) δ̃ from P₁ with the true mass matrix.
    """

    drive_amplitude: FloatArray
    modal_amplitude: FloatArray
    omega_rad_s: FloatArray
    damping_ratio: FloatArray
    force_n: FloatArray
    pbmif: FloatArray
    gamma_force: FloatArray
    gamma_acceleration: FloatArray
    participation: ComplexArray
    full_modal_amplitude: FloatArray
    exact_damping_ratio: FloatArray


@dataclass(frozen=True)
class PhaseResonantBackbone:
    """Phase-resonant responses at the requested drive amplitudes.

    Attributes:
        responses: one per drive amplitude reached (first crossing where the branch folds).
        branch: the continuation's own points; the parameter is log10 of the drive amplitude.
    """

    responses: tuple[PeriodicResponse, ...]
    branch: Branch

    @property
    def omega_rad_s(self) -> FloatArray:
        """(k,) phase-resonant frequencies, rad/s."""
        return np.array([response.angular_frequency for response in self.responses])

    @property
    def single_valued(self) -> bool:
        """The drive amplitude grows along the whole branch, up to the highest one requested."""
        return self.branch.single_valued


class _Quadrature:
    """z = [local, ω / ω_ref, log10 u] with Re(F_1 conj(x_1)) = 0 at the drive point."""

    def __init__(self, problem: ForcedProblem) -> None:
        self.problem = problem

    def __call__(self, z: FloatArray) -> tuple[FloatArray, FloatArray]:
        n = z.size - 2
        reference = self.problem.reference_frequency
        residual, jacobian, drive_point, slopes = self.problem.evaluate(z[:n], z[n] * reference, z[n + 1])
        displacement, force = drive_point
        power = force * np.conj(displacement)
        power_slopes = slopes[1] * np.conj(displacement) + force * np.conj(slopes[0])
        size = abs(power)
        size_slopes = (np.conj(power) * power_slopes).real / size
        condition = power.real / size
        condition_slopes = power_slopes.real / size - power.real * size_slopes / size**2
        full = np.vstack((jacobian, condition_slopes))
        full[:, n] *= reference
        return np.append(residual, condition), full

    def response(self, z: FloatArray) -> PeriodicResponse:
        return self.problem.response(z[:-2], z[-2] * self.problem.reference_frequency, z[-1])


def linear_phase_resonance(problem: ForcedProblem) -> float:
    """Frequency (rad/s) nearest to the reference where the system linearised at rest is in phase resonance.

    Args:
        problem: forced problem; its reference frequency is the middle of the search.

    Raises:
        BenchError: force and displacement are nowhere in quadrature there, e.g. with the drive near a node.
    """
    from scipy.optimize import brentq  # late: half a second that a plant does without

    system, reference = problem.system, problem.reference_frequency

    def quadrature(omega: float) -> float:
        unknowns, force = system.response(omega)
        return float((force * np.conj(system.motion(system.drive_point, unknowns))).real)

    grid = reference * np.linspace(1.0 - _BAND, 1.0 + _BAND, 1201)
    response = RestResponse.of(system, problem.with_every_port)
    if response is not None:

        def fast(frequencies: FloatArray) -> FloatArray:
            displacement, force = response(frequencies)
            return np.asarray((force * np.conj(displacement)).real, dtype=np.float64)

        bracket = _falling_bracket(grid, fast(grid), reference)
        if bracket is not None:
            near = float(brentq(lambda omega: float(fast(np.array([omega]))[0]), *bracket, xtol=1e-10 * reference))
            # The system's own solution decides, next to what the ports give; it is straight there.
            low, high = near * (1.0 - _NEAR), near * (1.0 + _NEAR)
            above, below = quadrature(low), quadrature(high)
            if above > 0.0 >= below:
                return low + (high - low) * above / (above - below)
    values = np.array([quadrature(omega) for omega in grid])
    bracket = _falling_bracket(grid, values, reference)
    if bracket is None:
        raise BenchError(
            f"no phase resonance near {reference / (2.0 * np.pi):.4g} Hz with the drive at point "
            f"{system.drive_point}: the point lies near a node of the mode; drive another point."
        )
    return float(brentq(quadrature, *bracket, xtol=1e-10 * reference))


def _falling_bracket(grid: FloatArray, values: FloatArray, reference: float) -> tuple[float, float] | None:
    """Neighbours on a grid between which Re F x̄ falls through zero, nearest to the reference; None if nowhere."""
    # The inertia takes over above a resonance (Re F x̄ falls through zero), the stiffness above an
    # antiresonance.
    falling = np.flatnonzero((values[:-1] > 0.0) & (values[1:] <= 0.0))
    if falling.size == 0:
        return None
    nearest = falling[np.argmin(np.abs(grid[falling] - reference))]
    return float(grid[nearest]), float(grid[nearest + 1])


def phase_resonant_backbone(
    problem: ForcedProblem,
    drive_amplitudes: Sequence[float] | FloatArray,
    skip_unreached: bool = False,
) -> PhaseResonantBackbone:
    """Follow phase resonance from low drive upwards and evaluate it at the given drive amplitudes.

    Args:
        problem: forced problem whose reference frequency is the sticking linear frequency of the mode.
        drive_amplitudes: (k,) positive and ascending; the smallest should lie in the linear range.
        skip_unreached: leave out drive amplitudes beyond a fold of the branch instead of raising.

    Raises:
        BenchError: amplitudes not positive and ascending, no phase resonance in the linear range, or an
            amplitude that the branch does not reach.
        NotConvergedError: phase resonance could not be followed.
    """
    drives = np.asarray(drive_amplitudes, dtype=np.float64)
    if drives.size == 0 or not np.all(np.isfinite(drives)) or drives[0] <= 0.0 or np.any(np.diff(drives) <= 0.0):
        raise BenchError("drive amplitudes must be positive, ascending and different; check the levels.")
    system = _Quadrature(problem)
    logs = np.log10(drives)
    resonance = linear_phase_resonance(problem)
    ratio = resonance / problem.reference_frequency
    guess = np.concatenate((problem.linear_start(resonance), [ratio, logs[0]]))
    start = solve_at_parameter(system, guess, what="phase resonance")
    if logs.size == 1:
        branch = Branch(start[None, :], np.zeros((1, start.size)), True)
        return PhaseResonantBackbone((system.response(start),), branch)
    branch = follow_branch(system, start, float(logs[-1]) + 1e-9, what="phase-resonant backbone")
    highest = float(branch.points[:, -1].max())
    if logs[-1] > highest and not skip_unreached:
        raise BenchError(
            f"phase resonance folds back at a drive amplitude of {10.0**highest:.4g} and does not reach "
            f"{drives[-1]:.4g}; lower the highest level."
        )
    solutions = [start]
    for value in logs[1:][logs[1:] <= highest]:
        solutions.append(solve_at_parameter(system, branch.at_parameter(float(value)), what="phase resonance"))
    return PhaseResonantBackbone(tuple(system.response(z) for z in solutions), branch)


def estimated_mass(linear_shapes: FloatArray) -> FloatArray:
    """M_exp = (Φᵀ)⁺ Φ⁺ (paper eq. 10) of mass-normalised shapes Φ (sensors, modes); (sensors, sensors),
    kg."""
    inverse = np.linalg.pinv(linear_shapes)
    result: FloatArray = inverse.T @ inverse
    return result


def extract_mode(
    problem: ForcedProblem,
    responses: Sequence[PeriodicResponse],
    sensor_points: Sequence[int],
    linear_shapes: FloatArray,
    structure_mass: FloatArray,
) -> ExtractedMode:
    """Modal properties of phase-resonant responses from a few sensors, as a test would extract them.

    Args:
        problem: forced problem the responses belong to.
        responses: phase-resonant periodic responses.
        sensor_points: (sensors,) point numbers of the response sensors.
        linear_shapes: (sensors, modes) mass-normalised linear shapes Φ at these points, 1/√kg.
        structure_mass: (n_s, n_s) mass matrix of the structure alone, kg.

    Raises:
        BenchError: shapes and sensors do not fit together.
    """
    if linear_shapes.shape[0] != len(sensor_points):
        raise BenchError(
            f"{len(sensor_points)} sensor points but linear shapes of {linear_shapes.shape[0]} points; "
            "give one row of shapes per sensor."
        )
    system = problem.system
    mass = estimated_mass(linear_shapes)
    inverse = np.linalg.pinv(linear_shapes)
    fundamental = problem.basis.fundamental
    orders = problem.basis.orders
    count, modes = len(responses), linear_shapes.shape[1]
    columns = {
        name: np.empty(count)
        for name in (
            "drive_amplitude",
            "modal_amplitude",
            "omega_rad_s",
            "damping_ratio",
            "force_n",
            "pbmif",
            "gamma_force",
            "gamma_acceleration",
            "full_modal_amplitude",
            "exact_damping_ratio",
        )
    }
    participation = np.empty((count, modes), dtype=np.complex128)
    size = structure_mass.shape[0]
    oscillating = orders > 0
    for k, response in enumerate(responses):
        omega = response.angular_frequency
        unknowns = response.unknowns.T
        shape = np.array([system.motion(point, unknowns[:, fundamental]) for point in sensor_points])
        drive = system.motion(system.drive_point, unknowns)
        velocity = 1j * orders * omega * drive
        acceleration = 1j * orders * omega * velocity
        force = response.force
        # Paper eqs. 8 and 9: power of the fundamental, and of all harmonics for the PBMIF.
        power = 0.5 * float((velocity[fundamental] * np.conj(force[fundamental])).real)
        active = 0.5 * float(np.sum(velocity * np.conj(force)).real)
        apparent = 0.5 * float(np.linalg.norm(velocity[oscillating]) * np.linalg.norm(force[oscillating]))
        square = float((np.conj(shape) @ mass @ shape).real)
        full = response.unknowns[fundamental, :size]
        full_square = float((np.conj(full) @ structure_mass @ full).real)
        columns["drive_amplitude"][k] = response.drive_amplitude
        columns["modal_amplitude"][k] = np.sqrt(square)
        columns["omega_rad_s"][k] = omega
        columns["damping_ratio"][k] = power / (omega**3 * square)
        columns["force_n"][k] = abs(force[fundamental])
        columns["pbmif"][k] = abs(active) / apparent
        columns["gamma_force"][k] = abs(force[fundamental]) / np.linalg.norm(force[oscillating])
        columns["gamma_acceleration"][k] = abs(acceleration[fundamental]) / np.linalg.norm(acceleration[oscillating])
        columns["full_modal_amplitude"][k] = np.sqrt(full_square)
        columns["exact_damping_ratio"][k] = power / (omega**3 * full_square)
        phase = drive[fundamental] / abs(drive[fundamental])
        participation[k] = inverse @ (shape / phase) / np.sqrt(square)
    return ExtractedMode(participation=participation, **columns)
