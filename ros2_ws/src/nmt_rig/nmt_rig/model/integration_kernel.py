"""Compiled time loop: exact linear propagation, implicit local forces, corners located by halving the step.

A piecewise linear element (Jenkins, stop, gap) has a branch: sticking 0, slipping ±1; open 0, closed ±1.
Within a sub-step branches are frozen; a sub-step whose end contradicts its branch is refused and halved, down
to step / 2^K. There it is accepted and the branch switched, so a corner is timed to step / 2^K.

Ports of elements come first, those of couplings (forces of two arguments) behind them. Newton's method works on the
forces and slopes of all of them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nmt_core.numerics.kernels import njit
from nmt_rig.model.couplings import BOUC_WEN, FORCE_FACTOR, LUGRE
from nmt_rig.model.element_kernels import frozen, next_branch_here, piece_here
from nmt_rig.model.local_elements.friction import Jenkins
from nmt_rig.model.structure import Array

JENKINS = Jenkins.kind
_NEWTON_STEPS = 25
_NEWTON_TOLERANCE = 1e-13
_SLOPE_TOLERANCE = 1e-9
_SMALLEST = 1e-290

Integers = NDArray[np.int64]


class Memory(NamedTuple):
    """What ports and elements carry from one sub-step to the next; arrays that the kernels update.

    Attributes:
        forces: (2 ports,) port forces (N) and slopes (N/s) at the present time.
        kinematics: (3 own + 4 couplings,) what elements and couplings see, see `port_forces`.
        branch: (elements,) sticking 0, slipping ±1; open 0, closed ±1.
        slider: (elements,) m.
        dissipated: (elements,) energy lost in sliders, J.
        counters: [sub-steps, corners].
    """

    forces: Array
    kinematics: Array
    branch: Integers
    slider: Array
    dissipated: Array
    counters: Integers


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


@njit(cache=True)
def coupling_response(kind: int, p: Array, first: float, second: float) -> tuple[float, float, float]:
    """f, ∂f/∂y₁ and ∂f/∂y₂ of one coupling.

    Args:
        kind: code of the coupling.
        p: (COUPLING_PARAMETERS,) parameters.
        first, second: y₁ and y₂.
    """
    if kind == FORCE_FACTOR:
        share = first * (p[1] + p[2] * first)
        return p[0] * share * second, p[0] * (p[1] + 2.0 * p[2] * first) * second, p[0] * share
    if kind == BOUC_WEN:
        v, z = first, second
        reach = abs(z) / p[0]
        side = 1.0 if v * z > 0.0 else -1.0
        weight = p[2] * side + 1.0 - p[2]
        power = reach ** p[1]
        by_z = 0.0
        if z != 0.0:
            by_z = v * weight * p[1] * power / z
        return v * power * weight, power * weight, by_z
    if kind == LUGRE:
        v, z = first, second
        ratio = v / p[3]
        bump = (p[2] - p[1]) * np.exp(-ratio * ratio)
        level = p[1] + bump
        side = 1.0 if v > 0.0 else -1.0
        f = p[0] * abs(v) * z / level
        by_v = p[0] * z / level * (side + abs(v) * bump * 2.0 * ratio / (p[3] * level))
        return f, by_v, p[0] * abs(v) / level
    return 0.0, 0.0, 0.0


@njit(cache=True, forceinline=True)
def port_forces(
    kinds: Integers,
    parameters: Array,
    element_port: Integers,
    branch: Integers,
    slider: Array,
    coupling_kinds: Integers,
    coupling_parameters: Array,
    kinematics: Array,
    own: int,
    forces: Array,
    tangents: Array,
) -> None:
    """Forces, slopes and tangents of all ports for what elements and couplings see.

    Args:
        kinds, parameters, element_port, branch, slider: (elements,…) description and memory.
        coupling_kinds, coupling_parameters: (couplings,…).
        kinematics: (3 own + 4 couplings,) displacements, velocities, accelerations of the elements' ports, then what
            the couplings observe, then its rates.
        own: number of ports of elements.
        forces: (2 ports,) overwritten: forces (N), slopes (N/s).
        tangents: (ports, 2) overwritten: with respect to displacement and velocity, or to y₁ and y₂.
    """
    ports = tangents.shape[0]
    for q in range(ports):
        forces[q] = 0.0
        tangents[q, 0] = 0.0
        tangents[q, 1] = 0.0
    for e in range(kinds.size):
        q = element_port[e]
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
            coupling_kinds[k], coupling_parameters[k], kinematics[first], kinematics[first + 1]
        )
        forces[q] = f
        tangents[q, 0] = f_1
        tangents[q, 1] = f_2
        forces[ports + q] = f_1 * kinematics[rate] + f_2 * kinematics[rate + 1]


@njit(cache=True, forceinline=True)
def accept(
    kinds: Integers,
    parameters: Array,
    element_port: Integers,
    branch: Integers,
    slider: Array,
    dissipated: Array,
    before: Array,
    after: Array,
    ports: int,
    corner: bool,
) -> None:
    """Move the sliders that slip with their ports, count what they lose; past a corner, take the branches that fit."""
    for e in range(kinds.size):
        q = element_port[e]
        if kinds[e] == JENKINS and branch[e] != 0:
            dissipated[e] += branch[e] * parameters[e, 1] * (after[q] - before[q])
            slider[e] = after[q] - branch[e] * parameters[e, 1] / parameters[e, 0]
        if corner:
            new = next_branch_here(kinds[e], parameters, e, branch[e], after[q], after[ports + q], slider[e])
            if new != branch[e] and branch[e] == 0 and kinds[e] == JENKINS:
                slipped = after[q] - new * parameters[e, 1] / parameters[e, 0]
                dissipated[e] += new * parameters[e, 1] * (slipped - slider[e])
                slider[e] = slipped
            branch[e] = new


@njit(cache=True)
def integrate(
    modal: bool,
    pair: Array,
    dense: Array,
    start_weights: Array,
    end_weights: Array,
    port_rows: Array,
    port_input: Array,
    port_feedthrough: Array,
    compliance: Array,
    kinds: Integers,
    parameters: Array,
    element_port: Integers,
    coupling_kinds: Integers,
    coupling_parameters: Array,
    affine: bool,
    levels: int,
    substeps: int,
    inputs: Array,
    state: Array,
    forces: Array,
    kinematics: Array,
    branch: Integers,
    slider: Array,
    dissipated: Array,
    counters: Integers,
    outputs_state: Array,
    outputs_force: Array,
    outputs_input: Array,
    history: Array,
    force_history: Array,
    outputs: Array,
) -> bool:
    """Integrate one block; outputs are taken at the samples, before each step.

    Args:
        affine: all elements are piecewise linear, and there are no couplings.
        inputs: (n + 1,) input at the samples and one beyond; straight between them.
        state: (Z,) working state, updated.
        forces: (2 ports,) port forces and slopes at the present time, updated.
        kinematics: (3 own + 4 couplings,) of the ports at the present time, see `port_forces`, updated.
        branch, slider, dissipated: (elements,) memory and energy lost in sliders (J), updated.
        counters: [sub-steps, corners], updated.
        outputs_state, outputs_force, outputs_input: C (outputs, Z), D_g (outputs, ports), D_u (outputs,).
        history, force_history: (Z, ≥ n) and (ports, ≥ n) work space.
        outputs: (outputs, n) overwritten.

    Returns:
        False where the state stopped being finite or Newton's method failed.
    """
    samples = inputs.size - 1
    size = state.size
    pairs = size // 2
    ports = port_feedthrough.shape[1]
    elements = kinds.size
    couplings = coupling_kinds.size
    own = ports - couplings
    trial = state.copy()
    force_trial = forces.copy()
    kin_free = kinematics.copy()
    kin_trial = kinematics.copy()
    tangents = np.zeros((ports, 2))
    jacobian = outputs_state[:0, :0].copy()
    residual = forces.copy()
    if ports > 0:
        jacobian = compliance[0, : 2 * ports, : 2 * ports].copy()
    ticks = 1 << levels
    # Accelerations of the ports matter only to elements that depend on velocity.
    rows = 2 * ports if affine else kinematics.size
    # Sums are taken four terms at a time, of systems with couplings one at a time.
    lanes = size - size % 4 if couplings == 0 else 0
    good = True

    for k in range(samples):
        for i in range(size):
            history[i, k] = state[i]
        for q in range(ports):
            force_history[q, k] = forces[q]
        increment = (inputs[k + 1] - inputs[k]) / substeps
        for s in range(substeps):
            u_start = inputs[k] + s * increment
            position = 0
            level = 0
            while position < ticks:
                width = ticks >> level
                u0 = u_start + increment * (position / ticks)
                u1 = u_start + increment * ((position + width) / ticks)
                # Free motion: everything known at the start of the sub-step. Indices are written out in full:
                # a view in this loop would cost more than the arithmetic.
                if modal:
                    if ports == 1:
                        g0 = forces[0]
                        s0 = forces[1]
                        for i in range(pairs):
                            j = pairs + i
                            x = state[i]
                            y = state[j]
                            trial[i] = (
                                (pair[level, 0, i] * x + pair[level, 1, i] * y)
                                + (start_weights[level, 0, i] * u0 + start_weights[level, 1, i] * u1)
                                + (start_weights[level, 2, i] * g0 + start_weights[level, 3, i] * s0)
                            )
                            trial[j] = (
                                (pair[level, 2, i] * x + pair[level, 3, i] * y)
                                + (start_weights[level, 0, j] * u0 + start_weights[level, 1, j] * u1)
                                + (start_weights[level, 2, j] * g0 + start_weights[level, 3, j] * s0)
                            )
                    else:
                        for i in range(pairs):
                            j = pairs + i
                            x = state[i]
                            y = state[j]
                            trial[i] = (pair[level, 0, i] * x + pair[level, 1, i] * y) + (
                                start_weights[level, 0, i] * u0 + start_weights[level, 1, i] * u1
                            )
                            trial[j] = (pair[level, 2, i] * x + pair[level, 3, i] * y) + (
                                start_weights[level, 0, j] * u0 + start_weights[level, 1, j] * u1
                            )
                else:
                    for i in range(size):
                        total = start_weights[level, 0, i] * u0 + start_weights[level, 1, i] * u1
                        for j in range(size):
                            total += dense[level, i, j] * state[j]
                        trial[i] = total
                if ports != 1 or not modal:
                    for c in range(2 * ports):
                        value = forces[c]
                        for i in range(size):
                            trial[i] += start_weights[level, 2 + c, i] * value
                for r in range(rows):
                    total0 = port_input[r] * u1
                    total1 = 0.0
                    total2 = 0.0
                    total3 = 0.0
                    for i in range(0, lanes, 4):
                        total0 += port_rows[r, i] * trial[i]
                        total1 += port_rows[r, i + 1] * trial[i + 1]
                        total2 += port_rows[r, i + 2] * trial[i + 2]
                        total3 += port_rows[r, i + 3] * trial[i + 3]
                    for i in range(lanes, size):
                        total0 += port_rows[r, i] * trial[i]
                    kin_free[r] = (total0 + total1) + (total2 + total3)

                # Port forces at the end: implicit. One port of piecewise linear elements in closed form,
                # otherwise Newton's method on forces and slopes.
                solved = ports == 0
                if ports == 1 and affine:
                    k_sum = 0.0
                    g_rest = 0.0
                    for e in range(elements):
                        own_k, own_rest = piece_here(kinds[e], parameters, e, branch[e], slider[e])
                        k_sum += own_k
                        g_rest += own_rest
                    w = kin_free[0]
                    v = kin_free[1]
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
                    force_trial[0] = g1
                    force_trial[1] = s1
                    kin_trial[0] = w + (compliance[level, 0, 0] * g1 + compliance[level, 0, 1] * s1)
                    kin_trial[1] = v + (compliance[level, 1, 0] * g1 + compliance[level, 1, 1] * s1)
                    solved = True
                elif ports > 0:
                    for q in range(2 * ports):
                        force_trial[q] = forces[q]
                    for _ in range(_NEWTON_STEPS):
                        for r in range(rows):
                            total = kin_free[r]
                            for c in range(2 * ports):
                                total += compliance[level, r, c] * force_trial[c]
                            kin_trial[r] = total
                        port_forces(
                            kinds, parameters, element_port, branch, slider, coupling_kinds, coupling_parameters,
                            kin_trial, own, residual, tangents,
                        )  # fmt: skip
                        for q in range(2 * ports):
                            residual[q] -= force_trial[q]
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
                                    tangents[q, 0] * compliance[level, first, c]
                                    + tangents[q, 1] * compliance[level, second, c]
                                )
                                jacobian[ports + q, c] = -(
                                    tangents[q, 0] * compliance[level, rate_first, c]
                                    + tangents[q, 1] * compliance[level, rate_second, c]
                                )
                            jacobian[q, q] += 1.0
                            jacobian[ports + q, ports + q] += 1.0
                        solve_in_place(jacobian, residual, 2 * ports)
                        for q in range(2 * ports):
                            force_trial[q] += residual[q]
                        solved = True
                        if not affine:
                            for q in range(ports):
                                scale_g = abs(force_trial[q]) + abs(forces[q])
                                scale_s = abs(force_trial[ports + q]) + abs(forces[ports + q])
                                # The slope's tangents leave out second derivatives. NaN counts as not solved.
                                if not abs(residual[q]) <= _NEWTON_TOLERANCE * scale_g + _SMALLEST:
                                    solved = False
                                if not abs(residual[ports + q]) <= _SLOPE_TOLERANCE * scale_s + _SMALLEST:
                                    solved = False
                        if solved:
                            break
                    for r in range(rows):
                        total = kin_free[r]
                        for c in range(2 * ports):
                            total += compliance[level, r, c] * force_trial[c]
                        kin_trial[r] = total

                corner = False
                for e in range(elements):
                    q = element_port[e]
                    if (
                        next_branch_here(
                            kinds[e], parameters, e, branch[e], kin_trial[q], kin_trial[own + q], slider[e]
                        )
                        != branch[e]
                    ):
                        corner = True
                if (corner or not solved) and level < levels:
                    level += 1
                    continue
                if not solved:
                    good = False

                # Accept the sub-step.
                if ports == 1 and couplings == 0:
                    g1 = force_trial[0]
                    s1 = force_trial[1]
                    for i in range(size):
                        state[i] = trial[i] + (end_weights[level, 0, i] * g1 + end_weights[level, 1, i] * s1)
                else:
                    for c in range(2 * ports):
                        value = force_trial[c]
                        for i in range(size):
                            trial[i] += end_weights[level, c, i] * value
                    for i in range(size):
                        state[i] = trial[i]
                accept(
                    kinds, parameters, element_port, branch, slider, dissipated, kinematics, kin_trial, own, corner
                )  # fmt: skip
                if corner:
                    counters[1] += 1
                    port_forces(
                        kinds, parameters, element_port, branch, slider, coupling_kinds, coupling_parameters,
                        kin_trial, own, force_trial, tangents,
                    )  # fmt: skip
                for q in range(2 * ports):
                    forces[q] = force_trial[q]
                for r in range(rows):
                    kinematics[r] = kin_trial[r]
                counters[0] += 1
                position += width
                # Widest sub-step that starts here and stays on the dyadic grid.
                level = levels
                while level > 0 and position % (ticks >> (level - 1)) == 0:
                    level -= 1

    # Outputs sample by sample in the inner loop: vectorised without changing the order of a sample's sum.
    for o in range(outputs.shape[0]):
        for k in range(samples):
            outputs[o, k] = outputs_input[o] * inputs[k]
        for i in range(0, lanes, 4):
            c0 = outputs_state[o, i]
            c1 = outputs_state[o, i + 1]
            c2 = outputs_state[o, i + 2]
            c3 = outputs_state[o, i + 3]
            for k in range(samples):
                outputs[o, k] += (c0 * history[i, k] + c1 * history[i + 1, k]) + (
                    c2 * history[i + 2, k] + c3 * history[i + 3, k]
                )
        for i in range(lanes, size):
            for k in range(samples):
                outputs[o, k] += outputs_state[o, i] * history[i, k]
        for q in range(ports):
            for k in range(samples):
                outputs[o, k] += outputs_force[o, q] * force_history[q, k]
    for i in range(size):
        if not abs(state[i]) < 1e300:
            good = False
    return good
