"""When within a held sample of the drive a random test was sampled, by the fit of all its lines.

What images of a held drive add turns with their order times that moment: a direction of the measuring chain describes
small errors of it only. So it is moved along a grid, every other parameter following in proportion, and taken where the
least is left.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from nmt_core.blocks import FloatArray
from nmt_diagnose.inference.fit import Fit
from nmt_diagnose.inference.problem import Problem
from nmt_diagnose.observations.conditions import RandomTest
from nmt_diagnose.observations.observables import Observations
from nmt_diagnose.twin.forward import Forward, Prediction

_STEPS = np.linspace(-0.2, 0.2, 41)  # samples
_FALL = 6.0  # of what is left, squared: a better moment lets it fall by more than that


def with_better_moment(problem: Problem, found: Fit) -> Observations | None:
    """The observations with another moment at which a held random test was sampled; None where none is clearly better.

    Args:
        problem: with the errors of its measuring chains as part of the noise.
        found: fit of the model alone.
    """
    for number, test in enumerate(problem.observations.tests):
        if isinstance(test, RandomTest) and test.sampled_at is not None:
            moments = test.sampled_at + _STEPS
            left = _left(problem, found, number, moments)
            if float(left.min()) < float(left[_STEPS.size // 2]) - _FALL:
                return _sampled_at(problem.observations, number, float(moments[int(np.argmin(left))]))
    return None


def _sampled_at(observations: Observations, number: int, moment: float) -> Observations:
    tests = tuple(
        replace(test, sampled_at=moment) if k == number and isinstance(test, RandomTest) else test
        for k, test in enumerate(observations.tests)
    )
    return replace(observations, tests=tests)


def _left(problem: Problem, found: Fit, number: int, moments: FloatArray) -> FloatArray:
    """χ² and prior of the fit with its parameters following in proportion, for each of some moments, (moments,)."""
    rows = problem.observations.rows
    mine = rows.test == number
    own = rows.take(mine)
    own = replace(own, test=np.zeros_like(own.test))
    rig = found.parametrisation.rig(found.theta)
    jacobian, prior = found.jacobian[found.used], found.parametrisation.prior_std
    information = jacobian.T @ jacobian + np.diag(prior**-2.0)
    values = found.prediction.values.copy()
    state = Prediction(values[mine], found.prediction.converged[mine], (), (found.prediction.states[number],))
    result = np.empty(moments.size)
    for k, moment in enumerate(moments):
        test = _sampled_at(problem.observations, number, float(moment)).tests[number]
        values[mine] = Forward((test,), own).predict(rig, state).values
        residual = problem.whitened(problem.difference(values))[found.used]
        residual = np.where(np.isfinite(residual), residual, 0.0)
        gradient = jacobian.T @ residual - found.theta / prior**2
        result[k] = residual @ residual - gradient @ np.linalg.solve(information, gradient)
    return result
