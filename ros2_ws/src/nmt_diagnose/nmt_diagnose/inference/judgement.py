"""From fits to probabilities: hypotheses, equivalence classes, places."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from nmt_core.blocks import FloatArray
from nmt_diagnose.effects.effect import Candidate
from nmt_diagnose.effects.sensor_effects import placed
from nmt_diagnose.inference.confidence import Confidence
from nmt_diagnose.inference.contest import Contender
from nmt_diagnose.inference.generic_source import SourceScore
from nmt_diagnose.inference.hypotheses import NULL, OTHER, UNKNOWN, Hypothesis, equivalence_classes, probabilities
from nmt_rig.rig import Rig

_UNLIKELY = math.log(1e5)


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
        by_label: probability by hypothesis; ``other`` for a named one that was not among those that competed.
        signs: what the probabilities follow from, see :data:`nmt_diagnose.inference.confidence.RANGES`.
    """

    none: float
    unknown: float
    classes: tuple[ExplanationClass, ...]
    places: dict[tuple[str, str], float]
    by_label: dict[str, float]
    signs: dict[str, float]

    @property
    def log_odds(self) -> float:
        """ln of all explanations over ``none``, as evidence and priors have it."""
        return self.signs["log_odds"]

    @property
    def unknown_odds(self) -> float:
        """ln of something unnamed over the named explanations, as reliabilities have it."""
        unknown = min(max(self.unknown, 1e-12), 1.0)
        named = sum(weight for label, weight in self.by_label.items() if label not in (NULL, UNKNOWN))
        return math.log(unknown / max(named, 1e-12))


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
    best: Contender | None = None,
    chance: float = 1.0,
) -> Judgement:
    """Weigh all explanations.

    Args:
        null: the model with its parameters re-fitted.
        singles, pairs: fitted explanations.
        sources: generic sources on top of the model.
        leftovers: generic sources on top of ``best``.
        candidates: all that were scanned; a fit at one of many places pays for the choice.
        rig: the model.
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
    # What a focused test finds and no source explains: noise of another kind, for example. Unlike evidence it has no
    # rival, so it counts from where chance would not get once in a hundred thousand diagnoses.
    found, behind = -math.log(max(chance, 1e-300)) - _UNLIKELY, math.log(confidence.prior_unknown)
    if best is not None:
        if len(best.candidates) == 1:
            behind += math.log(confidence.prior_effect / kinds)
        else:
            behind += math.log(2.0 * confidence.prior_pair / kinds**2)
        behind += chosen(best)
        found += best.fit.log_evidence - base
    hypotheses.append(Hypothesis(UNKNOWN, (), "", found, behind, None))
    contenders.append(None)
    if best is not None:
        for source in leftovers:
            prior = behind - math.log(max(1, len(leftovers)))
            gain = best.fit.log_evidence - base + source.gain - inexact(best)
            hypotheses.append(Hypothesis(UNKNOWN, (), f"{source.place}|{source.detail}", gain, prior, None))
            contenders.append(None)
    weights = probabilities(hypotheses)
    classes = _classes(weights, contenders, confidence.equivalence)
    plain = np.array([h.log_prior + h.log_evidence for h in hypotheses])
    named = np.array([value for value, h in zip(plain, hypotheses, strict=True) if h.label not in (NULL, UNKNOWN)])
    unnamed = np.array([value for value, h in zip(plain, hypotheses, strict=True) if h.label == UNKNOWN])
    signs = _signs(plain[0], named, unnamed, classes, max((s.gain for s in leftovers), default=0.0))
    return _calibrated(weights, hypotheses, contenders, classes, signs, rig, confidence)


def _signs(
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
        "together": float(first is not None and _together(first.head.candidates)),
        "margin": math.log(max(first.probability, 1e-300) / max(others, 1e-300)) if first else -math.inf,
        "sigmas": math.log1p(first.head.sigmas) if first else 0.0,
        "rivals": float(len(first.members) - 1) if first else 0.0,
    }


def _together(candidates: Sequence[Candidate]) -> bool:
    """Whether two effects act at one point or channel: one that has no name is often imitated so."""
    points = [re.findall(r"\d+", candidate.placement.label) for candidate in candidates]
    return len(points) > 1 and bool(points[0]) and all(own == points[0] for own in points)


def _odds(left: FloatArray, right: FloatArray) -> float:
    if not left.size:
        return -math.inf
    return float(np.logaddexp.reduce(left) - np.logaddexp.reduce(right)) if right.size else math.inf


def _calibrated(
    weights: FloatArray,
    hypotheses: Sequence[Hypothesis],
    contenders: Sequence[Contender | None],
    classes: tuple[ExplanationClass, ...],
    signs: dict[str, float],
    rig: Rig,
    confidence: Confidence,
) -> Judgement:
    """Probabilities as often right as they say: shares within none, unnamed and named stay in proportion."""
    gap = confidence.gap.probability(signs)
    unnamed = confidence.unnamed.probability(signs) if classes else 1.0
    first = confidence.first.probability(signs)
    named = gap * (1.0 - unnamed)
    scaled = []
    others = sum(group.probability for group in classes[1:])
    left = named * (1.0 - first)
    for rank, group in enumerate(classes):
        # None of the others may become more probable than the first by what is left for all.
        share = named * first if rank == 0 else min(left * group.probability / max(others, 1e-300), named * first)
        scaled.append(replace(group, probability=share))
    by_label = {NULL: 1.0 - gap, UNKNOWN: gap * unnamed}
    factors = np.zeros(weights.size)
    for before, after in zip(classes, scaled, strict=True):
        effects = {item for item, contender in enumerate(contenders) if contender is not None and contender.candidates
                   and contender.effects in before.effects}  # fmt: skip
        total = sum(float(weights[k]) for k in effects)
        for k in effects:
            factors[k] = after.probability * (float(weights[k]) / total if total > 0.0 else 1.0 / len(effects))
    sources = np.array([h.label == UNKNOWN for h in hypotheses])
    mass = float(weights[sources].sum())
    if mass > 0.0:
        factors[sources] = gap * unnamed * weights[sources] / mass
    factors[0] = 1.0 - gap
    for factor, hypothesis in zip(factors, hypotheses, strict=True):
        if hypothesis.label not in (NULL, UNKNOWN):
            by_label[hypothesis.label] = by_label.get(hypothesis.label, 0.0) + float(factor)
    by_label[OTHER] = max(0.0, 1.0 - sum(by_label.values()))
    places = _places(factors[1:], hypotheses[1:], contenders[1:], rig)
    return Judgement(1.0 - gap, gap * unnamed, tuple(scaled), places, by_label, signs)


def with_share_left(judgement: Judgement, left: float) -> Judgement:
    """The judgement where the best named explanation leaves only so small a share of the gap on data it has not seen.

    Something unnamed may then lie behind it, but it is not what the gap is made of: its probability counts for the
    share that is left, the rest goes to the named explanations.

    Args:
        judgement: without regard to unseen data.
        left: share of the gap that is left, 0 to 1.
    """
    unknown = judgement.unknown * left
    named = 1.0 - judgement.none - judgement.unknown
    factor = (1.0 - judgement.none - unknown) / named if named > 0.0 else 1.0
    by_label = {
        label: value if label == NULL else unknown if label == UNKNOWN else value * factor
        for label, value in judgement.by_label.items()
    }
    classes = tuple(replace(group, probability=group.probability * factor) for group in judgement.classes)
    return replace(judgement, unknown=unknown, classes=classes, by_label=by_label)


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
            if not hypothesis.place:
                continue  # a test that does not tell the place
            place, _, detail = hypothesis.place.partition("|")
            keys = [(place, detail)]
        else:
            keys = [place_of(candidate, rig) for candidate in contender.candidates]
        for key in keys:
            result[key] = result.get(key, 0.0) + float(weight) / len(keys)
    total = sum(result.values())
    return {key: value / total for key, value in sorted(result.items(), key=lambda item: -item[1])} if total else {}
