"""Effects that may act and are too weak for the recordings at hand, and the probability that further tests show them.

An effect that the recordings at hand show from a strength s on shows from s/ρ on once a further test is added. ρ is the
ratio of standard deviations, with and without that test, by which a unit of the effect differs from changes of
parameters and measuring chain. The prior of a strength is uniform in its logarithm: a further test adds ln ρ of the ln
of its range. That goes on until the share of effects remains that no test shows.

An effect that shows and is too small to matter has a fitted law, from which its size at the remaining levels follows.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import entr, ndtr

from nmt_core.errors import BenchError
from nmt_core.numerics.arrays import BoolArray, FloatArray
from nmt_diagnose.ahead.ahead import Ahead
from nmt_diagnose.fit.candidate_starts import at_strength, strength_position
from nmt_diagnose.fit.explanations import FittedExplanation, Score
from nmt_diagnose.ledger.size import size_of_change
from nmt_diagnose.measurements.measurement import Observations
from nmt_diagnose.prediction.forward import Forward
from nmt_diagnose.search.search import Search
from nmt_diagnose.thresholds import THRESHOLDS

_NO_SOLUTION = (BenchError, ValueError, ArithmeticError, np.linalg.LinAlgError)


@dataclass(frozen=True)
class Hidden:
    """What these recordings are too weak to show.

    Attributes:
        probability: that something acts which the tests that are left would show, or show to matter.
        next: the same of the next of them.
    """

    probability: float
    next: float

    @property
    def information(self) -> float:
        """Fall of the entropy of whether something acts that is expected of the next test, nats."""
        if not 0.0 < self.probability < 1.0:
            return 0.0
        left = max(0.0, self.probability - self.next) / (1.0 - self.next)
        return max(0.0, _entropy(self.probability) - (1.0 - self.next) * _entropy(left))

    def combined_with(self, other: Hidden) -> Hidden:
        """What is hidden for one of two reasons that have nothing to do with each other."""
        return Hidden(
            1.0 - (1.0 - self.probability) * (1.0 - other.probability), 1.0 - (1.0 - self.next) * (1.0 - other.next)
        )


class Growth:
    """Probability that an effect that shows and does not matter yet matters at the remaining levels.

    Its change of the predictions there is proportional to its strength. It is the change from the model alone, which
    took a part of the effect in the recordings at hand. The change has to matter, and has to leave more than noise once
    the model is refitted: both hold from a share 1/r of the fitted strength on.

    Args:
        found: what shows, fitted to the recordings at hand.
        probability: that it acts.
        left: observables of the remaining tests with expected uncertainties; values are not set.
        ahead: the model alone in these tests.
        wanted: what matters, by kind.
    """

    def __init__(
        self,
        found: FittedExplanation,
        probability: float,
        left: Observations,
        ahead: Ahead,
        wanted: Mapping[str, float],
    ) -> None:
        self._found, self._probability, self._wanted = found, probability, wanted
        forward, fitted = Forward(left.tests, left.rows), found.fit
        self._left, self._ahead, self._change = left, ahead, np.full(len(left.rows), np.nan)
        try:
            there = forward.predict(fitted.parametrisation.rig(fitted.theta), ahead.base)
        except _NO_SOLUTION:
            return
        self._left = replace(left, values=ahead.base.values)
        self._change = forward.difference(there.values, ahead.base.values)

    def matters(self, rows: BoolArray) -> float:
        """The probability that it matters in some of the rows, (m,)."""
        known = rows & np.isfinite(self._change)
        if not known.any():
            return 0.0
        size = size_of_change(self._left, known, self._left.sigma, self._change).values
        most = max((value / max(self._wanted.get(kind, 0.0), 1e-300) for kind, value in size.items()), default=0.0)
        least = min(most, self.beyond_noise(known))
        return self._probability * float(ndtr(self._found.sigmas * (1.0 - 1.0 / least))) if least > 0.0 else 0.0

    def beyond_noise(self, known: BoolArray) -> float:
        """How much stronger it is than what leaves more than noise in a channel's rows of one kind."""
        left = self._ahead.beyond(np.nan_to_num(self._change) / self._left.sigma, known)
        rows = self._left.rows
        keys = np.stack([rows.channel[known], rows.part[known], rows.harmonic[known]])
        _, group = np.unique(keys, axis=1, return_inverse=True)
        squares, count = np.bincount(group.ravel(), left**2), np.bincount(group.ravel())
        return float(np.sqrt(np.max(squares / (THRESHOLDS.verdict.excess_sigmas * np.sqrt(2.0 * count)))))

    def levels(self, least: int) -> int:
        """How many of the levels that are left, from the lowest on, are needed to see whether it matters."""
        level = self._left.rows.level
        count = int(level.max(initial=-1)) + 1
        of_all = self.matters(level < count)
        if of_all < 0.5:
            return min(least, count)
        return next(n for n in range(min(least, count), count + 1) if self.matters(level < n) > 0.5 * of_all)


