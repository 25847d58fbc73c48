"""What held levels, or parts of a record, say of a missing law, in sentences."""

from __future__ import annotations

import math
from collections.abc import Sequence

from nmt_core.text.number_words import percent, significant
from nmt_diagnose.law.law_elements import not_written
from nmt_diagnose.law.reading import LawReading, LocalLaw
from nmt_diagnose.ledger.diagnosis import PlaceShare


def law_sentences(reading: LawReading | None, written: bool) -> tuple[str, ...]:
    """The law's family, place and closure, and whether it is ``written`` to the rig file; nothing without a law."""
    if reading is None or not reading.is_stated:
        return ()
    what = " and ".join(f"{law.family} at {_where(law)}" for law in reading.laws)
    where, pieces = ("In the record", "parts") if reading.of_record else ("At the held levels", "levels")
    if reading.late is not None:
        channel, late = reading.late
        goes = "after" if late > 0.0 else "ahead of"
        where += f", where {channel} comes {significant(1e3 * abs(late), 2)} ms {goes} the motion,"
    text = f"{where} the missing force acts like {what}"
    if math.isfinite(reading.closed_inside):
        text += f"; it closes {percent(reading.closed_inside)} of the gap at {pieces} left out inside the range"
        if math.isfinite(reading.closed_above):
            text += f" and {percent(reading.closed_above)} at the top two"
    result = [text + "."]
    alike = [law for law in reading.laws if law.other_places]
    for law in alike:
        places = " or ".join(law.other_places)
        result.append(
            f"Point {places} would do nearly as well as {law.place}; equal laws at several places say that the place "
            "may not be in the model."
        )
    for law in reading.laws:
        if law.other_families:
            families = " or ".join(law.other_families)
            result.append(f"At {_where(law)} {families} would do nearly as well.")
            if law.parted_by:
                result.append(
                    f"To part them, record a motion of {law.parted_by}. Check first that the specimen bears it."
                )
    result += [sentence for law in reading.laws for sentence in _following(law)]
    if reading.late is not None:
        result.append("Check the clocks, filters and delays of force and motion before you rely on the law.")
    if not reading.is_written:
        result.append(
            "It is not written to the rig file, which with it would predict what was left out no better than without."
        )
    if not written:
        return tuple(result)
    lacking = not_written(reading.laws)
    reach = significant(1e3 * max(law.valid_to_m for law in reading.laws), 3)
    text = f"The rig file gets it as local elements, valid up to {reach} mm"
    result.append(text + (f"; {', '.join(lacking)} has no kind there and is left out." if lacking else "."))
    channels = dict.fromkeys(name for law in reading.laws for name, *_ in law.valid_between)
    if channels:
        names = " and the ".join(channels)
        result.append(
            f"Its elements follow the {names} of a record; elsewhere modulated_value sets it, at first to the middle "
            "of its range in the records."
        )
    return tuple(result)


def led_by_law(
    from_law: Sequence[str], text: Sequence[str], law: LawReading, where: Sequence[PlaceShare]
) -> tuple[str, ...]:
    """Sentences of a law before those of the nearest explanation, without the one that names another place.

    Args:
        from_law: sentences of the law.
        text: the others; the first is of the places where there are any.
        law: the law.
        where: places that the others name.
    """
    elsewhere = bool(where) and not {one.place for one in law.laws} & set(where[0].detail.split(" + "))
    first = from_law[0] if elsewhere else f"{from_law[0]} {text[0]}"
    return (first, *text[1:], *from_law[1:])


def _following(law: LocalLaw) -> list[str]:
    """Sentences on strengths that follow a measured channel."""
    result = []
    for term in law.terms:
        base = [
            law_term
            for law_term in law.terms
            if not law_term.by and (law_term.kind, law_term.parameters) == (term.kind, term.parameters)
        ]
        if not term.by or not base:
            continue
        # A slider's limit is its stiffness times its slip displacement.
        limit = term.kind in ("slider", "bristle", "weakening bristle")
        factor = term.parameters[0] if limit else 1.0
        units = [law_term.unit.replace("N/m", "N", 1) if limit else law_term.unit for law_term in (base[0], term)]
        what = (
            "friction limit" if limit or term.kind == "friction" else f"strength of {term.of_unit_strength.form.family}"
        )
        sizes = [significant(factor * abs(law_term.coefficient), 3) for law_term in (base[0], term)]
        first = "−" if base[0].coefficient < 0.0 else ""
        sign, goes = ("+", "grows") if term.coefficient > 0.0 else ("−", "falls")
        low, high = next((low, high) for name, low, high in law.valid_between if name == term.by)
        between = f"{significant(low, 3)} and {significant(high, 3)}"
        result.append(
            f"At {_where(law)} the {what} {goes} with the {term.by}: {first}{sizes[0]} {units[0]} {sign} {sizes[1]} "
            f"{units[1]}, read between {between}."
        )
    return result


def _where(law: LocalLaw) -> str:
    return f"points {law.point} and {law.other_point}" if law.other_point else f"point {law.point}"
