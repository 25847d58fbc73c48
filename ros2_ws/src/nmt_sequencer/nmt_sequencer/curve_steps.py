"""Points put along a response curve so that neighbours are equally far apart: the step follows what was measured.

One point of the curve has the frequency Ω, the lag ϑ and the drive-point response x/F per force. The distance of two
points is that of (ln |x/F|, ϑ, w ln Ω), see :class:`nmt_core.kinds.ResponseCurveTest`.

As long as the lag grows along the curve, it is what is held and stepped. The speed of the curve, distance per lag, is
taken from the last points and carried on geometrically; of a linear oscillator at a held force, for which ln |x/F| =
ln sin ϑ + const., it is about 1 / sin ϑ, which serves until there are two points. The lag is single-valued along the
curve of one mode also where the curve turns back over the frequency.

With several modes the lag turns back as well, and a loop that holds it swings with their beat. Along the secant the
next point is foreseen on the parabola over the distance through the last three, and the loop is what corrects it; no
derivative is needed. With the tangent t = (t_ϑ, t_x, t_Ω) in the direction in which the frequency of stable orbits
grows:

* t_Ω > 0: the orbit is stable as a rule, and the frequency is held;
* t_Ω not far below 0, t_ϑ large and t_x small: it runs away slowly, and the lag is held by a slow loop;
* else the combination ϑ + κ ln |x| is held. The lag answers to the frequency at once and the response later, so that
  ω → ϑ + κ ln |x| has the sign of 1 at high frequencies. At rest it has that of (t_ϑ + κ t_x) / t_Ω, and an orbit
  beyond a simple fold has one pole in the right half-plane where t_Ω < 0. Both fit together without a zero in the right
  half-plane where t_ϑ + κ t_x > 0, for which κ takes the sign of t_x.

Two modes may also lose stability without a fold, and curves may turn within a step. Where an orbit is lost, it is begun
anew from rest at the last point, whose frequency is held, with shorter steps; where it was lost by a held frequency,
that is not relied on any more along this curve.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from nmt_core.kinds import ResponseCurveTest
from nmt_core.kinds.response_curve import LEAST_LAG
from nmt_core.messages.records import LoopStatus
from nmt_core.vocabulary import CurveParameter

MOST_PARTS = 256
"""Parts that the lags of a curve are cut into at most, and points that are put into one where the lag is not held."""
_GROWTH = 1.5  # of the step of the lag, from one to the next
_SHORTEST_LAST = 0.5  # of the step: the remainder before an end is not cut
_TURNING_SHARE = 0.7  # share of the way to a parabola's turning point that a step may take
_LARGEST_BEND = 0.3  # rad, by which the curve may turn within a step
_SHORTEST_STEP = 0.25  # of the spacing; also after a loss
_DEVIATION = 0.25  # of a step, which a point may lie off its parabola
_MOST_HALVINGS = 2  # of steps along a curve at a held response
_MOST_RESTARTS = 3  # from one point
_SHORTER = 0.4  # step with each of them
_WEIGHT = 3.2  # rad, |κ|: with less t_ϑ + κ t_x has the wrong sign where the lag falls, with more the response,
# which answers late, steers alone (both are seen in the eigenvalues of two modes 10 % apart, 1 % damped)
_LEAST_SUM = 0.15  # t_ϑ + κ t_x with which the combination tells one point from the next
_CLEAR_FREQUENCY = 0.2  # t_Ω with which a fold over the frequency is far
_STEEP_LAG, _FLAT_RESPONSE, _SLOW_FREQUENCY = 0.6, 0.4, -0.2  # t_ϑ, |t_x|, t_Ω with which the lag is held slowly
_Point = tuple[float, float, float]  # phase, ln |x/F|, w ln Ω


@dataclass(frozen=True, slots=True)
class CurveStep:
    """The point to be put in next.

    Attributes:
        phase: by which the force is to lead the velocity, rad; foreseen where it is not what is held.
        parameter: what is held.
        frequency_hz: foreseen, or held; 0 = not known.
        response: foreseen, unit of the response; 0 = not known.
        weight: κ, rad.
    """

    phase: float
    parameter: CurveParameter = CurveParameter.LAG
    frequency_hz: float = 0.0
    response: float = 0.0
    weight: float = 0.0

    @property
    def level_fields(self) -> dict[str, Any]:
        """Fields of ``nmt_msgs/Level``."""
        return {
            "held_phase": self.phase,
            "frequency_hz": self.frequency_hz,
            "parameter": int(self.parameter),
            "held_response": self.response,
            "phase_per_response": self.weight,
        }


@dataclass(frozen=True, slots=True)
class _Course:
    """The parabola over the distance through the last three points, or the line through two, from the newest on."""

    place: np.ndarray
    tangent: np.ndarray
    bend: np.ndarray

    @classmethod
    def of(cls, track: list[_Point]) -> _Course:
        points = np.array(track[-3:])
        ways = np.diff(points, axis=0)
        lengths = np.linalg.norm(ways, axis=1)
        tangents = ways / lengths[:, np.newaxis]
        if len(ways) == 1:
            return cls(points[-1], tangents[0], np.zeros(3))
        bend = (tangents[1] - tangents[0]) / lengths.mean()
        return cls(points[-1], tangents[1] + 0.5 * lengths[1] * bend, bend)

    def at(self, step: float) -> np.ndarray:
        """The point after a step."""
        return np.asarray(self.place + step * self.tangent + 0.5 * step**2 * self.bend)

    def length_before_turning(self, axis: int, direction: float) -> float:
        """Longest step along which a coordinate grows and turns not too near behind; 0 where it does not grow."""
        slope, bend = direction * float(self.tangent[axis]), direction * float(self.bend[axis])
        if slope <= 0.0:
            return 0.0
        return _TURNING_SHARE * slope / (-2.0 * bend) if bend < 0.0 else math.inf


class CurveSteps:
    """Step control along the curves of one run.

    Args:
        kind: the test, with ends and spacing.
        holds_force: whether the levels are forces; at a held response the frequency is held where the lag is not.

    Attributes:
        spacing: wanted distance of neighbours.
        shortest: step of the lag that is not cut any more, rad.
    """

    def __init__(self, kind: ResponseCurveTest, holds_force: bool = True) -> None:
        self.spacing = kind.spacing
        self.shortest = abs(kind.lag_to - kind.lag_from) / MOST_PARTS
        self._holds_force = holds_force
        self._weight = kind.FREQUENCY_WEIGHT
        self._along_secant = kind.follows_secant
        self._level = math.nan
        self._direction = 0.0  # 1 where the curve is followed to larger lags
        self._track: list[_Point] = []
        self._phases: list[float] = []  # that were asked for at the points of the track
        self._turned = False  # the curve is followed from its other end
        self._goal: _Course | None = None  # of the points before the loss that it is followed back to
        self._lost: set[tuple[float, float]] = set()  # last phase that locked, phase that did not
        self._steps: dict[float, CurveStep] = {}  # that were put in off the lag
        self._count = 0
        self._has_ended = False
        self._left_stable = False  # a held frequency has lost the curve
        self._limit = self.spacing  # of a step off the lag
        self._restarts = 0  # from the last point
        self._sums, self._heard, self._heard_index = np.zeros(4), 0, -1  # over the window of a point

    def hear(self, report: LoopStatus) -> None:
        """Take a report of the present point while it is locked; another level index begins another point."""
        if report.level_index != self._heard_index:
            self._sums, self._heard, self._heard_index = np.zeros(4), 0, report.level_index
        values = (report.force_amplitude, report.response_amplitude, report.frequency_hz, report.phase_error)
        self._sums += np.array(values)
        self._heard += 1

    def add(self, level: float, phase: float, report: LoopStatus) -> None:
        """Take what was measured with a held phase (rad) at a level; another level begins another curve."""
        if level != self._level:
            self._begin(level)
        values = np.array([report.force_amplitude, report.response_amplitude, report.frequency_hz])
        error, found = 0.0, phase
        if phase in self._steps:  # what was not held scatters: the mean of the window
            values, error = (
                (self._sums[:3] / self._heard, self._sums[3] / self._heard) if self._heard else (values, 0.0)
            )
            found = phase - float(error)
        force, response, frequency = values.tolist()
        if min(force, response, frequency) > 0.0:
            kept = [k for k, asked in enumerate(self._phases) if asked != phase][-2:]  # a point may be repeated
            point = (found, math.log(response / force), self._weight * math.log(frequency))
            if self._phases and phase != self._phases[-1]:
                self._restarts = 0
                self._limit = self._next_limit(point, self._steps.get(phase))
            self._track = [*(self._track[k] for k in kept), point]
            self._phases = [*(self._phases[k] for k in kept), phase]

    def _begin(self, level: float) -> None:
        self._level, self._turned, self._direction, self._count, self._has_ended = level, False, 0.0, 0, False
        self._track, self._phases, self._goal = [], [], None
        self._left_stable, self._limit, self._restarts = False, self.spacing, 0
        self._lost.clear()
        self._steps.clear()

    @property
    def is_given_up(self) -> bool:
        """Whether a curve was lost from both ends, and trying what was lost anew from rest is of no use.

        Along the secant its lag leads elsewhere; at a held response there is one answer, which was not held.
        """
        return self._turned and (self._along_secant or not self._holds_force)

    def _next_limit(self, point: _Point, step: CurveStep | None) -> float:
        """Longest step off the lag after a point: it grows, and shrinks where the point lies off its parabola."""
        longest = min(_GROWTH * self._limit, self.spacing)
        if step is None or not self._track:
            return longest
        response = math.log(step.response / self._level) if self._holds_force else point[1]
        away = math.dist(point, (step.phase, response, self._weight * math.log(step.frequency_hz)))
        length = math.dist(point, self._track[-1])
        longest = min(longest, length * _DEVIATION / max(away / length, 1e-9))
        return max(longest, self.spacing * _SHORTEST_STEP**2)

    def before(self, following: float) -> CurveStep | None:
        """The point to be put in before that of the plan, whose phase is ``following`` (rad); None = go to that."""
        if not self._track:
            return None
        last = self._track[-1][0]
        way = following - last
        self._direction = self._direction or math.copysign(1.0, way)
        if self.is_finished:
            return None
        if self._along_secant and len(self._track) > 1:
            step = self._without_lag(_Course.of(self._track), self._direction * way)
            if step is None:
                self._has_ended = True
            else:
                self._count += 1
                self._steps[step.phase] = step
            return step
        speed = self._speed()
        length = self.spacing / speed
        if len(self._track) > 1:
            length = min(length, _GROWTH * abs(last - self._track[-2][0]))
        length = max(length, self.shortest)
        if abs(way) <= length * (1.0 + _SHORTEST_LAST):
            return None
        phase = last + math.copysign(length, way)
        return CurveStep(phase, frequency_hz=self.foreseen(self._level, phase))

    @property
    def is_finished(self) -> bool:
        """Whether the curve has come to its end otherwise than at the last point of the plan, or to what was lost."""
        if self._goal is None or len(self._track) < 2:
            return self._has_ended
        near = math.dist(self._goal.place, self._track[-1]) <= self.spacing * (1.0 + _SHORTEST_LAST)
        towards = float(_Course.of(self._track[-2:]).tangent @ self._goal.tangent)
        return self._has_ended or (near and towards < 0.0)  # two stretches of a curve may lie near each other

    def _without_lag(self, course: _Course, way: float) -> CurveStep | None:
        """The next point, held otherwise than by the lag alone; None at the end of the curve.

        Args:
            course: of the curve.
            way: lag that is left to the end of the curve, in the direction in which it is followed, rad.
        """
        to = self._direction
        slope = to * float(course.tangent[0])
        if self._goal is None and slope > 0.0 and way <= _SHORTEST_LAST * self.spacing * slope:
            return None
        bend = float(np.linalg.norm(course.bend))
        length = max(min(self.spacing, _LARGEST_BEND / max(bend, 1e-12)), _SHORTEST_STEP * self.spacing)
        length = min(length, self._limit)
        t_lag, t_response, t_frequency = (to * (course.tangent + 0.5 * length * course.bend)).tolist()
        until = course.length_before_turning(2, to)
        parameter, weight = CurveParameter.SECANT, math.copysign(_WEIGHT, t_response)
        held = t_lag + _WEIGHT * abs(t_response) > _LEAST_SUM
        clear = until > length or to * float(course.tangent[2]) > _CLEAR_FREQUENCY
        if not self._holds_force or (clear and not (self._left_stable and held)):
            parameter, weight = CurveParameter.FREQUENCY, 0.0
            if self._holds_force:
                length = min(length, max(until, _SHORTEST_STEP * self.spacing))
        elif t_lag > _STEEP_LAG and abs(t_response) < _FLAT_RESPONSE and t_frequency > _SLOW_FREQUENCY:
            weight = 0.0
        phase, motion, frequency = (float(value) for value in course.at(length))
        if self._count >= MOST_PARTS or abs(phase) >= 0.5 * math.pi - LEAST_LAG:
            return None
        response = self._level * math.exp(motion) if self._holds_force else self._level
        return CurveStep(phase, parameter, math.exp(frequency / self._weight), response, weight)

    def begins_at_other_end(self, level: float) -> bool:
        """Whether a curve whose first end did not lock is to be followed from its other end; once a curve."""
        if level == self._level and (self._track or self._turned):
            return False
        self._begin(level)
        self._turned = True
        return True

    def after_loss(self, level: float, lost: float) -> float | None:
        """The phase half-way to one that did not lock, rad; None = go on with the plan."""
        if not self._track or level != self._level or lost in self._steps:
            return None
        last = self._track[-1][0]
        half = last + 0.5 * (lost - last)
        tried = (round(last, 9), round(lost, 9))
        if tried in self._lost or abs(half - last) <= self.shortest:
            return None
        # A held response folds nowhere: the loop swings, and does so from there on.
        if not self._holds_force and len(self._lost) >= _MOST_HALVINGS:
            return None
        self._lost.add(tried)
        return half

    def from_rest(self, level: float, lost: float) -> float | None:
        """The phase (rad) of the last point anew, its frequency held, after a loss off the lag; None = no use."""
        step, last = self._steps.get(lost), self._steps.get(self._phases[-1]) if self._phases else None
        if level != self._level or step is None or self._restarts >= _MOST_RESTARTS:
            return None
        if last is not None and last.parameter is CurveParameter.SECANT and not self._rises():
            return None  # rest does not lead there
        self._left_stable |= step.parameter is CurveParameter.FREQUENCY
        self._restarts += 1
        self._limit = min(self._limit, self.spacing * _SHORTER**self._restarts)
        phase, motion, frequency = self._track[-1]
        response = self._level * (math.exp(motion) if self._holds_force else 1.0)
        # The point is the last of the track again, whatever was asked for when it was first measured.
        self._phases[-1] = phase
        self._steps[phase] = CurveStep(phase, CurveParameter.FREQUENCY, math.exp(frequency / self._weight), response)
        return phase

    def _rises(self) -> bool:
        """Whether the frequency grows along the curve as that of stable orbits does."""
        return len(self._track) > 1 and self._direction * float(_Course.of(self._track[-2:]).tangent[2]) > 0.0

    def turns_back(self, level: float) -> bool:
        """Whether a curve that was lost on its way is to be followed back from its other end; once a curve."""
        if level != self._level or self._turned or not self._track:
            return False
        goal = _Course.of(self._track) if len(self._track) > 1 else None
        self._begin(level)
        self._turned, self._goal = True, goal
        return True

    def level_fields(self, level: float, phase: float) -> dict[str, Any]:
        """Fields of ``nmt_msgs/Level`` of a point at a level with a phase (rad) that was asked for."""
        known = self._steps.get(phase) if level == self._level else None
        return (known or CurveStep(phase, frequency_hz=self.foreseen(level, phase))).level_fields

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