def hidden_effects(
    search: Search,
    null: FittedExplanation,
    scores: Sequence[Score],
    ahead: Ahead,
    of_next: BoolArray,
) -> Hidden:
    """What tests that are left would show, where those at hand show no gap.

    Args:
        search: has the candidates.
        null: the model alone, fitted.
        scores: of the candidates on top of it.
        ahead: the model alone in the tests that are left.
        of_next: which of their rows are of the next test, (m,).
    """
    strongest: dict[str, Score] = {}
    for score in scores:
        name = search.candidates[score.candidate].effect.name
        if (
            score.reach > 0.0
            and score.origin is not None
            and (name not in strongest or score.reach > strongest[name].reach)
        ):
            strongest[name] = score
    if not strongest:
        return Hidden(0.0, 0.0)
    chosen = list(strongest.values())
    at_hand = np.column_stack([score.column for score in chosen])
    now = ahead.reach(at_hand, at_hand, None)
    shows = now > 0.0
    chosen, at_hand, now = [it for it, ok in zip(chosen, shows, strict=True) if ok], at_hand[:, shows], now[shows]
    changes = _changes(search, null, chosen, THRESHOLDS.verdict.visible_sigmas / now, ahead)
    every = np.ones(of_next.size, dtype=bool)
    with_next, with_all = (ahead.reach(at_hand, changes, rows) / now for rows in (of_next, every))
    return chances(with_next, with_all)


def chances(with_next: FloatArray, with_left: FloatArray) -> Hidden:
    """Probabilities of hidden effects.

    Args:
        with_next: factor by which each effect may be weaker and still show once the next test is added to the
            recordings at hand, ρ, (effects,).
        with_left: the same with all remaining tests.
    """
    comparison = THRESHOLDS.comparison
    acts = 1.0 - comparison.prior_none
    # Of effects that act so many show in no test: that leaves the share of tests without a gap in which one acts.
    never = comparison.too_weak_share / (1.0 - comparison.too_weak_share) * comparison.prior_none / acts
    range_of_strengths = THRESHOLDS.next_test.strength_decades * math.log(10.0)

    def share(weaker: FloatArray) -> float:
        more = np.log(np.maximum(weaker, 1.0)) / range_of_strengths
        return float(np.mean(np.minimum(more, 1.0 - never))) if weaker.size else 0.0

    of_left, of_next = share(with_left), share(with_next)
    no_gap = comparison.prior_none + acts * (never + of_left)
    return Hidden(acts * of_left / no_gap, acts * min(of_next, of_left) / no_gap)


def _changes(
    search: Search, null: FittedExplanation, scores: Sequence[Score], strengths: FloatArray, ahead: Ahead
) -> FloatArray:
    """What a unit of each effect changes in a test that has not been made, over σ, (m, effects).

    Those that show to first order by their derivatives, the others by what they do as strong as is given.
    """
    result = np.zeros((ahead.sigma.size, len(scores)))
    at_rest = [k for k, score in enumerate(scores) if _strength(search, score) == 0.0]
    result[:, at_rest] = _slopes(search, null, [scores[k] for k in at_rest], ahead)
    for k, (score, strength) in enumerate(zip(scores, strengths, strict=True)):
        if k not in at_rest:
            result[:, k] = _moved(search, null, score, float(strength), ahead) / strength
    return ahead.over_sigma(result)


def _slopes(search: Search, null: FittedExplanation, scores: Sequence[Score], ahead: Ahead) -> FloatArray:
    """Derivatives by strengths at zero, (m, effects)."""
    added, fitted, which = [search.candidates[score.candidate] for score in scores], null.fit, []
    offset = fitted.theta.size
    for candidate in added:
        which.append(offset + strength_position(candidate))
        offset += len(candidate.effect.parameters)
    theta = np.concatenate([fitted.theta, *(_origin(score) for score in scores)])
    try:
        return ahead.forward.jacobian(search.parametrisation(added), theta, ahead.base, which)
    except _NO_SOLUTION:
        return np.zeros((ahead.sigma.size, len(scores)))


def _moved(search: Search, null: FittedExplanation, score: Score, strength: float, ahead: Ahead) -> FloatArray:
    """Change by an effect of finite strength, (m,); none where the model has no solution with it."""
    candidate, fitted = search.candidates[score.candidate], null.fit
    theta = np.concatenate([fitted.theta, at_strength(candidate, _origin(score), strength)])
    try:
        found = ahead.forward.predict(search.parametrisation([candidate]).rig(theta), ahead.base)
    except _NO_SOLUTION:
        return np.zeros(ahead.sigma.size)
    return ahead.forward.difference(found.values, ahead.base.values)


def _origin(score: Score) -> FloatArray:
    assert score.origin is not None
    return score.origin


def _strength(search: Search, score: Score) -> float:
    return float(_origin(score)[strength_position(search.candidates[score.candidate])])


def _entropy(p: float) -> float:
    """Of two alternatives, nats."""
    return float(entr(p) + entr(1.0 - p))
