"""Stability of forced periodic responses: Floquet multipliers of the variational equation over one period.

The variational equation is linear with periodic coefficients. A Jenkins element adds its slider as a state
ζ: while it sticks δg = k_t (δw − ζ) with constant ζ, while it slips δg = 0, and when slip ends at a turning
point ζ becomes δw there. Between the switching angles of friction and stops the coefficients are constant
unless smooth elements vary them; each step is a matrix exponential (exact, or the second-order exponential
midpoint rule with smooth elements).
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm

from nmt_rig.model.aft import LocalForces
from nmt_rig.model.forced_response import ForcedProblem, PeriodicResponse
from nmt_rig.model.fourier_basis import ComplexArray, FloatArray, IntArray
from nmt_rig.model.harmonic_balance import ModalImpedance
from nmt_rig.model.local_elements import element_response
from nmt_rig.model.piecewise_forces import corners, evaluate, jenkins_phases, level_crossing

TWO_PI = 2.0 * np.pi


@dataclass(frozen=True)
class FloquetStability:
    """Floquet multipliers of one periodic response at held drive.

    Attributes:
        multipliers: (m,) complex, largest magnitude first.
        tolerance: excess over one that counts as unstable.
    """

    multipliers: ComplexArray
    tolerance: float = 1e-6

    @property
    def stable(self) -> bool:
        """No multiplier leaves the unit circle."""
        return bool(np.abs(self.multipliers[0]) <= 1.0 + self.tolerance)


@dataclass(frozen=True)
class _Friction:
    """One Jenkins element that slips: sticking pieces [start, end] of the period and where slip ends."""

    coordinate: int
    stiffness: float
    sticking: list[tuple[float, float]]
    slip_ends: list[float]


def floquet_stability(
    problem: ForcedProblem, response: PeriodicResponse, steps: int = 512, tolerance: float = 1e-6
) -> FloquetStability:
    """Stability of a periodic response under its drive held constant.

    Args:
        problem: forced problem that gave the response.
        response: periodic response.
        steps: steps per period where smooth elements vary the coefficients (error of second order).
        tolerance: see ``FloquetStability``.
    """
    local, omega = problem.local, response.angular_frequency
    first_order = _first_order(problem.impedance)
    rows = local.directions @ problem.impedance.shapes
    springs, friction, contacts, events = _piecewise_schedule(local, response.local_displacement)
    smooth = local.kinds.size > 0
    if smooth:
        events.extend(TWO_PI * k / steps for k in range(steps))
    angles = np.unique(np.round(np.array([0.0, *events, TWO_PI]), 13))

    size, states = rows.shape[1], first_order.matrix.shape[0]
    inertial = first_order.inertial
    total = states + len(friction)
    displacement_rows = np.zeros((local.coordinates, total))
    displacement_rows[:, :size] = rows
    velocity_rows = np.zeros((local.coordinates, total))
    velocity_rows[:, size:states] = rows[:, inertial]
    input_columns = np.zeros((total, local.coordinates))
    input_columns[:states] = first_order.input_map @ rows.T

    generators = np.empty((angles.size - 1, total, total))
    for piece, (left, right) in enumerate(itertools.pairwise(angles)):
        middle = 0.5 * (left + right)
        matrix = np.zeros((total, total))
        matrix[:states, :states] = first_order.matrix
        stiffness = springs.copy()
        damping = np.zeros(local.coordinates)
        for coordinate, contact_stiffness, start, end in contacts:
            if start < middle < end:
                stiffness[coordinate] += contact_stiffness
        for index, element in enumerate(friction):
            if any(start < middle < end for start, end in element.sticking):
                stiffness[element.coordinate] += element.stiffness
                matrix[:, states + index] += element.stiffness * input_columns[:, element.coordinate]
        if smooth:
            for coordinate in range(local.coordinates):
                tangents = _smooth_tangents(local, response.local_displacement, coordinate, middle, omega)
                stiffness[coordinate] += tangents[0]
                damping[coordinate] += tangents[1]
        matrix -= input_columns @ (stiffness[:, None] * displacement_rows + damping[:, None] * velocity_rows)
        generators[piece] = matrix * ((right - left) / omega)
    monodromy = np.eye(total)
    for transition, right in zip(expm(generators), angles[1:], strict=True):
        monodromy = transition @ monodromy
        for index, element in enumerate(friction):
            if any(abs(right - end) < 1e-11 for end in element.slip_ends):
                monodromy[states + index] = displacement_rows[element.coordinate] @ monodromy
    multipliers = np.linalg.eigvals(monodromy).astype(np.complex128)
    return FloquetStability(multipliers[np.argsort(-np.abs(multipliers))], tolerance)


@dataclass(frozen=True)
class _FirstOrder:
    """ẏ = matrix y + input_map f with y = [η, η̇ of the inertial coordinates]; f modal force (row space of
    Z)."""

    matrix: FloatArray
    input_map: FloatArray
    inertial: IntArray


def _first_order(impedance: ModalImpedance) -> _FirstOrder:
    size = impedance.mass.shape[0]
    inertial = np.flatnonzero(np.diag(impedance.mass) > 0.5)
    massless = np.setdiff1d(np.arange(size), inertial)
    states = size + inertial.size
    matrix = np.zeros((states, states))
    input_map = np.zeros((states, size))
    velocity = size + np.arange(inertial.size)
    matrix[inertial, velocity] = 1.0
    # First-order coordinates (current): C_cc ẏ_c = −K_c η − C_ci η̇ + f_c.
    electrical = np.linalg.inv(impedance.damping[np.ix_(massless, massless)])
    matrix[np.ix_(massless, np.arange(size))] = -electrical @ impedance.stiffness[massless]
    matrix[np.ix_(massless, velocity)] = -electrical @ impedance.damping[np.ix_(massless, inertial)]
    input_map[np.ix_(massless, massless)] = electrical
    # Mass-normalised: η̈ = −K η − C η̇ − C_ic ẏ_c + f.
    coupling = impedance.damping[np.ix_(inertial, massless)]
    matrix[np.ix_(velocity, np.arange(size))] = -impedance.stiffness[inertial]
    matrix[np.ix_(velocity, velocity)] = -impedance.damping[np.ix_(inertial, inertial)]
    matrix[velocity] -= coupling @ matrix[massless]
    input_map[velocity, inertial] = 1.0
    input_map[velocity] -= coupling @ input_map[massless]
    return _FirstOrder(matrix, input_map, inertial)


def _piecewise_schedule(
    local: LocalForces, displacement: FloatArray
) -> tuple[FloatArray, list[_Friction], list[tuple[int, float, float, float]], list[float]]:
    """Always sticking stiffness per coordinate, slipping friction, contact pieces, all switching angles in
    [0, 2π]."""
    orders, offsets = local.basis.orders, local.basis.offsets
    springs = np.zeros(local.coordinates)
    friction: list[_Friction] = []
    contacts: list[tuple[int, float, float, float]] = []
    events: list[float] = []
    for i in range(local.coordinates):
        coefficients = np.ascontiguousarray(displacement[i])
        angles, values = corners(coefficients, orders, offsets, local.slope_basis)
        for stiffness, limit in local.jenkins[local.jenkins_start[i] : local.jenkins_start[i + 1]]:
            phases = jenkins_phases(coefficients, orders, offsets, angles, values, stiffness, limit)
            slips = phases[:, 1] != 0.0
            if not slips.any():
                springs[i] += stiffness
                continue
            sticking = [
                piece for left, end in zip(angles[:-1], phases[:, 0], strict=True) for piece in _wrapped(left, end)
            ]
            ends = [float(angle % TWO_PI) or TWO_PI for angle in angles[1:][slips]]
            friction.append(_Friction(i, float(stiffness), sticking, [round(end, 13) for end in ends]))
            events.extend(ends)
            events.extend(float(angle % TWO_PI) for angle in phases[:, 0])
        for stiffness, gap, side in local.contacts[local.contacts_start[i] : local.contacts_start[i + 1]]:
            for piece in _contact_pieces(local, coefficients, angles, values, float(gap), float(side)):
                contacts.append((i, float(stiffness), *piece))
                events.extend(piece)
    return springs, friction, contacts, events


def _contact_pieces(
    local: LocalForces,
    coefficients: FloatArray,
    angles: FloatArray,
    values: FloatArray,
    gap: float,
    side: float,
) -> list[tuple[float, float]]:
    pieces: list[tuple[float, float]] = []
    for p in range(angles.size - 1):
        left, right = float(angles[p]), float(angles[p + 1])
        before, after = side * values[p] - gap, side * values[p + 1] - gap
        if before <= 0.0 and after <= 0.0:
            continue
        if before < 0.0 or after < 0.0:
            crossing = level_crossing(
                coefficients,
                local.basis.orders,
                local.basis.offsets,
                left,
                right,
                bool(values[p + 1] > values[p]),
                side * gap,
            )
            left, right = (crossing, right) if before < 0.0 else (left, crossing)
        pieces.extend(_wrapped(left, right))
    return pieces


def _wrapped(left: float, right: float) -> list[tuple[float, float]]:
    """The interval brought into [0, 2π], in one or two pieces."""
    shift = TWO_PI * np.floor(left / TWO_PI)
    left, right = float(left - shift), float(right - shift)
    if right <= TWO_PI:
        return [(left, right)]
    return [(left, TWO_PI), (0.0, right - TWO_PI)]


def _smooth_tangents(
    local: LocalForces, displacement: FloatArray, coordinate: int, angle: float, omega: float
) -> tuple[float, float]:
    w, slope, _ = evaluate(displacement[coordinate], local.basis.orders, local.basis.offsets, angle)
    stiffness, damping = 0.0, 0.0
    for e in range(local.sampled_start[coordinate], local.sampled_start[coordinate + 1]):
        _, k, c, _ = element_response(int(local.kinds[e]), local.parameters[e], w, omega * slope, 0.0)
        stiffness += k
        damping += c
    return stiffness, damping
