"""Records: the model driven by the measured input, stepped pole by pole with its local forces in between.

Between two steps the local forces run linearly (first-order hold) while the linear part is exact; the steps are a
sixtieth of the fastest period that matters: (π/60)²/3 of the local forces, 0.1 %, is lost. The measured input is
interpolated as the band-limited signal it is. The state in which the record begins is read off its first samples.
"""

from __future__ import annotations

import hashlib
import math
from collections import OrderedDict
from collections.abc import Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq
from scipy.signal import resample_poly

from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import ComplexArray, FloatArray, IntArray
from nmt_diagnose.observations.channels.measuring_chain import MeasuringChain
from nmt_diagnose.observations.observables import Part, Rows
from nmt_diagnose.prediction.converter import expected_quantised
from nmt_diagnose.prediction.initial_state import InitialState, at_rest, initial_state
from nmt_diagnose.prediction.linear_model import LinearModel
from nmt_diagnose.prediction.parts_cache import PartsCache, Setup
from nmt_diagnose.prediction.prediction_settings import PredictionSettings
from nmt_diagnose.prediction.predictor import Predictor
from nmt_diagnose.prediction.record_kernel import SteppedModel, step_through
from nmt_diagnose.prediction.rig_parts import RigParts
from nmt_diagnose.prediction.rig_tables import DELAY, GAIN
from nmt_rig.model.fourier_basis import FourierBasis
from nmt_rig.rig import Rig

if TYPE_CHECKING:
    from nmt_diagnose.measurements.driven_record.driven_record import DrivenRecord

STEPS_PER_PERIOD = 60.0
MOST_SUBSTEPS = 32
REMEMBERED = 3
_ERROR_STEP = 0.05  # of a standard deviation, for differences


