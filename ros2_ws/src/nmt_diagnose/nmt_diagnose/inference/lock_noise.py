"""What the noise of the loop does to a locked window: one error that all of its observables share.

The loop holds the phase that it measures, so noise of force and response moves the excitation off phase resonance. How
far is known only as well as the phase can be measured from the window; frequency, amplitudes and phases move together.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from nmt_diagnose.inference.problem import Nuisance
from nmt_diagnose.observations.conditions import PhaseResonanceTest
from nmt_diagnose.observations.observables import Observations, Part
from nmt_diagnose.twin.forward import Forward, Prediction
from nmt_diagnose.twin.twin_settings import TwinSettings
from nmt_rig.rig import Rig

_STEP = 1e-4
_LEAST = 0.1


def lock_nuisances(
    observations: Observations, rig: Rig, prediction: Prediction, settings: TwinSettings | None = None
) -> tuple[Nuisance, ...]:
    """Shared errors of all locked windows.

    Args:
        observations: the real side.
        rig: the model.
        prediction: its prediction of the observations.
        settings: of the twin.
    """
    moved = tuple(
        replace(test, levels=tuple(replace(level, phase_error=level.phase_error + _STEP) for level in test.levels))
        if isinstance(test, PhaseResonanceTest)
        else test
        for test in observations.tests
    )
    forward = Forward(moved, observations.rows, settings)
    changed = forward.predict(rig, prediction)
    slopes = forward.difference(changed.values, prediction.values) / _STEP / observations.sigma
    result = []
    for number, test in enumerate(observations.tests):
        if not isinstance(test, PhaseResonanceTest):
            continue
        for position, level in enumerate(test.levels):
            mine = (observations.rows.test == number) & (observations.rows.level == position)
            rows = np.flatnonzero(mine & (observations.rows.part != Part.PHASE_ERROR))
            vector = slopes[rows] * level.phase_error_std
            size = float(np.linalg.norm(vector))
            if np.all(np.isfinite(vector)) and size > _LEAST:
                result.append(Nuisance(rows, vector / size, size))
    return tuple(result)
