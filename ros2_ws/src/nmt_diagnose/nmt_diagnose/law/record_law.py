"""The law of a missing force, read sample by sample from a record of an imposed motion whose force was measured.

What is left of the measured force by the model that is moved as measured is the missing force itself, at the point that
is moved. No balance is solved: terms are evaluated along the measured motion, sliders and bristles with their memory,
and their strengths are a convex problem as those of held levels.

Parts of the record stand for levels: each is predicted by a fit to the others, the two of the largest motion by a fit
to all below them. What chain and model are ordinarily off by are columns under their priors: zeros and gains of motion
and force, and every parameter of the model.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from nmt_core.numerics.arrays import BoolArray, FloatArray
from nmt_core.vocabulary import Quantity
from nmt_diagnose.effects.calibration import calibration_parameters
from nmt_diagnose.law.convex import ConvexFit, Solution
from nmt_diagnose.law.force_loop import ForceLoop
from nmt_diagnose.law.law_blocks import Block, blocks
from nmt_diagnose.law.law_search import best_moved, between
from nmt_diagnose.law.law_words import family
from nmt_diagnose.law.reading import LawReading, LawTerm, LocalLaw, closed_share, nearly_as_well
from nmt_diagnose.law.terms import Term
from nmt_diagnose.measurements.measurement import Measurement
from nmt_diagnose.observations.observables import Observations, Part
from nmt_diagnose.prediction.parts_cache import PartsCache
from nmt_diagnose.prediction.prediction_settings import PredictionSettings
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_rig.rig import Rig

_PARTS = 10
_STEP = 1e-3  # of a logarithm, for differences
_DRAWN = 60  # points of a stretch
_LINE = 1500  # points of its line


@dataclass(frozen=True)
class MovedRecord:
    """One record as parts, ascending motion.

    Attributes:
        name: of the test.
        point: that is moved.
        x, v: its motion at all samples, m and m/s, (1, n).
        at: sample of each row by part, (P, M); −1 where a part has fewer rows.
        missing: measured force less that of the model, over its standard deviation, (P, M); 0 where there is no row.
        sigma: standard deviation of each row, N, (P, M).
        nuisance: what a standard deviation of each error of chain and model adds, in these, (P, M, m).
        names: of the errors.
    """

    name: str
    point: int
    x: FloatArray
    v: FloatArray
    at: FloatArray
    missing: FloatArray
    sigma: FloatArray
    nuisance: FloatArray
    names: tuple[str, ...]

    @classmethod
    def of(cls, rig: Rig, observations: Observations, number: int) -> MovedRecord | None:
        """The record of one test; None where its force was not measured or rows are too few."""
        test, rows = observations.tests[number], observations.rows
        force = [k for k, channel in enumerate(test.channels) if channel.quantity is Quantity.FORCE]
        own = (rows.test == number) & (rows.part == Part.SAMPLE) & np.isin(rows.channel, force[:1])
        if int(own.sum()) < _PARTS * THRESHOLDS.law.fewest_levels:
            return None
        kept = rows.take(own)
        settings = PredictionSettings()
        predictor, cache = test.predictor(kept, settings), PartsCache(settings)
        base = predictor.values(rig, cache, ())
        sigma = observations.sigma[own]
        chain = observations.chains[number] if observations.chains else None
        errors = dict(test.record_errors(kept, rig, cache, settings, chain)[0])
        for parameter in calibration_parameters(rig):
            change = (predictor.values(parameter.apply(rig, _STEP), cache, ()) - base) / _STEP
            if np.any(change):
                errors[parameter.name] = parameter.std * change
        return cls._of_rows(test, kept.time_s, observations.values[own] - base, sigma, errors)

    @classmethod
    def _of_rows(
        cls, test: Measurement, time_s: FloatArray, missing: FloatArray, sigma: FloatArray,
        errors: dict[str, FloatArray],
    ) -> MovedRecord:  # fmt: skip
        assert test.moved_as is not None
        (x, v, _), rate, start = test.moved_as
        sample = np.clip(np.round((time_s - start) * rate).astype(int), 0, x.size - 1)
        parts = [part for part in np.array_split(np.argsort(sample), _PARTS) if part.size]
        parts.sort(key=lambda part: float(np.std(x[sample[part]])))
        size = max(part.size for part in parts)
        chosen = np.full((len(parts), size), -1)
        for row, part in enumerate(parts):
            chosen[row, : part.size] = part
        there = chosen >= 0

        def of_parts(values: FloatArray) -> FloatArray:
            return np.where(there, values[chosen], 0.0)

        white = [of_parts(column / sigma) for column in errors.values()]
        return cls(
            test.name, test.drive_point, x[None], v[None], np.where(there, sample[chosen], -1),
            of_parts(missing / sigma), np.where(there, sigma[chosen], 1.0),
            np.stack(white, axis=-1) if white else np.zeros((*chosen.shape, 0)), tuple(errors),
        )  # fmt: skip

    def columns(self, terms: Sequence[Term]) -> FloatArray:
        """Forces of terms along the motion in standard deviations of the rows, (P, M, k)."""
        at = self.at.astype(int)
        made = [np.where(at >= 0, term.force(self.x, self.v)[0, at] / self.sigma, 0.0) for term in terms]
        return np.stack(made, axis=-1)

    def independent(self, remainder: FloatArray) -> float:
        """Independent rows over rows by what a law leaves, (P, M): neighbours that leave the same count once."""
        order = np.argsort(self.at[self.at >= 0])
        left = remainder[self.at >= 0][order]
        left = left - left.mean()
        power = np.abs(np.fft.rfft(left, 2 * left.size)) ** 2
        correlation = np.fft.irfft(power)[: left.size // 2]
        if not correlation[0] > 0.0:
            return 1.0
        ends = np.flatnonzero(correlation < 0.0)
        summed = float(correlation[1 : int(ends[0]) if ends.size else None].sum()) / float(correlation[0])
        return 1.0 / (1.0 + 2.0 * summed)


@dataclass(frozen=True)
class _Found:
    block: Block
    fit: Solution

    @property
    def score(self) -> float:
        return self.fit.score

    @property
    def terms(self) -> list[tuple[Term, float]]:
        return [(t, float(c)) for t, c in zip(self.block.terms, self.fit.coefficients, strict=True) if c != 0.0]


def read_record_law(rig: Rig, observations: Observations) -> LawReading | None:
    """The law of the force that the model lacks at the point that a record moves; None without such a record.

    Args:
        rig: the model as given.
        observations: the real side.
    """
    numbers = [k for k, test in enumerate(observations.tests) if test.moved_as is not None]
    found = [record for k in numbers if (record := MovedRecord.of(rig, observations, k)) is not None]
    if not found:
        return None
    record = max(found, key=lambda one: float(np.ptp(one.x)))
    limits, count = THRESHOLDS.law, record.missing.shape[0]
    problem = ConvexFit(record.missing, record.nuisance, list(range(1, count - 1)), record.names)
    none = problem.solve(np.zeros((*record.missing.shape, 0)), np.zeros(0, bool))

    def reading(why: str, *laws: LocalLaw, after: float = none.score, above: float = math.nan) -> LawReading:
        inside = closed_share(none.score, after) if laws else math.nan
        return LawReading(record.name, count, laws, none.score, after, inside, above, (why,) if why else (), True)

    if none.score < limits.least_null_score:
        return reading("the record differs from the model by no more than noise and tolerances")
    tried = sorted(_families(record, problem), key=lambda one: one.score)
    if not tried:
        return reading("no local force explains it")
    least = tried[0].score * limits.alike_score_ratio
    best = min((one for one in tried if one.score <= least), key=lambda one: (len(one.terms), one.score))
    top = [count - 2, count - 1]
    signed = _signed(best.block)
    above = closed_share(
        problem.predicted(np.zeros((*record.missing.shape, 0)), np.zeros(0, bool), top),
        problem.predicted(record.columns(best.block.terms), signed, top),
    )
    pulled = [
        f"{name} ({value:+.1f} σ)"
        for name, value in zip(record.names, best.fit.nuisance, strict=True)
        if abs(value) > limits.pull_sigmas
    ]
    why = ""
    if best.score > limits.told_score_ratio * none.score:
        why = f"with it {100.0 * best.score / none.score:.0f} % of the misfit stay; half is asked for"
    elif pulled:
        why = f"it needs what chain and model are not ordinarily off by: {', '.join(pulled)}"
    elif above < 0.0:
        why = "the parts of the largest motion are predicted worse with it"
    return reading(why, _law(record, best, tried), after=best.score, above=above)


def _signed(block: Block) -> BoolArray:
    return np.array([term.signed for term in block.terms])


def _families(record: MovedRecord, problem: ConvexFit) -> list[_Found]:
    """The best block of each family along the motion."""
    found = []
    for members in blocks(record.x, record.v).values():

        def cost(block: Block) -> float:
            return problem.cost(record.columns(block.terms), _signed(block))

        best = members[0]
        if len(members) > 1:
            costs = [cost(block) for block in members]
            number = int(np.argmin(costs))
            best = between(members, number, cost) if members[number].contact else members[number]
        for parameter in best.refined if best.terms[0].first > 0.0 or 1 not in best.refined else ():
            best = best_moved(best, parameter, (-0.4, 0.4), cost)
        fit = problem.solve(record.columns(best.terms), _signed(best))
        if np.any(fit.coefficients):
            found.append(_Found(best, fit))
    return found


def _law(record: MovedRecord, best: _Found, tried: Sequence[_Found]) -> LocalLaw:
    m, active = best.fit.nuisance.size, best.fit.coefficients != 0.0
    std = np.zeros(best.fit.coefficients.size)
    # Rows that are not independent say less, and what is left beyond the stated noise is noise, too.
    left = best.fit.corrected - record.columns(best.block.terms) @ best.fit.coefficients
    scale = max(best.score, 1.0) / math.sqrt(record.independent(left))
    std[active] = scale * np.sqrt(np.maximum(np.diag(best.fit.covariance)[m:], 0.0))
    words = family(best.terms)
    terms = tuple(
        LawTerm(t.kind, tuple(p for p in (float(t.first), float(t.second)) if p), float(c), float(s), t.unit)
        for t, c, s in zip(best.block.terms, best.fit.coefficients, std, strict=True)
        if c != 0.0
    )
    others = {family(one.terms): None for one in tried if nearly_as_well(one.score, best.score)}
    others.pop(words, None)
    largest = float(np.abs(record.x).max())
    return LocalLaw(record.point, 0, words, terms, largest, (), _loops(record, best), tuple(others))


def _loops(record: MovedRecord, best: _Found) -> tuple[ForceLoop, ...]:
    """Missing force over the motion of a few parts, as it was measured and as the law has it."""
    at_rows = record.columns(best.block.terms) @ best.fit.coefficients
    law = sum(c * term.force(record.x, record.v)[0] for term, c in best.terms)
    result = []
    for number in np.unique(np.linspace(0, record.at.shape[0] - 1, 3).round().astype(int)):
        rows = np.flatnonzero(record.at[number] >= 0)[:_DRAWN]
        at, sigma = record.at[number, rows].astype(int), record.sigma[number, rows]
        line = np.arange(at[0], at[-1] + 1, max(1, (at[-1] - at[0]) // _LINE))
        result.append(
            ForceLoop(
                int(number) + 1, tuple(record.x[0, at]), tuple(record.v[0, at]),
                tuple(best.fit.corrected[number, rows] * sigma), float(sigma.mean()),
                tuple(at_rows[number, rows] * sigma),
                tuple(tuple(values[line]) for values in (record.x[0], record.v[0], law)),
            )
        )  # fmt: skip
    return tuple(result)
