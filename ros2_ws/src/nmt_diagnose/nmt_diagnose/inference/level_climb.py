"""Levels as a search climbs them: the lowest are nearly linear, and a fit is led from them to the highest."""

from __future__ import annotations

import numpy as np

from nmt_core.arrays import BoolArray, FloatArray
from nmt_diagnose.effects.parametrisation import Parametrisation
from nmt_diagnose.inference.fit import Fit, fit
from nmt_diagnose.inference.problem import Problem
from nmt_diagnose.observations.conditions import PhaseResonanceTest, SteppedSineTest
from nmt_diagnose.observations.observables import Observations

# Shares of the levels that a doubted fit is led over.
_CLIMB = (0.0, 0.25, 0.5, 0.65, 0.8, 0.9, 1.0)


def level_ranks(observations: Observations) -> tuple[BoolArray, FloatArray]:
    """Rows of levels of locked tests and of sweeps, and which share of these levels is lower, shape (m,) each."""
    rows = observations.rows
    levelled, rank = np.zeros(rows.test.size, dtype=bool), np.zeros(rows.test.size)
    sweeps = {
        number: (test.held, float(np.median(test.levels)))
        for number, test in enumerate(observations.tests)
        if isinstance(test, SteppedSineTest)
    }
    for number, test in enumerate(observations.tests):
        if isinstance(test, PhaseResonanceTest):
            mine = rows.test == number
            levelled |= mine
            amplitudes = np.unique(rows.amplitude[mine])
            rank[mine] = np.searchsorted(amplitudes, rows.amplitude[mine]) / max(1, amplitudes.size)
        elif number in sweeps:
            held, level = sweeps[number]
            levels = np.unique([other for quantity, other in sweeps.values() if quantity == held])
            if levels.size > 1:
                mine = rows.test == number
                levelled |= mine
                rank[mine] = np.searchsorted(levels, level) / levels.size
    return levelled, rank


def climbed(problem: Problem, parametrisation: Parametrisation, used: BoolArray | None, theta: FloatArray) -> Fit:
    """The model fitted to linear tests first, then to more and more levels from below.

    Far from the real parameters a nonlinear level has valleys of its own; from the levels below it is near.

    Args:
        problem: observations and model.
        parametrisation: what is fitted.
        used: rows that count, shape (m,); None = all.
        theta: start, shape (n,).

    Raises:
        FitError: as :func:`nmt_diagnose.inference.fit.fit`.
    """
    levelled, rank = level_ranks(problem.observations)
    wanted = np.ones(problem.size, dtype=bool) if used is None else used
    before = np.zeros_like(wanted)
    for share in _CLIMB[:-1]:
        rows = wanted & (~levelled | (rank < share))
        if np.any(rows != before) and np.any(rows != wanted):
            before = rows
            theta = fit(problem, parametrisation, theta, rows, only=True).theta
    return fit(problem, parametrisation, theta, wanted)
