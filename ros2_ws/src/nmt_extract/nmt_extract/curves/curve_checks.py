"""Plain looks at measured points of response curves: what must hold in them for a statement on a curve to be made.

Each function takes values with their standard uncertainties and nothing that was fitted or interpolated.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from nmt_core.numerics.arrays import BoolArray, FloatArray


def coverage(points: int) -> float:
    """Standard uncertainties beyond which two of so many values differ clearly: 2 √(ln n), as all pairs are compared.

    Of noise alone, 31 values, a turn is seen in 1 of 100.
    """
    return 2.0 * math.sqrt(math.log(max(points, 2)))


@dataclass(frozen=True)
class TurningPoint:
    """A place along a curve at which a quantity turns, between measured points.

    Attributes:
        first, last: indices of the nearest points before and after, whose values lie clearly on one side of `extreme`.
        extreme: index of the outermost point between them.
        sign: 1 = a maximum, −1 = a minimum.
    """

    first: int
    last: int
    extreme: int
    sign: int


def turns(values: FloatArray, values_std: FloatArray) -> tuple[TurningPoint, ...]:
    """Where values along a curve turn beyond their uncertainties: the check of a fold.

    Args:
        values: along the curve, ``(points,)``.
        values_std: standard uncertainties, same shape.

    Returns:
        In the order of the points; none where values are monotone within their uncertainties.
    """
    found = []
    begin = 0
    while (found_one := _next_turn(values, values_std, begin)) is not None:
        found.append(found_one)
        begin = found_one.extreme
    return tuple(found)


def _next_turn(values: FloatArray, values_std: FloatArray, begin: int) -> TurningPoint | None:
    """The first turn after a point that is an extreme itself, or the beginning."""
    low = high = begin
    for last in range(begin + 1, values.size):
        for extreme, sign in ((high, 1), (low, -1)):
            if not _clearly(sign * values, values_std, last, extreme):
                continue
            before = [k for k in range(begin, extreme) if _clearly(sign * values, values_std, k, extreme)]
            if before:
                return TurningPoint(before[-1], last, extreme, sign)
        high = last if values[last] > values[high] else high
        low = last if values[last] < values[low] else low
    return None


def _clearly(values: FloatArray, values_std: FloatArray, below: int, above: int) -> bool:
    """Whether one value lies below another beyond their uncertainties."""
    margin = coverage(values.size) * math.hypot(float(values_std[below]), float(values_std[above]))
    return bool(values[above] - values[below] > margin)


def rises(values: FloatArray, values_std: FloatArray) -> FloatArray:
    """Whether values rise through each point: the check of a stable orbit, and of an unstable one.

    Args:
        values: frequencies along the curve, ``(points,)``.
        values_std: standard uncertainties, same shape.

    Returns:
        1 where the nearest points that differ clearly are lower before and higher after, 0 the other way round, else
        NaN; at both ends of the curve one side tells. A fold that is smaller than the uncertainties is not seen.
    """
    answer = np.full(values.size, math.nan)
    for k in range(values.size):
        sides = {_side(values, values_std, k, step) for step in (-1, 1)} - {None}
        if len(sides) == 1:
            answer[k] = float(sides.pop() is True)
    return answer


def _side(values: FloatArray, values_std: FloatArray, k: int, step: int) -> bool | None:
    """Whether values rise through a point by those before it (step −1) or after it; None = nothing differs clearly."""
    other = k + step
    while 0 <= other < values.size:
        if _clearly(values, values_std, *((k, other) if step > 0 else (other, k))):
            return True
        if _clearly(values, values_std, *((other, k) if step > 0 else (k, other))):
            return False
        other += step
    return None


def overlap(one: FloatArray, other: FloatArray) -> tuple[float, float] | None:
    """What two measured bands of frequency (lowest and highest, Hz) share: the check of a force surface; else None."""
    low, high = max(float(one[0]), float(other[0])), min(float(one[1]), float(other[1]))
    return (low, high) if low < high else None


def reached_minima(forces: FloatArray, forces_std: FloatArray) -> tuple[int, ...]:
    """Held amplitudes that lie on an isola at the force that they need: the check of an isola.

    At the force of such an amplitude no frequency of another amplitude below and of another one above can be reached,
    so that the branch is closed between them.

    Args:
        forces: least force over frequency at each held amplitude, ascending amplitudes, N; NaN where it lies at an end
            of measured ones, or where frequencies of neighbouring amplitudes do not overlap.
        forces_std: standard uncertainties, same shape.

    Returns:
        Indices of the amplitudes; of neighbours in one valley the one with the least force.
    """
    known = np.isfinite(forces)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], known, [False]]).astype(int)))
    found = []
    for first, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        stretch = slice(first, end)
        found += [first + turn.extreme for turn in turns(forces[stretch], forces_std[stretch]) if turn.sign < 0]
    return tuple(found)


def gaps(lag: FloatArray, missing: FloatArray) -> BoolArray:
    """Between which neighbouring points, ``(points − 1,)``, a lag was asked for and not held: no line is drawn there.

    Args:
        lag: of the points, rad.
        missing: lags that were not held, rad, ``(missing,)``.
    """
    low, high = np.minimum(lag[:-1], lag[1:]), np.maximum(lag[:-1], lag[1:])
    return np.asarray(((missing[:, np.newaxis] > low) & (missing[:, np.newaxis] < high)).any(axis=0))
