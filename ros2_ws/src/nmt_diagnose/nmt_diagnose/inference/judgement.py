"""From fits to probabilities: hypotheses, equivalence classes, places."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from nmt_diagnose.effects.effect import Candidate
from nmt_diagnose.effects.sensor_effects import placed
from nmt_diagnose.inference.confidence import Confidence
from nmt_diagnose.inference.contest import Contender
from nmt_diagnose.inference.generic_source import SourceScore
from nmt_diagnose.inference.hypotheses import NULL, UNKNOWN, Hypothesis, equivalence_classes, probabilities
from nmt_plant.rig import Rig


@dataclass(frozen=True)
class ExplanationClass:
    """Explanations that the data cannot tell apart.

    Attributes:
        head: the best of them.
        members: all of them, one per set of effects, best first.
        probability: of all together.
    """

    head: Contender
    members: tuple[Contender, ...]
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
        places: probability by place and detail, given that there is a gap; sum 1.
        by_label: probability by hypothesis.
        log_odds: ln of all explanations over ``none``, without temperature.
        unknown_odds: ln of ``unknown`` over the best named explanation, without temperature.
    """

    none: float
    unknown: float
    classes: tuple[ExplanationClass, ...]
    places: dict[tuple[str, str], float]
    by_label: dict[str, float]
    log_odds: float
    unknown_odds: float


def place_of(candidate: Candidate, rig: Rig) -> tuple[str, str]:
    """Place and detail of a candidate."""
    return placed(candidate.effect, candidate.placement, rig), candidate.placement.label


def judge(
    null: Contender,
    singles: Sequence[Contender],
    pairs: Sequence[Contender],
    sources: Sequence[SourceScore],
    leftovers: Sequence[SourceScore],
    candidates: Sequence[Candidate],
    rig: Rig,
    confidence: Confidence,
) -> Judgement:
    """Weigh all explanations.

    Args:
        null: the model with its parameters re-fitted.
        singles, pairs: fitted explanations.
        sources: generic sources on top of the model.
        leftovers: generic sources on top of the best single explanation.
        candidates: all that were scanned; a fit at one of many places pays for the choice.
        rig: the model.
        confidence: priors and temperature.
    """
    placements: dict[str, int] = {}
    for candidate in candidates:
        placements[candidate.effect.name] = placements.get(candidate.effect.name, 0) + 1
    kinds = max(1, len(placements))
    base = null.fit.log_evidence

    def chosen(contender: Contender) -> float:
        return -sum(math.log(placements[candidate.effect.name]) for candidate in contender.candidates)

    by_label_gain = {c.label: max(0.0, c.fit.log_evidence - base) for c in singles}

    def inexact(contender: Contender) -> float:
        """Evidence that the inexact model of the strongest of its effects may feign."""
        own = [by_label_gain.get(candidate.label, 0.0) for candidate in contender.candidates]
        return confidence.inexactness * max(own, default=0.0)

    hypotheses = [Hypothesis(NULL, (), "", 0.0, math.log(confidence.prior_none), null.fit)]
    contenders: list[Contender | None] = [null]
    for contender in singles:
        prior = math.log(confidence.prior_effect / kinds) + chosen(contender)
        place = place_of(contender.candidates[0], rig)[0]
        gain = contender.fit.log_evidence - base
        hypotheses.append(Hypothesis(contender.label, contender.effects, place, gain, prior, contender.fit))
        contenders.append(contender)
    for contender in pairs:
        prior = math.log(2.0 * confidence.prior_pair / kinds**2) + chosen(contender)
        gain = contender.fit.log_evidence - base - inexact(contender)
        hypotheses.append(Hypothesis(contender.label, contender.effects, "", gain, prior, contender.fit))
        contenders.append(contender)
    for source in sources:
        prior = math.log(confidence.prior_unknown / max(1, len(sources)))
        gain = source.gain - confidence.inexactness * max(by_label_gain.values(), default=0.0)
        hypotheses.append(Hypothesis(UNKNOWN, (), f"{source.place}|{source.detail}", gain, prior, None))
        contenders.append(None)
    if singles:
        best = singles[0]
        for source in leftovers:
            prior = math.log(confidence.prior_unknown * confidence.prior_effect / max(1, len(leftovers)) / kinds)
            gain = best.fit.log_evidence - base + source.gain - inexact(best)
            prior += chosen(best)
            hypotheses.append(Hypothesis(UNKNOWN, (), f"{source.place}|{source.detail}", gain, prior, None))
            contenders.append(None)
    weights = probabilities(hypotheses, confidence.temperature)
    none = float(weights[0])
    unknown = float(sum(w for w, h in zip(weights, hypotheses, strict=True) if h.label == UNKNOWN))
    classes = _classes(weights, contenders, confidence.equivalence)
    by_label: dict[str, float] = {}
    for weight, hypothesis in zip(weights, hypotheses, strict=True):
        by_label[hypothesis.label] = by_label.get(hypothesis.label, 0.0) + float(weight)
    plain = np.array([h.log_prior + h.log_evidence for h in hypotheses])
    named = [value for value, h in zip(plain, hypotheses, strict=True) if h.label not in (NULL, UNKNOWN)]
    unnamed = [value for value, h in zip(plain, hypotheses, strict=True) if h.label == UNKNOWN]
    return Judgement(
        none,
        unknown,
        classes,
        _places(weights, hypotheses, contenders, rig),
        by_label,
        float(np.logaddexp.reduce([*named, *unnamed]) - plain[0]) if named or unnamed else -math.inf,
        float(np.logaddexp.reduce(unnamed) - np.logaddexp.reduce(named)) if named and unnamed else -math.inf,
    )


def _classes(weights: np.ndarray, contenders: Sequence[Contender | None], limit: float) -> tuple[ExplanationClass, ...]:
    by_effects: dict[tuple[str, ...], list[tuple[float, Contender]]] = {}
    for weight, contender in zip(weights, contenders, strict=True):
        if contender is not None and contender.candidates:
            by_effects.setdefault(contender.effects, []).append((float(weight), contender))
    groups = [
        (sum(weight for weight, _ in members), max(members, key=lambda item: item[0])[1])
        for members in by_effects.values()
    ]
    groups.sort(key=lambda item: -item[0])
    result = []
    for indices in equivalence_classes([contender.fit for _, contender in groups], limit):
        found = [groups[k][1] for k in indices]
        # With one effect more than another member an explanation says nothing new.
        members = tuple(m for m in found if not any(set(o.effects) < set(m.effects) for o in found))
        result.append(ExplanationClass(members[0], members, sum(groups[k][0] for k in indices)))
    return tuple(sorted(result, key=lambda item: -item.probability))


def _places(
    weights: np.ndarray,
    hypotheses: Sequence[Hypothesis],
    contenders: Sequence[Contender | None],
    rig: Rig,
) -> dict[tuple[str, str], float]:
    result: dict[tuple[str, str], float] = {}
    for weight, hypothesis, contender in zip(weights, hypotheses, contenders, strict=True):
        if contender is None:
            place, _, detail = hypothesis.place.partition("|")
            keys = [(place, detail)]
        else:
            keys = [place_of(candidate, rig) for candidate in contender.candidates]
        for key in keys:
            result[key] = result.get(key, 0.0) + float(weight) / len(keys)
    total = sum(result.values())
    return {key: value / total for key, value in sorted(result.items(), key=lambda item: -item[1])} if total else {}
