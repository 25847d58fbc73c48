"""Strengths of one effect with their standard deviations, from weak to strong.

Model parameters and the measuring chain imitate some effects nearly: an error of the clock is a shift of all natural
frequencies. What is left is found by shifting the model until it says what the effect does. Where a resonance moves by
more than its width, a search from the plain model ends anywhere. So the curve is climbed: it begins where everything
is linear, and each strength starts from the shifts of the weaker ones, continued to it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from nmt_blind.cases.injected_effects import InjectedEffect, Spot
from nmt_blind.cases.laboratory import TrialError
from nmt_blind.cases.strength import Observed, Sensitivity, Shifted
from nmt_core.numerics.arrays import FloatArray

WEAK, MIDDLE, STRONGEST = 8.0, 64.0, 4096.0
"""Standard deviations from which to which a curve goes, and those of a strength that a search may start from."""
SEARCHED = 256.0
"""Standard deviations up to which the best shifts are searched; those of stronger effects are an upper bound."""
COMPARED = 16.0
"""Strength at which signatures are compared, standard deviations."""
# Size of a difference, over the noise, up to which everything is linear; what is near enough to it.
_LINEAR = 60.0
_NEAR = (0.2, 2.0)
_LOOKS = 10
_FARTHEST = 100.0
# From one strength to the next: where parameters imitate the effect, at first, and at most. Each step that was not too
# long is followed by one that is longer by a factor.
_SHORT, _LONG, _GROWTH = 2.0, 8.0, 1.5
# The same where nothing is searched any more.
_BEYOND = 4.0
_IMITATED = 5.0
_AGREES = 0.1
_MOST_RUNGS = 40
# What is left grows faster than this times the strength: shifts were continued too far. Least ratio of two strengths.
_JUMP = 3.0
_SHORTEST = 1.1
# Continued shifts that leave at most this times what is left in proportion are good ones.
_EXPECTED = 1.1
# The weakest strength ends at so many times WEAK.
_WEAK_ENOUGH = 1.5
# Where tests fail, the last strength that does not is found to this factor.
_CLOSE = 1.3
# ln of how far from COMPARED a signature may have been taken that does not grow in proportion.
_ALIKE = math.log(3.0)


@dataclass(frozen=True, eq=False)
class Rung:
    """One strength of an effect.

    Attributes:
        value: the strength, in the unit of the effect.
        observed: tests with it.
        best: the model that imitates them best.
        imitated: whether parameters or the measuring chain take a good part of it.
    """

    value: float
    observed: Observed
    best: Shifted
    imitated: bool

    @property
    def sigma(self) -> float:
        """Standard deviations that are left."""
        return self.best.left


def curve(
    sensitivity: Sensitivity, effect: InjectedEffect, spot: Spot, former: dict[str, Any] | None = None
) -> tuple[dict[str, Any], FloatArray | None]:
    """Strengths of an effect at a spot with their standard deviations, ascending; up to 4,096 where it gets there.

    Args:
        sensitivity: of the rig.
        effect: the injected effect.
        spot: where.
        former: an older curve; the search starts from its strength of 64 standard deviations.

    Returns:
        ``points``: strength and standard deviations; ``trouble``: why it does not get stronger, empty if it does;
        ``compared``: strength and shifts at which its signature was taken. And that signature, for what it has in
        common with others; None where no strength was near `COMPARED`.

    Raises:
        TrialError: the model cannot be tested with the shifts at which the signature is taken.
    """

    def play(value: float) -> Observed:
        return sensitivity.played(effect.edits(sensitivity.model, sensitivity.operating, spot, value))

    guess = value_at(former, MIDDLE) if former else None
    if guess is None:
        guess = sensitivity.rig.caution * effect.guess(sensitivity.model, sensitivity.operating, spot)
    largest = effect.limit(sensitivity.model, sensitivity.operating, spot)
    rungs, trouble = climbed(sensitivity, play, min(guess, largest), largest)
    points = [[float(f"{rung.value:.6g}"), float(f"{rung.sigma:.5g}")] for rung in rungs if rung.sigma > 0.0]
    found: dict[str, Any] = {"points": points, "proportional": effect.proportional, "trouble": trouble}
    near = min(rungs, key=lambda rung: abs(math.log(max(rung.sigma, 1e-300) / COMPARED)), default=None)
    if near is None or abs(math.log(max(near.sigma, 1e-300) / COMPARED)) >= (
        math.inf if effect.proportional else _ALIKE
    ):
        return found, None
    shifts = [float(f"{shift:.5g}") for shift in near.best.made]
    found["compared"] = {"value": near.value, "shifts": shifts}
    return found, sensitivity.signature(near.observed, np.array(shifts))


def climbed(
    sensitivity: Sensitivity, play: Callable[[float], Observed], guess: float, largest: float
) -> tuple[list[Rung], str]:
    """Strengths from weak to strong, and why it ends below the strongest; empty if it does not.

    Args:
        sensitivity: of the rig.
        play: the tests with an effect of some strength; raises TrialError where they cannot be made.
        guess: a strength to begin with.
        largest: the largest strength.
    """
    trouble = ""
    try:
        first = _weak(sensitivity, play, guess, largest)
    except TrialError as error:
        return [], str(error)
    rungs = [first]
    value, failed, ratio = first.value, math.inf, _SHORT
    for _ in range(_MOST_RUNGS):
        last = rungs[-1]
        if last.sigma >= STRONGEST:
            return rungs, ""
        if last.value >= largest:
            return rungs, trouble or "as strong as it can be"
        if failed < _CLOSE * last.value:
            return rungs, trouble
        searched = last.sigma < SEARCHED
        factor = (ratio if last.imitated else _LONG) if searched else _BEYOND
        value = min(last.value * factor, largest, math.sqrt(failed * last.value))
        try:
            rung = _rung(sensitivity, play(value), value, rungs)
            while (
                searched
                and rung.imitated
                and value > _SHORTEST * last.value
                and rung.sigma > _JUMP * value / last.value * last.sigma
            ):
                value = math.sqrt(value * last.value)
                rung = _rung(sensitivity, play(value), value, rungs)
            rungs.append(rung)
            ratio = min(_GROWTH * value / last.value, _LONG)
        except TrialError as error:
            trouble, failed = str(error), value
    return rungs, trouble or f"{_MOST_RUNGS} strengths tried"


def _weak(sensitivity: Sensitivity, play: Callable[[float], Observed], guess: float, largest: float) -> Rung:
    """A strength at which everything is linear, of some eight standard deviations or less.

    Raises:
        TrialError: tests cannot be made at any strength that was tried.
    """
    value, observed = guess, None
    low, high = (share * _LINEAR for share in _NEAR)
    for _ in range(_LOOKS):
        try:
            observed = play(value)
            size = sensitivity.linear(observed)[0]
        except TrialError:
            observed = None
            value *= 0.1
            continue
        if low <= size <= high or (size < low and value >= largest):
            break
        observed = None
        value = min(value * min(max(_LINEAR / max(size, 1e-300), 1.0 / _FARTHEST), _FARTHEST), largest)
    observed = play(value) if observed is None else observed
    # Where everything is linear one step to the best shifts tells how much too strong it is: no search is needed yet.
    for _ in range(_LOOKS):
        left = sensitivity.linear(observed)[1]
        if left <= _WEAK_ENOUGH * WEAK:
            break
        value *= max(WEAK / left, 1.0 / _FARTHEST)
        observed = play(value)
    rung = _rung(sensitivity, observed, value, [])
    for _ in range(_LOOKS):
        if rung.sigma <= _WEAK_ENOUGH * WEAK:
            break
        value *= max(WEAK / rung.sigma, 1.0 / _FARTHEST)
        rung = _rung(sensitivity, play(value), value, [])
    return rung


def _rung(sensitivity: Sensitivity, observed: Observed, value: float, rungs: list[Rung]) -> Rung:
    """The model that imitates tests best, from the shifts of weaker effects on.

    Raises:
        TrialError: too few levels locked.
    """
    best = sensitivity.shifted(observed)
    size, linear, _ = sensitivity.linear(observed)
    for made in _continued(rungs, value):
        try:
            start = sensitivity.shifted(observed, made, rungs[-1].best.changes)
        except TrialError:
            continue
        if start.left < best.left:
            best = start
        if best.left <= _EXPECTED * value / rungs[-1].value * rungs[-1].sigma:
            break
    # What every test shows many times over is told apart however strong it is: there a bound will do.
    if not rungs or rungs[-1].sigma < SEARCHED:
        best = sensitivity.settled(observed, best)
    distinct = size < _IMITATED * best.left and abs(linear - best.left) < _AGREES * best.left
    return Rung(value, observed, best, not distinct)


def _continued(rungs: list[Rung], value: float) -> list[FloatArray]:
    """Shifts for a strength: by the parabola through zero and the last two, and in proportion to the last."""
    if not rungs:
        return []
    last = rungs[-1]
    found = [last.best.made * (value / last.value)]
    if len(rungs) > 1:
        before = rungs[-2]
        slope, other = last.best.made / last.value, before.best.made / before.value
        bend = (slope - other) / (last.value - before.value)
        found.insert(0, value * (slope + bend * (value - last.value)))
    return found


def spot_key(effect: InjectedEffect, spot: Spot) -> str:
    """Key of a curve in a table."""
    return f"{effect.name}@{spot.label}" if spot.label else effect.name


def value_at(curve: dict[str, Any], target: float) -> float | None:
    """Strength for a number of standard deviations, by interpolation of a curve on logarithmic scales.

    Beyond the weakest point, and a single one, in proportion; None where the curve does not get there.
    """
    points = [(float(v), float(s)) for v, s in curve["points"]]
    rising: list[tuple[float, float]] = []
    for value, found in points:
        if not rising or found > rising[-1][1]:
            rising.append((value, found))
    if not rising:
        return None
    if target > 1.1 * rising[-1][1]:
        # An effect that grows in proportion may have been left somewhat below the target.
        near = curve.get("proportional") and target < 3.0 * rising[-1][1]
        return rising[-1][0] * target / rising[-1][1] if near else None
    if target <= rising[0][1]:
        return rising[0][0] * target / rising[0][1]
    values, founds = np.log(np.array(rising)).T
    if target >= rising[-1][1]:
        return rising[-1][0]
    return float(np.exp(np.interp(math.log(target), founds, values)))
