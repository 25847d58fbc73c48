"""Jumps of a measured backbone, and where it depends on the direction.

Between two levels the frequency is expected to change as the mean of the slopes before and after says. What it changes
beyond that, J, is a jump where it exceeds what slopes that differ and curve can make of it:

    J = y₂ − y₁ − ½ (s₁ + s₂) Δx,    |J| > |s₂ − s₁| |Δx| + 3 (e₁ + e₂) + 5 σ,

with x = ln(level), y = ln(frequency), e the change of y that the curvature of each side makes over half the step, and σ
the standard uncertainty of y₂ − y₁. Its mean slope is at least twice those next to it. A part of the backbone that is
steeper than the steps resolve looks the same.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from nmt_core.messages.modal_point import ModalPoint
from nmt_core.vocabulary import PointStatus

_LEAST = 3e-4  # relative jump of the frequency that is named
_STEEPER = 2.0  # mean slope of a jump over those next to it, at least
_ALIKE = 1e-6  # relative difference of levels that are the same
_DIFFERENT = 5e-4  # relative difference of frequencies of the two directions that is named


@dataclass(frozen=True)
class BackboneJump:
    """A jump between two neighbouring levels that locked.

    Attributes:
        before, after: the points on both sides.
        size: relative change of the frequency beyond what the slopes say.
        lost: levels between them that did not lock.
    """

    before: ModalPoint
    after: ModalPoint
    size: float
    lost: tuple[float, ...] = ()

    @property
    def sentence(self) -> str:
        """What it is, one sentence."""
        a, b = self.before, self.after
        told = (
            f"The backbone jumps between {a.level:.4g} and {b.level:.4g} {b.level_unit}: from {a.frequency_hz:.6g} to "
            f"{b.frequency_hz:.6g} Hz, {100.0 * self.size:+.2g} % beyond its slopes, and the force from "
            f"{a.force_n:.3g} to {b.force_n:.3g} N"
        )
        lost = ", ".join(f"{level:.4g}" for level in self.lost)
        return f"{told}; no lock at {lost}." if lost else f"{told}."


def backbone_sentences(points: Sequence[ModalPoint]) -> list[str]:
    """What is to be said of a backbone: its jumps, and how far both directions agree.

    Examples:
        >>> backbone_sentences([])
        []
    """
    difference = direction_difference(points)
    told = [] if difference is None else [difference.sentence]
    return [*(jump.sentence for jump in find_jumps(points)), *told]


def find_jumps(points: Sequence[ModalPoint]) -> list[BackboneJump]:
    """Jumps among points in the order of the test.

    Examples:
        >>> find_jumps([])
        []
    """
    return [jump for run in _directed(points) for jump in _jumps_of(run)]


def _directed(points: Sequence[ModalPoint]) -> list[list[ModalPoint]]:
    """Points cut where the levels turn; the turning one belongs to both. A repeated level counts once, last."""
    runs: list[list[ModalPoint]] = []
    for point in sorted(points, key=lambda item: item.level_index):
        if not point.level > 0.0 or point.force_order or point.held_phase:
            continue
        run = runs[-1] if runs else []
        if not runs:
            runs.append([point])
            continue
        last = run[-1]
        if last.status is not PointStatus.OK and math.isclose(last.level, point.level, rel_tol=_ALIKE):
            run[-1] = point
            continue
        good = [item for item in run if item.status is PointStatus.OK]
        turns = len(good) > 1 and (good[-1].level - good[-2].level) * (point.level - good[-1].level) < 0.0
        if turns and point.status is PointStatus.OK:
            runs.append([good[-1], point])
        else:
            run.append(point)
    return runs


def _jumps_of(run: list[ModalPoint]) -> list[BackboneJump]:
    good = [point for point in run if point.status is PointStatus.OK and point.frequency_hz > 0.0]
    if len(good) < 4:
        return []
    x = [math.log(point.level) for point in good]
    y = [math.log(point.frequency_hz) for point in good]
    slopes = [(b - a) / (v - u) if v != u else 0.0 for (u, v), (a, b) in zip(pairwise(x), pairwise(y), strict=True)]
    found = []
    for k in range(1, len(good) - 2):
        width = x[k + 1] - x[k]
        left, right = slopes[k - 1], slopes[k + 1]
        size = y[k + 1] - y[k] - 0.5 * (left + right) * width
        limit = abs(right - left) * abs(width)
        if k >= 2:
            limit += 3.0 * _curved(slopes[k - 2], left, x[k - 2], x[k - 1], x[k], width)
        if k + 3 < len(good):
            limit += 3.0 * _curved(slopes[k + 2], right, x[k + 3], x[k + 2], x[k + 1], width)
        stds = [point.frequency_hz_std / point.frequency_hz for point in good[k : k + 2]]
        limit += 5.0 * math.hypot(*(std if math.isfinite(std) else 0.0 for std in stds))
        steeper = abs(slopes[k]) > _STEEPER * max(abs(left), abs(right))
        if steeper and abs(size) > max(limit, _LEAST):
            between = (
                point.level
                for point in run[run.index(good[k]) + 1 : run.index(good[k + 1])]
                if point.status is not PointStatus.OK
            )
            found.append(BackboneJump(good[k], good[k + 1], size, tuple(dict.fromkeys(between))))
    return found


def _curved(far: float, near: float, x0: float, x1: float, x2: float, width: float) -> float:
    """Change of y that the curvature of three points makes over half a step beyond the last of them."""
    if x2 == x0:
        return 0.0
    half = 0.5 * abs(width)
    return abs((near - far) / (x2 - x0)) * half * (half + abs(x2 - x1))


@dataclass(frozen=True)
class DirectionDifference:
    """What levels measured in both directions say.

    Attributes:
        levels: number of them.
        largest: largest relative difference of the frequency among those that agree.
        different: level, frequency up and down (Hz) of those that do not.
        unit: of the levels.
    """

    levels: int
    largest: float
    different: tuple[tuple[float, float, float], ...]
    unit: str

    @property
    def sentence(self) -> str:
        """What it is, one sentence."""
        alike = self.levels - len(self.different)
        told = f"Up and down agree within {100.0 * self.largest:.2g} % in frequency at {alike} of {self.levels} levels"
        if not self.different:
            return f"{told}."
        low, high = self.different[0][0], self.different[-1][0]
        most = max(abs(down / up - 1.0) for _, up, down in self.different)
        return f"{told}; from {low:.4g} to {high:.4g} {self.unit} they differ by up to {100.0 * most:.2g} %: a fold."


def direction_difference(points: Sequence[ModalPoint]) -> DirectionDifference | None:
    """Compare levels that were measured upwards and downwards; None if there are none.

    Examples:
        >>> direction_difference([]) is None
        True
    """
    runs = _directed(points)
    ways: dict[bool, dict[float, ModalPoint]] = {True: {}, False: {}}
    for run in runs:
        good = [point for point in run if point.status is PointStatus.OK]
        if len(good) > 1:
            rises = good[-1].level > good[0].level
            ways[rises].update({float(f"{point.level:.6g}"): point for point in good})
    turning = {id(run[0]) for run in runs[1:]}
    common = [
        level
        for level in sorted(ways[True].keys() & ways[False].keys())
        if id(ways[True][level]) not in turning or id(ways[False][level]) not in turning
    ]
    if not common:
        return None
    pairs = [(level, ways[True][level].frequency_hz, ways[False][level].frequency_hz) for level in common]
    different = tuple(pair for pair in pairs if abs(pair[2] / pair[1] - 1.0) > _DIFFERENT)
    agreed = [abs(down / up - 1.0) for level, up, down in pairs if (level, up, down) not in different]
    return DirectionDifference(len(pairs), max(agreed, default=0.0), different, ways[True][common[0]].level_unit)
