"""Scatter of a quantity between units and within them, from estimates with their standard uncertainties."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.stats import chi2, t

from nmt_core.numerics.arrays import FloatArray, IntArray

COVERAGE = 0.95
"""Of the band for the next unit."""

FALSE_ALARM = 0.02
"""Probability that any of the units of a group is called odd in any of its parameters where none is."""

_FEWEST_TO_COMPARE = 4


@dataclass(frozen=True)
class Estimate:
    """One estimate: of which unit, at which setting (mounting, day, repeat), value and standard uncertainty.

    Attributes:
        unit, setting: of the recording.
        value: the estimate.
        std: its standard uncertainty without what all units share.
        shared_std: what all units share: it moves them all alike, so no difference between them has it.
    """

    unit: str
    setting: str
    value: float
    std: float
    shared_std: float = 0.0


@dataclass(frozen=True)
class OddUnit:
    """A unit that its sisters do not predict.

    Attributes:
        unit: its name.
        difference, difference_std: from the mean of its sisters; the uncertainty has their scatter in it.
        p: probability that a unit of their kind differs by as much.
    """

    unit: str
    difference: float
    difference_std: float
    p: float


@dataclass(frozen=True)
class UnitMean:
    """A unit's mean over its settings; ``std`` has the scatter within units in it."""

    unit: str
    value: float
    std: float


@dataclass(frozen=True)
class Components:
    """What a group of units says of a quantity.

    Attributes:
        mean, mean_std: of the units' distribution; what all units share is part of the uncertainty of the mean alone.
        between_std: standard deviation between units beyond what their estimates scatter.
        within_std: standard deviation between settings of one unit beyond their ±; None without repeated settings.
        heterogeneity_p: probability of as much scatter between units if they were alike (Cochran's Q).
        next_low, next_high: band that holds the estimate of the next unit, measured likewise, with ``COVERAGE``; where
            units differ by less than their ± it is wider than that.
        units: mean of each unit.
        odd: units that their sisters do not predict, the farthest first; needs four units.
    """

    mean: float
    mean_std: float
    between_std: float
    within_std: float | None
    heterogeneity_p: float
    next_low: float
    next_high: float
    units: tuple[UnitMean, ...]
    odd: tuple[OddUnit, ...] = ()


def components(estimates: Sequence[Estimate], parameters: int = 1) -> Components:
    """Means and variance components in two stages, each by the estimator of Paule and Mandel (J. Res. NBS 87 (1982)).

    The scatter within units is pooled over those with several settings and added to the ± of each estimate. The band
    of the next unit takes Student's t of one fewer degrees of freedom than units, as the variance is estimated from
    them. A unit is odd if Student's prediction from the others alone, at a level shared by all units and by all
    parameters of the group, does not hold it.

    Args:
        estimates: of one parameter.
        parameters: how many the group compares.

    Raises:
        ValueError: fewer than two units, or an estimate that is not finite or has no uncertainty.
    """
    names = list(dict.fromkeys(each.unit for each in estimates))
    values = np.array([each.value for each in estimates])
    stds = np.array([each.std for each in estimates])
    if len(names) < 2:
        raise ValueError("a group needs two units or more")
    if not (np.all(np.isfinite(values)) and np.all(np.isfinite(stds)) and np.all(stds > 0.0)):
        raise ValueError("each estimate needs a finite value and a standard uncertainty above 0")
    number = np.array([names.index(each.unit) for each in estimates])
    repeated = values.size > len(names)
    within = _excess(values, stds**2, number) if repeated else 0.0
    weights = 1.0 / (stds**2 + within)
    sums = np.bincount(number, weights)
    means = np.bincount(number, weights * values) / sums
    variances = 1.0 / sums
    between = _excess(means, variances, np.zeros(means.size, int))
    mean, variance = _mean(means, variances + between)
    single = float(np.mean(stds**2)) + within
    reach = float(t.ppf(0.5 + 0.5 * COVERAGE, means.size - 1)) * np.sqrt(between + single + variance)
    plain_mean, _ = _mean(means, variances)
    q = float(np.sum((means - plain_mean) ** 2 / variances))
    return Components(
        mean=mean,
        mean_std=float(np.sqrt(variance + np.mean([each.shared_std**2 for each in estimates]))),
        between_std=float(np.sqrt(between)),
        within_std=float(np.sqrt(within)) if repeated else None,
        heterogeneity_p=float(chi2.sf(q, means.size - 1)),
        next_low=mean - reach,
        next_high=mean + reach,
        units=tuple(
            UnitMean(name, float(value), float(std))
            for name, value, std in zip(names, means, np.sqrt(variances), strict=True)
        ),
        odd=_odd(names, means, variances, FALSE_ALARM / (means.size * parameters)),
    )


def _mean(values: FloatArray, variances: FloatArray) -> tuple[float, float]:
    """Weighted mean and its variance."""
    weights = 1.0 / variances
    return float(np.sum(weights * values) / np.sum(weights)), float(1.0 / np.sum(weights))


def _excess(values: FloatArray, variances: FloatArray, group: IntArray) -> float:
    """Variance that, added to those stated, makes the scatter about the groups' means what is expected of it."""
    freedom = values.size - np.unique(group).size

    def surplus(added: float) -> float:
        weights = 1.0 / (variances + added)
        means = np.bincount(group, weights * values) / np.bincount(group, weights)
        return float(np.sum(weights * (values - means[group]) ** 2)) - freedom

    if freedom < 1 or surplus(0.0) <= 0.0:
        return 0.0
    top = float(np.ptp(values)) ** 2 * values.size
    return float(brentq(surplus, 0.0, top, xtol=1e-12 * top))


def _odd(names: Sequence[str], means: FloatArray, variances: FloatArray, level: float) -> tuple[OddUnit, ...]:
    if means.size < _FEWEST_TO_COMPARE:
        return ()
    found = []
    for k, name in enumerate(names):
        others = np.delete(np.arange(means.size), k)
        added = _excess(means[others], variances[others], np.zeros(others.size, int))
        mean, variance = _mean(means[others], variances[others] + added)
        std = float(np.sqrt(variance + added + variances[k]))
        difference = float(means[k] - mean)
        p = float(2.0 * t.sf(abs(difference) / std, others.size - 1))
        if p < level:
            found.append(OddUnit(name, difference, std, p))
    return tuple(sorted(found, key=lambda each: each.p))
