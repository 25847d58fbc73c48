"""Compiled time loop for piecewise linear elements at many places: only those that slip or touch are updated.

The scheme is that of integration_kernel.py: exact linear propagation, Hermite holds of the local forces, corners
located on a grid of step / 2^K. Four things differ, so that a place at rest costs nothing:

* The springs of sticking Jenkins elements are part of the linear motion. The residual as a port's force is
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

from typing import Any

import numpy as np

from nmt_core.numerics.kernels import loop_step, njit
from nmt_rig.model.active_ports import (
    AT_END,
    AT_START,
    Active,
    Places,
    SampleMotion,
    Trial,
    follow_branches,
    follow_width,
    project,
    row_product,
    solve_factored,
)
from nmt_rig.model.element_kernels import margin, next_branch, piece
from nmt_rig.model.integration_kernel import (
    _SMALLEST,
    _XX,
    _XY,
    _YX,
    _YY,
    CORNERS,
    JENKINS,
    SUB_STEPS,
    Integers,
    OutputMatrices,
    PortMemory,
    begin_slip,
    hold_inputs,
    is_bounded,
    slip_along,
    widest_level,
)
from nmt_rig.model.structure import Array

# A bound on a motion is a sum of rounded numbers; so much earlier the element itself is looked at.
_CAUTION = 1.0 - 1e-9
# Share of a force that it causes itself by the end of a step, below which forces are iterated for.
_ITERATED_BELOW = 0.05
# Sweeps for the forces end where the next one would change less than this share of them.
_SETTLED = 1e-14
_SWEEPS = 14


@loop_step
def quiet_ticks(
    places: Places, memory: PortMemory, q: int, ticks: int, width: float, w0: float, v0: float, w1: float, v1: float
) -> int:
    """How many of the ticks of a sub-step a port's elements keep their branches, by the cubic through both ends.

    Args:
        places, memory: as for `integrate_contacts`.
        q: the port.
        ticks: in the sub-step.
        width: of the sub-step, s.
        w0, v0, w1, v1: displacement and velocity at its ends.
    """
    branch, slider = memory.branch, memory.slider
    low = 0
    high = ticks
    while high - low > 1:
        middle = (low + high) // 2
        x = middle / ticks
        y = 1.0 - x
        w = y * y * ((1.0 + 2.0 * x) * w0 + x * width * v0) + x * x * ((1.0 + 2.0 * y) * w1 - y * width * v1)
        v = 6.0 * x * y * (w1 - w0) / width + y * (y - 2.0 * x) * v0 + x * (x - 2.0 * y) * v1
        kept = True
        for n in range(places.port_start[q], places.port_start[q + 1]):
            e = places.port_elements[n]
            if next_branch(places.kinds[e], places.parameters, e, branch[e], w, v, slider[e]) != branch[e]:
                kept = False
        if kept:
            low = middle
        else:
            high = middle
    return low


@loop_step
def move(
    motion: SampleMotion, now: Active, exciters: tuple[int, ...], state: Array, level: int, ends: Array, trial: Array
) -> None:
    """The state (Z,) at the end of a sub-step without the active ports' forces, for the inputs at its ends."""
    pair, weights, steady_step = motion.pair, motion.start_weights, now.steady_step
    pairs = state.size // 2
    for i in range(pairs):
        j = pairs + i
        x = state[i]
        y = state[j]
        first = pair[level, _XX, i] * x + pair[level, _XY, i] * y
        second = pair[level, _YX, i] * x + pair[level, _YY, i] * y
        for e in range(len(exciters)):
            first += weights[level, 2 * e, i] * ends[e, 0] + weights[level, 2 * e + 1, i] * ends[e, 1]
            second += weights[level, 2 * e, j] * ends[e, 0] + weights[level, 2 * e + 1, j] * ends[e, 1]
        trial[i] = first + steady_step[level, i]
        trial[j] = second + steady_step[level, j]


