"""What control of the force's harmonics has done, told from modal points with and without it.

How far frequency and damping moved when control came on is reported at one modal amplitude, since at one voltage the
amplitude moves as well: the backbone with control is read at the amplitude of the window without, linear between its
points in logarithms. That is the error of the method which control has taken away, as far as the levels are dense
enough to tell; what one exciter at one point leaves is not in it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from nmt_core.messages.modal_point import ModalPoint
from nmt_core.vocabulary import PointStatus

HARMONICS_COLUMNS = (
    "harmonics_control",
    "force_harmonics",
    "force_harmonics_without",
    "frequency_moved",
    "damping_moved",
)
"""Columns that ``modal.csv`` has behind the others where harmonics of the force were controlled in any level."""


@dataclass(frozen=True, slots=True)
class HarmonicsIndicators:
    """One level; NaN = not known.

    Attributes:
        harmonics_control: up to which harmonic those of the force were controlled; 0 = none, 1 = as many as could be.
        force_harmonics: √Σ|F_n|²/|F_1| over all extracted harmonics n ≥ 2, 1.
        force_harmonics_without: the same in the window without control of the same level, 1.
        frequency_moved, damping_moved: ω̃ and δ̃ with control over those without it at the same modal amplitude,
            minus one, 1.
    """

    harmonics_control: int
    force_harmonics: float = math.nan
    force_harmonics_without: float = math.nan
    frequency_moved: float = math.nan
    damping_moved: float = math.nan


def any_control(points: Sequence[ModalPoint]) -> bool:
    """Whether harmonics of the force were controlled in any level."""
    return any(point.harmonics_control for point in points)


def force_content(point: ModalPoint) -> float:
    """√Σ|F_n|²/|F_1| over n ≥ 2; NaN where there are no values."""
    size = np.abs(point.force_harmonics)
    if size.size < 2 or not size[1] > 0.0:
        return math.nan
    return float(np.linalg.norm(size[2:]) / size[1])


def comparison_of(points: Sequence[ModalPoint], place: int) -> ModalPoint | None:
    """The point without control right before one with it, at the same level; None = there is none."""
    if place == 0 or not points[place].harmonics_control:
        return None
    before = points[place - 1]
    alike = before.level == points[place].level and before.level_unit == points[place].level_unit
    return before if alike and not before.harmonics_control and before.status is PointStatus.OK else None


def indicators(points: Sequence[ModalPoint]) -> list[HarmonicsIndicators]:
    """Indicators of every level, in the order of the points."""
    return [_of(points, place) for place in range(len(points))]


def _of(points: Sequence[ModalPoint], place: int) -> HarmonicsIndicators:
    point = points[place]
    own = HarmonicsIndicators(point.harmonics_control, force_content(point))
    without = comparison_of(points, place)
    if without is None or point.status is not PointStatus.OK:
        return own
    moved = []
    for name in ("omega_rad_s", "damping_ratio"):
        expected = _with_control(points, name, without.modal_amplitude)
        moved.append(expected / getattr(without, name) - 1.0)
    return HarmonicsIndicators(point.harmonics_control, own.force_harmonics, force_content(without), *moved)


def _with_control(points: Sequence[ModalPoint], name: str, amplitude: float) -> float:
    """A quantity of the backbone with control at a modal amplitude (m√kg), linear between points in logarithms."""
    curve = {
        math.log(point.modal_amplitude): math.log(getattr(point, name))
        for point in points
        if point.harmonics_control and point.status is PointStatus.OK and getattr(point, name) > 0.0
    }
    x = np.array(sorted(curve))
    y = np.array([curve[each] for each in x.tolist()])
    if x.size < 2:
        return math.exp(float(y[0])) if y.size else math.nan
    place = math.log(amplitude)
    left = int(np.clip(np.searchsorted(x, place) - 1, 0, x.size - 2))
    share = (place - x[left]) / (x[left + 1] - x[left])
    return math.exp(float(y[left] + share * (y[left + 1] - y[left])))
