"""The ledger of a diagnosis: a row for each explanation that was fitted, and what passed the other candidates over."""

from __future__ import annotations

import math
from dataclasses import replace

from nmt_diagnose.fit.explanations import FittedExplanation, Score
from nmt_diagnose.ledger.comparison import EquivalentClass, distance, laws
from nmt_diagnose.ledger.diagnosis import Verdict
from nmt_diagnose.ledger.judgement import Judgement
from nmt_diagnose.ledger.row import Facts, GroupLeft, Ledger, LedgerRow, Predicted, Promise, Ruling
from nmt_diagnose.ledger.rules import (
    GAP,
    IN_REACH,
    LIKELY,
    OF_ALL,
    OF_EFFECTS,
    PROMISING,
    furthest_credible,
    rulings_of,
)
from nmt_diagnose.ledger.size import change_size, left_sizes
from nmt_diagnose.thresholds import THRESHOLDS


def ledger_of(judgement: Judgement) -> Ledger:
    """The ledger."""
    rows = [_row_alone(judgement), *(_row(judgement, found) for found in judgement.findings.named)]
    known = {row.label for row in rows}
    for out in judgement.findings.left_out:
        if out.found.fitted.label not in known:
            known.add(out.found.fitted.label)
            behind = IN_REACH(Facts(behind=out.behind, behind_most=out.behind_most))
            rows.append(_made(judgement, out.found, (behind,), behind.rule))
    return Ledger(tuple(rows), _promises(judgement, known))


def _row_alone(judgement: Judgement) -> LedgerRow:
    rulings = tuple(rule(judgement.alone) for rule in (*OF_ALL, *OF_EFFECTS))
    stated = not judgement.verdict.gap
    failed = next((ruling.rule for ruling in rulings if ruling.rule != GAP.name and not ruling.passed), GAP.name)
    failed = "" if stated else failed if judgement.alone.modes else GAP.name
    return _made(judgement, judgement.findings.null, rulings, failed)


def _row(judgement: Judgement, found: FittedExplanation) -> LedgerRow:
    if not found.stated:
        rulings = tuple(rule(judgement.alone) for rule in OF_ALL)
        failed = next((r.rule for k in found.small for r in _of_effect(found, k) if not r.passed), OF_EFFECTS[0].name)
        return _made(judgement, found, rulings, failed)
    leader = judgement.leader
    heads = leader is not None and leader.head is found
    rulings = rulings_of(_facts(judgement, found))
    if heads and judgement.verdict is Verdict.EFFECT:
        return _made(judgement, found, rulings, "")
    # The leader may be stated as a part, too: what it failed last is why it is not.
    asked = [ruling for ruling in rulings if ruling.part] if heads else []
    failed = next((ruling.rule for ruling in asked or rulings if not ruling.passed), LIKELY.name)
    return _made(judgement, found, rulings, failed)


def _facts(judgement: Judgement, found: FittedExplanation) -> Facts:
    """What the rules of a verdict ask of an explanation that states effects."""
    comparison, leader, data = judgement.comparison, judgement.leader, judgement.findings.data
    wanted = data.observations.matters
    share = judgement.shares.get(found.explanation)
    rival = max(comparison.unknown, comparison.none)
    group = next((equivalent for equivalent in comparison.classes if equivalent.head is found), None)
    if group is None or group is not leader:
        ahead = leader.probability if leader is not None else 0.0
        if leader is not None and any(member is found for member in leader.members):
            ahead = comparison.by_label.get(leader.head.explanation.label, 0.0)
        rival = max(rival, ahead)
    if group is None:
        p = comparison.by_label.get(found.explanation.label, 0.0)
        group = EquivalentClass((found,), p, p, judgement.findings.hypotheses.objections(found))
    facts = group.facts(share, rival)
    sizes = left_sizes(data, found, wanted)
    pulls = abs(found.fit.theta[: facts.parameters])
    return replace(
        facts,
        log_odds=judgement.alone.log_odds,
        modes=judgement.alone.modes,
        left=max((size.over for size in sizes), default=0.0),
        pull=facts.pull or min(float(pulls.max(initial=0.0)), furthest_credible(facts.parameters)),
        laws=laws(found),
    )


