"""Fitted explanations as values: what they need, how strong, the best of each."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from nmt_core.numerics.arrays import FloatArray
from nmt_diagnose.chain.chain_columns import SharedDelay
from nmt_diagnose.effects.effect import Candidate
from nmt_diagnose.effects.location import Explanation
from nmt_diagnose.fit.fitting import FitResult
from nmt_diagnose.ledger.row import Facts
from nmt_rig.rig import Rig


@dataclass(frozen=True)
class FittedExplanation:
    """A fitted explanation.

    Attributes:
        candidates: its effects at their places; none for the model alone.
        fit: the fit.
        small: numbers of those candidates without which the residual would not matter: they are not reported.
        comparisons: what candidates do compared with simpler explanations, as rules ask for it, by number.
    """

    candidates: tuple[Candidate, ...]
    fit: FitResult
    small: frozenset[int] = frozenset()
    comparisons: Mapping[int, Facts] = field(default_factory=dict)

    @cached_property
    def fitted(self) -> Explanation:
        """All its effects at their places as values that compare."""
        return Explanation(tuple(candidate.cause for candidate in self.candidates))

    @property
    def stated(self) -> tuple[int, ...]:
        """Numbers of the candidates that it needs."""
        return tuple(k for k in range(len(self.candidates)) if k not in self.small)

    @cached_property
    def explanation(self) -> Explanation:
        """The effects that it needs, at their places."""
        return Explanation(tuple(self.candidates[k].cause for k in self.stated))

    @property
    def effects(self) -> tuple[str, ...]:
        """Names of its effects, sorted."""
        return self.explanation.effects

    @property
    def rig(self) -> Rig:
        """Its rig; what belongs to the measuring chain stays as given."""
        parameters = self.fit.parametrisation.calibration
        theta = self.fit.theta.copy()
        theta[[k for k, parameter in enumerate(parameters) if isinstance(parameter, SharedDelay)]] = 0.0
        return self.fit.parametrisation.rig(theta)

    def scale(self, gap: bool = True) -> FloatArray:
        """What residuals over σ are multiplied by to be in standard deviations of the noise, (m,).

        The residual of a gap enlarges the scale that an explanation learns. That part of the scale is not noise.
        """
        weights = self.fit.errors.weights
        return np.asarray(np.sqrt(np.maximum(weights, 1.0) if gap else weights))

    def strength(self, member: int) -> float:
        """Strength of one effect over its standard uncertainty."""
        selected = self.fit.parametrisation.index_of(member)
        parameters = self.candidates[member].effect.parameters
        sizes = np.abs(self.fit.theta[selected]) / self.fit.std[selected]
        return max((float(s) for s, p in zip(sizes, parameters, strict=True) if p.kind == "strength"), default=0.0)

    @property
    def sigmas(self) -> float:
        """Strength of the weakest effect that it needs, of all where it needs none; 0 without effects."""
        members = self.stated or range(len(self.candidates))
        return min((self.strength(member) for member in members), default=0.0)


@dataclass(frozen=True)
class LeftOut:
    """An explanation that was fitted and does not compete.

    Attributes:
        found: the explanation.
        model_alone: the model alone, fitted to the same data.
        behind: ln evidence that it lies behind the best.
        behind_most: that the last one lies behind that competes, where as many compete as may; else infinite.
    """

    found: FittedExplanation
    model_alone: FittedExplanation
    behind: float
    behind_most: float = math.inf


@dataclass(frozen=True)
class Score:
    """What a candidate promises on top of a fit.

    Attributes:
        candidate: its number.
        start: its parameters, strength included.
        gain: fall of the cost.
        reach: standard deviations for each unit of strength.
        column: change of the rows over the strength, over σ, (m,).
        signed: whether the strength may have either sign.
        origin: parameters that the column is of, of strength 0 where it is a derivative there; None = not known.
    """

    candidate: int
    start: FloatArray
    gain: float
    reach: float
    column: FloatArray
    signed: bool = True
    origin: FloatArray | None = None


def best_of(found: Sequence[FittedExplanation]) -> list[FittedExplanation]:
    """The best fit of each explanation, the best first."""
    best: dict[Explanation, FittedExplanation] = {}
    for explanation in found:
        known = best.get(explanation.explanation)
        if known is None or explanation.fit.log_evidence > known.fit.log_evidence:
            best[explanation.explanation] = explanation
    return sorted(best.values(), key=lambda explanation: -explanation.fit.log_evidence)


def best_by_effect(found: Sequence[FittedExplanation]) -> list[FittedExplanation]:
    """The first of each set of effects."""
    heads: dict[tuple[str, ...], FittedExplanation] = {}
    for explanation in found:
        heads.setdefault(explanation.effects, explanation)
    return list(heads.values())
