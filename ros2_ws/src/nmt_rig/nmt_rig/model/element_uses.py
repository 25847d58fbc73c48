"""What a local element is to those who look for a force that a model lacks: an effect, and terms of a law.

Both are data of the element's section, next to its keys and formulas. The diagnosis makes its library of effects and
the law of held levels from them, nmt_blind its truths.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class ElementEffect:
    """An effect of the diagnosis that is one element, anywhere on the structure.

    Attributes:
        name: fixed name.
        equation: force that it adds.
        reference: where it is described.
        parameters: key of the section by name of the parameter, the strength first; others are shapes, sizes of the
            displacement.
        strength: strength whose force is that of a stiffness k (N/m) at amplitude a (m) and frequency ω (rad/s).
        share: of the mode's own force at the largest amplitude, which is the typical size of the effect.
        drawn_share: the same of the truths of blind cases.
        signed: the strength may be negative.
        even: multiple of the typical size to start from where the force is even and shows no first order; 0 = none.
        starts: shapes to start from, multiples of the largest amplitude.
        equivalents: effects that look alike, and the test that distinguishes them.
    """

    name: str
    equation: str
    reference: str
    parameters: Mapping[str, str]
    strength: Callable[[float, float, float], float]
    share: float
    drawn_share: float
    signed: bool = False
    even: float = 0.0
    starts: tuple[float, ...] = ()
    equivalents: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class LawForm:
    """A term of the law of held levels: a strength c times the force of an element of unit strength.

    A term has up to two numbers: an exponent or a size, in m or m/s, and what else its kind needs.

    Attributes:
        kind: of the term.
        family: of laws that it belongs to.
        formula: force for a unit strength, as it is read. In braces: `power`, its exponent raised; `mm` and `size`, its
            first number, in mm and in SI; `last`, its last number; `beyond`, where a stop is closed.
        values: (c, first, second) -> values of the section's own keys; None = see `force`.
        words: what the force is, in words; empty = the family.
        unit: of the strength, with its exponent in braces; empty = that of the section's first own key.
        exponent: the one exponent that the element has, in place of a first number; 0 = it takes any.
        signed: the strength may be negative, as in a spring that softens; all else is passive.
        by_speed: its first number is a speed.
        of_records: it is read from records alone: a few harmonics do not tell it.
        starts: first numbers that are tried of a law of this term alone: exponents, or multiples of the largest
            displacement or speed.
        effect: (c, first) -> effect and parameters that the search begins at; None = the section's own effect.
        force: (x, v, first, second) -> force of a unit strength, where no element has it; unwritten: what is then left
            out of a rig file.
    """

    kind: str
    family: str
    formula: str
    values: Callable[[float, float, float], tuple[float, ...]] | None = None
    words: str = ""
    unit: str = ""
    exponent: float = 0.0
    signed: bool = False
    by_speed: bool = False
    of_records: bool = False
    starts: tuple[float, ...] = ()
    effect: Callable[[float, float], tuple[str, Mapping[str, float]] | None] | None = None
    force: Callable[..., Any] | None = None
    unwritten: str = ""
