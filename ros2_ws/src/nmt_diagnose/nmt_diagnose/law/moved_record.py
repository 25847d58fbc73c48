"""Records of imposed motion as samples of the force that the model lacks.

The model is moved as measured. The residual of the measured force is the missing force itself, at the point that is
moved. Parts of the records stand for levels, each of which is predicted by a fit to the others. Ordinary errors of
chain and model are columns under their priors: gains and zeros of motion and force, and every parameter of the model.
A constant force is not a law: it is a preload or the zero of the cell, and free.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from nmt_core.numerics.arrays import FloatArray, IntArray
from nmt_core.vocabulary import Quantity
from nmt_diagnose.effects.calibration import calibration_parameters
from nmt_diagnose.law.sampled_records import (
    DELAY,
    HALF_A_SAMPLE,
    PARTS,
    ROWS,
    STEP,
    SampledRecords,
    parts_by_motion,
    rows_at,
)
from nmt_diagnose.law.terms import Term
from nmt_diagnose.measurements.driven_record import spread_samples
from nmt_diagnose.measurements.measurement import Observations, Record
from nmt_diagnose.observations.observables import Part, Rows
from nmt_diagnose.prediction.parts_cache import PartsCache
from nmt_diagnose.prediction.prediction_settings import PredictionSettings
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_rig.rig import Rig


@dataclass(frozen=True)
class MovedRecord:
    """One record.

    Attributes:
        test: of the record.
        x, v: its motion, m and m/s, (1, n).
        parts: samples of the motion at which each part has a row, ascending.
        rows: of all parts.
        force_samples: samples of the force of each part.
        measured: force at these, N.
        missing: measured force less that of the model at these, N.
        sigma: standard deviation of each, N.
        errors: what a standard deviation of each error of chain and model adds, N.
        channels: measured channels that a coefficient may follow, (1, n); the displacement is one.
    """

    test: Record
    x: FloatArray
    v: FloatArray
    parts: tuple[IntArray, ...]
    rows: Rows
    force_samples: tuple[IntArray, ...]
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
        test, rows = observations.tests[number].record, observations.rows
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
        dense = rows_at(number, force[0], time_s)
        settings = PredictionSettings()
        predictor, cache = test.predictor(dense, settings), PartsCache(settings)
        base = predictor.values(rig, cache, ())
        known = np.argsort(rows.time_s[selected])
        sigma = np.interp(time_s, rows.time_s[selected][known], observations.sigma[selected][known])
        chain = observations.chains[number] if observations.chains else None
        errors = dict(test.errors(dense, rig, cache, settings, chain)[0])
        errors[constant_of(test)] = np.full(samples.size, test.force_n)
        # Channels are sampled in step or half a sample apart.
        slope = np.gradient(np.interp(np.arange(test.force.size), samples, test.force[samples]))
        errors[f"{DELAY} the force in {test.name}"] = HALF_A_SAMPLE * slope[samples]
        for parameter in calibration_parameters(rig):
            change = (predictor.values(parameter.apply(rig, STEP), PartsCache(settings), ()) - base) / STEP
            if np.any(change):
                errors[parameter.name] = change
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
        force, at = self.test.force, self.force_samples[part]
        known = np.flatnonzero(np.isfinite(force))
        there: FloatArray = np.interp(at + late, known, force[known])
        return self.missing[part] + there - force[at]

    @property
    def rate(self) -> float:
        """Samples of the motion a second, Hz."""
        return self.test.sample_rate

    @property
    def streams(self) -> tuple[IntArray, ...]:
        """All rows are of the force."""
        return tuple(np.zeros(part.size, np.int64) for part in self.parts)

    @property
    def free(self) -> frozenset[str]:
        """A force that does not change."""
        return frozenset({constant_of(self.test)})

    def force(self, term: Term, at: IntArray | slice = slice(None)) -> FloatArray:
        """Force of a term of unit strength at samples, N, (n,); its memory begins as that of the file does."""
        force: FloatArray
        if term.remembers:
            force = term.force(self.x, self.v, closed=False)[0, at]
        else:
            force = term.force(self.x[:, at], self.v[:, at])[0]
        return force * (self.channels[term.by][0, at] - term.about) if term.by else force

    @cached_property
    def _rows_of_parts(self) -> IntArray:
        return np.concatenate(self.parts)

    def column(self, term: Term) -> FloatArray:
        """Force of a term of unit strength at the rows, part after part, N."""
        return self.force(term, self._rows_of_parts)

    def force_at(self, part: int, corrected: FloatArray) -> tuple[IntArray, FloatArray, float]:
        """Samples of a part, the missing force there and its standard uncertainty, N; see ``SampledRecord``."""
        sigma = self.sigma[part]
        return self.parts[part], corrected[: sigma.size] * sigma, float(sigma.mean())


def constant_of(test: Record) -> str:
    """Name of the force of a record that does not change."""
    force = next(channel for channel in test.channels if channel.quantity is Quantity.FORCE)
    return f"zero of {force.name} in {test.name}"


@dataclass(frozen=True)
class MovedRecords(SampledRecords[MovedRecord]):
    """Records of imposed motion whose missing force is one law; their parts ascend in motion."""

    @classmethod
    def of(cls, rig: Rig, observations: Observations, late: int = 0) -> MovedRecords | None:
        """The records of imposed motion among some tests, the force so many samples late; None without one."""
        numbers = [
            k for k, test in enumerate(observations.tests) if test.record is not None and test.record.motion.size
        ]
        if not numbers:
            return None
        parts, most = max(1, round(PARTS / len(numbers))), ROWS // len(numbers)
        records = [MovedRecord.of(rig, observations, k, parts, most, late) for k in numbers]
        found = tuple(record for record in records if record is not None)
        pairs = parts_by_motion(found)
        return cls(found, pairs, late) if pairs else None

    @property
    def place(self) -> tuple[int, int]:
        """The point that is moved, against the ground."""
        return self.records[0].test.drive_point, 0

    def moved(self, late: int) -> FloatArray:
        """:attr:`missing` where the measured force is taken so many samples later."""
        return self._padded([record.moved(part, late) / record.sigma[part] for record, part in self._parts()])

    @property
    def lateness(self) -> tuple[str, float] | None:
        """Channel of the force and duration of a sample of it, s; None where it is in step."""
        return (self.force_channel, 1.0 / self.force_rate) if self.late else None

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
