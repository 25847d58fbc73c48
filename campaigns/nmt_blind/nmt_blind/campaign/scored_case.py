"""A case with its truth and what the diagnosis said of it, in the terms that scores are made of."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

EffectSet = frozenset[str]

ALARMS = ("effect", "unknown")


@dataclass(frozen=True)
class Answer:
    """What a method says of a case.

    Attributes:
        alarm: it claims a gap that the model's own parameters do not close.
        gap_score: the larger, the more of a gap.
        ranking: explanations, best first; each a set of equivalents, each of these a set of effects.
        unknown_score: the larger, the more something unnamed; None = the method cannot say.
    """

    alarm: bool
    gap_score: float
    ranking: tuple[frozenset[EffectSet], ...]
    unknown_score: float | None = None

    def first(self, truth: EffectSet) -> bool:
        """The best explanation, or one of its equivalents, is the truth."""
        return bool(self.ranking) and truth in self.ranking[0]

    def among(self, truth: EffectSet, count: int = 3) -> bool:
        """All effects of the truth occur among the first explanations."""
        found = {name for group in self.ranking[:count] for effects in group for name in effects}
        return bool(truth) and truth <= found


@dataclass(frozen=True)
class Estimate:
    """A parameter of an effect that was named rightly.

    Attributes:
        effect: name of the effect.
        name: of the parameter.
        truth: its true value.
        value, std: what the diagnosis states.
    """

    effect: str
    name: str
    truth: float
    value: float
    std: float

    @property
    def deviation(self) -> float:
        """Stated standard uncertainties between truth and value; infinite where none is stated."""
        off = abs(self.value - self.truth)
        if self.std > 0.0:
            return off / self.std
        return 0.0 if off == 0.0 else math.inf


@dataclass(frozen=True)
class ScoredCase:
    """One case.

    Attributes:
        name: its number.
        kind: null, effect, open, compound, twin or withheld.
        truth: names of its effects.
        places: where they act.
        sigma: strength of the weakest of them, standard deviations; 0 without, infinite where it is not known: such an
            effect counts with those that must be found.
        shifted: parameters of the model were off.
        withheld: what the library did without.
        verdict: of the diagnosis; ``failed`` where there is none.
        answer: of the diagnosis.
        place: the most probable place, empty if none was named.
        confidence: probability of what the diagnosis settled on.
        settled: labels that it settled on: none, unknown or sets of effects.
        closed, before, after: of the held-out gap; NaN if not known.
        details: the diagnosis.
        sindy: answer of the sparse regression, if it was made.
        seconds: computing time.
        estimates: of the parameters of effects that were named rightly, at the right point or channel.
    """

    name: str
    kind: str
    truth: EffectSet
    places: frozenset[str]
    sigma: float
    shifted: bool
    withheld: str
    verdict: str
    answer: Answer
    place: str
    confidence: float
    settled: str
    closed: float
    before: float
    after: float
    floor: float
    details: dict[str, Any] = field(default_factory=dict)
    sindy: dict[str, Any] = field(default_factory=dict)
    seconds: float = math.nan
    estimates: tuple[Estimate, ...] = ()

    @property
    def covered(self) -> tuple[bool, ...]:
        """Of each effect that was named rightly, whether all its parameters lie within 3 standard uncertainties."""
        worst: dict[str, float] = {}
        for estimate in self.estimates:
            worst[estimate.effect] = max(worst.get(estimate.effect, 0.0), estimate.deviation)
        return tuple(deviation <= 3.0 for deviation in worst.values())

    @property
    def known(self) -> bool:
        """The library has what is true, and something is."""
        return self.kind in ("effect", "twin", "compound")

    @property
    def single(self) -> bool:
        """One effect that the library has."""
        return self.kind in ("effect", "twin")

    @property
    def unknown(self) -> bool:
        """What is true is not in the library."""
        return self.kind in ("open", "withheld")

    @property
    def settled_rightly(self) -> bool:
        """What the diagnosis settled on is the truth."""
        if self.settled == "none":
            return self.kind == "null"
        if self.settled == "unknown":
            return self.unknown
        return self.known and self.answer.first(self.truth)


def effect_set(text: str) -> EffectSet:
    """Names of effects joined by plus signs, without places."""
    return frozenset(part.partition("@")[0].strip() for part in text.split("+") if part.strip())


def scored_case(truth: dict[str, Any], result: dict[str, Any]) -> ScoredCase:
    """Bring a case's truth and its result together.

    Args:
        truth: the case's entry in the sealed file.
        result: the file that the campaign's run has written.
    """
    effects = truth["effects"]
    diagnosis = result.get("diagnosis") or {}
    ranking = tuple(
        frozenset({effect_set(entry["effect"]), *(effect_set(text) for text in entry.get("equivalents", ()))})
        for entry in diagnosis.get("ranking", ())
    )
    verdict = str(diagnosis.get("verdict", "failed"))
    probabilities = {name: float(p or 0.0) for name, p in diagnosis.get("probabilities", {}).items()}
    none = probabilities.get("none", 0.0) + probabilities.get("calibration", 0.0)
    unknown = probabilities.get("unknown", 0.0)
    features = diagnosis.get("features", {})
    # Odds before they are rounded to a probability of 1 order the cases better.
    gap_score = _number(features.get("feature:log_odds"), _log_odds(1.0 - none) if diagnosis else -math.inf)
    unknown_score = _log_odds(unknown / max(1.0 - none, 1e-12)) if diagnosis else -math.inf
    first = float(diagnosis["ranking"][0]["probability"] or 0.0) if diagnosis.get("ranking") else 0.0
    settled = max((("none", none), ("unknown", unknown), ("effect", first)), key=lambda item: item[1])
    where = sorted(diagnosis.get("where", ()), key=lambda entry: -float(entry.get("p") or 0.0))
    gap = diagnosis.get("gap", {})
    return ScoredCase(
        name=str(truth["case"]),
        kind=str(truth["kind"]),
        truth=frozenset(str(effect["name"]) for effect in effects),
        places=frozenset(str(effect["place"]) for effect in effects),
        sigma=min((_number(effect.get("sigma"), math.inf) for effect in effects), default=0.0),
        shifted=bool(truth["shifted"]),
        withheld=str(truth["withheld"]),
        verdict=verdict,
        answer=Answer(verdict in ALARMS, gap_score, ranking, unknown_score),
        place=str(where[0]["place"]) if where else "",
        confidence=settled[1],
        settled=settled[0],
        closed=_number(gap.get("closed")),
        before=_number(gap.get("before")),
        after=_number(gap.get("after")),
        floor=_number(gap.get("floor")),
        details=diagnosis,
        sindy=diagnosis.get("sindy") or {},
        seconds=_number(result.get("seconds")),
        estimates=_estimates(effects, diagnosis) if verdict == "effect" else (),
    )


def _estimates(effects: Sequence[Mapping[str, Any]], diagnosis: Mapping[str, Any]) -> tuple[Estimate, ...]:
    """True and stated parameters of the effects that the first explanation names, where it names all of them."""
    head = next(iter(diagnosis.get("ranking", ())), None)
    if head is None or effect_set(head["effect"]) != frozenset(str(effect["name"]) for effect in effects):
        return ()
    stated: Mapping[str, Mapping[str, Any]] = head.get("parameters", {})
    found = []
    for effect in effects:
        name, spot = str(effect["name"]), str(effect.get("detail", "")).split(" at ")[0]
        for key, truth in effect.get("figures", {}).items():
            for label, value in stated.items():
                # Of two effects, parameters are named effect@detail.parameter.
                cause, _, parameter = label.rpartition(".")
                named, _, detail = cause.partition("@") if cause else (name, "", str(head.get("detail", "")))
                detail = detail.split(" at ")[0]
                if parameter == key and named == name and (not detail or not spot or detail == spot):
                    found.append(
                        Estimate(name, key, float(truth), _number(value.get("value")), _number(value.get("std")))
                    )
    return tuple(found)


def _number(value: Any, otherwise: float = math.nan) -> float:
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else otherwise


def _log_odds(p: float) -> float:
    p = min(max(p, 1e-300), 1.0 - 1e-16)
    return math.log(p / (1.0 - p))
