"""Tests whose results a laboratory hands over as tables, and free decays: all from the time integration of the truth.

A force of constant amplitude is stepped through the resonance, up at every level and down at the highest; every line
is measured after the motion has settled, through the sensors of the case. A decay from the highest level gives the
backbone: frequency and damping over the amplitude, from windows of a few periods.
"""

from __future__ import annotations

import json
import math
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from nmt_blind.cases.laboratory import BenchSettings, RecordingOutcome, as_built, sidecar_of
from nmt_blind.cases.laboratory_rig import Converters
from nmt_blind.cases.rig_edits import rig_yaml
from nmt_core.bench_version import bench_version
from nmt_core.errors import BenchError
from nmt_core.messages.blocks import OscillatorPhase
from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_plant.devices.simulated_rig import rig_sensors, sensor_row
from nmt_record.exchange.imports.imported_run import read_import, write_import
from nmt_rig.drift import Drift
from nmt_rig.linear_description import linear_description
from nmt_rig.model.time_integration import IntegrationError, TimeIntegrator
from nmt_rig.rig import Rig
from nmt_rig.rig_model import build_system, input_per_volt
from nmt_rig.sensors import SensorChannel

LINES = 41
MARGIN = 0.025
"""Of the resonance, by which the lines reach beyond it on either side."""
SETTLING = 6.0
"""Time constants of the mode before a line is measured."""
PERIODS = 24
"""Of a line's measurement."""
NODES = 10
"""Rows of a backbone."""
WINDOW = 12
"""Periods of the window that a row of a backbone is taken from."""
LOWEST = 0.08
"""Smallest amplitude of a decay that is used, over the largest."""
RESPONSE_SCATTER, FREQUENCY_SCATTER, DAMPING_SCATTER, AMPLITUDE_SCATTER = 3e-3, 1e-4, 0.03, 5e-3
"""Stated scatter: of a line, and of a backbone's frequencies, damping ratios and amplitudes, relative."""
_SEED = 0x7AB1E
# Phase that is near enough to resonance, rad, and how often a better frequency is tried.
_RESONANT, _TRIES = 2e-3, 20


class BenchRig:
    """A truth that is driven by a prescribed voltage and measured through its sensors; it goes on where it stopped.

    Args:
        built: the rig as it stands in the laboratory.
        seed: of the noise.
    """

    def __init__(self, built: Rig, seed: int) -> None:
        self.rate = built.sample_rate_hz
        system = build_system(built)
        self._volts = input_per_volt(built)
        rows = [sensor_row(system, built, index) for index in range(len(built.sensors))]
        true_rate = self.rate * (1.0 + built.clock_error)
        self._integrator = TimeIntegrator(system, true_rate, rows, built.substeps)
        self._drift = Drift(built)
        self._channels = [SensorChannel(sensor, true_rate, seed) for sensor in rig_sensors(built)]
        self.names = tuple(channel.sensor.channel for channel in self._channels)
        self._cycles = 0.0

    def drive(self, amplitude: float, frequency_hz: float, samples: int) -> FloatArray:
        """Recorded channels, shape (channels, samples), under a cosine that goes on in phase; 0 V = switched off.

        Raises:
            IntegrationError: the motion is not finite.
        """
        step = frequency_hz / self.rate
        cycles = self._cycles + step * np.arange(samples + 1)
        voltage = amplitude * np.cos(2.0 * np.pi * cycles)
        if self._drift.active:
            phase = OscillatorPhase(self._cycles % 1.0, frequency_hz, 0.0)
            values = self._drift.advance(self._integrator, self._volts * voltage[None], phase)
        else:
            values = self._integrator.advance(self._volts * voltage)
        self._cycles = float(cycles[-1]) % 1.0
        return np.stack([
            channel.measure(row, voltage[:-1])[0] for channel, row in zip(self._channels, values, strict=True)
        ])  # fmt: skip


@dataclass(frozen=True, eq=False)
class SimulatedDecay:
    """A free decay.

    Attributes:
        names: of the channels.
        data: from the switch-off on, (channels, n).
        before: samples before it with the drive still on, (channels, m).
        frequency_hz: of the drive before.
    """

    names: tuple[str, ...]
    data: FloatArray
    before: FloatArray
    frequency_hz: float


