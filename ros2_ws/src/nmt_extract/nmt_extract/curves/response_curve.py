"""Response curves from the points of a test along the phase lag: response, folds, tip, stability.

A curve is what was measured at one held force or response amplitude; its points are ordered by the lag ϑ of the
drive-point displacement behind the force, of which frequency and response are smooth functions also beyond the folds.
Where the lag turns back as well, they stand in the order in which they were measured, and what they are functions of
is their distance along the curve, that of (ϑ, ln x, 10 ln Ω), which then stands for the lag in what follows.

* Response: of P₁ = ½ ω |x| |F₁| cos φ, with the phase φ = ϑ − 90° between force and velocity.
* Folds: where the frequency turns beyond the uncertainties of measured points, which lie clearly below (or above) the
  outermost one on both sides; between them a cubic spline says where. Tip: the same of |x|.
* Stability of the orbit with the force as it is and no control: with δ the decay of the mode, the lag answers to the
  frequency as (s + δ) / (s² + 2 δ s + δ dΩ/dϑ), so that one real exponent passes through zero with dΩ/dϑ, and the orbit
  is stable where the frequency rises with the lag. This holds for held force and simple folds. A point is stable
  where the nearest measured points whose frequencies differ clearly from its own are lower before it and higher behind
  it, unstable the other way round (:mod:`nmt_extract.curves.curve_checks`). Between the points that bracket a fold its
  place tells, beyond two standard uncertainties. All else is left open.
* Floquet exponents, where the drive was perturbed: see :mod:`nmt_extract.modal.floquet_exponents`.

Uncertainties of folds and tip have three parts: that of the values they hang on, a third of the change when every
second point is left out, the even ones or the odd ones (the error of a cubic spline falls to a sixteenth when the
distance of its points is halved, and by less where they do not lie evenly), and what the spline adds to the outermost
point. Where every second point shows no such place, it may lie anywhere between the points that bracket it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from functools import cached_property
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from nmt_core.files.whole_file import csv_text, write_result
from nmt_core.kinds import ResponseCurveTest
from nmt_core.messages.modal_point import ModalPoint
from nmt_core.numerics.arrays import BoolArray, FloatArray, IntArray
from nmt_core.vocabulary import CurveParameter, PointStatus
from nmt_extract.curves import curve_checks
from nmt_extract.curves.curve_checks import TurningPoint

LEAST_POINTS = 5
"""Fewer points of a curve say nothing of its folds."""
RESONANT_LAG = 0.5 * math.pi
MISSED_AMPLITUDE = 0.02
"""Of the amplitude of a level, from which on a point is said to have another one."""
COVERAGE = 2.0
"""Standard uncertainties of a Floquet exponent, or of a fold's place, within which stability is left open."""
_COARSE_SHARE = 1.0 / 3.0
_SAME_SHARE = 0.1  # of the median distance of neighbours, below which two points off the lag are one
CURVE_COLUMNS = (
    "curve", "level", "lag_rad", "lag_rad_std", "frequency_hz", "frequency_hz_std", "response_m", "response_m_std",
    "force_n", "force_n_std", "stable", "growth_per_s", "growth_per_s_std",
)  # fmt: skip
"""Columns of ``response_curve.csv``; ``stable`` is 1, 0, or nan where it is left open; ``growth_per_s`` is nan where
no Floquet exponents were measured."""
PLACE_COLUMNS = (
    "curve", "level", "place", "lag_rad", "lag_rad_std", "frequency_hz", "frequency_hz_std", "response_m",
    "response_m_std", "lag_before_rad", "lag_after_rad",
)  # fmt: skip
"""Columns of ``response_folds.csv``; ``place`` is ``fold`` or ``tip``; the last two are the lags of the measured points
between which it lies."""


class PlaceKind(Enum):
    """What is particular about a place of a curve."""

    FOLD = "fold"
    TIP = "tip"


@dataclass(frozen=True)
class CurvePlace:
    """A fold or the tip of a curve, with standard uncertainties.

    Attributes:
        place: which of them.
        lag, lag_std: ϑ, rad.
        frequency_hz, frequency_hz_std: Hz.
        response, response_std: |x| at the drive point, m.
        position, position_std: where on the curve, see :attr:`ResponseCurve.place`.
        lag_before, lag_after: of the measured points between which it lies, rad.
    """

    place: PlaceKind
    lag: float
    lag_std: float
    frequency_hz: float
    frequency_hz_std: float
    response: float
    response_std: float
    position: float
    position_std: float
    lag_before: float
    lag_after: float


