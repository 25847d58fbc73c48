"""Samples with stamps on an even grid: stretches, missing samples, stamps that scatter."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.messages.stamped_samples import interpolated
from nmt_core.numerics.arrays import FloatArray, IntArray

FEWEST = 16
"""Samples of a stretch that is a recording."""
_EVEN = 2e-3  # of a step: scatter of stamps that is not worth a word
_SMOOTHER = 0.8  # roughness by which one reading of the stamps is better than the other
_PAUSE = 0.5  # s: without samples for so long, and for 16 steps, recording paused
_GAP = 1.5  # steps
_BESIDE = 9  # samples on each side of a gap, by which it is judged
_BURSTS = 0.5  # of a step: stamps that scatter so come in bursts
_JITTER = 0.03  # of a step: scatter that may hide a loss
_STRONG_JITTER = 0.15  # of a step
_COUNTS = 12  # times that samples are counted again at most
_OTHER_RATE = 0.02  # relative
_LONGEST = 16  # samples of the grid for each that there is


@dataclass(frozen=True, eq=False)
class EvenGrid:
    """Samples at equal steps.

    Attributes:
        start: time of the first, s.
        step: s.
        std: relative standard uncertainty of the step.
        columns: NaN where samples are missing.
        notes: what was done.
        stretches: first sample and sample after the last one of each stretch.
        time: true time of each sample that there is, s.
        rows: its position on the grid.
        sources: its position in what the grid was made of.
    """

    start: float
    step: float
    std: float
    columns: tuple[FloatArray, ...]
    notes: list[str]
    stretches: tuple[tuple[int, int], ...]
    time: FloatArray
    rows: IntArray
    sources: IntArray


@dataclass(eq=False)
class _Stretch:
    """One stretch: slice of the samples, their numbers from its first one on, and a line through their times."""

    part: slice
    index: IntArray
    start: float
    step: float
    scatter: float
    bursts: bool


def even_grid(
    time: FloatArray,
    columns: Sequence[FloatArray],
    name: str,
    clock: str,
    breaks: Sequence[int] = (),
    stretch: int | None = None,
    as_stamped: bool = True,
) -> EvenGrid:
    """Put samples with stamps on an even grid.

    Stamps scatter because samples were taken at uneven times, or because they were stamped late. Which it is, the
    signals tell: read the right way they are smoother.

    Args:
        time: stamp of each sample, s, ascending.
        columns: each of that length.
        name, clock: for the notes.
        breaks: samples at which a new stretch begins because the clock was set anew.
        stretch: number from 1 of the only one that is wanted; None = all.
        as_stamped: whether samples may be moved to where their stamps have them.

    Raises:
        BenchError: more than a third of the samples is missing, stretches have different rates, or there is not such a
            stretch.
    """
    if not (np.diff(time) > 0.0).any():
        raise BenchError(f"The {clock} of {name} stand still; a recording needs a clock.")
    notes: list[str] = []
    stretches = _stretches(time, breaks, name, clock, notes)
    if stretch is not None:
        if not 1 <= stretch <= len(stretches):
            raise BenchError(f"{name} has {len(stretches)} stretches; there is no stretch {stretch}.")
        stretches = [stretches[stretch - 1]]
    step, std = _common_step(stretches, time, name, clock)
    first = stretches[0]
    places = [round((one.start - first.start) / step) for one in stretches]
    for number in range(1, len(places)):  # one sample at least is missing between two
        places[number] = max(places[number], places[number - 1] + int(stretches[number - 1].index[-1]) + 2)
    length = places[-1] + int(stretches[-1].index[-1]) + 1
    count = sum(one.index.size for one in stretches)
    if length > _LONGEST * count + 10_000:
        raise BenchError(
            f"{name} has {len(stretches)} stretches with long pauses ({length * step:.6g} s for {count * step:.6g} s "
            f"of samples); say which it is: 'stretch: 1' to 'stretch: {len(stretches)}'."
        )
    rows = np.concatenate([place + one.index for place, one in zip(places, stretches, strict=True)])
    sources = np.concatenate([np.arange(one.part.start, one.part.stop) for one in stretches])
    placed = [_placed(values[sources], rows, length) if length > count else values[sources] for values in columns]
    _note_missing(stretches, time, name, clock, notes)
    scatter = math.sqrt(sum(one.scatter**2 * one.index.size for one in stretches) / count)
    true: FloatArray = np.asarray(first.start + step * rows, dtype=np.float64)
    if scatter > _EVEN * step:
        ahead = (
            f"The {clock} of {name} scatter by {1e3 * scatter:.3g} ms about an even clock ({100 * scatter / step:.2g} "
        )
        ahead += "% of a step)"
        moved = _moved(time, columns, stretches, step, places, length) if as_stamped else []
        ratios = [_roughness(new) / _roughness(old) for new, old in zip(moved, placed, strict=False) if _roughness(old)]
        if ratios and float(np.median(ratios)) < _SMOOTHER:
            placed, true = moved, time[sources]
            notes.append(f"{ahead}; the signals are smoother by their stamps and were interpolated at even times.")
        else:
            notes.append(f"{ahead}; the signals are smoother at even times, so the stamps give the rate only.")
    if scatter > _EVEN * step:
        notes.append(f"The rate of {name} is known to {100 * std:.2g} %.")
    ends = tuple((place, place + int(one.index[-1]) + 1) for place, one in zip(places, stretches, strict=True))
    return EvenGrid(float(first.start), step, std, tuple(placed), notes, ends, true, rows, sources)


def sampled_at(grid: EvenGrid, values: FloatArray, places: FloatArray) -> FloatArray:
    """A column of a grid at other times (s); NaN beyond its ends and where samples are missing."""
    there = values[grid.rows]
    good = np.isfinite(there)
    time, rows = grid.time[good], grid.rows[good]
    if time.size < 4 or (np.diff(time) <= 0.0).any():
        return np.full(places.size, np.nan)
    result = interpolated(time, there[good], places, math.inf)
    right = np.clip(np.searchsorted(time, places), 1, time.size - 1)
    off_grid = np.minimum(np.abs(places - time[right - 1]), np.abs(time[right] - places)) > 1e-3 * grid.step
    hole = off_grid & (rows[right] - rows[right - 1] > 1)
    outside = (places < time[0] - 0.5 * grid.step) | (places > time[-1] + 0.5 * grid.step)
    return np.where(hole | outside, np.nan, result)


def _stretches(time: FloatArray, breaks: Sequence[int], name: str, clock: str, notes: list[str]) -> list[_Stretch]:
    """Stretches that are long enough, each with the numbers of its samples."""
    typical = usual_step(time)
    steps = np.diff(time)
    pauses = np.flatnonzero(steps > max(_PAUSE, FEWEST * typical)) + 1
    # What was only delayed comes at once, as soon as it comes.
    behind = np.minimum(pauses + 2 * FEWEST, time.size - 1)
    made_up = time[behind] - time[pauses] < (behind - pauses) * typical - 0.5 * steps[pauses - 1]
    pauses = pauses[~made_up]
    edges = [0, *sorted({*breaks, *pauses.tolist()}), time.size]
    parts: list[slice] = []
    for first, stop in itertools.pairwise(edges):
        parts += [slice(first, stop)] if stop - first < 2 * FEWEST else _by_rate(time, first, stop)
    short = [part for part in parts if part.stop - part.start < FEWEST]
    kept = [part for part in parts if part not in short]
    if not kept:
        kept, short = [slice(0, time.size)], []
    if len(kept) > 1 or short:
        listed = ", ".join(
            f"{time[part.start] - time[0]:.6g} to {time[part.stop - 1] - time[0]:.6g} s" for part in kept[:8]
        )
        lost = sum(part.stop - part.start for part in short)
        brief = f"; {lost} messages in shorter ones were left out" if short else ""
        notes.append(
            f"{name} has {len(kept)} stretch{'es' if len(kept) > 1 else ''} by its {clock} ({listed}"
            f"{', …' if len(kept) > 8 else ''}){brief}."
        )
    return [_numbered(time, part, name, clock) for part in kept]


def _by_rate(time: FloatArray, first: int, stop: int) -> list[slice]:
    """One stretch, or two where the rate changes in between for good."""
    part = time[first:stop]
    away = part - np.linspace(part[0], part[-1], part.size)
    knee = int(np.argmax(np.abs(away)))
    if min(knee, part.size - knee) < 2 * FEWEST:
        return [slice(first, stop)]
    rates = [usual_step(piece) for piece in (part[:knee], part[knee:])]
    if abs(rates[0] / rates[1] - 1.0) < 5.0 * _OTHER_RATE:
        return [slice(first, stop)]
    means = [float(piece[-1] - piece[0]) / (piece.size - 1) for piece in (part[:knee], part[knee:])]
    if abs(means[0] / means[1] - 1.0) < 5.0 * _OTHER_RATE:
        return [slice(first, stop)]
    return [*_by_rate(time, first, first + knee), *_by_rate(time, first + knee, stop)]


def usual_step(time: FloatArray | IntArray) -> float:
    """Usual step of ascending times, in their unit: the middle one, or, where they come in bursts, that over many."""
    steps = np.diff(time)
    lag = min(32, max(1, time.size // 4))
    median, lagged = float(np.median(steps)), float(np.median(time[lag:] - time[:-lag])) / lag
    return median if lagged <= 0.0 or abs(median - lagged) < 0.4 * lagged else lagged


def _numbered(time: FloatArray, part: slice, name: str, clock: str) -> _Stretch:
    """Numbers of the samples of a stretch, with gaps where some are missing.

    A step that is too long by scatter is made up for by the next ones; behind a missing sample all are later.
    """
    t = time[part]
    step = usual_step(t)
    steps = np.diff(t)
    spread = 1.4826 * float(np.median(np.abs(steps - step))) / math.sqrt(2.0)
    bursts = spread > _BURSTS * step
    limit = step + 8.0 * spread if bursts else _GAP * step
    candidates = np.flatnonzero(steps > limit)
    start, scatter = 0.0, 0.0
    for _ in range(2):  # again with the step that the first count gives
        residual = t - step * np.arange(t.size)
        missing = np.zeros(t.size, dtype=np.int64)
        ends = np.append(candidates, t.size - 1)[1:]
        for gap, end in zip(candidates.tolist(), ends.tolist(), strict=True):
            before = residual[max(0, gap + 1 - _BESIDE) : gap + 1]
            after = residual[gap + 1 : min(gap + 1 + _BESIDE, end + 1)]
            missing[gap + 1] = max(0, round(float(np.median(after) - np.median(before)) / step))
            if missing[gap + 1]:
                residual[gap + 1 :] -= missing[gap + 1] * step
        index = np.arange(t.size) + np.cumsum(missing)
        start, step, scatter = _line(index, t)
        if bursts and missing.any():  # a delay is made up for, a loss is not: then the count is much straighter
            plain = _line(np.arange(t.size), t)
            if scatter > 0.5 * plain[2]:
                index, (start, step, scatter) = np.arange(t.size), plain
    if not bursts and spread > _JITTER * step:
        index = _recounted(t, missing, _BESIDE if spread < _STRONG_JITTER * step else 3 * _BESIDE)
        start, step, scatter = _line(index, t)
    length = int(index[-1]) + 1
    if length > 1.5 * t.size:
        raise BenchError(
            f"Of {name} {length - t.size} of {length} samples are missing by its {clock}; record it again, or resample "
            "it to one rate."
        )
    return _Stretch(part, index.astype(np.int64), start, step, scatter, bursts)


def _recounted(t: FloatArray, missing: IntArray, width: int) -> IntArray:
    """Numbers of samples whose stamps scatter: a loss that scatter hides shows in all stamps behind it.

    Args:
        t: stamps.
        missing: samples that a first count found missing before each.
        width: stamps on each side of a place, by whose middle ones it is judged.
    """
    missing = missing.copy()
    places = np.arange(t.size)
    steps = np.diff(t)
    index = places + np.cumsum(missing)
    if t.size < 4 * width:
        return index
    for _ in range(_COUNTS):
        start, step, _scatter = _line(index, t)
        middle = np.median(np.lib.stride_tricks.sliding_window_view(t - start - step * index, width), axis=1)
        behind = middle[width:] - middle[:-width]  # of the step from place + width - 1 to the next
        wrong = np.flatnonzero(np.abs(behind) > 0.5 * step)
        if not wrong.size:
            break
        for run in np.split(wrong, np.flatnonzero(np.diff(wrong) > 1) + 1):
            extra = round(float(behind[run[np.argmax(np.abs(behind[run]))]]) / step)
            gaps = run + width - 1
            left = steps[gaps] - step * missing[gaps + 1]
            at = int(gaps[np.argmax(left) if extra > 0 else np.argmin(left)]) + 1
            missing[at] = max(0, missing[at] + extra)
        index = places + np.cumsum(missing)
    return index


def _common_step(stretches: Sequence[_Stretch], time: FloatArray, name: str, clock: str) -> tuple[float, float]:
    """Step of all stretches, s, and its relative standard uncertainty.

    Raises:
        BenchError: they have different ones.
    """
    step, std = common_slope([(one.index, time[one.part]) for one in stretches])
    other = max(stretches, key=lambda one: abs(one.step / step - 1.0))
    unsure = math.sqrt(12.0 / other.index.size) * other.scatter / (other.step * other.index.size)
    if len(stretches) > 1 and abs(other.step / step - 1.0) > max(_OTHER_RATE, 5.0 * unsure):
        rates = ", ".join(f"{1.0 / one.step:.6g}" for one in stretches[:8])
        raise BenchError(
            f"The stretches of {name} have different rates by its {clock} ({rates} Hz); say which one it is: "
            f"'stretch: 1' to 'stretch: {len(stretches)}'."
        )
    return step, std / step


def common_slope(parts: Sequence[tuple[FloatArray | IntArray, FloatArray]]) -> tuple[float, float]:
    """Slope that lines through the points of each part share, NaN without one, and its standard uncertainty by their
    scatter, that which varies slowly too."""
    centred = [(x - x.mean(), y - y.mean()) for x, y in parts]
    top, bottom = (sum(float(x @ values) for x, values in pairs) for pairs in (centred, [(x, x) for x, _ in centred]))
    if not bottom > 0.0 or not top > 0.0:
        return math.nan, math.inf
    slope = top / bottom
    scatter, count, slow = 0.0, 0, 0.0
    for x, y in centred:
        residual = y - slope * x
        scatter, count = scatter + float(residual @ residual), count + x.size
        means = [float(piece.mean()) for piece in np.array_split(residual, min(8, max(1, x.size // 2)))]
        slow = max(slow, float(np.std(means)) * math.sqrt(x.size / len(means)))
    return slope, max(math.sqrt(scatter / max(count - 2, 1)), slow) / math.sqrt(bottom)


def _note_missing(stretches: Sequence[_Stretch], time: FloatArray, name: str, clock: str, notes: list[str]) -> None:
    lost = sum(int(one.index[-1]) + 1 - one.index.size for one in stretches)
    if not lost:
        return
    gaps = [one.part.start + int(gap) for one in stretches for gap in np.flatnonzero(np.diff(one.index) > 1)]
    notes.append(
        f"{lost} samples of {name} are missing at {len(gaps)} places by its {clock} (first after "
        f"{float(time[gaps[0]] - time[stretches[0].part.start]):.6g} s); they are marked as missing."
    )


def _moved(
    time: FloatArray, columns: Sequence[FloatArray], stretches: Sequence[_Stretch], step: float, places: Sequence[int],
    length: int,
) -> list[FloatArray]:  # fmt: skip
    """Columns interpolated at even times, by stretch; NaN where samples are missing."""
    if any((np.diff(time[one.part]) <= 0.0).any() for one in stretches):
        return []  # samples are not taken at one time
    result = []
    for values in columns:
        column = np.full(length, np.nan)
        for place, one in zip(places, stretches, strict=True):
            t, there = time[one.part], values[one.part]
            at: FloatArray = t.mean() + step * (one.index - one.index.mean())
            known = there[np.isfinite(there)]
            if known.size and np.ptp(known) > 0.0:  # what does not move stays as it is, to the bit
                there = np.where(np.isnan(there), np.nan, interpolated(t, there, at, math.inf))
            column[place + one.index] = there
        result.append(column)
    return result


def _line(index: IntArray | FloatArray, time: FloatArray) -> tuple[float, float, float]:
    """Start, step and rms scatter of times about a straight line over their numbers."""
    centred = index - index.mean()
    step = float((centred * (time - time.mean())).sum() / (centred * centred).sum())
    start = float(time.mean() - step * index.mean())
    return start, step, float(np.sqrt(np.mean((time - start - step * index) ** 2)))


def _placed(values: FloatArray, index: IntArray, length: int) -> FloatArray:
    result = np.full(length, np.nan)
    result[index] = values
    return result


def _roughness(values: FloatArray) -> float:
    """rms of the fourth differences."""
    differences = np.diff(values, 4)
    known = differences[np.isfinite(differences)]
    return float(np.sqrt(np.mean(known**2))) if known.size else 0.0
