"""Words for what a diagnosis names: effects, places, verdicts, parameters with their uncertainty."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace

from nmt_core.errors import BenchError
from nmt_core.text.number_words import percent, plain, share_with_interval, value_text
from nmt_diagnose.effects.library import effect_named
from nmt_diagnose.effects.location import effect_words, joined
from nmt_diagnose.ledger.diagnosis import NULL, TOO_WEAK, UNKNOWN, Answer, Diagnosis, Gap, Ranked, Value, Verdict
from nmt_rig.rig import Rig

PLACES = {
    "structure": "the structure",
    "boundary": "the clamping",
    "joint": "a joint or contact",
    "exciter": "the exciter",
    "force_sensor": "the force sensor",
    "response_sensor": "a response sensor",
    "controller": "the controller",
    "time": "a change over time",
}
VERDICTS = {
    Verdict.NONE: ("no gap beyond noise", "good"),
    Verdict.CALIBRATION: ("the model's own parameters were off", "good"),
    Verdict.EFFECT: ("an unmodelled effect", "good"),
    Verdict.UNKNOWN: ("a gap that nothing in the library explains", "partly"),
}
_NO_GAP = (Verdict.NONE, Verdict.CALIBRATION)
QUESTIONS = ("Where", "Which", "How far")

_NAMED = 4
_SYMBOLS = {"factor": "factor on the model's value", "tau": "delay τ", "g": "relative error g", "e": "relative error e",
            "gap": "clearance"}  # fmt: skip
"""What parameters mean whose symbol alone does not say it."""
_LETTERS = {"f": "force", "x": "displacement", "v": "velocity", "a": "acceleration"}


def verdict_text(diagnosis: Diagnosis) -> tuple[str, str]:
    """The verdict in a few words, and its class on a page: ``good``, ``partly`` or ``bad``."""
    text, kind = VERDICTS[diagnosis.verdict]
    law = diagnosis.law
    if law is not None and diagnosis.law_leads:
        forces = joined(f"{each.family} ({detail_text(each.place)})" for each in law.laws)
        text = f"a force like {forces}, which no effect of the library explains"
        if diagnosis.verdict is Verdict.EFFECT:
            text = f"a force like {forces}, of which no effect of the library explains more than a part"
            kind = "partly"
    elif diagnosis.verdict is Verdict.EFFECT and diagnosis.ranking:
        head = diagnosis.ranking[0]
        if is_partial(diagnosis):
            closed = diagnosis.gap.closed
            part = percent(closed, 1) if math.isfinite(closed) else "most"
            named = f"{class_text(head)} ({place_text(head.place, head.detail)})"
            rest = percent(1.0 - closed, 1) if math.isfinite(closed) else "the rest"
            return f"{named} explains {part} of the gap; {rest} is unexplained", "partly"
        alters = effect_named(head.effect).alters if "+" not in head.effect and not head.equivalents else ()
        named = f"the model lacks {class_text(head)}"
        if alters and "factor" in head.parameters:
            named = f"the model is {alters[head.parameters['factor'].value > 1.0]}"
        text = f"{named} ({place_text(head.place, head.detail)})"
        if diagnosis.remainder is not None:
            share = 100.0 * diagnosis.remainder.share
            text += f", which explains {max(0.0, 100.0 - share):.0f} % of the gap and leaves {share:.0f} %"
    if diagnosis.warnings:
        count = len(diagnosis.warnings)
        return f"{text}; mind the {'warning' if count == 1 else f'{count} warnings'}", "partly"
    return text, kind


def answered(diagnosis: Diagnosis) -> list[tuple[str, str]]:
    """Sentences with the question that each answers, empty where it answers none; without the warnings."""
    others = [sentence for sentence in diagnosis.sentences if sentence not in diagnosis.warnings]
    # Where nothing is named nothing says how far the gap shrinks.
    names = list(QUESTIONS[:2] if diagnosis.verdict is Verdict.UNKNOWN else QUESTIONS)
    names += ["What next"] if diagnosis.next_test else []
    names += [""] * (len(others) - len(names))
    return list(zip(names, others, strict=False))


def is_partial(diagnosis: Diagnosis) -> bool:
    """Whether what is named leaves more than noise that matters; its probability is one among the library alone."""
    return diagnosis.verdict is Verdict.EFFECT and not diagnosis.adequate


def is_within_first(diagnosis: Diagnosis, item: Ranked) -> bool:
    """Whether an explanation is the first one, a partial one, with another effect next to it.

    The probability of a partial explanation counts whatever acts next to it, so that of this one is part of it.
    """
    first = diagnosis.ranking[0]
    return is_partial(diagnosis) and set(first.effect.split(" + ")) < set(item.effect.split(" + "))


def effect_text(name: str) -> str:
    """``cubic stiffness`` for ``cubic_stiffness``; the competing explanations that are no effects in words."""
    if name == NULL:
        return "no effect needed"
    if name == UNKNOWN:
        return "something not in the library"
    if name == TOO_WEAK:
        return "an effect too weak to see"
    return effect_words(joined(part.split("@")[0] for part in name.split(" + ")))


def class_text(item: Ranked) -> str:
    """The explanations of a class, joined by *or*; those that are another one with something added are left out."""
    return _alternatives_text((item.effect, *item.equivalents))


def answers_text(answers: Sequence[Answer]) -> str:
    """The answers that together hold 95 % of the probability, in words; empty where they are not known."""
    words = [_alternatives_text(answer.effects) if answer.effects else effect_text(answer.kind) for answer in answers]
    return f"95 % credible set: {'; '.join(words)}." if words else ""


def _alternatives_text(names: Sequence[str]) -> str:
    parts = [frozenset(name.split(" + ")) for name in names]
    plain_ones = [name for name, part in zip(names, parts, strict=True) if not any(other < part for other in parts)]
    shown = [effect_text(name) for name in plain_ones[:_NAMED]]
    more = len(plain_ones) - len(shown)
    return " or ".join(shown) + (f" or one of {more} more" if more else "")


def place_text(place: str, detail: str = "") -> str:
    """Where, in words: ``the structure, point 5``; of two effects both places, each with its detail."""
    places, details = place.split(" + "), [part for part in detail.split(" + ") if part]
    if len(places) == len(details) > 1:
        return ", and ".join(dict.fromkeys(map(place_text, places, details)))
    words = [PLACES.get(part, part.replace("_", " ")) for part in places]
    said = list(dict.fromkeys(filter(None, (detail_text(part, place) for part in details))))
    return " and ".join(words) + (f", {' and '.join(said)}" if said else "")


def detail_text(detail: str, place: str = "") -> str:
    """A point, pair of points, channel or direction in words."""
    if detail.isdigit():
        return f"point {detail}"
    pair = re.fullmatch(r"(\d+)\s*[-–]\s*(\d+)", detail)
    if pair:
        return f"between points {pair[1]} and {pair[2]}"
    picked_up = re.fullmatch(r"([a-z]\w*)<(\d+)", detail)
    if picked_up:
        return f"channel {picked_up[1]} picking up point {picked_up[2]}"
    if place.endswith("sensor") or re.fullmatch(r"[fxva]\d+", detail):
        return f"channel {detail}"
    if (place, detail) in (("time", "time"), ("joint", "joint"), ("boundary", "clamp")):
        return ""  # it says no more than the place
    return {"time": "over time", "cycles": "over the number of periods"}.get(detail, detail)


def key_text(key: str, rig: Rig) -> str:
    """A key of the rig file with the names of elements and sensors for their numbers, as ``--set`` takes it."""
    parts = key.split(".")
    if len(parts) > 1 and parts[1].isdigit():
        index = int(parts[1])
        if parts[0] == "local_elements" and index < len(rig.local_elements):
            parts[1] = rig.local_elements[index].name or parts[1]
        elif parts[0] == "sensors" and index < len(rig.sensors):
            parts[1] = rig.sensors[index].channel or parts[1]
    return ".".join(parts)


def channel_text(channel: str) -> str:
    """``displacement at point 4`` for ``x4``; other names as they are."""
    known = re.fullmatch(r"([fxva])(\d+)", channel)
    return f"{_LETTERS[known[1]]} at point {known[2]}" if known else channel


def equation_text(effect: str) -> str:
    """Equations of an effect, or of two; empty where the library has none of that name."""
    found = []
    for name in effect.split(" + "):
        try:
            found.append(effect_named(name.split("@")[0]).equation)
        except BenchError:
            return ""
    return "; ".join(found)


def parameters_text(parameters: Mapping[str, Value]) -> str:
    """Parameters with uncertainties, separated by commas."""
    groups: dict[str, list[str]] = {}
    for name, v in parameters.items():
        label, _, symbol = name.rpartition(".") if "@" in name or "." in name else ("", "", name)
        groups.setdefault(label, []).append(f"{_SYMBOLS.get(symbol, symbol)} = {value_text(v.value, v.std, v.unit)}")
    return "; ".join((f"{_label_text(label)}: " if label else "") + ", ".join(items) for label, items in groups.items())


def smallest_text(parameters: Mapping[str, Value]) -> str:
    """The smallest parameters that would show, two digits each; of a factor two digits of what it changes."""
    base = {name: float(name == "factor") for name in parameters}
    return parameters_text(
        {name: replace(v, value=base[name] + float(f"{v.value - base[name]:.1e}")) for name, v in parameters.items()}
    )


def _label_text(label: str) -> str:
    """``cubic stiffness at point 4`` for ``cubic_stiffness@4``."""
    effect, _, detail = label.partition("@")
    return effect_text(effect) + (f" at {detail_text(detail)}" if detail else "")


def sigma_text(sigma: float) -> str:
    """Expected standard deviations; beyond a hundred the number says nothing more."""
    return "> 100" if sigma > 100.0 else plain(sigma, 0)


def probability_text(p: float) -> str:
    """A probability in percent, never claiming more certainty than two digits show."""
    if not math.isfinite(p):
        return "—"
    if p > 0.995:
        return "> 99 %"
    return "< 1 %" if p < 0.005 else f"{100.0 * p:.0f} %"


def closed_text(gap: Gap) -> str:
    """Share of the gap that is closed, with its interval of 90 %."""
    value, interval = share_with_interval(gap.closed, gap.low, gap.high)
    return f"{value} ({interval})" if interval else value


def rest_text(diagnosis: Diagnosis) -> tuple[str, float]:
    """What is neither no effect nor one of the ranked ones, and its probability.

    Where no gap is claimed that is an effect too weak for these tests, whatever its name.
    """
    unknown = diagnosis.probabilities.get(UNKNOWN, 0.0)
    if diagnosis.verdict in _NO_GAP:
        return effect_text(TOO_WEAK), unknown
    return effect_text(UNKNOWN), unknown
