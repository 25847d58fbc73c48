"""Levels put between those of a plan where the backbone bends: the step follows the measured curvature.

With x = ln(level) and y = ln(frequency) a straight line through the last two levels misses the next one, at a distance
h, by |y[x₁, x₂, x₃]| h (h + h₁), h₁ being the last step and y[…] the second divided difference of the last three. The
step is the one for which this is the tolerance, at most twice the last one and at least a sixteenth of the plan's. The
levels of the plan are all kept, so that runs in both directions have them in common. A level that does not lock is
tried again after one half-way to it, until the step is a sixteenth: so a jump is enclosed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

MOST_PARTS = 16
"""Parts that a step of the plan is cut into at most."""
_GROWTH = 2.0
_SHORTEST_LAST = 0.5  # of the step: the remainder before a level of the plan is not cut


class LevelRefinement:
    """Step control of one run.

    Args:
        tolerance: relative deviation of the frequency from a straight line.
        levels: of the plan.

    Attributes:
        shortest: step of ln(level) that is not cut any more.
    """

    def __init__(self, tolerance: float, levels: Sequence[float]) -> None:
        self.tolerance = tolerance
        steps = [abs(math.log(after / level)) for level, after in pairwise(levels)]
        self.shortest = max(steps, default=0.0) / MOST_PARTS
        self._track: list[tuple[float, float]] = []
        self._lost: set[tuple[float, float]] = set()  # last level that locked, level that did not, of ln

    def add(self, level: float, frequency_hz: float) -> None:
        """Take what was measured at a level."""
        if level > 0.0 and frequency_hz > 0.0:
            self._track = [*self._track[-2:], (math.log(level), math.log(frequency_hz))]

    def before(self, following: float) -> float | None:
        """The level to be put in before the following one of the plan; None = go to that."""
        if len(self._track) < 3 or following <= 0.0:
            return None
        (x1, y1), (x2, y2), (x3, y3) = self._track
        way = math.log(following) - x3
        if x1 == x2 or x2 == x3 or way == 0.0 or (x3 - x2) * way < 0.0 or (x2 - x1) * way < 0.0:
            return None  # the direction has just turned
        bend = abs(((y3 - y2) / (x3 - x2) - (y2 - y1) / (x2 - x1)) / (x3 - x1))
        last = abs(x3 - x2)
        step = _GROWTH * last
        if bend > 0.0:
            step = min(step, 0.5 * (math.sqrt(last**2 + 4.0 * self.tolerance / bend) - last))
        step = max(step, self.shortest)
        if abs(way) <= step * (1.0 + _SHORTEST_LAST):
            return None
        parts = math.ceil(abs(way) / step - 1e-9)
        return math.exp(x3 + way / parts)

    def after_loss(self, lost: float) -> float | None:
        """The level half-way to one that did not lock, to be done before that is tried again; None = go on.

        What was lost from the same last level before is not tried again.
        """
        if not self._track:
            return None
        last, place = self._track[-1][0], math.log(lost)
        tried = (last, round(place, 9))
        half = last + 0.5 * (place - last)
        if tried in self._lost or (last, round(half, 9)) in self._lost or abs(half - last) <= self.shortest:
            return None
        self._lost.add(tried)
        return math.exp(half)
