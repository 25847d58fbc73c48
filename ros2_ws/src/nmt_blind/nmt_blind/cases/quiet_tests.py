"""The tests without noise, reduced to observables: what differences between rigs are measured on.

Nothing here is shared with the diagnosis: harmonics by a plain least-squares fit, frequency responses by lines of the
Fourier transform.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nmt_blind.cases.laboratory import (
    BenchSettings,
    TrialError,
    as_built,
    backbone_test,
    play,
    random_test,
)
from nmt_core.blocks import FloatArray, Quantity
from nmt_plant.device import DeviceFault
from nmt_rig.rig import Rig

ComplexArray = NDArray[np.complex128]

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
    found: dict[int, QuietWindow] = {}
    names = _names(truth)
    blocks: list[tuple[int, float, float, float, FloatArray]] = []
    try:
        for step in play(as_built(quiet(truth, model), bench, _SEED), model, backbone_test(truth, model, bench)):
            force = step.blocks[Quantity.FORCE]
            if step.begun is not None:
                blocks = []
            phase = force.oscillator
            data = np.concatenate([b.data for q, b in step.blocks.items() if q != Quantity.VOLTAGE])
            blocks.append((force.first_sample, phase.cycles, phase.frequency_hz, phase.rate_hz_s, data))
            if step.ended is not None:
                window = step.ended
                order = [c for q, b in step.blocks.items() if q != Quantity.VOLTAGE for c in b.channels]
                found[window.level.index] = _reduced(
                    blocks, window.first_sample, window.samples, model.sample_rate_hz, order, names, truth, model
                )
    except DeviceFault as fault:
        raise TrialError(str(fault)) from fault
    return found


def play_random(truth: Rig, model: Rig, bench: BenchSettings) -> QuietRecord:
    """The window of the random test.

    Raises:
        TrialError: the motion is not finite or the test does not end.
    """
    parts: list[FloatArray] = []
    voltages: list[FloatArray] = []
    first = samples = 0
    order: list[str] = []
    try:
        for step in play(as_built(quiet(truth, model), bench, _SEED), model, random_test(model, bench)):
            order = [c for q, b in step.blocks.items() if q != Quantity.VOLTAGE for c in b.channels]
            parts.append(np.concatenate([b.data for q, b in step.blocks.items() if q != Quantity.VOLTAGE]))
            voltages.append(step.blocks[Quantity.VOLTAGE].data[0])
            if step.ended is not None:
                first, samples = step.ended.first_sample, step.ended.samples
    except DeviceFault as fault:
        raise TrialError(str(fault)) from fault
    if samples == 0:
        raise TrialError("the random test was given up")
    span = slice(first, first + samples)
    data = np.concatenate(parts, axis=1)[:, span]
    names = _names(truth)
    data = data[[order.index(name) for name in names]]
    return QuietRecord(names, _quantised(data, names, truth, model), np.concatenate(voltages)[span])


def _names(rig: Rig) -> tuple[str, ...]:
    return tuple(rig.sensor_channel(sensor) for sensor in rig.sensors if sensor.quantity != "voltage")


def _reduced(
    blocks: list[tuple[int, float, float, float, FloatArray]],
    first: int,
    samples: int,
    rate: float,
    order: list[str],
    names: tuple[str, ...],
    truth: Rig,
    model: Rig,
) -> QuietWindow:
    start = blocks[0][0]
    turns = []
    count = 0.0
    previous = None
    for _, cycles, frequency, slope, data in blocks:
        length = data.shape[1] / rate
        if previous is not None:
            count += round(previous - cycles)
        time = np.arange(data.shape[1]) / rate
        turns.append(count + cycles + time * (frequency + 0.5 * slope * time))
        previous = cycles + length * (frequency + 0.5 * slope * length)
    span = slice(first - start, first - start + samples)
    theta = np.concatenate(turns)[span]
    data = np.concatenate([block[4] for block in blocks], axis=1)[[order.index(name) for name in names]][:, span]
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
