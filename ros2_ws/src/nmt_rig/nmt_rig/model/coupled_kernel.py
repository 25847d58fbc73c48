"""Compiled time loop for systems with couplings, i.e. with forces of two arguments.

The scheme is that of integration_kernel.py (exact linear propagation, Hermite holds of the forces, corners located by
halving), with Newton's method on the forces and slopes of all ports and full transition matrices. Systems without
couplings never come here.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from nmt_rig.model.couplings import BOUC_WEN, FORCE_FACTOR, LUGRE
from nmt_rig.model.element_kernels import frozen, next_branch
from nmt_rig.model.integration_kernel import (
    _NEWTON_STEPS,
    _NEWTON_TOLERANCE,
    _SLOPE_TOLERANCE,
    _SMALLEST,
    Integers,
    accept,
    solve_in_place,
)
from nmt_rig.model.structure import Array


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


@njit(cache=True)
def coupled_forces(
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
        forces: (2 ports,) overwritten: forces, slopes.
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


@njit(cache=True)
def integrate_coupled(
    dense: Array,
    start_weights: Array,
    end_weights: Array,
    port_rows: Array,
    port_input: Array,
    compliance: Array,
    kinds: Integers,
    parameters: Array,
    element_port: Integers,
    coupling_kinds: Integers,
    coupling_parameters: Array,
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
    outputs: Array,
) -> bool:
    """Integrate one block; arguments and result as in `integration_kernel.integrate`."""
    samples = inputs.size - 1
    size = state.size
    ports = forces.size // 2
    couplings = coupling_kinds.size
    own = ports - couplings
    rows = kinematics.size
    elements = kinds.size
    trial = state.copy()
    force_trial = forces.copy()
    kin_free = kinematics.copy()
    kin_trial = kinematics.copy()
    tangents = port_rows[:ports, :2].copy()
    jacobian = compliance[0, : 2 * ports, : 2 * ports].copy()
    residual = forces.copy()
    ticks = 1 << levels
    good = True

    for k in range(samples):
        for o in range(outputs.shape[0]):
            total = outputs_input[o] * inputs[k]
            for i in range(size):
                total += outputs_state[o, i] * state[i]
            for q in range(ports):
                total += outputs_force[o, q] * forces[q]
            outputs[o, k] = total
        increment = (inputs[k + 1] - inputs[k]) / substeps
        for s in range(substeps):
            u_start = inputs[k] + s * increment
            position = 0
            level = 0
            while position < ticks:
                width = ticks >> level
                u0 = u_start + increment * (position / ticks)
                u1 = u_start + increment * ((position + width) / ticks)
                for i in range(size):
                    total = start_weights[level, 0, i] * u0 + start_weights[level, 1, i] * u1
                    for j in range(size):
                        total += dense[level, i, j] * state[j]
                    trial[i] = total
                for c in range(2 * ports):
                    value = forces[c]
                    for i in range(size):
                        trial[i] += start_weights[level, 2 + c, i] * value
                for r in range(rows):
                    total = port_input[r] * u1
                    for i in range(size):
                        total += port_rows[r, i] * trial[i]
                    kin_free[r] = total

                solved = False
                for q in range(2 * ports):
                    force_trial[q] = forces[q]
                for _ in range(_NEWTON_STEPS):
                    for r in range(rows):
                        total = kin_free[r]
                        for c in range(2 * ports):
                            total += compliance[level, r, c] * force_trial[c]
                        kin_trial[r] = total
                    coupled_forces(
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
                    for q in range(ports):
                        scale_g = abs(force_trial[q]) + abs(forces[q])
                        scale_s = abs(force_trial[ports + q]) + abs(forces[ports + q])
                        # Written so that NaN counts as not solved.
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
                        next_branch(kinds[e], parameters, e, branch[e], kin_trial[q], kin_trial[own + q], slider[e])
                        != branch[e]
                    ):
                        corner = True
                if (corner or not solved) and level < levels:
                    level += 1
                    continue
                if not solved:
                    good = False

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
                    coupled_forces(
                        kinds, parameters, element_port, branch, slider, coupling_kinds, coupling_parameters,
                        kin_trial, own, force_trial, tangents,
                    )  # fmt: skip
                for q in range(2 * ports):
                    forces[q] = force_trial[q]
                for r in range(rows):
                    kinematics[r] = kin_trial[r]
                counters[0] += 1
                position += width
                level = levels
                while level > 0 and position % (ticks >> (level - 1)) == 0:
                    level -= 1

    for i in range(size):
        if not abs(state[i]) < 1e300:
            good = False
    return good
