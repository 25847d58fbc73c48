"""Errors of records among those of the measuring chain: zeros and gains of their sensors, and the state in which each
begins."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from nmt_core.numerics.arrays import FloatArray
from nmt_diagnose.observations.conditions import ImposedMotionTest, RecordTest
from nmt_diagnose.observations.observables import Observations
from nmt_diagnose.prediction.imposed_motion_predictor import ImposedMotionPredictor
from nmt_diagnose.prediction.parts_cache import PartsCache
from nmt_diagnose.prediction.prediction_settings import PredictionSettings
from nmt_diagnose.prediction.record_predictor import RecordPredictor
from nmt_rig.rig import Rig


def record_errors(observations: Observations, rig: Rig) -> dict[str, FloatArray]:
    """What a standard deviation of each error adds to the observables, (m,) each, about the motion of a rig.

    Sensors of the bench's own simulator have neither zeros nor gains that are off.

    Args:
        observations: the real side.
        rig: an explanation of it.
    """
    rows, settings = observations.rows, PredictionSettings()
    cache, found = PartsCache(settings), {}
    chains = (*observations.chains, *[None] * len(observations.tests))
    for number, (test, chain) in enumerate(zip(observations.tests, chains, strict=False)):
        if not isinstance(test, RecordTest):
            continue
        selected = rows.test == number
        part = rows.take(selected)
        part = replace(part, test=np.zeros_like(part.test))
        predictor: RecordPredictor | ImposedMotionPredictor = (
            ImposedMotionPredictor(test, part, settings)
            if isinstance(test, ImposedMotionTest)
            else RecordPredictor(test, part, settings)
        )
        for name, column in predictor.errors(rig, cache, chain).items():
            found[name] = np.zeros(len(rows))
            found[name][selected] = column
    return found
