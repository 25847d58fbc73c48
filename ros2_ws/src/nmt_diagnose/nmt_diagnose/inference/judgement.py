"""From fits to probabilities: hypotheses, equivalence classes, places."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from nmt_core.arrays import FloatArray
from nmt_diagnose.effects.effect import Candidate
from nmt_diagnose.effects.placement import Explanation, Placement
from nmt_diagnose.inference.confidence import Confidence
from nmt_diagnose.inference.fitted_model import FittedModel
from nmt_diagnose.inference.generic_source import SourceScore
from nmt_diagnose.inference.hypotheses import NULL, OTHER, UNKNOWN, Hypothesis, Kind, equivalence_classes, probabilities
from nmt_diagnose.inference.physical_limits import beyond_limits

_UNLIKELY = math.log(1e5)
# The share of ``inexactness`` was learned on effects of up to 64 standard deviations, a gain of 64²/2. Of what an
# effect explains beyond that, a model of it that is right to 3 % leaves 1e-3.
_LEARNED = 0.5 * 64.0**2
_LEFT = 1e-3
# Standard deviations by which a prediction may be worse than another by chance.
_CHANCE_OF_WORSE = 2.0


@dataclass(frozen=True)
class ExplanationClass:
    """Explanations that the data cannot distinguish.

    Attributes:
        head: the best of them.
        members: all of them, one per set of effects, best first.
        probability: of all together.
    """

    head: FittedModel
    members: tuple[FittedModel, ...]
    probability: float

    @property
    def effects(self) -> tuple[tuple[str, ...], ...]:
        """Sets of effects of the members."""
        return tuple(member.effects for member in self.members)


@dataclass(frozen=True)
class Judgement:
    """Probabilities of everything that competed.

    Attributes:
        none: probability that the model, its parameters re-fitted, is enough.
        unknown: probability of something unnamed.
        classes: named explanations, most probable first.
        places: probability by place, given that there is a gap; sum 1.
        named: probability of each explanation that competed.
        other: probability of a named one that was not among them.
        features: what the probabilities follow from, see :data:`nmt_diagnose.inference.confidence.RANGES`.
        strained: what speaks for a gap is only that the model's own parameters are hard to believe.
    """

    none: float
    unknown: float
    classes: tuple[ExplanationClass, ...]
    places: dict[Placement, float]
    named: dict[Explanation, float]
    other: float
    features: dict[str, float]
    strained: bool = False

    @property
    def log_odds(self) -> float:
        """ln of all explanations over ``none``, as evidence and priors have it."""
        return self.features["log_odds"]

    @property
    def unknown_odds(self) -> float:
        """ln of something unnamed over the named explanations, as reliabilities have it."""
        unknown = min(max(self.unknown, 1e-12), 1.0)
        named = sum((*self.named.values(), self.other))
        return math.log(unknown / max(named, 1e-12))

    @property
    def by_label(self) -> dict[str, float]:
        """Probability by hypothesis, as ``diagnosis.json`` has it."""
        named: dict[str, float] = {}
        for explanation, p in self.named.items():  # forms of one effect share a label
            named[explanation.label] = named.get(explanation.label, 0.0) + p
        return {NULL: self.none, UNKNOWN: self.unknown, **named, OTHER: self.other}


def judge(
    null: FittedModel,
    singles: Sequence[FittedModel],
    pairs: Sequence[FittedModel],
    sources: Sequence[SourceScore],
    leftovers: Sequence[SourceScore],
    candidates: Sequence[Candidate],
    confidence: Confidence,
    best: FittedModel | None = None,
    chance: float = 1.0,
) -> Judgement:
    """Weigh all explanations.

    Args:
        null: the model with its parameters re-fitted.
        singles, pairs: fitted explanations.
        sources: generic sources on top of the model.
        leftovers: generic sources on top of ``best``.
        candidates: all that were scanned; a fit at one of many places pays for the choice.
        confidence: priors and reliabilities.
        best: the explanation that the leftovers are left by; None without leftovers.
        chance: smallest probability, corrected for the number of tests, by which a focused test would find as much in
            what ``best``, or the model without it, leaves.
    """
    placements: dict[str, int] = {}
    for candidate in candidates:
        placements[candidate.effect.name] = placements.get(candidate.effect.name, 0) + 1
    kinds = max(1, len(placements))
    base = null.fit.log_evidence

    def chosen(fitted_model: FittedModel) -> float:
        choice = sum(math.log(placements[candidate.effect.name]) for candidate in fitted_model.candidates)
        return -choice - 0.5 * beyond_limits(fitted_model.candidates, fitted_model.fit) ** 2

    single_gain = {c.explanation.causes[0]: max(0.0, c.fit.log_evidence - base) for c in singles}

    def strongest(fitted_model: FittedModel) -> float:
        """Gain of the strongest of its effects alone."""
        return max((single_gain.get(cause, 0.0) for cause in fitted_model.explanation.causes), default=0.0)

    def feigned(fitted_model: FittedModel) -> float:
        """Evidence for something unnamed that the inexact model of the strongest effect may feign."""
        return confidence.inexactness * strongest(fitted_model)

    def inexact(fitted_model: FittedModel) -> float:
        """The same for a second effect, which has one or two parameters to imitate that inexactness with."""
        own = strongest(fitted_model)
        return confidence.inexactness * min(own, _LEARNED) + _LEFT * max(0.0, own - _LEARNED)

    hypotheses = [Hypothesis(Kind.NONE, 0.0, math.log(confidence.prior_none), null)]
    for fitted_model in singles:
        prior = math.log(confidence.prior_effect / kinds) + chosen(fitted_model)
        hypotheses.append(Hypothesis(Kind.NAMED, fitted_model.fit.log_evidence - base, prior, fitted_model))
    for fitted_model in pairs:
        prior = math.log(2.0 * confidence.prior_pair / kinds**2) + chosen(fitted_model)
        gain = fitted_model.fit.log_evidence - base - inexact(fitted_model)
        hypotheses.append(Hypothesis(Kind.NAMED, gain, prior, fitted_model))
    for source in sources:
        prior = math.log(confidence.prior_unknown / max(1, len(sources)))
        gain = source.gain - confidence.inexactness * max(single_gain.values(), default=0.0)
        hypotheses.append(Hypothesis(Kind.UNNAMED, gain, prior, placement=source.placement))
    # What a focused test finds and no source explains: noise of another kind, for example. Unlike evidence it has no
    # competitor, so it counts from where chance would not get once in a hundred thousand diagnoses.
    found, behind = -math.log(max(chance, 1e-300)) - _UNLIKELY, math.log(confidence.prior_unknown)
    if best is not None:
        if len(best.candidates) == 1:
            behind += math.log(confidence.prior_effect / kinds)
        else:
            behind += math.log(2.0 * confidence.prior_pair / kinds**2)
        behind += chosen(best)
        found += best.fit.log_evidence - base - feigned(best)
    hypotheses.append(Hypothesis(Kind.UNNAMED, found, behind))
    if best is not None:
        for source in leftovers:
            prior = behind - math.log(max(1, len(leftovers)))
            gain = best.fit.log_evidence - base + source.gain - feigned(best)
            hypotheses.append(Hypothesis(Kind.UNNAMED, gain, prior, placement=source.placement))
    weights = probabilities(hypotheses)
    classes = _classes(weights, hypotheses, confidence.equivalence)
    plain = np.array([h.log_prior + h.log_evidence for h in hypotheses])
    named = np.array([value for value, h in zip(plain, hypotheses, strict=True) if h.kind is Kind.NAMED])
    unnamed = np.array([value for value, h in zip(plain, hypotheses, strict=True) if h.kind is Kind.UNNAMED])
    features = _features(plain[0], named, unnamed, classes, max((s.gain for s in leftovers), default=0.0))
    return _calibrated(weights, hypotheses, classes, features, confidence)


def _features(
    null: float, named: FloatArray, unnamed: FloatArray, classes: Sequence[ExplanationClass], leftover: float
) -> dict[str, float]:
    """What the reliabilities are functions of."""
    both = np.concatenate([named, unnamed])
    first = classes[0] if classes else None
    others = sum(group.probability for group in classes[1:])
    return {
        "log_odds": float(np.logaddexp.reduce(both) - null) if both.size else -math.inf,
        "unknown_odds": _odds(unnamed, named),
        "leftover": leftover,
        "second": float(first is not None and len(first.head.candidates) > 1),
        "together": float(first is not None and first.head.explanation.together),
        "margin": math.log(max(first.probability, 1e-300) / max(others, 1e-300)) if first else -math.inf,
        "sigmas": math.log1p(first.head.sigmas) if first else 0.0,
        "equivalents": float(len(first.members) - 1) if first else 0.0,
    }


def _odds(left: FloatArray, right: FloatArray) -> float:
    if not left.size:
        return -math.inf
    return float(np.logaddexp.reduce(left) - np.logaddexp.reduce(right)) if right.size else math.inf


def _calibrated(
    weights: FloatArray,
    hypotheses: Sequence[Hypothesis],
    classes: tuple[ExplanationClass, ...],
    features: dict[str, float],
    confidence: Confidence,
) -> Judgement:
    """Probabilities as often right as they say: shares within none, unnamed and named stay in proportion."""
    gap = confidence.gap.probability(features)
    unnamed = confidence.unnamed.probability(features) if classes else 1.0
    first = confidence.first.probability(features)
    named = gap * (1.0 - unnamed)
    scaled = []
    others = sum(group.probability for group in classes[1:])
    left = named * (1.0 - first)
    for rank, group in enumerate(classes):
        # None of the others may become more probable than the first by what is left for all.
        share = named * first if rank == 0 else min(left * group.probability / max(others, 1e-300), named * first)
        scaled.append(replace(group, probability=share))
    factors = np.zeros(weights.size)
    for before, after in zip(classes, scaled, strict=True):
        effects = {
            item
            for item, hypothesis in enumerate(hypotheses)
            if hypothesis.kind is Kind.NAMED and _fitted_model_of(hypothesis).effects in before.effects
        }
        total = sum(float(weights[k]) for k in effects)
        for k in effects:
            factors[k] = after.probability * (float(weights[k]) / total if total > 0.0 else 1.0 / len(effects))
    sources = np.array([h.kind is Kind.UNNAMED for h in hypotheses])
    mass = float(weights[sources].sum())
    if mass > 0.0:
        factors[sources] = gap * unnamed * weights[sources] / mass
    factors[0] = 1.0 - gap
    by_explanation: dict[Explanation, float] = {}
    for factor, hypothesis in zip(factors, hypotheses, strict=True):
        if hypothesis.kind is Kind.NAMED:
            explanation = _fitted_model_of(hypothesis).explanation
            by_explanation[explanation] = by_explanation.get(explanation, 0.0) + float(factor)
    other = max(0.0, 1.0 - sum((1.0 - gap, gap * unnamed, *by_explanation.values())))
    places = _places(factors[1:], hypotheses[1:])
    return Judgement(1.0 - gap, gap * unnamed, tuple(scaled), places, by_explanation, other, features)


def _fitted_model_of(hypothesis: Hypothesis) -> FittedModel:
    """The fit of a named hypothesis."""
    assert hypothesis.fitted_model is not None
    return hypothesis.fitted_model


def with_share_left(judgement: Judgement, left: float) -> Judgement:
    """The judgement where the best named explanation leaves only so small a share of the gap on data it has not seen.

    Something unnamed may then lie behind it, but it is not what the gap is made of: its probability counts for the
    share that is left, the rest goes to the named explanations.

    Args:
        judgement: without regard to unseen data.
        left: share of the gap that is left, 0 to 1.
    """
    return _with_unknown(judgement, judgement.unknown * left)


def with_share_unexplained(judgement: Judgement, left: float) -> Judgement:
    """The judgement where the best named explanation leaves a share of a clear gap on data it has not seen.

    Something unnamed is at least as probable then as the share is large: what explains less than half of a gap is not
    what the gap is made of, however much better it fits than its competitors.

    Args:
        judgement: without regard to unseen data.
        left: share of the gap that is left at least, 0 to 1.
    """
    least = left * (1.0 - judgement.none)
    return judgement if judgement.unknown >= least else _with_unknown(judgement, least)


def with_prior_conflict(judgement: Judgement, conflict: float, confidence: Confidence) -> Judgement:
    """The judgement where the model closes the gap with parameters that are hard to believe, and nothing else does.

    What moved them has neither name nor place then. Where an explanation raises the alarm by itself, nothing changes:
    it may stand beside beliefs that are too narrow.

    Args:
        judgement: without regard to it.
        conflict: evidence for wider beliefs, see `prior_conflict`.
        confidence: priors and reliabilities.
    """
    own = conflict + math.log(confidence.prior_unknown / confidence.prior_none)
    odds = float(np.logaddexp(judgement.log_odds, own))
    if judgement.log_odds >= confidence.alarm or odds < confidence.alarm:
        return judgement
    features = {**judgement.features, "log_odds": odds}
    none = 1.0 - confidence.gap.probability(features)
    before = 1.0 - judgement.none
    factor = (1.0 - none) / before if before > 0.0 else 0.0
    unknown = judgement.unknown * factor
    scaled = replace(
        _shared(judgement, factor), none=none, unknown=unknown, places={}, features=features, strained=True
    )
    return _with_unknown(scaled, max(unknown, math.exp(own - odds) * (1.0 - none)))


def _with_unknown(judgement: Judgement, unknown: float) -> Judgement:
    """The judgement with another probability of something unnamed; named explanations share the rest as before."""
    named = 1.0 - judgement.none - judgement.unknown
    factor = (1.0 - judgement.none - unknown) / named if named > 0.0 else 1.0
    return replace(_shared(judgement, factor), unknown=unknown)


def _shared(judgement: Judgement, factor: float) -> Judgement:
    """The judgement with the probabilities of all named explanations multiplied by one factor."""
    by_explanation = {explanation: value * factor for explanation, value in judgement.named.items()}
    classes = tuple(replace(group, probability=group.probability * factor) for group in judgement.classes)
    return replace(judgement, classes=classes, named=by_explanation, other=judgement.other * factor)


def with_held_out(judgement: Judgement, worse: Mapping[Explanation, float]) -> Judgement:
    """The judgement where explanations are less probable by how much worse they predict data that no fit has seen.

    The evidence compares how well models fit; one that is wrong by more than the noise may fit best where it bends most
    freely, and predicts badly. What is lost goes to the others that were compared.

    Args:
        judgement: by evidence and priors.
        worse: standard deviations by which each explanation that was compared predicts worse than the best of them; up
            to two are chance.
    """
    penalties = {
        group.head.explanation: math.exp(-0.5 * max(worse[group.head.explanation] - _CHANCE_OF_WORSE, 0.0) ** 2)
        for group in judgement.classes
        if group.head.explanation in worse
    }
    told = [group for group in judgement.classes if group.head.explanation in penalties]
    before = sum(group.probability for group in told)
    after = sum(group.probability * penalties[group.head.explanation] for group in told)
    if min(penalties.values(), default=1.0) == 1.0 or not after > 0.0:
        return judgement
    factors = [
        penalties[g.head.explanation] * before / after if any(g is own for own in told) else 1.0
        for g in judgement.classes
    ]
    classes = [replace(c, probability=c.probability * f) for c, f in zip(judgement.classes, factors, strict=True)]
    by_effects = {effects: f for c, f in zip(judgement.classes, factors, strict=True) for effects in c.effects}
    named = {explanation: p * by_effects.get(explanation.effects, 1.0) for explanation, p in judgement.named.items()}
    classes.sort(key=lambda item: -item.probability)
    return replace(judgement, classes=tuple(classes), named=named)


def _classes(weights: FloatArray, hypotheses: Sequence[Hypothesis], limit: float) -> tuple[ExplanationClass, ...]:
    by_effects: dict[tuple[str, ...], list[tuple[float, FittedModel]]] = {}
    for weight, hypothesis in zip(weights, hypotheses, strict=True):
        if hypothesis.kind is Kind.NAMED:
            fitted_model = _fitted_model_of(hypothesis)
            by_effects.setdefault(fitted_model.effects, []).append((float(weight), fitted_model))
    groups = [
        (sum(weight for weight, _ in members), max(members, key=lambda item: item[0])[1])
        for members in by_effects.values()
    ]
    groups.sort(key=lambda item: -item[0])
    result = []
    for indices in equivalence_classes([fitted_model.fit for _, fitted_model in groups], limit):
        found = [groups[k][1] for k in indices]
        # With one effect more than another member an explanation says nothing new.
        members = tuple(m for m in found if not any(set(o.effects) < set(m.effects) for o in found))
        result.append(ExplanationClass(members[0], members, sum(groups[k][0] for k in indices)))
    return tuple(sorted(result, key=lambda item: -item.probability))


def _places(weights: FloatArray, hypotheses: Sequence[Hypothesis]) -> dict[Placement, float]:
    """Share of each place; a test that does not tell the place has none."""
    result: dict[Placement, float] = {}
    for weight, hypothesis in zip(weights, hypotheses, strict=True):
        for placement in hypothesis.placements:
            result[placement] = result.get(placement, 0.0) + float(weight) / len(hypothesis.placements)
    total = sum(result.values())
    return {key: value / total for key, value in sorted(result.items(), key=lambda item: -item[1])} if total else {}
