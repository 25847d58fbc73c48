"""Which of many columns a fit needs: sets of causes, compared by rows that their fit has not seen.

All sets carry the same nuisances. The criterion of a set, smaller being better, is::

    n ln v + n s² / v + Σ pull² + ln n per coefficient + 2 ln(M / α) per cause,  v = max(s², floor²)

s² is the mean square of rows in groups that were left out of the fit, n the number of independent rows, M the number of
columns asked. The last three terms are the prior: how far nuisances moved, the Schwarz penalty for coefficients that
are not zero and for fitted numbers inside columns, and the odds α that any of the M columns is a cause. Where a cause
is a part of the target, s² is taken per variance of the target that is kept, for scaling it to zero explains all.

The floor decides how many causes and coefficients there are. Where it bounds smooth errors instead of noise, s² / v is
1. Sets of equal size are compared by the rows: there v is s². Numbers inside columns move by the squares of all rows.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.linalg.lapack import dtrtrs
from scipy.optimize import minimize_scalar

from nmt_core.numerics.arrays import BoolArray, FloatArray, IntArray
from nmt_diagnose.choose.bounded import constrained
from nmt_diagnose.choose.space import Columns, Space

ALPHA = 0.01
"""Prior odds that any column at all is a cause."""
_KEPT = 3
"""Sets that are grown on: with one alone a first step that is wrong stays."""
_JUDGED = 8
"""Columns a set is grown by in full, of those that take most at first order."""
_PATIENCE = 1
"""Causes more that bring nothing before the search ends."""
_HOPE = 0.5
"""Of its price that a cause has to pay at first order, its numbers as they are asked, before sets are grown by one."""
_STEPS = 8
_SETTLED = 0.01
_RIDGE = 1e-9
_LEAST_KEPT = 1e-3
_COARSE, _FINE = 2.5e-3, 2.5e-4
"""Share of their range to which numbers in columns are found, while sets grow and at last."""
_ALIKE = 0.01
"""Of the criterion, which rounding errors of equal columns differ by less than."""
_RECOUNTED = 0.05
"""Change of the number of independent rows from which on sets are judged anew."""


@dataclass(frozen=True, eq=False)
class Judged:
    """A set of columns, by number, with its criterion.

    Attributes:
        numbers: of the columns, ascending.
        score: the criterion; infinite where a coefficient is not what its name says.
        size: numbers of causes and of coefficients that are not zero.
        unfloored: the criterion without a floor, for sets of one size.
        variance: of a row, the floor included.
        values: of nuisances and coefficients.
    """

    numbers: tuple[int, ...]
    score: float
    size: tuple[int, int]
    unfloored: float
    variance: float
    values: FloatArray = field(repr=False)


@dataclass(frozen=True, eq=False)
class Chosen:
    """The best set and those it was compared with.

    Attributes:
        causes: of the best set; that first without which the others explain least.
        best: that set.
        judged: all sets that were compared, best first.
        instead: keys of causes in whose place the first does no better by more than what was asked.
        columns: by number; the library, and what was made of it.
        independent: number of independent rows.
    """

    causes: tuple[Columns, ...]
    best: Judged
    judged: tuple[Judged, ...]
    instead: tuple[tuple[str, str], ...]
    columns: tuple[Columns, ...]
    independent: float

    @property
    def score(self) -> float:
        """Criterion of the best set."""
        return self.best.score

    def probability(self, key: tuple[str, str]) -> float:
        """Posterior probability that a cause with a key is there, over all sets that were compared."""
        scores = np.array([item.score for item in self.judged])
        weights = np.exp(-0.5 * (scores - np.min(scores)))
        holds = [any(self.columns[number].key == key for number in item.numbers) for item in self.judged]
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
        return sets.gains(sets.judged(()), sets.stacked(range(len(columns))))[0]

    def fitted(self, causes: Sequence[Sequence[Columns]]) -> Chosen:
        """A set of causes, each in the best of its variants, with the numbers in their columns moved to where the fit
        is best."""
        sets = _Sets(self._space, [column for variants in causes for column in variants])
        starts = np.cumsum([0, *map(len, causes)]).tolist()
        best = sets.judged(tuple(starts[:-1]))
        for begin, end in pairwise(starts):
            others = [number for number in best.numbers if not begin <= number < end]
            every = (sets.judged(tuple(sorted([*others, number])), best.variance) for number in range(begin, end))
            best = min(every, key=lambda item: item.unfloored)
        for number in best.numbers:
            best = sets.moved(best, number, _FINE)
        return sets.chosen(best, best.numbers)

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
            if best.numbers and not sets.may_grow(best, kept):
                break
            grown = [item for start in kept for item in sets.grown(start)]
            if sets.recount(_best([best, *grown])):
                best, *grown = (sets.judged(item.numbers, item.variance) for item in [best, *grown])
            improved = [sets.improved(item) for item in sets.lowest(grown)]
            kept = sets.lowest(item for item in [*grown, *improved] if len(item.numbers) == size)
            found = _best([best, *improved])
            # Two causes may be needed together before either pays for itself.
            waited = 0 if found is not best else waited + 1
            best = found
            if waited > _PATIENCE:
                break
        for number in best.numbers:
            best = sets.moved(best, number, _FINE)
        order = sets.by_need(best)
        instead = sets.in_place_of(best, order[0], alike) if order and alike > 0.0 else ()
        return sets.chosen(best, order, instead)


def _order(item: Judged) -> tuple[float, tuple[int, ...]]:
    """By criterion; sets that no fit parts, such as of equal columns, as the library lists them."""
    return _rounded(item.score), item.numbers


def _rounded(score: float) -> float:
    return round(score / _ALIKE) if np.isfinite(score) else np.inf


def _best(sets: Iterable[Judged]) -> Judged:
    """The best of the best sets of each size; the first of equal ones."""
    each: dict[tuple[int, int], Judged] = {}
    for item in sets:
        each[item.size] = min(each.get(item.size, item), item, key=lambda one: _rounded(one.unfloored))
    return min(each.values(), key=_order)


def _squares(gram: FloatArray, values: FloatArray) -> FloatArray:
    """Sum of squares that coefficients leave over of rows with these products, …."""
    made = np.einsum("...ij,...j->...i", gram[..., :-1, :-1], values)
    return np.asarray(gram[..., -1, -1] + np.sum(values * (made - 2.0 * gram[..., :-1, -1]), axis=-1))


@dataclass(frozen=True, eq=False)
class _Stack:
    """Columns of causes side by side.

    Attributes:
        count: of causes.
        values: rows × columns.
        across: their products with nuisances and rows.
        parts: of each width the numbers of its causes, their columns, products of these, and which are not negative.
    """

    count: int
    values: FloatArray
    across: FloatArray
    parts: Sequence[tuple[IntArray, IntArray, FloatArray, BoolArray]]


class _Sets:
    """Sets of columns. Products of columns are made once, by groups of rows, when a set needs them."""

    def __init__(self, space: Space, library: Sequence[Columns]) -> None:
        self._space, self._asked, self.columns = space, range(len(library)), list(library)
        self._numbers = {item.same: number for number, item in enumerate(library)}
        self._rows, self._fixed = len(space.left), space.nuisances.shape[1]
        names, group, counts = np.unique(space.groups, return_inverse=True, return_counts=True)
        # Rows of a group lie side by side, filled up with zeros, so that all groups are multiplied at once.
        self._groups, self._longest = len(names), int(counts.max())
        place = np.empty(self._rows, np.int64)
        place[np.argsort(group, kind="stable")] = np.concatenate([np.arange(count) for count in counts])
        self._slots = group * self._longest + place
        self._unseen = np.flatnonzero(~np.isin(names, list(space.ends)))
        self._unseen_rows = int(counts[self._unseen].sum())
        self._base = self._placed(np.column_stack([space.nuisances, space.left]))
        self._made: dict[int, tuple[FloatArray, FloatArray]] = {}
        self._products: dict[tuple[int, int], FloatArray] = {(-1, -1): self._times(self._base, self._base)}
        self._followed: dict[int, list[int]] = {}
        square = float(space.left @ space.left)
        self._least = max(space.floor**2, 1e-12 * square / self._rows, 1e-300)
        self._price = 2.0 * np.log(max(len(library), 1) / ALPHA)
        self._independent = space.independent_by(space.left)
        self._memory: dict[tuple[int, ...], Judged] = {}
        self._ranked: dict[tuple[int, ...], list[int]] = {}
        self._settled: dict[tuple[tuple[int, ...], int, float], Judged] = {}

    def _placed(self, values: FloatArray) -> FloatArray:
        """Rows at their places among those of their groups."""
        result = np.zeros((self._groups * self._longest, values.shape[1]))
        result[self._slots] = values
        return result

    def _times(self, one: FloatArray, other: FloatArray) -> FloatArray:
        """Products of columns by groups."""
        parts = one.reshape(self._groups, self._longest, -1)
        return np.asarray(parts.transpose(0, 2, 1) @ other.reshape(self._groups, self._longest, -1))

    def number(self, column: Columns) -> int:
        """Number of a column, which may be one that the library lacks."""
        if column.same not in self._numbers:
            self._numbers[column.same] = len(self.columns)
            self.columns.append(column)
        return self._numbers[column.same]

    def _following(self, number: int) -> list[int]:
        """Numbers of a cause that follows what is measured."""
        if number not in self._followed:
            self._followed[number] = [self.number(other) for other in self.columns[number].following()]
        return self._followed[number]

    def _values(self, number: int) -> tuple[FloatArray, FloatArray]:
        """Placed rows of unit rms, so that no unit decides what is singular, and the rms."""
        if number not in self._made:
            self._made[number] = self._scaled(self.columns[number])
        return self._made[number]

    def _scaled(self, column: Columns) -> tuple[FloatArray, FloatArray]:
        size = np.maximum(np.sqrt(np.mean(np.square(column.values), axis=0)), 1e-300)
        return self._placed(column.values / size), size

    def _product(self, one: int, other: int) -> FloatArray:
        """Products of two causes by groups; -1 stands for the nuisances and the rows."""
        if (one, other) not in self._products:
            if other > one >= 0:
                return self._product(other, one).transpose(0, 2, 1)
            left, right = (self._base if k < 0 else self._values(k)[0] for k in (one, other))
            self._products[one, other] = self._times(left, right)
        return self._products[one, other]

    def _spans(self, numbers: Sequence[int]) -> list[slice]:
        """Where the coefficients of causes stand behind those of the nuisances."""
        widths = [self.columns[number].values.shape[1] for number in numbers]
        ends = self._fixed + np.cumsum([0, *widths])
        return [slice(int(start), int(end)) for start, end in pairwise(ends)]

    def _grams(self, numbers: tuple[int, ...]) -> FloatArray:
        """Products of nuisances, columns of a set and rows, by groups, G × K + 1 × K + 1."""
        spans, m = self._spans(numbers), self._fixed
        last = spans[-1].stop if spans else m
        result = np.empty((self._groups, last + 1, last + 1))
        base = self._products[-1, -1]
        result[:, :m, :m], result[:, last, last] = base[:, :m, :m], base[:, m, m]
        result[:, :m, last] = result[:, last, :m] = base[:, :m, m]
        for k, (number, span) in enumerate(zip(numbers, spans, strict=True)):
            across = self._product(number, -1)
            result[:, span, :m], result[:, span, last] = across[..., :m], across[..., m]
            result[:, :m, span], result[:, last, span] = across[..., :m].transpose(0, 2, 1), across[..., m]
            for other, there in zip(numbers[: k + 1], spans[: k + 1], strict=True):
                part = self._product(number, other)
                result[:, span, there], result[:, there, span] = part, part.transpose(0, 2, 1)
        return result

    def _signed(self, numbers: Sequence[int]) -> BoolArray:
        """Coefficients of causes that may have either sign."""
        each = [self.columns[number] for number in numbers]
        parts = [np.ones(c.values.shape[1], bool) if c.signed is None else c.signed for c in each]
        return np.concatenate([np.zeros(0, bool), *parts])

    def chosen(self, best: Judged, order: Sequence[int], instead: tuple[tuple[str, str], ...] = ()) -> Chosen:
        """A set with all that were judged and are possible, best first."""
        every = sorted((item for item in self._memory.values() if np.isfinite(item.score)), key=_order)
        causes = tuple(self.columns[number] for number in order)
        return Chosen(causes, best, tuple(every), instead, tuple(self.columns), self._independent)

    def may_grow(self, best: Judged, kept: Sequence[Judged]) -> bool:
        """Whether one cause more may pay for a good part of itself in one of some sets, or leave more than a bound."""
        if self._space.bound and best.variance <= self._least:
            return False
        numbers = {item.numbers: item for item in (best, *kept)}
        return any(self._pays(item) for item in numbers.values())

    def _pays(self, start: Judged) -> bool:
        found, counts = self.gains(start, self._all_asked)
        return bool(np.max(found - counts * np.log(self._independent)) > _HOPE * self._price)

    def lowest(self, sets: Iterable[Judged]) -> list[Judged]:
        """The few best, each of other causes."""
        each: dict[frozenset[tuple[str, str]], list[Judged]] = {}
        for item in sets:
            if np.isfinite(item.score):
                each.setdefault(frozenset(self.columns[number].key for number in item.numbers), []).append(item)
        return sorted(map(_best, each.values()), key=_order)[:_KEPT]

    def recount(self, best: Judged) -> bool:
        """Whether sets are to be judged anew, for the best leaves another number of independent rows."""
        independent = self._space.independent_by(self._left_by(best))
        if abs(independent - self._independent) <= _RECOUNTED * self._independent:
            return False
        self._independent = independent
        self._memory, self._ranked, self._settled = {}, {}, {}
        return True

    def _left_by(self, item: Judged) -> FloatArray:
        every = np.column_stack([self._base[:, :-1], *(self._values(number)[0] for number in item.numbers)])
        return np.asarray((self._base[:, -1] - every @ item.values)[self._slots])

    def judged(self, numbers: tuple[int, ...], variance: float = np.inf) -> Judged:
        """A set with its criterion; the variance of a row at which its search starts is that of a smaller set."""
        if numbers not in self._memory:
            self._memory[numbers] = self._judged(numbers, variance)
        return self._memory[numbers]

    def _judged(self, numbers: tuple[int, ...], variance: float) -> Judged:
        grams, signed = self._grams(numbers), self._signed(numbers)
        gram = np.sum(grams, axis=0)
        if not np.isfinite(variance):
            variance = max(float(gram[-1, -1]) / self._rows, self._least)
        values = np.zeros(len(gram) - 1)
        for _ in range(_STEPS):
            values = self._solved(gram[None], variance, signed)[0]
            left = max(float(_squares(gram, values)) / self._rows, self._least)
            settled = abs(np.log(left / variance)) < _SETTLED
            variance = left
            if settled:
                break
        if not self._allowed(numbers, values):
            return Judged(numbers, np.inf, (0, 0), np.inf, variance, values)
        grams = grams[self._unseen]
        unseen = self._solved(gram - grams, variance, signed)
        squares = float(np.sum(np.maximum(_squares(grams, unseen), 0.0))) / self._unseen_rows
        squares /= self._target_kept(numbers, values)
        noise, independent = max(squares, self._least), self._independent
        pulls = float(np.sum(values[: self._fixed] ** 2))
        acting = int(np.count_nonzero(values[self._fixed :]))
        freed = sum(self.columns[number].freed for number in numbers)
        causes = sum(self.columns[number].causes for number in numbers)
        priced = pulls + causes * self._price + (acting + freed) * np.log(independent)
        score = independent * (np.log(noise) + (1.0 if self._space.bound else squares / noise)) + priced
        unfloored = independent * (np.log(max(squares, 1e-300)) + 1.0) + priced
        return Judged(numbers, float(score), (causes, acting), float(unfloored), variance, values)

    def _solved(self, gram: FloatArray, variance: float, signed: BoolArray) -> FloatArray:
        """Coefficients, G × K, by products of their columns and of the rows, G × K + 1 × K + 1."""
        weight = self._independent / self._rows / variance
        matrix, moment = weight * gram[:, :-1, :-1], weight * gram[:, :-1, -1:]
        inner = np.arange(matrix.shape[-1])
        matrix[:, inner, inner] *= 1.0 + _RIDGE
        matrix[:, inner, inner] += self._prior(inner)
        values = np.asarray(np.linalg.solve(matrix, moment)[..., 0])
        if not signed.all():
            negative = np.any((values[:, self._fixed :] < 0.0) & ~signed, axis=1)
            for k in np.flatnonzero(negative).tolist():
                plain = matrix[k] - np.diag(self._prior(inner))
                values[k] = constrained(plain, moment[k, :, 0], self._fixed, signed)
        return values

    def _prior(self, place: IntArray) -> FloatArray:
        """What unit priors of nuisances add to the diagonal."""
        return np.where(place < self._fixed, 1.0, 1e-200)

    def _allowed(self, numbers: tuple[int, ...], values: FloatArray) -> bool:
        return all(
            self.columns[number].allows(values[span] / self._values(number)[1])
            for number, span in zip(numbers, self._spans(numbers), strict=True)
        )

    def _target_kept(self, numbers: tuple[int, ...], values: FloatArray) -> float:
        """Variance of the target without what a set takes of it, as a share."""
        target = self._space.target
        parts = [
            self.columns[number].values @ (values[span] / self._values(number)[1])
            for number, span in zip(numbers, self._spans(numbers), strict=True)
            if self.columns[number].of_target
        ]
        if not parts or target is None:
            return 1.0
        return max(float(np.var(target - np.sum(parts, axis=0)) / max(np.var(target), 1e-300)), _LEAST_KEPT)

    def gains(self, start: Judged, stack: _Stack) -> tuple[FloatArray, FloatArray]:
        """By how much causes lower weighted squares and pulls on top of a set, at first order, and how many
        coefficients of each do so. Coefficients of the set that are at their limit stay there.
        """
        weight = self._independent / self._rows / start.variance
        acting = np.flatnonzero(start.values[self._fixed :])
        held = np.column_stack([self._base[:, :0], *(self._values(number)[0] for number in start.numbers)])[:, acting]
        place = np.append(np.arange(self._fixed), self._fixed + acting)
        gram = np.sum(self._grams(start.numbers), axis=0)
        matrix = weight * gram[np.ix_(place, place)]
        matrix[np.diag_indices(len(place))] *= 1.0 + _RIDGE
        matrix[np.diag_indices(len(place))] += self._prior(place)
        # The set is taken out of all columns and of the rows at once.
        cross = weight * np.column_stack([stack.across[:, :-1], stack.values.T @ held]).T
        taken = np.linalg.solve(matrix, np.column_stack([cross, weight * gram[place, -1]]))
        moment = weight * stack.across[:, -1] - cross.T @ taken[:, -1]
        found, counts = np.zeros(stack.count), np.zeros(stack.count)
        for some, near, products, passive in stack.parts:
            inner = weight * products - np.einsum("kci,kcj->cij", cross[:, near], taken[:, :-1][:, near])
            width = range(near.shape[1])
            inner[:, width, width] += _RIDGE * weight * self._rows
            solved = np.linalg.solve(inner, moment[near][..., None])[..., 0]
            negative = np.any((solved < 0.0) & passive, axis=1)
            if len(width) <= 2:
                # Of two that are not negative that one alone which takes more.
                alone = np.maximum(moment[near], 0.0) / inner[:, width, width]
                alone *= alone * moment[near] >= np.max(alone * moment[near], axis=1, keepdims=True)
                pairs = negative & np.all(passive, axis=1)
                solved[pairs], negative = alone[pairs], negative & ~pairs
            for at in np.flatnonzero(negative).tolist():
                solved[at] = constrained(inner[at], moment[near[at]], 0, ~passive[at])
            found[some] = np.sum(moment[near] * solved, axis=1)
            counts[some] = np.count_nonzero(solved, axis=1)
        return found, counts

    def stacked(self, numbers: Sequence[int]) -> _Stack:
        """Columns of causes side by side."""
        values = np.column_stack([self._base[:, :0], *(self._values(number)[0] for number in numbers)])
        starts = np.array([span.start - self._fixed for span in self._spans(numbers)])
        widths = np.array([self.columns[number].values.shape[1] for number in numbers])
        passive, parts = ~self._signed(numbers), []
        for width in np.unique(widths):
            some = np.flatnonzero(widths == width)
            near = starts[some][:, None] + np.arange(width)
            products = np.stack([values[:, place].T @ values[:, place] for place in near])
            parts.append((some, near, products, passive[near]))
        return _Stack(len(widths), values, values.T @ self._base, parts)

    @cached_property
    def _all_asked(self) -> _Stack:
        return self.stacked(self._asked)

    def _promise(self, start: Judged, stack: _Stack) -> FloatArray:
        """What causes may lower the criterion by on top of a set, but for their prior odds, at first order."""
        found, counts = self.gains(start, stack)
        n = self._independent
        squares = float(_squares(np.sum(self._grams(start.numbers), axis=0), start.values)) / self._rows
        share = np.minimum(found * start.variance / max(n * squares, 1e-300), 1.0 - 1e-9)
        return np.asarray(-n * np.log1p(-share) - counts * np.log(n))

    def _promising(self, start: Judged, most: int) -> list[int]:
        """Columns that promise most on top of a set; no key of the set, and each key twice at most.

        A cause with numbers that are moved stands for others of its key. What promises much, or has one coefficient, is
        asked with coefficients that follow something measured, too.
        """
        if start.numbers not in self._ranked:
            taken = {self.columns[number].key for number in start.numbers}
            counts: dict[tuple[str, str], int] = {}
            found = []
            promise = self._promise(start, self._all_asked)
            for number in np.argsort(-promise, kind="stable").tolist():
                column = self.columns[number]
                counts[column.key] = counts.get(column.key, 0) + 1
                if column.key not in taken and counts[column.key] <= (1 if column.reaches else 2):
                    found.append(number)
            # One coefficient alone may promise nothing where its mean is a nuisance.
            asked = [n for k, n in enumerate(found) if k < _JUDGED or self.columns[n].values.shape[1] == 1]
            more = [other for number in asked for other in self._following(number)]
            if more:
                # They count as two causes.
                promises = np.append(promise[found], self._promise(start, self.stacked(more)) - self._price)
                every = zip(promises.tolist(), [*found, *more], strict=True)
                found = [number for _, number in sorted(every, key=lambda one: -one[0])]
            self._ranked[start.numbers] = found
        return self._ranked[start.numbers][:most]

    def moved(self, item: Judged, number: int, share: float = _COARSE) -> Judged:
        """The set with the numbers in one of its columns moved, or as it is where that brings nothing.

        Args:
            item: the set.
            number: of the column.
            share: of their range to which they are found.
        """
        asked = item.numbers, number, share
        if asked not in self._settled:
            self._settled[asked] = self._moved(item, number, share)
        return self._settled[asked]

    def _moved(self, item: Judged, number: int, share: float) -> Judged:
        column = self.columns[number]
        if not column.reaches or not np.isfinite(item.score):
            return item
        others = tuple(other for other in item.numbers if other != number)
        cost = self._cost(others, item.variance)
        # Several numbers are moved in turn.
        for k in list(range(len(column.reaches))) * len(column.reaches):
            low, high = column.reaches[k]
            best = minimize_scalar(
                lambda log, k=k, column=column: cost(column.moved(k, float(log))),
                bounds=(low, high), method="bounded", options={"xatol": share * (high - low), "maxiter": 20},
            )  # fmt: skip
            if best.fun < cost(column):
                column = column.moved(k, float(best.x))
        if column is self.columns[number]:
            return item
        return _best([item, self.judged(tuple(sorted((*others, self.number(column)))), item.variance)])

    def _cost(self, others: tuple[int, ...], variance: float) -> Callable[[Columns], float]:
        """Weighted squares and pulls of a set by one cause more; what may have either sign is projected out once."""
        weight = self._independent / self._rows / variance
        gram = weight * np.sum(self._grams(others), axis=0)
        signed = self._signed(others)
        free = np.append(np.arange(self._fixed), self._fixed + np.flatnonzero(signed))
        bound = np.append(self._fixed + np.flatnonzero(~signed), len(gram) - 1)
        normal = gram[np.ix_(free, free)]
        normal[np.diag_indices(len(free))] *= 1.0 + _RIDGE
        normal[np.diag_indices(len(free))] += self._prior(free)
        lower = cholesky(normal, lower=True)
        half = solve_triangular(lower, gram[np.ix_(free, bound)], lower=True)
        fixed = gram[np.ix_(bound, bound)] - half.T @ half
        held = (self._values(number)[0] for number in others)
        every = np.column_stack([self._base[:, :-1], *held, self._base[:, -1]])[self._slots]
        count = len(bound) - 1

        def cost(column: Columns) -> float:
            values = column.values
            inner = values.T @ values
            size = np.sqrt(np.maximum(inner.diagonal() / self._rows, 1e-300))
            across = (weight / size)[:, None] * (values.T @ every)
            coupling = dtrtrs(lower, across[:, free].T, lower=1)[0]
            matrix = np.empty((count + len(size), count + len(size)))
            matrix[:count, :count] = fixed[:-1, :-1]
            matrix[count:, count:] = (weight / np.multiply.outer(size, size)) * inner - coupling.T @ coupling
            matrix.flat[:: len(matrix) + 1] += _RIDGE * weight * self._rows
            cross = across[:, bound] - coupling.T @ half
            matrix[count:, :count], matrix[:count, count:] = cross[:, :-1], cross[:, :-1].T
            right = np.append(fixed[:-1, -1], cross[:, -1])
            signs = np.ones(len(size), bool) if column.signed is None else column.signed
            theta = constrained(matrix, right, 0, np.append(np.zeros(count, bool), signs))
            return float(fixed[-1, -1] - theta @ right)

        return cost

    def _with(self, start: Judged, number: int) -> Judged:
        return self.judged(tuple(sorted((*start.numbers, number))), start.variance)

    def grown(self, start: Judged, most: int = _JUDGED) -> list[Judged]:
        """A set with one column more; numbers in it are moved where the set may be among the best."""
        each = [(self._with(start, number), number) for number in self._promising(start, most)]
        each.sort(key=lambda one: _order(one[0]))
        moved = [self.moved(item, number) for item, number in each[: most // 2]]
        return [*moved, *(item for item, _ in each[most // 2 :])]

    def improved(self, start: Judged) -> Judged:
        """The set after all exchanges, omissions and moves that lower its criterion."""
        best, passed = start, {start.numbers}
        while True:
            for number in best.numbers:
                if len(best.numbers) > 1 or len(self.columns[number].reaches) > 1:
                    best = self.moved(best, number)
            found = [best]
            spans = self._spans(best.numbers)
            for number, span in zip(best.numbers, spans, strict=True):
                fewer = self.judged(tuple(item for item in best.numbers if item != number), best.variance)
                variants = [self.number(other) for other in self.columns[number].shorter(best.values[span])]
                variants += self._following(number)
                found += [fewer, *self.grown(fewer, _JUDGED // 2), *(self._with(fewer, other) for other in variants)]
            better = _best(found)
            # Of sets of unlike sizes each may be better than the next, and the last than the first.
            if better is best or better.numbers in passed:
                return best
            passed.add(better.numbers)
            best = better

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
            self.columns[number].key
            for number in self._promising(fewer, 2 * _JUDGED)
            if self.columns[number].key != self.columns[first].key
            and self._with(fewer, number).score < best.score + alike
        ]
        return tuple(dict.fromkeys(found))
