"""The part of the gap that a named explanation does not close: size, observables, and levels."""

from __future__ import annotations

import math

import numpy as np

from nmt_core.numerics.arrays import FloatArray, IntArray
from nmt_diagnose.ledger.diagnosis import Gap, Remainder, RemainderPart
from nmt_diagnose.ledger.gap import NOISE, rms
from nmt_diagnose.measurements.measurement import Observations
from nmt_diagnose.say.residual_map import observables_of, unit_of_channel
from nmt_diagnose.thresholds import THRESHOLDS

# Observables that are named with the remainder of a gap.
_NAMED_OBSERVABLES = 3

_BANDS = ("lowest", "middle", "highest")


def remainder(observations: Observations, gap: Gap, after: FloatArray) -> Remainder | None:
    """The remainder of a gap; None where that is less than 1 % of it, not known, or no more than the noise before.

    Args:
        observations: the real side.
        gap: before and after the explanation.
        after: residual of the judged rows in standard deviations, (m,); NaN in the others.
    """
    if not math.isfinite(gap.closed) or 1.0 - gap.closed < THRESHOLDS.verdict.least_remainder or gap.before <= NOISE:
        return None
    found: list[tuple[float, RemainderPart]] = []
    good = np.isfinite(after)
    for name, number, channel, facts, kind in observables_of(observations):
        selected = np.flatnonzero(kind & good)
        if not selected.size:
            continue
        beyond = float(np.sum(after[selected] ** 2)) - selected.size * gap.floor**2
        left = RemainderPart(
            name, _levels(observations, number, after, selected), 0.0, rms(after[selected]),
            rms(after[selected] * observations.sigma[selected] * facts.factor),
            facts.unit or unit_of_channel(observations, number, channel),
        )  # fmt: skip
        found.append((max(beyond, 0.0), left))
    total = sum(size for size, _ in found)
    found.sort(key=lambda item: -item[0])
    where = tuple(
        RemainderPart(left.observable, left.levels, size / total, left.rms, left.rms_unit, left.unit)
        for size, left in found[:_NAMED_OBSERVABLES]
        if total > 0.0 and size > 0.0
    )
    return Remainder(1.0 - gap.closed, 1.0 - gap.high, 1.0 - gap.low, where)


def _levels(observations: Observations, number: int, after: FloatArray, selected: IntArray) -> str:
    """The third of a test's levels (or lines) that holds most of the residual; empty where none does."""
    test = observations.tests[number]
    place = test.axis.thirds(observations.rows, selected)
    steps = np.unique(place)
    if steps.size < THRESHOLDS.verdict.remainder_fewest_levels:
        return ""
    third = np.searchsorted(steps, place) * len(_BANDS) // steps.size
    squares = np.bincount(third, after[selected] ** 2, minlength=len(_BANDS))
    most = int(np.argmax(squares))
    return (
        f"{_BANDS[most]} {test.axis.steps}"
        if squares[most] > THRESHOLDS.verdict.remainder_third_share * squares.sum()
        else ""
    )