@dataclass(frozen=True, eq=False)
class ResponseCurve:
    """Points at one held amplitude, by ascending lag or in their order along the curve; arrays are ``(points,)``.

    Attributes:
        level: held force (N) or response (m or m/s²).
        level_unit: its unit.
        lag, lag_std: ϑ, rad.
        frequency_hz, frequency_hz_std: Hz.
        response, response_std: |x| at the drive point, m.
        force, force_std: |F₁|, N.
        points: as measured.
        missing: points whose lag was asked for and never measured, in their order.
        cut_off: the point within whose window the test ended; None where it ended between points.
    """

    level: float
    level_unit: str
    lag: FloatArray
    lag_std: FloatArray
    frequency_hz: FloatArray
    frequency_hz_std: FloatArray
    response: FloatArray
    response_std: FloatArray
    force: FloatArray
    force_std: FloatArray
    points: tuple[ModalPoint, ...]
    missing: tuple[ModalPoint, ...] = ()
    cut_off: ModalPoint | None = None

    @property
    def holds_force(self) -> bool:
        """Whether the force was held."""
        return self.level_unit == "N"

    @property
    def turns_back(self) -> bool:
        """Whether the lag does: then it is not what the points are ordered by."""
        return bool(np.any(np.diff(self.lag) <= 0.0))

    @cached_property
    def place(self) -> FloatArray:
        """What the curve is a function of: the lag (rad), or the distance along the curve where that turns back."""
        if not self.turns_back:
            return self.lag
        return _distance(self.lag, self.response, self.frequency_hz)

    @cached_property
    def _place_std(self) -> FloatArray:
        if not self.turns_back:
            return self.lag_std
        relative = self.response_std / self.response, self.frequency_hz_std / self.frequency_hz
        parts = [self.lag_std, relative[0], ResponseCurveTest.FREQUENCY_WEIGHT * relative[1]]
        return np.asarray(np.sqrt(np.sum(np.square(parts), axis=0)))

    @property
    def folds(self) -> tuple[CurvePlace, ...]:
        """Places at which the frequency turns, by ascending lag; none where the response was held."""
        if not self.holds_force:
            return ()
        turns = self._turns(self.frequency_hz, self.frequency_hz_std)
        return self._places(self.frequency_hz, self.frequency_hz_std, PlaceKind.FOLD, turns)

    @property
    def tip(self) -> CurvePlace | None:
        """Largest response of a curve at a held force; None where it lies at an end."""
        if not self.holds_force:
            return None
        turns = [turn for turn in self._turns(self.response, self.response_std) if turn.sign > 0]
        found = self._places(self.response, self.response_std, PlaceKind.TIP, turns)
        return max(found, key=lambda item: item.response, default=None)

    @property
    def stable(self) -> FloatArray:
        """1 where the orbit is stable in open loop at this force, 0 where not, NaN where it is left open."""
        if not self.holds_force or self.lag.size < LEAST_POINTS:
            return np.full(self.lag.size, math.nan)
        found = curve_checks.rises(self.frequency_hz, self.frequency_hz_std)
        turns = self._turns(self.frequency_hz, self.frequency_hz_std)
        for turn, fold in zip(turns, self.folds, strict=True):  # what lies next to a fold that measured points bracket
            inner = np.arange(turn.first + 1, turn.last)
            away = self.place[inner] - fold.position
            clear = np.abs(away) > COVERAGE * np.hypot(fold.position_std, self._place_std[inner])
            found[inner[clear]] = np.where(turn.sign * away[clear] < 0.0, 1.0, 0.0)
        return found

    @property
    def gaps(self) -> BoolArray:
        """Between which neighbours, ``(points − 1,)``, a point was asked for and not held."""
        return curve_checks.gaps(self.lag, np.array([RESONANT_LAG + point.held_phase for point in self.missing]))

    @property
    def growth(self) -> FloatArray:
        """Largest real part of the Floquet exponents in open loop, 1/s; NaN where they were not measured."""
        return np.array([point.floquet_growth for point in self.points])

    @property
    def growth_std(self) -> FloatArray:
        """Standard uncertainties of the growth, 1/s."""
        return np.array([point.floquet_growth_std for point in self.points])

    @property
    def floquet_stable(self) -> FloatArray:
        """1 where the growth is negative, 0 where it is positive, NaN within two standard uncertainties of zero."""
        clear = np.abs(self.growth) > COVERAGE * self.growth_std
        return np.where(clear, (self.growth < 0.0).astype(np.float64), math.nan)

    def _turns(self, values: FloatArray, values_std: FloatArray) -> tuple[TurningPoint, ...]:
        return curve_checks.turns(values, values_std) if self.lag.size >= LEAST_POINTS else ()

    def _places(
        self, values: FloatArray, values_std: FloatArray, place: PlaceKind, turns: Sequence[TurningPoint]
    ) -> tuple[CurvePlace, ...]:
        """Where values turn between measured points, by the spline through them."""
        every = np.arange(self.lag.size)
        halves = [np.union1d(every[start::2], every[[0, -1]]) for start in (0, 1)]
        found = []
        for turn in turns:
            position = self._position(turn, values)
            apart = max(self._apart(turn, position, values, half) for half in halves)
            at = self._at(position, every)
            # A shift of the values by their uncertainty moves the extreme by that of the slope over the curvature.
            bend = abs(float(_spline(self.place, values)(position, 2)))
            weights = _weights(self.place, position, 1)
            moved = float(np.sqrt(((weights * values_std) ** 2).sum())) / bend if bend > 0.0 else 0.0
            near = float(np.interp(position, self.place, self._place_std))
            position_std = math.hypot(moved, apart, near)
            height = float(_spline(self.place, values)(position))
            added = abs(height - float(values[turn.extreme])) / math.sqrt(3.0)
            coarse = max(abs(float(_spline(self.place[half], values[half])(position)) - height) for half in halves)
            # What turns here does not change with the place; the other quantity does.
            other = self.response if place is PlaceKind.FOLD else self.frequency_hz
            moving = float(_spline(self.place, other)(position, 1)) * position_std
            turning = math.hypot(added, _COARSE_SHARE * coarse)
            stds = [
                math.hypot(float(np.interp(position, self.place, std)), turning if std is values_std else moving)
                for std in (self.frequency_hz_std, self.response_std)
            ]
            lag, lag_std = position, position_std
            if self.turns_back:
                lag, slope = (float(_spline(self.place, self.lag)(position, order)) for order in (0, 1))
                lag_std = math.hypot(slope * position_std, float(np.interp(position, self.place, self.lag_std)))
            values_here = (at[0], stds[0], at[1], stds[1])
            between = (float(self.lag[turn.first]), float(self.lag[turn.last]))
            found.append(CurvePlace(place, lag, lag_std, *values_here, position, position_std, *between))
        return tuple(found)

    def _apart(self, turn: TurningPoint, position: float, values: FloatArray, half: IntArray) -> float:
        """Standard uncertainty of the place of an extreme by the spacing: from that of every second point alone.

        Where those show no extreme between the measured points that bracket it, nothing but these bounds it.
        """
        first, last = float(self.place[turn.first]), float(self.place[turn.last])
        near = [other for other in self._extremes(values, half) if first < other < last] if half.size >= 4 else []
        if not near:
            return (last - first) / math.sqrt(12.0)
        return _COARSE_SHARE * min(abs(other - position) for other in near)

    def _position(self, turn: TurningPoint, values: FloatArray) -> float:
        """Where the spline has the outermost value between the measured points of a turn."""
        first, last = float(self.place[turn.first]), float(self.place[turn.last])
        inner = [p for p in self._extremes(values, np.arange(values.size)) if first < p < last]
        spline = _spline(self.place, values)
        return max([float(self.place[turn.extreme]), *inner], key=lambda p: turn.sign * float(spline(p)))

    def _extremes(self, values: FloatArray, chosen: IntArray) -> list[float]:
        """Positions within the curve at which the spline through the chosen points has an extreme."""
        place = self.place[chosen]
        slope = _spline(place, values[chosen]).derivative()
        return [float(root) for root in slope.roots(extrapolate=False) if place[0] < root < place[-1]]

    def _at(self, position: float, chosen: IntArray) -> tuple[float, float]:
        """Frequency and response on splines through the chosen points."""
        place = self.place[chosen]
        at = [float(_spline(place, v[chosen])(position)) for v in (self.frequency_hz, self.response)]
        return at[0], at[1]


