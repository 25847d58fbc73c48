"""Noise by scatter: of few values each, of the points of a course about a smooth one, of sweeps that state none.

A standard uncertainty from ten sub-windows is itself uncertain by a quarter, and residuals over it have the tails of
Student's distribution. Rows of one kind have similar noise, so their variances are drawn towards a common one, as far
as they scatter no more than such few values must (empirical Bayes; G. K. Smyth, 2004, Statistical Applications in
Genetics and Molecular Biology 3, 3).

A scatter of sixty lines is known to a seventh. Of six sweeps that are taken each by itself, one looks so much more
exact than it is that its ordinary noise counts as a gap. Where the sweeps scatter alike, or nearly so, each is drawn
towards what all of them say, by how uncertain it is and how much they differ (empirical Bayes of ln σ, between-sweep
variance by DerSimonian and Laird 1986).
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq
from scipy.special import digamma, polygamma

from nmt_core.numerics.arrays import FloatArray, IntArray
from nmt_diagnose.measurements.measurement import Observations
from nmt_diagnose.thresholds import THRESHOLDS


def moderated(variances: FloatArray, degrees_of_freedom: float) -> tuple[FloatArray, FloatArray]:
    """Variances drawn towards the common one.

    Args:
        variances: s² of one kind of row, shape (k,); zeros and NaN stay as they are.
        degrees_of_freedom: degrees of freedom of each.

    Returns:
        The moderated variances, shape (k,), and their degrees of freedom, shape (k,).
    """
    result = variances.copy()
    usable = np.isfinite(variances) & (variances > 0.0)
    degrees = np.full(variances.shape, degrees_of_freedom)
    if int(usable.sum()) < THRESHOLDS.noise.moderated_fewest:
        return result, degrees
    logs = np.log(variances[usable]) - digamma(0.5 * degrees_of_freedom) + np.log(0.5 * degrees_of_freedom)
    excess = float(np.var(logs, ddof=1)) - float(polygamma(1, 0.5 * degrees_of_freedom))
    prior = _degrees_of_freedom_of(excess)
    common = float(np.exp(logs.mean() + digamma(0.5 * prior) - np.log(0.5 * prior)))
    result[usable] = (degrees_of_freedom * variances[usable] + prior * common) / (degrees_of_freedom + prior)
    degrees[usable] = degrees_of_freedom + prior
    return result, degrees


def _degrees_of_freedom_of(excess: float) -> float:
    """Degrees of freedom d with ψ'(d/2) = excess, at most 1e4."""
    smallest = float(polygamma(1, 0.5 * THRESHOLDS.noise.most_degrees_of_freedom))
    if excess <= smallest:
        return THRESHOLDS.noise.most_degrees_of_freedom
    return 2.0 * float(
        brentq(lambda half: float(polygamma(1, half)) - excess, 1e-3, 0.5 * THRESHOLDS.noise.most_degrees_of_freedom)
    )


_NEAR = np.array([-2, -1, 1, 2])


class NeighbourCubics(NamedTuple):
    """For k points of a course, from the third to the last but two.

    Attributes:
        middle: (k,) their positions.
        near: (k, 4) positions of their neighbours.
        weights: (k, 4) of the neighbours' values in the cubic at the point (Lagrange).
    """

    middle: IntArray
    near: IntArray
    weights: FloatArray


def neighbour_cubics(x: FloatArray) -> NeighbourCubics:
    """Of places in ascending order, shape (n,); points with neighbours at one place are left out."""
    middle = np.arange(2, x.size - 2)
    near = middle[:, None] + _NEAR
    gaps = x[near][:, :, None] - x[near][:, None, :]
    gaps[:, range(4), range(4)] = 1.0
    good = np.all(gaps != 0.0, axis=(1, 2))
    middle, near, gaps = middle[good], near[good], gaps[good]
    offsets = np.repeat((x[middle][:, None] - x[near])[:, None, :], 4, axis=1)
    offsets[:, range(4), range(4)] = 1.0
    return NeighbourCubics(middle, near, np.prod(offsets, axis=2) / np.prod(gaps, axis=2))


def with_shared_scatter(observations: Observations) -> Observations:
    """The observations with the noise of sweeps that is estimated from their scatter taken together, by channel."""
    rows, groups = observations.rows, dict[str, list[int]]()
    for number, test in enumerate(observations.tests):
        key = None if test.lines is None else test.lines.scatter_key
        if key is not None and np.any(rows.test == number):
            groups.setdefault(repr(key), []).append(number)
    tests, std = list(observations.tests), observations.std.copy()
    notes = list(observations.notes)
    for numbers in groups.values():
        if len(numbers) < 2:
            continue
        rows_of_test = [rows.test == number for number in numbers]
        before = np.array([float(np.median(std[selected & (rows.channel == 0)])) for selected in rows_of_test])
        after, degrees = shrunk(before, np.array([tests[number].noise_degrees for number in numbers]))
        for number, selected, old, new, free in zip(numbers, rows_of_test, before, after, degrees, strict=True):
            if (lines := tests[number].lines) is not None:
                first = np.flatnonzero(selected & (rows.channel == 0))
                of_lines = std[first[np.unique(rows.level[first], return_index=True)[1]]]
                tests[number] = lines.with_scatter(of_lines, float(new / old), float(free))
            std[selected] *= new / old  # of the first channel; others scatter in proportion
        low, high = (f"{100.0 * value:.2g}" for value in (after.min(), after.max()))
        span = f"{low} %" if low == high else f"{low} to {high} %"
        name = tests[numbers[0]].channels[0].name
        notes.append(f"The scatter of the {len(numbers)} sweeps of {name} is taken together: {span}.")
    return replace(observations, tests=tuple(tests), std=std, notes=tuple(notes))


def shrunk(std: FloatArray, degrees: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Standard deviations that belong to one kind, each drawn towards all, and their degrees of freedom.

    Args:
        std: estimated, shape (k,), k ≥ 2.
        degrees: degrees of freedom of each estimated variance, shape (k,): ln σ has the variance 1/(2 ν).
    """
    log, variance = np.log(std), 0.5 / degrees
    weight = 1.0 / variance
    mean = float(weight @ log / weight.sum())
    spread = float(weight @ (log - mean) ** 2)
    between = max(0.0, (spread - (std.size - 1)) / float(weight.sum() - weight @ weight / weight.sum()))
    weight = 1.0 / (variance + between)
    mean = float(weight @ log / weight.sum())
    share = between / (between + variance)
    after = variance * share + (1.0 - share) ** 2 / weight.sum()
    return np.exp(mean + share * (log - mean)), np.asarray(0.5 / after)
