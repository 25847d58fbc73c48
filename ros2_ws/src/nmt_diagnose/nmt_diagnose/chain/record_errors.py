"""Errors of records among those of the measuring chain: zeros and gains of their sensors, and the state in which each
begins."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from nmt_core.numerics.arrays import FloatArray
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
        selected = rows.test == number
        part = rows.take(selected)
        part = replace(part, test=np.zeros_like(part.test))
        errors, zeros = test.record_errors(part, rig, cache, settings, chain)
        for name, column in errors.items():
            found[name] = np.zeros(len(rows))
            found[name][selected] = column
            if name in zeros:
                by_sensor.setdefault(name.removesuffix(f" in {test.name}"), []).append((zeros[name], found[name]))
    for name, columns in by_sensor.items():
        largest = max(std for std, _ in columns)
        if len(columns) > 1:
            found[name] = np.sum([largest / std * column for std, column in columns if std > 0.0], axis=0)
    return found
