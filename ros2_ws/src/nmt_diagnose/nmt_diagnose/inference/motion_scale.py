"""What an error of the scale of the motion adds to the uncertainty of a fit.

Where a test gives the amplitudes of the motion (backbones, decays, frequency responses at held amplitudes) the model is
solved at them. A gain of their channel that is off by 1 % then makes a cubic stiffness off by 2 %, and no observable
shows it: nothing in the fit tells the gain, so nothing can be taken out of the residual. It is an error that is
considered (Schmidt, Adv. Control Syst. 3 (1966) 293): the estimate stays, and its covariance grows by what one standard
deviation of each gain would move it by.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from nmt_core.arrays import FloatArray
from nmt_diagnose.inference.discrepancy import measured_elsewhere
from nmt_diagnose.inference.fit import Fit
from nmt_diagnose.inference.problem import Problem
from nmt_diagnose.observations.conditions import (
    BackboneTable,
    MeasuredChannel,
    RingDownTest,
    SteppedSineTest,
    Test,
)
from nmt_diagnose.observations.measuring_chain import table_chain
from nmt_diagnose.observations.observables import Observations
from nmt_diagnose.twin.forward import Forward, Prediction

_STEP = 1e-3


def covariance_with_scale(problem: Problem, found: Fit) -> FloatArray:
    """Covariance of an estimate with the gains of the channels whose amplitudes are given, shape (n, n).

    Args:
        problem: observations and model.
        found: the fit.
    """
    columns = scale_errors(problem, found)
    if not columns.shape[1]:
        return found.covariance
    rows = found.used
    whitened = problem.whitened(columns)
    whitened = np.where(np.isfinite(whitened), whitened, 0.0)[rows]
    moved = found.covariance @ (found.jacobian[rows].T @ whitened)
    return np.asarray(found.covariance + moved @ moved.T)


def scale_errors(problem: Problem, found: Fit) -> FloatArray:
    """What one standard deviation of each channel's gain adds to the prediction, by the amplitudes given, (m, r)."""
    observations = problem.observations
    gains = _gains(observations)
    numbers = sorted({number for numbers, _ in gains.values() for number in numbers})
    result = np.zeros((len(observations.rows), len(gains)))
    if not numbers:
        return result
    mine = np.isin(observations.rows.test, numbers)
    part = observations.rows.take(mine)
    rows = replace(part, test=np.searchsorted(numbers, part.test))
    rig = found.parametrisation.rig(found.theta)
    start = Prediction(
        found.prediction.values[mine], found.prediction.converged[mine], (),
        tuple(found.prediction.states[number] for number in numbers),
    )  # fmt: skip
    plain = Forward([observations.tests[number] for number in numbers], rows)
    base = plain.predict(rig, start)
    for column, (own, gain) in enumerate(gains.values()):
        tests = [
            _scaled(observations.tests[number]) if number in own else observations.tests[number] for number in numbers
        ]
        moved = Forward(tests, rows).predict(rig, base)
        result[mine, column] = gain * plain.difference(moved.values, base.values) / _STEP
    return result


def _gains(observations: Observations) -> dict[str, tuple[list[int], float]]:
    """Tests that give amplitudes of each channel, and the relative standard deviation of its gain."""
    found: dict[str, tuple[list[int], float]] = {}
    for number, test in enumerate(observations.tests):
        channel = _given(test)
        if channel is None or not measured_elsewhere(observations, number):
            continue
        chain = observations.chains[number] if number < len(observations.chains) else None
        gain = (chain or table_chain()).of(channel.name).gain
        numbers, largest = found.setdefault(channel.name, ([], 0.0))
        found[channel.name] = [*numbers, number], max(largest, gain)
    return found


def _given(test: Test) -> MeasuredChannel | None:
    """The channel whose amplitudes a test gives; None where the model predicts them."""
    if isinstance(test, SteppedSineTest):
        return test.channels[0]
    return test.channel if isinstance(test, BackboneTable | RingDownTest) else None


def _scaled(test: Test) -> Test:
    """The test with its motion a little larger than recorded."""
    if isinstance(test, SteppedSineTest):
        return replace(test, scale=test.scale * (1.0 + _STEP))
    assert isinstance(test, BackboneTable | RingDownTest)
    return replace(test, amplitudes=test.amplitudes * (1.0 + _STEP))
