"""Compiled time loop: exact linear propagation, implicit local forces, corners located by halving the step.

A piecewise linear element (Jenkins, stop, gap) has a branch: sticking 0, slipping ±1; open 0, closed ±1.
Within a sub-step branches are frozen; a sub-step whose end contradicts its branch is refused and halved, down
to step / 2^K. There it is accepted and the branch switched, so a corner is timed to step / 2^K.

Ports of elements come first, those of couplings (forces of two arguments) behind them. Newton's method works on the
forces and slopes of all of them.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from nmt_core.numerics.kernels import loop_step, njit
from nmt_rig.model.couplings import coupling_response
from nmt_rig.model.element_kernels import frozen, next_branch, piece
from nmt_rig.model.local_elements.friction import Jenkins
from nmt_rig.model.structure import Array

JENKINS = Jenkins.kind
# Columns of the parameters of a Jenkins element.
STIFFNESS = Jenkins.parameter_names().index("tangential_stiffness")
SLIP_FORCE = Jenkins.parameter_names().index("slip_force")
# Places in `Memory.counters`.
SUB_STEPS, CORNERS = 0, 1
# Rows of `pair`; of `start_weights` with one exciter.
_XX, _XY, _YX, _YY = 0, 1, 2, 3
_INPUT_START, _INPUT_END, _FIRST_FORCE = 0, 1, 2
_NEWTON_STEPS = 25
_NEWTON_TOLERANCE = 1e-13
_SLOPE_TOLERANCE = 1e-9
_SMALLEST = 1e-290
# From this number of pairs on, vectorised loops over few arrays each take less time than one loop over all arrays.
_MANY_PAIRS = 12

Integers = NDArray[np.int64]


class LinearMotion(NamedTuple):
    """The linear motion over sub-steps of step / 2^level, as in the `Propagator`.

    Attributes:
        modal: whether `pair` moves the state on, else `dense` does.
        pair: (K+1, 4, pairs).
        dense: (K+1, Z, Z).
        start_weights, end_weights: (K+1, 2 exciters + 2 ports, Z), (K+1, 2 ports, Z).
        port_rows, port_inputs: (3 own + 4 couplings, Z), (exciters, 3 own + 4 couplings).
        compliance: (K+1, 3 own + 4 couplings, 2 ports).
    """

    modal: bool
    pair: Array
    dense: Array
    start_weights: Array
    end_weights: Array
    port_rows: Array
    port_inputs: Array
    compliance: Array


class PortForces(NamedTuple):
    """What acts at the ports: elements at the first ones, each coupling at one of those behind.

    Attributes:
        kinds, parameters: (elements,), (elements, PARAMETER_COUNT).
        element_port: (elements,) port of each element.
        coupling_kinds, coupling_parameters: (couplings,), (couplings, COUPLING_PARAMETERS).
        affine: all elements are piecewise linear, and there are no couplings.
    """

    kinds: Integers
    parameters: Array
    element_port: Integers
    coupling_kinds: Integers
    coupling_parameters: Array
    affine: bool


class OutputMatrices(NamedTuple):
    """Outputs C (outputs, Z), D_g (outputs, ports) and D_u (outputs, exciters)."""

    state: Array
    force: Array
    inputs: Array


class PortMemory(NamedTuple):
    """What ports and elements carry from one sub-step to the next; arrays that the kernels update.

    Attributes:
        forces: (2 ports,) port forces (N) and slopes (N/s) at the present time.
        kinematics: (3 own + 4 couplings,) what elements and couplings see, see `port_forces`.
        branch: (elements,) sticking 0, slipping ±1; open 0, closed ±1.
        slider: (elements,) m.
        dissipated: (elements,) energy lost in sliders, J.
        counters: (2,) sub-steps and corners so far, at `SUB_STEPS` and `CORNERS`.
    """

    forces: Array
    kinematics: Array
    branch: Integers
    slider: Array
    dissipated: Array
    counters: Integers


class SubStep(NamedTuple):
    """A sub-step that may be refused.

    Attributes:
        state: (Z,) at its end.
        forces: (2 ports,) port forces and slopes there.
        free, seen: (3 own + 4 couplings,) what ports see there, without and with these forces.
        tangents: (ports, 2) of the forces.
        jacobian, residual: (2 ports, 2 ports), (2 ports,) of Newton's method.
    """

    state: Array
    forces: Array
    free: Array
    seen: Array
    tangents: Array
    jacobian: Array
    residual: Array


@njit(cache=True)
def solve_in_place(matrix: Array, right: Array, n: int) -> None:
    """Gaussian elimination with partial pivoting of the leading n x n part; the solution replaces `right`."""
    for i in range(n):
        pivot = i
        for r in range(i + 1, n):
            if abs(matrix[r, i]) > abs(matrix[pivot, i]):
                pivot = r
        if pivot != i:
            for c in range(i, n):
                swap = matrix[i, c]
                matrix[i, c] = matrix[pivot, c]
                matrix[pivot, c] = swap
            value = right[i]
            right[i] = right[pivot]
            right[pivot] = value
        for r in range(i + 1, n):
            factor = matrix[r, i] / matrix[i, i]
            if factor != 0.0:
                for c in range(i + 1, n):
                    matrix[r, c] -= factor * matrix[i, c]
                right[r] -= factor * right[i]
    for i in range(n - 1, -1, -1):
        for c in range(i + 1, n):
            right[i] -= matrix[i, c] * right[c]
        right[i] /= matrix[i, i]


@loop_step
def port_forces(
    acting: PortForces, branch: Integers, slider: Array, kinematics: Array, forces: Array, tangents: Array
) -> None:
    """Forces, slopes and tangents of all ports for what elements and couplings see.

    Args:
        acting: elements and couplings.
        branch, slider: (elements,) memory.
        kinematics: (3 own + 4 couplings,) displacements, velocities, accelerations of the elements' ports, then what
            the couplings observe, then its rates.
        forces: (2 ports,) overwritten: forces (N), slopes (N/s).
        tangents: (ports, 2) overwritten: with respect to displacement and velocity, or to y₁ and y₂.
    """
    kinds, parameters, coupling_kinds = acting.kinds, acting.parameters, acting.coupling_kinds
    ports = tangents.shape[0]
    own = ports - coupling_kinds.size
    for q in range(ports):
        forces[q] = 0.0
        tangents[q, 0] = 0.0
        tangents[q, 1] = 0.0
    for e in range(kinds.size):
        q = acting.element_port[e]
        g, g_w, g_v = frozen(kinds[e], parameters, e, branch[e], kinematics[q], kinematics[own + q], slider[e])
        forces[q] += g
        tangents[q, 0] += g_w
        tangents[q, 1] += g_v
    for q in range(own):
        forces[ports + q] = tangents[q, 0] * kinematics[own + q] + tangents[q, 1] * kinematics[2 * own + q]
    for k in range(coupling_kinds.size):
        first = 3 * own + 2 * k
        rate = first + 2 * coupling_kinds.size
        q = own + k
        f, f_1, f_2 = coupling_response(
            coupling_kinds[k], acting.coupling_parameters[k], kinematics[first], kinematics[first + 1]
        )
        forces[q] = f
        tangents[q, 0] = f_1
        tangents[q, 1] = f_2
        forces[ports + q] = f_1 * kinematics[rate] + f_2 * kinematics[rate + 1]


@loop_step
def move_pairs(
    pair: Array, weights: Array, level: int, u0: float, u1: float, forces: Array, state: Array, end: Array
) -> None:
    """`move_free` in modal form with one exciter and one port; both branches give the same bits.

    A step is compiled by itself before it is copied into the loop, and nothing states there that arrays do not overlap.
    A vectorised loop therefore compares the addresses that it writes with those that it reads, and runs only where
    there are enough values for that. Few arrays per loop keep this number small.
    """
    size = state.size
    pairs = size // 2
    g0 = forces[0]
    s0 = forces[1]
    if pairs < _MANY_PAIRS:
        for i in range(pairs):
            j = pairs + i
            x = state[i]
            y = state[j]
            end[i] = (
                (pair[level, _XX, i] * x + pair[level, _XY, i] * y)
                + (weights[level, _INPUT_START, i] * u0 + weights[level, _INPUT_END, i] * u1)
                + (weights[level, _FIRST_FORCE, i] * g0 + weights[level, _FIRST_FORCE + 1, i] * s0)
            )
            end[j] = (
                (pair[level, _YX, i] * x + pair[level, _YY, i] * y)
                + (weights[level, _INPUT_START, j] * u0 + weights[level, _INPUT_END, j] * u1)
                + (weights[level, _FIRST_FORCE, j] * g0 + weights[level, _FIRST_FORCE + 1, j] * s0)
            )
        return
    for i in range(pairs):
        end[i] = pair[level, _XX, i] * state[i] + pair[level, _XY, i] * state[pairs + i]
    for i in range(pairs):
        end[pairs + i] = pair[level, _YX, i] * state[i] + pair[level, _YY, i] * state[pairs + i]
    for i in range(size):
        end[i] = (
            end[i]
            + (weights[level, _INPUT_START, i] * u0 + weights[level, _INPUT_END, i] * u1)
            + (weights[level, _FIRST_FORCE, i] * g0 + weights[level, _FIRST_FORCE + 1, i] * s0)
        )


@loop_step
def hold_inputs(
    exciters: tuple[int, ...], inputs: Array, increments: Array, k: int, s: int, start: float, end: float, ends: Array
) -> None:
    """Inputs (exciters, 2) at both ends of a sub-step, given as shares of step s from sample k on.

    Args:
        exciters: their numbers, from 0: a tuple, so that their count is known to the compiler.
        inputs, increments: (exciters, n + 1), (exciters,) at the samples, and their change in a step.
        ends: overwritten.
    """
    for e in range(len(exciters)):
        before = inputs[e, k] + s * increments[e]
        ends[e, 0] = before + increments[e] * start
        ends[e, 1] = before + increments[e] * end


@loop_step
def move_free(
    motion: LinearMotion, exciters: tuple[int, ...], level: int, ends: Array, forces: Array, state: Array, end: Array
) -> None:
    """The state (Z,) at the end of a sub-step by all that is known at its start, for the inputs at its ends.

    Indices are written out in full: a view in this loop would cost more than the arithmetic.
    """
    pair, weights, dense = motion.pair, motion.start_weights, motion.dense
    size = state.size
    pairs = size // 2
    inputs = 2 * len(exciters)
    if motion.modal and forces.size == 2 and len(exciters) == 1:
        move_pairs(pair, weights, level, ends[0, 0], ends[0, 1], forces, state, end)
        return
    if motion.modal:
        for i in range(pairs):
            j = pairs + i
            x = state[i]
            y = state[j]
            end[i] = pair[level, _XX, i] * x + pair[level, _XY, i] * y
            end[j] = pair[level, _YX, i] * x + pair[level, _YY, i] * y
        for e in range(len(exciters)):
            u0 = ends[e, 0]
            u1 = ends[e, 1]
            for i in range(size):
                end[i] += weights[level, 2 * e, i] * u0 + weights[level, 2 * e + 1, i] * u1
    else:
        for i in range(size):
            total = 0.0
            for e in range(len(exciters)):
                total += weights[level, 2 * e, i] * ends[e, 0] + weights[level, 2 * e + 1, i] * ends[e, 1]
            for j in range(size):
                total += dense[level, i, j] * state[j]
            end[i] = total
    for c in range(forces.size):
        value = forces[c]
        for i in range(size):
            end[i] += weights[level, inputs + c, i] * value


@loop_step
def see_free(
    motion: LinearMotion, exciters: tuple[int, ...], rows: int, lanes: int, ends: Array, end: Array, free: Array
) -> None:
    """What the ports see (the first `rows`) at the end of a sub-step without the forces there.

    Args:
        exciters: as for `hold_inputs`.
        rows: how many are wanted.
        lanes: so many terms are summed four at a time.
        ends: (exciters, 2) inputs at both ends.
        end, free: as in `SubStep`.
    """
    port_rows = motion.port_rows
    for r in range(rows):
        total0 = 0.0
        for e in range(len(exciters)):
            total0 += motion.port_inputs[e, r] * ends[e, 1]
        total1 = 0.0
        total2 = 0.0
        total3 = 0.0
        # Of range(0, lanes, 4) the compiler would not know that no index is negative.
        for four in range(lanes // 4):
            i = 4 * four
            total0 += port_rows[r, i] * end[i]
            total1 += port_rows[r, i + 1] * end[i + 1]
            total2 += port_rows[r, i + 2] * end[i + 2]
            total3 += port_rows[r, i + 3] * end[i + 3]
        for i in range(lanes, end.size):
            total0 += port_rows[r, i] * end[i]
        free[r] = (total0 + total1) + (total2 + total3)


@loop_step
def see_with_forces(compliance: Array, level: int, rows: int, sub: SubStep) -> None:
    """What the ports see at the end of a sub-step with the forces there, the first `rows` of `sub.seen`."""
    for r in range(rows):
        total = sub.free[r]
        for c in range(sub.forces.size):
            total += compliance[level, r, c] * sub.forces[c]
        sub.seen[r] = total


@loop_step
def solve_one_port(
    compliance: Array, level: int, acting: PortForces, branch: Integers, slider: Array, sub: SubStep
) -> None:
    """Force and slope at the end of a sub-step of one port with piecewise linear elements, in closed form."""
    k_sum = 0.0
    g_rest = 0.0
    for e in range(acting.kinds.size):
        own_k, own_rest = piece(acting.kinds[e], acting.parameters, e, branch[e], slider[e])
        k_sum += own_k
        g_rest += own_rest
    w = sub.free[0]
    v = sub.free[1]
    if k_sum == 0.0:
        g1 = g_rest
        s1 = 0.0
    else:
        a11 = 1.0 - k_sum * compliance[level, 0, 0]
        a12 = -k_sum * compliance[level, 0, 1]
        a21 = -k_sum * compliance[level, 1, 0]
        a22 = 1.0 - k_sum * compliance[level, 1, 1]
        right1 = g_rest + k_sum * w
        right2 = k_sum * v
        scale = 1.0 / (a11 * a22 - a12 * a21)
        g1 = scale * (a22 * right1 - a12 * right2)
        s1 = scale * (a11 * right2 - a21 * right1)
    sub.forces[0] = g1
    sub.forces[1] = s1
    sub.seen[0] = w + (compliance[level, 0, 0] * g1 + compliance[level, 0, 1] * s1)
    sub.seen[1] = v + (compliance[level, 1, 0] * g1 + compliance[level, 1, 1] * s1)


@loop_step
def newton_equations(compliance: Array, level: int, couplings: int, sub: SubStep) -> None:
    """Jacobian of Newton's method for the forces and slopes of all ports, from their tangents."""
    jacobian, tangents = sub.jacobian, sub.tangents
    ports = tangents.shape[0]
    own = ports - couplings
    for q in range(ports):
        if q < own:
            first, second = q, own + q
            rate_first, rate_second = own + q, 2 * own + q
        else:
            first = 3 * own + 2 * (q - own)
            second = first + 1
            rate_first, rate_second = first + 2 * couplings, second + 2 * couplings
        for c in range(2 * ports):
            jacobian[q, c] = -(
                tangents[q, 0] * compliance[level, first, c] + tangents[q, 1] * compliance[level, second, c]
            )
            jacobian[ports + q, c] = -(
                tangents[q, 0] * compliance[level, rate_first, c] + tangents[q, 1] * compliance[level, rate_second, c]
            )
        jacobian[q, q] += 1.0
        jacobian[ports + q, ports + q] += 1.0


