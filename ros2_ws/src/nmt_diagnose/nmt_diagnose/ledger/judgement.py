"""What the comparison of explanations came to: the verdict, and which explanation is stated."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.numerics.arrays import FloatArray
from nmt_diagnose.diagnosis_settings import DiagnosisSettings
from nmt_diagnose.effects.location import Explanation
from nmt_diagnose.fit.explanations import FittedExplanation
from nmt_diagnose.law.law_elements import with_law, with_laws
from nmt_diagnose.law.reading import LawReading, refitted_laws
from nmt_diagnose.ledger.comparison import Comparison, EquivalentClass, by_plain_effect
from nmt_diagnose.ledger.diagnosis import Verdict
from nmt_diagnose.ledger.gap import ClosedShare
from nmt_diagnose.ledger.held_out import HeldOut, Split
from nmt_diagnose.ledger.row import Facts
from nmt_diagnose.ledger.rules import furthest_credible, verdict_of
from nmt_diagnose.ledger.size import change_size, furthest_chain_error, over
from nmt_diagnose.prediction.forward import Forward
from nmt_diagnose.search.findings import Findings
from nmt_diagnose.search.law_starts import effects_of_law
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_rig.rig import Rig


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
        """Whether what is stated leaves noise, or what does not matter, and is more likely than something unnamed."""
        if self.named is None:
            return self.verdict is not Verdict.UNKNOWN
        return self.named.adequate and self.named.probability >= self.comparison.unknown

    @property
    def partial(self) -> bool:
        """Whether the stated effect explains only a part of the gap."""
        return self.verdict is Verdict.EFFECT and not self.adequate

    @property
    def best(self) -> FittedExplanation:
        """The model as it came out: with what is stated, or alone."""
        return self.findings.null if self.named is None else self.named.head

    @property
    def reported(self) -> FittedExplanation:
        """The explanation that describes the rest of the gap: the nearest one, or the model alone."""
        return self.findings.null if self.nearest is None else self.nearest.head

    @property
    def law(self) -> LawReading | None:
        """The law of held levels, if it is reported: no library effect explains all, and units and modes are right."""
        in_order = not (self.findings.inadequate or self.findings.factors)
        return self.findings.law if self.partial or (self.verdict is Verdict.UNKNOWN and in_order) else None

    @property
    def law_leads(self) -> bool:
        """Whether the law is the answer, by the shares that it and the nearest explanation close on the same rows.

        The law goes to the model as given. It leads where it closes as much as an explanation that leaves something,
        half as much as one that moves the model's parameters beyond belief, and certainly more than one that leaves
        noise.
        """
        law, leader, share = self.law, self.nearest, self.nearest_share
        if law is None or not law.is_written:
            return False
        if leader is None or share is None or not math.isfinite(share.value):
            return True
        if leader.adequate or leader.of_two_places:
            return law.closed_at_least > share.high
        if any(objection.group and not objection.kind for objection in leader.objections):
            return law.closed >= THRESHOLDS.law.told_score_ratio * share.value
        return law.closed >= share.low

    @property
    def law_is_written(self) -> bool:
        """Whether the rig file gets the law: where it leads, and where nothing else is stated."""
        law = self.law
        return law is not None and law.is_written and (self.law_leads or self.verdict is Verdict.UNKNOWN)

    @property
    def nearest_share(self) -> ClosedShare | None:
        """What it closes of the gap on data held out."""
        return None if self.nearest is None else self.shares[self.nearest.head.explanation]

    @property
    def written(self) -> tuple[Rig, Rig | None]:
        """The model for the rig file, and the one that competed with it; None where none did.

        Where the law is what comes nearest, too, it gets the strengths that close more.
        """
        rig, law = self.findings.search.rig, self.law
        model = rig if self.verdict is Verdict.NONE else self.best.rig
        if law is None or not law.is_written:
            return model, None
        by_law, share = with_law(rig, law), self.nearest_share
        if not self.law_is_written:
            return model, by_law
        named = {(cause.effect, cause.location.detail) for cause in self.reported.explanation.causes}
        alike = {(name, each.place) for each in law.laws for name, _ in effects_of_law(each)}
        if share is not None and named == alike and share.value > law.closed_by_file:
            return self.reported.rig, by_law
        return by_law, self.reported.rig


def judged(findings: Findings, held_out: HeldOut, settings: DiagnosisSettings) -> Judgement:
    """The judgement of some findings.

    Args:
        findings: explanations, fitted and compared.
        held_out: what they predict of rows that their fits did not see.
        settings: of the diagnosis.
    """
    comparison = findings.comparison
    shares = {equivalent.head.explanation: held_out.closed(equivalent.head) for equivalent in comparison.to_judge()}

    def leaves_less(one: FittedExplanation, other: FittedExplanation) -> bool:
        # The noise of a record's samples is known, and with it what the evidence demands.
        rise = one.fit.log_evidence - other.fit.log_evidence
        demanded = findings.search.of_records and rise >= THRESHOLDS.verdict.sure_log_evidence
        return demanded or held_out.closed(one, other).low > 0.0

    limit = furthest_credible(int(np.count_nonzero(findings.data.tolerances)))
    comparison = by_plain_effect(
        comparison, shares, leaves_less, lambda found: furthest_chain_error(findings.data, found) > limit
    )
    leader = comparison.classes[0] if comparison.classes else None
    share = None if leader is None else shares[leader.head.explanation]
    alone = _alone(findings, settings)
    rival = max(comparison.unknown, comparison.none)
    verdict = verdict_of(alone, None if leader is None else leader.facts(share, rival))
    law = findings.law
    if verdict.gap and law is not None and law.is_stated:
        scale = (findings.null if leader is None else leader.head).scale()
        by_law = _law_held_out(findings, held_out, scale)
        if by_law is not None:
            # Strengths of a record's law know its rows: what they close of parts that they do not know limits it.
            known = law.closed_by_file if law.of_record else math.nan
            value, low = (float(np.fmin(known, closed)) for closed in (by_law.value, by_law.low))
            law = replace(law, closed_by_file=value, closed_at_least=low)
            findings = replace(findings, law=law)
            if verdict is Verdict.EFFECT and leader is not None and share is not None:
                verdict = _effect_and_law(law, leader, share)
    return Judgement(findings, comparison, shares, alone, verdict)


def _effect_and_law(law: LawReading, leader: EquivalentClass, share: ClosedShare) -> Verdict:
    """The verdict on what would explain the whole: nothing in the library does where a law closes certainly more.

    A law that is that effect and nothing else says the same.
    """
    named = {(cause.effect, cause.location.detail) for cause in leader.head.explanation.causes}
    same = [
        {(name, each.place) for name, _ in effects_of_law(each)}
        for each in law.laws
        if len(each.at_middle) == 1 or {term.kind for term in each.at_middle} == {"friction"}
    ]
    if len(law.laws) == len(same) == 1 and named <= same[0]:
        return Verdict.EFFECT
    return Verdict.UNKNOWN if leader.adequate and law.closed_at_least > share.high else Verdict.EFFECT


def _law_held_out(findings: Findings, held_out: HeldOut, scale: FloatArray) -> ClosedShare | None:
    """How much of the gap the rig file with the law closes on rows that the law was not read from.

    Strengths of held levels are fitted anew to the rows of each split. The law goes to the model as given. None where
    no split determines it, or where the file has an element whose motion is only known step by step.

    Args:
        findings: with the law.
        held_out: the splits.
        scale: noise of all rows, as for the explanations that it competes with.
    """
    rig, observations, reading = findings.search.rig, held_out.everything.observations, findings.law
    forward = Forward(observations.tests, observations.rows)

    @cache
    def by_file() -> FloatArray | None:
        return None if reading is None else np.asarray(forward.predict(with_law(rig, reading)).values)

    def values_after(split: Split) -> FloatArray | None:
        if reading is not None and reading.of_record:
            return by_file()
        part = observations.take(held_out.fitted.used & split.fitted)
        laws = None if reading is None else refitted_laws(rig, part, reading)
        return None if laws is None else np.asarray(forward.predict(with_laws(rig, laws)).values)

    try:
        return held_out.closed_by(values_after, scale)
    except BenchError:
        return None


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
