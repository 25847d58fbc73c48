"""A law as local elements of a rig file: a sum at one place, passive where its strengths are not negative.

A strength that follows a channel is that of an element that is ``modulated_by`` it, about the middle of the visited
range.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from nmt_diagnose.effects.rig_edit import with_element
from nmt_diagnose.law.reading import LawReading, LawTerm, LocalLaw
from nmt_rig.model.local_elements.element import ElementSection
from nmt_rig.rig import Rig


def element_of(term: LawTerm, law: LocalLaw) -> ElementSection | None:
    """The local element of a term; None where no kind of the rig file has its force."""
    found = term.of_unit_strength
    if found.section is None:
        return None
    keys: dict[str, Any] = {"point": law.point, **found.values(term.coefficient)}
    if found.below:
        keys["reversed"] = True
    if law.other_point:
        keys["other_point"] = law.other_point
    for other in law.terms:
        if other.by and (other.kind, other.parameters) == (term.kind, term.parameters) and term.coefficient:
            low, high = next((low, high) for name, low, high in law.valid_between if name == other.by)
            keys["modulated_by"], keys["modulated_at"] = other.by, 0.5 * (low + high)
            keys["modulated_share"] = other.coefficient / term.coefficient
    return found.section.model_construct(kind=found.section.kind_name(), valid_to_m=law.valid_to_m, **keys)


def with_law(rig: Rig, reading: LawReading) -> Rig:
    """The rig with the laws of a reading as local elements; terms that no kind of element has are left out.

    A force that comes late is that of its sensor, too; a channel leads by no more than a sampling interval.
    """
    if reading.late is not None and reading.late[1] > -1.0 / rig.sample_rate_hz:
        name, late = reading.late
        sensors = [
            s.model_copy(update={"delay_s": s.delay_s + late}) if rig.sensor_channel(s) == name else s
            for s in rig.sensors
        ]
        rig = rig.model_copy(update={"sensors": sensors})
    return with_laws(rig, reading.laws)


def with_laws(rig: Rig, laws: Sequence[LocalLaw]) -> Rig:
    """As :func:`with_law`, of some laws."""
    for law in laws:
        for term in law.at_middle:
            element = element_of(term, law)
            if element is not None:
                rig = with_element(rig, element)  # type: ignore[arg-type]
    return rig


def not_written(laws: Sequence[LocalLaw]) -> tuple[str, ...]:
    """What of the laws no kind of element has, in words."""
    terms = [term for law in laws for term in law.at_middle if element_of(term, law) is None]
    return tuple(dict.fromkeys(term.of_unit_strength.form.unwritten for term in terms))
