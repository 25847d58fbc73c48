"""Records of imposed motion as samples of the force that the model lacks.

What is left of the measured force by the model that is moved as measured is the missing force itself, at the point that
is moved. Parts of the records stand for levels, each of which is predicted by a fit to the others. What chain and model
are ordinarily off by are columns under their priors: gains and zeros of motion and force, and every parameter of the
model. A force that does not change is no law: it is a preload or the zero of the cell, and free.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from nmt_core.numerics.arrays import FloatArray, IntArray
from nmt_core.vocabulary import Quantity
from nmt_diagnose.effects.calibration import calibration_parameters
from nmt_diagnose.law.terms import Term
from nmt_diagnose.measurements.driven_record.reading import spread_samples
from nmt_diagnose.measurements.imposed_motion.imposed_motion import ImposedMotion
from nmt_diagnose.observations.observables import Observations, Part, Rows
from nmt_diagnose.prediction.parts_cache import PartsCache
from nmt_diagnose.prediction.prediction_settings import PredictionSettings
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_rig.rig import Rig

_PARTS = 10
_ROWS = 2500  # of all records together
DELAY = "delay of the force"
HALF_A_SAMPLE = 0.5
_STEP = 1e-3  # of a logarithm, for differences


@dataclass(frozen=True)
class MovedRecord:
    """One record.

    Attributes:
        test: of the record.
        x, v: its motion, m and m/s, (1, n).
        parts: samples of the motion at which each part has a row, ascending.
        rows: of all parts.
        force_at: samples of the force of each part.
        measured: force at these, N.
        missing: measured force less that of the model at these, N.
        sigma: standard deviation of each, N.
        errors: what a standard deviation of each error of chain and model adds, N.
        channels: measured channels that a coefficient may follow, (1, n); the displacement is one.
    """

    test: ImposedMotion
    x: FloatArray
    v: FloatArray
    parts: tuple[IntArray, ...]
    rows: Rows
    force_at: tuple[IntArray, ...]
    measured: FloatArray
    missing: tuple[FloatArray, ...]
    sigma: tuple[FloatArray, ...]
    errors: dict[str, tuple[FloatArray, ...]]
    channels: dict[str, FloatArray]

    @classmethod
    def of(
        cls, rig: Rig, observations: Observations, number: int, parts: int, most: int, late: int = 0
    ) -> MovedRecord | None:
        """The record of one test in parts; None where its force was not measured or rows are too few.

        Args:
            rig: the model.
            observations: the real side.
            number: of the test.
            parts: number of parts.
            most: rows.
            late: samples of the force by which it comes later than the motion.
        """
        test, rows = observations.tests[number].moved_as, observations.rows
        force = [
            k for k, channel in enumerate(observations.tests[number].channels) if channel.quantity is Quantity.FORCE
        ]
        if test is None or not force or not test.force.size:
            return None
        selected = (rows.test == number) & (rows.part == Part.SAMPLE) & (rows.channel == force[0])
        samples = np.flatnonzero(np.isfinite(test.force))
        if int(selected.sum()) < parts * THRESHOLDS.law.fewest_levels:
            return None
        factor = test.input.size // test.force.size
        # The model's own delay of the force is in its prediction, but not in terms.
        channel = observations.tests[number].channels[force[0]].name
        modelled = sum(sensor.delay_s for sensor in rig.sensors if rig.sensor_channel(sensor) == channel)
        moved = factor * late + round(modelled * test.sample_rate)
        at = factor * samples - moved
        samples = samples[(at >= 0) & (at < test.input.size)]
        samples = samples[spread_samples(0, samples.size, most)]
        time_s = test.start_s + (samples - late) * factor / test.sample_rate
        dense = _rows_at(number, force[0], time_s)
        settings = PredictionSettings()
        predictor, cache = test.predictor(dense, settings), PartsCache(settings)
        base = predictor.values(rig, cache, ())
        known = np.argsort(rows.time_s[selected])
        sigma = np.interp(time_s, rows.time_s[selected][known], observations.sigma[selected][known])
        chain = observations.chains[number] if observations.chains else None
        errors = dict(test.record_errors(dense, rig, cache, settings, chain)[0])
        errors[constant_of(test)] = np.full(samples.size, test.force_n)
        # Channels are sampled in step or half a sample apart.
        slope = np.gradient(np.interp(np.arange(test.force.size), samples, test.force[samples]))
        errors[f"{DELAY} in {test.name}"] = HALF_A_SAMPLE * slope[samples]
        for parameter in calibration_parameters(rig):
            change = (predictor.values(parameter.apply(rig, _STEP), cache, ()) - base) / _STEP
            if np.any(change):
                errors[parameter.name] = parameter.std * change
        pieces = [piece for piece in np.array_split(np.arange(samples.size), parts) if piece.size]
        missing = test.force[samples] - base
        return cls(
            test, test.motion[:1], test.motion[1:2],
            tuple(factor * samples[piece] - moved for piece in pieces), dense,
            tuple(samples[piece] for piece in pieces), test.force[samples],
            tuple(missing[piece] for piece in pieces),
            tuple(sigma[piece] for piece in pieces),
            {name: tuple(column[piece] for piece in pieces) for name, column in errors.items()},
            {name: values[np.newaxis] for name, values in test.signals.items()},
        )  # fmt: skip

    def left_by(self, rig: Rig) -> list[FloatArray]:
        """What another rig leaves of the force of each part, by the prediction that a diagnosis makes with it, N."""
        settings = PredictionSettings()
        values = self.test.predictor(self.rows, settings).values(rig, PartsCache(settings), ())
        return np.split(self.measured - values, np.cumsum([part.size for part in self.parts])[:-1])

    def moved(self, part: int, late: int) -> FloatArray:
        """Missing force of a part where the measured one is taken so many samples later, N; its ends stay."""
        force, at = self.test.force, self.force_at[part]
        known = np.flatnonzero(np.isfinite(force))
        there: FloatArray = np.interp(at + late, known, force[known])
        return self.missing[part] + there - force[at]

    def force(self, term: Term, at: IntArray | slice = slice(None)) -> FloatArray:
        """Force of a term of unit strength at samples, N, (n,); its memory begins as that of the file does."""
        force: FloatArray
        if term.remembers:
            force = term.force(self.x, self.v, closed=False)[0, at]
        else:
            force = term.force(self.x[:, at], self.v[:, at])[0]
        return force * (self.channels[term.by][0, at] - term.about) if term.by else force


def constant_of(test: ImposedMotion) -> str:
    """Name of the force of a record that does not change."""
    force = next(channel for channel in test.channels if channel.quantity is Quantity.FORCE)
    return f"zero of {force.name} in {test.name}"


def _rows_at(test: int, channel: int, time_s: FloatArray) -> Rows:
    def filled(value: int) -> IntArray:
        return np.full(time_s.size, value, np.int64)

    nothing = np.zeros(time_s.size)
    return Rows(
        filled(test), filled(0), filled(channel), filled(-1), filled(int(Part.SAMPLE)), time_s, nothing, nothing
    )


@dataclass(frozen=True)
class MovedRecords:
    """Records whose missing force is one law; their parts ascend in motion.

    Attributes:
        records: one or more.
        part_of: record and number of each part.
        late: samples of the force by which it comes later than the motion.
    """

    records: tuple[MovedRecord, ...]
    part_of: tuple[tuple[int, int], ...]
    late: int = 0
    _columns: dict[Term, FloatArray] = field(default_factory=dict, repr=False, compare=False)

    @classmethod
    def of(cls, rig: Rig, observations: Observations, late: int = 0) -> MovedRecords | None:
        """The records of imposed motion among some tests, the force so many samples late; None without one."""
        numbers = [k for k, test in enumerate(observations.tests) if test.moved_as is not None]
        if not numbers:
            return None
        parts, most = max(1, round(_PARTS / len(numbers))), _ROWS // len(numbers)
        records = [MovedRecord.of(rig, observations, k, parts, most, late) for k in numbers]
        found = tuple(record for record in records if record is not None)
        pairs = [(k, part) for k, record in enumerate(found) for part in range(len(record.parts))]
        pairs.sort(key=lambda pair: float(np.std(found[pair[0]].x[0, found[pair[0]].parts[pair[1]]])))
        return cls(found, tuple(pairs), late) if len(pairs) >= THRESHOLDS.law.fewest_levels else None

    @property
    def count(self) -> int:
        """Number of parts."""
        return len(self.part_of)

    @property
    def point(self) -> int:
        """That is moved."""
        return self.records[0].test.drive_point

    @property
    def x(self) -> FloatArray:
        """Displacement at the rows, m, (1, n)."""
        return np.concatenate([record.x[:, record.parts[part]] for record, part in self._parts()], axis=1)

    @property
    def v(self) -> FloatArray:
        """Velocity at the rows, m/s, (1, n)."""
        return np.concatenate([record.v[:, record.parts[part]] for record, part in self._parts()], axis=1)

    def left_by(self, rig: Rig, parts: Sequence[int]) -> float:
        """rms of what another rig leaves of some parts, in standard deviations, but for constants of the records."""
        forces = [record.left_by(rig) for record in self.records]
        squares = rows = 0.0
        for k, record in enumerate(self.records):
            here = [part for number, part in (self.part_of[p] for p in parts) if number == k]
            if here:
                left = np.concatenate([forces[k][part] for part in here])
                sigma = np.concatenate([record.sigma[part] for part in here])
                left = left - np.average(left, weights=sigma**-2.0)
                squares, rows = squares + float(np.sum((left / sigma) ** 2)), rows + left.size
        return math.sqrt(squares / rows)

    def moved(self, late: int) -> FloatArray:
        """:attr:`missing` where the measured force is taken so many samples later."""
        return self._padded([record.moved(part, late) / record.sigma[part] for record, part in self._parts()])

    @property
    def force_channel(self) -> str:
        """Name of the channel of the force."""
        return next(c.name for c in self.records[0].test.channels if c.quantity is Quantity.FORCE)

    @property
    def force_rate(self) -> float:
        """Samples of the force a second, Hz."""
        test = self.records[0].test
        return test.sample_rate * test.force.size / test.input.size

    @property
    def samples_of_a_turn(self) -> float:
        """Samples of the force in a period of the middle frequency of the fastest record."""
        return self.force_rate / max(record.test.frequency_hz for record in self.records)

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

    @cached_property
    def missing(self) -> FloatArray:
        """Missing force over its standard deviation, (P, M); 0 where a part has no row."""
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
        """Forces of terms along the motion in standard deviations of the rows, (P, M, k)."""
        for term in terms:
            if term not in self._columns:
                self._columns[term] = self._column(term)
        made = [self._columns[term] for term in terms]
        # The samples of a term lie side by side: fits run along them.
        return np.moveaxis(np.stack(made), 0, -1) if made else np.zeros((*self.missing.shape, 0))

    def _column(self, term: Term) -> FloatArray:
        column = np.zeros(self.missing.shape)
        for record, (at, sigma, places) in zip(self.records, self._samples, strict=True):
            column.ravel()[places] = record.force(term, at) / sigma
        return column

    @cached_property
    def _samples(self) -> list[tuple[IntArray, FloatArray, IntArray]]:
        """Of each record the samples of its parts, their standard deviations and their places in a column."""
        longest = self.missing.shape[1]
        found = []
        for number, record in enumerate(self.records):
            parts = [(row, part) for row, (k, part) in enumerate(self.part_of) if k == number]
            found.append(
                (
                    np.concatenate([record.parts[part] for _, part in parts]),
                    np.concatenate([record.sigma[part] for _, part in parts]),
                    np.concatenate([row * longest + np.arange(record.parts[part].size) for row, part in parts]),
                )
            )
        return found

    def _parts(self) -> list[tuple[MovedRecord, int]]:
        return [(self.records[k], part) for k, part in self.part_of]

    def _padded(self, rows: Sequence[FloatArray]) -> FloatArray:
        result = np.zeros((len(rows), max(row.size for row in rows)))
        for k, row in enumerate(rows):
            result[k, : row.size] = row
        return result

    def independent(self, left: FloatArray) -> float:
        """Independent rows over rows by what a law leaves, (P, M): neighbours that leave the same count once."""
        total = independent = 0.0
        for k, (record, part) in enumerate(self._parts()):
            size = record.parts[part].size
            row = left[k, :size] - left[k, :size].mean()
            total += size
            independent += size * _independent_share(row)
        return independent / total


def _independent_share(row: FloatArray) -> float:
    """Independent samples over samples (Bartlett, J. R. Stat. Soc. Suppl. 8 (1946) 27)."""
    power = np.abs(np.fft.rfft(row, 2 * row.size)) ** 2
    correlation = np.fft.irfft(power)[: row.size]
    if not correlation[0] > 0.0:
        return 1.0
    ends = np.flatnonzero(correlation < 0.0)
    summed = float(correlation[1 : int(ends[0]) if ends.size else None].sum()) / float(correlation[0])
    return 1.0 / (1.0 + 2.0 * summed)