def settle(rig: BenchRig, level: float, frequency_hz: float, damping: float) -> float:
    """Bring a rig to phase resonance of force and acceleration at a level; the frequency that it is at.

    Raises:
        IntegrationError: the motion is not finite.
    """
    force = next(row for row, name in enumerate(rig.names) if name.startswith("f"))
    drive = next(row for row, name in enumerate(rig.names) if name == "a" + rig.names[force][1:])
    samples = round(SETTLING / (2.0 * np.pi * frequency_hz * damping) * rig.rate)
    found = frequency_hz
    for _ in range(_TRIES):
        rig.drive(level, found, samples)
        line = fundamental(rig.drive(level, found, round(PERIODS / found * rig.rate)), found / rig.rate)
        # Acceleration leads force by a right angle at phase resonance: near it, tan of the rest is (f0 - f) / (f0 ζ).
        remaining_phase = float(np.clip(np.angle(line[drive] / line[force] / 1j), -1.2, 1.2))
        if abs(remaining_phase) < _RESONANT:
            break
        found *= 1.0 + 0.7 * damping * math.tan(remaining_phase)
    return found


def fundamental(data: FloatArray, step: float) -> ComplexArray:
    """Complex amplitudes of the channels, (channels, n), at a frequency in cycles per sample, by least squares.

    The second and third harmonic and a constant are fitted too, so that they do not leak in.
    """
    angle = 2.0 * np.pi * step * np.arange(data.shape[1])
    columns = [np.ones(angle.size)]
    for order in (1, 2, 3):
        columns += [np.cos(order * angle), np.sin(order * angle)]
    basis = np.stack(columns)
    fitted = np.linalg.solve(basis @ basis.T, basis @ data.T)
    result: ComplexArray = fitted[1] - 1j * fitted[2]
    return result


def free_decay(built: Rig, model: Rig, level: float, seed: int) -> SimulatedDecay:
    """Drive the mode that is tested to phase resonance at a level, and switch off.

    Args:
        built: the rig as it stands in the laboratory.
        model: the rig as it is believed to be: where the search for the resonance begins.
        level: amplitude of the drive, V.
        seed: of the noise.

    Raises:
        IntegrationError: the motion is not finite.
    """
    start, damping = linear_description(model).plant_frequency_rad_s / (2.0 * np.pi), _damping(model)
    rig = BenchRig(built, seed)
    frequency = settle(rig, level, start, damping)
    before = rig.drive(level, frequency, round(0.2 * rig.rate))
    length = -math.log(0.5 * LOWEST) / (2.0 * np.pi * start * damping)
    return SimulatedDecay(rig.names, rig.drive(0.0, frequency, round(length * rig.rate)), before, frequency)


def _damping(rig: Rig) -> float:
    """Damping ratio of the mode that is tested, by the linear description."""
    ratios = linear_description(rig).damping_ratios
    return max(1e-4, float(ratios[min(rig.test.mode, len(ratios)) - 1]))