@loop_step
def is_settled(change: Array, forces: Array, before: Array) -> bool:
    """Whether a step of Newton's method (2 ports,) ends it, for the forces at the end and the start of a sub-step."""
    ports = forces.size // 2
    settled = True
    for q in range(ports):
        scale_g = abs(forces[q]) + abs(before[q])
        scale_s = abs(forces[ports + q]) + abs(before[ports + q])
        # The slope's tangents leave out second derivatives. NaN counts as not settled.
        if not abs(change[q]) <= _NEWTON_TOLERANCE * scale_g + _SMALLEST:
            settled = False
        if not abs(change[ports + q]) <= _SLOPE_TOLERANCE * scale_s + _SMALLEST:
            settled = False
    return settled


@loop_step
def solve_ports(compliance: Array, level: int, rows: int, acting: PortForces, memory: PortMemory, sub: SubStep) -> bool:
    """Forces and slopes of all ports at the end of a sub-step by Newton's method; whether they were found."""
    forces, residual = sub.forces, sub.residual
    count = forces.size
    for q in range(count):
        forces[q] = memory.forces[q]
    solved = False
    for _ in range(_NEWTON_STEPS):
        see_with_forces(compliance, level, rows, sub)
        port_forces(acting, memory.branch, memory.slider, sub.seen, residual, sub.tangents)
        for q in range(count):
            residual[q] -= forces[q]
        newton_equations(compliance, level, acting.coupling_kinds.size, sub)
        solve_in_place(sub.jacobian, residual, count)
        for q in range(count):
            forces[q] += residual[q]
        solved = acting.affine or is_settled(residual, forces, memory.forces)
        if solved:
            break
    see_with_forces(compliance, level, rows, sub)
    return solved


