"""Driven records as samples of the responses that a missing force causes.

Where a measured force drives, the missing force is measured nowhere. With the motion of its place known, the response
of the channels to a law is that of the linear model to the law's force along that motion: linear in its strengths,
so that the law is the convex problem of an imposed motion with other columns. Errors of the model's parameters act
along the measured motion, too, and the state in which the record begins is free.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicHermiteSpline
from scipy.signal import welch

from nmt_core.numerics.arrays import ComplexArray, FloatArray, IntArray
from nmt_core.numerics.kernels import njit
from nmt_core.vocabulary import Quantity
from nmt_diagnose.effects.calibration import calibration_parameters
from nmt_diagnose.law.driven_plant import DrivenPlant, UnknownMotion, unknown_motion
from nmt_diagnose.law.law_search import moves_enough
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
from nmt_diagnose.measurements.channel import with_magnitudes
from nmt_diagnose.measurements.driven_record import spread_samples, substeps_of, white_noise
from nmt_diagnose.measurements.imposed_motion import POSITION
from nmt_diagnose.measurements.measurement import Observations, Record
from nmt_diagnose.observations.channels.measuring_chain import MeasuringChain
from nmt_diagnose.observations.observables import Part, Rows
from nmt_diagnose.prediction.parts_cache import PartsCache, Setup
from nmt_diagnose.prediction.prediction_settings import PredictionSettings
from nmt_diagnose.prediction.record_kernel import SteppedModel, StepWork, _coordinate_forces, _room
from nmt_diagnose.prediction.rig_parts import RigParts
from nmt_diagnose.prediction.timed_elements import TimedTables
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_rig.model.aft import ElementTables
from nmt_rig.model.fourier_basis import FourierBasis
from nmt_rig.rig import ChainSection, ForceSection, Rig
from nmt_rig.rig_model import inputs_per_volt
from nmt_signals.band_limited import finer

_STEPS = 20000  # of a record, at most: finer ones where it is short
_PADDING_SAMPLES = 512
_NOISE = 1e-4  # of a channel over its size, at least
_LEAST_START = 1e-3  # of a free motion over the largest of its channel, from which on it is seen
_CLIPPED = 0.98
_NO_ROW = 1e6  # standard deviation over the size of a channel that has no rows
_RUNS_AWAY = 5.0  # motion of a place over the largest at a sensor
_MOST_UNKNOWNS = 400  # of the model's motion: more cost gigabytes along a record


def places_of(rig: Rig, parts: RigParts) -> list[tuple[int, int]]:
    """Points and neighbours of a chain, and where the model has elements."""
    points = [(point, 0) for point in rig.structure.points]
    if isinstance(rig.structure, ChainSection):
        points += [(p + 1, p) for p in rig.structure.points[:-1]]
    taken = {(e.point, e.other_point or 0) for e in rig.local_elements if not e.rotation}
    points += [pair for pair in sorted(taken) if pair not in points and pair[::-1] not in points]
    return [pair for pair in points if {*pair} - {0} <= {*parts.system.point_numbers}]


def _newton_per_volt(rig: Rig, test: Record) -> float | None:
    """Force by the input of a record: 1 of a force, that of an exciter without dynamics of a voltage, else None."""
    if test.input_channel.quantity is Quantity.FORCE:
        return 1.0
    ideal = all(isinstance(exciter, ForceSection) for exciter in rig.all_exciters) and len(rig.all_exciters) == 1
    return float(inputs_per_volt(rig)[0]) if ideal else None


@dataclass(frozen=True)
class DrivenBasis:
    """What all places of a record share.

    Attributes:
        test: the record.
        number: of the test.
        rig: the model.
        chain: tolerances of its measuring chain.
        plant: the model about rest.
        force: measured force at the steps, N, (n,).
        under: displacements and velocities along the directions under it, (2, r + p, n).
        poles: of the plant under it, at the recorded samples, (samples, k).
        answered: channels under it at the recorded samples, (c, samples).
        measured: channels, (c, samples).
        noise: of each as the filter takes it, (c,).
        sigma: what a sample of each counts with, (c,).
        changed: parts of the model with each of its parameters off by a small step, by name.
        at: recorded samples that have rows, ascending.
    """

    test: Record
    number: int
    rig: Rig
    chain: MeasuringChain | None
    plant: DrivenPlant
    force: FloatArray
    under: FloatArray
    poles: ComplexArray
    answered: FloatArray
    measured: FloatArray
    noise: FloatArray
    sigma: FloatArray
    changed: dict[str, RigParts]
    at: IntArray

    @classmethod
    def of(cls, rig: Rig, observations: Observations, number: int, most: int) -> DrivenBasis | str:
        """The basis of one driven record with so many rows at most, or why there is none, a clause.

        Args:
            rig: the model.
            observations: the real side.
            number: of the test.
            most: rows.
        """
        test = observations.tests[number].record
        assert test is not None
        per_volt = _newton_per_volt(rig, test)
        if per_volt is None:
            return "the force that drives was not measured; record it, for a voltage drives the exciter, too"
        if not np.all(np.isfinite(test.responses)) or not np.all(np.std(test.responses, axis=1) > 0.0):
            return "a channel of the record stands still or lacks samples; leave it out"
        settings = PredictionSettings()
        cache = PartsCache(settings)
        setup = Setup(test.drive_points, True, test.channels, FourierBasis.up_to(1))
        seconds = test.start_s + 0.5 * test.input.size / test.sample_rate
        parts = cache.parts(rig, setup, seconds)
        system = parts.system
        if np.any(parts.channels[:, 1:] != 0.0):
            return "sensors of the model have filters or delays; correct the recording for them and leave them out"
        if system.first_order or system.size > _MOST_UNKNOWNS:
            lacking = "unknowns without inertia" if system.first_order else f"{system.size} unknowns"
            return f"the model has {lacking}; leave attachments out or take a coarser mesh"
        places = places_of(rig, parts)
        rate = test.sample_rate / test.head_stride
        samples = test.responses.shape[1]
        wanted = substeps_of(parts.linear, test.sample_rate)
        stride = test.head_stride * max(1, min(wanted, _STEPS // max(test.input.size, 1)))
        plant = DrivenPlant.of(parts, places, np.arange(len(test.channels)), rate, stride, settings)
        force = per_volt * finer(test.input, stride // test.head_stride, _PADDING_SAMPLES)[: (samples - 1) * stride + 1]
        drive = plant.coordinates
        x, v, poles = plant.motion_under(drive, force)
        answered = plant.answer(drive, force, stride * np.arange(samples))
        size = np.std(test.responses, axis=1)
        noise = np.array([white_noise(row, rate) for row in test.responses])
        rows = observations.rows
        here = (rows.test == number) & (rows.part == Part.SAMPLE)
        # A channel of which no sample counts says nothing of the law.
        counts = [here & (rows.channel == k) for k in range(len(size))]
        sigma = np.array(
            [np.median(observations.sigma[k]) if k.any() else _NO_ROW * s for k, s in zip(counts, size, strict=True)]
        )
        clipped = np.any(
            (test.limits[:, np.newaxis] > 0.0) & (np.abs(test.responses) >= _CLIPPED * test.limits[:, np.newaxis]),
            axis=0,
        )
        kept = np.flatnonzero(~clipped)
        at = kept[spread_samples(0, kept.size, max(1, most // len(size)))]
        changed = {}
        for parameter in calibration_parameters(rig):
            moved = PartsCache(settings).parts(parameter.apply(rig, STEP), setup, seconds)
            if moved.system.size == system.size and moved.coordinates == parts.coordinates:
                changed[parameter.name] = moved
        chain = observations.chains[number] if observations.chains else None
        return cls(
            test, number, rig, chain, plant, force, np.array([x, v]), poles, answered, test.responses,
            np.hypot(noise, _NOISE * size), sigma, changed, at,
        )  # fmt: skip

    @cached_property
    def slowest_hz(self) -> float:
        """Lowest frequency with power in the responses, Hz."""
        rate, lowest = self.plant.rate, []
        for row in self.measured:
            frequency, power = welch(row - row.mean(), rate, nperseg=min(row.size, 4096))
            share = np.cumsum(power) / max(float(power.sum()), 1e-300)
            lowest.append(float(frequency[max(1, int(np.searchsorted(share, 0.05)))]))
        return min(lowest)

    @cached_property
    def nonlinear(self) -> tuple[int, ...]:
        """Coordinates of the model that have a nonlinear force."""
        parts, found = self.plant.parts, []
        for k in range(parts.coordinates):
            starts = (parts.tables.elements.jenkins_start, parts.tables.elements.contacts_start,
                      parts.tables.elements.sampled_start)  # fmt: skip
            timed = k < len(parts.timed.groups) and len(parts.timed.groups[k]) > 0
            if timed or any(k + 1 < start.size and start[k + 1] > start[k] for start in starts):
                found.append(k)
        return tuple(found)


@dataclass(frozen=True)
class RespondingRecord:
    """One record with the motion of one place.

    Attributes:
        basis: what all places share.
        place: number of the place.
        x, v: motion of the place at the steps, m and m/s, (1, n).
        x_std: what noise of the channels leaves of the displacement open, m.
        acting: missing force that the responses tell at the recorded samples, N, (samples,), and its uncertainty.
        parts: steps at which each part has a row, channel after channel.
        streams: channel of each row.
        missing: measured channels less those of the model with its local forces along the motion.
        sigma: standard deviation of each row.
        errors: what a standard deviation of each error of chain and model adds.
        free: errors that are ordinarily of any size.
    """

    basis: DrivenBasis
    place: int
    x: FloatArray
    v: FloatArray
    x_std: float
    acting: tuple[FloatArray, float]
    parts: tuple[IntArray, ...]
    streams: tuple[IntArray, ...]
    missing: tuple[FloatArray, ...]
    sigma: tuple[FloatArray, ...]
    errors: dict[str, tuple[FloatArray, ...]]
    free: frozenset[str]
    _pieces: tuple[IntArray, ...] = field(repr=False, default=())

    @classmethod
    def of(cls, basis: DrivenBasis, place: int, parts: int, force: FloatArray | None = None) -> RespondingRecord:
        """The record with the motion of a place by its number.

        Args:
            basis: of the record.
            place: its number.
            parts: number of parts.
            force: of a law that was read there, at the steps, N, (n,): the unknown force adds to it; None = nothing.
        """
        plant = basis.plant
        row = plant.parts.coordinates + place
        shared, law = basis, np.zeros(basis.measured.shape[1])
        if force is not None:
            x, v, poles = plant.motion_under(row, -force)
            law = force[:: plant.stride][: law.size]
            basis = replace(
                basis, under=basis.under + np.array([x, v]), poles=basis.poles + poles,
                answered=basis.answered + plant.answer(row, -force, plant.stride * np.arange(law.size)),
            )  # fmt: skip
        inputs = (row, *(k for k in basis.nonlinear if not _parallel(plant.directions[:, k], plant.directions[:, row])))
        unknown = unknown_motion(
            plant, inputs, basis.measured - basis.answered, basis.noise, float(np.std(basis.force)), basis.slowest_hz
        )
        motion = _at_steps(basis, unknown)
        x, v = motion[0, row], motion[1, row]
        pieces = tuple(piece for piece in np.array_split(basis.at, parts) if piece.size)
        count = len(basis.measured)

        def split(values: FloatArray) -> tuple[FloatArray, ...]:
            """Channels (c, T) at the rows of each part, channel after channel."""
            ends = np.cumsum([piece.size for piece in pieces])[:-1]
            return tuple(part.ravel() for part in np.split(values, ends, axis=1))

        local = _local_forces(basis, plant.parts, motion)
        missing = basis.measured[:, basis.at] - shared.answered[:, basis.at]
        for k in basis.nonlinear:
            stiffness, damping = (values[k] for values in plant.parts.resting)
            beyond = local[k] - stiffness * motion[0, k] - damping * motion[1, k]
            missing = missing + plant.answer(k, beyond, plant.stride * basis.at)
        errors, free = _errors(basis, shared.answered, unknown, motion, local, (row, -law))
        return cls(
            shared, place, x[np.newaxis], v[np.newaxis], unknown.x_std, (law - unknown.force, unknown.force_std),
            tuple(np.tile(plant.stride * piece, count) for piece in pieces),
            tuple(np.repeat(np.arange(count), piece.size) for piece in pieces),
            split(missing), split(np.repeat(basis.sigma[:, np.newaxis], basis.at.size, axis=1)),
            {name: split(values) for name, values in errors.items()}, free, pieces,
        )  # fmt: skip

    @property
    def test(self) -> Record:
        """The record."""
        return self.basis.test

    @property
    def rate(self) -> float:
        """Steps a second, Hz."""
        return self.basis.plant.rate * self.basis.plant.stride

    @cached_property
    def channels(self) -> dict[str, FloatArray]:
        """Measured channels that a coefficient may follow; the displacement of the place is one."""
        times = np.arange(self.x.shape[1]) / self.rate
        known = np.arange(self.test.input.size) / self.test.sample_rate
        signals = {name: np.interp(times, known, values)[np.newaxis] for name, values in self.test.signals.items()}
        return with_magnitudes({POSITION: self.x, **signals})

    def force(self, term: Term) -> FloatArray:
        """Force of a term of unit strength at all steps, N, (n,); its memory begins as that of the file does."""
        force: FloatArray = term.force(self.x, self.v, closed=False)[0]
        return force * (self.channels[term.by][0] - term.about) if term.by else force

    def column(self, term: Term) -> FloatArray:
        """What a term of unit strength makes of the channels at the rows, part after part."""
        plant = self.basis.plant
        number = plant.parts.coordinates + self.place
        return -plant.answer(number, self.force(term), plant.stride * self.basis.at).ravel()[self._order]

    @cached_property
    def _order(self) -> IntArray:
        """Places of the rows, part after part, among channels (c, T)."""
        numbers = np.arange(len(self.basis.measured) * self.basis.at.size).reshape(len(self.basis.measured), -1)
        ends = np.cumsum([piece.size for piece in self._pieces])[:-1]
        return np.concatenate([part.ravel() for part in np.split(numbers, ends, axis=1)])

    def left_by(self, rig: Rig) -> list[FloatArray]:
        """What another rig leaves of the channels of each part, by the prediction that a diagnosis makes with it."""
        test, settings, at = self.test, PredictionSettings(), self.basis.at
        times = test.start_s + at / self.basis.plant.rate
        each = [rows_at(self.basis.number, channel, times) for channel in range(len(test.channels))]
        rows = Rows(*(np.concatenate([getattr(one, name) for one in each]) for name in Rows.__dataclass_fields__))
        values = test.predictor(rows, settings).values(rig, PartsCache(settings), ())
        left = self.basis.measured[:, at] - values.reshape(len(test.channels), -1)
        ends = np.cumsum([piece.size for piece in self._pieces])[:-1]
        return [part.ravel() for part in np.split(left, ends, axis=1)]

    def force_at(self, part: int, corrected: FloatArray) -> tuple[IntArray, FloatArray, float]:
        """Steps of a part, the missing force that the responses tell there, and its standard uncertainty, N."""
        piece = self._pieces[part]
        return self.basis.plant.stride * piece, self.acting[0][piece], self.acting[1]


def _parallel(one: FloatArray, other: FloatArray) -> bool:
    return abs(float(one @ other)) > (1.0 - 1e-9) * float(np.linalg.norm(one) * np.linalg.norm(other))


def _at_steps(basis: DrivenBasis, unknown: UnknownMotion) -> FloatArray:
    """Displacements and velocities along the directions at all steps, (2, r + p, n)."""
    stride, samples = basis.plant.stride, unknown.x.shape[1]
    result: FloatArray = basis.under.copy()
    if stride == 1:
        return np.asarray(result + np.array([unknown.x, unknown.v]))
    times = np.arange(samples, dtype=np.float64)
    fine = np.arange(result.shape[2]) / stride
    spline = CubicHermiteSpline(times, unknown.x, unknown.v / basis.plant.rate, axis=1)
    result[0] += spline(fine)
    result[1] += basis.plant.rate * spline(fine, 1)
    return result


def _local_forces(basis: DrivenBasis, parts: RigParts, motion: FloatArray) -> FloatArray:
    """Forces of the model's own elements that are not linear along the motion, N, (r, n)."""
    r, n = parts.coordinates, motion.shape[2]
    if not basis.nonlinear:
        return np.zeros((r, n))
    finer_signals = {
        name: np.interp(np.arange(n) / (basis.plant.rate * basis.plant.stride),
                        np.arange(values.size) / basis.test.sample_rate, values)
        for name, values in basis.test.signals.items()
    }  # fmt: skip
    timed = parts.timed.tables(finer_signals, 1)
    none = np.zeros((0, r), np.complex128)
    still = SteppedModel(np.zeros(0, np.complex128), none, none, none.T.copy(), none.T.copy(), np.zeros((r, r)))
    return np.asarray(
        _forces_along(
            np.ascontiguousarray(motion[0, :r]), np.ascontiguousarray(motion[1, :r]), still, parts.force_factor,
            parts.tables.elements, timed,
        )
    )  # fmt: skip


