"""Records in parts that stand for levels: what a law is fitted to where it is read from samples.

Each part is predicted by a fit to the others. A record says what is missing at its rows, what a unit of a term adds
there, and what its errors of chain and model add; how it knows is its kind's matter.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Generic, Protocol, TypeVar

import numpy as np

from nmt_core.numerics.arrays import FloatArray, IntArray
from nmt_diagnose.choose.space import independent_share
from nmt_diagnose.law.terms import Term
from nmt_diagnose.observations.observables import Part, Rows
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_rig.rig import Rig

PARTS = 10
ROWS = 2500  # of all records together
DELAY = "delay of"
HALF_A_SAMPLE = 0.5
STEP = 1e-3  # of a logarithm, for differences


class SampledRecord(Protocol):
    """One record.

    Attributes:
        test: of the record.
        rate: samples of the motion a second, Hz.
        x, v: motion of the place of the law, m and m/s, (1, n).
        parts: samples of the motion at which each part has a row; ascending within a stream.
        streams: number of the channel that each row of a part is of.
        missing: what the model lacks at the rows of each part, in the unit of their channel.
        sigma: standard deviation of each.
        errors: what a standard deviation of each error of chain and model adds.
        free: errors that are ordinarily of any size.
        channels: measured channels that a coefficient may follow, (1, n).
    """

    @property
    def test(self) -> Any: ...  # noqa: D102
    @property
    def rate(self) -> float: ...  # noqa: D102
    @property
    def x(self) -> FloatArray: ...  # noqa: D102
    @property
    def v(self) -> FloatArray: ...  # noqa: D102
    @property
    def parts(self) -> tuple[IntArray, ...]: ...  # noqa: D102
    @property
    def streams(self) -> tuple[IntArray, ...]: ...  # noqa: D102
    @property
    def missing(self) -> tuple[FloatArray, ...]: ...  # noqa: D102
    @property
    def sigma(self) -> tuple[FloatArray, ...]: ...  # noqa: D102
    @property
    def errors(self) -> dict[str, tuple[FloatArray, ...]]: ...  # noqa: D102
    @property
    def free(self) -> frozenset[str]: ...  # noqa: D102
    @property
    def channels(self) -> dict[str, FloatArray]: ...  # noqa: D102

    def left_by(self, rig: Rig) -> list[FloatArray]:
        """What another rig leaves of each part, by the prediction that a diagnosis makes with it."""
        ...

    def force(self, term: Term) -> FloatArray:
        """Force of a term of unit strength at all samples, N, (n,)."""
        ...

    def column(self, term: Term) -> FloatArray:
        """What a term of unit strength adds to the rows, part after part."""
        ...

    def force_at(self, part: int, corrected: FloatArray) -> tuple[IntArray, FloatArray, float]:
        """Samples of a part, the missing force there and its standard uncertainty, N.

        Args:
            part: its number.
            corrected: what is missing at its rows without errors of chain and model, over the standard deviation.
        """
        ...


def rows_at(test: int, channel: int, time_s: FloatArray) -> Rows:
    """Rows of samples of a channel of a test."""

    def filled(value: int) -> IntArray:
        return np.full(time_s.size, value, np.int64)

    nothing = np.zeros(time_s.size)
    return Rows(
        filled(test), filled(0), filled(channel), filled(-1), filled(int(Part.SAMPLE)), time_s, nothing, nothing
    )


R = TypeVar("R", bound=SampledRecord)


def parts_by_motion(records: Sequence[SampledRecord]) -> tuple[tuple[int, int], ...]:
    """Record and number of each part, in the order of their motion; nothing where they are too few to leave one out."""
    pairs = [(k, part) for k, record in enumerate(records) for part in range(len(record.parts))]
    pairs.sort(key=lambda pair: float(np.std(records[pair[0]].x[0, records[pair[0]].parts[pair[1]]])))
    return tuple(pairs) if len(pairs) >= THRESHOLDS.law.fewest_levels else ()


@dataclass(frozen=True)
class SampledRecords(Generic[R]):
    """Records whose missing force is one law; their parts ascend in motion.

    Attributes:
        records: one or more.
        part_of: record and number of each part.
        late: samples of the force by which it comes later than the motion.
    """

    records: tuple[R, ...]
    part_of: tuple[tuple[int, int], ...]
    late: int = 0
    _columns: dict[Term, FloatArray] = field(default_factory=dict, repr=False, compare=False)

    @property
    def count(self) -> int:
        """Number of parts."""
        return len(self.part_of)

    @property
    def place(self) -> tuple[int, int]:
        """Point at which the law acts and the other one; 0 = the ground."""
        raise NotImplementedError

    @property
    def bound(self) -> bool:
        """Whether the standard deviations bound errors of the motion, too, and are not those of noise."""
        return False

    @property
    def lateness(self) -> tuple[str, float] | None:
        """Channel of the force and duration of a sample of it, s; None where it is in step."""
        return None

    @property
    def x(self) -> FloatArray:
        """Displacement at the rows, m, (1, n)."""
        return np.concatenate([record.x[:, record.parts[part]] for record, part in self._parts()], axis=1)

    @property
    def v(self) -> FloatArray:
        """Velocity at the rows, m/s, (1, n)."""
        return np.concatenate([record.v[:, record.parts[part]] for record, part in self._parts()], axis=1)

    def left_by(self, rig: Rig, parts: Sequence[int]) -> float:
        """rms residual of another rig on some parts, in standard deviations, but for constants of the channels."""
        found = [record.left_by(rig) for record in self.records]
        squares = rows = 0.0
        for k, record in enumerate(self.records):
            here = [part for number, part in (self.part_of[p] for p in parts) if number == k]
            if not here:
                continue
            left, sigma, streams = (
                np.concatenate([values[part] for part in here]) for values in (found[k], record.sigma, record.streams)
            )
            for stream in np.unique(streams):
                some = streams == stream
                centred = left[some] - np.average(left[some], weights=sigma[some] ** -2.0)
                squares, rows = squares + float(np.sum((centred / sigma[some]) ** 2)), rows + centred.size
        return math.sqrt(squares / rows)

    def range_of(self, channel: str) -> tuple[float, float]:
        """Smallest and largest value of a channel at the rows; both 0 where a record has none of that name."""
        if any(channel not in record.channels for record in self.records):
            return 0.0, 0.0
        values = [record.channels[channel][0, record.parts[part]] for record, part in self._parts()]
        return min(float(one.min()) for one in values), max(float(one.max()) for one in values)

    @property
    def names(self) -> tuple[str, ...]:
        """Errors of chain and model."""
        return tuple(dict.fromkeys(name for record in self.records for name in record.errors))

    @property
    def free(self) -> frozenset[str]:
        """Errors that are ordinarily of any size."""
        return frozenset().union(*(record.free for record in self.records))

    @cached_property
    def missing(self) -> FloatArray:
        """What the model lacks over its standard deviation, (P, M); 0 where a part has no row."""
        return self._padded([record.missing[part] / record.sigma[part] for record, part in self._parts()])

    @property
    def nuisance(self) -> FloatArray:
        """What a standard deviation of each error adds, in standard deviations of the rows, (P, M, m)."""
        columns = []
        for name in self.names:
            rows = [
                record.errors[name][part] / record.sigma[part]
                if name in record.errors
                else np.zeros(record.parts[part].size)
                for record, part in self._parts()
            ]
            columns.append(self._padded(rows))
        return np.stack(columns, axis=-1) if columns else np.zeros((*self.missing.shape, 0))

    def columns(self, terms: Sequence[Term]) -> FloatArray:
        """What terms of unit strength add, in standard deviations of the rows, (P, M, k)."""
        for term in terms:
            if term not in self._columns:
                self._columns[term] = self._column(term)
        made = [self._columns[term] for term in terms]
        # The samples of a term lie side by side: fits run along them.
        return np.moveaxis(np.stack(made), 0, -1) if made else np.zeros((*self.missing.shape, 0))

    def _column(self, term: Term) -> FloatArray:
        column = np.zeros(self.missing.shape)
        for record, (sigma, places) in zip(self.records, self._places, strict=True):
            column.ravel()[places] = record.column(term) / sigma
        return column

    @cached_property
    def _places(self) -> list[tuple[FloatArray, IntArray]]:
        """Of each record the standard deviations of its rows, part after part, and their places in a column."""
        longest = self.missing.shape[1]
        found = []
        for number, record in enumerate(self.records):
            row_of = {part: row for row, (k, part) in enumerate(self.part_of) if k == number}
            places = [row_of[part] * longest + np.arange(rows.size) for part, rows in enumerate(record.parts)]
            found.append((np.concatenate(record.sigma), np.concatenate(places)))
        return found

    def _parts(self) -> list[tuple[R, int]]:
        return [(self.records[k], part) for k, part in self.part_of]

    def _padded(self, rows: Sequence[FloatArray]) -> FloatArray:
        result = np.zeros((len(rows), max(row.size for row in rows)))
        for k, row in enumerate(rows):
            result[k, : row.size] = row
        return result

    def series(self) -> list[tuple[int, IntArray, FloatArray]]:
        """Part, its rows of one channel, and the times of these, s; one after the other."""
        found = []
        for number, (record, part) in enumerate(self._parts()):
            for stream in np.unique(record.streams[part]):
                rows = np.flatnonzero(record.streams[part] == stream)
                found.append((number, rows, record.parts[part][rows] / record.rate))
        return found

    def independent(self, left: FloatArray) -> float:
        """Independent rows over rows, by a law's residual, (P, M): correlated neighbours count once."""
        total = independent = 0.0
        for number, rows, _ in self.series():
            row = left[number, rows] - left[number, rows].mean()
            total += rows.size
            independent += rows.size * independent_share(row)
        return independent / total
