"""One fit: the rows that it leaves over, what may move at a cost, and columns that the rest may be a sum of."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field

import numpy as np

from nmt_core.numerics.arrays import FloatArray


@dataclass(frozen=True, eq=False)
class Columns:
    """A cause: what a unit of each of its coefficients adds to the rows.

    Attributes:
        place: where it acts; empty = everywhere.
        term: what it is; a place has one of a term at most.
        variant: number that is fixed in the columns, in words.
        values: N × K, of finite numbers, per unit of each coefficient.
        lowest, largest: of the first coefficient, or of the length of the first ``strengths`` of them; beyond these it
            is not what its name says.
        smallest: size of it below which it is not.
        strengths: number of leading columns that these limits are of; the others are free.
        of_target: whether it is a part of the target itself, so that it can make that small.
    """

    place: str
    term: str
    values: FloatArray
    variant: str = ""
    lowest: float = -np.inf
    largest: float = np.inf
    smallest: float = 0.0
    strengths: int = 1
    of_target: bool = False

    @property
    def key(self) -> tuple[str, str]:
        """Place and term, of which a set has one."""
        return self.place, self.term

    def allows(self, coefficients: FloatArray) -> bool:
        """Whether coefficients are what the name says."""
        part = coefficients[: self.strengths]
        size = float(part[0]) if self.strengths == 1 else float(np.linalg.norm(part))
        return self.lowest <= size <= self.largest and abs(size) >= self.smallest


@dataclass(frozen=True, eq=False)
class Space:
    """Rows about one fit.

    Attributes:
        left: N, what the fit leaves over.
        nuisances: N × P, what may move, per standard deviation of its prior about zero.
        groups: N; rows of one number are left out together, for they are not independent.
        independent: number of independent rows.
        floor: standard deviation of a row that no set of causes undercuts, as a noise.
        target: N, what the rows are a share of; None where no cause is a part of it.
        library: columns that may be asked.
    """

    left: FloatArray
    nuisances: FloatArray
    groups: FloatArray
    independent: float
    floor: float
    target: FloatArray | None = None
    library: Sequence[Columns] = field(default=())

    def columns(self, place: str = "", terms: Collection[str] = ()) -> list[Columns]:
        """Those of the library at a place and of some terms; an empty argument takes all."""
        return [item for item in self.library if place in ("", item.place) and (not terms or item.term in terms)]
