"""How late channels are against the model by the phases of all their lines, however many turns that is.

Least squares on phases lead to the right delay from within half a turn of it at the highest line only. The sum of all
lines, each turned by what a delay would make of it, is largest at the right one (Knapp and Carter, IEEE Trans. Acoust.
Speech Signal Process. 24 (1976) 320, phase transform).
"""

from __future__ import annotations

import math

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.numerics.arrays import FloatArray
from nmt_diagnose.measurements.measurement import Observations, is_broad_band
from nmt_diagnose.observations.observables import Part
from nmt_diagnose.prediction.forward import Forward
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_rig.rig import Rig


def delay_of(frequency_hz: FloatArray, later: FloatArray) -> float:
    """Delay that explains phases best, s.

    Args:
        frequency_hz: of each line, (n,).
        later: phase lag of each, rad, (n,).

    Returns:
        Within 10 ms either way.
    """
    step = THRESHOLDS.prediction.delay_step_turns / float(frequency_hz.max())
    count = math.ceil(THRESHOLDS.prediction.latest_delay_s / step)
    tried = step * np.arange(-count, count + 1)
    sums = np.abs(np.exp(1j * (2.0 * np.pi * tried[:, None] * frequency_hz - later)).sum(axis=1))
    return float(tried[np.argmax(sums)])


def lateness(observations: Observations, rig: Rig) -> dict[tuple[int, int], float]:
    """Delay of each channel of each random test against a rig, s, by numbers of test and channel.

    Args:
        observations: the real side.
        rig: the model.
    """
    rows = observations.rows
    random = [k for k, test in enumerate(observations.tests) if is_broad_band(test)]
    selected = np.isin(rows.test, random) & (rows.part == Part.PHASE)
    if not selected.any():
        return {}
    forward = Forward(observations.tests, rows.take(selected))
    try:
        predicted = forward.predict(rig).values
    except (BenchError, ValueError, ArithmeticError, np.linalg.LinAlgError):
        return {}
    rows, lag = rows.take(selected), predicted - observations.values[selected]
    found = {}
    for test in random:
        for channel in np.unique(rows.channel[rows.test == test]):
            used = (rows.test == test) & (rows.channel == channel) & np.isfinite(lag)
            if used.any():
                found[test, int(channel)] = delay_of(rows.frequency_hz[used], lag[used])
    return found