@loop_step
def passes_corner(acting: PortForces, branch: Integers, slider: Array, own: int, seen: Array) -> bool:
    """Whether an element's branch does not fit what its port sees at the end of a sub-step."""
    corner = False
    for e in range(acting.kinds.size):
        q = acting.element_port[e]
        new = next_branch(acting.kinds[e], acting.parameters, e, branch[e], seen[q], seen[own + q], slider[e])
        if new != branch[e]:
            corner = True
    return corner


@loop_step
def take_state(motion: LinearMotion, level: int, one: bool, sub: SubStep, state: Array) -> None:
    """The state at the end of a sub-step with the forces there; `one`: of one port without couplings."""
    weights, end, forces = motion.end_weights, sub.state, sub.forces
    if one:
        g1 = forces[0]
        s1 = forces[1]
        for i in range(state.size):
            state[i] = end[i] + (weights[level, 0, i] * g1 + weights[level, 1, i] * s1)
    else:
        for c in range(forces.size):
            value = forces[c]
            for i in range(state.size):
                end[i] += weights[level, c, i] * value
        for i in range(state.size):
            state[i] = end[i]


@loop_step
def slip_along(parameters: Array, e: int, memory: PortMemory, before: float, after: float) -> None:
    """Move the slider of a slipping Jenkins element with its port, from `before` to `after`; count what it loses."""
    side = memory.branch[e]
    memory.dissipated[e] += side * parameters[e, SLIP_FORCE] * (after - before)
    memory.slider[e] = after - side * parameters[e, SLIP_FORCE] / parameters[e, STIFFNESS]


