"""Search for the local law that held levels lack: places and blocks, one level left out at a time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.optimize import minimize_scalar

from nmt_core.numerics.arrays import BoolArray, ComplexArray, FloatArray
from nmt_diagnose.law.convex import ConvexFit, Solution
from nmt_diagnose.law.law_blocks import Block, blocks, moved
from nmt_diagnose.law.law_rows import LawRows
from nmt_diagnose.law.modal_frame import KnownForces
from nmt_diagnose.law.nuisance import MOTION_ROUNDS, known_motion, nuisance_columns
from nmt_diagnose.law.terms import Term, harmonics, sampled
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_rig.rig import ChainSection, Rig

Forces = list[tuple[FloatArray, ComplexArray]]
_LEAST_STIFFNESS = 0.3
"""Smallest stiffness of a place with its law over that without it, for the step of its mean displacement."""


@dataclass(frozen=True)
class LawPlace:
    """Where a local force may act: a point, or between two; ``other_point`` 0 = the ground."""

    point: int
    other_point: int
    participation: FloatArray = field(repr=False, compare=False)


@dataclass(frozen=True)
class Candidate:
    """Blocks at places with their fit.

    Attributes:
        parts: place and block of each law.
        fit: coefficients of all terms, in order.
        motions: of each place, m, (L, ORDERS + 1).
    """

    parts: tuple[tuple[LawPlace, Block], ...]
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

    def singles(self) -> list[Candidate]:
        """The best block of each family at each place along the motion without it, the best first."""
        forces = self._known([])
        found = []
        for place in self.places():
            motion = self.rows.motion(place.participation, forces)
            found += self._at(place, motion, self.basis, None)
        return sorted(found, key=lambda candidate: candidate.score)

    def _at(
        self, place: LawPlace, motion: ComplexArray, problem: ConvexFit, first: Candidate | None
    ) -> list[Candidate]:
        """The best block of each family at a place, added to a first law where there is one."""
        x, v = sampled(motion, self.rows.levels.omega)
        before = self.law_columns(first) if first is not None else None
        parts = first.parts if first is not None else ()
        motions = first.motions if first is not None else ()
        signs = [t.signed for _, block in parts for t in block.terms]
        found = []
        for family in blocks(x, v).values():
            if any(where == place and block.name == family[0].name for where, block in parts):
                continue

            def beside(block: Block) -> tuple[FloatArray, BoolArray]:
                columns = self.columns(place, block.terms, x, v)
                if before is not None:
                    columns = np.concatenate([before, columns], axis=2)
                return columns, np.array([*signs, *(t.signed for t in block.terms)])

            best = family[0]
            if len(family) > 1:
                costs = [problem.cost(*beside(block)) for block in family]
                best = family[int(np.argmin(costs))]
                if best.contact:
                    best = between(family, int(np.argmin(costs)), lambda block: problem.cost(*beside(block)))
            fit = problem.solve(*beside(best))
            if np.any(fit.coefficients[len(signs) :]):
                found.append(Candidate((*parts, (place, best)), fit, (*motions, motion)))
        return found

    def law_columns(self, candidate: Candidate) -> FloatArray:
        """Whitened columns (L, M, k) of all terms of a law along the motion of its places."""
        return self._along(candidate.parts, candidate.motions)[0]

    def forces(self, candidate: Candidate) -> Forces:
        """Forces of a law along the motion of its places."""
        result, used = [], 0
        for (place, block), motion in zip(candidate.parts, candidate.motions, strict=True):
            x, v = sampled(motion, self.rows.levels.omega)
            values = candidate.fit.coefficients[used : used + len(block.terms)]
            used += len(block.terms)
            total = sum((c * t.force(x, v) for c, t in zip(values, block.terms, strict=True)), np.zeros_like(x))
            result.append((place.participation, harmonics(total)))
        return result

    def again(self, candidate: Candidate) -> Candidate:
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
            if turn:
                parts = tuple(self._refined(candidate, k, motions, problem) for k in range(len(parts)))
            candidate = Candidate(parts, problem.solve(*self._along(parts, motions)), motions)
            if not np.isfinite(candidate.score) or candidate.score > 3.0 * best.score:
                return best
            settled = abs(candidate.score - best.score) < 0.01 * best.score
            best = candidate if candidate.score < best.score or turn else best
            if settled and turn:
                break
        return best

    def refitted(self, parts: tuple[tuple[LawPlace, Block], ...]) -> Candidate:
        """The strengths of a law whose places and terms are known, along the motion that it makes.

        Raises:
            UnboundedMotionError: see :meth:`problem`.
        """
        motions = tuple(self.motion(place, []) for place, _ in parts)
        kept = tuple((place, replace(block, refined=())) for place, block in parts)
        return self.again(Candidate(kept, self.basis.solve(*self._along(kept, motions)), motions))

    def _moved(self, candidate: Candidate, number: int, forces: Forces) -> ComplexArray:
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

    def _along(
        self, parts: tuple[tuple[LawPlace, Block], ...], motions: tuple[ComplexArray, ...]
    ) -> tuple[FloatArray, BoolArray]:
        """Columns of parts along motions, and which of their coefficients may have either sign."""
        columns = [
            self.columns(place, block.terms, *sampled(motion, self.rows.levels.omega))
            for (place, block), motion in zip(parts, motions, strict=True)
        ]
        return np.concatenate(columns, axis=2), np.array([t.signed for _, block in parts for t in block.terms])

    def _refined(
        self, candidate: Candidate, number: int, motions: tuple[ComplexArray, ...], problem: ConvexFit
    ) -> tuple[LawPlace, Block]:
        """One part with the parameter of its block moved to where the fit is best."""
        place, block = candidate.parts[number]

        def cost(other: Block) -> float:
            parts = list(candidate.parts)
            parts[number] = (place, other)
            return problem.cost(*self._along(tuple(parts), motions))

        for parameter in block.refined if block.terms[0].first > 0.0 or 1 not in block.refined else ():
            block = best_moved(block, parameter, (-0.4, 0.4), cost)
        return place, block

    def seconds(self, first: Candidate) -> list[Candidate]:
        """Pairs of a first law and a block at any place, the best first."""
        forces = self.forces(first)
        problem = self.problem(forces)
        known = self._known(forces)
        found: list[Candidate] = []
        for place in self.places():
            motion = self.rows.motion(place.participation, [*known, *forces])
            found += self._at(place, motion, problem, first)
        return sorted(found, key=lambda candidate: candidate.score)

    def firsts(self, pair: Candidate) -> list[Candidate]:
        """Blocks in the place of the first law of a pair, the best first: it was chosen for both."""
        second = Candidate(pair.parts[1:], pair.fit, pair.motions[1:])
        found = self._at(pair.parts[0][0], pair.motions[0], self.problem(self.forces(pair)), second)
        return sorted(found, key=lambda candidate: candidate.score)

    def fewer(self, pair: Candidate) -> list[Candidate]:
        """The laws with one power less: a polynomial that was chosen with another first law may have one too many."""
        problem, found = self.problem(self.forces(pair)), []
        for k, (place, block) in enumerate(pair.parts):
            for term in block.terms if len(block.terms) > 1 else ():
                if term.kind == "power":
                    kept = replace(block, terms=tuple(other for other in block.terms if other != term))
                    parts = (*pair.parts[:k], (place, kept), *pair.parts[k + 1 :])
                    found.append(replace(pair, parts=parts, fit=problem.solve(*self._along(parts, pair.motions))))
        return found


def moves_enough(sizes: FloatArray) -> BoolArray:
    """Which places move enough for a force there to be seen, from their motions."""
    return np.asarray(sizes > THRESHOLDS.law.least_motion_share * sizes.max())


def between(family: Sequence[Block], number: int, cost: Callable[[Block], float]) -> Block:
    """The block of a family between the neighbours of its best one where the cost is least."""
    best = family[number]
    size = best.terms[0].first
    if not size > 0.0:
        return best
    low = family[max(number - 1, 0)].terms[0].first
    high = family[min(number + 1, len(family) - 1)].terms[0].first
    bounds = (max(low, 0.5 * size) / size, high / size)
    if not bounds[1] > bounds[0]:
        return best
    found = minimize_scalar(
        lambda factor: cost(moved(best, 1, float(factor))), bounds=bounds, method="bounded", options={"maxiter": 12}
    )
    return moved(best, 1, float(found.x)) if found.fun < cost(best) else best


def best_moved(block: Block, number: int, logs: tuple[float, float], cost: Callable[[Block], float]) -> Block:
    """The block with a parameter moved, within logarithms of a factor, to where the cost is least."""

    def at(log_factor: float) -> Block:
        return moved(block, number, float(np.exp(log_factor)))

    found = minimize_scalar(
        lambda log_factor: cost(at(log_factor)),
        bounds=logs,
        method="bounded",
        options={"xatol": 5e-3 * logs[1], "maxiter": 20},
    )
    return at(float(found.x)) if found.fun < cost(block) else block


def fewest(found: Sequence[Candidate]) -> Candidate:
    """Of the laws whose score is near the best, the one of fewest elements; of these the best."""
    least = min(candidate.score for candidate in found) * THRESHOLDS.law.alike_score_ratio
    near = [candidate for candidate in found if candidate.score <= least]
    return min(near, key=lambda candidate: (candidate.elements, candidate.score))
