"""The gap on held-out data: before, after, floor, and how much of it a candidate closes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from nmt_core.numerics.arrays import BoolArray, FloatArray, IntArray
from nmt_diagnose.measurements.measurement import Observations
from nmt_diagnose.observations.observables import Part
from nmt_diagnose.thresholds import THRESHOLDS

# The 5 % ends of an interval then rest on fifty resamples each.
_RESAMPLES = 1000
# Fewer resamples with a gap have no 5 % ends.
_FEWEST_RESAMPLES = 50

Pair = tuple[FloatArray, FloatArray, BoolArray]
"""Residuals over standard deviations before and after, (m,) each, and the rows that are judged by them, (m,)."""

NOISE = 1.0
"""Root mean square of residuals in standard deviations that the stated uncertainties allow."""


@dataclass(frozen=True)
class ClosedShare:
    """How much of a gap is closed.

    Attributes:
        before, after: root-mean-square whitened residual on held-out data.
        floor: what noise and repeatability leave.
        value: (before − after) / (before − floor), at most 1; NaN without a gap to close.
        low, high: bootstrap interval of 90 %.
        gain: fall of the squared residuals over its own scatter from block to block; negative where the held-out data
            are predicted worse.
    """

    before: float
    after: float
    floor: float
    value: float
    low: float
    high: float
    gain: float = float("nan")


def rms(residual: FloatArray) -> float:
    """Root mean square of whitened residuals; NaN without any."""
    finite = residual[np.isfinite(residual)]
    return float(np.sqrt(np.mean(finite**2))) if finite.size else float("nan")


def over_splits(residuals: Sequence[tuple[FloatArray, BoolArray]]) -> FloatArray:
    """Root mean square of each row's residuals over the splits that judge it, (m,); NaN where none does.

    Args:
        residuals: of a split, (m,), and the rows that it judges, (m,).
    """
    every = np.array([np.where(rows, residual, np.nan) for residual, rows in residuals])
    judged = np.isfinite(every)
    squares = np.sum(np.where(judged, every, 0.0) ** 2, axis=0)
    with np.errstate(invalid="ignore"):
        return np.asarray(np.sqrt(squares / judged.sum(axis=0)))


def closed(
    observations: Observations,
    pairs: list[Pair],
    seed: int = 0,
    floor: float = 1.0,
) -> ClosedShare:
    """Pool held-out residuals of several splits and resample them in blocks that belong together.

    Args:
        observations: the real side.
        pairs: residuals of the held-out rows, one pair for each split.
        seed: of the bootstrap.
        floor: rms of the noise floor. A smaller residual after the fit replaces it, as no prediction beats a true
            floor.
    """
    before_squares, after_squares, counts = [], [], []
    for before, after, rows in pairs:
        both = rows & np.isfinite(before) & np.isfinite(after)
        # Rows of one level (one tenth of the lines of a random test) stand or fall together.
        keys = observations.rows.test * 100_000 + _block(observations)
        for key in np.unique(keys[both]):
            block = both & (keys == key)
            before_squares.append(float(before[block] @ before[block]))
            after_squares.append(float(after[block] @ after[block]))
            counts.append(int(block.sum()))
    if not counts:
        nan = float("nan")
        return ClosedShare(nan, nan, floor, nan, nan, nan)
    b, a, n = np.array(before_squares), np.array(after_squares), np.array(counts)
    generator = np.random.default_rng(seed)
    draws = generator.integers(0, n.size, size=(_RESAMPLES, n.size))
    total = n[draws].sum(axis=1)
    sample = _share(np.sqrt(b[draws].sum(axis=1) / total), np.sqrt(a[draws].sum(axis=1) / total), floor)
    sample = sample[np.isfinite(sample)]
    low, high = (
        (float(x) for x in np.quantile(sample, [0.05, 0.95]))
        if sample.size > _FEWEST_RESAMPLES
        else (float("nan"),) * 2
    )
    before_rms, after_rms = float(np.sqrt(b.sum() / n.sum())), float(np.sqrt(a.sum() / n.sum()))
    value = float(_share(np.array([before_rms]), np.array([after_rms]), floor)[0])
    floor = min(floor, after_rms)
    fall = b - a
    scatter = float(np.sqrt(n.size) * np.std(fall))
    gain = float(fall.sum()) / scatter if scatter > 0.0 else 0.0
    return ClosedShare(before_rms, after_rms, floor, value, low, high, gain)


def no_worse_than_silence(observations: Observations, residual: FloatArray, sigma: FloatArray) -> FloatArray:
    """A residual over standard deviations, (m,), that on no channel of a record is larger than the record itself.

    A model that runs away from the measured values counts like one that predicts nothing: how far it went does not
    count as a gap that something closes.

    Args:
        observations: the real side.
        residual: of a model, (m,).
        sigma: standard deviation of each row, (m,).
    """
    rows, result = observations.rows, residual.copy()
    samples = rows.part == Part.SAMPLE
    for test, channel in {(int(t), int(c)) for t, c in zip(rows.test[samples], rows.channel[samples], strict=True)}:
        selected = samples & (rows.test == test) & (rows.channel == channel) & np.isfinite(residual)
        silence, size = rms(observations.values[selected] / sigma[selected]), rms(residual[selected])
        if size > silence:
            result[selected] *= silence / size
    return result


def _block(observations: Observations) -> IntArray:
    level = observations.rows.level
    lines = observations.rows.harmonic < 0
    many = np.bincount(observations.rows.test) > 0
    blocks = level.astype(np.int64).copy()
    for test in np.flatnonzero(many):
        selected = (observations.rows.test == test) & lines
        if np.unique(level[selected]).size > THRESHOLDS.verdict.many_lines:
            blocks[selected] = level[selected] * 10 // (int(level[selected].max()) + 1)
    return blocks


def _share(before: FloatArray, after: FloatArray, floor: float) -> FloatArray:
    """Share of the gap above the floor that is closed: at most 1, NaN where nothing lies above the floor."""
    reached = np.minimum(floor, after)
    with np.errstate(divide="ignore", invalid="ignore"):
        value = (before - after) / (before - reached)
    return np.where(before > floor * THRESHOLDS.verdict.least_gap_ratio, value, np.nan)
