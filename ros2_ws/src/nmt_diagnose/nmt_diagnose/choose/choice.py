"""Which of many columns a fit needs: sets of causes, compared by rows that their fit has not seen.

All sets carry the same nuisances. The criterion of a set, smaller being better, is::

    n ln v + n s² / v + Σ pull² + ln n per coefficient + 2 ln(M / α) per cause,  v = max(s², floor²)

s² is the mean square of rows in groups that were left out of the fit, n the number of independent rows, M the number of
columns asked. The last three terms are the prior: how far nuisances moved, the Schwarz penalty, and the odds α that
any of the M columns is a cause. Where a cause is a part of the target, s² is taken per variance of the target that is
kept, for scaling it to zero explains all.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from nmt_core.numerics.arrays import FloatArray
from nmt_diagnose.choose.space import Columns, Space

ALPHA = 0.01
"""Prior odds that any column at all is a cause."""
_KEPT = 3
"""Sets that are grown on: with one alone a first step that is wrong stays."""
_JUDGED = 8
"""Columns a set is grown by in full, of those that take most at first order."""
_PATIENCE = 1
"""Causes more that bring nothing before the search ends."""
_STEPS = 8
_SETTLED = 0.01
_RIDGE = 1e-9
_LEAST_KEPT = 1e-3
_ALIKE = 0.01
"""Of the criterion, which rounding errors of equal columns differ by less than."""


@dataclass(frozen=True, eq=False)
class Judged:
    """A set of columns, by number, with its criterion.

    Attributes:
        numbers: in the library, ascending.
        score: the criterion; infinite where a coefficient is not what its name says.
        variance: of a row, the floor included.
    """

    numbers: tuple[int, ...]
    score: float
    variance: float


@dataclass(frozen=True, eq=False)
class Chosen:
    """The best set and those it was compared with.

    Attributes:
        causes: of the best set; that first without which the others explain least.
        score: its criterion.
        judged: all sets that were compared, best first.
        instead: keys of causes in whose place the first does no better by more than what was asked.
        library: that was asked.
    """

    causes: tuple[Columns, ...]
    score: float
    judged: tuple[Judged, ...]
    instead: tuple[tuple[str, str], ...]
    library: tuple[Columns, ...]

    def probability(self, key: tuple[str, str]) -> float:
        """Posterior probability that a cause with a key is there, over all sets that were compared."""
        weights = np.exp(-0.5 * (np.array([item.score for item in self.judged]) - self.judged[0].score))
        holds = [any(self.library[number].key == key for number in item.numbers) for item in self.judged]
        return float(np.sum(weights[holds]) / np.sum(weights))


class Choice:
    """Choice among columns about one fit.

    Args:
        space: the fit.
    """

    def __init__(self, space: Space) -> None:
        self._space = space

    def gain(self, columns: Sequence[Columns]) -> FloatArray:
        """By how much each of C columns alone lowers the weighted squares and pulls, C."""
        sets = _Sets(self._space, columns)
        empty = sets.judged(())
        return sets.gains(empty)

    def grow(self, library: Sequence[Columns], most: int, alike: float = 0.0) -> Chosen:
        """The best set of at most so many columns.

        Args:
            library: columns that are asked.
            most: number of causes.
            alike: difference of the criterion up to which another cause does as well in the place of the first.
        """
        sets = _Sets(self._space, library)
        best = sets.judged(())
        kept, waited = [best], 0
        for size in range(1, most + 1):
            grown = [item for start in kept for item in sets.grown(start)]
            improved = [sets.improved(item) for item in _lowest(grown, _KEPT)]
            kept = _lowest((item for item in [*grown, *improved] if len(item.numbers) == size), _KEPT)
            found = min([best, *improved], key=_order)
            # Two causes may be needed together before either pays for itself.
            waited = 0 if found is not best else waited + 1
            best = found
            if waited > _PATIENCE:
                break
        order = sets.by_need(best)
        instead = sets.in_place_of(best, order[0], alike) if order and alike > 0.0 else ()
        return Chosen(
            tuple(library[number] for number in order), best.score, tuple(sets.every()), instead, tuple(library)
        )


def _lowest(sets: Iterable[Judged], most: int) -> list[Judged]:
    """Those of least criterion that are possible, each once."""
    each = {item.numbers: item for item in sets if np.isfinite(item.score)}
    return sorted(each.values(), key=_order)[:most]


def _order(item: Judged) -> tuple[int, tuple[int, ...]]:
    """By criterion; sets that no fit parts, such as of equal columns, as the library lists them."""
    return round(item.score / _ALIKE), item.numbers


def _squares(gram: FloatArray, values: FloatArray) -> FloatArray:
    """Sum of squares that coefficients leave over of rows with these products, …."""
    made = np.einsum("...ij,...j->...i", gram[..., :-1, :-1], values)
    return np.asarray(gram[..., -1, -1] + np.sum(values * (made - 2.0 * gram[..., :-1, -1]), axis=-1))


class _Sets:
    """Sets of columns of one library. All products of columns are made once, by groups of rows."""

    def __init__(self, space: Space, library: Sequence[Columns]) -> None:
        self._space, self._library = space, library
        self._rows = len(space.left)
        self._fixed = space.nuisances.shape[1]
        widths = [item.values.shape[1] for item in library]
        starts = self._fixed + np.cumsum([0, *widths])
        self._spans = [np.arange(start, start + width) for start, width in zip(starts, widths, strict=False)]
        target = np.zeros(self._rows) if space.target is None else space.target - np.mean(space.target)
        every = np.column_stack(
            [space.nuisances, *(item.values for item in library), space.left, target, np.ones(self._rows)]
        )
        self._count = int(starts[-1])
        # Each column of a cause has unit rms, so that no unit decides what is singular.
        self._scale = np.ones(every.shape[1])
        size = np.sqrt(np.mean(np.square(every[:, self._fixed : self._count]), axis=0))
        self._scale[self._fixed : self._count] = np.maximum(size, 1e-300)
        every = every / self._scale
        order = np.argsort(space.groups, kind="stable")
        _, firsts = np.unique(space.groups[order], return_index=True)
        parts = np.split(every[order], firsts[1:])
        self._grams = np.stack([part.T @ part for part in parts])
        self._gram = np.sum(self._grams, axis=0)
        self._least = max(space.floor**2, 1e-12 * float(self._gram[self._count, self._count]) / self._rows, 1e-300)
        self._price = 2.0 * np.log(max(len(library), 1) / ALPHA)
        self._memory: dict[tuple[int, ...], Judged] = {}
        self._ranked: dict[tuple[int, ...], list[int]] = {}

    def every(self) -> list[Judged]:
        """All sets that were judged and are possible, best first."""
        return _lowest(self._memory.values(), len(self._memory))

    def judged(self, numbers: tuple[int, ...], variance: float = np.inf) -> Judged:
        """A set with its criterion; the variance of a row at which its search starts is that of a smaller set."""
        if numbers not in self._memory:
            self._memory[numbers] = self._judged(numbers, variance)
        return self._memory[numbers]

    def _judged(self, numbers: tuple[int, ...], variance: float) -> Judged:
        place = self._place(numbers)
        inner = np.append(place, self._count)
        grams = self._grams[:, inner[:, None], inner]
        gram = self._gram[np.ix_(inner, inner)]
        if not np.isfinite(variance):
            variance = max(float(gram[-1, -1]) / self._rows, self._least)
        values = np.zeros(len(place))
        for _ in range(_STEPS):
            values = self._solved(gram, variance)
            left = max(float(_squares(gram, values)) / self._rows, self._least)
            settled = abs(np.log(left / variance)) < _SETTLED
            variance = left
            if settled:
                break
        if not self._allowed(numbers, values):
            return Judged(numbers, np.inf, variance)
        unseen = self._solved(gram - grams, variance)
        squares = float(np.sum(np.maximum(_squares(grams, unseen), 0.0))) / self._rows
        squares /= self._target_kept(numbers, values)
        noise = max(squares, self._least)
        independent = self._space.independent
        pulls = float(np.sum(values[: self._fixed] ** 2))
        price = len(numbers) * self._price + (len(place) - self._fixed) * np.log(independent)
        score = independent * (np.log(noise) + squares / noise) + pulls + price
        return Judged(numbers, float(score), variance)

    def _place(self, numbers: tuple[int, ...]) -> FloatArray:
        """Columns of a set, the nuisances first."""
        return np.concatenate([np.arange(self._fixed), *(self._spans[number] for number in numbers)])

    def _solved(self, gram: FloatArray, variance: float) -> FloatArray:
        """Coefficients, … × K, by products of their columns and of the rows, … × K + 1 × K + 1."""
        weight = self._space.independent / self._rows / variance
        matrix, moment = weight * gram[..., :-1, :-1], weight * gram[..., :-1, -1:]
        inner = np.arange(matrix.shape[-1])
        matrix[..., inner, inner] *= 1.0 + _RIDGE
        matrix[..., inner, inner] += np.where(inner < self._fixed, 1.0, 1e-200)
        return np.asarray(np.linalg.solve(matrix, moment)[..., 0])

    def _allowed(self, numbers: tuple[int, ...], values: FloatArray) -> bool:
        place = self._fixed
        for number in numbers:
            span = self._spans[number]
            if not self._library[number].allows(values[place : place + len(span)] / self._scale[span]):
                return False
            place += len(span)
        return True

    def _target_kept(self, numbers: tuple[int, ...], values: FloatArray) -> float:
        """Variance of the target without what a set takes of it, as a share."""
        place, parts, found = self._fixed, [], []
        for number in numbers:
            span = self._spans[number]
            if self._library[number].of_target:
                parts.append(span)
                found.append(values[place : place + len(span)])
            place += len(span)
        if not parts:
            return 1.0
        target, one = self._count + 1, self._count + 2
        at, size = np.concatenate([*parts, [target]]), np.concatenate([*found, [-1.0]])
        mean = float(self._gram[one, at] @ size) / self._rows
        square = float(size @ self._gram[np.ix_(at, at)] @ size) / self._rows
        variance = float(self._gram[target, target]) / self._rows
        return max((square - mean**2) / max(variance, 1e-300), _LEAST_KEPT)

    def gains(self, start: Judged) -> FloatArray:
        """By how much each column of the library lowers weighted squares and pulls on top of a set, at first order."""
        place, weight = self._place(start.numbers), self._space.independent / self._rows / start.variance
        matrix = weight * self._gram[np.ix_(place, place)]
        matrix[np.diag_indices(len(place))] *= 1.0 + _RIDGE
        matrix[np.diag_indices(len(place))] += np.where(place < self._fixed, 1.0, 1e-200)
        # The set is taken out of all columns and of the rows at once.
        others = np.arange(self._fixed, self._count + 1)
        cross = weight * self._gram[np.ix_(place, others)]
        taken = np.linalg.solve(matrix, cross)
        moment = weight * self._gram[others[:-1], self._count] - cross[:, :-1].T @ taken[:, -1]
        found = np.zeros(len(self._library))
        for width in {len(span) for span in self._spans}:
            numbers = [number for number, span in enumerate(self._spans) if len(span) == width]
            spans = np.stack([self._spans[number] for number in numbers])
            near = spans - self._fixed
            inner = weight * self._gram[spans[:, :, None], spans[:, None, :]]
            inner -= np.einsum("kci,kcj->cij", cross[:, near], taken[:, near])
            inner[:, range(width), range(width)] += _RIDGE * weight * self._rows
            found[numbers] = np.sum(moment[near] * np.linalg.solve(inner, moment[near][..., None])[..., 0], axis=1)
        return found

    def _promising(self, start: Judged, most: int) -> list[int]:
        """Columns that take most on top of a set; no key of the set, and each key twice at most."""
        if start.numbers not in self._ranked:
            taken = {self._library[number].key for number in start.numbers}
            counts: dict[tuple[str, str], int] = {}
            found = []
            for number in np.argsort(-self.gains(start), kind="stable").tolist():
                key = self._library[number].key
                counts[key] = counts.get(key, 0) + 1
                if key not in taken and counts[key] <= 2:
                    found.append(number)
            self._ranked[start.numbers] = found
        return self._ranked[start.numbers][:most]

    def _with(self, start: Judged, number: int) -> Judged:
        return self.judged(tuple(sorted((*start.numbers, number))), start.variance)

    def grown(self, start: Judged) -> list[Judged]:
        """A set with one column more."""
        return [self._with(start, number) for number in self._promising(start, _JUDGED)]

    def improved(self, start: Judged) -> Judged:
        """The set after all exchanges and omissions that lower its criterion."""
        best = start
        while True:
            found = [best]
            for number in best.numbers:
                fewer = self.judged(tuple(item for item in best.numbers if item != number), best.variance)
                found += [fewer, *(self._with(fewer, other) for other in self._promising(fewer, _JUDGED // 2))]
            possible = _lowest(found, 1)
            if not possible or possible[0] is best:
                return best
            best = possible[0]

    def by_need(self, best: Judged) -> list[int]:
        """Columns of a set, that first without which the others explain least."""
        without = {
            number: self.judged(tuple(item for item in best.numbers if item != number), best.variance).score
            for number in best.numbers
        }
        return sorted(best.numbers, key=lambda number: -without[number])

    def in_place_of(self, best: Judged, first: int, alike: float) -> tuple[tuple[str, str], ...]:
        """Keys of causes that do about as well in the place of the first."""
        fewer = self.judged(tuple(item for item in best.numbers if item != first), best.variance)
        found = [
            self._library[number].key
            for number in self._promising(fewer, 2 * _JUDGED)
            if self._library[number].key != self._library[first].key
            and self._with(fewer, number).score < best.score + alike
        ]
        return tuple(dict.fromkeys(found))
