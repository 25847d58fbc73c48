"""Ports of piecewise linear elements at many places: which are active, and the equations of those that are.

What follows from the branches of the elements alone, of :mod:`nmt_rig.model.contact_kernel`: the forces of the ports at
rest, which are constants, and factors of the equations of the others for every step width.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nmt_core.numerics.kernels import loop_step, njit
from nmt_rig.model.element_kernels import piece
from nmt_rig.model.integration_kernel import _XX, _XY, _YX, _YY, JENKINS, Integers, PortMemory
from nmt_rig.model.structure import Array

# First rows of `Motion.holds` for forces at the start and at the end of a step, and their columns.
AT_START, AT_END = 0, 2
# Sums may be taken several terms at a time, in an order that the compiler fixes once for all.
_IN_LANES = {"reassoc", "contract"}


class SampleMotion(NamedTuple):
    """The linear motion between the samples.

    Attributes:
        pair, start_weights, port_rows: of the `Propagator`.
        holds: (K+1, 4, 4, pairs) blocks that take the projected forces and slopes at the start, then at the end of a
            step to the state.
        projection: (ports, Z) of port forces on the working coordinates' rates.
        answers: (K+1, 2 ports, 2 ports) the propagator's compliance of displacements and velocities, transposed.
        reach: (Z,) largest |share| of each working coordinate in the ports' displacements.
        gains: (K+1,) largest share of a change of the ports' forces that it causes again by the end of a step; where it
            is small a fixed-point iteration finds the forces, else they are factorised.
        step: of the integration, s.
    """

    pair: Array
    start_weights: Array
    port_rows: Array
    holds: Array
    projection: Array
    answers: Array
    reach: Array
    gains: Array
    step: float


class Places(NamedTuple):
    """Elements and the ports that they act at.

    Attributes:
        kinds, parameters: (elements,), (elements, PARAMETER_COUNT).
        absorbed: (elements,) stiffness that is part of the linear motion, N/m.
        element_port: (elements,) port of each element.
        port_start, port_elements: (ports + 1,), (elements,) elements of each port.
    """

    kinds: Integers
    parameters: Array
    absorbed: Array
    element_port: Integers
    port_start: Integers
    port_elements: Integers


class Active(NamedTuple):
    """What follows from the branches alone.

    Attributes:
        stiffness, constant: (ports,) of the elements, N/m and N.
        ports: (ports,) its beginning: those that have to be solved for.
        place: (ports,) of each port among them, −1 = at rest.
        steady: (Z,) projected forces of the ports at rest.
        steady_step: (K+1, Z) what they do in a step of each width.
        columns, order: (K+1, 2 ports, 2 ports), (K+1, 2 ports) factors of the equations of the active ports.
        known: (K+1,) whether the last three are.
    """

    stiffness: Array
    constant: Array
    ports: Integers
    place: Integers
    steady: Array
    steady_step: Array
    columns: Array
    order: Integers
    known: NDArray[np.bool_]


class Trial(NamedTuple):
    """A sub-step that may be refused.

    Attributes:
        state: (Z,) at its end.
        w, v: (ports,) displacement and velocity there.
        forces: (2 ports,) forces and slopes there.
        due: (ports,) the way from its end at which a port that was looked at is to be looked at again.
        looked: (ports,) its beginning: resting ports that were looked at.
        turned: (ports,) where a branch does not fit the end.
        own, own_slope, next_own, next_slope: (Z,) projected forces and slopes at the start and at the end.
        free, seen: (2 ports,) displacements and velocities without and with the forces at the end.
        right: (2 ports,) forces and slopes of the active ports.
        change: (ports,) of a sweep.
    """

    state: Array
    w: Array
    v: Array
    forces: Array
    due: Array
    looked: Integers
    turned: NDArray[np.bool_]
    own: Array
    own_slope: Array
    next_own: Array
    next_slope: Array
    free: Array
    seen: Array
    right: Array
    change: Array


@njit(cache=True, fastmath=_IN_LANES)
def row_product(matrix: Array, row: int, vector: Array, size: int) -> float:
    """matrix[row] · vector over the leading `size` entries, always summed in the same order."""
    total = 0.0
    for i in range(size):
        total += matrix[row, i] * vector[i]
    return total


@njit(cache=True, fastmath=_IN_LANES)
def project(projection: Array, active: Integers, count: int, forces: Array, own: Array, own_slope: Array) -> None:
    """Overwrite `own` and `own_slope` (Z,) with the active ports' forces and slopes on the working coordinates."""
    size = own.size
    ports = projection.shape[0]
    for i in range(size):
        own[i] = 0.0
        own_slope[i] = 0.0
    for a in range(0, count - 3, 4):
        q0, q1, q2, q3 = active[a], active[a + 1], active[a + 2], active[a + 3]
        g0, g1, g2, g3 = forces[q0], forces[q1], forces[q2], forces[q3]
        s0, s1, s2, s3 = forces[ports + q0], forces[ports + q1], forces[ports + q2], forces[ports + q3]
        for i in range(size):
            p0, p1, p2, p3 = projection[q0, i], projection[q1, i], projection[q2, i], projection[q3, i]
            own[i] += (g0 * p0 + g1 * p1) + (g2 * p2 + g3 * p3)
            own_slope[i] += (s0 * p0 + s1 * p1) + (s2 * p2 + s3 * p3)
    for a in range(count - count % 4, count):
        q = active[a]
        g = forces[q]
        slope = forces[ports + q]
        for i in range(size):
            own[i] += g * projection[q, i]
            own_slope[i] += slope * projection[q, i]