@njit(cache=True)
def _forces_along(
    x: FloatArray, v: FloatArray, still: SteppedModel, factor: FloatArray, elements: ElementTables, timed: TimedTables
) -> FloatArray:
    """Forces (r, n) of local elements along a known motion (r, n)."""
    r = x.shape[0]
    steps: StepWork = _room(still, r, elements.jenkins.shape[0], timed.kinds.size)
    result = np.zeros(x.shape)
    for n in range(x.shape[1]):
        for i in range(r):
            steps.w[i] = x[i, n]
            steps.v[i] = v[i, n]
        _coordinate_forces(steps, factor, elements, timed, n)
        steps.sliders[:] = steps.moved
        steps.memory[:] = steps.remembered
        for i in range(r):
            result[i, n] = steps.g[i]
    return result


def _errors(
    basis: DrivenBasis,
    answered: FloatArray,
    unknown: UnknownMotion,
    motion: FloatArray,
    local: FloatArray,
    law: tuple[int, FloatArray],
) -> tuple[dict[str, FloatArray], frozenset[str]]:
    """What a standard deviation of each error adds to the channels at the rows, (c, T), and those that are free."""
    test, at, chain = basis.test, basis.at, basis.chain
    found: dict[str, FloatArray] = {}
    free = set()
    count = len(test.channels)

    def alone(number: int, values: FloatArray) -> FloatArray:
        result: FloatArray = np.zeros((count, at.size))
        result[number] = values[at]
        return result

    for number, channel in enumerate(test.channels):
        row = basis.measured[number]
        name = f"zero of {channel.name} in {test.name}"
        found[name] = alone(number, np.full(row.size, max(float(test.zeros[1 + number]), float(np.std(row)))))
        free.add(name)
        if chain is not None:
            found[f"gain of {channel.name} in {test.name}"] = alone(number, chain.of(channel.name).gain * row)
        found[f"{DELAY} {channel.name} in {test.name}"] = alone(number, HALF_A_SAMPLE * np.gradient(row))
    if chain is not None:
        measured = test.input_channel.quantity is Quantity.FORCE
        gain = chain.of(test.input_channel.name).gain if measured else chain.voltage_gain
        found[f"gain of {test.input_channel.name} in {test.name}"] = gain * answered[:, at]
    for number, values in enumerate(_free_motions(basis)):
        name = f"start {number} of {test.name}"
        found[name] = values
        free.add(name)
    for name, values in _of_parameters(basis, unknown, motion, local, law).items():
        if np.any(values):
            found[name] = values
    return found, frozenset(free)


