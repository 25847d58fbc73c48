"""When within a held sample of the drive a random test was sampled, by the fit of all its lines.

What images of a held drive add turns with their order times that moment: a direction of the measuring chain describes
small errors of it only. So it is moved along a grid, for all channels, for the sensors of each kind, and for each
channel near the step, every other parameter following in proportion, and taken where the least is left.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from nmt_core.arrays import BoolArray, FloatArray
from nmt_diagnose.inference.fit import Fit
from nmt_diagnose.inference.problem import Problem
from nmt_diagnose.observations.conditions import RandomTest
from nmt_diagnose.observations.observables import Observations
from nmt_diagnose.twin.forward import Forward, Prediction

NEAR_STEPS, WIDE_STEPS = np.linspace(-0.2, 0.2, 41), np.linspace(-0.5, 0.5, 101)  # samples
_NEAR, _FINE_STEPS = 0.06, np.linspace(-0.06, 0.06, 121)
_FALL = 6.0  # of what is left, squared: a better moment lets it fall by more than that


def with_better_moment(problem: Problem, found: Fit, steps: FloatArray = NEAR_STEPS) -> Observations | None:
    """The observations with another moment at which a held random test was sampled; None where none is clearly better.

    Args:
        problem: with the errors of its measuring chains as part of the noise.
        found: fit of the model alone.
        steps: from the present moment that are tried, samples; the middle one is none.
    """
    for number, test in enumerate(problem.observations.tests):
        if isinstance(test, RandomTest) and test.sampled_at is not None:
            best, least = None, math.inf
            searches = [*((own, steps) for own in _groups(test)), *_beside_the_step(test)]
            # What a channel sees depends on its own moment only: all of them together are moved once for all searches.
            grids = {tried.size: tried for _, tried in searches}
            together = {size: _predicted(problem, found, number, test, tried) for size, tried in grids.items()}
            for own, tried in searches:
                left = _left(problem, found, number, own, together[tried.size])
                if float(left.min()) < min(least, float(left[tried.size // 2]) - _FALL):
                    best, least = moved(test, own, float(tried[np.argmin(left)])), float(left.min())
            if best is not None:
                return _with(problem.observations, number, best)
    return None


def _groups(test: RandomTest) -> list[BoolArray]:
    """All channels, and those of each kind where there are several, (channels,) each."""
    kinds = [channel.quantity for channel in test.channels]
    several = sorted(set(kinds)) if len(set(kinds)) > 1 else []
    return [np.ones(len(kinds), dtype=bool), *(np.array([own == kind for own in kinds]) for kind in several)]


def _beside_the_step(test: RandomTest) -> list[tuple[BoolArray, FloatArray]]:
    """Channels that are sampled close to when the drive moves on, and the steps in which to look for the moment.

    There a microsecond decides how much of the step a channel sees.
    """
    late = np.array(test.late_s or (0.0,) * len(test.channels)) * test.drive_hold_hz + (test.sampled_at or 0.0)
    near = np.abs(late - np.round(late)) < _NEAR
    return [(np.arange(late.size) == channel, _FINE_STEPS) for channel in np.flatnonzero(near)]


def moved(test: RandomTest, channels: BoolArray, step: float) -> RandomTest:
    """The test with some of its channels sampled later.

    Args:
        test: over a held drive whose images are in its responses.
        channels: which, shape (channels,).
        step: samples of the drive.
    """
    assert test.sampled_at is not None
    if channels.all():
        return replace(test, sampled_at=test.sampled_at + step)
    late = np.array(test.late_s or (0.0,) * len(test.channels)) + step / test.drive_hold_hz * channels
    return replace(test, late_s=tuple(late.tolist()))


def _with(observations: Observations, number: int, test: RandomTest) -> Observations:
    tests = tuple(test if k == number else own for k, own in enumerate(observations.tests))
    return replace(observations, tests=tests)


def _predicted(problem: Problem, found: Fit, number: int, test: RandomTest, steps: FloatArray) -> FloatArray:
    """Rows of a test with all of its channels sampled later by some steps, (steps, rows)."""
    rows = problem.observations.rows
    mine = rows.test == number
    own = rows.take(mine)
    own = replace(own, test=np.zeros_like(own.test))
    rig = found.parametrisation.rig(found.theta)
    prediction = found.prediction
    state = Prediction(prediction.values[mine], prediction.converged[mine], (), (prediction.states[number],))
    everywhere = np.ones(len(test.channels), dtype=bool)
    options = (moved(test, everywhere, float(step)) for step in steps)
    return np.stack([Forward((option,), own).predict(rig, state).values for option in options])


def _left(problem: Problem, found: Fit, number: int, channels: BoolArray, together: FloatArray) -> FloatArray:
    """χ² and prior of the fit with its parameters following in proportion, for each of some steps, (steps,).

    Args:
        problem, found: as for `with_better_moment`.
        number: of the test.
        channels: that are moved, shape (channels,).
        together: rows of the test with all channels moved, shape (steps, rows).
    """
    rows = problem.observations.rows
    mine = np.flatnonzero(rows.test == number)
    theirs = channels[rows.channel[mine]]
    jacobian, prior = found.jacobian[found.used], found.parametrisation.prior_std
    information = jacobian.T @ jacobian + np.diag(prior**-2.0)
    values = found.prediction.values.copy()
    result = np.empty(len(together))
    for k, predicted in enumerate(together):
        values[mine[theirs]] = predicted[theirs]
        residual = problem.whitened(problem.difference(values))[found.used]
        residual = np.where(np.isfinite(residual), residual, 0.0)
        gradient = jacobian.T @ residual - found.theta / prior**2
        result[k] = residual @ residual - gradient @ np.linalg.solve(information, gradient)
    return result