def _of_effect(found: FittedExplanation, number: int) -> tuple[Ruling, ...]:
    facts = found.comparisons.get(number)
    return () if facts is None else tuple(rule(facts) for rule in OF_EFFECTS)


def _made(judgement: Judgement, found: FittedExplanation, rulings: tuple[Ruling, ...], failed: str) -> LedgerRow:
    data, null, fitted = judgement.findings.data, judgement.findings.null, found.fit
    counts, squares = data.counts, fitted.errors.squares
    total = max(float(squares.sum()), 1e-300)
    model = fitted.parametrisation.calibration
    chain = fitted.errors.chain
    names = data.chain_names if len(data.chain_names) == chain.size else ()
    pulled = sorted(zip(names, map(float, chain), strict=False), key=lambda item: -abs(item[1]))
    difference = data.forward.difference(fitted.errors.values, null.fit.errors.values)
    size = change_size(data, difference)
    wanted = data.observations.matters
    heads = [
        null,
        *(equivalent.head for equivalent in judgement.comparison.classes[: THRESHOLDS.verdict.judged_explanations]),
    ]
    share = judgement.shares.get(found.explanation) if found.stated else None
    label = found.explanation.label if found.stated else found.fitted.label
    p = judgement.comparison.by_label.get(label if found.candidates else "none", 0.0)
    return LedgerRow(
        label=found.fitted.label,
        stated=not failed,
        failed=failed,
        rulings=rulings,
        effects={candidate.cause.label: _of_effect(found, k) for k, candidate in enumerate(found.candidates)},
        small=tuple(found.candidates[k].cause.label for k in sorted(found.small)),
        start=fitted.start,
        left=tuple(
            GroupLeft(name, int(count), math.sqrt(square / count), square / total)
            for name, count, square in zip(data.groups.names, counts, squares, strict=True)
            if count > 0.0
        ),
        parameters={it.name: float(theta) for it, theta in zip(model, fitted.theta, strict=False)},
        chain={name: value for name, value in pulled if abs(value) > 1.0},
        change={kind: value / wanted[kind] for kind, value in size.values.items() if wanted.get(kind, 0.0) > 0.0},
        apart={other.fitted.label: distance(found, other) for other in heads if other is not found},
        predicted=None
        if share is None
        else Predicted(share.before, share.after, share.value, share.low, share.high, share.gain),
        prior=judgement.findings.hypotheses.prior(found)
        if found.candidates
        else math.log(THRESHOLDS.comparison.prior_none),
        evidence=fitted.log_evidence - null.fit.log_evidence,
        probability=p,
    )


def _promises(judgement: Judgement, fitted: set[str]) -> tuple[Promise, ...]:
    """Candidates that the score test looked at and that no row is about, with the rule that passed each over."""
    candidates = judgement.findings.search.candidates
    promised: dict[str, Score] = {}
    for score in judgement.findings.scanned:
        promised.setdefault(candidates[score.candidate].cause.label, score)
    effect = {label: candidates[score.candidate].effect.name for label, score in promised.items()}
    least_of: dict[str, list[float]] = {}
    for label, score in promised.items():
        if label in fitted:
            least_of.setdefault(effect[label], []).append(score.gain)
    least = min((max(gains) for gains in least_of.values()), default=-math.inf)
    result = []
    for label, score in promised.items():
        if label in fitted:
            continue
        gains = least_of.get(effect[label], [])
        several = len(gains) >= THRESHOLDS.search.first_locations
        ruling = PROMISING(Facts(promised=score.gain, promised_least=min(gains) if several else least))
        lost = candidates[score.candidate].cause in judgement.findings.search.lost
        if ruling.passed and not lost:
            alone = GAP(judgement.alone)
            ruling = ruling if alone.passed else alone
        result.append(Promise(label, score.gain, ruling, lost))
    return tuple(result)