def _free_motions(basis: DrivenBasis) -> list[FloatArray]:
    """Motions of single poles from the beginning on, as large as the channels, at the rows, (c, T) each."""
    plant, at = basis.plant, basis.at
    model, result = plant.coarse, []
    rows = slice(plant.coordinates, plant.coordinates + plant.channels)
    size = np.std(basis.measured, axis=1)
    for k in range(model.decay.size):
        turning = model.outputs[rows, k, np.newaxis] * model.decay[k] ** at
        scale = float(np.max(np.abs(model.outputs[rows, k]) / size))
        if not scale > 0.0 or np.abs(model.decay[k] ** at[0]) < _LEAST_START:
            continue
        for share in (1.0, 1j) if model.decay[k].imag != 0.0 else (1.0,):
            values = (turning * share).real / scale
            # A motion that has decayed by the second row gives no column.
            if np.count_nonzero(np.max(np.abs(values) / size[:, np.newaxis], axis=0) > _LEAST_START) > 3:
                result.append(values)
    return result


def _of_parameters(
    basis: DrivenBasis, unknown: UnknownMotion, motion: FloatArray, local: FloatArray, law: tuple[int, FloatArray]
) -> dict[str, FloatArray]:
    """What the model's parameters add, each off by a standard deviation, along the measured motion, (c, T) each."""
    plant, model = basis.plant, basis.plant.coarse
    parts, samples = plant.parts, basis.measured.shape[1]
    first, r = plant.coordinates + plant.channels, plant.parts.coordinates
    force = basis.force[:: plant.stride][:samples]
    every = (basis.poles + unknown.poles) @ model.outputs[first:].T
    moved = every.real + np.outer(force, model.direct[first:, -1])
    moved += unknown.forces @ model.direct[first:, list(unknown.inputs)].T
    moved += np.outer(law[1], model.direct[first:, law[0]])
    q, rate, acceleration = np.split(moved, 3, axis=1)
    stiffness, damping = parts.resting
    linear_k, linear_c = (
        values - (parts.inputs[:, :r] * part) @ parts.inputs[:, :r].T
        for values, part in ((parts.system.stiffness, stiffness), (parts.system.damping, damping))
    )
    result = {}
    for name, other in basis.changed.items():
        change = other.system
        acting = -(
            acceleration @ (change.mass - parts.system.mass).T
            + rate @ (change.damping - linear_c).T
            + q @ (change.stiffness - linear_k).T
        )
        acting += np.outer(force, other.inputs[:, r] - parts.inputs[:, r])
        if basis.nonlinear and other.tables is not parts.tables:
            more = _local_forces(basis, other, motion) - local
            acting -= more[:, :: plant.stride][:, :samples].T @ parts.inputs[:, :r].T
        values = plant.answer_of_all(acting / STEP, basis.at)
        rows = slice(r, r + plant.channels)
        for before, after, along in (
            (parts.rows.displacement, other.rows.displacement, q),
            (parts.rows.velocity, other.rows.velocity, rate),
            (parts.rows.acceleration, other.rows.acceleration, acceleration),
        ):
            values = values + (after[rows] - before[rows]) @ along[basis.at].T / STEP
        result[name] = values
    return result


