"""State in which a record begins: estimated from its first samples, with its uncertainty.

A structure is rarely at rest when a recording begins. The state is found by least squares over the first samples, which
are not among the observables; the zero of each sensor is free there. The uncertainty of the state counts as errors of
the record, like those of its measuring chain.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from nmt_core.numerics.arrays import ComplexArray, FloatArray, IntArray
from nmt_diagnose.prediction.record_kernel import SteppedModel

_ITERATIONS = 16
_HALVINGS = 3
_SETTLED = 1e-9  # change of the state, over the motion, below which it is found: differences of two rigs are small
_STEP = 1e-3  # of differences, over the motion
_SINGULAR = 1e-3  # of the largest singular value
_MOST_DECAY = 20.0  # nepers over the first samples beyond which a pole is not in them
_MOST_POLES = 12
_INDEPENDENT = 2.0  # independent values for each unknown that the first samples count as


class InitialState(NamedTuple):
    """State of the poles one step before the first sample.

    Attributes:
        state: (k,).
        errors: what a standard deviation of each error adds to it, (n, k).
    """

    state: ComplexArray
    errors: ComplexArray


def at_rest(poles: int) -> InitialState:
    """Of a model that stands still, without errors."""
    return InitialState(np.zeros(poles, dtype=np.complex128), np.zeros((0, poles), dtype=np.complex128))


def initial_state(
    measured: FloatArray,
    simulate: Callable[[ComplexArray], FloatArray],
    model: SteppedModel,
    coordinates: int,
    gains: FloatArray,
    at: IntArray,
    moving: bool,
) -> InitialState:
    """State that explains the first samples best.

    Args:
        measured: first samples of the channels, (c, n).
        simulate: the model's channels, (c, n), from a state (k,).
        model: recursion of the poles over one step.
        coordinates: of the model; its outputs are these and then the channels.
        gains: of the channels, (c, 1).
        at: number of steps after which the model is at each of the samples, (n,).
        moving: whether the record begins in motion; else the model starts at rest, with the uncertainty of that.
    """
    size = np.sqrt(np.mean((measured - measured.mean(axis=1, keepdims=True)) ** 2, axis=1))
    nothing = at_rest(model.decay.size)
    if not np.all(size > 0.0):
        return nothing
    directions = _directions(model, size, coordinates, int(at[-1]))
    if not directions.shape[0]:
        return nothing
    constants = np.kron(np.eye(size.size), np.ones((measured.shape[1], 1)))

    def left(theta: FloatArray) -> FloatArray:
        return np.asarray(((measured - simulate(theta @ directions)) / size[:, None]).ravel())

    def without_zeros(values: FloatArray) -> FloatArray:
        by_channel = values.reshape(size.size, -1)
        return np.asarray((by_channel - by_channel.mean(axis=1, keepdims=True)).ravel())

    def differences(theta: FloatArray, residual: FloatArray) -> FloatArray:
        moved = [left(theta + step) for step in _STEP * np.eye(theta.size)]
        return np.stack([(residual - other) / _STEP for other in moved], axis=1)

    def stepped(
        theta: FloatArray, residual: FloatArray, columns: FloatArray, halvings: int
    ) -> tuple[FloatArray, FloatArray, float]:
        """The state after a least-squares step that does not raise the residual, the residual, the step; 0 = none."""
        change = np.linalg.lstsq(np.hstack((columns, constants)), residual, rcond=_SINGULAR)[0][: theta.size]
        before = float(np.sum(without_zeros(residual) ** 2))
        for _ in range(1 + halvings):
            trial = left(theta + change)
            if np.isfinite(trial).all() and float(np.sum(without_zeros(trial) ** 2)) <= before:
                return theta + change, trial, float(np.abs(change).max())
            change = 0.5 * change
        return theta, residual, 0.0

    theta = np.zeros(directions.shape[0])
    residual = left(theta)
    motions = _free_motions(model.outputs[coordinates:], model.decay, directions, at)
    columns = np.stack([(gains * motion / size[:, None]).ravel() for motion in motions], axis=1)
    exact, last = False, np.inf
    # Free motions without local forces lead there fast, or differences of the whole model do, which cost a run each.
    for _ in range(_ITERATIONS if moving else 0):
        if not (np.isfinite(columns).all() and np.isfinite(residual).all()):
            break
        theta, residual, step = stepped(theta, residual, columns, _HALVINGS if exact else 0)
        if 0.0 < step < _SETTLED or (exact and step == 0.0):
            break
        if not exact and (step == 0.0 or _turns_left(step, last) > theta.size):
            columns, exact = differences(theta, residual), True
        last = step
    if not (np.isfinite(columns).all() and np.isfinite(residual).all()):
        return nothing
    free = np.stack([without_zeros(column) for column in columns.T], axis=1)
    scatter = float(np.mean(without_zeros(residual) ** 2)) * residual.size / (_INDEPENDENT * theta.size)
    # As an error no larger than the motion itself.
    precision = free.T @ free / max(scatter, 1e-18) + np.eye(theta.size)
    errors = np.linalg.cholesky(np.linalg.inv(precision)).T @ directions
    return InitialState(theta @ directions, errors)


def _turns_left(step: float, last: float) -> float:
    """Further steps until they are small enough, if each is to the one before as the last two."""
    ratio = step / last
    if ratio >= 1.0:
        return np.inf
    return float(np.log(_SETTLED / step) / np.log(ratio)) if ratio > 0.0 else 1.0


def _free_motions(
    outputs: ComplexArray, decay: ComplexArray, directions: ComplexArray, at: IntArray
) -> list[FloatArray]:
    """Channels, (c, n), of the poles alone from each state, which has one pole."""
    poles = np.argmax(np.abs(directions), axis=1)
    return [
        np.asarray(np.real(np.outer(outputs[:, k] * state[k], decay[k] ** at)))
        for k, state in zip(poles, directions, strict=True)
    ]


def _directions(model: SteppedModel, size: FloatArray, coordinates: int, steps: int) -> ComplexArray:
    """States of single poles that move the channels by no more than they move, (n, k)."""
    visible = np.max(np.abs(model.outputs[coordinates:]) / size[:, None], axis=0)
    decay = -np.log(np.maximum(np.abs(model.decay), 1e-300)) * steps
    angle = np.abs(np.angle(model.decay))
    usable: IntArray = np.flatnonzero((visible > 1e-9 * visible.max(initial=0.0)) & (decay < _MOST_DECAY))
    usable = usable[np.argsort(angle[usable] + np.abs(decay[usable]) / steps, kind="stable")][:_MOST_POLES]
    found = []
    for k in usable:
        for share in (1.0, 1j) if angle[k] > 0.0 else (1.0,):
            direction = np.zeros(model.decay.size, dtype=np.complex128)
            direction[k] = share / visible[k]
            found.append(direction)
    return np.array(found, dtype=np.complex128).reshape(-1, model.decay.size)
