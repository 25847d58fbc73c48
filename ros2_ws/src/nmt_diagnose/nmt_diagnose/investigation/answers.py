"""Answers of an investigation: their probabilities, what is open among them, and the benefit of a test."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from scipy.special import entr

from nmt_diagnose.effects.location import effect_words
from nmt_diagnose.investigation.investigation_record import AskedTest
from nmt_diagnose.ledger.diagnosis import HIDDEN, NULL, UNKNOWN, Diagnosis, NextTest, Verdict


def answers_of(diagnosis: Diagnosis) -> dict[str, float]:
    """Probability of ``none``, ``unknown`` and of each set of effects wherever they act, the most probable first.

    Without a gap, ``none`` means that no test of the plan would show one, and ``too_weak_so_far`` that one of the
    remaining tests would.
    """
    found: dict[str, float] = {}
    no_gap = diagnosis.verdict in (Verdict.NONE, Verdict.CALIBRATION)
    hidden = diagnosis.next_levels.hidden if no_gap and diagnosis.next_levels is not None else 0.0
    for label, p in diagnosis.probabilities.items():
        label = NULL if no_gap and label == UNKNOWN else label
        name = " + ".join(sorted(part.split("@")[0].strip() for part in label.split(" + ")))
        found[name] = found.get(name, 0.0) + p
    if hidden > 0.0:
        found = {name: (1.0 - hidden) * p for name, p in found.items()} | {HIDDEN: hidden * sum(found.values())}
    return dict(sorted(found.items(), key=lambda item: -item[1]))


def end_of(diagnosis: Diagnosis) -> str:
    """How an investigation ends where nothing is left to measure and no rival is left."""
    if diagnosis.verdict is Verdict.EFFECT:
        return "named" if diagnosis.adequate else "unknown"
    return {Verdict.NONE: "no_gap", Verdict.CALIBRATION: "recalibrated"}.get(diagnosis.verdict, "unknown")


def entropy_of(answers: Mapping[str, float], names: Sequence[str], verdict: str) -> float:
    """Entropy of a question, nats.

    Args:
        answers: probability of each.
        names: the first two of them are set against each other. Where the question is whether the plan shows a gap,
            what is too weak so far is set against all else while there is none, and no gap once there is one.
        verdict: of the diagnosis.
    """
    first, second = (max(0.0, answers.get(name, 0.0)) for name in names[:2])
    if HIDDEN in names:
        alone = HIDDEN if verdict in (Verdict.NONE.value, Verdict.CALIBRATION.value) else NULL
        first = max(0.0, answers.get(alone, 0.0))
        second = sum(p for name, p in answers.items() if name != alone)
    total = first + second
    return float(entr(first / total) + entr(second / total)) if total > 0.0 else 0.0


def worth(test: AskedTest) -> tuple[float, float]:
    """Expected information for each second of bench time; where that is not known, the standard deviations."""
    rate = test.expected / test.seconds if test.seconds > 0.0 and math.isfinite(test.expected) else 0.0
    return rate, test.expected_sigma


def reason(item: NextTest) -> str:
    """Why a test is proposed."""
    apart = " from ".join(effect_words(name) for name in item.separates[:2])
    return f"tells {apart} by {item.expected_sigma:.0f} standard deviations"