class RecordPredictor(Predictor):
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
        self.setup = setup
        self._own = np.array(setup.index(self.channels), dtype=np.int64)
        self._known.clear()

    def values(self, rig: Rig, cache: PartsCache, states: Sequence[Any] = ()) -> FloatArray:
        """Observables of the test's rows."""
        responses = self.responses(rig, cache)
        result = np.full(len(self.rows), np.nan)
        which = self.rows.part == Part.SAMPLE
        result[which] = responses[np.maximum(self.rows.channel[which], 0), self._sample[which]]
        return result

    def responses(self, rig: Rig, cache: PartsCache) -> FloatArray:
        """Recorded responses (channels, samples)."""
        parts, rate, substeps = self._stepping(rig, cache)
        return self._recorded(self._raw(parts, rate, substeps)[0], parts, rate)

    def errors(self, rig: Rig, cache: PartsCache, chain: MeasuringChain | None) -> dict[str, FloatArray]:
        """What a standard deviation of each error of the record adds to its rows, (rows,) each.

        Errors are the zero and the gain of each sensor and the state in which the record begins.

        Args:
            rig: about whose motion they act.
            cache: of the prediction.
            chain: of the record; None = that of the bench's simulator, whose sensors have no zeros and no gains.
        """
        parts, rate, substeps = self._stepping(rig, cache)
        raw, initial = self._raw(parts, rate, substeps, errors=True)
        base = self._recorded(raw, parts, rate)

        def change(moved: FloatArray) -> FloatArray:
            return self._of_rows((self._recorded(moved, parts, rate) - base) / _ERROR_STEP)

        found: dict[str, FloatArray] = {}
        if chain is not None and self.test.zeros.size:
            source, *responses = (float(zero) for zero in self.test.zeros)
            if source > 0.0:
                moved = self._stepped(parts, rate, substeps, offset=_ERROR_STEP * source)[0]
                found[f"zero of {self.test.input_channel.name} in {self.test.name}"] = change(moved)
            louder = _ERROR_STEP * chain.of(self.test.input_channel.name).gain
            if louder > 0.0:
                moved = self._stepped(parts, rate, substeps, louder=louder)[0]
                found[f"gain of {self.test.input_channel.name} in {self.test.name}"] = change(moved)
            for number, (channel, zero) in enumerate(zip(self.channels, responses, strict=True)):
                selected = (self.rows.part == Part.SAMPLE) & (self.rows.channel == number)
                found[f"zero of {channel.name} in {self.test.name}"] = zero * selected
                gain = chain.of(channel.name).gain * self._of_rows(base) * selected
                found[f"gain of {channel.name} in {self.test.name}"] = gain
        for number, error in enumerate(initial.errors):
            moved = self._stepped(parts, rate, substeps, initial.state + _ERROR_STEP * error)[0]
            found[f"start {number} of {self.test.name}"] = change(moved)
        return found

    def _stepping(self, rig: Rig, cache: PartsCache) -> tuple[RigParts, float, int]:
        """Parts of the rig, sampling rate by its clock (Hz) and steps per sample."""
        test = self.test
        parts = cache.parts(rig, self.setup, test.start_s + 0.5 * test.input.size / test.sample_rate)
        rate = test.sample_rate * parts.clock
        return parts, rate, substeps_of(parts.linear, rate)

    def _recorded(self, raw: FloatArray, parts: RigParts, rate: float) -> FloatArray:
        """What the sensors make of the channels, by the rate of the input, Hz."""
        return recorded(raw, parts, self._own, rate / self.test.head_stride)

    def _of_rows(self, responses: FloatArray) -> FloatArray:
        selected = self.rows.part == Part.SAMPLE
        return np.where(selected, responses[np.maximum(self.rows.channel, 0), self._sample], 0.0)

    def _driven_model(self, parts: RigParts, rate: float, substeps: int) -> tuple[float, float, SteppedModel]:
        """Saturation and gain of the drive, and the recursion of the poles over a step."""
        saturation = math.inf if self.ideal_force else float(parts.saturation[0])
        gain = 1.0 if self.ideal_force else float(parts.input_per_volt[0])
        rows = np.concatenate((np.arange(parts.coordinates), parts.coordinates + self._own))
        return saturation, gain, stepped_model(parts.linear, parts.coordinates, rows, 1.0 / (rate * substeps))

    def _raw(
        self, parts: RigParts, rate: float, substeps: int, errors: bool = False
    ) -> tuple[FloatArray, InitialState]:
        """Motion and its begin as :meth:`_stepped`, remembered; rigs that differ in sensors only share it."""
        saturation, gain, model = self._driven_model(parts, rate, substeps)
        errors = errors or self.test.begins_in_motion
        digest = hashlib.sha256(repr((substeps, saturation, gain, errors)).encode())
        # The state that a record begins in is read through the sensors.
        gains = parts.channels[self._own, GAIN] if self.test.head.size else np.zeros(0)
        for array in (*model, parts.force_factor, *parts.tables.elements, *parts.timed.tables(), gains):
            digest.update(repr(array.shape).encode() + np.ascontiguousarray(array).tobytes())
        key = digest.digest()
        if key not in self._known:
            self._known[key] = self._stepped(parts, rate, substeps, errors=errors)
            if len(self._known) > REMEMBERED:
                self._known.popitem(last=False)
        self._known.move_to_end(key)
        return self._known[key]

    def _stepped(
        self,
        parts: RigParts,
        rate: float,
        substeps: int,
        state: ComplexArray | None = None,
        offset: float = 0.0,
        louder: float = 0.0,
        errors: bool = True,
    ) -> tuple[FloatArray, InitialState]:
        """What the channels would record without their sensors (channels, samples), and the state they begin in.

        Args:
            parts: of the rig.
            rate: of the input, Hz.
            substeps: steps per sample of it.
            state: of the poles, to begin with, (k,); None = as the first samples tell.
            offset: what is added to the input, in its unit.
            louder: share of the input that is added to it.
            errors: whether those of the begin are wanted where the model starts at rest.
        """
        saturation, gain, model = self._driven_model(parts, rate, substeps)
        drive = (1.0 + louder) * self._interpolated(substeps) + offset
        if math.isfinite(saturation):
            drive = saturation * np.tanh(drive / saturation)
        drive = gain * drive
        timed = parts.timed.tables(self.test.signals, substeps)

        def simulated(samples: int, start: ComplexArray) -> FloatArray:
            part, every = drive[: samples * substeps], substeps * self.test.head_stride
            return step_through(part, every, parts.coordinates, model, parts.force_factor, parts.tables, start, timed)

        if state is not None:
            return simulated(self.test.input.size, state), InitialState(state, at_rest(state.size).errors)
        head, stride = self.test.head, self.test.head_stride
        initial = at_rest(model.decay.size)
        if head.size and errors:
            gains = parts.channels[self._own, GAIN][:, None]
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
            samples = np.asarray(self.test.input, dtype=np.float64)
            found = (
                samples
                if substeps == 1
                else np.asarray(resample_poly(samples, substeps, 1, window=("kaiser", 10.0), padtype="line"))
            )
            self._inputs[substeps] = np.ascontiguousarray(found)
        return self._inputs[substeps]


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


def stepped_model(model: LinearModel, coordinates: int, rows: np.ndarray, step: float) -> SteppedModel:
    """Recursion of the poles over one step.

    Args:
        model: its first inputs are the forces of the coordinates, its first outputs their displacements.
        coordinates: number of them.
        rows: outputs that are wanted.
        step: s.
    """
    keep = model.poles.imag >= 0.0
    poles = model.poles[keep]
    weight = np.where(np.abs(poles.imag) > 1e-12 * np.abs(poles), 2.0, 1.0)
    z = poles * step
    decay = np.exp(z)
    small = np.abs(z) < 1e-4
    safe = np.where(small, 1.0, z)
    first = np.where(small, 1.0 + z / 2.0 + z**2 / 6.0, (decay - 1.0) / safe)
    second = np.where(small, 0.5 + z / 6.0 + z**2 / 24.0, (decay - 1.0 - z) / safe**2)
    inputs = model.inputs[keep]
    p = model.poles
    outputs = model.displacement[rows] + model.velocity[rows] * p + model.acceleration[rows] * p**2
    direct = (model.velocity[rows] + model.acceleration[rows] * model.poles) @ model.inputs + model.feedthrough[rows]
    return SteppedModel(
        decay,
        np.ascontiguousarray(step * (first - second)[:, None] * inputs),
        np.ascontiguousarray(step * second[:, None] * inputs),
        np.ascontiguousarray(outputs[:, keep] * weight),
        np.ascontiguousarray(model.displacement[:coordinates, keep] * poles * weight),
        np.ascontiguousarray(direct.real),
    )
