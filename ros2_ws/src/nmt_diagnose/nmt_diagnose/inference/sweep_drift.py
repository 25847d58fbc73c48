"""Drift of the resonance between sweeps, as what an explanation leaves shows it.

Sweeps up and down at several levels take hours; meanwhile a clamp warms up or a bolt settles, and the resonance moves
by some hundredths of a percent. Near the peak of a lightly damped mode that is many times the noise of a line. It has
no course that an effect would have: two sweeps at one level differ by it. So each sweep has a shift of its own, of a
common standard deviation, which is marginalised as an error that its rows share.
"""

from __future__ import annotations

import numpy as np
from scipy.stats import chi2

from nmt_core.arrays import FloatArray
from nmt_diagnose.observations.conditions import SteppedSineTest
from nmt_diagnose.observations.observables import Observations

_FEWEST = 3
_BY_CHANCE = 1e-4
# Relative shifts of a resonance beyond this are no drift.
_LARGEST = 1e-3
_SAME_LEVEL = 0.02


def sweep_drift(observations: Observations, difference: FloatArray, directions: FloatArray) -> float:
    """Relative standard deviation of the resonance from sweep to sweep; 0 where the noise explains the differences.

    Args:
        observations: the real side.
        difference: measured minus predicted by the best explanation, not whitened, shape (m,).
        directions: what a relative shift of the resonance does to the rows of each sweep, shape (m, tests); columns of
            zeros for other tests.
    """
    shifts: dict[int, tuple[float, float]] = {}
    for number, test in enumerate(observations.tests):
        mine = np.flatnonzero((observations.rows.test == number) & np.isfinite(difference) & (observations.sigma > 0.0))
        column = directions[mine, number] / observations.sigma[mine]
        square = float(column @ column)
        if isinstance(test, SteppedSineTest) and square > 0.0:
            along = float(column @ (difference[mine] / observations.sigma[mine]))
            shifts[number] = along / square, 1.0 / square
    squares, stated, size = [], [], []
    for first, second in _pairs(observations, list(shifts)):
        (a, variance), (b, other) = shifts[first], shifts[second]
        squares.append((a - b) ** 2)
        stated.append(variance + other)
        size.append(2.0)
    if len(squares) < _FEWEST:
        squares, stated, size = _about_neighbours(observations, shifts)
    if len(squares) < _FEWEST:
        return 0.0
    own, noise = np.array(squares), np.array(stated)
    if chi2.sf(float(np.sum(own / noise)), own.size) > _BY_CHANCE:
        return 0.0
    return min(float(np.sqrt(max(float(np.mean((own - noise) / np.array(size))), 0.0))), _LARGEST)


def _level(observations: Observations, number: int) -> float:
    test = observations.tests[number]
    assert isinstance(test, SteppedSineTest)
    return float(np.median(test.levels))


def _pairs(observations: Observations, numbers: list[int]) -> list[tuple[int, int]]:
    """Sweeps of one level and quotient, each in one pair at most."""
    found, taken = [], set[int]()
    for k, first in enumerate(numbers):
        for second in numbers[k + 1 :]:
            one, other = observations.tests[first], observations.tests[second]
            assert isinstance(one, SteppedSineTest)
            assert isinstance(other, SteppedSineTest)
            near = abs(np.log(_level(observations, first) / _level(observations, second))) < _SAME_LEVEL
            alike = (one.held, one.reference, one.channels, one.drive_point) == (
                other.held, other.reference, other.channels, other.drive_point,
            )  # fmt: skip
            if near and alike and not {first, second} & taken:
                found.append((first, second))
                taken |= {first, second}
    return found


def _about_neighbours(
    observations: Observations, shifts: dict[int, tuple[float, float]]
) -> tuple[list[float], list[float], list[float]]:
    """Squares of each sweep's shift about the line through those of the levels beside it, over ln of the level."""
    order = sorted(shifts, key=lambda number: _level(observations, number))
    levels = np.log([_level(observations, number) for number in order]) if order else np.zeros(0)
    squares, stated, size = [], [], []
    for k in range(1, len(order) - 1):
        apart = levels[k + 1] - levels[k - 1]
        if not apart > 0.0:
            continue
        weight = float((levels[k] - levels[k - 1]) / apart)
        (a, one), (b, two), (c, three) = (shifts[order[k + step]] for step in (-1, 0, 1))
        squares.append((b - (1.0 - weight) * a - weight * c) ** 2)
        stated.append(two + (1.0 - weight) ** 2 * one + weight**2 * three)
        size.append(1.0 + (1.0 - weight) ** 2 + weight**2)
    return squares, stated, size
