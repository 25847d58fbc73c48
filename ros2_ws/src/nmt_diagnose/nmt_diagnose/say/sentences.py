"""The answers in words: where the gap lies, which effect causes it, how far it shrinks."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from nmt_core.text.number_words import percent, share_with_interval, significant, value_text
from nmt_diagnose.effects.library import effect_named
from nmt_diagnose.effects.location import Explanation, effect_words, joined
from nmt_diagnose.ledger.diagnosis import (
    NULL,
    Gap,
    NextTest,
    PlaceShare,
    Ranked,
    Recalibrated,
    Remainder,
    Value,
    Verdict,
)
from nmt_diagnose.ledger.gap import NOISE
from nmt_diagnose.ledger.size import Objection
from nmt_diagnose.say.words import detail_text, parameters_text, place_text, probability_text
from nmt_diagnose.thresholds import THRESHOLDS

UNITS_FIRST = "Effects are judged once units and signs of the recording are right."
"""Last sentence of a diagnosis that ends with channels of another unit or sign than the model predicts."""


def sentences(
    verdict: Verdict,
    where: Sequence[PlaceShare],
    ranking: Sequence[Ranked],
    named: Explanation | None,
    gap: Gap,
    ahead: Sequence[NextTest],
    calibration: Sequence[Recalibrated],
    remainder: Remainder | None = None,
    left: Sequence[Objection] = (),
    small: str = "",
) -> tuple[str, ...]:
    """Where, which, how far; and what would settle the rest if something is left open.

    ``named`` is the explanation that ``ranking`` begins with, ``left`` its residuals that matter, ``small`` the
    sentence on an effect that is there and does not matter.
    """
    if verdict is Verdict.NONE:
        which = "Held-out data" if gap.held_out else "The data"
        moved = [item for item in calibration if abs(item.sigmas) > THRESHOLDS.verdict.visible_sigmas]
        own_parameters = (
            f"he model's own parameters were off, by less than what matters: {_farthest(moved)}."
            if moved
            else "he model's own parameters need no change either."
        )
        model = "the model"
        if small:
            model = f"the model with it and {gap.as_given:.2f} from the model as given"
        distance = gap.after if small else gap.as_given
        return (
            "There is no gap that the noise and the repeatability of these tests could not explain."
            if gap.as_given <= THRESHOLDS.verdict.left_over_scale and not small
            else "There is no gap that matters: what is beyond the noise is smaller than that.",
            f"{small} T{own_parameters}" if small else f"No unmodelled effect is claimed; t{own_parameters}",
            f"{which} lie {distance:.2f} standard deviations (rms) from {model}; 1 is what the noise allows.",
        )
    if verdict is Verdict.CALIBRATION:
        return (
            "The gap lies in parameters that the model already has.",
            f"{small or 'No unmodelled effect is needed.'} {_common_factor(calibration)}The parameters that moved most "
            f"relative to their uncertainty: {_farthest(calibration)}.",
            _how_far(
                gap, "Re-fitting them", f"{gap.before:.2f} with the model as given", "re-fitted", "model as given"
            ),
        )
    place = where_words(where)
    if verdict is Verdict.EFFECT and " + " in ranking[0].place:
        # Two effects act at both places: neither is an alternative to the other.
        place = where_words([PlaceShare(ranking[0].place, ranking[0].detail, 1.0, ranking[0].probability)])
    if verdict is Verdict.UNKNOWN:
        part = gap.bridged >= THRESHOLDS.verdict.nearest_closed_share
        most = "all" if part else "a third"
        known = f"Nothing in the library explains {most} of it."
        return (place, known + _nearest(ranking, named, gap), *_ahead(ahead))
    head = ranking[0]
    values = parameters_text(head.parameters)
    alters = "+" not in head.effect and effect_named(head.effect).alters
    what = f"{_title(head.effect)}{_at(named)}" + (f" ({values})" if values else "")
    if alters and list(head.parameters) == ["factor"]:
        what = f"{_title(head.effect)}{_at(named)}, {values.partition('= ')[2]} of the model's"
    if not head.adequate:
        which = (
            f"{_share_of(gap)} of the gap acts like {what}, probability {_sure(head.probability)} among the effects of "
            f"the library; {_against(left)}"
        )
    else:
        sure = (
            "The cause is" if head.probability >= THRESHOLDS.verdict.cause_probability else "The most probable cause is"
        )
        which = f"{sure} {what}, probability {_sure(head.probability)}"
    if head.equivalents:
        which += f"; these tests cannot tell it from {' or '.join(_title(name) for name in head.equivalents)}"
    which += place_words(head)
    which += _with_second(ranking)
    worse = " (which predicts worse)" if gap.before > gap.as_given else ""
    before = f"{gap.as_given:.2f} with the model as given, {gap.before:.2f} with its parameters re-fitted{worse}"
    what, after = ("Correcting it", "with it corrected") if alters else ("Adding it", "with it added")
    far = _how_far(gap, what, before, after, "re-fitted model")
    return (place, which + ".", far + _left(remainder), *_ahead(ahead))


def _farthest(calibration: Sequence[Recalibrated]) -> str:
    """The parameters that moved most relative to their uncertainty, from and to."""
    moved = sorted(calibration, key=lambda item: -abs(item.sigmas))[:3]
    return "; ".join(f"{m.name} {value_text(m.start, math.nan)} to {value_text(m.to, m.std, m.unit)}" for m in moved)


_MODAL_MASS = "modal_mass_kg"
_FEWEST_MASSES = 2  # one mass that moved has no factor in common with another
_UNLIKE_SHARE = 0.25  # of the common change, by which single masses may differ from it


def _common_factor(calibration: Sequence[Recalibrated]) -> str:
    """A factor that all modal masses have in common; empty where they have none.

    Responses per force go with 1/m: a gain of the force, or the inverse one of all responses, does the same.
    """
    masses = [item for item in calibration if item.name.endswith(_MODAL_MASS)]
    if len(masses) < _FEWEST_MASSES:
        return ""
    ratios = [item.to / item.start for item in masses]
    # The uncertainties have the scale in common, so a mean is no surer than the surest of them.
    std = min(item.std / item.start for item in masses)
    change = sum(ratios) / len(ratios) - 1.0
    unlike = max(abs(ratio - 1.0 - change) for ratio in ratios)
    if abs(change) < THRESHOLDS.verdict.excess_sigmas * std or unlike > max(_UNLIKE_SHARE * abs(change), std):
        return ""
    reads = percent(abs(change), 1)
    return (
        f"All {len(masses)} modal masses changed by one factor, {value_text(1.0 + change, std)}: a force channel that "
        f"reads {reads} too {'much' if change > 0.0 else 'little'}, or responses that read {reads} too "
        f"{'little' if change > 0.0 else 'much'}, would look the same. "
    )


def _with_second(ranking: Sequence[Ranked]) -> str:
    """The share of the gap that a partial explanation closes with a second effect, where that has been fitted."""
    head = ranking[0].effect.split(" + ")
    for other in ranking[1:] if not ranking[0].adequate else ():
        effects = other.effect.split(" + ")
        if set(head) < set(effects) and math.isfinite(other.closed.value):
            second = joined(_title(name) for name in effects if name not in head)
            return f"; with {second} added it closes {percent(other.closed.value, 1)} of the gap"
    return ""


def place_words(head: Ranked) -> str:
    """The places of an explanation with their probabilities, where more than one is likely."""
    best = max(head.places.values(), default=0.0)
    likely = {at: p for at, p in head.places.items() if p > THRESHOLDS.verdict.as_likely_share * best}
    if len(likely) < 2:
        return ""
    return "; its place: " + ", ".join(f"{detail_text(at) or at} ({_sure(p)})" for at, p in likely.items())


def _share_of(gap: Gap) -> str:
    return percent(gap.closed, 1) if math.isfinite(gap.closed) else "Most"


def _against(left: Sequence[Objection]) -> str:
    """What speaks against an explanation as the whole of the gap."""
    return (
        left[0].sentence if left else "more than noise remains that it does not explain, so something unnamed acts too"
    )


def likeness(explanation: Explanation, found: Mapping[str, Value]) -> str:
    """What a difference that does not matter looks like."""
    return f"It looks like {_with_values(explanation, found)}; '--matters' says from which size on that is a gap."


def too_small(explanation: Explanation, row: Ranked, size: str) -> str:
    """An effect that the recordings demand and that changes less than what matters.

    Args:
        explanation: the effect and its place.
        row: its parameters and probability.
        size: what it changes, in words.
    """
    alike = f", or {' or '.join(_title(name) for name in row.equivalents)}" if row.equivalents else ""
    return (
        f"The model lacks {_with_values(explanation, row.parameters)}{alike}, probability {_sure(row.probability)}. "
        f"That is too small to matter: it changes {size}; '--matters' says from which size on it is a gap."
    )


def _with_values(explanation: Explanation, found: Mapping[str, Value]) -> str:
    what = joined(_title(cause.effect) for cause in explanation.causes)
    return f"{what}{_at(explanation)} ({parameters_text(found)})"


def relieving(explanation: Explanation, found: Mapping[str, Value]) -> str:
    """Sentence on an effect that only moves model and measuring chain back to their priors."""
    return (
        f"With {_with_values(explanation, found)} added, parameters of the model and errors of the measuring chain "
        "stay closer to their priors; no row needs it, so it is not claimed."
    )


def _nearest(ranking: Sequence[Ranked], named: Explanation | None, gap: Gap) -> str:
    """The nearest explanation, with its parameters and the remaining gap."""
    if not ranking:
        return f" {gap.before:.2f} standard deviations (rms) lie between the recordings and the re-fitted model."
    if gap.closed <= 0.0:
        return " No effect of it predicts data held out from the fit better than the model alone."
    head = ranking[0]
    closes = f" and closes {100.0 * gap.closed:.0f} % of it" if math.isfinite(gap.closed) else ""
    return (
        f" What comes nearest is {_title(head.effect)}{_at(named)} ({parameters_text(head.parameters)}){closes}: from "
        f"{gap.before:.2f} to {gap.after:.2f} standard deviations (rms) where noise gives 1."
    )


def _left(remainder: Remainder | None) -> str:
    """How much is left of the gap, and where most of it lies."""
    if remainder is None:
        return ""
    explained, left = max(0.0, 1.0 - remainder.share), remainder.share
    text = f" It explains {100.0 * explained:.0f} %; {100.0 * left:.0f} % is left"
    if remainder.where:
        first = remainder.where[0]
        at = f" at the {first.levels}" if first.levels else ""
        text += f", most of it in {first.observable}{at} ({significant(first.rms_unit, 3)} {first.unit} rms)"
    return text + "."


def where_words(where: Sequence[PlaceShare]) -> str:
    """Where the gap lies, as a sentence."""
    if not where:
        return "Where the gap lies could not be told."
    first = where[0]
    text = f"The gap lies in {place_text(first.place, first.detail)} (probability {_sure(first.p)})"
    others = [item for item in where[1:3] if item.p > THRESHOLDS.verdict.other_location_probability]
    if others:
        text += "; otherwise " + " or ".join(f"{place_text(item.place)} ({_sure(item.p)})" for item in others)
    return text + "."


def _how_far(gap: Gap, what: str, before: str, after: str, base: str) -> str:
    if not math.isfinite(gap.closed):
        return (
            f"{what} takes the fit from {gap.before:.2f} to {gap.after:.2f} standard deviations (rms; 1 is what "
            "the stated uncertainties allow); too few data could be held out to say how much of the gap that closes."
        )
    if gap.closed <= 0.0:
        return (
            f"{what} predicts data held out from the fit no better: {gap.before:.2f} standard deviations rms before, "
            f"{gap.after:.2f} after it, where noise alone leaves {gap.floor:.2f}; do not rely on the new values."
        )
    closed, limits = share_with_interval(gap.closed, gap.low, gap.high)
    interval = f" (90 % interval {limits})" if limits else ""
    return (
        f"On data held out from the fit, {what[:1].lower()}{what[1:]} removes {closed} of the residual of the {base} "
        f"beyond noise{interval}. Residual there, in standard deviations of the noise (rms): {before}, {gap.after:.2f} "
        f"{after}; noise alone leaves {gap.floor:.2f}."
        + (" The uncertainties of the held-out data allow 1, so they hardly show it." if gap.before <= NOISE else "")
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
    return effect_words(effect) if effect != NULL else "the model without any effect"


def _at(explanation: Explanation | None) -> str:
    locations = () if explanation is None else explanation.locations
    details = [detail_text(location.detail, location.kind) for location in locations]
    found = " and ".join(dict.fromkeys(part for part in details if part))
    return f" {found}" if found.startswith(("between", "over")) else f" at {found}" if found else ""


def _sure(p: float) -> str:
    """A probability in running text."""
    return probability_text(p).replace("> ", "over ").replace("< ", "below ")
