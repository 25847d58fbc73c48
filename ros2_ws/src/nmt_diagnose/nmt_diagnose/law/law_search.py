"""Search for the local law that held levels lack: places and blocks, one level left out at a time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from nmt_core.numerics.arrays import BoolArray, ComplexArray, FloatArray
from nmt_diagnose.choose.choice import Choice, Chosen
from nmt_diagnose.choose.space import Space
from nmt_diagnose.law.convex import ConvexFit, Solution
from nmt_diagnose.law.law_blocks import Along, Block, BlockColumns, blocks, signed
from nmt_diagnose.law.law_rows import LawRows
from nmt_diagnose.law.modal_frame import KnownForces
from nmt_diagnose.law.nuisance import MOTION_ROUNDS, known_motion, nuisance_columns
from nmt_diagnose.law.terms import Term, harmonics, sampled
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_rig.rig import ChainSection, Rig

Forces = list[tuple[FloatArray, ComplexArray]]
_FINALISTS = 10
"""Laws that are read again along the motion that they make."""
_LEAST_STIFFNESS = 0.3
"""Smallest stiffness of a place with its law over that without it, for the step of its mean displacement."""


@dataclass(frozen=True)
class LawPlace:
    """Where a local force may act: a point, or between two; ``other_point`` 0 = the ground."""

    point: int
    other_point: int
    participation: FloatArray = field(repr=False, compare=False)

    @property
    def name(self) -> str:
        """For people: a point, or two."""
        return f"{self.point}-{self.other_point}" if self.other_point else f"{self.point}"


Parts = tuple[tuple[LawPlace, Block], ...]


@dataclass(frozen=True)
class LawCandidate:
    """Blocks at places with their fit.

    Attributes:
        parts: place and block of each law.
        fit: coefficients of all terms, in order.
        motions: of each place, m, (L, ORDERS + 1).
    """

    parts: Parts
    fit: Solution = field(repr=False)
    motions: tuple[ComplexArray, ...] = field(repr=False)

    @property
    def elements(self) -> int:
        """Terms that act."""
        return int(np.count_nonzero(self.fit.coefficients))

    @property
    def score(self) -> float:
        """rms of whitened rows of levels that were left out."""
        return self.fit.score

    def terms(self) -> list[tuple[LawPlace, Term, float]]:
        """Place, term and coefficient of the terms that act."""
        flat = [(place, term) for place, block in self.parts for term in block.terms]
        pairs = zip(flat, self.fit.coefficients, strict=True)
        return [(place, term, float(value)) for (place, term), value in pairs if value != 0.0]


class UnboundedMotionError(ArithmeticError):
    """Under a law that is tried the motion grows beyond all numbers."""


class LawSearch:
    """Looks for laws in the rows of one test.

    Args:
        rows: of its levels.
        rig: the model.
    """

    def __init__(self, rows: LawRows, rig: Rig) -> None:
        self.rows, self.rig = rows, rig
        elements = rows.frame.elements
        self.known = KnownForces(elements, rows.frame) if elements else None
        self.inner = list(range(1, rows.levels.count - 1))
        self.independent = np.nan
        self.basis = self.problem([])
        self.null = self.basis.solve(np.zeros((*self.basis.target.shape, 0)), np.zeros(0, bool))

    def _known(self, others: Forces) -> Forces:
        return known_motion(self.rows, self.known, others)[1] if self.known is not None else []

    def problem(self, others: Forces) -> ConvexFit:
        """The fit of the missing force, the model's own elements along the motion that other forces make, too.

        Raises:
            UnboundedMotionError: under these forces the model has no motion that numbers hold.
        """
        motion, forces = known_motion(self.rows, self.known, others) if self.known is not None else (None, [])
        missing = self.rows.measured.copy()
        for participation, force in forces:
            missing -= self.rows.of_force(participation, force)
        columns, names = nuisance_columns(self.rows, self.rig, self.known, motion, others)
        white = np.moveaxis(self.rows.whitened(np.moveaxis(columns, -1, 0)), 0, -1)
        if not np.isfinite(white).all():
            raise UnboundedMotionError
        return ConvexFit(self.rows.whitened(missing), white, self.inner, names)

    @cached_property
    def places(self) -> list[LawPlace]:
        """Points that move, and neighbours of a chain."""
        frame = self.rows.frame
        points = [(point, 0) for point in self.rig.structure.points]
        if isinstance(self.rig.structure, ChainSection):
            points += [(p + 1, p) for p in self.rig.structure.points[:-1]]
        taken = {(e.point, e.other_point or 0) for e in self.rig.local_elements if not e.rotation}
        points += [pair for pair in sorted(taken) if pair not in points and pair[::-1] not in points]
        found = [LawPlace(p, o, frame.at(p, o)) for p, o in points]
        sizes = np.linalg.norm([place.participation[list(frame.modes)] for place in found], axis=1)
        return [place for place, moves in zip(found, moves_enough(sizes), strict=True) if moves]

    def motion(self, place: LawPlace, others: Forces) -> ComplexArray:
        """Motion of a place (L, ORDERS + 1) under the model's own and other forces."""
        return self.rows.motion(place.participation, [*self._known(others), *others])

    def columns(self, place: LawPlace, terms: Sequence[Term], x: FloatArray, v: FloatArray) -> FloatArray:
        """Whitened columns (L, M, k) of terms along the motion of their place."""
        made = np.stack([harmonics(term.force(x, v)) for term in terms])
        rows = self.rows.whitened(self.rows.of_force(place.participation, made))
        return np.moveaxis(rows, 0, -1)

    def found(self, first: LawCandidate | None = None) -> list[LawCandidate]:
        """Laws, one or a first one with another, each along the motion that it makes; by score."""
        forces, motions = self.forces(first) if first else [], {}
        for place in self.places:
            motions[place] = self.motion(place, forces)
        if first is not None:
            motions |= {place: motion for (place, _), motion in zip(first.parts, first.motions, strict=True)}
        variants: dict[tuple[str, str], list[BlockColumns]] = {}
        for place, motion in motions.items():
            families = blocks(*sampled(motion, self.rows.levels.omega))
            for column in BlockColumns.every(self._along(place, motion), families, place.name):
                variants.setdefault(column.key, []).append(column)
        problem, count = self.problem(forces), 1 if first is None else 2
        space = self._space(problem, np.nan)
        chosen = Choice(space).grow([column for some in variants.values() for column in some], count)
        self.independent = chosen.independent
        sets = (tuple(chosen.columns[number].key for number in item.numbers) for item in chosen.judged)
        finalists = []
        for keys in list(dict.fromkeys(keys for keys in sets if len(keys) == count))[:_FINALISTS]:
            # A set is grown by one variant of each cause.
            parts = self._parts(Choice(space).fitted([variants[key] for key in keys]))
            law = self._candidate(parts, tuple(motions[place] for place, _ in parts), problem)
            finalists.append(self.refit(law))
        return sorted((law for law in finalists if law.elements), key=lambda law: law.score)

    def _space(self, problem: ConvexFit, independent: float) -> Space:
        """Rows of the levels about the model, other forces taken off.

        Standard deviations bound errors that are smooth over the levels: a model without a missing law leaves a part.
        """
        count, size = problem.target.shape
        numbers = np.arange(count * size).reshape(count, size)
        return Space(
            problem.target.ravel(), problem.nuisance.reshape(count * size, -1), np.repeat(np.arange(count), size),
            independent, THRESHOLDS.law.second_from_score, ends=(0, count - 1), series=list(numbers.T), bound=True,
        )  # fmt: skip

    def _along(self, place: LawPlace, motion: ComplexArray) -> Along:
        x, v = sampled(motion, self.rows.levels.omega)
        return Along(lambda terms: self.columns(place, terms, x, v).reshape(-1, len(terms)), of_law=False)

    def _column(self, place: LawPlace, block: Block, motion: ComplexArray) -> BlockColumns:
        return BlockColumns.of(place.name, block.name, self._along(place, motion), block, (-block.reach, block.reach))

    def _parts(self, chosen: Chosen) -> Parts:
        named = {place.name: place for place in self.places}
        return tuple((named[one.place], one.block) for one in chosen.causes if isinstance(one, BlockColumns))

    def _candidate(self, parts: Parts, motions: tuple[ComplexArray, ...], problem: ConvexFit) -> LawCandidate:
        """A law along motions of its places with its fit."""
        columns = self.law_columns(parts, motions)
        return LawCandidate(parts, problem.solve(columns, signed([block for _, block in parts])), motions)

    def law_columns(self, parts: Parts, motions: tuple[ComplexArray, ...]) -> FloatArray:
        """Whitened columns (L, M, k) of all terms of parts along motions of their places."""
        each = [
            self.columns(place, block.terms, *sampled(motion, self.rows.levels.omega))
            for (place, block), motion in zip(parts, motions, strict=True)
        ]
        return np.concatenate(each, axis=2)

    def forces(self, candidate: LawCandidate) -> Forces:
        """Forces of a law along the motion of its places."""
        result, used = [], 0
        for (place, block), motion in zip(candidate.parts, candidate.motions, strict=True):
            x, v = sampled(motion, self.rows.levels.omega)
            values = candidate.fit.coefficients[used : used + len(block.terms)]
            used += len(block.terms)
            total = sum((c * t.force(x, v) for c, t in zip(values, block.terms, strict=True)), np.zeros_like(x))
            result.append((place.participation, harmonics(total)))
        return result

    def refit(self, candidate: LawCandidate, refined: bool = True) -> LawCandidate:
        """A law read along the motion that it makes, its parameters refined."""
        best = candidate
        for turn in range(MOTION_ROUNDS):
            forces = self.forces(candidate)
            try:
                problem = self.problem(forces)
            except UnboundedMotionError:
                return best
            motions = tuple(self._moved(candidate, k, forces) for k in range(len(candidate.parts)))
            parts = candidate.parts
            if refined and turn:
                every = zip(parts, motions, strict=True)
                each = [[self._column(place, block, motion)] for (place, block), motion in every]
                parts = self._parts(Choice(self._space(problem, self.independent)).fitted(each))
            candidate = self._candidate(parts, motions, problem)
            if not np.isfinite(candidate.score) or candidate.score > 3.0 * best.score:
                return best
            settled = abs(candidate.score - best.score) < 0.01 * best.score
            best = candidate if candidate.score < best.score or turn else best
            if settled and turn:
                break
        return best

    def refitted(self, parts: Parts) -> LawCandidate:
        """The strengths of a law whose places and terms are known, along the motion that it makes.

        Raises:
            UnboundedMotionError: see :meth:`problem`.
        """
        motions = tuple(self.motion(place, []) for place, _ in parts)
        return self.refit(self._candidate(parts, motions, self.basis), refined=False)

    def _moved(self, candidate: LawCandidate, number: int, forces: Forces) -> ComplexArray:
        """Motion of a place under the forces of a law, its mean by a step of Newton's method.

        On a soft suspension the mean force moves the place by more than it fell off by: repeated alone it diverges.
        """
        place, _ = candidate.parts[number]
        before, motion = candidate.motions[number], self.motion(place, forces)
        shift = 1e-3 * np.abs(before[:, 1])
        motions = list(candidate.motions)
        motions[number] = before + shift[:, np.newaxis] * (np.arange(before.shape[1]) == 0)
        moved_on = self.forces(replace(candidate, motions=tuple(motions)))[number][1][:, 0]
        stiffness = (moved_on - forces[number][1][:, 0]).real / shift
        compliance = (place.participation**2 / self.rows.denominators[0]).sum(axis=1).real
        # Where the law takes the equilibrium away the step is limited.
        share = 1.0 / np.maximum(1.0 + compliance * stiffness, _LEAST_STIFFNESS)
        motion[:, 0] = before[:, 0] + share * (motion[:, 0] - before[:, 0])
        return motion


def moves_enough(sizes: FloatArray) -> BoolArray:
    """Which places move enough for a force there to be seen, from their motions."""
    return np.asarray(sizes > THRESHOLDS.law.least_motion_share * sizes.max())


def fewest(found: Sequence[LawCandidate]) -> LawCandidate:
    """Of the laws whose score is near the best, the one of fewest elements; of these the best."""
    least = min(candidate.score for candidate in found) * THRESHOLDS.law.alike_score_ratio
    near = [candidate for candidate in found if candidate.score <= least]
    return min(near, key=lambda candidate: (candidate.elements, candidate.score))
