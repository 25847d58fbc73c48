"""The tests without noise, reduced to observables: what differences between rigs are measured on.

Nothing here is shared with the diagnosis: harmonics by a plain least-squares fit, frequency responses by lines of the
Fourier transform.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from nmt_blind.cases.laboratory import (
    BenchSettings,
    TrialError,
    as_built,
    backbone_test,
    play,
    random_test,
)
from nmt_core.messages.blocks import OscillatorPhase, Quantity, SampleBlock
from nmt_core.messages.records import LevelCommand, LockEvent, LoopStatus
from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_core.vocabulary import LoopState
from nmt_rig.rig import Rig

FITTED = 9
"""Harmonics that are fitted, so that they do not leak into those that are used."""
_SEED = 20


@dataclass(frozen=True, eq=False)
class QuietWindow:
    """One locked window without noise.

    Attributes:
        channels: names, without the voltage.
        amplitudes: harmonics 0..FITTED in the frame of the drive, (channels, FITTED + 1).
        mains: amplitude of what goes with 50 Hz, (channels,).
        peaks: largest magnitude, (channels,).
        frequency_hz: mean over the window.
        samples: number of samples.
        stop_s: bench time of its end.
    """

    channels: tuple[str, ...]
    amplitudes: ComplexArray
    mains: ComplexArray
    peaks: FloatArray
    frequency_hz: float
    samples: int
    stop_s: float


@dataclass(frozen=True, eq=False)
class QuietRecord:
    """One random window without noise: channels without the voltage, (channels, n), and the voltage, (n,)."""

    channels: tuple[str, ...]
    data: FloatArray
    voltage: FloatArray


def quiet(rig: Rig, model: Rig) -> Rig:
    """The rig without noise and converters; converters that differ from the model's are left to `_quantised`."""
    sensors = [sensor.model_copy(update={"noise_psd": 0.0, "range": None, "bits": None}) for sensor in rig.sensors]
    return rig.model_copy(update={"sensors": sensors})


def play_backbone(truth: Rig, model: Rig, bench: BenchSettings) -> dict[int, QuietWindow]:
    """Windows of the levels that locked, by level.

    Raises:
        TrialError: the motion is not finite or the test does not end.
    """
    reduction = _Reduction(truth, model)
    play(as_built(quiet(truth, model), bench, _SEED), backbone_test(truth, model, bench), reduction)
    reduction.finish()
    return reduction.found


def play_random(truth: Rig, model: Rig, bench: BenchSettings) -> QuietRecord:
    """The window of the random test.

    Raises:
        TrialError: the motion is not finite or the test does not end.
    """
    heard = _HeardSamples()
    play(as_built(quiet(truth, model), bench, _SEED), random_test(model, bench), heard)
    if heard.lock is None:
        raise TrialError("the random test was given up")
    span = slice(heard.lock.window_first_sample, heard.lock.window_end)
    names = _names(truth)
    data = np.concatenate([block.data for block in heard.blocks], axis=1)[[heard.order.index(n) for n in names]]
    voltage = np.concatenate([block.voltage for block in heard.blocks])
    return QuietRecord(names, _quantised(data[:, span], names, truth, model), voltage[span])


@dataclass(frozen=True, eq=False)
class _Block:
    """All channels of one block: without the voltage, (channels, n), and the voltage, (n,)."""

    first_sample: int
    phase: OscillatorPhase
    data: FloatArray
    voltage: FloatArray


class _HeardSamples:
    """Listens to a test: blocks of the present level, in order, and its lock.

    Attributes:
        blocks: since the level began.
        order: names of the channels, without the voltage.
        lock: of the present level; None before and if it was lost before its window was complete.
    """

    def __init__(self) -> None:
        self.blocks: list[_Block] = []
        self.order: list[str] = []
        self.lock: LockEvent | None = None
        self._parts: list[SampleBlock] = []

    def __call__(self, topic: str, record: Any) -> None:
        if isinstance(record, SampleBlock):
            if self._parts and self._parts[0].first_sample != record.first_sample:
                self._join()
            self._parts.append(record)
        elif isinstance(record, LockEvent):
            self.lock = record
        elif isinstance(record, LoopStatus):
            lost = record.state == LoopState.LOCK_LOST
            if lost and self.lock is not None and record.last_sample + 1 < self.lock.window_end:
                self.lock = None
        elif isinstance(record, LevelCommand):
            self.finish()

    def _join(self) -> None:
        motion = [part for part in self._parts if part.quantity != Quantity.VOLTAGE]
        (voltage,) = (part for part in self._parts if part.quantity == Quantity.VOLTAGE)
        self.order = [name for part in motion for name in part.channels]
        data = np.concatenate([part.data for part in motion])
        self.blocks.append(_Block(voltage.first_sample, voltage.oscillator, data, voltage.data[0]))
        self._parts = []

    def finish(self) -> None:
        """The present level is over."""
        if self._parts:
            self._join()


