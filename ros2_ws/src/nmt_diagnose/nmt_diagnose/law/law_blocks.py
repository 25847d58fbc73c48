"""Blocks of terms that a local law may consist of, by the motion of its place."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from nmt_core.numerics.arrays import BoolArray, FloatArray
from nmt_diagnose.choose.space import Columns
from nmt_diagnose.law.terms import OF_RECORDS, Term
from nmt_diagnose.measurements.imposed_motion import POSITION
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_rig.model.element_uses import LawForm
from nmt_rig.model.local_elements import SECTIONS
from nmt_rig.model.local_elements.element import MAGNITUDE_OF

_SLACK_SHARES = (0.2, 0.4, 0.6, 0.8)  # of the slip displacement
_WAVES = (1.5, 40.0, 0.2)  # of cogging along the way from end to end: fewest, most, step
_BELOW = 0.1  # of a strength that it may be below zero at the end of the range
_LEAST_EXPONENT = 1.05  # of a damper: 1 is viscous, and elements have no less
_CLOSED = (0.01, 0.8)  # of the samples of a record: least and largest share along which a contact is closed


@dataclass(frozen=True)
class Block:
    """A few terms that stand together.

    Attributes:
        name: of the family.
        terms: its terms.
        refined: numbers of the parameters of its terms, 1 or 2, that are moved to where the fit is best.
        reach: logarithm of the factor by which they are moved at most.
        half: of the range of the channel that its coefficients follow.
    """

    name: str
    terms: tuple[Term, ...]
    refined: tuple[int, ...] = ()
    reach: float = 0.4
    half: float = 0.0

    @property
    def by(self) -> str:
        """Measured channel that its coefficients follow; empty = none."""
        return self.terms[-1].by

    def following(self, channel: str, low: float, high: float) -> Block:
        """The block with coefficients that change with a measured channel, and are its strengths in its middle."""
        changing = (replace(term, by=channel, about=0.5 * (low + high)) for term in self.terms)
        return replace(self, terms=(*self.terms, *changing), half=0.5 * (high - low))

    @property
    def bounded(self) -> bool:
        """Whether its size is fitted between its neighbours: beyond them it is another block."""
        return self.contact or self.terms[0].kind == "cogging"

    @property
    def contact(self) -> bool:
        """Whether it is open along a part of the motion."""
        return self.terms[0].kind in ("gap", "stop")


def blocks(x: FloatArray, v: FloatArray) -> dict[str, list[Block]]:
    """Blocks by family along the motion of a place at all levels; the best of each family is chosen later.

    Args:
        x, v: displacement (m) and velocity (m/s), (L, samples).
    """
    a, s = float(np.abs(x).max()), float(np.abs(v).max())
    most = THRESHOLDS.law.largest_slip_share
    slips, fine = a * np.geomspace(0.01, most, 14), a * np.geomspace(0.005, most, 32)
    # Where a contact is hardly reached its force hangs on the last percent of the clearance.
    free = 1.0 - np.geomspace(0.02, 0.95, 24)[::-1]
    falls = s * np.array([0.03, 0.08, 0.2, 0.5])

    def powers(*exponents: int) -> list[Block]:
        return [Block("polynomial", tuple(Term("power", float(n)) for n in exponents))]

    forms = [(section.kind_name(), form) for section in SECTIONS for form in section.law if not form.of_records]
    found = {f"{form.kind} of {kind}": _alone(form, a, s) for kind, form in forms}
    found |= {
        "quadratic and cubic": powers(2, 3), "cubic and quintic": powers(3, 5), "polynomial": powers(2, 3, 5),
        "gap": [Block("gap", (Term("gap", g), Term("gap damping", g)), (1,)) for g in a * free],
        "slider": [Block("slider", (Term("slider", slip),), (1,)) for slip in fine],
        "sliders": [Block("sliders", tuple(Term("slider", slip) for slip in slips))],
        "weakening friction": [
            Block("weakening friction", (Term("friction", w), Term("weakening friction", w, fall)), (2,))
            for w in s * np.array(Term("friction").form.starts[:4])
            for fall in falls
        ],
        "weakening bristle": [
            Block("weakening bristle", (Term("bristle", slip), Term("weakening bristle", slip, fall)), (1, 2))
            for slip in a * np.geomspace(0.01, 0.3, 5)
            for fall in falls
        ],
        "pinched sliders": [
            Block(
                "pinched sliders",
                (
                    *(Term("slider", slip) for slip in slips),
                    *(Term("slack slider", slip, slack) for slip in slips for slack in (0.3, 0.6)),
                ),
            )
        ],
    }  # fmt: skip
    for side, name in ((1.0, "stop above"), (-1.0, "stop below")):
        ends = float((side * x).max()) * np.append(0.0, free)
        found[name] = [Block(name, (Term("stop", g, side), Term("stop damping", g, side)), (1,)) for g in ends]
    return {name: family for name, family in found.items() if family}


def blocks_of_records(x: FloatArray, v: FloatArray) -> dict[str, list[Block]]:
    """Blocks by family along records of a motion: linear forces too, and contacts that are open now and then.

    Args:
        x, v: displacement (m) and velocity (m/s), (1, samples).
    """
    found = {form.words: [Block(form.words, (Term(form.kind, form.exponent),))] for form, _ in OF_RECORDS}
    for name, family in blocks(x, v).items():
        members = [block for block in family if not block.contact or _opens(block.terms[0], x)]
        if members:
            found[name] = members
    # Backlash in series with friction: one slider whose spring has a slack and then stiffens.
    found["slack slider"] = [
        Block(
            "slack slider",
            (Term("slider", slip), *(Term("slack slider", slip, share) for share in _SLACK_SHARES)),
            (1,),
        )
        for slip in float(np.abs(x).max()) * np.geomspace(0.02, THRESHOLDS.law.largest_slip_share, 12)
    ]
    way, (fewest, most, step) = float(np.ptp(x)), _WAVES
    found["cogging"] = [
        Block("cogging", (Term("cogging", way / waves), Term("cogging", way / waves, 0.25)), (1,), step / waves)
        for waves in np.arange(most, fewest, -step)
    ]
    # Samples show the way to full friction, and exponents, which a few harmonics do not.
    found["weakening friction"] = [replace(block, refined=(1, 2)) for block in found["weakening friction"]]
    for name, members in found.items():
        if members[0].terms[0].form.starts and "{power}" in members[0].terms[0].form.formula:
            found[name] = [replace(block, refined=(1,)) for block in members]
    return found


def _opens(contact: Term, x: FloatArray) -> bool:
    """Whether a contact is neither closed along nearly all of a motion nor along hardly any of it."""
    return _CLOSED[0] < float(np.mean(contact.force(x, np.zeros_like(x)) != 0.0)) < _CLOSED[1]


def _alone(form: LawForm, a: float, s: float) -> list[Block]:
    """Blocks of one term, by largest displacement and speed; none of a term that is only tried with others."""
    if form.exponent or "{power}" in form.formula:
        return [Block(form.family, (Term(form.kind, n),)) for n in form.starts or (form.exponent,)]
    sizes = (s if form.by_speed else a) * np.array(form.starts)
    return [Block(form.family, (Term(form.kind, size),), (1,)) for size in sizes]


def moved(block: Block, number: int, factor: float) -> Block:
    """The block with parameter 1 or 2 of its terms times a factor."""
    first, second = (factor, 1.0) if number == 1 else (1.0, factor)
    terms = tuple(replace(t, first=first * t.first, second=second * t.second) for t in block.terms)
    return replace(block, terms=terms)


@dataclass(frozen=True, eq=False)
class Along:
    """A motion along which blocks act.

    Attributes:
        columns: what a unit of each term adds to the rows, N × k.
        channels: that were measured.
        range_of: smallest and largest value of a channel.
        of_law: whether it is the motion that a law makes; along another one nothing tells which of its terms act.
    """

    columns: Callable[[Sequence[Term]], FloatArray]
    channels: Sequence[str] = ()
    range_of: Callable[[str], tuple[float, float]] = field(default=lambda _: (0.0, 0.0))
    of_law: bool = True


@dataclass(frozen=True, eq=False)
class BlockColumns(Columns):
    """A block of terms along a motion.

    Attributes:
        along: the motion.
        block: the terms.
        reach: logarithms of the factors by which its parameters are moved at most.
        asked: whether its exponent is one that was asked, which is likelier than others.
    """

    along: Along = field(kw_only=True, repr=False)
    block: Block = field(kw_only=True)
    reach: tuple[float, float] = field(kw_only=True)
    asked: bool = field(kw_only=True)

    @classmethod
    def of(
        cls, place: str, name: str, along: Along, block: Block, reach: tuple[float, float], asked: bool = True
    ) -> BlockColumns:
        """The columns of a block at a place, by the name of its family."""
        freed = 0 if asked and _has_exponent(block) else len(block.refined)
        return cls(
            place, name, along.columns(block.terms) @ passive([block]), signed=signed([block]), freed=freed,
            causes=2 if block.by else 1, along=along, block=block, reach=reach, asked=asked,
        )  # fmt: skip

    @classmethod
    def every(cls, along: Along, families: Mapping[str, Sequence[Block]], place: str = "") -> list[BlockColumns]:
        """The columns of all blocks of families."""
        found = []
        for name, members in families.items():
            for number, block in enumerate(members):
                near = members[max(number - 1, 0)], members[min(number + 1, len(members) - 1)]
                found.append(cls.of(place, name, along, block, _reach(block, *near)))
        return found

    @cached_property
    def same(self) -> tuple[str, str, Block]:
        """See :attr:`Columns.same`."""
        return self.place, self.term, self.block

    def _of(self, block: Block) -> BlockColumns:
        return BlockColumns.of(self.place, self.term, self.along, block, self.reach, self.asked)

    @cached_property
    def reaches(self) -> Sequence[tuple[float, float]]:
        """See :attr:`Columns.reaches`; a contact without a clearance has none."""
        if not self.block.terms[0].first > 0.0 and 1 in self.block.refined:
            return ()
        return [self.reach] * len(self.block.refined)

    def moved(self, number: int, log_factor: float) -> BlockColumns:
        """See :meth:`Columns.moved`; what is bounded stays there."""
        low, high = self.reach
        bounded = self.block.bounded or _has_exponent(self.block)
        reach = (low - log_factor, high - log_factor) if bounded else self.reach
        block = moved(self.block, self.block.refined[number], math.exp(log_factor))
        return BlockColumns.of(self.place, self.term, self.along, block, reach, False)

    def allows(self, coefficients: FloatArray) -> bool:
        """Whether the block has a force, contacts their spring."""
        return bool(coefficients[0] if self.block.contact else np.any(coefficients))

    def shorter(self, coefficients: FloatArray) -> list[BlockColumns]:
        """The block with the terms that act, and these without one of them; with an exponent that is not fitted."""
        if not self.along.of_law:
            return []
        strengths = passive([self.block]) @ coefficients
        terms = [term for term, value in zip(self.block.terms, strengths, strict=True) if value != 0.0]
        some = [terms] if len(terms) < len(self.block.terms) else []
        for term in terms if len(terms) > 1 else ():
            if term.by or not any(other.by and replace(other, by="", about=0.0) == term for other in terms):
                some.append([other for other in terms if other != term])
        found = [self._of(replace(self.block, terms=tuple(kept))) for kept in some]
        exponent = round(2.0 * self.block.terms[0].first) / 2.0
        if _has_exponent(self.block) and not self.asked and exponent > _LEAST_EXPONENT:
            block = replace(self.block, terms=tuple(replace(term, first=exponent) for term in self.block.terms))
            reach = _reach(block, block, block)
            found.append(BlockColumns.of(self.place, self.term, self.along, block, reach))
        return found

    def following(self) -> list[BlockColumns]:
        """The block with coefficients that change with one of the measured channels."""
        found, block = [], self.block
        for channel in self.along.channels:
            low, high = self.along.range_of(channel)
            plain = channel.removeprefix(MAGNITUDE_OF)
            if block.by or block.contact or not high > low or (plain == POSITION and block.terms[0].signed):
                continue
            ends = self.along.range_of(plain)
            # Where a channel is of one sign its magnitude says the same.
            if plain == channel or ends[0] * ends[1] < 0.0:
                found.append(self._of(block.following(channel, low, high)))
        return found


def _has_exponent(block: Block) -> bool:
    return "{power}" in block.terms[0].form.formula


def _reach(block: Block, below: Block, above: Block) -> tuple[float, float]:
    """Logarithms of the factors by which a block is moved: what is bounded stays between its neighbours."""
    size = block.terms[0].first
    if not block.bounded or not size > 0.0:
        return (math.log(_LEAST_EXPONENT / size) if _has_exponent(block) else -block.reach), block.reach
    ends = sorted((below.terms[0].first, above.terms[0].first))
    return math.log(max(ends[0] / size, 0.5)), math.log(ends[1] / size)


def passive(blocks: Sequence[Block]) -> FloatArray:
    """Coefficients of terms by those that are fitted, (k, k).

    What follows a channel is fitted by its values at both ends of the range, which are not negative where the force is
    passive: the rest of a model's own damper, whose mean is an error of the model, counts as such.
    """
    terms = [term for block in blocks for term in block.terms]
    result = np.eye(len(terms))
    start = 0
    for block in blocks:
        for k, term in enumerate(block.terms):
            if term.by and not term.signed:
                pair = start + np.array([block.terms.index(replace(term, by="", about=0.0)), k])
                share = (1.0 + _BELOW) / block.half
                result[np.ix_(pair, pair)] = [[1.0, 1.0], [-share, share]]
        start += len(block.terms)
    return result


def signed(blocks: Sequence[Block]) -> BoolArray:
    """Fitted coefficients of blocks that may have either sign, (k,)."""
    return np.array([term.signed for block in blocks for term in block.terms], bool)
