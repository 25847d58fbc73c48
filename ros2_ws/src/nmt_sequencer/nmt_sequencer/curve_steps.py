"""Points put along a response curve so that neighbours are equally far apart: the step follows what was measured.

At a held lag ϑ one point of the curve is measured: the frequency Ω and the drive-point response x/F per force. The
distance of two points is that of (ln |x/F|, ϑ, w ln Ω), see :class:`nmt_core.kinds.ResponseCurveTest`. The speed of the
curve, distance per lag, is taken from the last points and carried on geometrically; of a linear oscillator at a held
force, for which ln |x/F| = ln sin ϑ + const., it is about 1 / sin ϑ, which serves until there are two points. The lag
is single-valued along the curve of one mode also where the curve turns back over the frequency.
"""

from __future__ import annotations

import math
from itertools import pairwise

from nmt_core.kinds import ResponseCurveTest
from nmt_core.messages.records import LoopStatus

MOST_PARTS = 256
"""Parts that the lags of a curve are cut into at most."""
_GROWTH = 1.5  # of the step of the lag, from one to the next
_SHORTEST_LAST = 0.5  # of the step: what is left before an end is not cut
_Point = tuple[float, float, float]  # lag, ln |x/F|, w ln Ω


class CurveSteps:
    """Step control along the curves of one run.

    Args:
        kind: the test, with ends and spacing.

    Attributes:
        spacing: wanted distance of neighbours.
        shortest: step of the lag that is not cut any more, rad.
    """

    def __init__(self, kind: ResponseCurveTest) -> None:
        self.spacing = kind.spacing
        self.shortest = abs(kind.lag_to - kind.lag_from) / MOST_PARTS
        self._weight = kind.FREQUENCY_WEIGHT
        self._level = math.nan
        self._track: list[_Point] = []
        self._turned = False  # the curve is followed from its other end
        self._lost: set[tuple[float, float]] = set()  # last phase that locked, phase that did not

    def add(self, level: float, phase: float, report: LoopStatus) -> None:
        """Take what was measured with a held phase (rad) at a level; another level begins another curve."""
        if level != self._level:
            self._level, self._track, self._turned = level, [], False
            self._lost.clear()
        force, response, frequency = report.force_amplitude, report.response_amplitude, report.frequency_hz
        if min(force, response, frequency) > 0.0:
            motion = math.log(response / force)
            kept = [point for point in self._track if point[0] != phase]  # a point may be repeated
            self._track = [*kept[-2:], (phase, motion, self._weight * math.log(frequency))]

    def before(self, following: float) -> float | None:
        """The phase (rad) of the point to be put in before that of the plan; None = go to that."""
        if not self._track:
            return None
        last = self._track[-1][0]
        way = following - last
        speed = self._speed()
        step = self.spacing / speed
        if len(self._track) > 1:
            step = min(step, _GROWTH * abs(last - self._track[-2][0]))
        step = max(step, self.shortest)
        if abs(way) <= step * (1.0 + _SHORTEST_LAST):
            return None
        return last + math.copysign(step, way)

    def begins_at_other_end(self, level: float) -> bool:
        """Whether a curve whose first end did not lock is to be followed from its other end; once a curve."""
        if level == self._level and (self._track or self._turned):
            return False
        self._level, self._track, self._turned = level, [], True
        return True

    def after_loss(self, level: float, lost: float) -> float | None:
        """The phase half-way to one that did not lock, rad; None = go on with the plan."""
        if not self._track or level != self._level:
            return None
        last = self._track[-1][0]
        half = last + 0.5 * (lost - last)
        tried = (round(last, 9), round(lost, 9))
        if tried in self._lost or abs(half - last) <= self.shortest:
            return None
        self._lost.add(tried)
        return half

    def foreseen(self, level: float, phase: float) -> float:
        """Frequency that the parabola through the last points has at a phase (rad), Hz; 0 = not known."""
        if level != self._level or len(self._track) < 2:
            return 0.0
        value = 0.0
        for place, one in enumerate(self._track):
            share = one[2]
            for other in (*self._track[:place], *self._track[place + 1 :]):
                share *= (phase - other[0]) / (one[0] - other[0])
            value += share
        return math.exp(value / self._weight)

    def _speed(self) -> float:
        """Distance along the curve per lag, carried on to the middle of the next step."""
        if len(self._track) < 2:
            return 1.0 / max(math.cos(self._track[-1][0]), 0.05)
        speeds = [math.dist(one, other) / abs(other[0] - one[0]) for one, other in pairwise(self._track)]
        if len(speeds) < 2:
            return speeds[-1]
        return speeds[-1] * min(max(speeds[-1] / speeds[-2], 0.5), 2.0)
