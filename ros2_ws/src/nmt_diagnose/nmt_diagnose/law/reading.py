"""The law of the force that a model lacks, with what it closes, its loop, and the reasons not to report it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from nmt_core.numerics.arrays import BoolArray, ComplexArray, FloatArray
from nmt_core.text.number_words import percent
from nmt_diagnose.law.force_loop import ForceLoop, force_loops
from nmt_diagnose.law.law_blocks import Block, signed
from nmt_diagnose.law.law_rows import LawRows
from nmt_diagnose.law.law_search import LawCandidate, LawSearch, UnboundedMotionError, fewest
from nmt_diagnose.law.law_words import family
from nmt_diagnose.law.modal_frame import ModalFrame
from nmt_diagnose.law.record_check import RecordCheck
from nmt_diagnose.law.terms import Term, sampled
from nmt_diagnose.measurements.measurement import HeldLevels, Observations
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_rig.rig import Rig


@dataclass(frozen=True)
class LawTerm:
    """One term of a law.

    Attributes:
        kind: of the formula, see :class:`nmt_diagnose.law.terms.Term`.
        parameters: of the formula, SI.
        coefficient, std: its strength with its standard uncertainty.
        unit: of the strength.
        by: measured channel that the term is multiplied by; empty = none.
    """

    kind: str
    parameters: tuple[float, ...]
    coefficient: float
    std: float
    unit: str
    by: str = ""

    @property
    def reversed(self) -> LawTerm:
        """The same term along the other direction: even powers and stops on one side change it."""
        if self.kind in ("stop", "stop damping"):
            return replace(self, parameters=(*self.parameters[:-1], -self.parameters[-1]))
        even = self.kind == "power" and self.parameters[0] % 2.0 == 0.0
        return replace(self, coefficient=-self.coefficient) if even else self

    @property
    def of_unit_strength(self) -> Term:
        """The formula; a stop whose gap is zero states its side only."""
        stop = self.kind in ("stop", "stop damping")
        first, second = ((0.0, *self.parameters)[-2:] if stop else (*self.parameters, 0.0, 0.0))[:2]
        return Term(self.kind, first, second, self.by)


@dataclass(frozen=True)
class LocalLaw:
    """A local force at a place.

    Attributes:
        point, other_point: where it acts; ``other_point`` 0 = against the ground.
        family: what it is, in words.
        terms: its terms.
        valid_to_m: largest displacement that was visited, m.
        other_places: places at which a law of its family does nearly as well.
        loops: force over displacement and velocity, level by level.
        other_families: families that do nearly as well at its place and do not have its terms among theirs.
        valid_between: channels that its strengths follow, with the smallest and the largest value that was visited.
        parted_by: motion at which those other families differ most from it, in words; empty = none is known.
    """

    point: int
    other_point: int
    family: str
    terms: tuple[LawTerm, ...]
    valid_to_m: float
    other_places: tuple[str, ...]
    loops: tuple[ForceLoop, ...]
    other_families: tuple[str, ...] = ()
    valid_between: tuple[tuple[str, float, float], ...] = ()
    parted_by: str = ""

    @property
    def at_middle(self) -> tuple[LawTerm, ...]:
        """Its terms with strengths at the middle of the range of the channels that they follow."""
        middles = {name: 0.5 * (low + high) for name, low, high in self.valid_between}
        result = []
        for term in self.terms:
            alike = (
                other
                for other in self.terms
                if other.by
                and replace(other, by="", coefficient=0.0, std=0.0, unit="")
                == replace(term, coefficient=0.0, std=0.0, unit="")
            )
            if not term.by:
                change = sum(other.coefficient * middles[other.by] for other in alike)
                result.append(replace(term, coefficient=term.coefficient + change))
        return tuple(result)

    @property
    def reversed(self) -> LocalLaw:
        """The same law between the same points in the other order."""
        return replace(
            self, point=self.other_point, other_point=self.point, terms=tuple(t.reversed for t in self.terms)
        )

    @property
    def place(self) -> str:
        """Where it acts, for people: a point, or two."""
        return f"{self.point}-{self.other_point}" if self.other_point else f"{self.point}"


@dataclass(frozen=True)
class LawReading:
    """What held levels say of the force that a model lacks.

    Attributes:
        test: name of the test.
        levels: number of levels.
        laws: one, or two at their places; empty where nothing fits.
        before, after: rms of whitened rows of levels that were left out, without and with the laws.
        closed_inside: share of the gap closed on levels that were left out between the lowest and the highest.
        closed_above: the same of the top two levels, by a fit to those below.
        refusals: why the law is not reported; empty = it is reported.
        of_record: parts of one record stand for levels.
        closed_by_file: share of the gap that the rig file with the laws closes by the prediction that later commands
            make with it, on rows that were held out; NaN = not known. Strengths of held levels are fitted without
            these; a record's close no more than on the parts of the largest motion, which they then do not know.
        closed_at_least: the lower end of its interval; NaN = not known.
        check: the law of records against a part that it does not know.
        late: channel of the force of records and how much later than the motion it comes, s; None = in step.
    """

    test: str
    levels: int
    laws: tuple[LocalLaw, ...]
    before: float
    after: float
    closed_inside: float
    closed_above: float
    refusals: tuple[str, ...]
    of_record: bool = False
    closed_by_file: float = math.nan
    closed_at_least: float = math.nan
    late: tuple[str, float] | None = None
    check: RecordCheck | None = None

    @property
    def is_stated(self) -> bool:
        """Whether the law is reported."""
        return bool(self.laws) and not self.refusals

    @property
    def is_written(self) -> bool:
        """Whether the law goes to the rig file: not where the file predicts no better than without it."""
        return self.is_stated and not self.closed_by_file <= 0.0

    @property
    def closed(self) -> float:
        """Share of the gap that it closes on held-out rows: by its file, else on levels that were left out."""
        return self.closed_by_file if math.isfinite(self.closed_by_file) else min(self.closed_inside, self.closed_above)


def read_law(rig: Rig, observations: Observations) -> LawReading | None:
    """The law of the local force that the model lacks; None where no held levels determine one.

    Args:
        rig: the model as given.
        observations: the real side.
    """
    levels = _levels_of(rig, observations)
    if levels is None:
        return None
    frame = ModalFrame.of(rig, levels)
    if frame is None:
        return None
    if frame.resolution < THRESHOLDS.law.least_resolution:
        near = " and ".join(f"{mode + 1}" for mode in sorted(frame.modes))
        why = (
            f"modes {near} lie so near each other that the levels move all of them, and the channels do not tell their "
            "shapes apart; put sensors where they differ"
        )
        return LawReading(levels.name, levels.count, (), math.nan, math.nan, math.nan, math.nan, (why,))
    levels = frame.relative(levels)
    return _read(LawSearch(LawRows(frame, levels), rig), levels)


def refitted_laws(rig: Rig, observations: Observations, reading: LawReading) -> tuple[LocalLaw, ...] | None:
    """The laws of a reading with the strengths that other levels give; None where those determine none.

    Args:
        rig: the model as given.
        observations: what the strengths are fitted to.
        reading: the places and terms.
    """
    levels = _levels_of(rig, observations)
    frame = None if levels is None else ModalFrame.of(rig, levels)
    if levels is None or frame is None:
        return None
    search = LawSearch(LawRows(frame, frame.relative(levels)), rig)
    places = {(place.point, place.other_point): place for place in search.places}
    if any((law.point, law.other_point) not in places for law in reading.laws):
        return None
    parts = tuple(
        (places[law.point, law.other_point], Block(law.family, tuple(term.of_unit_strength for term in law.terms)))
        for law in reading.laws
    )
    try:
        values = search.refitted(parts).fit.coefficients
    except UnboundedMotionError:
        return None
    found, used = [], 0
    for law in reading.laws:
        terms = tuple(replace(t, coefficient=float(c)) for t, c in zip(law.terms, values[used:], strict=False))
        used += len(terms)
        found.append(replace(law, terms=tuple(term for term in terms if term.coefficient != 0.0)))
    return tuple(found)


def _levels_of(rig: Rig, observations: Observations) -> HeldLevels | None:
    """The held levels of the test that says most; None where no test has so many."""
    found = [
        levels for number in range(len(observations.tests))
        if (levels := observations.tests[number].held_levels(observations, number)) is not None
        and levels.count >= THRESHOLDS.law.fewest_levels and (levels.harmonics >= 2 or _stands_alone(rig, levels))
    ]  # fmt: skip
    if not found:
        return None
    return max(found, key=lambda one: (one.harmonics > 1, one.count, float(np.nanmax(np.abs(one.motion)))))


def _stands_alone(rig: Rig, levels: HeldLevels) -> bool:
    """Whether fundamentals alone determine a law: lines of a stepped sine, and levels without a force where no shaker
    that stays attached belongs to them."""
    if levels.ratio is None:
        return levels.alone
    return rig.exciter is None or rig.exciter.kind == "force"


def _read(search: LawSearch, levels: HeldLevels) -> LawReading:
    before = search.null.score
    limits = THRESHOLDS.law
    if before < limits.least_null_score:
        why = "the levels differ from the model by no more than noise and tolerances"
        return LawReading(levels.name, levels.count, (), before, before, math.nan, math.nan, (why,))
    finalists = search.found()
    if not finalists:
        why = "no local force explains them"
        return LawReading(levels.name, levels.count, (), before, before, 0.0, 0.0, (why,))
    best = fewest(finalists)
    try:
        best = _with_second(search, best)
        above = closed_share(*_above(search, best))
    except UnboundedMotionError:
        why = "under the law that explains them best the motion has no bound"
        return LawReading(levels.name, levels.count, (), before, best.score, 0.0, 0.0, (why,))
    laws = tuple(_law(search, best, number, finalists) for number in range(len(best.parts)) if _acting(best, number))
    return LawReading(
        levels.name, levels.count, laws, before, best.score, closed_share(before, best.score), above,
        _refusals(best, before, above),
    )  # fmt: skip


def _with_second(search: LawSearch, first: LawCandidate) -> LawCandidate:
    """Adds a second law if it improves the score, or if the first needs implausible nuisance parameters."""
    limits = THRESHOLDS.law
    if not _pulled(first) and first.score <= limits.second_from_score:
        return first
    # The residual of a law that closes nearly all is often due to its form, and then falls by a part only.
    enough = closed_share(search.null.score, first.score) >= limits.single_closure
    ratio = limits.clear_score_ratio if enough else limits.second_score_ratio
    pairs = [pair for pair in search.found(first) if _is_better(pair, first, ratio)]
    return fewest(pairs) if pairs else first


def _is_better(pair: LawCandidate, first: LawCandidate, ratio: float) -> bool:
    """Whether the score falls to a ratio by a second law, or it takes off a pull that the first alone needs."""
    if pair.score <= ratio * first.score:
        return True
    return pair.score < first.score and bool(_pulled(first)) and not _pulled(pair)


def _stds(candidate: LawCandidate) -> FloatArray:
    """Standard uncertainties of all coefficients, (k,): 0 of those that do not act."""
    m = candidate.fit.nuisance.size
    result = np.zeros(candidate.fit.coefficients.size)
    active = candidate.fit.coefficients != 0.0
    # A residual beyond the stated noise counts as noise, too.
    scale = max(candidate.score, 1.0)
    result[active] = scale * np.sqrt(np.maximum(np.diag(candidate.fit.covariance)[m:], 0.0))
    return result


def closed_share(before: float, after: float) -> float:
    """Share of a gap that is closed; what is within noise and tolerances counts as none."""
    if not before > 1.0:
        return math.nan
    return (before - max(after, 1.0)) / (before - 1.0)


def _above(search: LawSearch, best: LawCandidate) -> tuple[float, float]:
    """rms of the top two levels as a fit to those below predicts them, without and with the law."""
    count = search.rows.levels.count
    top = [count - 2, count - 1]
    problem = search.problem(search.forces(best))
    empty = np.zeros((*problem.target.shape, 0))
    kept = _slipping(search, best, count - 2)
    return (
        search.basis.predicted(empty, np.zeros(0, bool), top),
        problem.predicted(
            search.law_columns(best.parts, best.motions)[:, :, kept], signed([b for _, b in best.parts])[kept], top
        ),
    )


def _slipping(search: LawSearch, best: LawCandidate, count: int) -> BoolArray:
    """Terms of a law that its lowest levels determine, (k,): of many sliders those that slip there.

    A slider that sticks is a spring at these levels, and several such cannot be distinguished.
    """
    result = []
    for (_, block), motion in zip(best.parts, best.motions, strict=True):
        x, _ = sampled(motion[:count], search.rows.levels.omega[:count])
        largest = float(np.abs(x).max())
        slips = [term.kind not in ("slider", "slack slider") or term.first <= largest for term in block.terms]
        result += slips if any(slips) else [True] * len(slips)
    return np.array(result, bool)


def _refusals(best: LawCandidate, before: float, closed_above: float) -> tuple[str, ...]:
    limits, result = THRESHOLDS.law, []
    if best.score > limits.told_score_ratio * before:
        result.append(f"with it {100.0 * best.score / before:.0f} % of the misfit stay; half is asked for")
    pulled = _pulled(best)
    if pulled:
        result.append(f"it needs what chain and model are not ordinarily off by: {', '.join(pulled)}")
    if closed_above < 0.0:
        result.append(f"the top two levels are predicted worse with it: {percent(closed_above)} of the gap is closed")
    return tuple(result)


def _pulled(best: LawCandidate) -> list[str]:
    """Errors of chain and model that a law needs and that are not ordinarily so large."""
    return [
        f"{name} ({value:+.1f} σ)"
        for name, value in zip(best.fit.names, best.fit.nuisance, strict=True)
        if abs(value) > THRESHOLDS.law.pull_sigmas
    ]


def _acting(best: LawCandidate, number: int) -> list[tuple[Term, float, float]]:
    """Terms of a part that act, with coefficient and standard uncertainty."""
    terms = best.parts[number][1].terms
    start = sum(len(one.terms) for _, one in best.parts[:number])
    values, std = (values[start : start + len(terms)] for values in (best.fit.coefficients, _stds(best)))
    return [(term, float(c), float(s)) for term, c, s in zip(terms, values, std, strict=True) if c != 0.0]


def _law(search: LawSearch, best: LawCandidate, number: int, finalists: Sequence[LawCandidate]) -> LocalLaw:
    place, acting = best.parts[number][0], _acting(best, number)
    family_words = family([(term, c) for term, c, _ in acting])
    motion: ComplexArray = best.motions[number]
    x, _ = sampled(motion, search.rows.levels.omega)
    places: dict[str, None] = {}
    families: dict[str, None] = {}
    for candidate in finalists if len(best.parts) == 1 else ():
        if not candidate.elements or not nearly_as_well(candidate.score, best.score):
            continue
        where, there = candidate.parts[0][0], [(term, c) for _, term, c in candidate.terms()]
        words = family(there)
        if where != place and words == family_words:
            places[where.name] = None
        elif where == place and words != family_words and not _forms(acting) <= _forms(there):
            families[words] = None
    terms = tuple(
        LawTerm(term.kind, tuple(p for p in (float(term.first), float(term.second)) if p), c, s, term.unit)
        for term, c, s in acting
    )
    return LocalLaw(
        place.point, place.other_point, family_words, terms, float(np.abs(x).max()), tuple(places),
        force_loops(search, best, number), tuple(families),
    )  # fmt: skip


def _forms(terms: Sequence[tuple[Any, ...]]) -> set[tuple[str, float]]:
    """Formulas of terms without what a search moves: exponents stay."""
    return {(term.kind, term.first if "{power}" in term.form.formula else 0.0) for term, *_ in terms}


def nearly_as_well(score: float, best: float) -> bool:
    """Whether a law at another place fits nearly as well as the best."""
    return score <= THRESHOLDS.law.place_score_ratio * best
