"""A diagnosis by hand: observations of every kind of test, models beside it, and one outcome per verdict."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import FloatArray
from nmt_diagnose.ledger.diagnosis import (
    Diagnosis,
    Gap,
    NextTest,
    PlaceShare,
    Ranked,
    Recalibrated,
    Share,
    Value,
    Verdict,
)
from nmt_diagnose.ledger.gap import rms
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.measurements.driven_record import DrivenRecord
from nmt_diagnose.measurements.locked_windows import LockedWindows
from nmt_diagnose.measurements.measurement import LockedLevel, Observations, RowTable, joined
from nmt_diagnose.measurements.random_responses import RandomResponses
from nmt_diagnose.measurements.recorded_decay import RecordedDecay
from nmt_diagnose.measurements.stepped_responses import SteppedResponses
from nmt_diagnose.observations.observables import Part, Place
from nmt_diagnose.say.residual_map import per_observable, residual_map
from nmt_report.diagnosis_curves import Models
from nmt_report.diagnosis_report import DiagnosisReport
from nmt_rig.rig import load_rig

DRIVES = (0.1, 0.2, 0.4, 0.8, 1.6)
FORCE = MeasuredChannel("f2", Quantity.FORCE, 2)
DISPLACEMENT = MeasuredChannel("x5", Quantity.DISPLACEMENT, 5)
HZ = 22.5


def phase_resonance() -> Observations:
    table = RowTable()
    levels = []
    for k, drive in enumerate(DRIVES):
        place = Place(k, 3.0 * k + 1.5, HZ, drive)
        levels.append(LockedLevel(k, drive, 0.0, 1e-3, HZ, 3.0 * k, 3.0 * k + 2.0, 60.0 * k, 1))
        table.add(Part.LOG_FREQUENCY, math.log(2.0 * math.pi * HZ), 1e-4, 0.0, place)
        table.add(Part.PHASE_ERROR, 1e-4, 1e-3, 0.0, place)
        for channel in (0, 1):
            table.add(Part.LOG_MAGNITUDE, math.log((2.0, 3e-4)[channel] * drive), 1e-3, 0.0, place, channel, 1)
            table.add(Part.PHASE, (0.8, 3.14)[channel], 1e-3, 0.0, place, channel, 1)
            for order in (2, 3):
                table.add(Part.REAL, 0.003 * order, 1e-4, 0.0, place, channel, order)
                table.add(Part.IMAG, -0.004 * order, 1e-4, 0.0, place, channel, order)
    test = LockedWindows("backbone", (2,), "x5", (FORCE, DISPLACEMENT), 3, "voltage", tuple(levels))
    return table.observations(test)


def random() -> Observations:
    lines = np.linspace(10.0, 200.0, 50)
    table = RowTable()
    for k, line in enumerate(lines):
        place = Place(k, 0.0, float(line), 0.05)
        table.add(Part.LOG_MAGNITUDE, 0.01 * k, 5e-3, 0.0, place, 0)
        table.add(Part.PHASE, -0.01 * k, 5e-3, 0.0, place, 0)
    return table.observations(RandomResponses("random", 2, (FORCE,), "voltage", lines, 0.1, "none", 0.05, 0.0, 30.0))


def stepped_sine(force: float, direction: int, channels: tuple[MeasuredChannel, ...], point: int = 2) -> Observations:
    lines = np.linspace(20.0, 25.0, 6)
    table = RowTable()
    for channel in range(len(channels)):
        for k, line in enumerate(lines):
            table.add(Part.LOG_MAGNITUDE, 0.1 * k, 5e-3, 0.0, Place(k, 0.0, float(line), force), channel, 1)
    measured = np.ones((lines.size, len(channels)), dtype=np.complex128)
    noise = np.full(lines.size, 5e-3)
    name = f"sweep {force} {direction} {point}"
    test = SteppedResponses(
        name, point, channels, "force", "force", lines, np.full(lines.size, force), measured, noise, direction
    )
    return table.observations(test)


def ring_down() -> Observations:
    amplitudes = np.geomspace(1e-3, 1e-5, 6)
    table = RowTable()
    for k, amplitude in enumerate(amplitudes):
        place = Place(k, 0.3 * k, HZ, float(amplitude))
        table.add(Part.LOG_FREQUENCY, math.log(2.0 * math.pi * HZ), 1e-4, 0.0, place)
        table.add(Part.DAMPING, 0.01, 1e-4, 0.0, place)
    return table.observations(RecordedDecay("decay", 2, DISPLACEMENT, amplitudes, HZ))


def record() -> Observations:
    table = RowTable()
    for k in range(60):
        table.add(Part.SAMPLE, 1e-3 * math.sin(0.3 * k), 1e-5, 0.0, Place(k // 20, 0.01 * k, 0.0, 0.0), 0)
    bounds = np.array([0.0, 20.0, 40.0, 60.0])
    return table.observations(DrivenRecord("record", 2, 100.0, FORCE, np.zeros(60), (DISPLACEMENT,), bounds))


def every_test() -> Observations:
    found = joined([phase_resonance(), random(), ring_down(), record()])
    return replace(found, inputs=(("bags/backbone", "ab" * 32), ("bags/random", "cd" * 32)))


def one_test() -> Observations:
    return replace(phase_resonance(), inputs=(("bags/backbone", "ab" * 32),))


def models_of(observations: Observations) -> Models:
    """The model as given is 5 standard deviations off everywhere, the re-fitted one 3, the final one 0.5."""
    sign = np.where(np.arange(len(observations.rows)) % 2, 1.0, -1.0)
    shifted: list[FloatArray] = [observations.values + size * sign * observations.sigma for size in (5.0, 3.0, 0.5)]
    return Models(*shifted)


def report(verdict: Verdict, observations: Observations | None = None) -> DiagnosisReport:
    """A report of a verdict; ``effect`` has a class of two that cannot be distinguished."""
    observations = every_test() if observations is None else observations
    models = models_of(observations)
    given, refitted, final = (
        (values - observations.values) / observations.sigma
        for values in (models.as_given, models.refitted, models.final)
    )
    last = final if verdict is Verdict.EFFECT else refitted
    everything = np.ones(len(observations.rows), dtype=bool)
    nan = math.nan
    closed = (0.9, 0.8, 0.95) if verdict in (Verdict.EFFECT, Verdict.CALIBRATION) else (nan, nan, nan)
    ranked = Ranked(
        "cubic_stiffness", "structure", "5", 0.93, ("quintic_stiffness",), {"k": Value(2.0e7, 3.1e5, "N/m³")},
        Share(0.9, 0.8, 0.95), 64.0,
    )  # fmt: skip
    pair = Ranked(
        "air_drag + force_gain", "structure + force_sensor", "3 + f2", 0.02, (),
        {"air_drag@3.c2": Value(0.4, 0.1, "N s²/m²"), "force_gain@f2.g": Value(0.01, 0.002, "1")},
        Share(nan, nan, nan), 4.0,
    )  # fmt: skip
    gapless = verdict in (Verdict.NONE, Verdict.CALIBRATION)
    diagnosis = Diagnosis(
        verdict=verdict,
        sentences=(f"Where of {verdict.value}.", f"Which of {verdict.value}.", f"How far of {verdict.value}."),
        where=() if gapless else (PlaceShare("structure", "5", 0.9, 0.94), PlaceShare("time", "", 0.1, 0.06)),
        ranking=(ranked, pair),
        probabilities={"none": 0.01, "unknown": 0.04, "cubic_stiffness@5": 0.93},
        gap=Gap(
            3.0, rms(last), 1.0, 5.0, *closed, per_observable(observations, [(refitted, last, everything)]),
            ("every second level",),
        ),
        next_test=() if gapless else (
            NextTest(
                "higher levels, up to 3 V", "./nmt run beam --levels 1.5:3:6 --out high",
                ("cubic_stiffness", "quintic_stiffness"), 8.0,
            ),
        ),
        calibration=(
            Recalibrated("local_elements.0.slip_force_n", 1.0, 1.02, 0.004, "N", 0.1, 5.0),
            Recalibrated("structure.youngs_modulus_pa", 1.85e11, 1.8502e11, 9e7, "Pa", 0.01, 0.2),
        ),
        inputs={
            "bags": [{"path": path, "sha256": digest} for path, digest in observations.inputs],
            "tests": [{"name": "backbone", "kind": "LockedWindows", "drive_point": 2, "levels": 5}],
            "held_out": ["every second level"],
            "withheld": ["microslip"],
            "seed": 0,
        },
        notes=("backbone: level 7 is left out.",),
        residual_map=residual_map(observations, given, refitted, last),
        residual_tests=(
            {"name": "even harmonics", "where": "backbone", "statistic": 99.0, "degrees_of_freedom": 10,
             "p": 1e-9, "p_holm": 1e-8},
            {"name": "odd harmonics above the first", "where": "x5", "statistic": 9.0, "degrees_of_freedom": 10,
             "p": 0.5, "p_holm": 1.0},
        ),
        candidates=({"label": "none", "log_evidence": 0.0, "chi_square": 900.0, "rows": 100, "converged": True},),
    )  # fmt: skip
    return DiagnosisReport(diagnosis, observations, models, load_rig("beam"))
