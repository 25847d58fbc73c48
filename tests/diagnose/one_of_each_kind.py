"""One measurement of every kind, of a rig that the prediction simulates: what a diagnosis works on, without a bag."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from diagnose.predicted_tests import chain, channels_of, level, locked, noise_test, rows_of

from nmt_core.messages.blocks import Quantity
from nmt_diagnose.measurements.backbone_table import BackboneTable
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.measurements.driven_record import DrivenRecord
from nmt_diagnose.measurements.imposed_motion import ImposedMotion
from nmt_diagnose.measurements.measurement import Observations, RowTable, joined
from nmt_diagnose.measurements.recorded_decay import RecordedDecay
from nmt_diagnose.measurements.stepped_responses import SteppedResponses
from nmt_diagnose.observations.channels.measuring_chain import MeasuringChain
from nmt_diagnose.observations.model_view import ModelView
from nmt_diagnose.observations.observables import Part, Place
from nmt_diagnose.prediction.forward import Forward, traced
from nmt_rig.rig import Rig

MATTERS = {"frequency": 5e-4, "damping": 0.02, "response": 0.02, "harmonics": 1e-3}
FREQUENCY = 21.0
FORCE = MeasuredChannel("f1", Quantity.FORCE, 1)
DISPLACEMENT = MeasuredChannel("x1", Quantity.DISPLACEMENT, 1)
ACCELERATION = MeasuredChannel("a2", Quantity.ACCELERATION, 2)
VOLTAGE = MeasuredChannel("u", Quantity.VOLTAGE, 0)


def rig_of_kinds(**changes: Any) -> Rig:
    """Two masses with friction and a hardening spring, without the parts of the friction that are slow to solve."""
    elements = [
        {"kind": "jenkins", "point": 2, "other_point": 1, "tangential_stiffness_n_m": 3000.0, "slip_force_n": 0.1},
        {"kind": "cubic_spring", "point": 1, "stiffness_n_m3": 2.0e8},
    ]
    return chain(**{"local_elements": elements, **changes})


def locked_windows(rig: Rig) -> Observations:
    """Five levels with the harmonics of all channels, lines of the mains and steps of converters."""
    drives = (0.05, 0.2, 0.5, 1.0, 1.6)
    levels = [
        replace(
            level(drive, FREQUENCY), index=k, start_s=10.0 * k, stop_s=10.0 * k + 7.0, cycles_before=200.0 * k,
            phase_error_std=2e-4, amplitude_leans=(1e-4,) * 4, fundamentals=(0.1 * drive,) * 4,
        )
        for k, drive in enumerate(drives)
    ]  # fmt: skip
    test, table = locked(rig, levels, "x1", harmonics=3)
    test = replace(test, name="levels")
    table += [(0, k, channel, -1, Part.LINE) for k in range(len(levels)) for channel in range(3)]
    table += [(0, k, channel, -1, Part.STEP) for k in range(len(levels)) for channel in range(3)]
    rows = rows_of(table)
    rows = replace(
        rows, amplitude=np.asarray(drives)[rows.level], frequency_hz=np.where(rows.part == Part.LINE, 50.0, FREQUENCY),
        time_s=10.0 * rows.level,
    )  # fmt: skip
    useful = (rows.harmonic != 0) & ((rows.channel < 3) | (rows.harmonic < 0))
    return _observed(rig, test, rows.take(useful))


def random_responses(rig: Rig, reference: str = "voltage") -> Observations:
    """Forty lines over the voltage, or over the force."""
    test, table = noise_test(rig, 5.0, 60.0, 40, reference=reference, window="none")
    test = replace(test, name=f"random over {reference}")
    rows = rows_of(table)
    rows = replace(
        rows, amplitude=np.full(len(rows), test.drive_rms), frequency_hz=np.asarray(test.lines_hz)[rows.level]
    )
    return _observed(rig, test, rows)


def stepped_responses(rig: Rig, force: float = 0.5) -> Observations:
    """Sixteen lines about the resonance at a held force, as the linear model has them, bent a little."""
    lines = np.linspace(17.0, 26.0, 16)
    channels = (DISPLACEMENT, ACCELERATION)
    view = ModelView.of(rig, (1,))
    found = view.responses((*channels, MeasuredChannel("f1", Quantity.FORCE, 1)), lines)
    measured = np.asarray((found[:2] / found[2]).T * 1.02 * np.exp(0.01j))
    test = SteppedResponses(
        f"sweep at {force:g}", 1, channels, "force", "force", lines, np.full(lines.size, force), measured,
        np.full(lines.size, 5e-3), 1,
    )  # fmt: skip
    table = RowTable()
    for channel in range(len(channels)):
        for k, line in enumerate(lines):
            for part, value in (
                (Part.LOG_MAGNITUDE, math.log(abs(measured[k, channel]))),
                (Part.PHASE, float(np.angle(measured[k, channel]))),
            ):
                table.add(part, value, 5e-3, 2e-4, Place(k, 0.0, float(line), force), channel, 1)
    observed = table.observations(test)
    forward = Forward(observed.tests, observed.rows)
    return replace(observed, tests=traced(observed.tests, forward.predict(rig)))


def free_decay(rig: Rig) -> Observations:
    """Six amplitudes of a decay with the shape of another channel."""
    amplitudes = np.geomspace(1e-3, 2e-5, 6)
    test = RecordedDecay("decay", 1, DISPLACEMENT, amplitudes, 26.0, (ACCELERATION,))
    table = RowTable()
    for k, amplitude in enumerate(amplitudes):
        place = Place(k, 0.3 * k, 26.0, float(amplitude))
        table.add(Part.LOG_FREQUENCY, 0.0, 2e-5, 0.0, place)
        table.add(Part.DAMPING, 0.0, 2e-4, 0.0, place)
        table.add(Part.LOG_MAGNITUDE, 0.0, 1e-3, 0.0, place, 1, 1)
        table.add(Part.PHASE, 0.0, 1e-3, 0.0, place, 1, 1)
    blank = table.observations(test)
    return _observed(rig, test, blank.rows, blank.std)


def driven_record(rig: Rig) -> Observations:
    """A second of two tones at the shaker's voltage, in six segments."""
    rate, count = 1000.0, 900
    time = np.arange(count) / rate
    u = 0.4 * np.sin(2.0 * np.pi * 19.0 * time) + 0.2 * np.sin(2.0 * np.pi * 31.0 * time)
    channels = tuple(channel for channel in channels_of(rig) if channel.quantity is not Quantity.VOLTAGE)
    test = DrivenRecord(
        "record", 1, rate, VOLTAGE, u, channels, np.linspace(0.0, 900.0, 7),
        zeros=np.array([1e-3, 1e-3, 1e-6, 1e-3]), limits=np.array([0.0, 0.0, 30.0]),
    )  # fmt: skip
    return _sampled(rig, test, count, 6)