def _distance(lag: FloatArray, response: FloatArray, frequency_hz: FloatArray) -> FloatArray:
    """Distance along a curve from its first point, ``(points,)``."""
    columns = (lag, np.log(response), ResponseCurveTest.FREQUENCY_WEIGHT * np.log(frequency_hz))
    steps = np.linalg.norm(np.diff(columns, axis=1), axis=0)
    return np.concatenate([[0.0], np.cumsum(steps)])


def _weights(lag: FloatArray, place: float, order: int) -> FloatArray:
    """What a derivative of the spline at a place changes by with each value, ``(points,)``."""
    return np.asarray(_spline(lag, np.eye(lag.size))(place, order), dtype=np.float64)


def _words_of_floquet(curve: ResponseCurve) -> str:
    """What the exponents say next to the direction of the branch; empty where none were measured."""
    measured = ~np.isnan(curve.floquet_stable)
    both = measured & ~np.isnan(curve.stable)
    apart = both & (curve.floquet_stable != curve.stable)
    if not measured.any():
        return ""
    if not apart.any():
        return f"; Floquet exponents of {int(measured.sum())} points say the same of their stability"
    lags = ", ".join(f"{math.degrees(lag):.1f}°" for lag in curve.lag[apart])
    return (
        f"; Floquet exponents and the direction of the branch disagree on the stability at {lags}: look at the other "
        "modes there, of which the direction says nothing"
    )


