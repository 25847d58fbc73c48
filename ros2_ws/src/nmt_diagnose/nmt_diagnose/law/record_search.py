"""Search for the law of records of imposed motion: blocks of terms side by side, as many as parts left out ask for.

Terms act along the measured motion, so that blocks are added one after the other to a convex problem. From each of few
laws the families that fit best beside it are refined and judged by the parts that the fit did not see. A block stays
only where these are told better by as much as laws have to differ to be told apart.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from nmt_core.numerics.arrays import BoolArray, FloatArray
from nmt_diagnose.law.convex import ConvexFit, Solution
from nmt_diagnose.law.law_blocks import Block, blocks_of_records, moved
from nmt_diagnose.law.law_search import best_moved, between
from nmt_diagnose.law.law_words import family
from nmt_diagnose.law.sampled_records import DELAY, HALF_A_SAMPLE, SampledRecords
from nmt_diagnose.law.terms import Term
from nmt_diagnose.measurements.imposed_motion import POSITION
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_rig.model.local_elements.element import MAGNITUDE_OF

_BLOCKS = 5  # side by side
_KEPT = 2  # laws that are gone on from
_BELOW = 0.1  # of a strength that it may be below zero at the end of the range
_STEP = 1e-3  # of a parameter, for differences
_SHORTENED = 3  # of as many terms that are judged
_THIN = 8  # of a family that are tried where places are compared
_TIGHTENED = 30  # rounds in which errors without a law come to be ordinary ones
_WITHIN = 0.98
_REFINED = 6  # families that are refined beside each


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
    def unwritten(self) -> bool:
        """Whether no element has the force of one of its terms."""
        return any(term.section is None for term, _ in self.terms)

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
        """The law, none at first, with its rows counted as what it leaves is worth.

        What neighbours leave alike counts once, and what is left beyond the stated noise is noise, too. Thousands of
        samples of a wrong law would otherwise bend chain and model by tens of their standard deviations. Without a law
        nothing keeps gains from taking off all of motion and force: errors stay ordinary there.
        """
        worth = 1.0 if law is None else self._scale(law)
        self.worth = np.where(self._free, 1.0, worth)
        if law is None or not law.blocks:
            return self.ordinary(())
        self._count()
        return self.law(law.blocks)

    def _count(self) -> None:
        """The problem with errors that count as they are worth."""
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
        left = law.fit.corrected - self.records.columns(_terms(law.blocks)) @ law.fit.coefficients
        return max(law.score, 1.0) / math.sqrt(self.records.independent(left))

    def law(self, blocks: Sequence[Block]) -> RecordLaw:
        """Blocks with their fit."""
        return RecordLaw(tuple(blocks), self.problem.solve(self.records.columns(_terms(blocks)), signed(blocks)))

    def cost(self, blocks: Sequence[Block]) -> float:
        """Squared residuals of blocks and what the priors of the errors count."""
        return self.problem.cost(self.records.columns(_terms(blocks)), signed(blocks))

    def singles(self) -> list[RecordLaw]:
        """Laws of one block of the families that fit best, of a few of each: what a place is worth, the best first."""
        every = blocks_of_records(self.records.x, self.records.v).values()
        # A wave is met or it is not: of cogging half are tried.
        families = [m[:: 2 if m[0].terms[0].kind == "cogging" else max(1, len(m) // _THIN)] for m in every]
        laws = [law for law in self._beside(self.null, families) if law.terms]
        return sorted(laws, key=lambda law: law.score)

    def found(self) -> list[RecordLaw]:
        """Laws of one block and more, the best of each number of blocks among them."""
        families = blocks_of_records(self.records.x, self.records.v)
        result, kept, ratio = list[RecordLaw](), [self.null], THRESHOLDS.law.alike_score_ratio
        for _ in range(_BLOCKS):
            grown = [(one, law) for one in kept for law in self._beside(one, list(families.values()))]
            others = sorted((law for _, law in grown), key=lambda law: law.score)
            # A block is told beside those that it stands with, not beside another law.
            better = sorted((law for one, law in grown if law.score * self._asked(one) <= one.score), key=_score)
            if not better or kept[0].score <= THRESHOLDS.law.second_from_score:
                return result or others
            near = [law for law in better[1:] if law.score <= better[0].score * ratio]
            # What is gone on from is the best law and the shortest that is alike.
            goes_on = [better[0], min(near, key=lambda law: (len(law.terms), law.score))] if near else better[:_KEPT]
            kept = sorted((self.polished(law) for law in goes_on), key=lambda law: law.score)
            result += kept + [law for law in others if all(law is not other for other in goes_on)]
            kept = [self._weighed(kept[0]), *(self.law(law.blocks) for law in kept[1:])]
        return result

    def _asked(self, law: RecordLaw) -> float:
        """By how much a score has to fall by one block more."""
        limits = THRESHOLDS.law
        return limits.alike_score_ratio if law.score > self.records.enough else 1.0 / limits.clear_score_ratio

    def _beside(self, law: RecordLaw, families: Sequence[Sequence[Block]]) -> list[RecordLaw]:
        """The best block of the families that fit best beside a law, each with it."""
        tried = []
        for members in families:
            costs = [self.cost((*law.blocks, block)) for block in members]
            number = int(np.argmin(costs))
            tried.append((costs[number], number, members))
        tried.sort(key=lambda one: one[0])
        result = []
        for _, number, members in tried[:_REFINED]:
            block = members[number]
            if block.bounded and len(members) > 1:
                block = between(members, number, lambda other: self.cost((*law.blocks, other)))
            larger = self._acting(self.law((*law.blocks, self.refined(block, law.blocks))))
            if larger.acts:
                result.append(larger)
        return result + self._following(law)

    def _acting(self, law: RecordLaw) -> RecordLaw:
        """The law whose last block, a grid, has only the terms that act: others would fit the noise of parts."""
        block, strengths = law.blocks[-1], law.strengths[-1]
        if block.refined or not 0 < len(strengths) < len(block.terms):
            return law
        return self.law((*law.blocks[:-1], replace(block, terms=tuple(term for term, _ in strengths))))

    def _following(self, law: RecordLaw) -> list[RecordLaw]:
        """The law with one of its blocks following a measured channel, as far as its strength stays passive."""
        result = []
        for k, block in enumerate(law.blocks):
            for channel in self.records.records[0].channels:
                low, high = self.records.range_of(channel)
                plain = channel.removeprefix(MAGNITUDE_OF)
                if block.by or block.contact or not high > low or (plain == POSITION and block.terms[0].signed):
                    continue
                ends = self.records.range_of(plain)
                if plain != channel and ends[0] * ends[1] >= 0.0:
                    continue  # where the channel is of one sign its magnitude says the same
                blocks = [*law.blocks[:k], block.following(channel, 0.5 * (low + high)), *law.blocks[k + 1 :]]
                blocks[k] = self.refined(blocks[k], [*blocks[:k], *blocks[k + 1 :]])
                following = self.law(blocks)
                if following.acts and _stays_passive(following, k, 0.5 * (high - low)):
                    result.append(following)
        return result

    def refined(self, block: Block, others: Sequence[Block]) -> Block:
        """The block with its parameters moved to where the fit beside others is best."""
        if not block.terms[0].first > 0.0 and 1 in block.refined:
            return block
        # Two parameters are moved in turn.
        for parameter in block.refined * len(block.refined):
            block = best_moved(block, parameter, (-block.reach, block.reach), lambda other: self.cost((*others, other)))
        return block

    def polished(self, law: RecordLaw) -> RecordLaw:
        """The law with every block refined beside the others, where parts left out are told no worse by it."""
        blocks = list(law.blocks)
        for k, block in enumerate(blocks[:-1]):
            blocks[k] = self.refined(block, [*blocks[:k], *blocks[k + 1 :]])
        found = self.law(blocks)
        return found if found.score <= law.score and found.acts else law

    def late(self, law: RecordLaw) -> float:
        """Samples by which the force comes later than the motion, beside a law."""
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

    def fewest(self, tried: Sequence[RecordLaw]) -> RecordLaw:
        """Of the laws whose score is near the best the family of fewest terms, in the shape that is told best.

        What a file can hold comes before what it cannot.

        A family is asked for by a tenth of the score. Terms that are no family of their own are its shape, and their
        number hangs on the grid that they come from: they stay where parts left out are told any better.
        """
        ratio = THRESHOLDS.law.alike_score_ratio
        first = min(tried, key=lambda law: law.score)
        # Scores compare where rows count alike.
        best = self._weighed(first).score
        near = [self.law(law.blocks) for law in tried if law.score <= first.score * ratio]
        near = [law for law in near if law.acts] or [first]
        paths = [self._shortened(law, max(law.score, best * ratio**0.5)) for law in near]
        least = ratio * min(law.score for path in paths for law in path)
        within = [kept for path in paths if (kept := [law for law in path if law.score <= least])]
        path = min(within, key=lambda laws: (laws[-1].unwritten, len(laws[-1].terms), laws[-1].score))
        return self._weighed(in_shape(path, [words_of(self.records, law) for law in path]))

    def _shortened(self, law: RecordLaw, most: float) -> list[RecordLaw]:
        """The law with ever fewer blocks and terms, up to a score."""
        path = [law]
        while True:
            shorter = [
                (*law.blocks[:k], *without, *law.blocks[k + 1 :])
                for k, block in enumerate(law.blocks)
                for without in _shorter(block)
            ]
            fewer = self._fewer([blocks for blocks in shorter if blocks], most)
            if fewer is None:
                return path
            law = fewer
            path.append(law)

    def _fewer(self, shorter: Sequence[tuple[Block, ...]], most: float) -> RecordLaw | None:
        """Of laws without a block or a term the one of fewest terms up to a score; None where there is none."""
        numbers = [len(_terms(blocks)) for blocks in shorter]
        for number in sorted(set(numbers)):
            # Left out one by one, parts take ten times as long: those that fit best come first.
            alike = sorted((b for b, n in zip(shorter, numbers, strict=True) if n == number), key=self.cost)[
                :_SHORTENED
            ]
            laws = [law for law in map(self.law, alike) if law.score <= most and law.terms and law.acts]
            if laws:
                return min(laws, key=lambda law: (len(law.terms), law.score))
        return None


def _score(law: RecordLaw) -> float:
    return law.score


def in_shape(path: Sequence[RecordLaw], words: Sequence[str]) -> RecordLaw:
    """Of ever shorter laws the shortest that has the family of the last and is told as well as the first.

    Args:
        path: the laws.
        words: their families.
    """
    most = path[0].score * THRESHOLDS.law.shape_score_ratio
    alike = [law for law, its in zip(path, words, strict=True) if its == words[-1] and law.score <= most]
    return (alike or [path[-1]])[-1]


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


def _stays_passive(law: RecordLaw, number: int, half: float) -> bool:
    """Whether strengths that change by a channel on either side of its middle keep their sign, within their errors."""
    strengths = dict(law.strengths[number])
    return all(
        abs(strengths.get(replace(term, by="", about=0.0), 0.0)) * (1.0 + _BELOW) >= abs(value) * half
        for term, value in strengths.items()
        if term.by
    )


def _shorter(block: Block) -> list[tuple[Block, ...]]:
    """A block without one of its terms, and no block."""
    found: list[tuple[Block, ...]] = [()]
    for term in block.terms if len(block.terms) > 1 else ():
        if not term.by and any(other.by and replace(other, by="", about=0.0) == term for other in block.terms):
            continue
        found.append((replace(block, terms=tuple(other for other in block.terms if other != term)),))
    return found


def _terms(blocks: Sequence[Block]) -> list[Term]:
    return [term for block in blocks for term in block.terms]


def signed(blocks: Sequence[Block]) -> BoolArray:
    """Coefficients of blocks that may have either sign, (k,)."""
    return np.array([term.signed for term in _terms(blocks)], bool)
