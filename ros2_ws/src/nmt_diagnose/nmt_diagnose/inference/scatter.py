"""Scatter of imported runs from level to level, as what an explanation leaves shows it.

A laboratory's repeats differ by 0.1 to 2 %, far more than the noise within a window. What scatters about a straight
line over the levels has no course that an effect would have, so it is noise of a kind of its own: it raises the floors.
What follows a smooth course does not. Lines of a sweep that had not settled scatter likewise, about their neighbours.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.stats import chi2

from nmt_core.arrays import FloatArray, IntArray
from nmt_diagnose.observations.conditions import BackboneTable, PhaseResonanceTest, SteppedSineTest
from nmt_diagnose.observations.neighbour_cubics import neighbour_cubics
from nmt_diagnose.observations.observables import Observations, Part
from nmt_diagnose.observations.stepped_table_observations import MEDIAN_STD

_FEWEST_LEVELS = 4
_FEWEST_FREE = 3
_FEWEST_BETWEEN = 4
_BY_CHANCE = 1e-4
_MEDIAN = 0.6745  # of the magnitude of a normal variable
# What scatter may be, as an ordinary share: ln ω, phases in rad, ln of magnitudes, harmonics over their fundamental.
_LARGEST = {
    Part.LOG_FREQUENCY: 1e-3,
    Part.PHASE_ERROR: 0.02,
    Part.LOG_MAGNITUDE: 0.02,
    Part.PHASE: 0.02,
    Part.REAL: 5e-3,
    Part.IMAG: 5e-3,
}
# Of tables that others have reduced, relative: a laboratory's repeats, not those of a locked loop.
_LARGEST_OF_TABLES = {Part.LOG_FREQUENCY: 0.02, Part.DAMPING: 0.3}
_LARGEST_OF_LINES = 0.02
_FEWEST_LINES = 12
_TIMES = 4.0  # standard deviations of an estimated scatter that count


def scatter_floor(observations: Observations, difference: FloatArray) -> FloatArray:
    """Standard deviation of the scatter of each row's kind, shape (m,); 0 where it may be noise as stated.

    Rows of one kind share it: those of a test, part and quantity, fundamentals and other orders apart.

    Args:
        observations: the real side.
        difference: measured minus predicted, not whitened, shape (m,).
    """
    result = _of_lines(observations, difference)
    for number, test in enumerate(observations.tests):
        if isinstance(test, BackboneTable):
            for part, largest in _LARGEST_OF_TABLES.items():
                which = np.flatnonzero((observations.rows.test == number) & (observations.rows.part == part))
                if not which.size:
                    continue
                size = 1.0 if part is Part.LOG_FREQUENCY else float(np.median(np.abs(observations.values[which])))
                chance = _BY_CHANCE if math.isinf(test.noise_degrees) else 1.0
                result[which] = min(_about_neighbours(observations, difference, which, chance), largest * size)
        if not (
            isinstance(test, PhaseResonanceTest) and number < len(observations.chains) and observations.chains[number]
        ):
            continue
        quantities = np.array([int(channel.quantity) for channel in test.channels] + [-1])
        mine = observations.rows.test == number
        kinds = np.column_stack(
            [
                observations.rows.part,
                quantities[observations.rows.channel * mine],
                np.minimum(observations.rows.harmonic, 2),
            ]
        )
        for kind in np.unique(kinds[mine], axis=0):
            which = mine & np.all(kinds == kind, axis=1)
            ordinary = _LARGEST.get(Part(int(kind[0])))
            if ordinary is not None:
                result[which] = min(_of_kind(observations, difference, np.flatnonzero(which)), ordinary)
    return result


def _of_lines(observations: Observations, difference: FloatArray) -> FloatArray:
    """Standard deviation of the lines of sweeps beyond the stated one, the same for all sweeps of a channel, (m,).

    Each line is compared with the cubic through its four neighbours. The median does not see where an effect leaves
    more than a smooth course.
    """
    rows = observations.rows
    result = np.zeros(len(rows))
    channels = {test.channels for test in observations.tests if isinstance(test, SteppedSineTest)}
    for own in sorted(channels, key=repr):
        numbers = [
            number
            for number, test in enumerate(observations.tests)
            if isinstance(test, SteppedSineTest) and test.channels == own
        ]
        found = []
        for number in numbers:
            for part in (Part.LOG_MAGNITUDE, Part.PHASE):
                which = np.flatnonzero((rows.test == number) & (rows.part == part) & np.isfinite(difference))
                which = which[np.argsort(rows.frequency_hz[which], kind="stable")]
                if which.size >= _FEWEST_LINES:
                    found.append(_beside_cubics(rows.frequency_hz[which], difference[which], observations.sigma[which]))
        beside = np.concatenate(found) if found else np.zeros(0)
        if not beside.size:
            continue
        ratio = float(np.median(np.abs(beside))) / _MEDIAN
        if ratio > 1.0 + _TIMES * MEDIAN_STD / math.sqrt(beside.size):
            mine = np.isin(rows.test, numbers) & np.isin(rows.part, (Part.LOG_MAGNITUDE, Part.PHASE))
            size = math.sqrt(ratio**2 - 1.0) * float(np.median(observations.sigma[mine]))
            result[mine] = min(size, _LARGEST_OF_LINES)
    return result


def _beside_cubics(frequency: FloatArray, values: FloatArray, sigma: FloatArray) -> FloatArray:
    """Distances of values from the cubics through their four neighbours, over their stated standard deviations."""
    middle, near, weights = neighbour_cubics(frequency)
    stated = np.sqrt(sigma[middle] ** 2 + np.sum((weights * sigma[near]) ** 2, axis=1))
    result: FloatArray = (values[middle] - np.sum(weights * values[near], axis=1)) / stated
    return result


def _about_neighbours(observations: Observations, difference: FloatArray, which: IntArray, chance: float) -> float:
    """Standard deviation beyond the stated one of a table's rows, each about the line through its two neighbours.

    A smooth course bends by less between neighbours than scatter does, so what an effect leaves counts little. It is
    none where the noise as stated would give as much with a probability above ``chance``.
    """
    own = which[np.isfinite(difference[which])]
    own = own[np.argsort(observations.rows.amplitude[own], kind="stable")]
    x = np.log(np.maximum(observations.rows.amplitude[own], 1e-300))
    apart = x[2:] - x[:-2]
    good = apart > 0.0
    if int(good.sum()) < _FEWEST_BETWEEN:
        return 0.0
    weight = np.divide(x[1:-1] - x[:-2], apart, out=np.full(apart.size, 0.5), where=good)
    d, variance = difference[own], observations.sigma[own] ** 2
    squares = (d[1:-1] - (1.0 - weight) * d[:-2] - weight * d[2:]) ** 2
    size = 1.0 + (1.0 - weight) ** 2 + weight**2
    stated = variance[1:-1] + (1.0 - weight) ** 2 * variance[:-2] + weight**2 * variance[2:]
    squares, size, stated = squares[good], size[good], stated[good]
    # Neighbouring differences share values: about two of three are independent.
    free = 2.0 * squares.size / 3.0
    if chi2.sf(free * float(np.mean(squares / stated)), free) > chance:
        return 0.0
    return float(np.sqrt(max(float(np.mean((squares - stated) / size)), 0.0)))


def _of_kind(observations: Observations, difference: FloatArray, which: np.ndarray) -> float:
    """Standard deviation beyond the stated one about straight lines over the levels, one for each channel and order."""
    rows = observations.rows.take(which)
    left, stated, squares, free = 0.0, 0.0, 0.0, 0
    groups = np.column_stack([rows.channel, rows.harmonic])
    for group in np.unique(groups, axis=0):
        own = which[np.all(groups == group, axis=1)]
        own = own[np.isfinite(difference[own])]
        if own.size < _FEWEST_LEVELS:
            continue
        sigma = observations.sigma[own]
        level = observations.rows.amplitude[own]
        basis = np.column_stack([np.ones(own.size), level - level.mean()])
        if np.linalg.matrix_rank(basis) < 2:
            basis = basis[:, :1]
        orthonormal, _ = np.linalg.qr(basis)
        rest = difference[own] - orthonormal @ (orthonormal.T @ difference[own])
        left += float(rest @ rest)
        degrees_of_freedom = own.size - basis.shape[1]
        squares += degrees_of_freedom * float(np.mean(sigma**2))
        stated += float(np.max(sigma) ** 2) * degrees_of_freedom
        free += degrees_of_freedom
    if free < _FEWEST_FREE or chi2.sf(left / (stated / free), free) > _BY_CHANCE:
        return 0.0
    # A variance from few values is uncertain itself; residuals over it have the variance d / (d − 2).
    return float(np.sqrt(max(left - squares, 0.0) / max(free - 2, 1)))