def imposed_motion(rig: Rig) -> Observations:
    """A second of a motion of two tones, and the force that it takes."""
    rate, count = 1000.0, 900
    time = np.arange(count) / rate
    rows = [
        sum(
            a * (2.0 * np.pi * f) ** order * np.sin(2.0 * np.pi * f * time + 0.5 * np.pi * order)
            for a, f in ((1e-3, 4.0), (2e-4, 11.0))
        )
        for order in range(3)
    ]
    motion = np.array(rows)
    test = ImposedMotion(
        "imposed", 1, rate, DISPLACEMENT, motion[0], (FORCE, ACCELERATION), np.linspace(0.0, 900.0, 7),
        zeros=np.array([1e-6, 1e-3, 1e-3]), limits=np.zeros(2), motion=motion, gain_std=0.01,
        frequency_hz=5.0, size=1.2e-3, force_n=20.0,
    )  # fmt: skip
    return _sampled(rig, test, count, 6)


def backbone_table(rig: Rig) -> Observations:
    """Six amplitudes of a table of frequency and damping."""
    amplitudes = np.geomspace(2e-5, 1e-3, 6)
    test = BackboneTable("table", 1, DISPLACEMENT, amplitudes)
    table = RowTable()
    for k, amplitude in enumerate(amplitudes):
        place = Place(k, 0.0, 26.0, float(amplitude))
        table.add(Part.LOG_FREQUENCY, 0.0, 1e-4, 1e-4, place)
        table.add(Part.DAMPING, 0.0, 1e-3, 1e-4, place)
    blank = table.observations(test)
    return _observed(rig, test, blank.rows, blank.std, blank.floor)


KINDS: dict[str, Callable[[Rig], Observations]] = {
    "locked windows": locked_windows,
    "random responses": random_responses,
    "random responses over force": lambda rig: random_responses(rig, "force"),
    "stepped responses": lambda rig: joined([stepped_responses(rig, 0.5), stepped_responses(rig, 1.0)]),
    "free decay": free_decay,
    "driven record": driven_record,
    "imposed motion": imposed_motion,
    "backbone table": backbone_table,
}
"""Observations of each kind, by what the kind is called."""


def with_chain(observations: Observations) -> Observations:
    """The observations as of a laboratory, whose channels have ordinary tolerances."""
    chain = MeasuringChain(hold_hz=2000.0)
    return replace(observations, chains=(chain,) * len(observations.tests), matters=MATTERS)


def _observed(rig: Rig, test: Any, rows: Any, std: Any = None, floor: Any = None) -> Observations:
    """Values that the rig itself predicts."""
    values = Forward([test], rows).predict(rig).values
    typical = {Part.LOG_FREQUENCY: 2e-5, Part.PHASE_ERROR: 3e-3, Part.REAL: 2e-4, Part.IMAG: 2e-4, Part.LINE: 1e-6}
    known = np.array([typical.get(Part(part), 5e-4) for part in rows.part]) if std is None else std
    none = np.zeros(len(rows)) if floor is None else floor
    found = Observations((test,), rows, values, known, none)
    return found.take(np.isfinite(values))


def _sampled(rig: Rig, test: Any, count: int, step: int) -> Observations:
    picks = np.arange(60, count - 60, step)
    number = len(test.channels)
    rows = rows_of([(0, 0, channel, 1, Part.SAMPLE) for channel in range(number) for _ in picks])
    segment = np.searchsorted(test.segment_bounds, picks, side="right") - 1
    rows = replace(rows, time_s=np.tile(picks / test.sample_rate, number), level=np.tile(segment, number))
    values = Forward([test], rows).predict(rig).values
    sizes = np.array([np.std(values[rows.channel == channel]) for channel in range(number)])
    return Observations((test,), rows, values, 0.01 * sizes[rows.channel], np.zeros(len(rows)))
