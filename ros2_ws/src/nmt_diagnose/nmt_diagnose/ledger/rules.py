"""The rules by which an explanation is stated or not, in the order in which they are asked.

Each has a name, a sentence, a number of the explanation and a limit. The first that an explanation fails is the reason
why it is not stated. What is behind them: docs/decisions/031-rules-of-the-verdict.md.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from dataclasses import dataclass, replace

from scipy.special import ndtri

from nmt_diagnose.ledger.diagnosis import Verdict
from nmt_diagnose.ledger.row import Facts, Ruling
from nmt_diagnose.thresholds import THRESHOLDS


@dataclass(frozen=True)
class Rule:
    """A rule.

    Attributes:
        name: as ``--why`` prints it.
        sentence: what has to hold.
        unit: of number and limit.
        number: of an explanation.
        limit: for it.
        holds: whether number and limit are as they have to be.
    """

    name: str
    sentence: str
    unit: str
    number: Callable[[Facts], float]
    limit: Callable[[Facts], float]
    holds: Callable[[float, float], bool] = operator.ge

    def __call__(self, facts: Facts) -> Ruling:
        """The rule applied; what was not asked passes."""
        number, limit = float(self.number(facts)), float(self.limit(facts))
        return Ruling(self.name, number, limit, math.isnan(number) or bool(self.holds(number, limit)), facts.part)


def furthest_credible(parameters: int) -> float:
    """Prior standard deviations that the furthest of some parameters may be from its prior mean (Bonferroni)."""
    chance = THRESHOLDS.comparison.incredible_probability / (2.0 * max(parameters, 1))
    return float(-ndtri(chance))


def _pull_limit(facts: Facts) -> float:
    if facts.part:
        return THRESHOLDS.verdict.partial_pulled_sigmas
    return furthest_credible(facts.parameters)


def _least_closed(facts: Facts) -> float:
    limits = THRESHOLDS.verdict
    return limits.partial_closed_share if facts.effects < 2 else limits.partial_closed_share_of_two


PROMISING = Rule(
    "promising",
    "The score test promises a fall of the cost that is worth a fit, and as large as that of those that are fitted.",
    "−2 ln p",
    lambda facts: facts.promised,
    lambda facts: max(THRESHOLDS.search.least_cost_fall, facts.promised_least),
)
IN_REACH = Rule(
    "near",
    "Its evidence is not far behind that of the best explanation.",
    "ln evidence",
    lambda facts: facts.behind,
    lambda facts: min(THRESHOLDS.search.far_behind_log_evidence, facts.behind_most),
    operator.le,
)
NEEDED = Rule(
    "needed",
    "Without it more is left than noise that matters, or the evidence demands it, or model and measuring chain are "
    "further from their priors.",
    "of the limit",
    lambda facts: facts.left_without,
    lambda facts: 1.0,
)
WITHIN = Rule(
    "within",
    "What only brings model and measuring chain back to their priors: rows leave what matters without it "
    "where they stay there, or it is of a sensor.",
    "of the limit (--matters)",
    lambda facts: facts.left_within,
    lambda facts: 1.0,
)
MATTERS = Rule(
    "matters",
    "It changes the predictions by what matters.",
    "of the limit (--matters)",
    lambda facts: facts.change,
    lambda facts: 1.0,
)
GAP = Rule(
    "gap",
    "Something is missing: the odds of any gap are large enough.",
    "ln odds",
    lambda facts: facts.log_odds,
    lambda facts: THRESHOLDS.verdict.alarm_log_odds,
)
COMPARABLE = Rule(
    "comparable",
    "The model has the modes of the recordings in their order, and no channel has another unit or sign.",
    "modes and channels",
    lambda facts: facts.modes + facts.factors,
    lambda facts: 0.0,
    operator.le,
)
PREDICTS = Rule(
    "predicts",
    "Data held out from the fit are predicted no worse than by the model alone.",
    "σ",
    lambda facts: facts.worse,
    lambda facts: THRESHOLDS.verdict.worse_prediction_sigmas,
    operator.le,
)
LEFT = Rule(
    "left",
    "What it leaves is noise, or smaller than what matters.",
    "of the limit (--matters)",
    lambda facts: facts.left,
    lambda facts: 1.0,
    operator.lt,
)
CREDIBLE = Rule(
    "credible",
    "No parameter of the model has an implausible value.",
    "σ",
    lambda facts: facts.pull,
    _pull_limit,
    operator.le,
)
SINGLE = Rule(
    "single",
    "It is not two laws of the structure, which together take the shape of one that the library lacks.",
    "laws",
    lambda facts: facts.laws,
    lambda facts: 1.0,
    operator.le,
)
LIKELY = Rule(
    "likely",
    "It is more probable than every other answer; as a partial cause, nearly certain among the library.",
    "1",
    lambda facts: facts.among_library if facts.part else facts.probability,
    lambda facts: THRESHOLDS.verdict.cause_probability if facts.part else facts.rival,
)
CLOSES = Rule(
    "closes",
    "As a partial cause it closes most of the gap on data held out, two effects nearly all of it.",
    "1",
    lambda facts: facts.closed,
    _least_closed,
)

OF_SEARCH = (PROMISING, IN_REACH)
"""Which explanations are fitted to the end."""
OF_EFFECTS = (NEEDED, WITHIN, MATTERS)
"""Which effects of an explanation are stated, and whether the model's own parameters were off."""
OF_ALL = (COMPARABLE, GAP)
"""Whether anything is stated."""
OF_THE_WHOLE = (LEFT, CREDIBLE, SINGLE, LIKELY)
"""What explains the whole of a gap."""
OF_A_PART = (CLOSES, LIKELY, CREDIBLE)
"""What explains a part of it and is established all the same."""
RULES = (*OF_SEARCH, *OF_EFFECTS, *OF_ALL, PREDICTS, *OF_THE_WHOLE, CLOSES)
"""All rules."""


def rule_named(name: str) -> Rule:
    """The rule of a name."""
    return next(rule for rule in RULES if rule.name == name)


def pass_all(rules: tuple[Rule, ...], facts: Facts) -> bool:
    """Whether an explanation passes all of some rules."""
    return all(rule(facts).passed for rule in rules)


def rulings_of(facts: Facts) -> tuple[Ruling, ...]:
    """The rules for a verdict applied to an explanation: to the whole of a gap and, where that fails, to a part."""
    first = tuple(rule(facts) for rule in (*OF_ALL, PREDICTS, *OF_THE_WHOLE))
    if all(ruling.passed for ruling in first) or not first[len(OF_ALL)].passed:
        return first
    part = replace(facts, part=True)
    return (*first, *(rule(part) for rule in OF_A_PART))


def verdict_of(alone: Facts, leader: Facts | None) -> Verdict:
    """The verdict.

    Args:
        alone: of the model alone: whether there is a gap, and whether its own parameters were off.
        leader: of the most probable class of explanations; None where there is none.
    """
    if not COMPARABLE(alone).passed:
        return Verdict.UNKNOWN
    if not GAP(alone).passed:
        if not LEFT(alone).passed:
            return Verdict.UNKNOWN
        return Verdict.CALIBRATION if pass_all(OF_EFFECTS, alone) else Verdict.NONE
    if leader is None or not PREDICTS(leader).passed:
        return Verdict.UNKNOWN
    # Something unnamed lies behind a part; a law without a rival that closes most of the gap is named all the same.
    explained = pass_all(OF_THE_WHOLE, leader) or pass_all(OF_A_PART, replace(leader, part=True))
    return Verdict.EFFECT if explained else Verdict.UNKNOWN