@loop_step
def add_held(holds: Array, level: int, end: int, force: Array, slope: Array, trial: Array) -> None:
    """Add what projected forces and slopes (Z,) at one end of a step (`AT_START`, `AT_END`) do to the state."""
    pairs = force.size // 2
    for i in range(pairs):
        j = pairs + i
        trial[i] += (holds[level, end, _XX, i] * force[i] + holds[level, end, _XY, i] * force[j]) + (
            holds[level, end + 1, _XX, i] * slope[i] + holds[level, end + 1, _XY, i] * slope[j]
        )
        trial[j] += (holds[level, end, _YX, i] * force[i] + holds[level, end, _YY, i] * force[j]) + (
            holds[level, end + 1, _YX, i] * slope[i] + holds[level, end + 1, _YY, i] * slope[j]
        )


@loop_step
def sweep_forces(
    answers: Array, now: Active, trial: Trial, count: int, level: int, span: float, gain: float, iterated: bool
) -> None:
    """Forces and slopes of the active ports at the end of a sub-step into `trial.right`, what they see into
    `trial.seen`.

    Args:
        count: of active ports.
        span: of the sub-step, s.
        gain: of its width, see `SampleMotion`.
        iterated: whether the forces are still to be found.
    """
    seen, right, change = trial.seen, trial.right, trial.change
    active, stiffness, constant = now.ports, now.stiffness, now.constant
    ports = stiffness.size
    for _ in range(_SWEEPS):
        for q in range(2 * ports):
            seen[q] = trial.free[q]
        for b in range(count):
            c = active[b]
            g = right[b]
            slope = right[count + b]
            for q in range(2 * ports):
                seen[q] += answers[level, c, q] * g + answers[level, ports + c, q] * slope
        largest = 0.0
        for a in range(count if iterated else 0):
            q = active[a]
            g = constant[q] + stiffness[q] * seen[q]
            slope = stiffness[q] * seen[ports + q]
            change[a] = abs(g - right[a]) + span * abs(slope - right[count + a])
            largest = max(largest, change[a])
            right[a] = g
            right[count + a] = slope
        # The next sweep would change no force more than this. NaN counts as settled; the state tells.
        largest *= gain
        settled = True
        for a in range(count if iterated else 0):
            scale = abs(right[a]) + abs(constant[active[a]]) + span * abs(right[count + a])
            if min(change[a], largest) > _SETTLED * scale + _SMALLEST:
                settled = False
        if settled:
            break


@loop_step
def solve_active(
    motion: SampleMotion, now: Active, trial: Trial, count: int, level: int, span: float, iterated: bool
) -> None:
    """Forces of the active ports at the end of a sub-step, and the state there with them."""
    port_rows, stiffness = motion.port_rows, now.stiffness
    size, ports = trial.state.size, stiffness.size
    add_held(motion.holds, level, AT_START, trial.own, trial.own_slope, trial.state)
    for a in range(count):
        q = now.ports[a]
        w = row_product(port_rows, q, trial.state, size)
        v = row_product(port_rows, ports + q, trial.state, size)
        trial.free[q] = w
        trial.free[ports + q] = v
        trial.right[a] = now.constant[q] + stiffness[q] * w
        trial.right[count + a] = stiffness[q] * v
    if not iterated:
        solve_factored(now.columns, level, now.order, trial.right, 2 * count)
    sweep_forces(motion.answers, now, trial, count, level, span, motion.gains[level], iterated)
    for a in range(count):
        q = now.ports[a]
        trial.w[q] = trial.seen[q]
        trial.v[q] = trial.seen[ports + q]
        trial.forces[q] = trial.right[a]
        trial.forces[ports + q] = trial.right[count + a]
    project(motion.projection, now.ports, count, trial.forces, trial.next_own, trial.next_slope)
    add_held(motion.holds, level, AT_END, trial.next_own, trial.next_slope, trial.state)


@loop_step
def turns_of_active(places: Places, memory: PortMemory, now: Active, trial: Trial, count: int) -> bool:
    """Whether an active port's element leaves its branch by the end of a sub-step; told in `trial.turned`."""
    branch, slider = memory.branch, memory.slider
    corner = False
    for a in range(count):
        q = now.ports[a]
        for n in range(places.port_start[q], places.port_start[q + 1]):
            e = places.port_elements[n]
            if (
                next_branch(places.kinds[e], places.parameters, e, branch[e], trial.w[q], trial.v[q], slider[e])
                != branch[e]
            ):
                corner = True
                trial.turned[q] = True
    return corner


