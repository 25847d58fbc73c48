"""What the comparison of explanations came to: the verdict, and which explanation is stated."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

from nmt_core.errors import BenchError
from nmt_diagnose.diagnosis_settings import DiagnosisSettings
from nmt_diagnose.effects.location import Explanation
from nmt_diagnose.fit.explanations import FittedExplanation
from nmt_diagnose.law.reading import LawReading
from nmt_diagnose.ledger.comparison import Comparison, EquivalentClass, by_plain_effect
from nmt_diagnose.ledger.diagnosis import Verdict
from nmt_diagnose.ledger.gap import ClosedShare
from nmt_diagnose.ledger.held_out import HeldOut
from nmt_diagnose.ledger.row import Facts
from nmt_diagnose.ledger.rules import verdict_of
from nmt_diagnose.ledger.size import change_size, over
from nmt_diagnose.search.findings import Findings
from nmt_diagnose.thresholds import THRESHOLDS


@dataclass(frozen=True)
class Judgement:
    """What a diagnosis decided.

    Attributes:
        findings: the explanations that were fitted.
        comparison: of them, one effect at its head where it closes most of a gap that two may not explain.
        shares: of the gap on data held out, of those that were judged.
        alone: facts of the model alone.
        verdict: that they come to.
    """

    findings: Findings
    comparison: Comparison
    shares: Mapping[Explanation, ClosedShare]
    alone: Facts
    verdict: Verdict

    @property
    def leader(self) -> EquivalentClass | None:
        """The most probable class."""
        return self.comparison.classes[0] if self.comparison.classes else None

    @property
    def named(self) -> EquivalentClass | None:
        """What is stated as the cause."""
        return self.leader if self.verdict is Verdict.EFFECT else None

    @property
    def nearest(self) -> EquivalentClass | None:
        """The same, or what explains a part where nothing in the library explains the whole."""
        return self.leader if self.verdict.gap else None

    @property
    def adequate(self) -> bool:
        """Whether what is stated leaves noise, or what does not matter."""
        return self.verdict is not Verdict.UNKNOWN and (self.named is None or self.named.adequate)

    @property
    def partial(self) -> bool:
        """Whether what is stated is a part of what acts."""
        return self.verdict is Verdict.EFFECT and not self.adequate

    @property
    def best(self) -> FittedExplanation:
        """The model as it came out: with what is stated, or alone."""
        return self.findings.null if self.named is None else self.named.head

    @property
    def reported(self) -> FittedExplanation:
        """What the rest of the gap is told by: with what comes nearest, or alone."""
        return self.findings.null if self.nearest is None else self.nearest.head

    @property
    def law(self) -> LawReading | None:
        """The law of held levels where it is told: nothing in the library is the whole, and the rest is in order."""
        in_order = not (self.findings.inadequate or self.findings.factors)
        return self.findings.law if self.partial or (self.verdict is Verdict.UNKNOWN and in_order) else None

    @property
    def law_leads(self) -> bool:
        """Whether the law is the answer and is written: nothing is stated, or what is stated closes less than it."""
        law = self.law
        if law is None or not law.is_written:
            return False
        return (
            self.nearest is None
            or not self.partial
            or law.closes_more_than(self.shares[self.nearest.head.explanation].value)
        )


def judged(findings: Findings, held_out: HeldOut, settings: DiagnosisSettings) -> Judgement:
    """The judgement of some findings.

    Args:
        findings: explanations, fitted and compared.
        held_out: what they predict of rows that their fits did not see.
        settings: of the diagnosis.
    """
    comparison = findings.comparison
    shares = {it.head.explanation: held_out.closed(it.head) for it in comparison.to_judge()}
    comparison = by_plain_effect(comparison, shares)
    leader = comparison.classes[0] if comparison.classes else None
    share = None if leader is None else shares[leader.head.explanation]
    alone = _alone(findings, settings)
    rival = max(comparison.unknown, comparison.none)
    verdict = verdict_of(alone, None if leader is None else leader.facts(share, rival))
    return Judgement(findings, comparison, shares, alone, verdict)


def _alone(findings: Findings, settings: DiagnosisSettings) -> Facts:
    """What the rules ask of the model alone: whether there is a gap, and what re-fitting its own parameters does."""
    data, null = findings.data, findings.null
    fall = (findings.as_given_errors.cost - null.fit.cost) / THRESHOLDS.verdict.recalibration_cost_fall
    facts = Facts(
        log_odds=findings.comparison.log_odds,
        modes=len(findings.inadequate),
        factors=len(findings.factors),
        left=max(
            findings.unexplained[0] / THRESHOLDS.verdict.unexplained_share,
            0.0 if findings.contradiction is None else findings.contradiction.over,
        ),
        left_without=fall,
    )
    if fall < 1.0:
        return facts
    try:
        values = data.forward.predict(null.rig, null.fit.prediction).values
    except BenchError:
        return replace(facts, change=math.inf)
    size = change_size(data, data.forward.difference(values, findings.as_given.values))
    return replace(facts, change=over(size, settings.matters))
