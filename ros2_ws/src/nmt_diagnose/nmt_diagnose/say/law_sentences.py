"""What held levels, or parts of a record, say of a missing law, in sentences."""

from __future__ import annotations

import math

from nmt_core.text.number_words import percent, significant
from nmt_diagnose.law.law_elements import not_written
from nmt_diagnose.law.reading import LawReading, LocalLaw


def law_sentences(reading: LawReading | None, written: bool) -> tuple[str, ...]:
    """The law's family, place and closure, and whether it is ``written`` to the rig file; nothing without a law."""
    if reading is None or not reading.is_stated:
        return ()
    what = " and ".join(f"{law.family} at {_where(law)}" for law in reading.laws)
    where, pieces = ("In the record", "parts") if reading.of_record else ("At the held levels", "levels")
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
    if not written:
        return tuple(result)
    lacking = not_written(reading.laws)
    reach = significant(1e3 * max(law.valid_to_m for law in reading.laws), 3)
    text = f"The rig file gets it as local elements, valid up to {reach} mm"
    result.append(text + (f"; {', '.join(lacking)} has no kind there and is left out." if lacking else "."))
    return tuple(result)


def _where(law: LocalLaw) -> str:
    return f"points {law.point} and {law.other_point}" if law.other_point else f"point {law.point}"
