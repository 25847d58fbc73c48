"""Force loops: the missing force over displacement and velocity of its place, level by level, measured and read."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_diagnose.law.law_search import LawCandidate, LawSearch
from nmt_diagnose.law.modal_frame import ORDERS
from nmt_diagnose.law.terms import SAMPLES, sampled

_DRAWN = 64
_DRAWN_LEVELS = 5  # more curves hide each other


@dataclass(frozen=True)
class ForceLoop:
    """One period at one level, or a stretch of a part of a record.

    Attributes:
        level: number in the test's plan.
        displacement, velocity: of the place, m and m/s.
        measured: force by the rows of the level alone, of the harmonics that were observed, N.
        std: standard uncertainty of it at every instant, N.
        law: force of the law, of the same harmonics, N.
        line: of a stretch of a record, displacement, velocity and force of the law between the instants, too; empty =
            one period, whose end meets its beginning.
    """

    level: int
    displacement: tuple[float, ...]
    velocity: tuple[float, ...]
    measured: tuple[float, ...]
    std: float
    law: tuple[float, ...]
    line: tuple[tuple[float, ...], ...] = ()


def force_loops(search: LawSearch, candidate: LawCandidate, number: int) -> tuple[ForceLoop, ...]:
    """Loops of a law at a few levels, the lowest and the highest among them.

    Args:
        search: of the law.
        candidate: the law.
        number: of its place.
    """
    rows = search.rows
    place, _ = candidate.parts[number]
    forces = search.forces(candidate)
    # What chain and model are off by, and the laws of other places, do not belong to it.
    left = candidate.fit.corrected
    for k, (participation, force) in enumerate(forces):
        if k != number:
            left = left - rows.whitened(rows.of_force(participation, force))
    measured, std = _harmonics(search, place.participation, left)
    force = forces[number][1]
    count = rows.levels.count
    chosen = np.unique(np.linspace(0, count - 1, min(count, _DRAWN_LEVELS)).round().astype(int))
    x, v = sampled(candidate.motions[number], rows.levels.omega)
    step = SAMPLES // _DRAWN
    result = []
    for k in chosen:
        kept = np.where(np.arange(ORDERS + 1) <= rows.highest, force[k], 0.0)
        kept[0] = 0.0
        waves = [_wave(series) for series in (measured[k], kept)]
        drawn = [_rounded(wave) for wave in (x[k, ::step], v[k, ::step], *waves)]
        result.append(ForceLoop(rows.levels.numbers[k], drawn[0], drawn[1], drawn[2], float(std[k]), drawn[3]))
    return tuple(result)


def _rounded(wave: FloatArray) -> tuple[float, ...]:
    return tuple(float(f"{value:.6g}") for value in wave)


def _wave(series: ComplexArray) -> FloatArray:
    angles = 2.0 * np.pi * np.arange(_DRAWN) / _DRAWN
    return np.asarray((series @ np.exp(1j * np.arange(series.size)[:, np.newaxis] * angles)).real)


def _harmonics(search: LawSearch, participation: FloatArray, left: FloatArray) -> tuple[ComplexArray, FloatArray]:
    """Harmonics (L, ORDERS + 1) of the force by least squares of each level's rows, and the spread of the wave (L,)."""
    rows = search.rows
    size = left.shape[1] // 2
    white = left[:, :size] + 1j * left[:, size:]
    result = np.zeros((rows.levels.count, ORDERS + 1), complex)
    variance = np.zeros(rows.levels.count)
    for h in range(1, rows.highest + 1):
        unit = np.zeros((rows.levels.count, ORDERS + 1), complex)
        unit[:, h] = 1.0
        column = rows.of_force(participation, unit) / rows.sigma
        weight = (np.abs(column) ** 2).sum(axis=1)
        visible = weight > 0.0
        result[visible, h] = (np.conj(column) * white).sum(axis=1)[visible] / weight[visible]
        variance[visible] += 1.0 / weight[visible]
    return result, np.sqrt(variance)
