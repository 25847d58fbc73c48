"""The law of records: blocks of terms along a measured motion, chosen side by side."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from nmt_core.numerics.arrays import FloatArray, IntArray
from nmt_diagnose.choose.choice import Choice, Chosen, Judged
from nmt_diagnose.choose.space import Space
from nmt_diagnose.law.convex import ConvexFit, Solution
from nmt_diagnose.law.law_blocks import Along, Block, BlockColumns, blocks_of_records, moved, passive, signed
from nmt_diagnose.law.law_words import family
from nmt_diagnose.law.sampled_records import DELAY, HALF_A_SAMPLE, SampledRecords
from nmt_diagnose.law.terms import Term
from nmt_diagnose.thresholds import THRESHOLDS

_BLOCKS = 5  # side by side
_STEP = 1e-3  # of a parameter, for differences
_THIN = 8  # of a family that are tried where places are compared
_COMPARED = 12  # sets of families that may do nearly as well
_SPARSE = 0.5  # independent share of rows of a law: beyond it they lie too far apart to show correlated residuals
_TIGHTENED = 30  # rounds in which errors without a law come to be ordinary ones
_WITHIN = 0.98


@dataclass(frozen=True)
class RecordLaw:
    """Blocks side by side with their fit."""

    blocks: tuple[Block, ...]
    fit: Solution

    @property
    def score(self) -> float:
        """rms of whitened rows of parts that were left out."""
        return self.fit.score

    @cached_property
    def strengths(self) -> tuple[tuple[tuple[Term, float], ...], ...]:
        """Terms that act with their coefficients, block by block."""
        values = iter(self.fit.coefficients)
        pairs = [[(term, float(next(values))) for term in block.terms] for block in self.blocks]
        return tuple(tuple(pair for pair in block if pair[1] != 0.0) for block in pairs)

    @property
    def acts(self) -> bool:
        """Whether every block has a force, contacts their spring."""
        pairs = zip(self.blocks, self.strengths, strict=True)
        return all(block.terms[0] in dict(acting) if block.contact or block.by else acting for block, acting in pairs)

    @property
    def terms(self) -> list[tuple[Term, float]]:
        """Terms that act with their coefficients."""
        return [pair for block in self.strengths for pair in block]


class RecordSearch:
    """Looks for the law of records.

    Args:
        records: with the motion of the place.
    """

    def __init__(self, records: SampledRecords[Any]) -> None:
        self.records = records
        self._missing, self._errors = records.missing, records.nuisance
        self._free = np.array([name in records.free for name in records.names], bool)
        self.null = self._weighed(self._weighed(None))

    def _weighed(self, law: RecordLaw | None) -> RecordLaw:
        """The law, none at first, with its rows weighted by the information in its residual.

        Correlated residuals of neighbours count once, and a residual beyond the stated noise counts as noise. Thousands
        of samples of a wrong law would otherwise bend chain and model by tens of their standard deviations. Without a
        law nothing keeps gains from taking off all of motion and force: errors stay ordinary there.
        """
        worth = 1.0 if law is None else self._scale(law)
        self.worth = np.where(self._free, 1.0, worth)
        if law is None or not law.blocks:
            return self.ordinary(())
        self._count()
        return self.law(law.blocks)

    def _count(self) -> None:
        """The problem with the present weights of its errors."""
        inner = list(range(1, self.records.count - 1))
        self.problem = ConvexFit(self._missing, self._errors / self.worth, inner, self.records.names)

    def ordinary(self, blocks: Sequence[Block]) -> RecordLaw:
        """Blocks with their fit where no error is beyond what is ordinary: the further it is the more it counts."""
        most = THRESHOLDS.law.pull_sigmas
        for _ in range(_TIGHTENED):
            self._count()
            found = self.law(blocks)
            pulls = np.where(self._free, 0.0, np.abs(found.fit.nuisance / self.worth))
            if not np.any(pulls > most):
                break
            self.worth = self.worth * np.maximum(pulls / (_WITHIN * most), 1.0) ** 0.75
        return found

    def _scale(self, law: RecordLaw) -> float:
        """Standard deviation that a row counts with, over the stated one."""
        return max(law.score, 1.0) / math.sqrt(self._independent(law))

    def _independent(self, law: RecordLaw) -> float:
        return self.records.independent(law.fit.corrected - self._made(law))

    def _made(self, law: RecordLaw) -> FloatArray:
        """What a law adds to the rows, whitened."""
        return np.asarray(self.records.columns(_terms(law.blocks)) @ law.fit.coefficients)

    def remaining(self, law: RecordLaw) -> float:
        """Share of the misfit that a law leaves, without white noise where rows lie close enough to show the law."""
        share = law.score / self.null.score
        if self.records.independent(self._made(law)) > _SPARSE:
            return share
        return share * math.sqrt(max(1.0 - self._independent(law), 0.0))

    def law(self, blocks: Sequence[Block]) -> RecordLaw:
        """Blocks with their fit."""
        every = passive(blocks)
        fit = self.problem.solve(self.records.columns(_terms(blocks)) @ every, signed(blocks))
        return RecordLaw(tuple(blocks), replace(fit, coefficients=every @ fit.coefficients))

    def predicted(self, blocks: Sequence[Block], out: list[int]) -> float:
        """rms of whitened rows of some parts that a fit of blocks to the others predicts."""
        return self.problem.predicted(self.records.columns(_terms(blocks)) @ passive(blocks), signed(blocks), out)

    def without(self, blocks: Sequence[Block], out: list[int]) -> tuple[FloatArray, FloatArray]:
        """Errors (m,) and coefficients (k,) of a fit of blocks to all parts but some."""
        every = passive(blocks)
        errors, values = self.problem.without(self.records.columns(_terms(blocks)) @ every, signed(blocks), out)
        return errors, every @ values

    def single(self) -> RecordLaw | None:
        """The best law of one block at a place, of a few of each family; None where none acts."""
        every = blocks_of_records(self.records.x, self.records.v)
        # A wave is met or it is not: of cogging half are tried.
        some = {name: m[:: 2 if name == "cogging" else max(1, len(m) // _THIN)] for name, m in every.items()}
        chosen = Choice(self._space).grow(self._library(some), 1)
        return next((self._law_of(chosen, one) for one in chosen.judged if one.numbers), None)

    def found(self) -> list[RecordLaw]:
        """The law and others that were compared with it, each with rows weighted by the residual of the law."""
        families = blocks_of_records(self.records.x, self.records.v)
        chosen = Choice(self._space).grow(self._library(families), _BLOCKS)
        best = self._law_of(chosen, chosen.best)
        if not best.blocks:
            return []
        best = self._weighed(best)
        others: dict[tuple[str, ...], Judged] = {}
        for one in chosen.judged:
            names = tuple(sorted(chosen.columns[number].term for number in one.numbers))
            if one is not chosen.best and 0 < len(one.numbers) <= len(best.blocks):
                others.setdefault(names, one)
        return [best, *(self._law_of(chosen, one) for one in list(others.values())[:_COMPARED])]

    @cached_property
    def _space(self) -> Space:
        """The rows about the model as given."""
        missing, errors = self._missing.ravel()[self._rows], self._errors.reshape(-1, self._errors.shape[2])[self._rows]
        length, count = self._missing.shape[1], self.records.count
        numbers = np.empty(self._missing.size, np.int64)
        numbers[self._rows] = np.arange(self._rows.size)
        series = [numbers[part * length + rows] for part, rows, _ in self.records.series()]
        return Space(
            missing, errors, self._rows // length, np.nan, 1.0, ends=(0, count - 1), series=series,
            bound=self.records.bound,
        )  # fmt: skip

    @cached_property
    def _rows(self) -> IntArray:
        """Places of the rows in parts of equal length."""
        size = np.zeros(self._missing.shape, bool)
        for part, rows, _ in self.records.series():
            size[part, rows] = True
        return np.flatnonzero(size)

    def _library(self, families: Mapping[str, Sequence[Block]]) -> list[BlockColumns]:
        along = Along(self._columns, list(self.records.records[0].channels), self.records.range_of)
        return BlockColumns.every(along, families)

    def _columns(self, terms: Sequence[Term]) -> FloatArray:
        values = self.records.columns(terms).reshape(-1, len(terms))
        return values if len(values) == self._rows.size else values[self._rows]

    def _law_of(self, chosen: Chosen, one: Judged) -> RecordLaw:
        columns = [chosen.columns[number] for number in one.numbers]
        return self.law([column.block for column in columns if isinstance(column, BlockColumns)])

    def moved(self, blocks: Sequence[Block]) -> RecordLaw:
        """Blocks with their parameters moved to where the fit is best."""
        chosen = Choice(self._space).fitted([self._library({block.name: [block]}) for block in blocks])
        return self._law_of(chosen, chosen.best)

    def late(self, law: RecordLaw) -> float:
        """Samples by which the force comes later than the motion, fitted together with a law."""
        parts = [
            value
            for error, value in zip(self.records.names, law.fit.nuisance / self.worth, strict=True)
            if error.startswith(DELAY)
        ]
        return self.records.late - HALF_A_SAMPLE * float(np.mean(parts))

    def pulled(self, law: RecordLaw) -> list[str]:
        """Errors of chain and model that a law needs and that are not ordinarily so large."""
        pulls = law.fit.nuisance / self.worth
        return [
            f"{error} ({value:+.1f} σ)"
            for error, value, free in zip(self.records.names, pulls, self._free, strict=True)
            if abs(value) > THRESHOLDS.law.pull_sigmas and not free
        ]

    def covariance(self, law: RecordLaw) -> FloatArray:
        """Covariance of the strengths of the terms that act, parameters being free, (k, k)."""
        scale = self._scale(law)
        slopes = [
            (self._force(law, k, parameter, 1.0 + _STEP) - self._force(law, k, parameter, 1.0 - _STEP)) / (2.0 * _STEP)
            for k, block in enumerate(law.blocks)
            for parameter in block.refined
        ]
        acting = self.records.columns([term for term, _ in law.terms])
        m, size = law.fit.nuisance.size, acting.shape[2]
        every = np.concatenate([self.problem.nuisance, acting, *(slope[..., np.newaxis] for slope in slopes)], axis=2)
        every = every.reshape(-1, every.shape[2])
        norms = np.maximum(np.linalg.norm(every, axis=0), 1e-150)
        normal = (every / norms).T @ (every / norms)
        normal[:m, :m] += np.diag(norms[:m] ** -2.0)
        every = np.linalg.pinv(normal, rcond=1e-12, hermitian=True)[m : m + size, m : m + size]
        return np.asarray(scale**2 * every / np.outer(norms[m : m + size], norms[m : m + size]))

    def _force(self, law: RecordLaw, number: int, parameter: int, factor: float) -> FloatArray:
        """Force of one block, whitened, with a parameter times a factor, (P, M)."""
        block = moved(law.blocks[number], parameter, factor)
        start = sum(len(one.terms) for one in law.blocks[:number])
        values = law.fit.coefficients[start : start + len(block.terms)]
        return np.asarray(self.records.columns(block.terms) @ values)


def words_of(records: SampledRecords[Any], law: RecordLaw) -> str:
    """Families of a law in words, that of the largest force first; empty where no term acts."""
    sizes: dict[str, float] = {}
    for block in filter(None, law.strengths):
        force = records.columns([term for term, _ in block]) @ np.array([value for _, value in block])
        words = family([pair for pair in block if not pair[0].by] or list(block))
        words += f" that follows the {block[-1][0].by}" if block[-1][0].by else ""
        sizes[words] = max(sizes.get(words, 0.0), float(np.linalg.norm(force)))
    names = sorted(sizes, key=lambda words: -sizes[words])
    return " and ".join([", ".join(names[:-1]), names[-1]]) if len(names) > 1 else "".join(names)


def _terms(blocks: Sequence[Block]) -> list[Term]:
    return [term for block in blocks for term in block.terms]
