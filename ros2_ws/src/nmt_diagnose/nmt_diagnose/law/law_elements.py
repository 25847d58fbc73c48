"""A law as local elements of a rig file: a sum at one place, passive where its strengths are not negative."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from nmt_diagnose.effects.changes import kind_of
from nmt_diagnose.effects.rig_edit import with_element
from nmt_diagnose.law.reading import LawReading, LawTerm, LocalLaw
from nmt_diagnose.law.terms import LEFT_SHARE
from nmt_rig.model.local_elements.attachments import LuGreSection
from nmt_rig.model.local_elements.contacts import TwoSidedGapSection, UnilateralStopSection
from nmt_rig.model.local_elements.dampers import AmplitudeDamperSection, EddyBrakeSection, PowerLawDamperSection
from nmt_rig.model.local_elements.element import ElementSection
from nmt_rig.model.local_elements.friction import JenkinsSection, TanhFrictionSection
from nmt_rig.model.local_elements.springs import CubicSpringSection, QuadraticSpringSection, QuinticSpringSection
from nmt_rig.rig import Rig

_SPRINGS: dict[float, type[ElementSection]] = {
    2.0: QuadraticSpringSection, 3.0: CubicSpringSection, 5.0: QuinticSpringSection,
}  # fmt: skip
_NAMES = {
    "gap damping": "damping in contact",
    "stop damping": "damping in contact",
    "stop": "a stop on the negative side",
    "weakening friction": "the part of the friction that weakens with speed",
    "slack slider": "the part of the friction with slack",
}


def element_of(term: LawTerm, law: LocalLaw) -> ElementSection | None:
    """The local element of a term; None where no kind of the rig file has its force."""
    found = _keys(term)
    if found is None:
        return None
    section, keys = found
    place: dict[str, Any] = {"point": law.point}
    if law.other_point:
        place["other_point"] = law.other_point
    return section.model_construct(kind=kind_of(section), valid_to_m=law.valid_to_m, **place, **keys)  # type: ignore[arg-type]


def _keys(term: LawTerm) -> tuple[type[ElementSection], dict[str, float]] | None:
    c = term.coefficient
    first = term.parameters[0] if term.parameters else 0.0
    if term.kind == "power":
        section = _SPRINGS.get(first)
        return None if section is None else (section, {f"stiffness_n_m{'' if first == 1.0 else f'{first:g}'}": c})
    if term.kind == "gap":
        return TwoSidedGapSection, {"stiffness_n_m": c, "gap_m": first}
    if term.kind == "stop":
        gap, side = (first, term.parameters[-1]) if len(term.parameters) > 1 else (0.0, first)
        return (UnilateralStopSection, {"stiffness_n_m": c, "gap_m": gap}) if side > 0.0 else None
    if term.kind == "slider":
        return JenkinsSection, {"tangential_stiffness_n_m": c, "slip_force_n": c * first}
    if term.kind in ("bristle", "weakening bristle"):
        weakens = term.kind == "weakening bristle"
        return LuGreSection, {
            "bristle_stiffness_n_m": c, "bristle_damping_ns_m": 0.0, "viscous_damping_ns_m": 0.0,
            "coulomb_force_n": c * first * (LEFT_SHARE if weakens else 1.0), "static_force_n": c * first,
            "stribeck_velocity_m_s": term.parameters[-1] if weakens else 1.0,
        }  # fmt: skip
    if term.kind == "speed":
        return PowerLawDamperSection, {"coefficient_n_sp_mp": c, "exponent": first}
    if term.kind == "amplitude" and first == 2.0:
        return AmplitudeDamperSection, {"damping_ns_m3": c}
    if term.kind == "friction":
        return TanhFrictionSection, {"slip_force_n": c, "reference_velocity_m_s": first}
    if term.kind == "brake":
        return EddyBrakeSection, {"damping_ns_m": c, "critical_velocity_m_s": first}
    return None


def with_law(rig: Rig, reading: LawReading) -> Rig:
    """The rig with the laws of a reading as local elements; terms that no kind of element has are left out."""
    for law in reading.laws:
        for term in law.terms:
            element = element_of(term, law)
            if element is not None:
                rig = with_element(rig, element)  # type: ignore[arg-type]
    return rig


def not_written(laws: Sequence[LocalLaw]) -> tuple[str, ...]:
    """What of the laws no kind of element has, in words."""
    lacking = [_NAMES.get(term.kind, term.kind) for law in laws for term in law.terms if element_of(term, law) is None]
    return tuple(dict.fromkeys(lacking))
