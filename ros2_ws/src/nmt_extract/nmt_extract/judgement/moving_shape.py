"""Shapes that move with the level by modes near the frequency, and what tells them from a gain."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from nmt_core.messages.linear_description import LinearDescription
from nmt_core.numerics.arrays import ComplexArray

_LEAST = 0.02  # of the largest value: smaller deviations do not matter
_CLOSE = 0.1  # distance of modes near the frequency, of it
_FASTER, _ADDED = 5.0, 0.01  # how much faster over ln q than before a near mode may come in; of the target's share
_MIXED = 3.0  # share of a near mode over the shift of the frequency next to its distance
_APART, _KEPT = 0.2, 0.2  # ln q between levels that tell; change of a share that stays, of it


class ShapeCourse(NamedTuple):
    """Where a level lies on the way of a shape.

    Attributes:
        place: ln of the modal amplitude (m√kg).
        shares: participation of the near modes next to the target's, shape ``(modes,)``.
        shift: of the frequency from the target's linear one, of the distance to the nearest near mode.
    """

    place: float
    shares: ComplexArray
    shift: float


class Doubt(NamedTuple):
    """A channel that may be off, or the shape moves: measured over expected, at which level, and whether it stays."""

    ratio: complex
    course: ShapeCourse
    stays: bool = False


def near_modes(linear: LinearDescription, omega: float) -> list[int]:
    """Linear modes besides the target near a frequency (rad/s)."""
    return [
        mode
        for mode, frequency in enumerate(linear.frequencies_rad_s)
        if mode != linear.target_mode and abs(frequency - omega) < _CLOSE * omega
    ]


def mode_words(linear: LinearDescription, mode: int) -> str:
    """For people: number from 1 and frequency."""
    return f"mode {mode + 1} at {linear.frequencies_rad_s[mode] / (2.0 * math.pi):.5g} Hz"


def course_of(shape: ComplexArray, near: Sequence[int], linear: LinearDescription, omega: float) -> ShapeCourse:
    """Course of a shape (displacements in m, shape ``(points,)``) at a frequency (rad/s)."""
    coordinates = np.linalg.pinv(linear.shape_matrix) @ shape
    target, at_rest = coordinates[linear.target_mode], linear.frequencies_rad_s[linear.target_mode]
    gap = min((abs(linear.frequencies_rad_s[mode] - at_rest) for mode in near), default=math.inf)
    shares = coordinates[list(near)] / target if target != 0.0 else np.full(len(near), complex(math.nan))
    place = math.log(max(float(np.linalg.norm(coordinates)), 1e-300))
    return ShapeCourse(place, np.asarray(shares), abs(omega - at_rest) / max(gap, 1e-300))


def moves_on(before: Sequence[ShapeCourse], here: ShapeCourse) -> bool:
    """Whether near modes come in as a nonlinear force lets them, and no gain does.

    As they did over the levels before; where there are fewer than two of these, in proportion to the frequency: a force
    that shifts it by a share of the distance between two modes mixes them by about that share.

    Args:
        before: levels before, any order; those at whose frequency other modes are near do not count.
        here: this level.
    """
    if not here.shares.size:
        return False
    before = [course for course in before if course.shares.size == here.shares.size]
    if len({course.place for course in before}) < 2:
        return bool(np.abs(here.shares).max() < _MIXED * here.shift + _ADDED)
    one, two = sorted(before, key=lambda course: abs(course.place - here.place))[:2]
    rate = float(np.abs(one.shares - two.shares).max()) / max(abs(one.place - two.place), 1e-9)
    return bool(np.abs(here.shares - one.shares).max() < _FASTER * rate * abs(here.place - one.place) + _ADDED)


def stays(then: ShapeCourse, now: ShapeCourse) -> bool:
    """Whether near modes keep their share while the amplitude changes: what a gain makes of a shape."""
    if now.shares.size != then.shares.size or not now.shares.size:
        return False
    change = float(np.abs(now.shares - then.shares).max())
    return abs(now.place - then.place) > _APART and change < _KEPT * float(np.abs(then.shares).max())


def shape_trend(shapes: Sequence[ComplexArray]) -> ComplexArray | None:
    """By what a shape moved over the last two levels; None where it hardly did.

    Args:
        shapes: of the levels, of unit size and phase, each of shape ``(points,)``.
    """
    if len(shapes) < 2:
        return None
    change = np.asarray(shapes[-1] - shapes[-2])
    return change if float(np.linalg.norm(change)) > _LEAST else None