@loop_step
def way_of(reach: Array, before: Array, after: Array) -> float:
    """Bound on the motion of any port between two states (Z,), m."""
    pairs = before.size // 2
    move0 = 0.0
    move1 = 0.0
    for i in range(pairs):
        move0 += reach[i] * abs(after[i] - before[i])
        move1 += reach[pairs + i] * abs(after[pairs + i] - before[pairs + i])
    return move0 + move1


@loop_step
def look_at_resting(
    motion: SampleMotion, places: Places, memory: PortMemory, due: Array, ahead: float, now: Active, trial: Trial
) -> tuple[int, bool]:
    """Look at the resting ports that are due after the way `ahead`.

    Returns:
        How many were looked at (`trial.looked`), and whether one leaves its branch (`trial.turned`).
    """
    branch, slider = memory.branch, memory.slider
    seen = 0
    corner = False
    for q in range(due.size):
        if now.place[q] >= 0 or ahead < due[q]:
            continue
        trial.w[q] = row_product(motion.port_rows, q, trial.state, trial.state.size)
        near = np.inf
        for n in range(places.port_start[q], places.port_start[q + 1]):
            e = places.port_elements[n]
            kind = places.kinds[e]
            if next_branch(kind, places.parameters, e, branch[e], trial.w[q], 0.0, slider[e]) != branch[e]:
                corner = True
                trial.turned[q] = True
            near = min(near, margin(kind, places.parameters, e, branch[e], trial.w[q], slider[e]))
        trial.due[q] = _CAUTION * near
        trial.looked[seen] = q
        seen += 1
    return seen, corner


@loop_step
def ticks_before_corner(
    motion: SampleMotion,
    places: Places,
    memory: PortMemory,
    state: Array,
    now: Active,
    trial: Trial,
    width: int,
    span: float,
) -> int:
    """Ticks to the tick before the first corner of a refused sub-step; `trial.turned` is cleared.

    Where the corner lies is guessed, what is accepted is not.
    """
    port_rows, ports, size = motion.port_rows, now.place.size, state.size
    kept = width
    for q in range(ports):
        if trial.turned[q]:
            w = memory.kinematics[q]
            v = memory.kinematics[ports + q]
            if now.place[q] < 0:
                w = row_product(port_rows, q, state, size)
                v = row_product(port_rows, ports + q, state, size)
                trial.v[q] = row_product(port_rows, ports + q, trial.state, size)
            kept = min(kept, quiet_ticks(places, memory, q, width, span, w, v, trial.w[q], trial.v[q]))
            trial.turned[q] = False
    return kept


@loop_step
def accept_active(places: Places, memory: PortMemory, now: Active, trial: Trial, count: int) -> None:
    """Take over forces and motion of the active ports, and move the sliders that slip with them."""
    forces, kinematics, branch = memory.forces, memory.kinematics, memory.branch
    w_trial, ports = trial.w, now.place.size
    for a in range(count):
        q = now.ports[a]
        for n in range(places.port_start[q], places.port_start[q + 1]):
            e = places.port_elements[n]
            if places.kinds[e] == JENKINS and branch[e] != 0:
                slip_along(places.parameters, e, memory, kinematics[q], w_trial[q])
        forces[q] = trial.forces[q]
        forces[ports + q] = trial.forces[ports + q]
        kinematics[q] = w_trial[q]
        kinematics[ports + q] = trial.v[q]
    if count > 0:
        for i in range(trial.own.size):
            trial.own[i] = trial.next_own[i]
            trial.own_slope[i] = trial.next_slope[i]


