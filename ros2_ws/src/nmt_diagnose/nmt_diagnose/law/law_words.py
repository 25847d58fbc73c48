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


_SMALL_SHARE = 0.05
"""Force of a slider over the largest below which it says nothing of the family."""
_ONE_RATIO = 1.6
"""Ratio of slip displacements up to which sliders of a grid stand for one between them."""


def family(terms: Sequence[tuple[Term, float]]) -> str:
    """Family of the terms of one law with their coefficients, in words."""
    kinds = {term.kind for term, _ in terms}
    if kinds == {"power"}:
        return _polynomial(terms)
    if kinds & {"stop", "stop damping"}:
        return "stop on one side"
    sliders = [(term.first, value * term.first) for term, value in terms if term.kind == "slider"]
    if sliders:
        most = max(force for _, force in sliders)
        large = [slip for slip, force in sliders if force > _SMALL_SHARE * most]
        return "friction of many sliders" if max(large) > _ONE_RATIO * min(large) else _PLAIN["slider"]
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
