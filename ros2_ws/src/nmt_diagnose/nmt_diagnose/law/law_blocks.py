"""Blocks of terms that a local law may consist of, by the motion of its place."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nmt_core.numerics.arrays import FloatArray
from nmt_diagnose.law.terms import Term
from nmt_diagnose.thresholds import THRESHOLDS


@dataclass(frozen=True)
class Block:
    """A few terms that stand together.

    Attributes:
        name: of the family.
        terms: its terms.
        refined: numbers of the parameters of its terms, 1 or 2, that are moved to where the fit is best.
    """

    name: str
    terms: tuple[Term, ...]
    refined: tuple[int, ...] = ()

    @property
    def contact(self) -> bool:
        """Whether it is open along a part of the motion."""
        return self.terms[0].kind in ("gap", "stop")


def blocks(x: FloatArray, v: FloatArray) -> dict[str, list[Block]]:
    """Blocks by family along the motion of a place at all levels; of each family the best is looked for.

    Args:
        x, v: displacement (m) and velocity (m/s), (L, samples).
    """
    a, s = float(np.abs(x).max()), float(np.abs(v).max())
    most = THRESHOLDS.law.largest_slip_share
    slips, fine = a * np.geomspace(0.01, most, 14), a * np.geomspace(0.005, most, 32)
    # Where a contact is hardly reached its force hangs on the last percent of the clearance.
    free = 1.0 - np.geomspace(0.02, 0.95, 24)[::-1]
    creep = s * np.geomspace(1e-3, 0.3, 6)

    def powers(*exponents: int) -> list[Block]:
        return [Block("polynomial", tuple(Term("power", float(n)) for n in exponents))]

    found = {
        "quadratic": powers(2), "cubic": powers(3), "quintic": powers(5), "quadratic and cubic": powers(2, 3),
        "cubic and quintic": powers(3, 5), "polynomial": powers(2, 3, 5),
        "gap": [Block("gap", (Term("gap", g), Term("gap damping", g)), (1,)) for g in a * free],
        "slider": [Block("slider", (Term("slider", slip),), (1,)) for slip in fine],
        "sliders": [Block("sliders", tuple(Term("slider", slip) for slip in slips))],
        "drag": [Block("drag", (Term("speed", n),)) for n in (1.5, 2.0, 3.0)],
        "amplitude damping": [Block("amplitude damping", (Term("amplitude", 2.0),))],
        "friction": [Block("friction", (Term("friction", w),), (1,)) for w in creep],
        "weakening friction": [
            Block("weakening friction", (Term("friction", w), Term("weakening friction", w, fall)), (2,))
            for w in creep[:4]
            for fall in s * np.array([0.03, 0.08, 0.2, 0.5])
        ],
        "weakening bristle": [
            Block("weakening bristle", (Term("bristle", slip), Term("weakening bristle", slip, fall)), (1, 2))
            for slip in a * np.geomspace(0.01, 0.3, 5)
            for fall in s * np.array([0.03, 0.08, 0.2, 0.5])
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
        "brake": [Block("brake", (Term("brake", w),), (1,)) for w in s * np.geomspace(0.05, 1.0, 8)],
    }  # fmt: skip
    for side, name in ((1.0, "stop above"), (-1.0, "stop below")):
        ends = float((side * x).max()) * np.append(0.0, free)
        found[name] = [Block(name, (Term("stop", g, side), Term("stop damping", g, side)), (1,)) for g in ends]
    return found


def moved(block: Block, number: int, factor: float) -> Block:
    """The block with parameter 1 or 2 of its terms times a factor."""
    first, second = (factor, 1.0) if number == 1 else (1.0, factor)
    terms = tuple(Term(t.kind, first * t.first, second * t.second) for t in block.terms)
    return Block(block.name, terms, block.refined)
