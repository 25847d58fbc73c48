"""The comparison: probabilities of no gap, of each explanation and of something unnamed; classes of equivalents."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from nmt_core.numerics.arrays import FloatArray
from nmt_diagnose.effects.effect import Candidate
from nmt_diagnose.effects.location import Explanation, Location
from nmt_diagnose.fit.explanations import FittedExplanation
from nmt_diagnose.fit.fitting import Data, Metric
from nmt_diagnose.fit.noise import chance_of
from nmt_diagnose.ledger.diagnosis import NULL, UNKNOWN
from nmt_diagnose.ledger.gap import ClosedShare
from nmt_diagnose.ledger.row import Facts
from nmt_diagnose.ledger.rules import OF_EFFECTS, SINGLE, pass_all
from nmt_diagnose.ledger.size import (
    IMITATION,
    Objection,
    change_size,
    implausible_parameters,
    leaves_something,
    left_over,
    matters,
    relief,
)
from nmt_diagnose.ledger.sources import SourceLocation, places
from nmt_diagnose.ledger.warnings import beyond_physical_limits
from nmt_diagnose.thresholds import THRESHOLDS

_AS_MUCH = 0.01
"""Of a gap: shares that differ by less close as much."""
_DIGITS = 6
"""Of the probability by which classes are ordered: one that is practically none comes before no other."""


@dataclass(frozen=True)
class SourceEvidence:
    """Evidence for something unnamed at a place, on top of a fit.

    Attributes:
        location: where.
        gain: rise of ln evidence; none from what is smaller than what matters.
        explained: fall of the cost.
    """

    location: Location
    gain: float
    explained: float


@dataclass(frozen=True)
class EquivalentClass:
    """Explanations that the recordings do not distinguish.

    Attributes:
        members: the most probable first, no two with the same effects.
        probability: of all of them together.
        given_library: the same if one of the explanations had to be the whole of the gap.
        objections: residuals of the most probable explanation that exceed noise and matter, and its implausible
            parameters.
        places: probability of each place, as :attr:`Explanation.place` writes it, if these effects are the cause.
    """

    members: tuple[FittedExplanation, ...]
    probability: float
    given_library: float = math.nan
    objections: tuple[Objection, ...] = ()
    places: Mapping[str, float] = field(default_factory=dict)

    @property
    def head(self) -> FittedExplanation:
        """The most probable."""
        return self.members[0]

    @property
    def adequate(self) -> bool:
        """Whether the residual of the most probable explanation is noise, or smaller than what matters."""
        return not self.objections

    @property
    def of_two_places(self) -> bool:
        """Whether it is two laws at two places and leaves no more than noise.

        One law that the library lacks acts at one place: two that imitate it do so there.
        """
        return self.objections == (IMITATION,) and len(set(self.head.explanation.locations)) > 1

    def facts(self, share: ClosedShare | None, rival: float) -> Facts:
        """What the rules of a verdict ask of it.

        Args:
            share: of the gap on data held out that it closes; None where that was not judged.
            rival: largest probability of another answer.
        """
        named = share is not None and math.isfinite(share.value)
        return Facts(
            worse=-share.gain if share is not None and share.value < 0.0 else math.nan,
            left=max((objection.over for objection in self.objections if objection.kind), default=0.0),
            pull=max(
                (objection.size for objection in self.objections if objection.group and not objection.kind), default=0.0
            ),
            parameters=len(self.head.fit.parametrisation.calibration),
            laws=laws(self.head) if IMITATION in self.objections else 1,
            probability=self.probability,
            rival=rival,
            among_library=self.given_library,
            closed=share.value if share is not None and named else 0.0,
            effects=1 if self.of_two_places else len(self.head.stated),
        )


@dataclass(frozen=True)
class Comparison:
    """Probabilities.

    Attributes:
        none: nothing is missing.
        unknown: something without a name is.
        classes: named explanations, the most probable class first.
        places: share of each place in what is missing; sum 1 where something is.
        log_odds: ln of everything else over none.
        by_label: probability of none, unknown and each explanation. What acts and is too weak to matter is there what
            shows beyond the noise, and unknown where nothing does.
        small: what best explains a difference that the recordings show and that does not matter.
        small_probability: that it acts rather than nothing, places and effects being alike before.
    """

    none: float
    unknown: float
    classes: tuple[EquivalentClass, ...]
    places: Mapping[Location, float]
    log_odds: float
    by_label: Mapping[str, float]
    small: FittedExplanation | None = None
    small_probability: float = 0.0

    def to_judge(self) -> tuple[EquivalentClass, ...]:
        """Classes whose predictions of held-out rows are judged: the first, and one effect of two that lead."""
        count = THRESHOLDS.verdict.judged_explanations
        first = set(self.classes[0].head.explanation.causes) if self.classes else set()
        parts = (equivalent for equivalent in self.classes[count:] if set(equivalent.head.explanation.causes) < first)
        return (*self.classes[:count], *parts)


def _prior_of_count(effects: int) -> float:
    """Prior probability of so many effects, in whichever order; each beyond two is as rare as the second is."""
    comparison = THRESHOLDS.comparison
    if effects == 0:
        return comparison.prior_none
    rarer = comparison.prior_two_effects / comparison.prior_one_effect
    return math.factorial(effects) * comparison.prior_one_effect * rarer ** (effects - 1)


def by_plain_effect(
    comparison: Comparison,
    shares: Mapping[Explanation, ClosedShare],
    leaves_less: Callable[[FittedExplanation, FittedExplanation], bool],
    implausible: Callable[[FittedExplanation], bool] = lambda found: False,
) -> Comparison:
    """Rank a single effect first if it alone closes most of a gap that several together may not explain.

    An effect that closes most of a gap alone is established, whatever else acts. One that leaves nothing that matters
    and closes as much of the gap on held-out data as the several is the whole answer. Two laws at two places stay
    together where they leave noise and certainly less than the one. An effect that needs an implausible error of the
    measuring chain does not lead several that need none: its size would be wrong by that error.

    Args:
        comparison: of all explanations.
        shares: of the gap that explanations close on data held out.
        leaves_less: whether the first explanation certainly leaves less than the second.
        implausible: whether an explanation needs an implausible error of the measuring chain.
    """
    if not comparison.classes or comparison.classes[0].adequate:
        return comparison
    leader = comparison.classes[0]
    value = {
        id(equivalent): shares[equivalent.head.explanation].value
        for equivalent in comparison.classes
        if equivalent.head.explanation in shares
    }
    least = THRESHOLDS.verdict.partial_closed_share
    of_two = value.get(id(leader), math.nan)
    if of_two < THRESHOLDS.verdict.partial_closed_share_of_two:
        least *= of_two  # nothing is named for certain: what comes nearest is the one that does most of it
    # Where rows held out leave open what the second does they ask of the first what they ask of a part.
    as_much = of_two - _AS_MUCH if math.isfinite(of_two) else THRESHOLDS.verdict.partial_closed_share
    causes = set(leader.head.explanation.causes)
    alone = [
        equivalent
        for equivalent in comparison.classes[1:]
        if set(equivalent.head.explanation.causes) < causes
        and value.get(id(equivalent), -math.inf) >= (least if equivalent.objections else as_much)
        and not (leader.of_two_places and leaves_less(leader.head, equivalent.head))
        and not (implausible(equivalent.head) and not implausible(leader.head))
    ]
    if not alone:
        return comparison
    single = max(alone, key=lambda it: value[id(it)])
    causes = set(single.head.explanation.causes)
    acts = sum(
        equivalent.given_library
        for equivalent in comparison.classes
        if causes <= set(equivalent.head.explanation.causes)
    )
    others = (equivalent for equivalent in comparison.classes if equivalent is not single)
    if single.objections:
        return replace(comparison, classes=(replace(single, given_library=acts), *others))
    # It leaves nothing that matters and closes as much: the second effect is not a part of the answer.
    unknown = max(0.0, 1.0 - acts - comparison.none)
    labels = {NULL: comparison.none, UNKNOWN: unknown, single.head.explanation.label: acts}
    first = replace(single, probability=acts, given_library=acts)
    return replace(comparison, classes=(first, *others), unknown=unknown, by_label=labels)


def source_locations(data: Data, base: FittedExplanation) -> list[SourceLocation]:
    """Possible places of an unnamed source, given a fit, and the changes that it could make to the rows."""

    def whitened(columns: FloatArray) -> FloatArray:
        return data.slopes(columns, base.fit.errors.values)

    # About the rig as it was fitted: resonances of the model as given lie elsewhere.
    rig = base.fit.parametrisation.rig(base.fit.theta)
    return places(data.forward, rig, base.fit.prediction, data.observations, whitened)


def sources(data: Data, base: FittedExplanation, open_from: int) -> list[SourceEvidence]:
    """Evidence for a generic source at each place on top of a fit; none where it leaves only what noise allows.

    Args:
        data: what fits work on.
        base: the fit.
        open_from: parameters from here on are of effects; their prior lets go.
    """
    if not leaves_something(data, base, data.observations.matters):
        return []
    fitted = base.fit
    prior = fitted.parametrisation.prior_std.copy()
    prior[open_from:] *= 1e3
    columns = np.column_stack([fitted.jacobian, fitted.errors.slopes])
    precision = np.concatenate([prior**-2.0, np.ones(fitted.errors.chain.size)])
    metric = Metric(columns, precision, fitted.errors.weights)
    result = []
    for place in source_locations(data, base):
        gains, falls = [], []
        for _, block in place.families:
            gain, fall, change = _source(data, base, metric, precision, block)
            small = not matters(change_size(data, data.in_units(change)), data.observations.matters)
            gains.append(min(gain, 0.0) if small else gain)
            falls.append(0.0 if small else fall)
        mean = float(np.logaddexp.reduce(gains) - math.log(len(gains)))
        result.append(SourceEvidence(place.location, mean, falls[int(np.argmax(gains))]))
    return result


def _source(
    data: Data, base: FittedExplanation, metric: Metric, precision: FloatArray, block: FloatArray
) -> tuple[float, float, FloatArray]:
    """A Gaussian source of one of several sizes: rise of ln evidence, fall of the cost, change of the rows, (m,)."""
    errors, groups, counts = base.fit.errors, data.groups, data.counts
    projected, coefficients_of_base = metric.project(block)
    now = np.concatenate([base.fit.theta, errors.chain])
    pull, stiff = (
        coefficients_of_base.T @ (precision * now),
        coefficients_of_base.T @ (precision[:, None] * coefficients_of_base),
    )
    before = groups.cost(errors.squares, counts)
    gains, explained, change = [], 0.0, np.zeros(len(projected))
    for size in THRESHOLDS.comparison.source_sizes:
        weights, gain, fall, moved = errors.weights, -math.inf, 0.0, change
        for _ in range(3):
            weighted = projected * weights[:, None]
            normal = projected.T @ weighted + stiff
            normal = 0.5 * (normal + normal.T) + np.eye(projected.shape[1]) / size**2
            coefficients = np.linalg.solve(normal, weighted.T @ errors.residual + pull)
            squares = groups.sums((errors.residual - projected @ coefficients) ** 2)
            prior = float(coefficients @ coefficients) / size**2 - 2.0 * float(coefficients @ pull)
            fall = before - groups.cost(squares, counts) - prior - float(coefficients @ stiff @ coefficients)
            trial = 0.5 * fall - 0.5 * float(np.linalg.slogdet(normal * size**2)[1])
            if trial <= gain:
                break
            gain, moved = trial, projected @ coefficients
            weights = groups.weights(squares, counts)[groups.of]
        gains.append(gain)
        if gain == max(gains):
            explained, change = fall, moved
    return float(np.logaddexp.reduce(gains) - math.log(len(gains))), explained, change


def distance(left: FittedExplanation, right: FittedExplanation) -> float:
    """How far two fits lie apart, in standard deviations of the learnt noise of the first."""
    apart = left.fit.errors.residual - right.fit.errors.residual
    return math.sqrt(float(apart @ (left.fit.errors.weights * apart)))


def misfit(found: FittedExplanation, weights: FloatArray) -> float:
    """Residual sum of squares in the noise learnt by ``weights``, plus the prior misfit of model and chain."""
    fitted = found.fit
    count = len(fitted.parametrisation.calibration)
    pulls = fitted.theta[:count] / fitted.parametrisation.prior_std[:count]
    left = float(fitted.errors.residual @ (weights * fitted.errors.residual))
    return left + float(pulls @ pulls) + float(fitted.errors.chain @ fitted.errors.chain)


def laws(found: FittedExplanation) -> int:
    """Laws of the structure that an explanation consists of; 1 where something else acts, too.

    Recordings that two laws explain are explained as well by one that the library lacks.
    """
    kinds = [location.kind for location in found.explanation.locations]
    return len(kinds) if all(kind in ("structure", "joint", "boundary") for kind in kinds) else 1


class Hypotheses:
    """All that competes.

    Args:
        data: what was fitted.
        null: the model alone.
        named: explanations by one or two effects.
        candidates: the library at all places.
        alone: sources on top of the model alone.
        behind: sources on top of the best explanation.
        far: explanations that were fitted before and do not compete, with how much more each left than the best of its
            effects, see `misfit`.
    """

    def __init__(
        self,
        data: Data,
        null: FittedExplanation,
        named: Sequence[FittedExplanation],
        candidates: Sequence[Candidate],
        alone: Sequence[SourceEvidence],
        behind: Sequence[SourceEvidence],
        far: Sequence[tuple[FittedExplanation, float]] = (),
    ) -> None:
        self.data, self.null, self.named = data, null, list(named)
        self.alone, self.behind, self.far = alone, behind, list(far)
        self._implausible_of: dict[int, tuple[tuple[Objection, ...], float]] = {}  # by fit
        spots: dict[str, set[object]] = {}
        for candidate in candidates:
            spots.setdefault(candidate.effect.name, set()).add(candidate.site.location)
        self._spots = {name: len(locations) for name, locations in spots.items()}

    def prior(self, found: FittedExplanation) -> float:
        """ln of the prior of an explanation: effects are alike, and so are the places of one."""
        each = sum(
            -math.log(len(self._spots)) - math.log(self._spots[found.candidates[k].effect.name]) for k in found.stated
        )
        # The limit is an estimate: beyond it the prior falls as that of Cauchy, and what is far beyond loses to a law
        # of the same course without such a limit, not to nothing at all.
        each -= sum(math.log1p(far**2) for far in beyond_physical_limits(found).values())
        return each + math.log(_prior_of_count(len(found.stated)))

    @property
    def stated(self) -> list[FittedExplanation]:
        """Explanations by effects that are needed."""
        return [found for found in self.named if found.stated]

    def _left(self, found: FittedExplanation) -> float:
        """ln probability that the residual is noise and that no parameter of the model is implausible."""
        errors, total = found.fit.errors, 0.0
        if left_over(self.data, found, self.data.observations.matters):
            chance = chance_of(self.data.tails(errors))
            total += min(0.0, math.log(max(chance, 1e-300) / THRESHOLDS.comparison.noise_probability))
        bent, chance = self._implausible(found)
        if bent:
            total += math.log(max(chance, 1e-300) / THRESHOLDS.comparison.incredible_probability)
        if not SINGLE(Facts(laws=laws(found))).passed:
            two, unnamed = THRESHOLDS.comparison.prior_two_effects, THRESHOLDS.comparison.prior_unnamed
            total += math.log(two / (two + unnamed))
        return total

    def _left_by_simplest(self, found: FittedExplanation) -> float:
        """The same of the best of an explanation and of those that say as much by fewer effects."""
        causes = set(found.explanation.causes)
        fewer = [other for other in self.stated if set(other.explanation.causes) < causes and self._alike(other, found)]
        return max(self._left(one) for one in (found, *fewer))

    def objections(self, found: FittedExplanation) -> tuple[Objection, ...]:
        """What speaks against an explanation as the whole of the gap."""
        left = (*left_over(self.data, found, self.data.observations.matters), *self._implausible(found)[0])
        return left or (() if SINGLE(Facts(laws=laws(found))).passed else (IMITATION,))

    def _implausible(self, found: FittedExplanation) -> tuple[tuple[Objection, ...], float]:
        key = id(found.fit)
        if key not in self._implausible_of:
            self._implausible_of[key] = implausible_parameters(self.data, found)
        return self._implausible_of[key]

    @staticmethod
    def _evidence(found: FittedExplanation) -> float:
        """ln evidence with a second penalty for implausible parameters.

        The model alone is credited with the rise that its unfinished fit still promised, so that no effect is claimed
        because a fit stopped early. Explanations get no such credit.
        """
        fitted = found.fit
        promised = 0.0 if found.candidates else 0.5 * fitted.promised
        far = np.abs(fitted.theta[: len(fitted.parametrisation.calibration)]) - THRESHOLDS.comparison.credible_sigmas
        return fitted.log_evidence + promised - 0.5 * float(np.sum(np.maximum(far, 0.0) ** 2))

    @cached_property
    def best(self) -> FittedExplanation | None:
        """The most probable explanation."""
        return max(self.stated, key=self._weight, default=None)

    @property
    def leading(self) -> FittedExplanation | None:
        """The most probable of all that was fitted, whether it says more than the model alone or not."""
        return max(self.named, key=self._weight, default=None)

    def _weight(self, found: FittedExplanation) -> float:
        return self._evidence(found) + self.prior(found)

    @property
    def small(self) -> FittedExplanation | None:
        """The most probable explanation of a difference that the recordings show and that does not matter.

        The evidence has to demand each of its effects. A simpler explanation with nearly the same evidence replaces it.
        """
        unstated = [explanation for explanation in self.named if not explanation.stated]
        found = max(unstated, key=self._evidence, default=None)
        if found is None or self._evidence(found) - self._evidence(self.null) <= self._visible_rise(found):
            return None
        while fewer := [
            explanation
            for explanation in unstated
            if explanation.candidates and set(explanation.fitted.causes) < set(found.fitted.causes)
        ]:
            simpler = max(fewer, key=self._evidence)
            if self._evidence(found) - self._evidence(simpler) >= THRESHOLDS.verdict.sure_log_evidence:
                break
            found = simpler
        return found

    def _visible_rise(self, found: FittedExplanation) -> float:
        """Rise of ln evidence from which an effect is seen, whether it matters or not."""
        effects = [candidate.effect.name for candidate in found.candidates]
        return THRESHOLDS.verdict.alarm_log_odds + sum(math.log(len(self._spots) * self._spots[e]) for e in effects)

    @property
    def _small_probability(self) -> float:
        """Probability of a small difference against none."""
        small = self.small
        if small is None:
            return 0.0
        alarm = THRESHOLDS.verdict.alarm_log_odds
        odds = self._evidence(small) - self._evidence(self.null) - self._visible_rise(small) + alarm
        return 1.0 / (1.0 + math.exp(-min(odds, 700.0)))

    def compared(self) -> Comparison:
        """Probabilities of everything."""
        zero = self._evidence(self.null)
        none = math.log(THRESHOLDS.comparison.prior_none)
        stated = self.stated
        named = [self._weight(explanation) - zero for explanation in stated]
        # With effects that are not needed an explanation says the same as the model alone.
        alike = [none, *(self._weight(explanation) - zero for explanation in self.named if not explanation.stated)]
        none = float(np.logaddexp.reduce(alike))
        alone = [
            math.log(THRESHOLDS.comparison.prior_unnamed / max(1, len(self.alone))) + source.gain
            for source in self.alone
        ]
        best, count = self.best, len(named)
        behind = (
            [
                max(named) + math.log(THRESHOLDS.comparison.prior_unnamed / len(self.behind)) + source.gain
                for source in self.behind
            ]
            if best is not None
            else []
        )
        logs = np.array([none, *named, *alone, *behind])
        weights = np.exp(logs - logs.max())
        weights = weights / weights.sum()
        p_named, p_unnamed = weights[1 : count + 1], weights[count + 1 :]
        by_place: dict[Location, float] = {}
        by_effects: dict[tuple[str, ...], float] = {}
        for explanation, p in zip(stated, p_named, strict=True):
            by_effects[explanation.effects] = by_effects.get(explanation.effects, 0.0) + float(p)
        for effects, p in by_effects.items():
            for location, share in self.located(effects):
                by_place[location] = by_place.get(location, 0.0) + p * share
        for source, p in zip(self.alone, p_unnamed, strict=False):
            by_place[source.location] = by_place.get(source.location, 0.0) + float(p)
        for source, p in zip(self.behind, p_unnamed[len(self.alone) :], strict=True):
            # Both are missing then, each as far as it explains the recordings.
            assert best is not None
            explained = max(self.null.fit.cost - best.fit.cost, 0.0)
            unnamed = float(p) * source.explained / max(source.explained + explained, 1e-300)
            by_place[source.location] = by_place.get(source.location, 0.0) + unnamed
            for location, share in _shares(best):
                by_place[location] = by_place.get(location, 0.0) + (float(p) - unnamed) * share
        total = sum(by_place.values())
        # A residual beyond noise shows an unnamed cause. Without further evidence it is placed with the named one.
        noise = np.exp([self._left_by_simplest(explanation) for explanation in stated])
        unknown = float(p_unnamed.sum() + p_named @ (1.0 - noise))
        given_library = p_named / max(float(p_named.sum()), 1e-300)
        p_named = p_named * noise
        too_weak = THRESHOLDS.comparison.too_weak_share * float(weights[0])
        labels = {"none": float(weights[0]) - too_weak, "unknown": unknown}
        for explanation, p in zip(stated, p_named, strict=True):
            labels[explanation.explanation.label] = labels.get(explanation.explanation.label, 0.0) + float(p)
        weak = "unknown" if self.small is None else self.small.fitted.label
        labels[weak] = labels.get(weak, 0.0) + too_weak
        return Comparison(
            float(weights[0]),
            unknown,
            self._classes(p_named, given_library),
            {k: v / total for k, v in sorted(by_place.items(), key=lambda item: -item[1])} if total else {},
            float(np.logaddexp.reduce(logs[1:]) - none) if logs.size > 1 else -math.inf,
            labels,
            self.small,
            self._small_probability,
        )

    def _placed(self, effects: tuple[str, ...]) -> list[tuple[FittedExplanation, float]]:
        """Explanations by some effects, one for each place, with the probability that they act there; sum 1.

        An ordinary model has its modes' shapes off by some per cent at each point, and with them what an effect there
        does to the rows. Along the difference between two fits that adds to the variance of noise, which is 1, the
        square of that share of all that the effect does; it divides the difference of their squares.
        """
        best: dict[Explanation, FittedExplanation] = {}
        for found in self.stated:
            if found.effects == effects:
                known = best.get(found.explanation)
                if known is None or self._weight(found) > self._weight(known):
                    best[found.explanation] = found
        leader = max(best.values(), key=self._weight)
        weights = leader.fit.errors.weights
        excess = {
            explanation.explanation: misfit(explanation, weights) - misfit(leader, weights)
            for explanation in best.values()
        }
        for found, more in self.far:
            if found.effects == effects and found.explanation not in excess:
                best[found.explanation], excess[found.explanation] = found, more
        if len(best) == 1:
            return [(leader, 1.0)]
        change = self.null.fit.errors.residual - leader.fit.errors.residual
        variance = 1.0 + THRESHOLDS.comparison.place_form_std**2 * float(change @ (weights * change))
        logs = np.array([self.prior(it) - 0.5 * excess[key] / variance for key, it in best.items()])
        shares = np.exp(logs - logs.max())
        return list(zip(best.values(), (shares / shares.sum()).tolist(), strict=True))

    def located(self, effects: tuple[str, ...]) -> list[tuple[Location, float]]:
        """Places of some effects with the share of each; sum 1.

        Combinations are fitted at few places. If only one placement was fitted, each of its effects takes the location
        probabilities of its fit alone.

        Args:
            effects: of explanations that are stated.
        """
        placed = self._placed(effects)
        if len(effects) == 1 or len(placed) > 1:
            return [(location, p * share) for found, p in placed for location, share in _shares(found)]
        ((found, _),) = placed
        result = []
        for cause, (location, share) in zip(found.explanation.causes, _shares(found), strict=True):
            alone = (
                self._placed((cause.effect,))
                if any(explanation.effects == (cause.effect,) for explanation in self.stated)
                else []
            )
            places = [(it.explanation.locations[0], p) for it, p in alone]
            if location not in [place for place, _ in places]:
                places = [(location, 1.0)]
            result += [(place, share * p) for place, p in places]
        return result

    def _classes(self, weights: FloatArray, given_library: FloatArray) -> tuple[EquivalentClass, ...]:
        """Explanations by their effects, those that the recordings do not distinguish together.

        Args:
            weights: probability of each explanation.
            given_library: the same if one of them had to be the whole of the gap.
        """
        groups: dict[tuple[str, ...], list[tuple[float, float, FittedExplanation]]] = {}
        for one, weight, library_share in zip(self.stated, weights, given_library, strict=True):
            groups.setdefault(one.effects, []).append((float(weight), float(library_share), one))
        heads = []
        for same in groups.values():
            best_first = [found for _, _, found in sorted(same, key=lambda item: item[:2], reverse=True)]
            heads.append((sum(w for w, _, _ in same), sum(g for _, g, _ in same), self._head(best_first)))
        heads.sort(key=lambda item: (-item[0], -item[1]))
        result = []
        while heads:
            first = heads[0]
            equivalent = [item for item in heads if item is first or self._alike(first[2], item[2])]
            heads = [item for item in heads if item not in equivalent]
            # With one effect more than another member an explanation says nothing new.
            members = [
                member
                for _, _, member in equivalent
                if not any(set(o.effects) < set(member.effects) for _, _, o in equivalent)
            ]
            weight, library_share = sum(w for w, _, _ in equivalent), sum(g for _, g, _ in equivalent)
            against, head = self.objections(members[0]), members[0]
            at: dict[str, float] = {}
            for found, share in self._placed(head.effects):
                at[found.explanation.place] = at.get(found.explanation.place, 0.0) + share
            result.append(EquivalentClass(tuple(members), weight, library_share, against, at))
        return tuple(
            sorted(
                result,
                key=lambda it: (
                    -round(it.probability, _DIGITS) if it.adequate or it.of_two_places else 0.0,
                    -it.given_library,
                ),
            )
        )

    def _head(self, same: Sequence[FittedExplanation]) -> FittedExplanation:
        """The most probable of explanations by the same effects; without small effects where that leaves nothing."""
        first = same[0]
        plain = [
            explanation
            for explanation in same
            if explanation.explanation == first.explanation
            and not explanation.small
            and not self.objections(explanation)
        ]
        return plain[0] if first.small and plain else first

    def _alike(self, one: FittedExplanation, other: FittedExplanation) -> bool:
        """Whether recordings do not distinguish two explanations, and what has an effect more saves nothing by it.

        What two laws differ by has to be more than what errors of an ordinary model's shapes do to the effect.
        """
        limits = THRESHOLDS.comparison
        if distance(one, other) >= max(limits.equivalent_sigmas, limits.place_form_std * distance(one, self.null)):
            return False
        fewer, more = sorted((one, other), key=lambda it: len(it.stated))
        wanted = self.data.observations.matters
        return not (
            set(fewer.effects) < set(more.effects) and pass_all(OF_EFFECTS, relief(self.data, more, fewer, wanted))
        )


def _shares(found: FittedExplanation) -> list[tuple[Location, float]]:
    """Places of an explanation with the share of each in it: the squares of the strengths in standard uncertainties."""
    squares = np.array([max(found.strength(member), 1e-6) ** 2 for member in found.stated])
    return list(zip(found.explanation.locations, (squares / max(squares.sum(), 1e-300)).tolist(), strict=True))