@dataclass(frozen=True)
class RespondingRecords(SampledRecords[RespondingRecord]):
    """Driven records of one rig whose missing force is one law at one place."""

    @classmethod
    def at_places(cls, rig: Rig, observations: Observations) -> list[RespondingRecords] | str:
        """The driven records among some tests, once for each place, or why none is read; nothing without a record."""
        counted = set(observations.rows.test[observations.rows.part == Part.SAMPLE].tolist())
        numbers = [
            k
            for k, test in enumerate(observations.tests)
            if test.record is not None and test.record.responses.size and k in counted
        ]
        if not numbers:
            return []
        parts, most = max(1, round(PARTS / len(numbers))), ROWS // len(numbers)
        made = [DrivenBasis.of(rig, observations, k, most) for k in numbers]
        bases = [basis for basis in made if isinstance(basis, DrivenBasis)]
        if not bases:
            return next(why for why in made if isinstance(why, str))
        found = []
        for place in range(len(bases[0].plant.places)):
            records = tuple(RespondingRecord.of(basis, place, parts) for basis in bases)
            pairs = parts_by_motion(records)
            if pairs:
                found.append(cls(records, pairs))
        return found

    @property
    def place(self) -> tuple[int, int]:
        """Point of the law and the other one; 0 = the ground."""
        record = self.records[0]
        return record.basis.plant.places[record.place]

    def with_forces(self, forces: Sequence[FloatArray]) -> RespondingRecords:
        """The records with the motion of the place under the forces of a law that was read there, N, one a record."""
        found = [
            RespondingRecord.of(record.basis, record.place, len(record.parts), force)
            for record, force in zip(self.records, forces, strict=True)
        ]
        return RespondingRecords(tuple(found), parts_by_motion(found))

    @property
    def bound(self) -> bool:
        """The motion of the place has errors, too, which a law that is added to another takes for its own."""
        return True


def moving(every: Sequence[RespondingRecords]) -> list[RespondingRecords]:
    """The places whose motion the channels determine and is large enough for a force there to show."""
    sizes = [float(np.sqrt(np.mean([np.var(record.x) for record in one.records]))) for one in every]
    open_by = [max(record.x_std for record in one.records) for one in every]
    sensors = {channel.point for one in every[:1] for channel in one.records[0].test.channels}
    largest = max((s for one, s in zip(every, sizes, strict=True) if one.place[0] in sensors and not one.place[1]),
                  default=np.inf)  # fmt: skip
    # An unknown force between points that no channel separates moves them as far as it likes.
    known = [
        (one, size)
        for one, size, std in zip(every, sizes, open_by, strict=True)
        if std <= THRESHOLDS.law.open_motion_share * size and size <= _RUNS_AWAY * largest
    ]
    if not known:
        return []
    large = moves_enough(np.array([size for _, size in known]))
    return [one for (one, _), moves in zip(known, large, strict=True) if moves]