@loop_step
def begin_slip(parameters: Array, e: int, memory: PortMemory, side: int, w: float) -> None:
    """Put the slider of a Jenkins element that begins to slip where its port, at w, has it; count what that loses."""
    slipped = w - side * parameters[e, SLIP_FORCE] / parameters[e, STIFFNESS]
    memory.dissipated[e] += side * parameters[e, SLIP_FORCE] * (slipped - memory.slider[e])
    memory.slider[e] = slipped


@loop_step
def move_elements(acting: PortForces, memory: PortMemory, own: int, corner: bool, seen: Array) -> None:
    """Move the sliders that slip with their ports; past a corner, take the branches that fit."""
    kinds, parameters, branch, slider = acting.kinds, acting.parameters, memory.branch, memory.slider
    for e in range(kinds.size):
        q = acting.element_port[e]
        if kinds[e] == JENKINS and branch[e] != 0:
            slip_along(parameters, e, memory, memory.kinematics[q], seen[q])
        if corner:
            new = next_branch(kinds[e], parameters, e, branch[e], seen[q], seen[own + q], slider[e])
            if new != branch[e] and branch[e] == 0 and kinds[e] == JENKINS:
                begin_slip(parameters, e, memory, new, seen[q])
            branch[e] = new


@loop_step
def accept(
    motion: LinearMotion, acting: PortForces, memory: PortMemory, level: int, corner: bool, rows: int, sub: SubStep,
    state: Array,
) -> None:  # fmt: skip
    """Take over the end of a sub-step: state, sliders, branches past a corner, forces and what the ports see."""
    ports, couplings = sub.tangents.shape[0], acting.coupling_kinds.size
    take_state(motion, level, ports == 1 and couplings == 0, sub, state)
    move_elements(acting, memory, ports - couplings, corner, sub.seen)
    if corner:
        memory.counters[CORNERS] += 1
        port_forces(acting, memory.branch, memory.slider, sub.seen, sub.forces, sub.tangents)
    for q in range(2 * ports):
        memory.forces[q] = sub.forces[q]
    for r in range(rows):
        memory.kinematics[r] = sub.seen[r]
    memory.counters[SUB_STEPS] += 1


