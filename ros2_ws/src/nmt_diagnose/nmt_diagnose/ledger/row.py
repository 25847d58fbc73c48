"""A row of the ledger: residuals, parameters and predictions of an explanation, and the rules applied to it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

_NOT_ASKED = math.nan


@dataclass(frozen=True)
class Facts:
    """Numbers of an explanation that rules ask for; NaN = not asked of it.

    Attributes:
        promised: fall of the cost by the score test, −2 ln p.
        promised_least: least promise of those that were fitted in its place.
        behind: ln evidence behind the best of those that were fitted with it.
        behind_most: ln evidence of the last that was fitted on behind the best, where there are more than may be.
        left_without: residual without its effect, over what matters; or by how much model and measuring chain move back
            to their priors, over what chance does.
        left_within: residual without its effect, over what matters, with model and measuring chain held within their
            priors; asked where the effect only moves them back there. Not asked of effects of sensors.
        change: of the predictions by its effect, over what matters.
        log_odds: ln of the odds of any gap.
        modes: of the recordings that the model lacks or has in another order.
        factors: channels that were recorded at another scale or sign.
        worse: standard deviations by which rows held out are predicted worse than by the model alone.
        left: more than noise, over what matters; of the model alone the largest share of its signal that a channel
            leaves, over what may be noise.
        pull: largest distance of a parameter of the model from its prior mean, in prior standard deviations, where its
            return would matter.
        parameters: of the model.
        laws: of the structure that act together.
        probability: of its class.
        rival: largest probability of any other class.
        among_library: probability of its class if one explanation of the library had to be the whole of the gap.
        closed: share of the gap on data held out that it closes.
        effects: that it states; two laws at two places that leave noise count as one.
        part: it is judged as a partial explanation.
    """

    promised: float = _NOT_ASKED
    promised_least: float = -math.inf
    behind: float = _NOT_ASKED
    behind_most: float = math.inf
    left_without: float = _NOT_ASKED
    left_within: float = _NOT_ASKED
    change: float = _NOT_ASKED
    log_odds: float = _NOT_ASKED
    modes: int = 0
    factors: int = 0
    worse: float = _NOT_ASKED
    left: float = _NOT_ASKED
    pull: float = _NOT_ASKED
    parameters: int = 0
    laws: int = 0
    probability: float = _NOT_ASKED
    rival: float = 0.0
    among_library: float = _NOT_ASKED
    closed: float = 0.0
    effects: int = 1
    part: bool = False


@dataclass(frozen=True)
class Ruling:
    """A rule as it was applied to an explanation.

    Attributes:
        rule: its name.
        number: of the explanation.
        limit: of the rule.
        passed: whether the explanation may be stated as far as this rule goes.
        part: whether it was applied to the explanation as a partial one.
    """

    rule: str
    number: float
    limit: float
    passed: bool
    part: bool = False


@dataclass(frozen=True)
class GroupLeft:
    """Residual of an explanation in rows that share a scale.

    Attributes:
        group: test and kind of row.
        rows: how many.
        rms: in the noise that the recordings show.
        share: of the squares of all that is left.
    """

    group: str
    rows: int
    rms: float
    share: float


@dataclass(frozen=True)
class Predicted:
    """How rows that a fit did not see were predicted; rms in standard deviations of the noise.

    Attributes:
        before, after: by the model alone and by the explanation.
        closed, low, high: share of the gap, with the interval of 90 %.
        gain: fall of the squares over its own scatter.
    """

    before: float
    after: float
    closed: float
    low: float
    high: float
    gain: float


@dataclass(frozen=True)
class LedgerRow:
    """An explanation that was fitted.

    Attributes:
        label: its effects at their places; ``none`` of the model alone.
        stated: whether the diagnosis states it.
        failed: the rule that kept it from that; empty where it is stated.
        rulings: rules in the order in which they were applied.
        effects: rules that were applied to each of its effects.
        small: those of its effects that it does not need.
        start: name of the start from which its fit was the best.
        left: its residuals, by group of rows.
        parameters: the model's, in prior standard deviations.
        chain: errors of the measuring chain beyond one prior standard deviation, the largest first.
        change: largest change of its predictions from those of the model alone by kind, over what matters.
        apart: distance of its predictions from those of other explanations, in standard deviations.
        predicted: rows that its fit did not see; None where that was not judged.
        prior: ln of its probability before the tests.
        evidence: ln evidence over that of the model alone.
        probability: after the tests.
    """

    label: str
    stated: bool
    failed: str
    rulings: tuple[Ruling, ...]
    effects: Mapping[str, tuple[Ruling, ...]]
    small: tuple[str, ...]
    start: str
    left: tuple[GroupLeft, ...]
    parameters: Mapping[str, float]
    chain: Mapping[str, float]
    change: Mapping[str, float]
    apart: Mapping[str, float]
    predicted: Predicted | None
    prior: float
    evidence: float
    probability: float


@dataclass(frozen=True)
class Promise:
    """A candidate that the score test looked at and that was not fitted.

    Attributes:
        label: the effect at its place.
        promised: fall of the cost, −2 ln p.
        ruling: the rule that passed it over.
        lost: its fit was begun and found no solution, or one that is worse than the model alone.
    """

    label: str
    promised: float
    ruling: Ruling
    lost: bool = False


@dataclass(frozen=True)
class Ledger:
    """All that a diagnosis decided on.

    Attributes:
        rows: of the explanations that were fitted, the model alone first.
        promises: candidates that were not.
    """

    rows: tuple[LedgerRow, ...] = ()
    promises: tuple[Promise, ...] = ()
