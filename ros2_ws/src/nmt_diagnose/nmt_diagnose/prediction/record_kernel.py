"""Compiled stepping of a rig through a record: exact recursion of its poles, local forces by Newton's method."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from nmt_core.numerics.arrays import ComplexArray, FloatArray, IntArray
from nmt_core.numerics.kernels import loop_step, njit
from nmt_diagnose.prediction.linear_model import LinearModel
from nmt_diagnose.prediction.rig_tables import FACTOR_LINEAR, FACTOR_QUADRATIC
from nmt_diagnose.prediction.timed_elements import TimedTables, no_timed_elements, timed_force
from nmt_rig.model.aft import ElementTables, LocalTables
from nmt_rig.model.element_kernels import response
from nmt_rig.model.local_elements.element import (
    CONTACT_GAP,
    CONTACT_SIDE,
    CONTACT_STIFFNESS,
    SLIDER_SLIP,
    SLIDER_STIFFNESS,
)
from nmt_rig.model.local_elements.friction import Jenkins

_moved = njit(Jenkins.moved)

MOTIONS_GIVEN = 3
"""Inputs where the drive point is moved: its displacement, velocity and acceleration."""
_SERIES_BELOW = 0.3  # of z = λ h, where differences of exponentials lose digits
ITERATIONS = 12
TOLERANCE = 1e-7  # of the largest force so far


class SteppedModel(NamedTuple):
    """Recursion of the poles of a linear model over one step; one k for each pair of poles, real parts are meant.

    Attributes:
        decay: (k,) of a step.
        early, late: (k, p) shares of the inputs at the beginning and at the end of a step.
        outputs: (o, k) coordinates and channels.
        velocities: (r, k) of the coordinates.
        direct: (o, p) direct share of the inputs in the outputs.
    """

    decay: ComplexArray
    early: ComplexArray
    late: ComplexArray
    outputs: ComplexArray
    velocities: ComplexArray
    direct: FloatArray


class StepWork(NamedTuple):
    """What the steps of r coordinates carry from one to the next, and work space.

    Attributes:
        sliders, moved: positions of the sliders before and after a step, m.
        memory, remembered: of timed elements before and after a step, (n, 3).
        g, before: (r,) forces at the end of the last step and of the one before it, N.
        trial: (r,) forces tried at the end of a step.
        free_w, free_v: (r,) displacements and velocities there without forces at the end.
        w, v: (r,) with those tried.
        by_displacement, by_velocity: (r, r) tangents of the forces.
        dw, dv: (r, r) what a force at the end of a step does to displacement and velocity there.
        system: (r, r + 1) equations of a step of Newton's method.
    """

    sliders: FloatArray
    moved: FloatArray
    memory: FloatArray
    remembered: FloatArray
    g: FloatArray
    before: FloatArray
    trial: FloatArray
    free_w: FloatArray
    free_v: FloatArray
    w: FloatArray
    v: FloatArray
    by_displacement: FloatArray
    by_velocity: FloatArray
    dw: FloatArray
    dv: FloatArray
    system: FloatArray


@njit(cache=True)
def _room(model: SteppedModel, r: int, sliders: int, timed: int) -> StepWork:
    """At rest."""
    outputs, velocities, late = model.outputs, model.velocities, model.late
    count = late.shape[0]
    dw, dv = np.zeros((r, r)), np.zeros((r, r))
    for i in range(r):
        for j in range(r):
            for k in range(count):
                dw[i, j] += (outputs[i, k] * late[k, j]).real
                dv[i, j] += (velocities[i, k] * late[k, j]).real
    return StepWork(
        np.zeros(sliders), np.zeros(sliders), np.zeros((timed, 3)), np.zeros((timed, 3)), np.zeros(r), np.zeros(r),
        np.zeros(r), np.zeros(r), np.zeros(r), np.zeros(r), np.zeros(r), np.zeros((r, r)), np.zeros((r, r)), dw, dv,
        np.zeros((r, r + 1)),
    )  # fmt: skip


@loop_step
def _coordinate_forces(
    steps: StepWork, factor: FloatArray, elements: ElementTables, timed: TimedTables, step: int
) -> None:
    """Forces (r,) of the coordinates at ``w`` and ``v`` and their tangents (r, r); ``moved`` gets the sliders."""
    jenkins, jenkins_start, contacts, contacts_start, kinds, parameters, sampled_start = elements
    w, v, g, by_displacement, by_velocity = steps.w, steps.v, steps.g, steps.by_displacement, steps.by_velocity
    count = jenkins_start.size - 1
    for i in range(g.size):
        for j in range(g.size):
            by_displacement[i, j] = 0.0
            by_velocity[i, j] = 0.0
    for i in range(count):
        force = 0.0
        stiffness = 0.0
        damping = 0.0
        for e in range(jenkins_start[i], jenkins_start[i + 1]):
            element_force, k, slider = _moved(
                jenkins[e, SLIDER_STIFFNESS], jenkins[e, SLIDER_SLIP], w[i], steps.sliders[e]
            )
            steps.moved[e] = slider
            force += element_force
            stiffness += k
        for e in range(contacts_start[i], contacts_start[i + 1]):
            side, k = contacts[e, CONTACT_SIDE], contacts[e, CONTACT_STIFFNESS]
            overlap = side * w[i] - contacts[e, CONTACT_GAP]
            if overlap > 0.0:
                force += side * k * overlap
                stiffness += k
        for e in range(sampled_start[i], sampled_start[i + 1]):
            element_force, k, c = response(kinds[e], parameters, e, w[i], v[i])
            force += element_force
            stiffness += k
            damping += c
        for e in range(timed.start[i], timed.start[i + 1]):
            element_force, k, c = timed_force(timed, e, step, w[i], v[i], steps.memory, steps.remembered)
            force += element_force
            stiffness += k
            damping += c
        g[i] = force
        by_displacement[i, i] = stiffness
        by_velocity[i, i] = damping
    r = g.size
    if r > count:
        coil, circuit = r - 2, r - 1
        x, current = w[coil], w[circuit]
        linear, quadratic = factor[FACTOR_LINEAR], factor[FACTOR_QUADRATIC]
        f = linear * x + quadratic * x * x
        slope = linear + 2.0 * quadratic * x
        g[coil] = -f * current
        by_displacement[coil, coil] = -slope * current
        by_displacement[coil, circuit] = -f
        g[circuit] = f * v[coil]
        by_displacement[circuit, coil] = slope * v[coil]
        by_velocity[circuit, coil] = f


@loop_step
def _newton_step(steps: StepWork) -> None:
    """Adds (1 + K dw + C dv)⁻¹ (g − trial) to ``trial``, by elimination with pivots: r is small."""
    g, trial, dw, dv, a = steps.g, steps.trial, steps.dw, steps.dv, steps.system
    kw, kv = steps.by_displacement, steps.by_velocity
    r = g.size
    for i in range(r):
        for j in range(r):
            value = 1.0 if i == j else 0.0
            for k in range(r):
                value += kw[i, k] * dw[k, j] + kv[i, k] * dv[k, j]
            a[i, j] = value
        a[i, r] = g[i] - trial[i]
    for c in range(r):
        best = c
        for i in range(c + 1, r):
            if abs(a[i, c]) > abs(a[best, c]):
                best = i
        if best != c:
            for j in range(c, r + 1):
                a[c, j], a[best, j] = a[best, j], a[c, j]
        for i in range(c + 1, r):
            share = a[i, c] / a[c, c]
            for j in range(c, r + 1):
                a[i, j] -= share * a[c, j]
    for i in range(r - 1, -1, -1):
        value = a[i, r]
        for j in range(i + 1, r):
            value -= a[i, j] * a[j, r]
        a[i, r] = value / a[i, i]
        trial[i] += a[i, r]


@loop_step
def _solve_forces(
    steps: StepWork, largest: float, factor: FloatArray, elements: ElementTables, timed: TimedTables, step: int
) -> None:
    """Forces (r,) at the end of a step by Newton's method from those tried; ``largest`` is that of all steps so far."""
    g, trial, w, v, dw, dv = steps.g, steps.trial, steps.w, steps.v, steps.dw, steps.dv
    free_w, free_v, kw, kv = steps.free_w, steps.free_v, steps.by_displacement, steps.by_velocity
    sliders, moved = steps.sliders, steps.moved
    r = g.size
    for _ in range(ITERATIONS):
        for i in range(r):
            w[i] = free_w[i]
            v[i] = free_v[i]
            for j in range(r):
                w[i] -= dw[i, j] * trial[j]
                v[i] -= dv[i, j] * trial[j]
        _coordinate_forces(steps, factor, elements, timed, step)
        error = 0.0
        size = largest
        for i in range(r):
            error = max(error, abs(g[i] - trial[i]))
            size = max(size, abs(g[i]))
        if error <= TOLERANCE * size:
            break
        if r == 1:
            trial[0] += (g[0] - trial[0]) / (1.0 + kw[0, 0] * dw[0, 0] + kv[0, 0] * dv[0, 0])
        else:
            _newton_step(steps)
    for e in range(sliders.size):
        sliders[e] = moved[e]
    for e in range(steps.memory.shape[0]):
        for place in range(steps.memory.shape[1]):
            steps.memory[e, place] = steps.remembered[e, place]