class _Reduction(_HeardSamples):
    """Reduces the window of every level that locked when the level is over."""

    def __init__(self, truth: Rig, model: Rig) -> None:
        super().__init__()
        self._truth, self._model = truth, model
        self.found: dict[int, QuietWindow] = {}

    def finish(self) -> None:
        """The present level is over: keep what its window says and forget its samples."""
        super().finish()
        if self.lock is not None:
            window = _reduced(self.blocks, self.lock, self.order, self._truth, self._model)
            self.found[self.lock.level_index] = window
        self.blocks, self.lock = [], None


def _names(rig: Rig) -> tuple[str, ...]:
    return tuple(rig.sensor_channel(sensor) for sensor in rig.sensors if sensor.quantity != "voltage")


def _reduced(blocks: list[_Block], lock: LockEvent, order: list[str], truth: Rig, model: Rig) -> QuietWindow:
    first, samples, rate = lock.window_first_sample, lock.window_samples, float(model.sample_rate_hz)
    names = _names(truth)
    start = blocks[0].first_sample
    turns = []
    count = 0.0
    previous = None
    for block in blocks:
        cycles, frequency, slope = block.phase
        length = block.voltage.size / rate
        if previous is not None:
            count += round(previous - cycles)
        time = np.arange(block.voltage.size) / rate
        turns.append(count + cycles + time * (frequency + 0.5 * slope * time))
        previous = cycles + length * (frequency + 0.5 * slope * length)
    span = slice(first - start, first - start + samples)
    theta = np.concatenate(turns)[span]
    data = np.concatenate([block.data for block in blocks], axis=1)[[order.index(name) for name in names]][:, span]
    data = _quantised(data, names, truth, model)
    angle = 2.0 * np.pi * theta
    mains = 2.0 * np.pi * 50.0 * (first + np.arange(samples)) / rate
    columns = [np.ones(samples)]
    for n in range(1, FITTED + 1):
        columns += [np.cos(n * angle), np.sin(n * angle)]
    columns += [np.cos(mains), np.sin(mains)]
    basis = np.stack(columns)
    fitted = np.linalg.solve(basis @ basis.T, basis @ data.T).T
    amplitudes = np.empty((len(names), FITTED + 1), dtype=np.complex128)
    amplitudes[:, 0] = fitted[:, 0]
    amplitudes[:, 1:] = fitted[:, 1 : 2 * FITTED : 2] - 1j * fitted[:, 2 : 2 * FITTED + 1 : 2]
    return QuietWindow(
        channels=names,
        amplitudes=amplitudes,
        mains=fitted[:, -2] - 1j * fitted[:, -1],
        peaks=np.abs(data).max(axis=1),
        frequency_hz=float((theta[-1] - theta[0]) / (samples - 1) * rate),
        samples=samples,
        stop_s=(first + samples) / rate,
    )


def _quantised(data: FloatArray, names: tuple[str, ...], truth: Rig, model: Rig) -> FloatArray:
    """What converters that differ from the model's do, with the noise as dither and then without it."""
    believed = {model.sensor_channel(s): (s.bits, s.range) for s in model.sensors}
    result = data
    for sensor in truth.sensors:
        name = truth.sensor_channel(sensor)
        if name not in believed or (sensor.bits, sensor.range) == believed[name]:
            continue
        if sensor.bits is None or sensor.range is None:
            continue
        row = names.index(name)
        held = sensor.noise_correlation_time_s or 1.0 / truth.sample_rate_hz
        noise = np.sqrt(sensor.noise_psd / held) * np.random.default_rng([_SEED, row]).standard_normal(data.shape[1])
        step = 2.0 * sensor.range / 2.0**sensor.bits
        result = result.copy() if result is data else result
        result[row] = step * np.round((data[row] + noise) / step) - noise
    return result
