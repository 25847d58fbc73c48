"""Noise of sweeps that state none: each shows its own by its scatter, and those of one channel show it together.

A scatter of sixty lines is known to a seventh. Of six sweeps that are taken each by itself, one looks so much more
exact than it is that its ordinary noise counts as a gap. Where the sweeps scatter alike, or nearly so, each is drawn
towards what all of them say, by how uncertain it is and how much they differ (empirical Bayes of ln σ, between-sweep
variance by DerSimonian and Laird 1986).
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from nmt_core.numerics.arrays import FloatArray
from nmt_diagnose.observations.conditions import SteppedSineTest
from nmt_diagnose.observations.observables import Observations


def with_shared_scatter(observations: Observations) -> Observations:
    """The observations with the noise of sweeps that is estimated from their scatter taken together, by channel."""
    groups: dict[str, list[int]] = {}
    for number, test in enumerate(observations.tests):
        estimated = isinstance(test, SteppedSineTest) and math.isfinite(test.noise_degrees)
        if estimated and np.any(observations.rows.test == number):
            groups.setdefault(repr((_sweep(test).channels, _sweep(test).reference)), []).append(number)
    tests, std = list(observations.tests), observations.std.copy()
    notes = list(observations.notes)
    for numbers in groups.values():
        if len(numbers) < 2:
            continue
        rows_of_test = [observations.rows.test == number for number in numbers]
        before = np.array([float(std[selected][0]) for selected in rows_of_test])
        after, degrees = shrunk(before, np.array([_sweep(tests[number]).noise_degrees for number in numbers]))
        for number, selected, old, new, free in zip(numbers, rows_of_test, before, after, degrees, strict=True):
            std[selected] *= new / old  # of the first channel; others scatter in proportion
            test = _sweep(tests[number])
            noise = np.sqrt(np.maximum(test.noise**2 - old**2, 0.0) + new**2)
            tests[number] = replace(test, noise=noise, noise_degrees=float(free))
        low, high = (f"{100.0 * value:.2g}" for value in (after.min(), after.max()))
        span = f"{low} %" if low == high else f"{low} to {high} %"
        name = _sweep(tests[numbers[0]]).channels[0].name
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


def _sweep(test: object) -> SteppedSineTest:
    assert isinstance(test, SteppedSineTest)
    return test