def backbone_of(signal: FloatArray, frequency_hz: float, rate: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Frequency (Hz), amplitude and damping ratio along a decay, at amplitudes in geometric steps, each (rows,).

    The signal is turned back by its frequency and smoothed by Hann's window; over as long a stretch again, straight
    lines through phase and logarithm of the amplitude give frequency and damping.
    """
    length = 2 * round(0.5 * WINDOW / frequency_hz * rate) + 1
    window = np.hanning(length + 2)[1:-1]
    turn = np.exp(-2j * np.pi * frequency_hz / rate * np.arange(signal.size))
    smooth = 2.0 * np.convolve(signal * turn, window / window.sum(), mode="valid")
    middle = np.arange(smooth.size) + length // 2
    size, phase = np.abs(smooth), np.unwrap(np.angle(smooth))
    half = length // 2
    first = half  # the first stretch that is free of the switch-off
    largest = size[first]
    found = []
    for target in largest * np.geomspace(1.0, LOWEST, NODES):
        below = np.flatnonzero(size[first:] <= target)
        at = first + (int(below[0]) if below.size else size.size)
        if at + half >= size.size:
            break
        span = slice(at - half, at + half + 1)
        time = (middle[span] - middle[at]) / rate
        turning = np.polynomial.polynomial.polyfit(time, phase[span], 1)[1]
        log_size, decay = np.polynomial.polynomial.polyfit(time, np.log(size[span]), 1)
        omega = 2.0 * np.pi * frequency_hz + turning
        found.append((omega / (2.0 * np.pi), math.exp(log_size), -decay / omega))
    frequency, amplitude, damping = np.array(found).T
    return frequency, amplitude, damping


def stepped_lines(
    built: Rig, model: Rig, force_volts: float, frequencies_hz: FloatArray, channel: str, seed: int
) -> tuple[ComplexArray, FloatArray]:
    """Response over force at every line, in the order given, and the force's amplitude in N.

    Args:
        built: the rig as it stands in the laboratory.
        model: the rig as it is believed to be: how long the motion settles follows from its damping.
        force_volts: amplitude of the drive, V.
        frequencies_hz: lines, (n,).
        channel: of the response.
        seed: of the noise.

    Raises:
        IntegrationError: the motion is not finite.
    """
    rig = BenchRig(built, seed)
    force = next(row for row, name in enumerate(rig.names) if name.startswith("f"))
    channel_row = rig.names.index(channel)
    settling = SETTLING / (2.0 * np.pi * float(frequencies_hz.mean()) * _damping(model))
    lines, forces = [], []
    for frequency in frequencies_hz:
        rig.drive(force_volts, float(frequency), round(settling * rig.rate))
        line = fundamental(rig.drive(force_volts, float(frequency), round(PERIODS / frequency * rig.rate)),
                           float(frequency) / rig.rate)  # fmt: skip
        lines.append(line[channel_row] / line[force])
        forces.append(abs(line[force]))
    return np.array(lines), np.array(forces)


def record_tables(
    bag: Path, truth: Rig, model: Rig, bench: BenchSettings, seed: int, converters: Converters | None = None
) -> RecordingOutcome:
    """Backbone and frequency responses as tables with their stated scatter; arguments as for `record_backbone`."""
    built = as_built(truth, bench, seed ^ _SEED)
    noise = np.random.default_rng([seed, _SEED])
    point = model.drive_point
    response, gauge = _named(model, "acceleration", point), _named(model, "displacement", 0)
    try:
        decay = free_decay(built, model, max(bench.levels), seed)
        measured = decay.data[decay.names.index(gauge)]
        frequency, amplitude, damping = backbone_of(measured, decay.frequency_hz, built.sample_rate_hz)
        reach = min(frequency.min(), decay.frequency_hz), max(frequency.max(), decay.frequency_hz)
        grid = np.linspace((1.0 - MARGIN) * reach[0], (1.0 + MARGIN) * reach[1], LINES)
        levels = (bench.levels[1], math.sqrt(bench.levels[1] * bench.levels[-1]), bench.levels[-1])
        passages = [(level, grid) for level in levels] + [(levels[-1], grid[::-1])]
        responses = [
            (level, lines, *stepped_lines(built, model, level, lines, response, seed + 1 + number))
            for number, (level, lines) in enumerate(passages)
        ]
    except (IntegrationError, BenchError) as error:
        return RecordingOutcome(0, 1, 0.0, str(error))
    files: dict[str, list[tuple[str, FloatArray]]] = {
        "backbone.csv": [
            ("frequency_hz", frequency * (1.0 + FREQUENCY_SCATTER * noise.standard_normal(frequency.size))),
            ("frequency_hz_std", FREQUENCY_SCATTER * frequency),
            ("amplitude", amplitude * (1.0 + AMPLITUDE_SCATTER * noise.standard_normal(frequency.size))),
            ("amplitude_std", AMPLITUDE_SCATTER * amplitude),
            ("damping_ratio", damping * (1.0 + DAMPING_SCATTER * noise.standard_normal(frequency.size))),
            ("damping_ratio_std", np.abs(DAMPING_SCATTER * damping)),
        ]
    }
    displaced = next(s for s in model.sensors if model.sensor_channel(s) == gauge)
    segments: list[dict[str, Any]] = [{
        "kind": "backbone", "file": "backbone.csv", "unit": "m", "name": "backbone",
        "point": model.sensor_point(displaced), "drive_point": point,
    }]  # fmt: skip
    for number, (_, lines, values, forces) in enumerate(responses, start=1):
        name = f"responses {number}"
        scatter = RESPONSE_SCATTER * np.abs(values) / math.sqrt(2.0)
        shaken = values + scatter * (noise.standard_normal(values.size) + 1j * noise.standard_normal(values.size))
        files[f"{name}.csv"] = [
            ("frequency_hz", lines), ("real", shaken.real), ("imag", shaken.imag), ("real_std", scatter),
            ("imag_std", scatter),
        ]  # fmt: skip
        segments.append({
            "kind": "frf", "file": f"{name}.csv", "unit": "m/s^2/N", "name": name, "point": point,
            "drive_point": point, "level": float(f"{forces.mean():.4g}"), "level_unit": "N",
            "direction": "up" if lines[-1] > lines[0] else "down",
        })  # fmt: skip
    lines_made = sum(lines.size for _, lines, *_ in responses)
    sidecar = {"rig": model.name, "file": "backbone.csv", "segments": segments}
    with tempfile.TemporaryDirectory() as folder:
        for name, columns in files.items():
            text = [",".join(key for key, _ in columns)]
            text += [",".join(f"{value:.9g}" for value in row) for row in zip(*(v for _, v in columns), strict=True)]
            (Path(folder) / name).write_text("\n".join(text) + "\n", encoding="utf-8")
        _import(Path(folder), sidecar, bag, model)
    return RecordingOutcome(lines_made, lines_made, 0.0)


def record_ring_down(
    bag: Path, truth: Rig, model: Rig, bench: BenchSettings, seed: int, converters: Converters | None = None
) -> RecordingOutcome:
    """A free decay from the highest level as a recording; arguments as for `record_backbone`."""
    built = as_built(truth, bench, seed ^ _SEED)
    try:
        decay = free_decay(built, model, max(bench.levels), seed)
    except (IntegrationError, BenchError) as error:
        return RecordingOutcome(0, 1, 0.0, str(error))
    rate, off = model.sample_rate_hz, decay.before.shape[1]
    data = np.concatenate([decay.before, decay.data], axis=1)
    sidecar = sidecar_of(model)
    sidecar["file"] = "decay.npz"
    sidecar["channels"] = [channel for channel in sidecar["channels"] if channel["quantity"] != "voltage"]
    sidecar["segments"] = [{
        "kind": "ring_down", "start": 0.0, "stop": data.shape[1] / rate, "switch_off": off / rate,
        "level": max(bench.levels), "level_unit": "V", "frequency_hz": float(f"{decay.frequency_hz:.6g}"),
    }]  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        np.savez(Path(folder) / "decay.npz", **dict(zip(decay.names, data, strict=True)))
        _import(Path(folder), sidecar, bag, model)
    return RecordingOutcome(1, 1, data.shape[1] / rate)


def _named(model: Rig, quantity: str, point: int) -> str:
    """Channel of a quantity at a point, or the first one of that quantity.

    Raises:
        BenchError: the rig measures no such thing.
    """
    found = [s for s in model.sensors if s.quantity == quantity]
    if not found:
        raise BenchError(f"The rig {model.name} has no {quantity} sensor, which its tables need; add one.")
    chosen = next((s for s in found if model.sensor_point(s) == point), found[0])
    return model.sensor_channel(chosen)


def _import(folder: Path, sidecar: dict[str, Any], bag: Path, model: Rig) -> None:
    path = folder / "sidecar.yaml"
    path.write_text(yaml.safe_dump(json.loads(json.dumps(sidecar)), sort_keys=False), encoding="utf-8")
    write_import(read_import(path), bag, model.name, rig_yaml(model), {"nmt": bench_version()})