@loop_step
def switch_branches(
    motion: SampleMotion,
    places: Places,
    memory: PortMemory,
    due: Array,
    way: float,
    state: Array,
    now: Active,
    trial: Trial,
) -> None:
    """Take the branches that fit at a corner, with the forces of the ports where one changes."""
    forces, kinematics, branch, slider = memory.forces, memory.kinematics, memory.branch, memory.slider
    kinds, parameters, port_rows = places.kinds, places.parameters, motion.port_rows
    ports, size = due.size, state.size
    for q in range(ports):
        changed = False
        if now.place[q] < 0:
            if due[q] > way:
                continue
            trial.w[q] = row_product(port_rows, q, state, size)
            trial.v[q] = 0.0  # a resting element does not ask for it
        for n in range(places.port_start[q], places.port_start[q + 1]):
            e = places.port_elements[n]
            new = next_branch(kinds[e], parameters, e, branch[e], trial.w[q], trial.v[q], slider[e])
            if new != branch[e]:
                if kinds[e] == JENKINS and branch[e] == 0:
                    begin_slip(parameters, e, memory, new, trial.w[q])
                branch[e] = new
                changed = True
        if changed:
            kinematics[q] = trial.w[q]
            kinematics[ports + q] = row_product(port_rows, ports + q, state, size)
            k_sum = 0.0
            rest = 0.0
            near = np.inf
            for n in range(places.port_start[q], places.port_start[q + 1]):
                e = places.port_elements[n]
                own_k, own_rest = piece(kinds[e], parameters, e, branch[e], slider[e])
                k_sum += own_k - places.absorbed[e]
                rest += own_rest
                near = min(near, margin(kinds[e], parameters, e, branch[e], kinematics[q], slider[e]))
            forces[q] = rest + k_sum * kinematics[q]
            forces[ports + q] = k_sum * kinematics[ports + q]
            due[q] = way + _CAUTION * near


@loop_step
def begin_again(due: Array, way: Array, place: Integers, looked: Integers, later: Array, seen: int) -> float:
    """Count the way from here, lest it lose digits; returns the way at which the first resting port is due.

    Args:
        due, way, place: as for `integrate_contacts` and `Active`.
        looked, later: resting ports that were looked at, the first `seen`, and the way (ports,) at which they are due.
    """
    for q in range(due.size):
        due[q] -= way[0]
    way[0] = 0.0
    for n in range(seen):
        due[looked[n]] = later[looked[n]]
    earliest = np.inf
    for q in range(due.size):
        if place[q] < 0:
            earliest = min(earliest, due[q])
    return earliest


@loop_step
def accept(
    motion: SampleMotion, places: Places, memory: PortMemory, due: Array, way: Array, state: Array, now: Active,
    trial: Trial, count: int, seen: int, corner: bool, earliest: float,
) -> float:  # fmt: skip
    """Take over the end of a sub-step, with the branches that fit past a corner.

    Args:
        motion, places, memory, due, way, state: as for `integrate_contacts`.
        now, trial: what follows from the branches, and the sub-step.
        count, seen: of the active ports, and of the resting ones that were looked at.
        corner: whether an element leaves its branch.
        earliest: the way at which the first resting port is due.

    Returns:
        The same, after the sub-step.
    """
    for q in range(due.size if corner else 0):
        trial.turned[q] = False
    for i in range(state.size):
        state[i] = trial.state[i]
    accept_active(places, memory, now, trial, count)
    if seen > 0:
        earliest = begin_again(due, way, now.place, trial.looked, trial.due, seen)
    if corner:
        memory.counters[CORNERS] += 1
        switch_branches(motion, places, memory, due, way[0], state, now, trial)
    memory.counters[SUB_STEPS] += 1
    return earliest


@loop_step
def narrowed(position: int, goal: int, level: int, levels: int) -> int:
    """Halvings, at least `level`, of a sub-step that starts at a tick and does not pass the goal."""
    while level < levels and position + ((1 << levels) >> level) > goal:
        level += 1
    return level


@loop_step
def next_level(position: int, goal: int, levels: int) -> int:
    """Halvings of the widest sub-step that starts at a tick, stays on the dyadic grid and does not pass the goal."""
    level: int = widest_level(position, levels)
    if position <= goal:
        level = narrowed(position, goal, level, levels)
    return level


@loop_step
def write_outputs(
    rows: OutputMatrices, state: Array, forces: Array, ports: int, inputs: Array, k: int, out: Array
) -> None:
    """Outputs (outputs, n) at sample k, for the inputs (exciters, n + 1)."""
    for o in range(out.shape[0]):
        total = rows.inputs[o, 0] * inputs[0, k]
        for e in range(1, inputs.shape[0]):
            total += rows.inputs[o, e] * inputs[e, k]
        total += row_product(rows.state, o, state, state.size)
        out[o, k] = total + row_product(rows.force, o, forces, ports)


