"""Where a search may begin when the resonances of a rig lie many of their widths beside those of its model.

A frequency response then tells a fit nothing of where its peaks have gone: moved a little, they overlap as little as
before. Their frequencies tell it. For each effect the strength is sought that brings the model's natural frequencies
nearest to them; from there the peaks overlap.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.signal import find_peaks

from nmt_core.arrays import FloatArray
from nmt_core.errors import BenchError
from nmt_diagnose.observations.conditions import RandomTest
from nmt_diagnose.observations.model_view import ORDER
from nmt_diagnose.observations.observables import Observations, Part
from nmt_rig.rig import Rig
from nmt_rig.rig_model import build_system

_PROMINENCE = float(np.log(3.0))
_SAME_PEAK = 0.01  # relative
_SEEN = 0.5  # of the channels
# What the model's own parameters move a frequency by, relative; misfit of one that counts as lost, in these.
_OWN, _LOST = 0.005, 40.0
# Misfit, squared, from which frequencies are worth a search; share of it that a start must take away.
_FAR, _TAKEN = 25.0, 0.7
_STRENGTHS = np.geomspace(0.02, 8.0, 27)
_MOVED = 1e-4


def measured_resonances(observations: Observations) -> FloatArray:
    """Frequencies at which most responses of random tests or tables of one drive point peak, Hz, ascending."""
    for tests in _by_drive_point(observations):
        peaks: list[float] = []
        channels = 0
        for number, test in tests:
            for k, channel in enumerate(test.channels):
                if channel.quantity not in ORDER:
                    continue
                rows = observations.rows
                mine = (rows.test == number) & (rows.channel == k) & (rows.part == Part.LOG_MAGNITUDE)
                order = np.argsort(rows.frequency_hz[mine])
                found, _ = find_peaks(observations.values[mine][order], prominence=_PROMINENCE)
                peaks += rows.frequency_hz[mine][order][found].tolist()
                channels += 1
        groups = _groups(np.sort(peaks))
        resonances = [float(np.median(group)) for group in groups if group.size >= _SEEN * channels]
        if resonances:
            return np.array(resonances)
    return np.zeros(0)


def _by_drive_point(observations: Observations) -> list[list[tuple[int, RandomTest]]]:
    found: dict[int, list[tuple[int, RandomTest]]] = {}
    for number, test in enumerate(observations.tests):
        if isinstance(test, RandomTest):
            found.setdefault(test.drive_point, []).append((number, test))
    return list(found.values())


def _groups(peaks: FloatArray) -> list[FloatArray]:
    """Ascending frequencies, split where neighbours are not the same."""
    return np.split(peaks, np.flatnonzero(np.diff(peaks) > _SAME_PEAK * peaks[1:]) + 1) if peaks.size else []


def natural_frequencies(rig: Rig, drive_point: int) -> FloatArray:
    """Natural frequencies of a rig at rest without its damping, Hz, any order.

    Raises:
        LinAlgError: its mass matrix is singular.
    """
    if drive_point != rig.drive_point:
        rig = rig.model_copy(update={"exciter": rig.exciter.model_copy(update={"point": drive_point})})
    system = build_system(rig)
    squares = np.linalg.eigvals(np.linalg.solve(system.mass, system.sticking_stiffness())).real
    return np.asarray(np.sqrt(squares[squares > 0.0]) / (2.0 * np.pi))


def resonance_starts(
    observations: Observations,
    rig: Rig,
    candidates: Sequence[tuple[float, bool]],
    changed: Callable[[int, float], Rig],
    most: int,
) -> list[tuple[int, float]]:
    """Candidates and their strengths that bring natural frequencies to where responses peak, best first.

    Args:
        observations: the real side.
        rig: the model.
        candidates: of each the prior standard deviation of its strength, and whether that may be negative.
        changed: the rig with a candidate of some strength; raises BenchError where there is none.
        most: how many.

    Returns:
        Number of the candidate and strength; empty where the model's frequencies are near the measured ones.
    """
    measured = measured_resonances(observations)
    if not measured.size:
        return []
    drive_point = next(test.drive_point for test in observations.tests if isinstance(test, RandomTest))

    def misfit(of: Rig) -> float:
        natural = natural_frequencies(of, drive_point)
        apart = np.min(np.abs(np.log(measured[:, np.newaxis] / natural)), axis=1) / _OWN
        return float(np.sum(np.minimum(apart, _LOST) ** 2))

    before = misfit(rig)
    if before < _FAR:
        return []
    found: list[tuple[float, int, float]] = []
    for number, (spread, signed) in enumerate(candidates):
        signs = (1.0, -1.0) if signed else (1.0,)
        try:
            moves = abs(misfit(changed(number, spread)) - before) > _MOVED * before
        except (ArithmeticError, ValueError, BenchError):
            continue
        if not moves:
            continue
        for sign in signs:
            for strength in sign * spread * _STRENGTHS:
                try:
                    left = misfit(changed(number, strength)) + (strength / spread) ** 2
                except (ArithmeticError, ValueError, BenchError):
                    continue
                found.append((left, number, strength))
    best: dict[int, tuple[float, float]] = {}
    for left, number, strength in sorted(found):
        best.setdefault(number, (left, strength))
    good = [(number, strength) for number, (left, strength) in best.items() if left < (1.0 - _TAKEN) * before]
    return good[:most]
