"""A fitted explanation, and what is asked of it again and again."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from nmt_diagnose.effects.effect import Candidate
from nmt_diagnose.effects.parametrisation import SPREADS
from nmt_diagnose.effects.placement import Explanation
from nmt_diagnose.inference.fit import Fit
from nmt_diagnose.inference.scan import Score

# Penalty of the prior for each parameter from which a fit is doubted.
_INCREDIBLE = 2.0
# Prior standard deviations of a strength from which a wider part of its prior is tried.
_WIDER = 2.5


@dataclass(frozen=True)
class FittedModel:
    """A fitted explanation.

    Attributes:
        candidates: its effects at their places; empty for the model with only its parameters re-fitted.
        fit: the fit.
        score: its score in the scan; None for the model without effect.
    """

    candidates: tuple[Candidate, ...]
    fit: Fit
    score: Score | None = None

    @cached_property
    def explanation(self) -> Explanation:
        """Its effects at their places as values that compare."""
        return Explanation(tuple(candidate.cause for candidate in self.candidates))

    @property
    def effects(self) -> tuple[str, ...]:
        """Names of its effects, sorted."""
        return self.explanation.effects

    @property
    def sigmas(self) -> float:
        """Strength of its weakest effect over its standard uncertainty; 0 without effects."""
        return min((self.strength(member) for member in range(len(self.candidates))), default=0.0)

    def strength(self, member: int) -> float:
        """Strength of one of its effects over its standard uncertainty."""
        own = self.fit.parametrisation.index_of(member)
        strengths = [
            abs(float(self.fit.theta[own][k])) / float(self.fit.std[own][k])
            for k, parameter in enumerate(self.candidates[member].effect.parameters)
            if parameter.kind == "strength"
        ]
        return max(strengths, default=0.0)


def without_member(fitted_model: FittedModel, member: int) -> tuple[Candidate, ...]:
    """Effects of an explanation but for one."""
    return tuple(c for k, c in enumerate(fitted_model.candidates) if k != member)


def refitted_whole(before: FittedModel, found: Fit) -> FittedModel | None:
    """An explanation with a new fit; None where that leaves out rows which it explained before."""
    if np.any(before.fit.used & ~found.used):
        return None
    return FittedModel(before.candidates, found, before.score)


def united(added: list[FittedModel], known: Sequence[FittedModel]) -> list[FittedModel]:
    """Fits, and known ones where they are better than the same explanation fitted anew."""
    for own in known:
        competing = [other for other in added if other.explanation == own.explanation]
        if all(own.fit.log_evidence > other.fit.log_evidence + 0.5 for other in competing):
            added = [other for other in added if other.explanation != own.explanation] + [own]
    return added


def best_by_effect(fitted_models: Sequence[FittedModel]) -> list[FittedModel]:
    """The first of each set of effects, in their order."""
    seen: set[tuple[str, ...]] = set()
    result = []
    for fitted_model in fitted_models:
        if fitted_model.effects not in seen:
            seen.add(fitted_model.effects)
            result.append(fitted_model)
    return result


def held_back(found: Fit, candidate: int) -> bool:
    """Whether the prior holds a strength of a candidate back."""
    own = found.parametrisation.index_of(candidate)
    share = np.abs(found.theta[own]) / found.parametrisation.prior_std[own]
    strengths = [p.kind == "strength" for p in found.parametrisation.candidates[candidate].effect.parameters]
    return bool(np.any(share[strengths] > _WIDER))


def wider_spread(spread: float) -> float:
    """The next wider part of a strength's prior; the widest itself."""
    return next((value for value in SPREADS if value > spread), spread)


def rms_left(fitted_model: FittedModel) -> float:
    """Rms of what a fit leaves of the rows that it used, in standard deviations."""
    return math.sqrt(fitted_model.fit.chi_square / max(1, int(fitted_model.fit.used.sum())))


def is_incredible(found: Fit) -> bool:
    """Whether nobody believes the parameters of a fit."""
    return found.penalty > _INCREDIBLE * max(1, found.theta.size)