@njit(cache=True, inline="always")
def work_space(levels: int, ports: int, state: Array, forces: Array) -> tuple[Active, Trial]:
    """Room for what follows from the branches, and for a sub-step."""
    size = state.size
    now = Active(
        np.zeros(ports), np.zeros(ports), np.zeros(ports, dtype=np.int64), np.zeros(ports, dtype=np.int64),
        np.zeros(size), np.zeros((levels + 1, size)), np.zeros((levels + 1, 2 * ports, 2 * ports)),
        np.zeros((levels + 1, 2 * ports), dtype=np.int64), np.zeros(levels + 1, dtype=np.bool_),
    )  # fmt: skip
    trial = Trial(
        state.copy(), np.zeros(ports), np.zeros(ports), forces.copy(), np.zeros(ports),
        np.zeros(ports, dtype=np.int64), np.zeros(ports, dtype=np.bool_),
        np.zeros(size), np.zeros(size), np.zeros(size), np.zeros(size), np.zeros(2 * ports), np.zeros(2 * ports),
        np.zeros(2 * ports), np.zeros(ports),
    )  # fmt: skip
    return now, trial


@njit(cache=True)
def integrate_contacts(
    motion_tables: tuple[Any, ...],
    place_tables: tuple[Any, ...],
    output_tables: tuple[Array, Array, Array],
    memory_tables: tuple[Any, ...],
    exciters: tuple[int, ...],
    substeps: int,
    inputs: Array,
    state: Array,
    due: Array,
    way: Array,
    outputs: Array,
) -> bool:
    """Integrate one block; outputs are taken at the samples, before each step.

    Args:
        motion_tables, place_tables, output_tables: `SampleMotion`, `Places` and `OutputMatrices` of the system as plain
            tuples, which come from Python sooner than named ones.
        memory_tables: likewise the `PortMemory`, updated; its kinematics are those of active ports.
        exciters: their numbers, from 0.
        substeps: per sample.
        inputs: (exciters, n + 1) input at the samples and one beyond; straight between them.
        state: (Z,) working state, updated.
        due: (ports,) the way of the state at which a port at rest is to be looked at, updated.
        way: (1,) of the state so far, m, updated.
        outputs: (outputs, n) overwritten.

    Returns:
        False where the state stopped being finite.
    """
    motion, places = SampleMotion(*motion_tables), Places(*place_tables)
    rows, memory = OutputMatrices(*output_tables), PortMemory(*memory_tables)
    levels = motion.gains.size - 1
    ports = due.size
    now, trial = work_space(levels, ports, state, memory.forces)
    forces, known, end = memory.forces, now.known, trial.state
    matrix = np.zeros((2 * ports, 2 * ports))
    row_order = np.zeros(2 * ports, dtype=np.int64)
    iterated = motion.gains < _ITERATED_BELOW
    ticks = 1 << levels
    count, earliest, fresh = 0, 0.0, False
    increments, ends = np.zeros(len(exciters)), np.zeros((len(exciters), 2))
    for k in range(inputs.shape[1] - 1):
        write_outputs(rows, state, forces, ports, inputs, k, outputs)
        for e in range(len(exciters)):
            increments[e] = (inputs[e, k + 1] - inputs[e, k]) / substeps
        for s in range(substeps):
            position = 0
            level = 0
            goal = 0
            while position < ticks:
                if not fresh:
                    count, earliest = follow_branches(motion, places, memory, due, now, trial)
                    fresh = True
                if not known[level]:
                    follow_width(motion, now, level, 0 if iterated[level] else count, matrix, row_order)
                width = ticks >> level
                span = motion.step * width / ticks
                hold_inputs(exciters, inputs, increments, k, s, position / ticks, (position + width) / ticks, ends)
                move(motion, now, exciters, state, level, ends, end)
                if count > 0:
                    solve_active(motion, now, trial, count, level, span, iterated[level])
                corner = turns_of_active(places, memory, now, trial, count)
                ahead = way[0] + way_of(motion.reach, state, end)
                seen = 0
                if not ahead < earliest:
                    seen, left = look_at_resting(motion, places, memory, due, ahead, now, trial)
                    corner = corner or left
                if corner and level < levels:
                    goal = position + ticks_before_corner(motion, places, memory, state, now, trial, width, span)
                    level = narrowed(position, goal, level + 1, levels)
                    continue
                way[0] = ahead
                earliest = accept(motion, places, memory, due, way, state, now, trial, count, seen, corner, earliest)
                fresh = not corner
                position += width
                level = next_level(position, goal, levels)
    bounded: bool = is_bounded(state)
    return bounded