def is_of_curve(points: Iterable[ModalPoint]) -> bool:
    """Whether points are those of response curves: they were held away from phase resonance."""
    return any(point.held_phase != 0.0 for point in points)


def response_curves(points: Sequence[ModalPoint]) -> tuple[ResponseCurve, ...]:
    """Curves in the order in which they were measured; a level that is not followed by itself is a curve.

    Args:
        points: of one test. Points without values are left out, and of points at one lag all but the last.
    """
    curves = []
    # Nothing was tried after the last point: where its window was not held to its end, the test ended there.
    last = max(points, key=lambda point: point.level_index, default=None)
    cut_off = last if last is not None and last.status is PointStatus.REJECTED else None
    for _, each in groupby((point for point in points if point is not cut_off), key=lambda point: point.level):
        group = list(each)
        good = {point.held_phase: point for point in group if point.status is PointStatus.OK}
        bad = tuple(point for point in group if point.status is not PointStatus.OK and point.held_phase not in good)
        if good:
            measured = list(good.values())
            if any(point.parameter != CurveParameter.LAG for point in measured):
                curves.append(_in_order(measured, bad))
            else:
                curves.append(_curve(sorted(measured, key=lambda point: point.phase_error), bad))
    if cut_off is not None and curves and curves[-1].level == cut_off.level:
        curves[-1] = replace(curves[-1], cut_off=cut_off)
    return tuple(curves)


def _in_order(points: list[ModalPoint], missing: tuple[ModalPoint, ...]) -> ResponseCurve:
    """A curve of points as they were measured, from its small lags on.

    What was followed back from the other end is turned; of two points at one place the later one is kept.
    """
    ordered = sorted(points, key=lambda point: point.level_index)
    turn = _turn(ordered)
    ordered = [*ordered[:turn], *reversed(ordered[turn:])]
    if ordered[-1].phase_error < ordered[0].phase_error:
        ordered.reverse()
    curve = _curve(ordered, missing)
    steps = np.diff(_distance(curve.lag, curve.response, curve.frequency_hz))
    kept = np.append(steps > _SAME_SHARE * np.median(steps), True)
    return _curve([point for point, keep in zip(ordered, kept, strict=True) if keep], missing)


def _turn(points: list[ModalPoint]) -> int:
    """Index of the first point that was measured from the other end: a lag that is held anew after others were not."""
    off = [place for place, point in enumerate(points) if point.parameter != CurveParameter.LAG]
    later = [place for place in range(off[0], len(points)) if points[place].parameter == CurveParameter.LAG]
    for place in later:
        if any(other > place for other in off):
            return place
    return len(points)


def _curve(points: list[ModalPoint], missing: tuple[ModalPoint, ...]) -> ResponseCurve:
    def of(name: str) -> FloatArray:
        return np.array([float(getattr(point, name)) for point in points])

    force, phase = of("force_n"), of("phase_error")
    response = 2.0 * of("active_power") / (of("omega_rad_s") * force * np.cos(phase))
    relative = np.nan_to_num(of("modal_amplitude_std")) / of("modal_amplitude")
    return ResponseCurve(
        points[0].level,
        points[0].level_unit,
        RESONANT_LAG + phase,
        np.nan_to_num(of("phase_error_std")),
        of("frequency_hz"),
        np.nan_to_num(of("frequency_hz_std")),
        response,
        relative * response,
        force,
        np.nan_to_num(of("force_n_std")),
        tuple(points),
        missing,
    )


def curve_sentences(curves: Sequence[ResponseCurve]) -> list[str]:
    """Folds and tip of each curve, one sentence a curve, and what was not reached."""
    sentences = [_sentence(curve) for curve in curves if curve.holds_force and curve.lag.size >= LEAST_POINTS]
    sentences += [_words_of_missing(curve) for curve in curves if curve.missing]
    for curve in curves:
        if curve.cut_off is not None:
            at, why = math.degrees(RESONANT_LAG + curve.cut_off.held_phase), curve.cut_off.reason.rstrip(".")
            sentences.append(f"At {curve.level:g} {curve.level_unit} the test ended at the point at {at:.1f}°: {why}.")
    return sentences + list(filter(None, map(_words_of_missed, curves)))


