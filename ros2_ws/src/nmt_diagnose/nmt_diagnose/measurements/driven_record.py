"""Records of any excitation."""

from __future__ import annotations

import hashlib
import math
from collections import OrderedDict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import combinations, pairwise
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq
from scipy.signal import resample_poly, welch

from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import ComplexArray, FloatArray, IntArray
from nmt_core.tolerances import TOLERANCES
from nmt_core.vocabulary import TestKind
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.measurements.measurement import (
    LevelSeries,
    Observations,
    Record,
    RowTable,
    empty,
    joined,
    occupied_band,
)
from nmt_diagnose.observations.bag_windows import BagWindows
from nmt_diagnose.observations.channels.bag_samples import SampleStretch
from nmt_diagnose.observations.channels.measuring_chain import MeasuringChain
from nmt_diagnose.observations.model_view import ModelView
from nmt_diagnose.observations.noise.input_noise import (
    InputNoise,
    input_noise,
    noise_lines,
    propagated_noise,
)
from nmt_diagnose.observations.observables import Part, Place, Rows
from nmt_diagnose.prediction.converter import expected_quantised
from nmt_diagnose.prediction.initial_state import InitialState, at_rest, initial_state
from nmt_diagnose.prediction.linear_model import LinearModel
from nmt_diagnose.prediction.parts_cache import PartsCache, Setup
from nmt_diagnose.prediction.prediction_settings import PredictionSettings
from nmt_diagnose.prediction.predictor import Predictor
from nmt_diagnose.prediction.record_kernel import SteppedModel, step_through, stepped_model
from nmt_diagnose.prediction.resting_motion import (
    Motion,
    noise_motion,
    ratio_if_far_off,
)
from nmt_diagnose.prediction.rig_parts import RigParts, channel_sections
from nmt_diagnose.prediction.rig_tables import DELAY, GAIN
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_rig.model.fourier_basis import FourierBasis
from nmt_rig.model.linear_modes import damped_modes
from nmt_rig.rig import Rig
from nmt_signals.band_limited import finer
from nmt_signals.channel_faults.clipping import clipping_level


class DrivenRecord(Record):
    """Any excitation: the model is driven by the measured input."""

    WORDS: ClassVar[str] = "record, driven by the measured input"
    unexcited: ClassVar[tuple[Part, ...]] = (Part.LINE,)
    series: ClassVar[LevelSeries] = LevelSeries(interleaved=True)

    def predictor(self, rows: Rows, settings: PredictionSettings) -> RecordPredictor:
        """What predicts its rows."""
        return RecordPredictor(self, rows, settings)

    def motions(
        self, rig: Rig, channels: tuple[MeasuredChannel, ...], settings: PredictionSettings, frequency_hz: float
    ) -> list[Motion]:
        """The model under its input at the samples at which a point, or the way between two, is the largest.

        Where the model has no solution, the rms of the motion that flat noise as large as the input makes.
        """
        lines = 2.0 * np.pi * np.geomspace(1e-3, 0.4, 200) * self.sample_rate
        ideal = self.input_channel.quantity == Quantity.FORCE
        at_rest = noise_motion(rig, self.drive_point, channels, settings, lines, float(np.std(self.input)), ideal)
        test = replace(self, channels=channels, head=np.zeros((0, 0)), begins_in_motion=False)
        moved = RecordPredictor(test, empty(()).rows, settings).responses(rig, PartsCache(settings))
        size = np.abs(moved).max(axis=1)
        if not np.isfinite(size).all() or not size.any():
            return at_rest
        factor = self._over_model(dict(zip((channel.name for channel in channels), size, strict=True)))
        probes = [number for number, channel in enumerate(channels) if channel.name.startswith("probe ")]
        ways = list(combinations(probes, 2)) if len(probes) <= THRESHOLDS.prediction.most_joined_points else []
        apart = [moved[i] - moved[j] for i, j in ways or pairwise(probes)]
        (parts, omega, drive, amplitudes, unknowns) = at_rest[0]
        crest = float(size[probes].max() / np.abs(amplitudes[probes]).max())
        found: list[Motion] = []
        for sample in sorted({int(np.abs(way).argmax()) for way in (*moved[probes], *apart)}):
            values = size.astype(np.complex128)
            values[probes] = moved[probes, sample]
            found.append((parts, omega, drive, factor * values, factor * crest * unknowns))
        return found

    def _over_model(self, predicted: Mapping[str, float]) -> float:
        """Measured motion over that of the model, by the largest samples of its channels; 1 where they are alike."""
        if not self.responses.size:
            return 1.0
        measured = np.abs(self.responses - self.responses.mean(axis=1, keepdims=True)).max(axis=1)
        ratios = [
            size / predicted[channel.name]
            for channel, size in zip(self.channels, measured, strict=True)
            if predicted.get(channel.name, 0.0) > 0.0
        ]
        return ratio_if_far_off(ratios)


