"""Observations made by the prediction itself, with known noise: what a diagnosis of it must come to is known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from diagnose.predicted_tests import chain, level, locked, noise_test, rows_of

from nmt_diagnose.measurements.measurement import Observations
from nmt_diagnose.observations.observables import Part
from nmt_diagnose.prediction.forward import Forward
from nmt_rig.rig import Rig, validate_rig
from nmt_rig.rig_file import RigDocument

DRIVES = (0.02, 0.05, 0.1, 0.2, 0.4, 0.8, 1.2, 1.6)
FREQUENCY = 21.0
_STD = {
    Part.LOG_FREQUENCY: 2e-5,
    Part.PHASE_ERROR: 3e-3,
    Part.LOG_MAGNITUDE: 5e-4,
    Part.PHASE: 5e-4,
    Part.REAL: 2e-4,
    Part.IMAG: 2e-4,
    Part.LINE: 1e-6,
}


def real(model: Rig, **changes: Any) -> Rig:
    """The model with sections of its file replaced, ``local_elements`` added to those that are there."""
    values = model.model_dump()
    added = changes.pop("local_elements", [])
    values["local_elements"] = [*values["local_elements"], *added]
    for key, change in changes.items():
        values[key] = {**values[key], **change} if isinstance(change, dict) else change
    return validate_rig(RigDocument("test", values, {}))


def observations_of_model(
    truth: Rig,
    seed: int = 0,
    noise: float = 1.0,
    drives: Sequence[float] = DRIVES,
    random: bool = True,
    lock_noise: float = 0.0,
    mains: bool = False,
) -> Observations:
    """A run of locked levels, and a random test of 60 lines, of a rig that the prediction simulates.

    Args:
        truth: the rig.
        seed: of the noise.
        noise: in stated standard deviations; 0 = none, though as much is stated.
        drives: levels, V.
        random: whether there is a random test.
        lock_noise: standard deviation of where the loop stands beside where it is known to stand, rad.
        mains: whether the line at 50 Hz of each channel of the levels is observed.
    """
    frequency = _resonance(truth)
    levels = [
        replace(level(drive, frequency), index=k, start_s=10.0 * k, stop_s=10.0 * k + 7.0, cycles_before=200.0 * k)
        for k, drive in enumerate(drives)
    ]
    levels = [replace(item, phase_error_std=lock_noise) for item in levels]
    run, table = locked(truth, levels, "x1", harmonics=3)
    if mains:
        table += [(0, k, channel, -1, Part.LINE) for k in range(len(levels)) for channel in range(len(run.channels))]
    tests: list[Any] = [replace(run, name="levels")]
    if random:
        test, more = noise_test(truth, 5.0, 60.0, 60, test=1, window="none")
        tests.append(replace(test, name="random"))
        table = [*table, *more]
    rows = rows_of(table)
    amplitude, lines = np.zeros(len(rows)), np.full(len(rows), frequency)
    for number, test in enumerate(tests):
        mine = rows.test == number
        values = np.asarray(drives) if number == 0 else np.full(test.lines_hz.size, test.drive_rms)
        amplitude[mine] = values[rows.level[mine]]
        if number:
            lines[mine] = test.lines_hz[rows.level[mine]]
    lines[rows.part == Part.LINE] = 50.0
    rows = replace(rows, amplitude=amplitude, frequency_hz=lines, time_s=10.0 * rows.level)
    std = np.array([_STD[Part(part)] for part in rows.part])
    std[rows.test == 1] = 3e-3
    generator = np.random.default_rng(seed)
    stood = generator.standard_normal(len(levels)) * lock_noise
    played = [replace(tests[0], levels=tuple(replace(v, phase_error=p) for v, p in zip(levels, stood, strict=True)))]
    forward = Forward([*played, *tests[1:]], rows)
    values = forward.predict(truth).values
    # The voltage is known; orders 0 of accelerations and means are rounding.
    voltage = rows.channel == len(run.channels) - 1
    useful = np.isfinite(values) & ~(voltage & (rows.test == 0)) & (rows.harmonic != 0)
    values = values + noise * std * generator.standard_normal(len(rows))
    return Observations(tuple(tests), rows, values, std, np.zeros(len(rows))).take(useful)


def _resonance(rig: Rig) -> float:
    del rig
    return FREQUENCY


__all__ = ["DRIVES", "chain", "observations_of_model", "real"]
