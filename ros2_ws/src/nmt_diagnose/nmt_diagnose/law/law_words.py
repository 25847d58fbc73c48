"""Families of laws in words."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from nmt_core.text.number_words import significant
from nmt_diagnose.law.terms import Term

_SMALL_SHARE = 0.05
"""Force of a slider over the largest, of weakening bristles over all, below which it says nothing of the family."""
_SLACK_SHARE = 0.2
"""The same of sliders with slack: a grid of sliders takes some of them for its corners."""
_SLIDERS = ("slider", "slack slider", "bristle", "weakening bristle")
_PAST_THE_FALL = 5.0  # speed at which a force that falls with it has gone, over the largest speed of its formula
_ONE_RATIO = 1.6
"""Ratio of slip displacements up to which sliders of a grid stand for one between them."""


def family(terms: Sequence[tuple[Term, float]]) -> str:
    """Family of the terms of one law with their coefficients, in words."""
    words = {term.kind: term.form.words or term.form.family for term, _ in terms}
    kinds = set(words)
    if kinds == {"power"}:
        return terms[0][0].form.words or _polynomial(terms)
    if kinds & {"stop", "stop damping"}:
        return Term("stop").form.words
    sliders = [(term.first, _sliding_force(term, value)) for term, value in terms if term.kind in _SLIDERS]
    if sliders:
        by_kind = {
            kind: sum(_sliding_force(t, c) for t, c in terms if t.kind == kind) for kind in kinds & set(_SLIDERS)
        }
        total = sum(by_kind.values())
        for kind, share in (("slack slider", _SLACK_SHARE), ("weakening bristle", _SMALL_SHARE)):
            if by_kind.get(kind, 0.0) > share * total:
                return words[kind]
        most = max(force for _, force in sliders)
        large = [slip for slip, force in sliders if force > _SMALL_SHARE * most]
        return "friction of many sliders" if max(large) > _ONE_RATIO * min(large) else Term("slider").form.words
    return words["weakening friction" if _weakens(terms) else min(kinds - {"weakening friction"} or kinds)]


def _weakens(terms: Sequence[tuple[Term, float]]) -> bool:
    """Whether dry friction falls with speed, and is not a knee of another shape."""
    falling = [term for term, _ in terms if term.kind == "weakening friction"]
    if not falling:
        return False
    v = np.linspace(0.0, _PAST_THE_FALL * max(max(term.first, term.second) for term in falling), 400)
    force = np.sum([value * term.force(0.0 * v, v) for term, value in terms], axis=0)
    return bool(force.max() - force[-1] > _SMALL_SHARE * force.max())


def _sliding_force(term: Term, coefficient: float) -> float:
    """Force at which a slider or bristles slide, at their slowest."""
    return coefficient * term.first * (1.0 - term.second if term.kind == "slack slider" else 1.0)


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


def formula(term: Term) -> str:
    """Force of a term for a unit strength, as it is read: displacement x, velocity v."""
    first, side = term.first, -1.0 if term.second < 0.0 else 1.0
    gap = significant(math.copysign(1e3 * first, side), 3)
    text = term.form.formula.format(
        power="" if first == 1.0 else raised(f"{first:.3g}"), mm=significant(1e3 * first, 3),
        size=significant(first, 2), last=significant(term.second, 2),
        beyond=f"x {'>' if side > 0.0 else '<'} {gap} mm",
    )  # fmt: skip
    return f"{term.by} times: {text}" if term.by else text


def raised(number: str) -> str:
    """``³`` for ``3``."""
    return number.translate(_RAISED)


_RAISED = str.maketrans("0123456789.", "⁰¹²³⁴⁵⁶⁷⁸⁹·")
