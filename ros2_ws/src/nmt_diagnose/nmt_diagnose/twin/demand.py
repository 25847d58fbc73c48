"""Which solutions a prediction has to have, and which it can do without."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nmt_core.arrays import BoolArray


class UnsolvedError(ArithmeticError):
    """A level or line has no solution without which a prediction is worth nothing."""


@dataclass(frozen=True)
class Demand:
    """What is asked of the levels or lines of one test.

    A level without solution costs many times one that has it: every way to it is tried.

    Attributes:
        needed: (levels,) without a solution of one of them the prediction is worth nothing.
        left: (levels,) not solved: they keep the state that they start from.
    """

    needed: BoolArray
    left: BoolArray


def nothing_needed(levels: int) -> Demand:
    """Every level is solved if it can be."""
    none = np.zeros(levels, dtype=bool)
    return Demand(none, none)
