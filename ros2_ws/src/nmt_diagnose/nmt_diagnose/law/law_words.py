"""Families of laws in words."""

from __future__ import annotations

from collections.abc import Sequence

from nmt_diagnose.law.terms import Term

_PLAIN = {
    "gap": "clearance", "gap damping": "clearance", "slider": "friction of a slider behind a spring",
    "speed": "damping that grows with speed", "amplitude": "damping that grows with amplitude",
    "friction": "dry friction", "weakening friction": "dry friction that weakens with speed",
    "brake": "damping that falls with speed",
}  # fmt: skip


def family(terms: Sequence[tuple[Term, float]]) -> str:
    """Family of the terms of one law with their coefficients, in words."""
    kinds = {term.kind for term, _ in terms}
    if kinds == {"power"}:
        return _polynomial(terms)
    if kinds & {"stop", "stop damping"}:
        return "stop on one side"
    if "slider" in kinds and sum(term.kind == "slider" for term, _ in terms) > 1:
        return "friction of many sliders"
    if "weakening friction" in kinds:
        return _PLAIN["weakening friction"]
    return _PLAIN[next(iter(sorted(kinds)))]


def _polynomial(terms: Sequence[tuple[Term, float]]) -> str:
    odd = [(term.first, value) for term, value in terms if term.first % 2.0]
    even = [term for term, _ in terms if not term.first % 2.0]
    if not odd:
        return "asymmetric spring"
    lowest, highest = min(odd)[1], max(odd)[1]
    name = "hardening" if lowest > 0.0 else "softening"
    if lowest * highest < 0.0:
        name += ", then hardening" if highest > 0.0 else ", then softening"
    return f"{name}, asymmetric spring" if even else f"{name} spring"