# -- predictor -------------------------------------------------------------------------------------------------------


STEPS_PER_PERIOD = 60.0
MOST_SUBSTEPS = 32
REMEMBERED = 3
_ERROR_STEP = 0.05  # of a standard deviation, for differences


class SamplePredictor(Predictor):
    """Predicts rows that are samples of the channels of a record."""

    test: Record
    _sample: IntArray

    def _of_rows(self, responses: FloatArray, otherwise: float = 0.0) -> FloatArray:
        """Values of channels (channels, samples) at the rows that are samples."""
        selected = self.rows.part == Part.SAMPLE
        return np.where(selected, responses[np.maximum(self.rows.channel, 0), self._sample], otherwise)

    def _sensor_errors(
        self, raw: FloatArray, parts: RigParts, rate: float, chain: MeasuringChain
    ) -> dict[str, FloatArray]:
        """What a standard deviation of zero, gain and delay of each sensor adds to the rows.

        A delay has the name that it has in other tests: it is one error of a channel.

        Args:
            raw: what the channels of the model record without their sensors, (channels, samples).
            parts: of the rig.
            rate: of the samples, Hz.
            chain: of the record.
        """
        found: dict[str, FloatArray] = {}
        values = self._of_rows(recorded(raw, parts, self._places, rate))
        channels = parts.channels.copy()
        channels[self._places, DELAY] += [chain.of(channel.name).delay_s for channel in self.channels]
        later = self._of_rows(recorded(raw, replace(parts, channels=channels), self._places, rate)) - values
        for number, channel in enumerate(self.channels):
            selected = (self.rows.part == Part.SAMPLE) & (self.rows.channel == number)
            found[f"zero of {channel.name} in {self.test.name}"] = float(self.test.zeros[1 + number]) * selected
            found[f"gain {channel.name}"] = chain.of(channel.name).gain * values * selected
            found[f"delay {channel.name}"] = later * selected
        return found


class _Stepping(NamedTuple):
    """Parts of a rig, sampling rate by its clock (Hz), steps per sample, and force over the input.

    A recorded force is what its sensor makes of the force, a recorded voltage what the exciter turns into one.
    """

    parts: RigParts
    rate: float
    substeps: int
    gain: float


