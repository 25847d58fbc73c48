"""One fit: the rows that it leaves over, what may move at a cost, and columns that the rest may be a sum of."""

from __future__ import annotations

from collections.abc import Collection, Hashable, Sequence
from dataclasses import dataclass, field

import numpy as np

from nmt_core.numerics.arrays import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class Columns:
    """A cause: what a unit of each of its coefficients adds to the rows.

    Attributes:
        place: where it acts; empty = everywhere.
        term: what it is; a place has one of a term at most.
        values: N × K, of finite numbers, per unit of each coefficient.
        variant: number that is fixed in the columns, in words.
        lowest, largest: of the first coefficient, or of the length of the first ``strengths`` of them; beyond these it
            is not what its name says.
        smallest: size of it below which it is not.
        strengths: number of leading columns that these limits are of; the others are free.
        of_target: whether it is a part of the target itself, so that it can make that small.
        signed: K, coefficients that may have either sign; None = all, the others are not negative.
        freed: numbers in the columns that are fitted, too.
        causes: that it counts as.
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
    signed: BoolArray | None = None
    freed: int = 0
    causes: int = 1

    @property
    def key(self) -> tuple[str, str]:
        """Place and term, of which a set has one."""
        return self.place, self.term

    @property
    def same(self) -> Hashable:
        """Equal for causes that are the same."""
        return id(self)

    @property
    def reaches(self) -> Sequence[tuple[float, float]]:
        """Of each number in the columns that is moved to where the fit is best the logarithms of the factors."""
        return ()

    def allows(self, coefficients: FloatArray) -> bool:
        """Whether coefficients are what the name says."""
        part = coefficients[: self.strengths]
        size = float(part[0]) if self.strengths == 1 else float(np.linalg.norm(part))
        return self.lowest <= size <= self.largest and abs(size) >= self.smallest

    def moved(self, number: int, log_factor: float) -> Columns:
        """The cause with one of its numbers times a factor."""
        raise NotImplementedError

    def shorter(self, coefficients: FloatArray) -> Sequence[Columns]:
        """The cause with fewer columns, by what its coefficients are."""
        del coefficients
        return ()

    def following(self) -> Sequence[Columns]:
        """The cause with coefficients that change with something measured."""
        return ()


@dataclass(frozen=True, eq=False)
class Space:
    """Rows about one fit.

    Attributes:
        left: N, the residual of the fit.
        nuisances: N × P, what may move, per standard deviation of its prior about zero.
        groups: N; rows of one number are left out together, for they are not independent.
        independent: number of independent rows; NaN = estimated from the residual along the series.
        floor: standard deviation of a row that no set of causes undercuts, as a noise.
        target: N, what the rows are a share of; None where no cause is a part of it.
        library: columns that may be asked.
        ends: groups that are in every fit, for the others predict nothing of them.
        series: rows that follow each other, of each series.
        bound: whether the floor bounds smooth errors: what lies below it asks for no more causes.
    """

    left: FloatArray
    nuisances: FloatArray
    groups: FloatArray
    independent: float
    floor: float
    target: FloatArray | None = None
    library: Sequence[Columns] = field(default=())
    ends: Collection[float] = ()
    series: Sequence[IntArray] = ()
    bound: bool = False

    def columns(self, place: str = "", terms: Collection[str] = ()) -> list[Columns]:
        """Those of the library at a place and of some terms; an empty argument takes all."""
        return [item for item in self.library if place in ("", item.place) and (not terms or item.term in terms)]

    def independent_by(self, left: FloatArray) -> float:
        """Number of independent rows, estimated from a residual: correlated neighbours count once."""
        if np.isfinite(self.independent):
            return self.independent
        return sum(rows.size * independent_share(left[rows] - left[rows].mean()) for rows in self.series)


def independent_share(row: FloatArray) -> float:
    """Independent samples over samples (Bartlett, J. R. Stat. Soc. Suppl. 8 (1946) 27)."""
    power = np.abs(np.fft.rfft(row, 2 * row.size)) ** 2
    correlation = np.fft.irfft(power)[: row.size]
    if not correlation[0] > 0.0:
        return 1.0
    ends = np.flatnonzero(correlation < 0.0)
    summed = float(correlation[1 : int(ends[0]) if ends.size else None].sum()) / float(correlation[0])
    return 1.0 / (1.0 + 2.0 * summed)
