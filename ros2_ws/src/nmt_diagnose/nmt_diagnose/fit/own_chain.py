"""Explanations with the errors of the measuring chain about themselves and not about the best of all.

Columns of the chain about an explanation hold what an error does through its effects: a gain of the force that is 1 %
off changes the harmonics of a stop that is just touched by a tenth. With these columns an explanation without the stop
would have its harmonics all the same, as the error of a gain.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from nmt_core.errors import BenchError
from nmt_diagnose.effects.location import Explanation
from nmt_diagnose.fit.explanations import FittedExplanation
from nmt_diagnose.fit.fitting import Data, Start, fit
from nmt_diagnose.fit.model_alone import about
from nmt_diagnose.measurements.measurement import Observations
from nmt_rig.rig import Rig


class OwnChains:
    """Fits explanations anew, each with the errors of the chain about itself, where those at hand are about more.

    Args:
        rig: the model.
        observations: the real side.
        data: rows and chain that all explanations were compared with.
        leader: the explanation that this chain is about.
    """

    def __init__(self, rig: Rig, observations: Observations, data: Data, leader: Explanation) -> None:
        self._rig, self._observations, self._data = rig, observations, data
        self._causes = set(leader.causes)
        self._known: dict[int, tuple[Data, FittedExplanation]] = {}

    def __call__(self, found: FittedExplanation) -> tuple[Data, FittedExplanation]:
        """Rows and chain about an explanation, and its fit to them.

        As they are where it has all effects of the leader, and where it cannot be fitted anew.
        """
        if self._causes <= set(found.fitted.causes):
            return self._data, found
        key = id(found.fit)
        if key not in self._known:
            self._known[key] = self._anew(found)
        return self._known[key]

    def _anew(self, found: FittedExplanation) -> tuple[Data, FittedExplanation]:
        near = found.fit
        try:
            data = about(self._rig, self._observations, near, self._data.used)
            refitted = fit(data, near.parametrisation, Start(near.start, near.theta, near))
        except (BenchError, ArithmeticError, np.linalg.LinAlgError):
            return self._data, found
        return data, replace(found, fit=refitted)
