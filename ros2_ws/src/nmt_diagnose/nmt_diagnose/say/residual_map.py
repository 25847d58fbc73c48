"""Residual map: residuals per test, level, channel and harmonic; and per observable in engineering units."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from nmt_core.numerics.arrays import BoolArray, FloatArray
from nmt_diagnose.ledger.diagnosis import ResidualGroup
from nmt_diagnose.ledger.gap import Pair, rms
from nmt_diagnose.measurements.measurement import Observations, holds_amplitude
from nmt_diagnose.observations.observables import Part, PartFacts

# Bands of lines in the map of residuals.
_BANDS = 10


def channel_name(observations: Observations, test: int, channel: int) -> str:
    """Name of a row's channel; ``frequency and phase`` where it belongs to none."""
    return "frequency and phase" if channel < 0 else observations.tests[test].channels[channel].name


def level_groups(observations: Observations) -> FloatArray:
    """Level of every row; the lines of a frequency response in ten bands, shape (m,)."""
    groups = observations.rows.level.astype(np.float64)
    for number, test in enumerate(observations.tests):
        selected = observations.rows.test == number
        if test.lines is not None and selected.any():
            groups[selected] = np.floor(
                observations.rows.level[selected] * _BANDS / (observations.rows.level[selected].max() + 1)
            )
    return groups


def residual_map(
    observations: Observations, as_given: FloatArray, before: FloatArray, after: FloatArray
) -> tuple[ResidualGroup, ...]:
    """Root-mean-square whitened residuals by test, level, channel and harmonic.

    Args:
        observations: the real side.
        as_given, before, after: whitened residuals of the model as given, re-fitted, and with the explanation, (m,).
    """
    rows, levels = observations.rows, level_groups(observations)
    keys = np.column_stack([rows.test, levels, rows.channel, rows.harmonic])
    result = []
    for key in np.unique(keys, axis=0):
        selected = np.all(keys == key, axis=1)
        test, level, channel, harmonic = (int(value) for value in key)
        banded = (harmonic < 0 and channel >= 0) or holds_amplitude(observations.tests[test])
        result.append(
            ResidualGroup(
                observations.tests[test].name,
                level,
                float(np.mean(rows.frequency_hz[selected] if banded else rows.amplitude[selected])),
                channel_name(observations, test, channel),
                harmonic,
                rms(as_given[selected]),
                rms(before[selected]),
                rms(after[selected]),
                int(selected.sum()),
            )
        )
    return tuple(result)


def observables_of(observations: Observations) -> Iterator[tuple[str, int, int, PartFacts, BoolArray]]:
    """Observables: name, number of the test, of the channel (−1 = none), their facts, and their rows, (m,)."""
    rows = observations.rows
    for number, test in enumerate(observations.tests):
        for words, parts in itertools.groupby(Part, lambda part: part.facts.words):
            alike = tuple(parts)
            kind = (rows.test == number) & np.isin(rows.part, alike)
            for channel in np.unique(rows.channel[kind]):
                tail = f" {channel_name(observations, number, int(channel))}" if channel >= 0 else ""
                name = f"{test.name}: {words}{tail}"
                yield name, number, int(channel), alike[0].facts, kind & (rows.channel == channel)


def per_observable(observations: Observations, pairs: Sequence[Pair]) -> dict[str, dict[str, Any]]:
    """Gap by observable: in noise units, and in engineering units as root mean square.

    Args:
        observations: the real side.
        pairs: residuals before and after of the rows to judge by; a row that several splits hold out counts in each.
    """
    result: dict[str, dict[str, Any]] = {}
    judged = [rows & np.isfinite(before) & np.isfinite(after) for before, after, rows in pairs]
    for name, number, channel, facts, kind in observables_of(observations):
        selected = [kind & rows for rows in judged]
        count = sum(int(rows.sum()) for rows in selected)
        if not count:
            continue
        scale = observations.sigma * facts.factor
        found: dict[str, Any] = {"floor": 1.0, "rows": count, "values": int(np.any(selected, axis=0).sum())}
        for key, side in (("before", 0), ("after", 1)):
            pooled = [(pair[side][rows], scale[rows]) for pair, rows in zip(pairs, selected, strict=True)]
            found[key] = rms(np.concatenate([residual for residual, _ in pooled]))
            found[f"{key}_unit"] = rms(np.concatenate([residual * unit for residual, unit in pooled]))
        found["unit"] = facts.unit or unit_of_channel(observations, number, channel)
        result[name] = found
    return result


def unit_of_channel(observations: Observations, test: int, channel: int) -> str:
    """Unit of the rows of a channel that have that of the channel; empty for those that belong to none."""
    return observations.tests[test].channels[channel].unit if channel >= 0 else ""
