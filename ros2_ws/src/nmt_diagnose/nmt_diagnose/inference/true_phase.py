"""Where the loop truly stood: channels that are late make it hold another phase than the one that it measures.

To first order such a delay is an error that all observables of a locked window share, see chain_errors.py. Near
resonance amplitudes go with the square of the phase, though: 100 µs between force and response at 116 Hz are 73 mrad,
and the 0.27 % of amplitude that they take would pass for damping. So locked windows are predicted at the phase that the
observations themselves tell, and the errors stay linear about it:

    y = f(θ, p + δ) − g δ + C n + noise,

with p the measured phase, δ what was found of its error, g the change of the observables over the phase there, and C n
the errors of the measuring chain, all of them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from nmt_core.arrays import FloatArray
from nmt_diagnose.inference.chain_errors import lock_slopes
from nmt_diagnose.inference.problem import Problem
from nmt_diagnose.observations.conditions import PhaseResonanceTest
from nmt_diagnose.observations.observables import Observations, Part
from nmt_diagnose.twin.forward import Prediction
from nmt_rig.rig import Rig

LEAST_CHANGE = 3e-3  # rad; its square over two is far below what a test repeats to
_MOST = 0.35  # rad
_FLAT = 1e-9


def chain_share(problem: Problem, columns: FloatArray, difference: FloatArray) -> FloatArray:
    """What errors of the measuring chain but the clock's most probably make of a difference, shape (m,).

    Args:
        problem: observations with their noise, the chain's errors not among it.
        columns: what a standard deviation of each error adds, the clock's first, shape (m, r).
        difference: measured minus predicted, shape (m,).
    """
    own = np.nan_to_num(problem.whitened(columns), posinf=0.0, neginf=0.0)
    left = np.nan_to_num(problem.whitened(difference), posinf=0.0, neginf=0.0)
    errors = np.linalg.solve(np.eye(own.shape[1]) + own.T @ own, own.T @ left)
    result: FloatArray = columns[:, 1:] @ errors[1:]
    return result


def at_true_phases(
    observations: Observations, rig: Rig, prediction: Prediction, share: FloatArray
) -> tuple[Observations, float]:
    """The observations with the locked windows at the phases that the errors of the chain tell; largest change, rad.

    Args:
        observations: the real side.
        rig: an explanation of it.
        prediction: of that explanation.
        share: what errors of the measuring chain make of the observables, the clock's not among them, shape (m,).
    """
    rows, slopes = observations.rows, lock_slopes(observations, rig, prediction)
    tests, largest = list(observations.tests), 0.0
    for number, test in enumerate(tests):
        if not isinstance(test, PhaseResonanceTest):
            continue
        levels = list(test.levels)
        for position, level in enumerate(levels):
            mine = (rows.test == number) & (rows.level == position) & (rows.part == Part.LOG_FREQUENCY)
            if not mine.any() or not abs(slopes[mine][0]) > _FLAT:
                continue
            moved = float(np.clip(share[mine][0] / slopes[mine][0], -_MOST, _MOST))
            change = moved - level.phase_moved
            largest = max(largest, abs(change))
            levels[position] = replace(level, phase_error=level.phase_error + change, phase_moved=moved)
        tests[number] = replace(test, levels=tuple(levels))
    return replace(observations, tests=tuple(tests)), largest


def with_phases_of(observations: Observations, other: Observations) -> Observations:
    """Observations with the locked windows of others of the same recordings."""
    tests = tuple(
        theirs if isinstance(own, PhaseResonanceTest) else own
        for own, theirs in zip(observations.tests, other.tests, strict=True)
    )
    return replace(observations, tests=tests)


def phase_offset(observations: Observations, rig: Rig, prediction: Prediction) -> FloatArray:
    """What predictions at the true phases are too high by, g δ: the chain's errors hold it as well; shape (m,)."""
    rows, slopes = observations.rows, lock_slopes(observations, rig, prediction)
    moved = np.zeros(len(rows))
    for number, test in enumerate(observations.tests):
        if isinstance(test, PhaseResonanceTest):
            mine = rows.test == number
            moved[mine] = np.array([level.phase_moved for level in test.levels])[rows.level[mine]]
    result: FloatArray = slopes * moved
    return result
