"""Smooth errors of an effect's model, as a part of the noise of imported tests.

A cubic spring that a laboratory's beam is taken for is right to some percent of what it does: the beam has a curvature,
a clamp, a second mode besides. What is left of the gap then follows a smooth course over the level, and is no sign of
something else. It is taken for a Gaussian process over ln(amplitude) whose size is a share of what the best explanation
does to each observable (Kennedy and O'Hagan, J. R. Stat. Soc. B 63 (2001) 425), marginalised as errors that rows share.
The share is the one that makes what is left most probable, up to a largest one. Where an explanation leaves nothing
beyond the noise there is none, and the bench's own simulator has none at all.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from nmt_core.arrays import FloatArray, IntArray
from nmt_diagnose.observations.conditions import BackboneTable, RandomTest, RecordTest
from nmt_diagnose.observations.observables import Observations, Part

LARGEST_SHARE = 0.06
"""Share of what an effect does that a smooth error of its model may have, one standard deviation."""
# Frequencies at low levels are off by that much where the effect itself does nothing yet, relative.
_ORDINARY_FREQUENCY = 3e-3
_SHARES = (0.1, 0.2, 0.4, 0.7, 1.0)
_LENGTH = 1.5  # of ln(amplitude) over which the error stays the same
_KEPT = 0.01
_FEWEST_LEVELS = 4
_HELPS = 3.0  # fall of −ln of the probability of what is left from which an error is seen


def measured_elsewhere(observations: Observations, number: int) -> bool:
    """Whether a test was not made by the bench's own simulator: it was imported, or reduced by someone else."""
    chained = number < len(observations.chains) and observations.chains[number] is not None
    return chained or isinstance(observations.tests[number], BackboneTable)


def elsewhere(observations: Observations) -> bool:
    """Whether any test was not made by the bench's own simulator."""
    return any(measured_elsewhere(observations, number) for number in range(len(observations.tests)))


def smooth_errors(observations: Observations, difference: FloatArray, effect: FloatArray) -> FloatArray:
    """What one standard deviation of each smooth error adds to the observables, shape (m, r); r = 0 without any.

    Args:
        observations: the real side, its scatter part of the floors.
        difference: measured minus predicted by the best explanation, not whitened, shape (m,).
        effect: what the explanation's effects do to the prediction, shape (m,).
    """
    found: list[FloatArray] = []
    for number, test in enumerate(observations.tests):
        if isinstance(test, RandomTest | RecordTest) or not measured_elsewhere(observations, number):
            continue
        by_part: dict[int, list[tuple[IntArray, FloatArray]]] = {}
        for part, rows in _courses(observations, number, difference, effect):
            by_part.setdefault(part, []).append((rows, _columns(observations, part, rows, effect)))
        for blocks in by_part.values():
            share = _share(observations, difference, blocks)
            if share > 0.0:
                found += [_placed(len(observations.rows), rows, share * columns) for rows, columns in blocks]
    return np.hstack(found) if found else np.zeros((len(observations.rows), 0))


def _courses(
    observations: Observations, number: int, difference: FloatArray, effect: FloatArray
) -> Iterator[tuple[int, IntArray]]:
    """Part and rows of each observable of a test over its levels."""
    rows = observations.rows
    mine = (rows.test == number) & np.isfinite(difference) & np.isfinite(effect) & (rows.amplitude > 0.0)
    groups = np.column_stack([rows.channel, rows.harmonic, rows.part])
    for group in np.unique(groups[mine], axis=0):
        own = np.flatnonzero(mine & np.all(groups == group, axis=1))
        if own.size >= _FEWEST_LEVELS and group[2] != Part.PHASE_ERROR:
            yield int(group[2]), own


def _columns(observations: Observations, part: int, rows: IntArray, effect: FloatArray) -> FloatArray:
    """Principal functions of the process at its largest, shape (rows, s)."""
    size = LARGEST_SHARE * np.abs(effect[rows])
    if part == Part.LOG_FREQUENCY:
        size = np.hypot(size, min(_ORDINARY_FREQUENCY, float(np.max(size))))
    x = np.log(observations.rows.amplitude[rows])
    kernel = np.exp(-0.5 * ((x[:, None] - x[None, :]) / _LENGTH) ** 2)
    values, vectors = np.linalg.eigh(kernel)
    keep = values > _KEPT * values[-1]
    result: FloatArray = size[:, None] * vectors[:, keep] * np.sqrt(values[keep])
    return result


def _share(observations: Observations, difference: FloatArray, blocks: list[tuple[IntArray, FloatArray]]) -> float:
    """Share of the largest size that makes what is left most probable; 0 where noise alone does nearly as well."""
    best, share = _HELPS, 0.0
    plain = sum(_surprise(observations, difference, rows, 0.0 * columns) for rows, columns in blocks)
    for trial in _SHARES:
        fall = plain - sum(_surprise(observations, difference, rows, trial * columns) for rows, columns in blocks)
        if fall > best:
            best, share = fall, trial
    return share


def _surprise(observations: Observations, difference: FloatArray, rows: IntArray, columns: FloatArray) -> float:
    """−ln of the probability of what is left in some rows, up to a constant."""
    sigma = observations.sigma[rows]
    u = columns / sigma[:, None]
    covariance = np.eye(rows.size) + u @ u.T
    left = difference[rows] / sigma
    return 0.5 * float(left @ np.linalg.solve(covariance, left)) + 0.5 * float(np.linalg.slogdet(covariance)[1])


def _placed(size: int, rows: IntArray, columns: FloatArray) -> FloatArray:
    result = np.zeros((size, columns.shape[1]))
    result[rows] = columns
    return result
