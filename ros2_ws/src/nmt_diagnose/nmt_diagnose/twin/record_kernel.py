"""Compiled stepping of a rig through a record: exact recursion of its poles, local forces by Newton's method."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nmt_core.numerics.arrays import ComplexArray, FloatArray, IntArray
from nmt_core.numerics.kernels import njit
from nmt_rig.model.aft import ElementTables, LocalTables
from nmt_rig.model.element_kernels import response
from nmt_rig.model.local_elements.friction import Jenkins

_moved = njit(Jenkins.moved)

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


@njit(cache=True)
def _coordinate_forces(
    w: FloatArray,
    v: FloatArray,
    sliders: FloatArray,
    moved: FloatArray,
    factor: FloatArray,
    jenkins: FloatArray,
    jenkins_start: IntArray,
    contacts: FloatArray,
    contacts_start: IntArray,
    kinds: IntArray,
    parameters: FloatArray,
    sampled_start: IntArray,
    g: FloatArray,
    by_displacement: FloatArray,
    by_velocity: FloatArray,
) -> None:
    """Forces (r,) of the coordinates and their tangents (r, r), written to the last three arguments; ``moved`` gets the
    sliders after the step."""
    elements = jenkins_start.size - 1
    by_displacement[:] = 0.0
    by_velocity[:] = 0.0
    for i in range(elements):
        force = 0.0
        stiffness = 0.0
        damping = 0.0
        for e in range(jenkins_start[i], jenkins_start[i + 1]):
            own, k, slider = _moved(jenkins[e, 0], jenkins[e, 1], w[i], sliders[e])
            moved[e] = slider
            force += own
            stiffness += k
        for e in range(contacts_start[i], contacts_start[i + 1]):
            side = contacts[e, 2]
            overlap = side * w[i] - contacts[e, 1]
            if overlap > 0.0:
                force += side * contacts[e, 0] * overlap
                stiffness += contacts[e, 0]
        for e in range(sampled_start[i], sampled_start[i + 1]):
            own, k, c = response(kinds[e], parameters, e, w[i], v[i])
            force += own
            stiffness += k
            damping += c
        g[i] = force
        by_displacement[i, i] = stiffness
        by_velocity[i, i] = damping
    r = g.size
    if r > elements:
        x, current = w[r - 2], w[r - 1]
        f = factor[1] * x + factor[2] * x * x
        slope = factor[1] + 2.0 * factor[2] * x
        g[r - 2] = -f * current
        by_displacement[r - 2, r - 2] = -slope * current
        by_displacement[r - 2, r - 1] = -f
        g[r - 1] = f * v[r - 2]
        by_displacement[r - 1, r - 2] = slope * v[r - 2]
        by_velocity[r - 1, r - 2] = f


@njit(cache=True)
def _step_all(
    drive: FloatArray,
    substeps: int,
    r: int,
    model: SteppedModel,
    factor: FloatArray,
    elements: ElementTables,
) -> FloatArray:
    """Channels (c, samples) of any number of coordinates."""
    decay, early, late, outputs, velocities, direct = model
    jenkins, jenkins_start, contacts, contacts_start, kinds, parameters, sampled_start = elements
    count = decay.size
    c = outputs.shape[0] - r
    samples = drive.size // substeps
    result = np.empty((c, samples))
    state = np.zeros(count, dtype=np.complex128)
    sliders = np.zeros(jenkins.shape[0])
    moved = np.zeros(jenkins.shape[0])
    g = np.zeros(r)
    trial = np.zeros(r)
    w = np.zeros(r)
    v = np.zeros(r)
    free_w = np.zeros(r)
    free_v = np.zeros(r)
    kw = np.zeros((r, r))
    kv = np.zeros((r, r))
    # What a force at the end of a step does to displacement and velocity there.
    dw = np.zeros((r, r))
    dv = np.zeros((r, r))
    for i in range(r):
        for j in range(r):
            for k in range(count):
                dw[i, j] += (outputs[i, k] * late[k, j]).real
                dv[i, j] += (velocities[i, k] * late[k, j]).real
    free = jenkins.shape[0] + contacts.shape[0] + kinds.size == 0 and jenkins_start.size - 1 == r
    before = np.zeros(r)
    largest = 1e-300
    previous = 0.0
    for n in range(drive.size):
        u = drive[n]
        for k in range(count):
            x = decay[k] * state[k] + early[k, r] * previous + late[k, r] * u
            if not free:
                for j in range(r):
                    x -= early[k, j] * g[j]
            state[k] = x
        previous = u
        for i in range(0 if free else r):
            a = 0.0
            b = 0.0
            for k in range(count):
                a += (outputs[i, k] * state[k]).real
                b += (velocities[i, k] * state[k]).real
            free_w[i] = a
            free_v[i] = b
            # Where the force seems to go: a step of the iteration saved.
            trial[i] = 2.0 * g[i] - before[i]
            before[i] = g[i]
        for _ in range(0 if free else ITERATIONS):
            for i in range(r):
                w[i] = free_w[i]
                v[i] = free_v[i]
                for j in range(r):
                    w[i] -= dw[i, j] * trial[j]
                    v[i] -= dv[i, j] * trial[j]
            _coordinate_forces(
                w, v, sliders, moved, factor, jenkins, jenkins_start, contacts, contacts_start, kinds, parameters,
                sampled_start, g, kw, kv,
            )  # fmt: skip
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
                system = np.eye(r) + kw @ dw + kv @ dv
                trial += np.linalg.solve(system, g - trial)
        for e in range(sliders.size):
            sliders[e] = moved[e]
        if not free:
            for j in range(r):
                largest = max(largest, abs(g[j]))
                for k in range(count):
                    state[k] -= late[k, j] * g[j]
        if n % substeps == 0:
            for o in range(c):
                y = direct[r + o, r] * u
                for j in range(r):
                    y -= direct[r + o, j] * g[j]
                for k in range(count):
                    y += (outputs[r + o, k] * state[k]).real
                result[o, n // substeps] = y
    return result


@njit(cache=True)
def _step_one(drive: FloatArray, substeps: int, model: SteppedModel, elements: ElementTables) -> FloatArray:
    """Channels (c, samples) of one coordinate without force factor: the same steps, without arrays in the loop."""
    decay, early, late, outputs, velocities, direct = model
    jenkins, _, contacts, _, kinds, parameters, _ = elements
    count = decay.size
    c = outputs.shape[0] - 1
    result = np.empty((c, drive.size // substeps))
    state = np.zeros(count, dtype=np.complex128)
    sliders = np.zeros(jenkins.shape[0])
    moved = np.zeros(jenkins.shape[0])
    dw = 0.0
    dv = 0.0
    for k in range(count):
        dw += (outputs[0, k] * late[k, 0]).real
        dv += (velocities[0, k] * late[k, 0]).real
    g = 0.0
    before = 0.0
    largest = 1e-300
    previous = 0.0
    for n in range(drive.size):
        u = drive[n]
        free_w = 0.0
        free_v = 0.0
        for k in range(count):
            x = decay[k] * state[k] + early[k, 1] * previous + late[k, 1] * u
            x -= early[k, 0] * g
            state[k] = x
            free_w += (outputs[0, k] * x).real
            free_v += (velocities[0, k] * x).real
        previous = u
        # Where the force seems to go: a step of the iteration saved.
        trial = 2.0 * g - before
        before = g
        for _ in range(ITERATIONS):
            w = free_w - dw * trial
            v = free_v - dv * trial
            g = 0.0
            by_displacement = 0.0
            by_velocity = 0.0
            for e in range(jenkins.shape[0]):
                stiffness, slip = jenkins[e, 0], jenkins[e, 1]
                own = stiffness * (w - sliders[e])
                if own > slip:
                    g += slip
                    moved[e] = w - slip / stiffness
                elif own < -slip:
                    g -= slip
                    moved[e] = w + slip / stiffness
                else:
                    g += own
                    by_displacement += stiffness
                    moved[e] = sliders[e]
            for e in range(contacts.shape[0]):
                side = contacts[e, 2]
                overlap = side * w - contacts[e, 1]
                if overlap > 0.0:
                    g += side * contacts[e, 0] * overlap
                    by_displacement += contacts[e, 0]
            for e in range(kinds.size):
                own, stiffness, damping = response(kinds[e], parameters, e, w, v)
                g += own
                by_displacement += stiffness
                by_velocity += damping
            if abs(g - trial) <= TOLERANCE * max(largest, abs(g)):
                break
            trial += (g - trial) / (1.0 + by_displacement * dw + by_velocity * dv)
        for e in range(sliders.size):
            sliders[e] = moved[e]
        largest = max(largest, abs(g))
        for k in range(count):
            state[k] -= late[k, 0] * g
        if n % substeps == 0:
            for o in range(c):
                y = direct[1 + o, 1] * u
                y -= direct[1 + o, 0] * g
                for k in range(count):
                    y += (outputs[1 + o, k] * state[k]).real
                result[o, n // substeps] = y
    return result


def step_through(
    drive: FloatArray,
    substeps: int,
    r: int,
    model: SteppedModel,
    factor: FloatArray,
    tables: LocalTables,
) -> FloatArray:
    """Channels from rest, shape (c, samples).

    Args:
        drive: input at the steps, shape (samples · substeps,).
        substeps: steps per sample.
        r: number of coordinates.
        model: recursion of the poles.
        factor: force factor and its dependence on displacement.
        tables: local elements by coordinate.
    """
    elements = tables.elements
    acting = elements.jenkins.shape[0] + elements.contacts.shape[0] + elements.kinds.size
    found: FloatArray
    if r == 1 and elements.jenkins_start.size == 2 and acting:
        found = _step_one(drive, substeps, model, elements)
    else:
        found = _step_all(drive, substeps, r, model, factor, elements)
    return found
