"""Compiled time loop for piecewise linear elements at many places: only those that slip or touch are updated.

The scheme is that of integration_kernel.py: exact linear propagation, Hermite holds of the local forces, corners
located on a grid of step / 2^K. Four things differ, so that a place at rest costs nothing:

* The springs of sticking Jenkins elements are part of the linear motion. What is left as a port's force is
  g - k w with the absorbed stiffness k: a constant while the element sticks, and implicit only while it slips. A
  contact's force is 0 while it is open.
* Constant forces act together, as one vector per step width, made anew when a branch changes. The equations of the
  other ports, the active ones, are solved by a fixed-point iteration where forces hardly act back on their ports within
  a step, else by factors kept for each set and step width.
* Whether a resting element yields or touches is asked only once the state has moved far enough for it: no port moves
  further than Σ R_i |Δz_i|, where R_i is the largest share of working coordinate i in any port's displacement.
* A refused sub-step tells by its cubic where its first corner lies; the next ones lead there without further refusals.
"""

from __future__ import annotations

import numpy as np

from nmt_core.kernels import njit
from nmt_rig.model.element_kernels import margin, next_branch, piece
from nmt_rig.model.integration_kernel import _SMALLEST, JENKINS, Integers
from nmt_rig.model.structure import Array

# A bound on a motion is a sum of rounded numbers; so much earlier the element itself is looked at.
_CAUTION = 1.0 - 1e-9
# Share of a force that it causes itself by the end of a step, below which forces are iterated for.
_ITERATED_BELOW = 0.05
# Sweeps for the forces end where the next one would change less than this share of them.
_SETTLED = 1e-14
_SWEEPS = 14
# Sums may be taken several terms at a time, in an order that the compiler fixes once for all.
_IN_LANES = {"reassoc", "contract"}


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


@njit(cache=True)
def gather(
    kinds: Integers,
    parameters: Array,
    absorbed: Array,
    element_port: Integers,
    branch: Integers,
    slider: Array,
    stiffness: Array,
    constant: Array,
    active: Integers,
    place: Integers,
) -> int:
    """Stiffness and constant of each port for the present branches, and the ports that have to be solved for.

    Args:
        kinds, parameters, absorbed, element_port, branch, slider: (elements,…) description and memory.
        stiffness, constant: (ports,) overwritten, N/m and N.
        active: (ports,) its beginning is overwritten with the active ports.
        place: (ports,) overwritten with each port's place among them, -1 = at rest.

    Returns:
        The number of active ports.
    """
    ports = stiffness.size
    for q in range(ports):
        stiffness[q] = 0.0
        constant[q] = 0.0
        place[q] = -1
    for e in range(kinds.size):
        q = element_port[e]
        k, rest = piece(kinds[e], parameters, e, branch[e], slider[e])
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


@njit(cache=True)
def quiet_ticks(
    kinds: Integers,
    parameters: Array,
    branch: Integers,
    slider: Array,
    port_start: Integers,
    port_elements: Integers,
    q: int,
    ticks: int,
    width: float,
    w0: float,
    v0: float,
    w1: float,
    v1: float,
) -> int:
    """How many of the ticks of a sub-step a port's elements keep their branches, by the cubic through both ends.

    Args:
        q: the port; kinds … port_elements: as for `integrate_contacts`.
        ticks: in the sub-step.
        width: of the sub-step, s.
        w0, v0, w1, v1: displacement and velocity at its ends.
    """
    low = 0
    high = ticks
    while high - low > 1:
        middle = (low + high) // 2
        x = middle / ticks
        y = 1.0 - x
        w = y * y * ((1.0 + 2.0 * x) * w0 + x * width * v0) + x * x * ((1.0 + 2.0 * y) * w1 - y * width * v1)
        v = 6.0 * x * y * (w1 - w0) / width + y * (y - 2.0 * x) * v0 + x * (x - 2.0 * y) * v1
        kept = True
        for n in range(port_start[q], port_start[q + 1]):
            e = port_elements[n]
            if next_branch(kinds[e], parameters, e, branch[e], w, v, slider[e]) != branch[e]:
                kept = False
        if kept:
            low = middle
        else:
            high = middle
    return low