@loop_step
def widest_level(position: int, levels: int) -> int:
    """Halvings of the widest sub-step that starts at a tick and stays on the dyadic grid."""
    level = levels
    # Widths are powers of two: a mask in place of a remainder, which takes as long as the motion of ten modes.
    while level > 0 and position & (((1 << levels) >> (level - 1)) - 1) == 0:
        level -= 1
    return level


@loop_step
def is_bounded(state: Array) -> bool:
    """Whether a state (Z,) is finite, and far from what is not."""
    good = True
    for i in range(state.size):
        if not abs(state[i]) < 1e300:
            good = False
    return good


@loop_step
def write_outputs(
    rows: OutputMatrices, inputs: Array, history: Array, force_history: Array, lanes: int, outputs: Array
) -> None:
    """Outputs sample by sample in the inner loop: vectorised without changing the order of a sample's sum."""
    samples = inputs.shape[1] - 1
    for o in range(outputs.shape[0]):
        for k in range(samples):
            outputs[o, k] = rows.inputs[o, 0] * inputs[0, k]
        for e in range(1, inputs.shape[0]):
            for k in range(samples):
                outputs[o, k] += rows.inputs[o, e] * inputs[e, k]
        for i in range(0, lanes, 4):
            c0 = rows.state[o, i]
            c1 = rows.state[o, i + 1]
            c2 = rows.state[o, i + 2]
            c3 = rows.state[o, i + 3]
            for k in range(samples):
                outputs[o, k] += (c0 * history[i, k] + c1 * history[i + 1, k]) + (
                    c2 * history[i + 2, k] + c3 * history[i + 3, k]
                )
        for i in range(lanes, rows.state.shape[1]):
            for k in range(samples):
                outputs[o, k] += rows.state[o, i] * history[i, k]
        for q in range(rows.force.shape[1]):
            for k in range(samples):
                outputs[o, k] += rows.force[o, q] * force_history[q, k]


