"""The answers in words: where the gap lies, which effect causes it, how far it shrinks."""

from __future__ import annotations

import math
from collections.abc import Sequence

from nmt_diagnose.evidence.observables import Evidence
from nmt_diagnose.inference.diagnosis import Gap, NextTest, PlaceShare, Ranked, Recalibrated, Verdict

PLACES = {
    "structure": "the structure",
    "boundary": "the clamping",
    "joint": "the joint",
    "exciter": "the exciter",
    "force_sensor": "the force sensor",
    "response_sensor": "a response sensor",
    "controller": "the controller",
    "time": "a change over time",
}
_LIKELY = 0.9


def sentences(
    verdict: Verdict,
    where: Sequence[PlaceShare],
    ranking: Sequence[Ranked],
    gap: Gap,
    ahead: Sequence[NextTest],
    calibration: Sequence[Recalibrated],
    evidence: Evidence,
) -> tuple[str, ...]:
    """Where, which, how far; and what would settle the rest if something is left open."""
    if verdict is Verdict.NONE:
        return (
            "There is no gap that the noise and the repeatability of these tests could not explain.",
            "No unmodelled effect is claimed; the model's own parameters need no change either.",
            f"Held-out data lie {gap.as_given:.2f} standard deviations (rms) from the model; noise alone gives 1.",
        )
    if verdict is Verdict.CALIBRATION:
        moved = sorted(calibration, key=lambda item: -abs(item.sigmas))[:3]
        named = "; ".join(f"{m.name} {_number(m.start)} to {_number(m.to)} ± {_number(m.std)} {m.unit}" for m in moved)
        return (
            "The gap lies in parameters that the model already has.",
            f"No unmodelled effect is needed; the parameters that moved most beside their uncertainty: {named}.",
            _how_far(gap, "Re-fitting them"),
        )
    place = _where(where)
    if verdict is Verdict.UNKNOWN:
        best = f"; the nearest named effect is {ranking[0].effect}{_at(ranking[0])}" if ranking else ""
        return (
            place,
            f"Nothing in the library explains it{best}.",
            f"Held-out data lie {gap.before:.2f} standard deviations (rms) from the re-fitted model; noise gives 1.",
            *_ahead(ahead),
        )
    head = ranking[0]
    sure = "The cause is" if head.probability >= _LIKELY else "The most probable cause is"
    values = ", ".join(f"{k} = {_number(v.value)} ± {_number(v.std)} {v.unit}" for k, v in head.parameters.items())
    which = f"{sure} {_title(head.effect)}{_at(head)} ({values}), probability {100.0 * head.probability:.0f} %"
    if head.equivalents:
        which += f"; these tests cannot tell it from {' or '.join(_title(name) for name in head.equivalents)}"
    return (place, which + ".", _how_far(gap, "Adding it"), *_ahead(ahead))


def _where(where: Sequence[PlaceShare]) -> str:
    if not where:
        return "Where the gap lies could not be told."
    first = where[0]
    detail = f" ({first.detail})" if first.detail else ""
    text = f"The gap lies in {PLACES.get(first.place, first.place)}{detail}, probability {100.0 * first.p:.0f} %"
    others = [item for item in where[1:3] if item.p > 0.05]
    if others:
        text += "; otherwise " + " or ".join(
            f"{PLACES.get(item.place, item.place)} ({100.0 * item.p:.0f} %)" for item in others
        )
    return text + "."


def _how_far(gap: Gap, what: str) -> str:
    if not math.isfinite(gap.closed):
        return (
            f"{what} takes the fit from {gap.before:.2f} to {gap.after:.2f} standard deviations (rms; noise gives 1); "
            "too few data could be held out to say how much of the gap that closes."
        )
    interval = f" (90 % interval {100 * gap.low:.0f} to {100 * gap.high:.0f} %)" if math.isfinite(gap.low) else ""
    return (
        f"{what} closes {100.0 * gap.closed:.0f} % of the gap on data held out from the fit{interval}: from "
        f"{gap.before:.2f} to {gap.after:.2f} standard deviations rms, where noise alone gives {gap.floor:.0f}."
    )


def _ahead(ahead: Sequence[NextTest]) -> tuple[str, ...]:
    if not ahead:
        return ()
    first = ahead[0]
    pair = " from ".join(_title(name) for name in first.separates[:2])
    return (
        f"What would settle the rest: {first.test}; it should tell {pair} by {first.expected_sigma:.0f} standard "
        "deviations.",
    )


def _title(effect: str) -> str:
    return effect.replace("_", " ") if effect != "none" else "the model without any effect"


def _at(item: Ranked) -> str:
    return f" at {item.detail}" if item.detail else ""


def _number(value: float) -> str:
    return f"{value:.4g}"