def _words_of_missed(curve: ResponseCurve) -> str:
    """Points whose held amplitude is not that of the level; empty where all have it."""
    if curve.level_unit not in ("N", "m"):
        return ""
    away = (curve.force if curve.holds_force else curve.response) / curve.level - 1.0
    missed = np.abs(away) > MISSED_AMPLITUDE
    if not missed.any():
        return ""
    worst = 100.0 * float(away[np.argmax(np.abs(away))])
    return (
        f"At {curve.level:g} {curve.level_unit} {int(missed.sum())} of {away.size} points do not have the amplitude "
        f"that was to be held, by up to {worst:+.1f} %; they lie where they were measured."
    )


def _words_of_missing(curve: ResponseCurve) -> str:
    """Which points were tried and not reached, and why not."""
    lags = sorted({math.degrees(RESONANT_LAG + point.held_phase) for point in curve.missing})
    where = f"{lags[0]:.1f}°" if len(lags) == 1 else f"{len(lags)} lags from {lags[0]:.1f} to {lags[-1]:.1f}°"
    first, more = curve.missing[0].reason.rstrip("."), len(curve.missing)
    tries = f"{more} times: {_words_of_tries(curve)}" if more > 1 else "once"
    return (
        f"At {curve.level:g} {curve.level_unit} the curve has no point at {where}, tried {tries}. "
        f"At the first: {first}."
        + (" What is not held at a force may be held at an amplitude, by --control response." * curve.holds_force)
    )


def _words_of_tries(curve: ResponseCurve) -> str:
    if all(point.parameter == CurveParameter.LAG for point in curve.missing):
        return "by the step, half of it, and from the other end"
    return "with the frequency or a combination of lag and response held, by shorter steps, and from the other end"


def _sentence(curve: ResponseCurve) -> str:
    folds = [
        f"{fold.frequency_hz:.4f} ± {fold.frequency_hz_std:.1g} Hz (between the points at "
        f"{math.degrees(fold.lag_before):.1f}° and {math.degrees(fold.lag_after):.1f}°)"
        for fold in curve.folds
    ]
    unstable = int(np.count_nonzero(curve.stable == 0.0))
    left_open = int(np.count_nonzero(np.isnan(curve.stable)))
    words = f"At {curve.level:g} {curve.level_unit} the curve has {len(curve.points)} points"
    name = "a fold" if len(folds) == 1 else "folds"
    words += f" and {name} at {' and '.join(folds)}" if folds else ", no fold"
    words += f"; {unstable} are unstable" if unstable else ""
    words += f"; the stability of {left_open} is left open" if left_open else ""
    if curve.tip is not None:
        words += f"; its tip is {curve.tip.response:.4g} m at {curve.tip.frequency_hz:.4f} Hz"
    return f"{words}{_words_of_floquet(curve)}."


def write_response_curves(curves: Sequence[ResponseCurve], folder: Path | str) -> None:
    """Write ``response_curve.csv`` and ``response_folds.csv``; SI units.

    Raises:
        BenchError: a file cannot be written; an older file is then left as it was.
    """
    rows: list[Sequence[str]] = [CURVE_COLUMNS]
    places: list[Sequence[str]] = [PLACE_COLUMNS]
    for number, curve in enumerate(curves, start=1):
        head = [str(number), repr(curve.level)]
        columns = (
            curve.lag, curve.lag_std, curve.frequency_hz, curve.frequency_hz_std, curve.response, curve.response_std,
            curve.force, curve.force_std, curve.stable, curve.growth, curve.growth_std,
        )  # fmt: skip
        rows += [[*head, *(repr(float(value)) for value in row)] for row in zip(*columns, strict=True)]
        for item in (*curve.folds, *([curve.tip] if curve.tip else [])):
            values = (
                item.lag, item.lag_std, item.frequency_hz, item.frequency_hz_std, item.response, item.response_std,
                item.lag_before, item.lag_after,
            )  # fmt: skip
            places.append([*head, item.place.value, *(repr(float(value)) for value in values)])
    write_result(Path(folder) / "response_curve.csv", csv_text(rows))
    write_result(Path(folder) / "response_folds.csv", csv_text(places))


def _spline(x: FloatArray, values: FloatArray) -> Any:
    """Cubic spline; SciPy is loaded where a curve is read only."""
    from scipy.interpolate import CubicSpline

    return CubicSpline(x, values)
