"""Focused tests of the residuals of an explanation, each for one kind of structure that noise does not have.

A global χ² over thousands of rows cannot see an effect of a few standard deviations. These tests look where an effect
would leave its trace; Holm's method combines them.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from scipy.special import chdtrc, fdtrc, ndtr

from nmt_core.numerics.arrays import BoolArray, FloatArray
from nmt_diagnose.measurements.measurement import Measurement, Observations, locked_levels
from nmt_diagnose.say.residual_map import channel_name
from nmt_diagnose.thresholds import THRESHOLDS


@dataclass(frozen=True)
class ResidualTest:
    """One test.

    Attributes:
        name: what it looks for.
        where: channel, or test.
        statistic: χ² or z.
        degrees_of_freedom: degrees of freedom (0 = standard normal).
        p: probability of as much by chance.
        p_holm: the same, corrected for the number of tests.
    """

    name: str
    where: str
    statistic: float
    degrees_of_freedom: int
    p: float
    p_holm: float = float("nan")

    def to_mapping(self) -> dict[str, Any]:
        """Plain values."""
        return asdict(self)


def residual_tests(observations: Observations, residual: FloatArray, used: BoolArray) -> tuple[ResidualTest, ...]:
    """All tests that the observations allow, most telling first.

    Args:
        observations: the real side.
        residual: whitened residual of the best explanation, parameters fitted, shape (m,).
        used: rows that the fit used.
    """
    good = used & np.isfinite(residual)
    found: list[ResidualTest] = []
    for number, test in enumerate(observations.tests):
        selected = good & (observations.rows.test == number)
        if not selected.any():
            continue
        squares = float(residual[selected] @ residual[selected])
        found.append(_size(test, squares, int(selected.sum())))
        if test.locked is not None:
            found.extend(_over_level(observations, residual, selected, number))
            found.extend(_parity(observations, residual, selected, test.name))
            found.extend(_up_down(observations, residual, selected, test))
        else:
            found.extend(_neighbours(observations, residual, selected, number))
    return holm(found)


def holm(tests: list[ResidualTest]) -> tuple[ResidualTest, ...]:
    """Holm's step-down correction; most telling first."""
    ordered = sorted(tests, key=lambda test: test.p)
    result, running = [], 0.0
    for rank, test in enumerate(ordered):
        running = max(running, min(1.0, test.p * (len(ordered) - rank)))
        result.append(ResidualTest(test.name, test.where, test.statistic, test.degrees_of_freedom, test.p, running))
    return tuple(result)


def _chi_square(name: str, where: str, statistic: float, degrees_of_freedom: int) -> ResidualTest:
    return ResidualTest(name, where, statistic, degrees_of_freedom, float(chdtrc(degrees_of_freedom, statistic)))


def _size(test: Measurement, squares: float, count: int) -> ResidualTest:
    """χ² of all rows of a test; where their noise is an estimate, over its degrees of freedom by Fisher's F."""
    name, degrees = "size of the residual", test.noise_degrees
    if math.isinf(degrees):
        return _chi_square(name, test.name, squares, count)
    return ResidualTest(name, test.name, squares, count, float(fdtrc(count, degrees, squares / count)))


def _over_level(
    observations: Observations, residual: FloatArray, selected: BoolArray, number: int
) -> list[ResidualTest]:
    """Smooth courses over the level: a quadratic through the levels of each channel, harmonic and part."""
    rows, result = observations.rows, []
    for channel in np.unique(rows.channel[selected]):
        statistic, degrees_of_freedom = 0.0, 0
        for harmonic in np.unique(rows.harmonic[selected & (rows.channel == channel)]):
            for part in np.unique(rows.part[selected & (rows.channel == channel) & (rows.harmonic == harmonic)]):
                group = selected & (rows.channel == channel) & (rows.harmonic == harmonic) & (rows.part == part)
                if int(group.sum()) < THRESHOLDS.verdict.course_fewest_levels:
                    continue
                x = np.argsort(np.argsort(rows.amplitude[group], kind="stable"), kind="stable").astype(np.float64)
                basis, _ = np.linalg.qr(np.vander(x - x.mean(), 3))
                along = basis.T @ residual[group]
                statistic += float(along @ along)
                degrees_of_freedom += 3
        if degrees_of_freedom:
            name = channel_name(observations, number, int(channel))
            result.append(_chi_square("smooth course over the level", name, statistic, degrees_of_freedom))
    return result


def _parity(observations: Observations, residual: FloatArray, selected: BoolArray, name: str) -> list[ResidualTest]:
    result = []
    for label, remainder in (("even harmonics", 0), ("odd harmonics above the first", 1)):
        group = selected & (observations.rows.harmonic > 1) & (observations.rows.harmonic % 2 == remainder)
        if group.any():
            result.append(_chi_square(label, name, float(residual[group] @ residual[group]), int(group.sum())))
    return result


def _up_down(
    observations: Observations, residual: FloatArray, selected: BoolArray, test: Measurement
) -> list[ResidualTest]:
    """Differences between two passages of the same drive level."""
    rows = observations.rows
    drives = {level.index: level.drive for level in locked_levels([test])}
    pairs = [(a, b) for a in drives for b in drives if a < b and np.isclose(drives[a], drives[b], rtol=1e-6)]
    statistic, degrees_of_freedom = 0.0, 0
    for first, second in pairs:
        left, right = selected & (rows.level == first), selected & (rows.level == second)
        if int(left.sum()) != int(right.sum()):
            continue
        difference = (residual[left] - residual[right]) / np.sqrt(2.0)
        statistic += float(difference @ difference)
        degrees_of_freedom += int(left.sum())
    return (
        [_chi_square("differences between rising and falling level", test.name, statistic, degrees_of_freedom)]
        if degrees_of_freedom
        else []
    )


def _neighbours(
    observations: Observations, residual: FloatArray, selected: BoolArray, number: int
) -> list[ResidualTest]:
    """Products of neighbouring lines or samples: noise has none on average."""
    rows, result = observations.rows, []
    for channel in np.unique(rows.channel[selected]):
        total, count = 0.0, 0
        for part in np.unique(rows.part[selected & (rows.channel == channel)]):
            group = np.flatnonzero(selected & (rows.channel == channel) & (rows.part == part))
            values = residual[group[np.argsort(rows.level[group], kind="stable")]]
            total += float(values[1:] @ values[:-1])
            count += values.size - 1
        if count > 10:
            z = total / np.sqrt(count)
            name = channel_name(observations, number, int(channel))
            where = f"{observations.tests[number].name}, {name}" if len(observations.tests) > 1 else name
            result.append(ResidualTest("correlation of neighbouring lines", where, z, 0, float(ndtr(-z))))
    return result