class RecordPredictor(SamplePredictor):
    """Predicts the samples of one record.

    Args:
        test: the record.
        rows: its rows.
        settings: of the predictor.
    """

    def __init__(self, test: DrivenRecord, rows: Rows, settings: PredictionSettings) -> None:
        self.test, self.rows, self.settings = test, rows, settings
        self.ideal_force = test.input_channel.quantity == Quantity.FORCE
        self.channels = tuple(test.channels)
        self._known: OrderedDict[bytes, tuple[FloatArray, InitialState]] = OrderedDict()
        self.use(Setup(test.drive_points, self.ideal_force, self.channels, FourierBasis.up_to(1)))
        # Responses are wanted where they were recorded, however much finer the input is.
        own_rate, count = test.sample_rate / test.head_stride, -(-test.input.size // test.head_stride)
        self._sample = np.clip(np.round((rows.time_s - test.start_s) * own_rate).astype(np.int64), 0, count - 1)
        self._inputs: dict[int, FloatArray] = {}

    def use(self, setup: Setup) -> None:
        """Take the parts of rigs from a setup that other tests share."""
        super().use(setup)
        self._known.clear()

    def values(self, rig: Rig, cache: PartsCache, states: Sequence[Any] = ()) -> FloatArray:
        """Observables of the test's rows."""
        return self._of_rows(self.responses(rig, cache), np.nan)

    def responses(self, rig: Rig, cache: PartsCache) -> FloatArray:
        """Recorded responses (channels, samples)."""
        stepping = self._stepping(rig, cache)
        return self._recorded(self._raw(stepping)[0], stepping)

    def errors(self, rig: Rig, cache: PartsCache, chain: MeasuringChain | None) -> dict[str, FloatArray]:
        """What a standard deviation of each error of the record adds to its rows, (rows,) each.

        Errors are zero, gain and delay of each sensor, the noise of the input, which never drove the structure, and the
        state in which the record begins.

        Args:
            rig: about whose motion they act.
            cache: of the prediction.
            chain: of the record; None = that of the bench's simulator, whose sensors have no zeros and no gains.
        """
        stepping = self._stepping(rig, cache)
        raw, initial = self._raw(stepping, errors=True)
        base = self._recorded(raw, stepping)

        def change(moved: FloatArray) -> FloatArray:
            return self._of_rows((self._recorded(moved, stepping) - base) / _ERROR_STEP)

        found: dict[str, FloatArray] = {}
        if self.test.noise.any():
            added = -_ERROR_STEP * self._between(self.test.noise, stepping.substeps)
            moved = self._stepped(stepping, offset=added)[0]
            found[f"noise of {self.test.input_channel.name} in {self.test.name}"] = change(moved)
        if chain is not None and self.test.zeros.size:
            source = float(self.test.zeros[0])
            if source > 0.0:
                moved = self._stepped(stepping, offset=_ERROR_STEP * source)[0]
                found[f"zero of {self.test.input_channel.name} in {self.test.name}"] = change(moved)
            # What the sensor shows too large is smaller; the gain of a channel is one error of all tests.
            quieter = -_ERROR_STEP * chain.of(self.test.input_channel.name).gain
            if quieter < 0.0:
                moved = self._stepped(stepping, louder=quieter)[0]
                found[f"gain {self.test.input_channel.name}"] = change(moved)
            found |= self._sensor_errors(raw, stepping.parts, stepping.rate / self.test.head_stride, chain)
        for number, error in enumerate(initial.errors):
            moved = self._stepped(stepping, initial.state + _ERROR_STEP * error)[0]
            found[f"start {number} of {self.test.name}"] = change(moved)
        return found

    def _stepping(self, rig: Rig, cache: PartsCache) -> _Stepping:
        test = self.test
        parts = cache.parts(rig, self.setup, test.start_s + 0.5 * test.input.size / test.sample_rate)
        rate = test.sample_rate * parts.clock
        (sensor,) = channel_sections(rig, [test.input_channel])
        gain = float(parts.input_per_volt[0])
        if self.ideal_force:
            gain = 1.0 if sensor is None else 1.0 / sensor.gain
        return _Stepping(parts, rate, substeps_of(parts.linear, rate), gain)

    def _recorded(self, raw: FloatArray, stepping: _Stepping) -> FloatArray:
        """What the sensors make of the channels."""
        return recorded(raw, stepping.parts, self._places, stepping.rate / self.test.head_stride)

    def _driven_model(self, stepping: _Stepping) -> tuple[float, SteppedModel]:
        """Saturation of the drive, and the recursion of the poles over a step."""
        parts = stepping.parts
        saturation = math.inf if self.ideal_force else float(parts.saturation[0])
        rows = np.concatenate((np.arange(parts.coordinates), parts.coordinates + self._places))
        step = 1.0 / (stepping.rate * stepping.substeps)
        return saturation, stepped_model(parts.linear, parts.coordinates, rows, step)

    def _raw(self, stepping: _Stepping, errors: bool = False) -> tuple[FloatArray, InitialState]:
        """Motion and its begin as :meth:`_stepped`, remembered; rigs that differ in sensors only share it."""
        parts, (saturation, model) = stepping.parts, self._driven_model(stepping)
        errors = errors or self.test.begins_in_motion
        digest = hashlib.sha256(repr((stepping.substeps, saturation, stepping.gain, errors)).encode())
        # The state that a record begins in is read through the sensors.
        gains = parts.channels[self._places, GAIN] if self.test.head.size else np.zeros(0)
        for array in (*model, parts.force_factor, *parts.tables.elements, *parts.timed.tables(), gains):
            digest.update(repr(array.shape).encode() + np.ascontiguousarray(array).tobytes())
        key = digest.digest()
        if key not in self._known:
            self._known[key] = self._stepped(stepping, errors=errors)
            if len(self._known) > REMEMBERED:
                self._known.popitem(last=False)
        self._known.move_to_end(key)
        return self._known[key]

    def _stepped(
        self,
        stepping: _Stepping,
        state: ComplexArray | None = None,
        offset: float | FloatArray = 0.0,
        louder: float = 0.0,
        errors: bool = True,
    ) -> tuple[FloatArray, InitialState]:
        """What the channels would record without their sensors (channels, samples), and the state they begin in.

        Args:
            stepping: the rig and its steps.
            state: of the poles, to begin with, (k,); None = estimated from the first samples.
            offset: what is added to the input, in its unit; one value or (n substeps,).
            louder: share of the input that is added to it.
            errors: whether those of the begin are wanted where the model starts at rest.
        """
        parts, substeps, (saturation, model) = stepping.parts, stepping.substeps, self._driven_model(stepping)
        drive = (1.0 + louder) * self._interpolated(substeps) + offset
        if math.isfinite(saturation):
            drive = saturation * np.tanh(drive / saturation)
        drive = stepping.gain * drive
        timed = parts.timed.tables(self.test.signals, substeps)

        def simulated(samples: int, start: ComplexArray) -> FloatArray:
            part, every = drive[np.newaxis, : samples * substeps], substeps * self.test.head_stride
            return step_through(part, every, parts.coordinates, model, parts.force_factor, parts.tables, start, timed)

        if state is not None:
            return simulated(self.test.input.size, state), InitialState(state, at_rest(state.size).errors)
        head, stride = self.test.head, self.test.head_stride
        initial = at_rest(model.decay.size)
        if head.size and errors:
            gains = parts.channels[self._places, GAIN][:, None]
            samples = (head.shape[1] - 1) * stride + 1
            initial = initial_state(
                head,
                lambda start: gains * simulated(samples, start),
                model,
                parts.coordinates,
                gains,
                1 + stride * substeps * np.arange(head.shape[1]),
                self.test.begins_in_motion,
            )
        return simulated(self.test.input.size, initial.state), initial

    def _interpolated(self, substeps: int) -> FloatArray:
        if substeps not in self._inputs:
            self._inputs[substeps] = self._between(self.test.input, substeps)
        return self._inputs[substeps]

    @staticmethod
    def _between(samples: FloatArray, substeps: int) -> FloatArray:
        """Samples of the input with steps between them."""
        if substeps == 1:
            return np.ascontiguousarray(samples, dtype=np.float64)
        fine = resample_poly(samples, substeps, 1, window=("kaiser", 10.0), padtype="line")
        return np.ascontiguousarray(fine, dtype=np.float64)


def _through_sensors(values: FloatArray, rate: float, chains: FloatArray) -> FloatArray:
    """Recorded values of channels, (channels, samples): gain, delay and filters, in the frequency domain.

    A straight line from the last value back to the first makes them periodic, and of a length that transforms fast.
    """
    result = values * chains[:, GAIN, None]
    filtered = np.flatnonzero(np.any(chains[:, DELAY:] != 0.0, axis=1))
    if not filtered.size:
        return result
    filtered_values, count = result[filtered], values.shape[1]
    size = next_fast_len(count + 1, real=True)
    back = np.linspace(filtered_values[:, -1], filtered_values[:, 0], size - count + 2, axis=1)[:, 1:-1]
    lines = rfft(np.concatenate((filtered_values, back), axis=1), axis=1)
    for position, channel in enumerate(filtered):
        lines[position] *= _sensor_response(size, rate, *map(float, chains[channel, DELAY:]))
    result[filtered] = irfft(lines, size, axis=1)[:, :count]
    return result


@lru_cache(maxsize=16)
def _sensor_response(size: int, rate: float, delay: float, low_pass: float, high_pass: float) -> ComplexArray:
    """Frequency response of a delay (s) and of filters (time constant in s, angular frequency in rad/s)."""
    s = 2j * np.pi * rfftfreq(size, 1.0 / rate)
    response = np.exp(-s * delay) / (1.0 + s * low_pass)
    if high_pass > 0.0:
        response = response * s / (s + high_pass)
    return np.asarray(response)


def substeps_of(model: LinearModel, rate: float) -> int:
    """Steps per sample: from the fastest oscillation below half of a tenth of the sampling rate (Hz), if any."""
    poles = model.poles
    oscillating = np.abs(poles.imag[(np.abs(poles.real) < 0.5 * np.abs(poles)) & (poles.imag > 0.0)])
    resolved = oscillating[oscillating < 0.5 * np.pi * rate]
    fastest = float(resolved.min()) / (2.0 * np.pi) if resolved.size else 0.05 * rate
    return int(min(max(math.ceil(STEPS_PER_PERIOD * fastest / rate), 1), MOST_SUBSTEPS))


def recorded(raw: FloatArray, parts: RigParts, channels: IntArray, rate: float) -> FloatArray:
    """What the sensors make of channels of a model, (channels, samples).

    Args:
        raw: what the channels would record without their sensors, (channels, samples).
        parts: of the rig.
        channels: position of each among the channels of the parts, (channels,).
        rate: of the samples, Hz.
    """
    result = _through_sensors(raw, rate, parts.channels[channels])
    for position, index in enumerate(channels):
        level, step, noise = parts.limits[index]
        if math.isfinite(level):
            result[position] = np.clip(result[position], -level, level)
        if step > 0.0 and noise < 0.7 * step:
            result[position] = expected_quantised(result[position], step, noise)
    return result


# -- reading ---------------------------------------------------------------------------------------------------------


# Mirrored samples at either end of a resampled drive.
_PADDING_SAMPLES = 512
# Half width of filters between samples, of recorders too: nearer to an end they take in what was not recorded.
_END_SAMPLES = 10

_FOLLOWED = (Quantity.CURRENT, Quantity.VOLTAGE, Quantity.FORCE)
_GOLDEN = 0.5 * (math.sqrt(5.0) - 1.0)


def spread_samples(start: int, stop: int, count: int) -> NDArray[np.int64]:
    """Up to ``count`` different indices from start to stop − 1, ascending, in step with nothing."""
    length = stop - start
    if count >= length:
        return np.arange(start, stop, dtype=np.int64)
    stride = length / count
    within = np.modf(_GOLDEN * np.arange(count))[0]
    return np.unique(start + np.floor((np.arange(count) + within) * stride).astype(np.int64)).clip(start, stop - 1)


def independent_values(samples: FloatArray, sample_rate: float) -> int:
    """Independent values of a record: two for each period of the highest frequency that it has power at.

    Args:
        samples: of one channel, (n,), in any unit.
        sample_rate: Hz.
    """
    _, highest = occupied_band(samples, sample_rate)
    return max(THRESHOLDS.reading.record_fewest_rows, int(2.0 * highest * samples.size / sample_rate))


def white_noise(samples: FloatArray, sample_rate: float) -> float:
    """Standard deviation of white noise as strong as the lowest twentieth of the spectrum."""
    segment = min(samples.size, max(64, samples.size // 64))
    _, power = welch(samples - samples.mean(), sample_rate, nperseg=segment)
    return float(math.sqrt(np.quantile(power[1:-1], THRESHOLDS.reading.record_noise_quantile) * 0.5 * sample_rate))


def refinement(response: FloatArray, sample_rate: float) -> int:
    """Power of two by which the input must be finer for straight lines to do, where the response has its power."""
    _, highest = occupied_band(response, sample_rate)
    wanted = math.pi * highest / math.sqrt(3.0 * THRESHOLDS.reading.record_hold_error) / sample_rate
    factor: int = 2 ** max(0, math.ceil(math.log2(max(wanted, 1e-9))))
    return min(THRESHOLDS.reading.record_finest_steps, factor)


def records_of(bag: BagWindows) -> list[Observations]:
    """Windows of records."""
    stretches = [window.stretch for window in bag.of_kind(TestKind.RECORD)]
    return [record_observations(bag.named(TestKind.RECORD), stretches, bag)] if stretches else []


def record_observations(name: str, stretches: Sequence[SampleStretch], bag: BagWindows) -> Observations:
    """Observables of the records of one bag, one test each.

    Args:
        name: name of the tests; numbered where there are several.
        stretches: the records.
        bag: they are of.
    """
    parts = []
    for number, stretch in enumerate(stretches):
        test_name = f"{name} {number + 1}" if len(stretches) > 1 else name
        parts.append(_one(test_name, stretch, bag, bag.settings.record_rows // len(stretches)))
    return joined(parts)


def _one(name: str, stretch: SampleStretch, bag: BagWindows, budget: int) -> Observations:
    view, channels, settings = bag.view, bag.channels, bag.settings
    linear_hold = math.isfinite(bag.hold_rate_hz)  # the input goes straight from sample to sample
    lost = [(channel, fault) for channel, fault in stretch.faults.items() if channel in channels]
    notes = [f"{name}: channel {channel} is left out: {fault}." for channel, fault in lost]
    source = stretch.find(Quantity.VOLTAGE) or stretch.find(Quantity.FORCE)
    if source is None or source.name in stretch.faults:
        why = (
            "no voltage or force was recorded"
            if source is None
            else f"its input cannot be used ({stretch.faults[source.name]})"
        )
        return empty((f"{name}: the record is left out: {why}.",))
    recorded = {model_channel.name: theirs for theirs, model_channel in channels.items()}
    present = [
        channel
        for channel in channels.values()
        if recorded[channel.name] in {c.name for c in stretch.channels} - set(stretch.faults) - {source.name}
        and channel.quantity is not Quantity.VOLTAGE
    ]
    if not present or stretch.samples < THRESHOLDS.reading.record_fewest_samples:
        why = "it has no response" if not present else f"{stretch.samples} samples are too few"
        return empty((*notes, f"{name}: the record is left out: {why}."))
    responses = np.array([stretch.row(recorded[channel.name]) for channel in present])
    first = head_of(responses, stretch.sample_rate)
    in_motion = starts_in_motion(responses, first)
    slowest = _slowest(view)
    start = start_of(slowest, stretch) if in_motion else 0
    independent = max(independent_values(row[start:], stretch.sample_rate) for row in responses)
    indices = spread_samples(
        max(start, _END_SAMPLES), stretch.samples - _END_SAMPLES, min(independent, max(1, budget // len(present)))
    )
    count = max(1, min(settings.record_segments, indices.size // 20))
    bounds = np.linspace(start, stretch.samples, count + 1).round().astype(np.int64)
    level = np.searchsorted(bounds, indices, side="right") - 1
    source_samples = stretch.row(source.name)
    amplitude = [float(np.std(source_samples[low:high])) for low, high in pairwise(bounds)]
    model_channel = channels.get(source.name, source)
    noise = input_noise(source_samples, responses, stretch.sample_rate)
    propagated = _from_input(noise, stretch, model_channel, present, view)
    table = RowTable()
    for row, channel in enumerate(present):
        samples = stretch.row(recorded[channel.name])
        samples = samples - samples.mean()
        std = math.hypot(white_noise(samples, stretch.sample_rate), float(propagated[row]))
        floor = settings.floors.record * float(np.std(samples))
        for index, segment in zip(indices, level, strict=True):
            table.add(
                Part.SAMPLE, float(samples[index]), std, floor,
                Place(int(segment), (stretch.first_sample + int(index)) / stretch.sample_rate, 0.0, amplitude[segment]),
                row,
            )  # fmt: skip
    factor = 1 if linear_hold else refinement(stretch.row(recorded[present[0].name]), stretch.sample_rate)
    fine = np.arange(factor * stretch.samples) / (factor * stretch.sample_rate)
    head = responses[:, :first] - responses.mean(axis=1, keepdims=True)
    test = DrivenRecord(
        name=name,
        drive_point=view.rig.drive_point,
        sample_rate=factor * stretch.sample_rate,
        input_channel=model_channel,
        input=finer(source_samples, factor, _PADDING_SAMPLES),
        noise=finer(noise.known, factor, _PADDING_SAMPLES),
        channels=tuple(present),
        segment_bounds=factor * bounds.astype(np.float64),
        start_s=stretch.start_s,
        zeros=np.array([_zero(source_samples, model_channel), *map(_zero, responses, present)]),
        limits=np.array([clipping_level(row) for row in responses]),
        head=head,
        head_stride=factor,
        begins_in_motion=in_motion,
        followed=followed_channels(stretch, source, set(recorded.values()), fine),
        responses=responses,
    )
    return table.observations(test, notes)


def followed_channels(
    stretch: SampleStretch, source: MeasuredChannel, known: Collection[str], fine: FloatArray
) -> dict[str, FloatArray]:
    """Currents, voltages and forces that the model has not, at times from the first sample on, by quantity and name."""
    found = [
        channel
        for channel in stretch.channels
        if channel.quantity in _FOLLOWED
        and channel.name not in {*stretch.faults, source.name}
        and (channel.quantity is not Quantity.FORCE or channel.name not in known)
    ]
    quantities = [channel.quantity for channel in found]
    time = np.arange(stretch.samples) / stretch.sample_rate
    result = {}
    for channel in found:
        name = channel.quantity.name.lower()
        name += f" {channel.name}" if quantities.count(channel.quantity) > 1 else ""
        result[name] = np.interp(fine, time, stretch.row(channel.name))
    return result


def _zero(samples: FloatArray, channel: MeasuredChannel) -> float:
    """Standard deviation of the zero of a channel, in its unit.

    A voltage has the zero of its converter. The zero of a motion is not calibrated, and a force cell carries a weight:
    the mean of these channels counts as an error of their zero.
    """
    mean = 0.0 if channel.quantity is Quantity.VOLTAGE else float(samples.mean())
    return math.hypot(TOLERANCES.zero * float(np.abs(samples).max()), mean)


def _from_input(
    noise: InputNoise,
    stretch: SampleStretch,
    source_channel: MeasuredChannel,
    channels: Sequence[MeasuredChannel],
    view: ModelView,
) -> FloatArray:
    """Standard deviation of each response caused by the noise of the measured input that is not known, (channels,)."""
    lines = noise_lines(view.frequencies_hz, stretch.sample_rate, stretch.samples / stretch.sample_rate)
    if source_channel.quantity is not Quantity.FORCE:
        return propagated_noise(noise, view.responses(channels, lines), lines)
    force = MeasuredChannel("force", Quantity.FORCE, view.rig.drive_point)
    over_volt = view.responses([force, *channels], lines)
    with np.errstate(divide="ignore", invalid="ignore"):
        return propagated_noise(noise, over_volt[1:] / over_volt[0], lines)


def head_of(responses: FloatArray, sample_rate: float) -> int:
    """Samples from which the state is read that a record begins in: some periods of its strongest line."""
    samples = responses.shape[1]
    centred = responses[0] - responses[0].mean()
    frequency, power = welch(centred, sample_rate, nperseg=min(samples, 4096))
    strongest = float(frequency[1:][np.argmax(power[1:])])
    wanted = math.ceil(THRESHOLDS.reading.record_head_periods * sample_rate / strongest)
    return int(
        min(max(wanted, THRESHOLDS.reading.record_head_samples), THRESHOLDS.reading.record_longest_start * samples)
    )


def starts_in_motion(responses: FloatArray, head: int) -> bool:
    """Whether some channel moves from the first samples on."""
    first = responses[:, : max(3, head // THRESHOLDS.reading.record_head_samples)]
    centre = responses.mean(axis=1, keepdims=True)
    share = np.sqrt(np.mean((first - centre) ** 2, axis=1) / np.maximum(np.var(responses, axis=1), 1e-300))
    return bool(np.any(share > THRESHOLDS.reading.record_rest_share))


def _slowest(view: ModelView) -> float:
    """Smallest decay rate of the model's modes, 1/s."""
    modes = damped_modes(view.system)
    return float(np.min(-modes.eigenvalues.real)) if modes.eigenvalues.size else 0.0


def start_of(slowest: float, stretch: SampleStretch) -> int:
    """First sample that an unknown initial state does not reach, at most a tenth of the record."""
    longest = THRESHOLDS.reading.record_longest_start * stretch.samples
    return int(
        min(
            THRESHOLDS.reading.record_decay_constants / slowest * stretch.sample_rate if slowest > 0.0 else longest,
            longest,
        )
    )