@njit(cache=True, fastmath={"reassoc", "contract", "nsz"})
def _step_all(
    inputs: FloatArray,
    stride: int,
    r: int,
    model: SteppedModel,
    factor: FloatArray,
    elements: ElementTables,
    timed: TimedTables,
    start: ComplexArray,
) -> FloatArray:
    """Channels (c, samples) of any number of coordinates.

    The state is that before the forces at the end of a step act, real and imaginary parts apart, as in `_step_one`.
    """
    recursion, forces, motions, channels, by_force = _tables_of_all(model, r)
    direct = model.direct[:, r:].copy()
    count, input_count, c = model.decay.size, inputs.shape[0], direct.shape[0] - r
    result = np.empty((c, (inputs.shape[1] + stride - 1) // stride))
    sliders = elements.jenkins.shape[0]
    steps = _room(model, r, sliders, timed.kinds.size)
    g, trial, before, free_w, free_v = steps.g, steps.trial, steps.before, steps.free_w, steps.free_v
    state = np.concatenate((start.real, start.imag))
    forces_of_motion = sliders + elements.contacts.shape[0] + elements.kinds.size + timed.kinds.size
    free = forces_of_motion == 0 and elements.jenkins_start.size - 1 == r
    largest = 1e-300
    previous = np.zeros(input_count)
    for n in range(inputs.shape[1]):
        was, u = previous[0], inputs[0, n]
        for k in range(count):
            re = state[k]
            im = state[count + k]
            state[k] = (
                recursion[0, k] * re - recursion[0, count + k] * im + recursion[1, k] * was + recursion[2, k] * u
            )  # fmt: skip
            state[count + k] = (
                recursion[0, k] * im + recursion[0, count + k] * re + recursion[1, count + k] * was
                + recursion[2, count + k] * u
            )  # fmt: skip
        for j in range(1, input_count):
            was, u = previous[j], inputs[j, n]
            for k in range(2 * count):
                state[k] += recursion[2 * j + 1, k] * was + recursion[2 * j + 2, k] * u
        for j in range(input_count):
            previous[j] = inputs[j, n]
        if not free:
            for j in range(r):
                force = g[j]
                for k in range(2 * count):
                    state[k] -= forces[j, k] * force
            for i in range(r):
                a = 0.0
                b = 0.0
                for k in range(2 * count):
                    a += motions[i, k] * state[k]
                    b += motions[r + i, k] * state[k]
                if input_count == MOTIONS_GIVEN:
                    a += direct[i, 0] * previous[0]
                    b += direct[i, 0] * previous[1]
                free_w[i] = a
                free_v[i] = b
                # Where the force seems to go: a step of the iteration saved.
                trial[i] = 2.0 * g[i] - before[i]
                before[i] = g[i]
            _solve_forces(steps, largest, factor, elements, timed, n)
            for j in range(r):
                largest = max(largest, abs(g[j]))
        if n % stride == 0:
            for o in range(c):
                y = 0.0
                for j in range(input_count):
                    y += direct[r + o, j] * previous[j]
                for j in range(r):
                    y -= by_force[o, j] * g[j]
                for k in range(2 * count):
                    y += channels[o, k] * state[k]
                result[o, n // stride] = y
    return result


@njit(cache=True)
def _tables_of_all(model: SteppedModel, r: int) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Coefficients of a step, real and imaginary parts apart.

    Returns:
        Recursion of the poles, then shares of each input at both ends of a step, (1 + 2 inputs, 2 k); of the forces at
        the end of the step before, (r, 2 k); of the state in displacements and velocities, (2 r, 2 k), and in the
        channels, (c, 2 k); of the forces at the end in the channels, (c, r).
    """
    decay, early, late, outputs, velocities, direct = model
    count, c, input_count = decay.size, outputs.shape[0] - r, early.shape[1] - r
    recursion, forces = np.empty((1 + 2 * input_count, 2 * count)), np.empty((r, 2 * count))
    motions, channels, by_force = np.empty((2 * r, 2 * count)), np.empty((c, 2 * count)), np.empty((c, r))
    for k in range(count):
        recursion[0, k] = decay[k].real
        recursion[0, count + k] = decay[k].imag
        for j in range(input_count):
            for row, value in enumerate((early[k, r + j], late[k, r + j])):
                recursion[2 * j + 1 + row, k] = value.real
                recursion[2 * j + 1 + row, count + k] = value.imag
        for j in range(r):
            force = decay[k] * late[k, j] + early[k, j]
            forces[j, k] = force.real
            forces[j, count + k] = force.imag
            motions[j, k] = outputs[j, k].real
            motions[j, count + k] = -outputs[j, k].imag
            motions[r + j, k] = velocities[j, k].real
            motions[r + j, count + k] = -velocities[j, k].imag
        for o in range(c):
            channels[o, k] = outputs[r + o, k].real
            channels[o, count + k] = -outputs[r + o, k].imag
    for o in range(c):
        for j in range(r):
            by_force[o, j] = direct[r + o, j]
            for k in range(count):
                by_force[o, j] += (outputs[r + o, k] * late[k, j]).real
    return recursion, forces, motions, channels, by_force


@njit(cache=True, fastmath={"reassoc", "contract", "nsz"})
def _step_one(
    drive: FloatArray, substeps: int, model: SteppedModel, elements: ElementTables, start: ComplexArray
) -> FloatArray:
    """Channels (c, samples) of one coordinate without force factor: the same steps, without arrays in the loop.

    Tables and state lie in arrays of one row, real and imaginary parts apart: that is what the compiler makes vector
    instructions of.
    """
    contacts, kinds, parameters = elements.contacts, elements.kinds, elements.parameters
    recursion, forces, motions, channels, by_force = _tables_of_all(model, 1)
    decay, early, late, force = recursion[0].copy(), recursion[1].copy(), recursion[2].copy(), forces[0].copy()
    displacement, velocity = motions[0].copy(), motions[1].copy()
    direct, count, steps = model.direct[1:, 1].copy(), model.decay.size, _room(model, 1, 0, 0)
    dw, dv = steps.dw[0, 0], steps.dv[0, 0]
    result = np.empty((direct.size, (drive.size + substeps - 1) // substeps))
    state = np.concatenate((start.real, start.imag))
    stiffnesses = elements.jenkins[:, SLIDER_STIFFNESS].copy()
    slips = elements.jenkins[:, SLIDER_SLIP].copy()
    # A slider without stiffness takes no force, however far it is stretched.
    limits = np.where(stiffnesses > 0.0, slips / np.where(stiffnesses > 0.0, stiffnesses, 1.0), np.inf)
    sliders = np.zeros(slips.size)
    g = before = previous = 0.0
    largest = 1e-300
    for n in range(drive.size):
        u = drive[n]
        free_w = 0.0
        free_v = 0.0
        for k in range(count):
            re = state[k]
            im = state[count + k]
            a = decay[k] * re - decay[count + k] * im
            b = decay[k] * im + decay[count + k] * re
            a += early[k] * previous + late[k] * u - force[k] * g
            b += early[count + k] * previous + late[count + k] * u - force[count + k] * g
            state[k] = a
            state[count + k] = b
            free_w += displacement[k] * a + displacement[count + k] * b
            free_v += velocity[k] * a + velocity[count + k] * b
        previous = u
        # Where the force seems to go: a step of the iteration saved.
        trial = 2.0 * g - before
        before = g
        w = free_w
        for _ in range(ITERATIONS):
            w = free_w - dw * trial
            v = free_v - dv * trial
            g = 0.0
            by_displacement = 0.0
            by_velocity = 0.0
            for e in range(slips.size):
                stretch = w - sliders[e]
                held = min(max(stretch, -limits[e]), limits[e])
                g += stiffnesses[e] * held
                by_displacement += stiffnesses[e] if held == stretch else 0.0
            for e in range(contacts.shape[0]):
                side, stiffness = contacts[e, CONTACT_SIDE], contacts[e, CONTACT_STIFFNESS]
                overlap = side * w - contacts[e, CONTACT_GAP]
                if overlap > 0.0:
                    g += side * stiffness * overlap
                    by_displacement += stiffness
            for e in range(kinds.size):
                element_force, stiffness, damping = response(kinds[e], parameters, e, w, v)
                g += element_force
                by_displacement += stiffness
                by_velocity += damping
            if abs(g - trial) <= TOLERANCE * max(largest, abs(g)):
                break
            trial += (g - trial) / (1.0 + by_displacement * dw + by_velocity * dv)
        for e in range(slips.size):
            sliders[e] = min(max(sliders[e], w - limits[e]), w + limits[e])
        largest = max(largest, abs(g))
        if n % substeps == 0:
            for o in range(direct.size):
                y = direct[o] * u - by_force[o, 0] * g
                for k in range(2 * count):
                    y += channels[o, k] * state[k]
                result[o, n // substeps] = y
    return result


def step_through(
    inputs: FloatArray,
    stride: int,
    r: int,
    model: SteppedModel,
    factor: FloatArray,
    tables: LocalTables,
    start: ComplexArray | None = None,
    timed: TimedTables | None = None,
) -> FloatArray:
    """Channels, shape (c, samples).

    Args:
        inputs: drive at the steps, (1, n), or the motion of the drive point, (3, n).
        stride: steps from one wanted sample to the next; the first step is one.
        r: number of coordinates.
        model: recursion of the poles.
        factor: force factor and its dependence on displacement.
        tables: local elements by coordinate.
        start: state of the poles one step before the first sample, (k,); None = at rest.
        timed: further elements, with their strengths at the steps; None = there are none.
    """
    elements = tables.elements
    timed = timed or no_timed_elements(elements.jenkins_start.size - 1)
    state = np.zeros(model.decay.size, dtype=np.complex128) if start is None else start
    found: FloatArray
    if r == 1 and inputs.shape[0] == 1 and elements.jenkins_start.size == 2 and not timed.kinds.size:
        found = _step_one(inputs[0], stride, model, elements, state)
    else:
        found = _step_all(np.ascontiguousarray(inputs), stride, r, model, factor, elements, timed, state)
    return found


@njit(cache=True)
def poles_at(
    decay: ComplexArray, early: ComplexArray, late: ComplexArray, driven: NDArray[Any], at: IntArray
) -> ComplexArray:
    """Poles (T, k) at some ascending steps, from rest, without local forces.

    Args:
        decay: of a step, (k,).
        early, late: shares of the input at the beginning and at the end of a step, (k,).
        driven: input at the steps, (n, 1), or one of each pole, (n, k).
        at: steps that are wanted, (T,).
    """
    k, own = decay.size, int(driven.shape[1] > 1)
    state = np.zeros(k, dtype=np.complex128)
    result = np.zeros((at.size, k), dtype=np.complex128)
    place = 0
    for n in range(driven.shape[0]):
        if n > 0:
            for j in range(k):
                state[j] = decay[j] * state[j] + early[j] * driven[n - 1, own * j] + late[j] * driven[n, own * j]
        while place < at.size and at[place] == n:
            result[place] = state
            place += 1
    return result


def line_shares(z: ComplexArray) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """exp z for a pole times a step, and shares of the input at both ends of the step, straight between, per step."""
    near = np.where(np.abs(z) < _SERIES_BELOW, z, 0.0)
    far = np.where(np.abs(z) < _SERIES_BELOW, 1.0, z)
    first, second = (
        np.where(near == z, sum(near**n / math.factorial(n + order) for n in range(12)), exact)
        for order, exact in ((1, np.expm1(far) / far), (2, (np.expm1(far) - far) / far**2))
    )
    return np.exp(z), first - second, second


def stepped_model(model: LinearModel, coordinates: int, rows: np.ndarray, step: float) -> SteppedModel:
    """Recursion of the poles over one step.

    Args:
        model: its first inputs are the forces of the coordinates, its first outputs their displacements.
        coordinates: number of them.
        rows: outputs that are wanted.
        step: s.
    """
    keep = model.poles.imag >= 0.0
    poles = model.poles[keep]
    weight = np.where(np.abs(poles.imag) > 1e-12 * np.abs(poles), 2.0, 1.0)
    decay, early, late = line_shares(poles * step)
    inputs = model.inputs[keep]
    p = model.poles
    outputs = model.displacement[rows] + model.velocity[rows] * p + model.acceleration[rows] * p**2
    direct = (model.velocity[rows] + model.acceleration[rows] * model.poles) @ model.inputs + model.feedthrough[rows]
    return SteppedModel(
        decay,
        np.ascontiguousarray(step * early[:, None] * inputs),
        np.ascontiguousarray(step * late[:, None] * inputs),
        np.ascontiguousarray(outputs[:, keep] * weight),
        np.ascontiguousarray(model.displacement[:coordinates, keep] * poles * weight),
        np.ascontiguousarray(direct.real),
    )
