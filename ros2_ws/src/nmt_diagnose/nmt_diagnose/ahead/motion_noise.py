"""Uncertainties of locked levels that have not been measured, over how little their channels move."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from nmt_core.errors import BenchError
from nmt_diagnose.fit.explanations import FittedExplanation
from nmt_diagnose.measurements.measurement import Observations
from nmt_diagnose.observations.observables import Part
from nmt_diagnose.prediction.forward import Forward


def noise_over_motion(left: Observations, at_hand: Observations, found: FittedExplanation) -> Observations:
    """Expected uncertainties of a run of locked levels where its channels move less than in those at hand.

    Noise of a channel is the same at all motions: a window of as many periods is the shorter the higher its frequency,
    so that the noise in its mean goes with the root of that. Over a small motion it is large. It is never taken to be
    less than in the tests at hand, which lock and repeat no better over a large one.

    Args:
        left: the run; other tests stay as they are.
        at_hand: what has been measured.
        found: an explanation, which tells the motion.
    """
    test = left.tests[0]
    runs = [number for number, it in enumerate(at_hand.tests) if it.locked is not None]
    if test.locked is None or not runs:
        return left
    rows, std = left.rows, left.std.copy()
    try:
        values = Forward(left.tests, rows).predict(found.fit.parametrisation.rig(found.fit.theta)).values
    except (BenchError, ArithmeticError, np.linalg.LinAlgError):
        return left
    fundamental = (at_hand.rows.part == Part.LOG_MAGNITUDE) & (at_hand.rows.harmonic == 1)
    fundamental &= np.isin(at_hand.rows.test, runs) & np.isfinite(at_hand.values)
    names = [tuple(c.name for c in test.channels) for test in at_hand.tests]
    for number, channel in enumerate(test.channels):
        same = np.array([
            k >= 0 and names[t][k] == channel.name for t, k in zip(at_hand.rows.test, at_hand.rows.channel, strict=True)
        ])  # fmt: skip
        alike = fundamental & same
        if not alike.any():
            continue
        frequency = np.maximum(at_hand.rows.frequency_hz[alike], 1e-12)
        noise = float(np.median(at_hand.sigma[alike] * np.exp(at_hand.values[alike]) / np.sqrt(frequency)))
        of_drive = at_hand.sigma[alike][np.argsort(at_hand.rows.amplitude[alike], kind="stable")]
        places = np.linspace(0.0, 1.0, of_drive.size)
        for level in np.unique(rows.level):
            here = rows.level == level
            row = np.flatnonzero(here & (rows.channel == number) & (rows.part == Part.LOG_MAGNITUDE))[0]
            relative = noise * math.sqrt(rows.frequency_hz[row]) / math.exp(values[row])
            if not math.isfinite(relative):
                continue
            std[here & (rows.channel == number)] *= max(1.0, relative / left.std[row])
            if test.locked.turned_by(channel.name) > 0:
                before = float(np.interp(level / max(1, len(test.locked.levels) - 1), places, of_drive))
                std[here & (rows.channel < 0)] *= max(1.0, relative / before)
    return replace(left, std=std)