@njit(cache=True, inline="always")
def room_for_sub_step(ports: int, state: Array, memory: PortMemory) -> SubStep:
    """Work space."""
    return SubStep(
        state.copy(), memory.forces.copy(), memory.kinematics.copy(), memory.kinematics.copy(), np.zeros((ports, 2)),
        np.zeros((2 * ports, 2 * ports)), np.zeros(2 * ports),
    )  # fmt: skip


@njit(cache=True)
def integrate(
    motion_tables: tuple[Any, ...],
    force_tables: tuple[Any, ...],
    output_tables: tuple[Array, Array, Array],
    memory_tables: tuple[Any, ...],
    exciters: tuple[int, ...],
    substeps: int,
    inputs: Array,
    state: Array,
    history: Array,
    force_history: Array,
    outputs: Array,
) -> bool:
    """Integrate one block; outputs are taken at the samples, before each step.

    Args:
        motion_tables, force_tables, output_tables: `LinearMotion`, `PortForces` and `OutputMatrices` of the system as
            plain tuples, which come from Python sooner than named ones.
        memory_tables: likewise the `PortMemory`, updated.
        exciters: their numbers, from 0.
        substeps: per sample.
        inputs: (exciters, n + 1) input at the samples and one beyond; straight between them.
        state: (Z,) working state, updated.
        history, force_history: (Z, ≥ n) and (ports, ≥ n) work space.
        outputs: (outputs, n) overwritten.

    Returns:
        False where the state stopped being finite or Newton's method failed.
    """
    motion, acting = LinearMotion(*motion_tables), PortForces(*force_tables)
    memory = PortMemory(*memory_tables)
    levels = motion.compliance.shape[0] - 1
    # By names of their own: in a loop each look into a tuple would count references.
    forces, branch, slider, compliance = memory.forces, memory.branch, memory.slider, motion.compliance
    size, ports, couplings = state.size, forces.size // 2, acting.coupling_kinds.size
    sub = room_for_sub_step(ports, state, memory)
    end, free, seen, affine = sub.state, sub.free, sub.seen, acting.affine
    ticks = 1 << levels
    # Accelerations of the ports matter only to elements that depend on velocity.
    rows = 2 * ports if affine else memory.kinematics.size
    # Sums are taken four terms at a time, of systems with couplings one at a time.
    lanes = size - size % 4 if couplings == 0 else 0
    good = True
    increments, ends = np.zeros(len(exciters)), np.zeros((len(exciters), 2))
    for k in range(inputs.shape[1] - 1):
        for i in range(size):
            history[i, k] = state[i]
        for q in range(ports):
            force_history[q, k] = forces[q]
        for e in range(len(exciters)):
            increments[e] = (inputs[e, k + 1] - inputs[e, k]) / substeps
        for s in range(substeps):
            position = 0
            level = 0
            while position < ticks:
                width = ticks >> level
                hold_inputs(exciters, inputs, increments, k, s, position / ticks, (position + width) / ticks, ends)
                move_free(motion, exciters, level, ends, forces, state, end)
                see_free(motion, exciters, rows, lanes, ends, end, free)
                solved = True
                if ports == 1 and affine:
                    solve_one_port(compliance, level, acting, branch, slider, sub)
                elif ports > 0:
                    solved = solve_ports(compliance, level, rows, acting, memory, sub)
                corner = passes_corner(acting, branch, slider, ports - couplings, seen)
                if (corner or not solved) and level < levels:
                    level += 1
                    continue
                good = good and solved
                accept(motion, acting, memory, level, corner, rows, sub, state)
                position += width
                level = widest_level(position, levels)
    write_outputs(OutputMatrices(*output_tables), inputs, history, force_history, lanes, outputs)
    return good and is_bounded(state)
