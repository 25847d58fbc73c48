"""Compiled stepping of free coordinates under an imposed motion: their poles, and local forces by Newton's method."""

from __future__ import annotations

import numpy as np

from nmt_core.numerics.arrays import FloatArray
from nmt_core.numerics.kernels import njit
from nmt_diagnose.prediction.record_kernel import SteppedModel, _room, _solve_forces
from nmt_diagnose.prediction.timed_elements import TimedTables
from nmt_rig.model.aft import ElementTables, LocalTables

MOTIONS_GIVEN = 3
"""Inputs in addition to the local forces: displacement, velocity and acceleration of the drive point."""


@njit(cache=True)
def _follow(
    motion: FloatArray,
    stride: int,
    r: int,
    model: SteppedModel,
    factor: FloatArray,
    elements: ElementTables,
    timed: TimedTables,
) -> FloatArray:
    """Channels (c, samples); each coordinate is the sum of its imposed and its free motion."""
    decay, early, late, outputs, velocities, direct = model
    count, steps_total, given = decay.size, motion.shape[1], motion.shape[0]
    c = direct.shape[0] - r
    result = np.empty((c, (steps_total + stride - 1) // stride))
    steps = _room(model, r, elements.jenkins.shape[0], timed.kinds.size)
    state = np.zeros(count, dtype=np.complex128)
    g, trial, before, free_w, free_v = steps.g, steps.trial, steps.before, steps.free_w, steps.free_v
    largest = 1e-300
    previous = np.zeros(given)
    for n in range(steps_total):
        for k in range(count):
            x = decay[k] * state[k]
            for j in range(given):
                x += early[k, r + j] * previous[j] + late[k, r + j] * motion[j, n]
            for j in range(r):
                x -= early[k, j] * g[j]
            state[k] = x
        for j in range(given):
            previous[j] = motion[j, n]
        for i in range(r):
            a = direct[i, r] * motion[0, n]
            b = direct[i, r] * motion[1, n]
            for k in range(count):
                a += (outputs[i, k] * state[k]).real
                b += (velocities[i, k] * state[k]).real
            free_w[i] = a
            free_v[i] = b
            trial[i] = 2.0 * g[i] - before[i]
            before[i] = g[i]
        _solve_forces(steps, largest, factor, elements, timed, n)
        for j in range(r):
            largest = max(largest, abs(g[j]))
            for k in range(count):
                state[k] -= late[k, j] * g[j]
        if n % stride == 0:
            for o in range(r, r + c):
                y = 0.0
                for j in range(given):
                    y += direct[o, r + j] * motion[j, n]
                for j in range(r):
                    y -= direct[o, j] * g[j]
                for k in range(count):
                    y += (outputs[o, k] * state[k]).real
                result[o - r, n // stride] = y
    return result


def follow(
    motion: FloatArray,
    stride: int,
    r: int,
    model: SteppedModel,
    factor: FloatArray,
    tables: LocalTables,
    timed: TimedTables,
) -> FloatArray:
    """Channels of a rig whose drive point moves as measured, (c, ⌈n / stride⌉).

    Args:
        motion: displacement, velocity and acceleration of the drive point at the steps, (3, n).
        stride: steps from one sample to the next.
        r: number of coordinates.
        model: recursion of the poles of the free coordinates; its inputs are the local forces and the motion.
        factor: force factor and its dependence on displacement.
        tables: local elements by coordinate.
        timed: further elements, with their strengths at the steps.
    """
    found: FloatArray = _follow(np.ascontiguousarray(motion), stride, r, model, factor, tables.elements, timed)
    return found
