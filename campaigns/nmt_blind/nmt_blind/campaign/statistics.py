"""Statistics of a score sheet: intervals of shares, detection curves, reliability of probabilities."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from nmt_core.numerics.arrays import FloatArray

Z_95 = 1.959963984540054


@dataclass(frozen=True)
class Proportion:
    """So many of so many, with the interval of 95 % after Wilson (1927)."""

    hits: int
    of: int

    @property
    def value(self) -> float:
        """The share; NaN of nothing."""
        return self.hits / self.of if self.of else math.nan

    @property
    def interval(self) -> tuple[float, float]:
        """Lower and upper end."""
        if not self.of:
            return math.nan, math.nan
        z2 = Z_95**2
        middle = (self.value + z2 / (2.0 * self.of)) / (1.0 + z2 / self.of)
        spread = self.value * (1.0 - self.value) / self.of + z2 / (4.0 * self.of**2)
        half = Z_95 / (1.0 + z2 / self.of) * math.sqrt(spread)
        return max(0.0, middle - half), min(1.0, middle + half)

    @classmethod
    def count(cls, found: Sequence[bool]) -> Proportion:
        """Of a sequence of yes and no."""
        return cls(sum(bool(item) for item in found), len(found))

    def to_mapping(self) -> dict[str, float | int | None]:
        """Plain values for JSON."""
        low, high = self.interval
        empty = self.of == 0
        return {
            "value": None if empty else self.value,
            "hits": self.hits,
            "of": self.of,
            "low": None if empty else low,
            "high": None if empty else high,
        }


def area_under_roc(positive: Sequence[float], negative: Sequence[float]) -> float:
    """Probability that a positive case scores higher than a negative one; ties count half."""
    if not positive or not negative:
        return math.nan
    a, b = np.asarray(positive)[:, np.newaxis], np.asarray(negative)[np.newaxis, :]
    return float(np.mean((a > b) + 0.5 * (a == b)))


def roc_curve(positive: Sequence[float], negative: Sequence[float]) -> tuple[FloatArray, FloatArray]:
    """False-alarm and detection rates over all thresholds, from (0, 0) to (1, 1); empty without cases of both kinds."""
    if not positive or not negative:
        return np.zeros(0), np.zeros(0)
    values = np.unique(np.concatenate([np.asarray(positive, float), np.asarray(negative, float)]))[::-1]
    false = np.array([0.0, *(np.mean(np.asarray(negative) >= v) for v in values)])
    true = np.array([0.0, *(np.mean(np.asarray(positive) >= v) for v in values)])
    return false, true


def threshold_for(negative: Sequence[float], rate: float) -> float:
    """Lowest threshold that at most a share `rate` of the negative scores exceeds (strictly)."""
    if not negative:
        return math.inf
    ordered = sorted(negative, reverse=True)
    return ordered[min(len(ordered) - 1, math.floor(rate * len(ordered) + 1e-9))]


@dataclass(frozen=True)
class ReliabilityDiagram:
    """Stated probabilities against how often they were right.

    Attributes:
        error: expected calibration error, Σ n_k/n |mean stated - share right|.
        stated, right, counts: by bin.
    """

    error: float
    stated: tuple[float, ...]
    right: tuple[float, ...]
    counts: tuple[int, ...]


def reliability(
    stated: Sequence[float], right: Sequence[bool], bins: int = 10, equal: bool = False
) -> ReliabilityDiagram:
    """Reliability over bins of equal width, or with equally many cases each."""
    p, y = np.asarray(stated, float), np.asarray(right, float)
    if p.size == 0:
        return ReliabilityDiagram(math.nan, (), (), ())
    if equal:
        groups = [g for g in np.array_split(np.argsort(p, kind="stable"), min(bins, p.size)) if g.size]
    else:
        index = np.minimum((p * bins).astype(int), bins - 1)
        groups = [np.flatnonzero(index == k) for k in range(bins) if (index == k).any()]
    means = tuple(float(p[g].mean()) for g in groups)
    shares = tuple(float(y[g].mean()) for g in groups)
    counts = tuple(int(g.size) for g in groups)
    error = sum(n * abs(m - s) for n, m, s in zip(counts, means, shares, strict=True)) / p.size
    return ReliabilityDiagram(float(error), means, shares, counts)
