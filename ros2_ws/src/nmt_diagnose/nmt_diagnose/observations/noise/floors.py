"""Floors: what finite exactness of lock, estimators and model adds to the noise, and what repeats show."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from nmt_core.numerics.arrays import FloatArray, IntArray
from nmt_diagnose.measurements.measurement import Observations
from nmt_diagnose.observations.observables import ANGLES, Natural, Rows, parts_where
from nmt_diagnose.thresholds import THRESHOLDS


def with_stated_repeatability(observations: Observations, run: Mapping[str, Any]) -> Observations:
    """The observations with what the sidecar of its bag says of repeats as part of the floors.

    Args:
        observations: of one bag.
        run: start record of the bag; ``imported.sidecar.repeatability`` has ``frequency``, ``damping`` and
            ``amplitude`` (relative) and ``phase_deg``, standard deviations.
    """
    imported = run.get("imported")
    sidecar = imported.get("sidecar") if isinstance(imported, dict) else None
    stated = sidecar.get("repeatability") if isinstance(sidecar, dict) else None
    if not isinstance(stated, dict):
        return observations
    part, floor = observations.rows.part, observations.floor
    for kind in parts_where(lambda facts: bool(facts.stated)):
        size = float(stated.get(kind.facts.stated) or 0.0)
        size = math.radians(size) if kind.facts.angle else size
        of_value = np.abs(observations.values) if kind.facts.natural is Natural.VALUE else 1.0
        floor = np.where(part == kind, np.hypot(floor, size * of_value), floor)
    return replace(observations, floor=floor)


def repeatability(observations: Observations, repeats: Observations) -> tuple[FloatArray, tuple[str, ...]]:
    """Floor of each row from the difference between a test and its repeat.

    Rows are paired by kind of test, drive point, level of excitation, channel, harmonic and part. Rows of one type
    (kind of test, part, fundamental or not, channel) share one floor: the rms of their differences over √2, less what
    the stated uncertainties explain. It takes the place of the row's own floor where it is larger.

    Args:
        observations: the real side.
        repeats: the same tests once more.

    Returns:
        Floors, shape (m,), and a sentence for the user.
    """
    floor = observations.floor.copy()
    partner = {key: row for row, key in enumerate(_keys(repeats))}
    paired = np.array([partner.get(key, -1) for key in _keys(observations)], dtype=np.int64)
    found = paired >= 0
    if not found.any():
        return floor, ("The floor bags hold no repeat of a test of the real side; the floors are the default ones.",)
    difference = np.full(paired.shape[0], np.nan)
    difference[found] = observations.values[found] - repeats.values[paired[found]]
    angles = np.isin(observations.rows.part, ANGLES)
    difference[angles] = (difference[angles] + np.pi) % (2.0 * np.pi) - np.pi
    stated = np.full(paired.shape[0], np.nan)
    stated[found] = 0.5 * (observations.std[found] ** 2 + repeats.std[paired[found]] ** 2)
    kinds = _types(observations.rows, observations)
    raised = 0
    for kind in np.unique(kinds[found]):
        selected = found & (kinds == kind)
        if int(selected.sum()) < THRESHOLDS.noise.floor_fewest_pairs:
            continue
        excess = float(np.mean(0.5 * difference[selected] ** 2) - np.mean(stated[selected]))
        measured = np.sqrt(max(0.0, excess))
        every = kinds == kind
        raised += int(np.sum(every & (floor < measured)))
        floor[every] = np.maximum(floor[every], measured)
    count = int(found.sum())
    return floor, (f"{count} observables have a repeat; the differences raise the floor of {raised}.",)


def _types(rows: Rows, observations: Observations) -> IntArray:
    order = np.clip(rows.harmonic, -1, 2)
    quantity = np.zeros(len(rows), dtype=np.int64)
    for index in range(len(rows)):
        channels = observations.tests[rows.test[index]].channels
        quantity[index] = int(channels[rows.channel[index]].quantity) if rows.channel[index] >= 0 else 0
    result: IntArray = ((rows.test * 16 + rows.part) * 16 + order + 1) * 16 + quantity
    return result


def _keys(observations: Observations) -> list[tuple[object, ...]]:
    rows = observations.rows
    keys: list[tuple[object, ...]] = []
    for index in range(len(rows)):
        test = observations.tests[rows.test[index]]
        channel = test.channels[rows.channel[index]].name if rows.channel[index] >= 0 else ""
        place, amplitude = test.repeat_key(rows, index)
        kind = int(rows.harmonic[index]), int(rows.part[index])
        keys.append((test.WORDS, test.drive_point, place, amplitude, channel, *kind))
    return keys
