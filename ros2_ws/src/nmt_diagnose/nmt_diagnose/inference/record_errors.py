"""Errors of records among those of the measuring chain: zeros and gains of their sensors, and the state in which each
begins."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from nmt_core.numerics.arrays import FloatArray
from nmt_diagnose.measurements.driven_record.driven_record import DrivenRecord
from nmt_diagnose.measurements.driven_record.predictor import RecordPredictor
from nmt_diagnose.measurements.imposed_motion.imposed_motion import ImposedMotion
from nmt_diagnose.measurements.imposed_motion.predictor import ImposedMotionPredictor
from nmt_diagnose.observations.observables import Observations
from nmt_diagnose.prediction.parts_cache import PartsCache
from nmt_diagnose.prediction.prediction_settings import PredictionSettings
from nmt_rig.rig import Rig


def record_errors(observations: Observations, rig: Rig) -> dict[str, FloatArray]:
    """What a standard deviation of each error adds to the observables, (m,) each, about the motion of a rig.

    Sensors of the bench's own simulator have neither zeros nor gains that are off. The zero of a sensor is one for all
    records, which it drifts about: what is little beside a loud record is much beside a quiet one.

    Args:
        observations: the real side.
        rig: an explanation of it.
    """
    rows, settings = observations.rows, PredictionSettings()
    cache, found = PartsCache(settings), {}
    by_sensor: dict[str, list[tuple[float, FloatArray]]] = {}
    chains = (*observations.chains, *[None] * len(observations.tests))
    for number, (test, chain) in enumerate(zip(observations.tests, chains, strict=False)):
        if not isinstance(test, DrivenRecord):
            continue
        selected = rows.test == number
        part = rows.take(selected)
        part = replace(part, test=np.zeros_like(part.test))
        predictor: RecordPredictor | ImposedMotionPredictor = (
            ImposedMotionPredictor(test, part, settings)
            if isinstance(test, ImposedMotion)
            else RecordPredictor(test, part, settings)
        )
        zeros = _zeros(test)
        for name, column in predictor.errors(rig, cache, chain).items():
            found[name] = np.zeros(len(rows))
            found[name][selected] = column
            if name in zeros:
                by_sensor.setdefault(name.removesuffix(f" in {test.name}"), []).append((zeros[name], found[name]))
    for name, columns in by_sensor.items():
        largest = max(std for std, _ in columns)
        if len(columns) > 1:
            found[name] = np.sum([largest / std * column for std, column in columns if std > 0.0], axis=0)
    return found


def _zeros(test: DrivenRecord) -> dict[str, float]:
    """Standard deviation of the zero of each channel of a record, by the name of the error."""
    names = (test.input_channel.name, *(channel.name for channel in test.channels))
    return {f"zero of {name} in {test.name}": float(std) for name, std in zip(names, test.zeros, strict=False)}