@njit(cache=True)
def factorise(matrix: Array, order: Integers, n: int) -> None:
    """LU factors of the leading n x n part in place, partial pivoting; `order` is overwritten with the rows' swaps."""
    for i in range(n):
        pivot = i
        for r in range(i + 1, n):
            if abs(matrix[r, i]) > abs(matrix[pivot, i]):
                pivot = r
        order[i] = pivot
        if pivot != i:
            for c in range(n):
                swap = matrix[i, c]
                matrix[i, c] = matrix[pivot, c]
                matrix[pivot, c] = swap
        for r in range(i + 1, n):
            factor = matrix[r, i] / matrix[i, i]
            matrix[r, i] = factor
            if factor != 0.0:
                for c in range(i + 1, n):
                    matrix[r, c] -= factor * matrix[i, c]


@njit(cache=True)
def solve_factored(columns: Array, level: int, order: Integers, right: Array, n: int) -> None:
    """Solve with the factors of `factorise`, given by columns; the solution replaces `right`."""
    for i in range(n):
        pivot = order[level, i]
        if pivot != i:
            value = right[i]
            right[i] = right[pivot]
            right[pivot] = value
    for i in range(n):
        value = right[i]
        for r in range(i + 1, n):
            right[r] -= columns[level, i, r] * value
    for i in range(n - 1, -1, -1):
        right[i] /= columns[level, i, i]
        value = right[i]
        for r in range(i):
            right[r] -= columns[level, i, r] * value


@loop_step
def gather(places: Places, branch: Integers, slider: Array, now: Active) -> int:
    """Stiffness and constant of each port for the present branches, and the ports that have to be solved for.

    Args:
        places, branch, slider: description and memory of the elements.
        now: its stiffness, constant, ports and place are overwritten.

    Returns:
        The number of active ports.
    """
    kinds, absorbed = places.kinds, places.absorbed
    stiffness, constant, active, place = now.stiffness, now.constant, now.ports, now.place
    ports = stiffness.size
    for q in range(ports):
        stiffness[q] = 0.0
        constant[q] = 0.0
        place[q] = -1
    for e in range(kinds.size):
        q = places.element_port[e]
        k, rest = piece(kinds[e], places.parameters, e, branch[e], slider[e])
        k -= absorbed[e]
        stiffness[q] += k
        constant[q] += rest
        if k != 0.0 or (kinds[e] == JENKINS and branch[e] != 0):
            place[q] = 0
    count = 0
    for q in range(ports):
        if place[q] == 0:
            place[q] = count
            active[count] = q
            count += 1
    return count


@loop_step
def follow_branches(
    motion: SampleMotion, places: Places, memory: PortMemory, due: Array, now: Active, trial: Trial
) -> tuple[int, float]:
    """Everything that follows from the branches; it depends on nothing else, so not on the blocks.

    Returns:
        The number of active ports, and the way of the state at which the first port at rest is to be looked at.
    """
    forces, ports = memory.forces, due.size
    count = gather(places, memory.branch, memory.slider, now)
    earliest = np.inf
    seen = 0
    for q in range(ports):
        if now.place[q] < 0:
            forces[q] = now.constant[q]
            forces[ports + q] = 0.0
            earliest = min(earliest, due[q])
            if now.constant[q] != 0.0:
                trial.looked[seen] = q
                seen += 1
    project(motion.projection, trial.looked, seen, forces, now.steady, trial.next_slope)
    project(motion.projection, now.ports, count, forces, trial.own, trial.own_slope)
    for n in range(now.known.size):
        now.known[n] = False
    return count, earliest


@loop_step
def follow_width(motion: SampleMotion, now: Active, level: int, count: int, matrix: Array, row_order: Integers) -> None:
    """What a step width adds to `follow_branches`: the motion under the steady forces, and the factors.

    Args:
        level: of the width.
        count: of active ports; 0 where their forces are iterated for.
        matrix, row_order: (2 ports, 2 ports), (2 ports,) work space.
    """
    holds, answers = motion.holds, motion.answers
    steady, stiffness, active = now.steady, now.stiffness, now.ports
    pairs, ports = steady.size // 2, stiffness.size
    for i in range(pairs):
        j = pairs + i
        now.steady_step[level, i] = (holds[level, AT_START, _XX, i] + holds[level, AT_END, _XX, i]) * steady[i] + (
            holds[level, AT_START, _XY, i] + holds[level, AT_END, _XY, i]
        ) * steady[j]
        now.steady_step[level, j] = (holds[level, AT_START, _YX, i] + holds[level, AT_END, _YX, i]) * steady[i] + (
            holds[level, AT_START, _YY, i] + holds[level, AT_END, _YY, i]
        ) * steady[j]
    now.known[level] = True
    for a in range(count):
        q = active[a]
        for b in range(count):
            c = active[b]
            matrix[a, b] = -stiffness[q] * answers[level, c, q]
            matrix[a, count + b] = -stiffness[q] * answers[level, ports + c, q]
            matrix[count + a, b] = -stiffness[q] * answers[level, c, ports + q]
            matrix[count + a, count + b] = -stiffness[q] * answers[level, ports + c, ports + q]
        matrix[a, a] += 1.0
        matrix[count + a, count + a] += 1.0
    factorise(matrix, row_order, 2 * count)
    for a in range(2 * count):
        now.order[level, a] = row_order[a]
        for b in range(2 * count):
            now.columns[level, a, b] = matrix[b, a]
