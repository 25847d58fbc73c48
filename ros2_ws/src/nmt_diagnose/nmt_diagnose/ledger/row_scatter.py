"""How much rows scatter about their neighbours, whatever a model predicts: what their noise can be at most.

What a model lacks changes neighbouring levels and lines alike; noise does not. Each row is compared with the cubic
through its four neighbours over level or frequency, in a short course with the line through two. This is done with the
measured values and with the residuals of a model. Resonances bend the first and not the second. Curvature only adds
scatter, so the smaller of the two is nearer to the noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from nmt_core.numerics.arrays import BoolArray, FloatArray, IntArray
from nmt_diagnose.fit.misfit import series_of, where_of
from nmt_diagnose.measurements.measurement import Observations
from nmt_diagnose.observations.noise.scatter import neighbour_cubics
from nmt_diagnose.observations.observables import Part
from nmt_diagnose.thresholds import THRESHOLDS

_PHASES = (Part.PHASE, Part.PHASE_ERROR)


@dataclass(frozen=True)
class RowScatter:
    """Squares of the distance of rows from their neighbours over the variance that their uncertainties allow it.

    Attributes:
        measured: of the measured values, (m,); NaN where a row has too few neighbours.
        left: of the residuals of a model, (m,).
    """

    measured: FloatArray
    left: FloatArray

    def largest_scale(self, groups: IntArray, count: int) -> FloatArray:
        """Largest squared scale of each group, (K,): no less than 1, infinite where too few rows have neighbours.

        Args:
            groups: group of each row, (m,).
            count: groups K.
        """
        limits, result = THRESHOLDS.noise, np.full(count, np.inf)
        known = np.isfinite(self.measured) & np.isfinite(self.left)
        for group in np.unique(groups[known]):
            rows = known & (groups == group)
            if int(rows.sum()) < limits.scatter_fewest_rows:
                continue
            scatter = min(float(np.mean(values[rows])) for values in (self.measured, self.left))
            # A variance of relative standard deviation r is as well known as one of 2/r² degrees of freedom.
            degrees = 0.5 * int(rows.sum()) / limits.cubic_relative_std**2
            # The upper tail of the inverse: the largest variance that shows as little scatter.
            least_square = float(chdtri(degrees, 1.0 - limits.scatter_probability))
            result[group] = max(1.0, scatter * degrees / max(least_square, 1e-300))
        return result


def row_scatter(observations: Observations, predicted: FloatArray, sigma: FloatArray) -> RowScatter:
    """Scatter of rows about their neighbours; NaN for samples of a record, whose residuals are smooth in time.

    Args:
        observations: the real side.
        predicted: by a model, (m,).
        sigma: standard deviations of the rows, (m,).
    """
    rows = observations.rows
    usable = np.isfinite(predicted) & (sigma > 0.0) & (rows.part != Part.SAMPLE)
    result = np.full((2, len(rows)), np.nan)
    phases = np.isin(rows.part, _PHASES)
    left = observations.values - predicted
    left[phases] = np.angle(np.exp(1j * left[phases]))
    place = where_of(observations)
    for course in series_of(observations, usable):
        where = place[course]
        order = np.argsort(where, kind="stable")
        course, where = course[order], where[order]
        apart: BoolArray = np.concatenate([[True], np.diff(where) > 0.0])
        course, where = course[apart], where[apart]
        for number, values in enumerate((observations.values, left)):
            y = np.unwrap(values[course]) if phases[course[0]] else values[course]
            middle, near, weights = _neighbours(where)
            distance = y[middle] - np.sum(weights * y[near], axis=1)
            own = sigma[course]
            variance = own[middle] ** 2 + np.sum((weights * own[near]) ** 2, axis=1)
            result[number, course[middle]] = distance**2 / variance
    return RowScatter(*result)


def _neighbours(x: FloatArray) -> tuple[IntArray, IntArray, FloatArray]:
    """Rows with their neighbours and the weights of these: of cubics, in a short course of lines."""
    if x.size >= THRESHOLDS.noise.table_fewest_for_scatter:
        return neighbour_cubics(x)
    middle = np.arange(1, x.size - 1)
    near = middle[:, None] + np.array([-1, 1])
    share = (x[middle] - x[near[:, 0]]) / (x[near[:, 1]] - x[near[:, 0]])
    return middle, near, np.stack([1.0 - share, share], axis=1)