@njit(cache=True)
def integrate_contacts(
    pair: Array,
    holds: Array,
    start_weights: Array,
    projection: Array,
    port_rows: Array,
    answers: Array,
    reach: Array,
    kinds: Integers,
    parameters: Array,
    absorbed: Array,
    element_port: Integers,
    port_start: Integers,
    port_elements: Integers,
    gains: Array,
    levels: int,
    step: float,
    substeps: int,
    inputs: Array,
    state: Array,
    forces: Array,
    kinematics: Array,
    branch: Integers,
    slider: Array,
    dissipated: Array,
    counters: Integers,
    due: Array,
    way: Array,
    outputs_state: Array,
    outputs_force: Array,
    outputs_input: Array,
    outputs: Array,
) -> bool:
    """Integrate one block; outputs are taken at the samples, before each step.

    Args:
        pair, start_weights, port_rows: of the `Propagator`.
        holds: (K+1, 4, 4, pairs) blocks that take the projected forces and slopes at the start, then at the end of a
            step to the state.
        projection: (ports, Z) of port forces on the working coordinates' rates.
        answers: (K+1, 2 ports, 2 ports) the propagator's compliance of displacements and velocities, transposed.
        reach: (Z,) largest |share| of each working coordinate in the ports' displacements.
        absorbed: (elements,) stiffness that is part of the linear motion, N/m.
        port_start, port_elements: (ports + 1,), (elements,) elements of each port.
        gains: (K+1,) largest share of a change of the ports' forces that it causes again by the end of a step; where it
            is small a fixed-point iteration finds the forces, else they are factorised.
        step: of the integration, s.
        inputs: (n + 1,) input at the samples and one beyond; straight between them.
        state: (Z,) working state, updated.
        forces, kinematics: (2 ports,) forces and slopes, displacements and velocities of active ports, updated.
        branch, slider, dissipated: (elements,) memory and energy lost in sliders (J), updated.
        counters: [sub-steps, corners], updated.
        due: (ports,) the way of the state at which a port at rest is to be looked at, updated.
        way: (1,) of the state so far, m, updated.
        outputs_state, outputs_force, outputs_input: C (outputs, Z), D_g (outputs, ports), D_u (outputs,).
        outputs: (outputs, n) overwritten.

    Returns:
        False where the state stopped being finite.
    """
    samples = inputs.size - 1
    size = state.size
    pairs = size // 2
    ports = due.size
    trial = state.copy()
    stiffness = due.copy()
    constant = due.copy()
    due_trial = due.copy()
    looked = np.zeros(ports, dtype=np.int64)
    active = np.zeros(ports, dtype=np.int64)
    place = np.zeros(ports, dtype=np.int64)
    w_trial = due.copy()
    v_trial = due.copy()
    free = np.zeros(2 * ports)
    seen_at = np.zeros(2 * ports)
    force_trial = forces.copy()
    steady = np.zeros(size)
    steady_step = np.zeros((levels + 1, size))
    own = np.zeros(size)
    own_slope = np.zeros(size)
    next_own = np.zeros(size)
    next_slope = np.zeros(size)
    matrix = np.zeros((2 * ports, 2 * ports))
    columns = np.zeros((levels + 1, 2 * ports, 2 * ports))
    order = np.zeros((levels + 1, 2 * ports), dtype=np.int64)
    row_order = np.zeros(2 * ports, dtype=np.int64)
    right = np.zeros(2 * ports)
    change = np.zeros(ports)
    iterated = gains < _ITERATED_BELOW
    turned = np.zeros(ports, dtype=np.bool_)
    known = np.zeros(levels + 1, dtype=np.bool_)
    ticks = 1 << levels
    good = True
    count = 0
    earliest = 0.0
    fresh = False

    for k in range(samples):
        for o in range(outputs.shape[0]):
            total = outputs_input[o] * inputs[k] + row_product(outputs_state, o, state, size)
            outputs[o, k] = total + row_product(outputs_force, o, forces, ports)
        increment = (inputs[k + 1] - inputs[k]) / substeps
        for s in range(substeps):
            u_start = inputs[k] + s * increment
            position = 0
            level = 0
            goal = 0
            while position < ticks:
                if not fresh:
                    # Everything that follows from the branches; it depends on nothing else, so not on the blocks.
                    count = gather(
                        kinds, parameters, absorbed, element_port, branch, slider, stiffness, constant, active, place
                    )
                    earliest = np.inf
                    seen = 0
                    for q in range(ports):
                        if place[q] < 0:
                            forces[q] = constant[q]
                            forces[ports + q] = 0.0
                            earliest = min(earliest, due[q])
                            if constant[q] != 0.0:
                                looked[seen] = q
                                seen += 1
                    project(projection, looked, seen, forces, steady, next_slope)
                    project(projection, active, count, forces, own, own_slope)
                    for n in range(levels + 1):
                        known[n] = False
                    fresh = True
                if not known[level]:
                    for i in range(pairs):
                        j = pairs + i
                        steady_step[level, i] = (holds[level, 0, 0, i] + holds[level, 2, 0, i]) * steady[i] + (
                            holds[level, 0, 1, i] + holds[level, 2, 1, i]
                        ) * steady[j]
                        steady_step[level, j] = (holds[level, 0, 2, i] + holds[level, 2, 2, i]) * steady[i] + (
                            holds[level, 0, 3, i] + holds[level, 2, 3, i]
                        ) * steady[j]
                    known[level] = True
                    factored = 0 if iterated[level] else count
                    for a in range(factored):
                        q = active[a]
                        for b in range(count):
                            c = active[b]
                            matrix[a, b] = -stiffness[q] * answers[level, c, q]
                            matrix[a, count + b] = -stiffness[q] * answers[level, ports + c, q]
                            matrix[count + a, b] = -stiffness[q] * answers[level, c, ports + q]
                            matrix[count + a, count + b] = -stiffness[q] * answers[level, ports + c, ports + q]
                        matrix[a, a] += 1.0
                        matrix[count + a, count + a] += 1.0
                    factorise(matrix, row_order, 2 * factored)
                    for a in range(2 * factored):
                        order[level, a] = row_order[a]
                        for b in range(2 * factored):
                            columns[level, a, b] = matrix[b, a]

                width = ticks >> level
                span = step * width / ticks
                u0 = u_start + increment * (position / ticks)
                u1 = u_start + increment * ((position + width) / ticks)
                for i in range(pairs):
                    j = pairs + i
                    x = state[i]
                    y = state[j]
                    trial[i] = (
                        (pair[level, 0, i] * x + pair[level, 1, i] * y)
                        + (start_weights[level, 0, i] * u0 + start_weights[level, 1, i] * u1)
                    ) + steady_step[level, i]
                    trial[j] = (
                        (pair[level, 2, i] * x + pair[level, 3, i] * y)
                        + (start_weights[level, 0, j] * u0 + start_weights[level, 1, j] * u1)
                    ) + steady_step[level, j]
                if count > 0:
                    for i in range(pairs):
                        j = pairs + i
                        trial[i] += (holds[level, 0, 0, i] * own[i] + holds[level, 0, 1, i] * own[j]) + (
                            holds[level, 1, 0, i] * own_slope[i] + holds[level, 1, 1, i] * own_slope[j]
                        )
                        trial[j] += (holds[level, 0, 2, i] * own[i] + holds[level, 0, 3, i] * own[j]) + (
                            holds[level, 1, 2, i] * own_slope[i] + holds[level, 1, 3, i] * own_slope[j]
                        )
                    for a in range(count):
                        q = active[a]
                        w = row_product(port_rows, q, trial, size)
                        v = row_product(port_rows, ports + q, trial, size)
                        free[q] = w
                        free[ports + q] = v
                        right[a] = constant[q] + stiffness[q] * w
                        right[count + a] = stiffness[q] * v
                    if not iterated[level]:
                        solve_factored(columns, level, order, right, 2 * count)
                    for _ in range(_SWEEPS):
                        for q in range(2 * ports):
                            seen_at[q] = free[q]
                        for b in range(count):
                            c = active[b]
                            g = right[b]
                            slope = right[count + b]
                            for q in range(2 * ports):
                                seen_at[q] += answers[level, c, q] * g + answers[level, ports + c, q] * slope
                        largest = 0.0
                        for a in range(count if iterated[level] else 0):
                            q = active[a]
                            g = constant[q] + stiffness[q] * seen_at[q]
                            slope = stiffness[q] * seen_at[ports + q]
                            change[a] = abs(g - right[a]) + span * abs(slope - right[count + a])
                            largest = max(largest, change[a])
                            right[a] = g
                            right[count + a] = slope
                        # The next sweep would change no force more than this. NaN counts as settled; the state tells.
                        largest *= gains[level]
                        settled = True
                        for a in range(count if iterated[level] else 0):
                            scale = abs(right[a]) + abs(constant[active[a]]) + span * abs(right[count + a])
                            if min(change[a], largest) > _SETTLED * scale + _SMALLEST:
                                settled = False
                        if settled:
                            break
                    for a in range(count):
                        w_trial[active[a]] = seen_at[active[a]]
                        v_trial[active[a]] = seen_at[ports + active[a]]
                    for a in range(count):
                        force_trial[active[a]] = right[a]
                        force_trial[ports + active[a]] = right[count + a]
                    project(projection, active, count, force_trial, next_own, next_slope)
                    for i in range(pairs):
                        j = pairs + i
                        trial[i] += (holds[level, 2, 0, i] * next_own[i] + holds[level, 2, 1, i] * next_own[j]) + (
                            holds[level, 3, 0, i] * next_slope[i] + holds[level, 3, 1, i] * next_slope[j]
                        )
                        trial[j] += (holds[level, 2, 2, i] * next_own[i] + holds[level, 2, 3, i] * next_own[j]) + (
                            holds[level, 3, 2, i] * next_slope[i] + holds[level, 3, 3, i] * next_slope[j]
                        )

                corner = False
                for a in range(count):
                    q = active[a]
                    for n in range(port_start[q], port_start[q + 1]):
                        e = port_elements[n]
                        if (
                            next_branch(kinds[e], parameters, e, branch[e], w_trial[q], v_trial[q], slider[e])
                            != branch[e]
                        ):
                            corner = True
                            turned[q] = True
                move0 = 0.0
                move1 = 0.0
                for i in range(pairs):
                    move0 += reach[i] * abs(trial[i] - state[i])
                    move1 += reach[pairs + i] * abs(trial[pairs + i] - state[pairs + i])
                ahead = way[0] + (move0 + move1)
                seen = 0
                if not ahead < earliest:
                    for q in range(ports):
                        if place[q] >= 0 or ahead < due[q]:
                            continue
                        w_trial[q] = row_product(port_rows, q, trial, size)
                        near = np.inf
                        for n in range(port_start[q], port_start[q + 1]):
                            e = port_elements[n]
                            if next_branch(kinds[e], parameters, e, branch[e], w_trial[q], 0.0, slider[e]) != branch[e]:
                                corner = True
                                turned[q] = True
                            near = min(near, margin(kinds[e], parameters, e, branch[e], w_trial[q], slider[e]))
                        due_trial[q] = _CAUTION * near
                        looked[seen] = q
                        seen += 1
                if corner and level < levels:
                    # Go on to the tick before the first corner; where it lies is guessed, what is accepted is not.
                    kept = width
                    for q in range(ports):
                        if turned[q]:
                            w = kinematics[q]
                            v = kinematics[ports + q]
                            if place[q] < 0:
                                w = row_product(port_rows, q, state, size)
                                v = row_product(port_rows, ports + q, state, size)
                                v_trial[q] = row_product(port_rows, ports + q, trial, size)
                            kept = min(
                                kept,
                                quiet_ticks(
                                    kinds, parameters, branch, slider, port_start, port_elements, q, width,
                                    span, w, v, w_trial[q], v_trial[q],
                                ),
                            )  # fmt: skip
                            turned[q] = False
                    goal = position + kept
                    level += 1
                    while level < levels and position + (ticks >> level) > goal:
                        level += 1
                    continue
                for q in range(ports if corner else 0):
                    turned[q] = False

                # Accept the sub-step.
                for i in range(size):
                    state[i] = trial[i]
                way[0] = ahead
                for a in range(count):
                    q = active[a]
                    for n in range(port_start[q], port_start[q + 1]):
                        e = port_elements[n]
                        if kinds[e] == JENKINS and branch[e] != 0:
                            dissipated[e] += branch[e] * parameters[e, 1] * (w_trial[q] - kinematics[q])
                            slider[e] = w_trial[q] - branch[e] * parameters[e, 1] / parameters[e, 0]
                    forces[q] = force_trial[q]
                    forces[ports + q] = force_trial[ports + q]
                    kinematics[q] = w_trial[q]
                    kinematics[ports + q] = v_trial[q]
                if count > 0:
                    for i in range(size):
                        own[i] = next_own[i]
                        own_slope[i] = next_slope[i]
                if seen > 0:
                    # The way begins again, lest it lose digits.
                    for q in range(ports):
                        due[q] -= ahead
                    way[0] = 0.0
                    for n in range(seen):
                        due[looked[n]] = due_trial[looked[n]]
                    earliest = np.inf
                    for q in range(ports):
                        if place[q] < 0:
                            earliest = min(earliest, due[q])
                if corner:
                    counters[1] += 1
                    for q in range(ports):
                        changed = False
                        if place[q] < 0:
                            if due[q] > way[0]:
                                continue
                            w_trial[q] = row_product(port_rows, q, state, size)
                            v_trial[q] = 0.0  # a resting element does not ask for it
                        for n in range(port_start[q], port_start[q + 1]):
                            e = port_elements[n]
                            new = next_branch(kinds[e], parameters, e, branch[e], w_trial[q], v_trial[q], slider[e])
                            if new != branch[e]:
                                if kinds[e] == JENKINS and branch[e] == 0:
                                    slipped = w_trial[q] - new * parameters[e, 1] / parameters[e, 0]
                                    dissipated[e] += new * parameters[e, 1] * (slipped - slider[e])
                                    slider[e] = slipped
                                branch[e] = new
                                changed = True
                        if changed:
                            kinematics[q] = w_trial[q]
                            kinematics[ports + q] = row_product(port_rows, ports + q, state, size)
                            k_sum = 0.0
                            rest = 0.0
                            near = np.inf
                            for n in range(port_start[q], port_start[q + 1]):
                                e = port_elements[n]
                                own_k, own_rest = piece(kinds[e], parameters, e, branch[e], slider[e])
                                k_sum += own_k - absorbed[e]
                                rest += own_rest
                                near = min(near, margin(kinds[e], parameters, e, branch[e], kinematics[q], slider[e]))
                            forces[q] = rest + k_sum * kinematics[q]
                            forces[ports + q] = k_sum * kinematics[ports + q]
                            due[q] = way[0] + _CAUTION * near
                    fresh = False
                counters[0] += 1
                position += width
                # Widest sub-step that starts here and stays on the dyadic grid.
                level = levels
                while level > 0 and position % (ticks >> (level - 1)) == 0:
                    level -= 1
                if position <= goal:
                    while level < levels and position + (ticks >> level) > goal:
                        level += 1

    for i in range(size):
        if not abs(state[i]) < 1e300:
            good = False
    return good
