"""The rows that a test which has not been made would have, with uncertainties as they are in the tests at hand.

A table has a function for every kind of test that the diagnosis takes; of the others it says why it cannot foretell
them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.kinds.request import TestRequest
from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import FloatArray
from nmt_core.vocabulary import MOTIONS, TestKind
from nmt_diagnose.effects.rig_edit import with_value
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.measurements.locked_windows.locked_level import LockedLevel
from nmt_diagnose.measurements.locked_windows.locked_windows import LockedWindows
from nmt_diagnose.measurements.measurement import Measurement
from nmt_diagnose.measurements.random_responses.random_responses import RandomResponses
from nmt_diagnose.observations.channels.measuring_chain import MeasuringChain
from nmt_diagnose.observations.observables import Observations, Part, Place, RowTable
from nmt_diagnose.observations.observation_settings import ObservationSettings
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_rig.model.linear_modes import sticking_modes
from nmt_rig.rig import Rig
from nmt_rig.rig_model import build_elements, build_structure
from nmt_sequencer.level_plan import directed
from nmt_signals.harmonics import resolvable_harmonics

# Uncertainties of a kind of observable of which the tests at hand hold none.
_TYPICAL = {
    Part.LOG_FREQUENCY: 3e-5,
    Part.PHASE_ERROR: 3e-3,
    Part.LOG_MAGNITUDE: 1e-3,
    Part.PHASE: 1e-3,
    Part.REAL: 1e-3,
    Part.IMAG: 1e-3,
}

_READ = ObservationSettings()
_LEVEL_S = 6.0
"""Time from level to level that is reckoned with where none was measured, s."""
_LOW_LEVEL_V = 0.05
"""Drive of a random test that is reckoned with where no level is known, V rms."""


def expected(request: TestRequest, rig: Rig, at_hand: Observations) -> Observations:
    """Observables of a test that has not been made; values are not set.

    Args:
        request: the test.
        rig: the model.
        at_hand: what has been measured.

    Raises:
        BenchError: what a test of this kind would show cannot be foretold; the sentence says why.
    """
    foretell = EXPECTED.get(request.kind.NUMBER)
    if foretell is None:
        raise BenchError(f"What a {request.kind.words()} test would show is not foretold.")
    return foretell(request, rig_of(request, rig), at_hand)


def voltage_runs(observations: Observations) -> list[LockedWindows]:
    """Runs of locked levels whose drive is known."""
    return [it for it in observations.tests if isinstance(it, LockedWindows) and it.held == "voltage"]


def rig_of(request: TestRequest, rig: Rig) -> Rig:
    """The model with the sensors of a request where they are."""
    for sensor in request.sensors:
        places = [k for k, it in enumerate(rig.sensors) if rig.sensor_channel(it) == sensor.channel]
        for index in places if sensor.channel else ():
            rig = with_value(rig, ("sensors", index, "point"), sensor.point)
    return rig


def model_frequencies(rig: Rig) -> FloatArray:
    """Frequencies of the model's modes with friction sticking, Hz; 0 of a body that nothing holds."""
    structure = build_structure(rig)
    return np.asarray(sticking_modes(structure, build_elements(rig, structure)).frequencies / (2.0 * np.pi))


def mode_of(request: TestRequest, rig: Rig) -> int:
    """Number of the mode that a test is about: the first that swings from that of the request or of the rig on.

    Raises:
        BenchError: none does.
    """
    asked = int(dict(request.changes).get("test.mode", rig.test.mode))
    swinging = np.flatnonzero(model_frequencies(rig) > 0.0) + 1
    if not swinging.size:
        raise BenchError(
            f"The model {rig.name} has no mode that swings, so what such a test would show is not foretold."
        )
    return int(swinging[min(int(np.searchsorted(swinging, asked)), swinging.size - 1)])


def channels_of(request: TestRequest, rig: Rig, at_hand: Observations) -> tuple[MeasuredChannel, ...]:
    """Channels of a test: those of the rig with its exciter where it is then, and those of further sensors."""
    result = []
    for sensor in rig.sensors:
        quantity = Quantity[sensor.quantity.upper()]
        if quantity in (Quantity.VOLTAGE, Quantity.CURRENT):
            continue
        where = sensor.point if isinstance(sensor.point, int) else drive_point_of(request, rig, at_hand)
        result.append(MeasuredChannel(sensor.channel or f"{quantity.letter}{where}", quantity, where))
    for more in request.sensors:
        if not more.channel:
            quantity = Quantity[more.quantity.upper()]
            result.append(MeasuredChannel(f"another at {more.point}", quantity, more.point, ideal=True))
    return tuple(result)


def drive_point_of(request: TestRequest, rig: Rig, at_hand: Observations) -> int:
    """Measurement point of the exciter: where it was in the tests at hand unless it is moved."""
    points = (*request.exciters, *(run.drive_point for run in voltage_runs(at_hand)), rig.drive_point)
    return points[0]


def _typical(
    observations: Observations, kind: type[Measurement] | tuple[type, ...], part: Part, harmonic: int, fraction: float
) -> float:
    """Median uncertainty of a kind of observable in the tests at hand, near a level given as a fraction of all."""
    selected = np.zeros(len(observations.rows), dtype=bool)
    for number, test in enumerate(observations.tests):
        if isinstance(test, kind):
            selected |= observations.rows.test == number
    selected &= (observations.rows.part == part) & (observations.rows.harmonic == harmonic)
    if not selected.any():
        return THRESHOLDS.next_test.typical_response_std if kind is RandomResponses else _TYPICAL[part]
    amplitude = observations.rows.amplitude[selected]
    order = np.argsort(amplitude, kind="stable")
    sigma = observations.sigma[selected][order]
    middle = round(fraction * (sigma.size - 1))
    reach = max(1, sigma.size // 6)
    return float(np.median(sigma[max(0, middle - reach) : middle + reach + 1]))


def _chains(observations: Observations, kind: type[Measurement]) -> tuple[MeasuringChain | None, ...]:
    """Tolerances of a test that has not been made: those of the first of its kind, else of the first test."""
    found = list(zip(observations.tests, observations.chains, strict=False))
    return tuple([chain for test, chain in found if isinstance(test, kind)] or [chain for _, chain in found])[:1]


def _locked(request: TestRequest, rig: Rig, at_hand: Observations) -> Observations:
    """A run of locked levels."""
    channels, point = channels_of(request, rig, at_hand), drive_point_of(request, rig, at_hand)
    frequency_hz = float(model_frequencies(rig)[mode_of(request, rig) - 1])
    ideal = MeasuredChannel(f"x{point}", Quantity.DISPLACEMENT, point)
    response = next((c for c in channels if c.quantity in MOTIONS and c.point == point), ideal)
    harmonics = max((t.harmonics for t in at_hand.tests if isinstance(t, LockedWindows)), default=_READ.harmonics)
    resolved = resolvable_harmonics(harmonics, float(rig.sample_rate_hz) / frequency_hz)
    levels = _levels(request, at_hand, frequency_hz)
    table = RowTable()
    sizes = sorted({level.drive for level in levels})
    for level in levels:
        place = Place(level.index, 0.5 * (level.start_s + level.stop_s), frequency_hz, level.drive)
        fraction = sizes.index(level.drive) / max(1, len(sizes) - 1)

        def add(part: Part, channel: int = -1, harmonic: int = -1, place: Place = place, at: float = fraction) -> None:
            table.add(part, 0.0, _typical(at_hand, LockedWindows, part, harmonic, at), 0.0, place, channel, harmonic)

        add(Part.LOG_FREQUENCY)
        add(Part.PHASE_ERROR)
        for number, channel in enumerate(channels):
            add(Part.LOG_MAGNITUDE, number, 1)
            add(Part.PHASE, number, 1)
            if channel.quantity is Quantity.DISPLACEMENT:
                add(Part.REAL, number, 0)
            for harmonic in range(2, resolved + 1):
                add(Part.REAL, number, harmonic)
                add(Part.IMAG, number, harmonic)
    test = LockedWindows("proposed", (point,), response.name, channels, harmonics, "voltage", levels)
    return replace(table.observations(test), chains=_chains(at_hand, LockedWindows))


def _levels(request: TestRequest, at_hand: Observations, frequency_hz: float) -> tuple[LockedLevel, ...]:
    """Levels in their order; where they fall, they do so after all that was measured."""
    drives = request.levels if request.direction == "given" else tuple(directed(request.levels, request.direction))
    falling = request.direction in ("down", "both")
    start, cycles, length = 0.0, 0.0, _LEVEL_S
    locked = [level for test in at_hand.tests if isinstance(test, LockedWindows) for level in test.levels]
    if falling and locked:
        last = max(locked, key=lambda level: level.stop_s)
        start, cycles, length = last.stop_s, last.cycles_before, 1.5 * max(last.stop_s - last.start_s, 1.0)
    turning = int(np.argmax(drives)) if falling else len(drives)
    return tuple(
        LockedLevel(
            k, drive, 0.0, 1e-3, frequency_hz, start + k * length, start + (k + 0.7) * length,
            cycles + (k + 0.5) * length * frequency_hz, -1 if k > turning else 1,
        )
        for k, drive in enumerate(drives)
    )  # fmt: skip


def _random(request: TestRequest, rig: Rig, at_hand: Observations) -> Observations:
    """A random test at low level."""
    channels = channels_of(request, rig, at_hand)
    frequencies = model_frequencies(rig)
    mode = mode_of(request, rig)
    top = min(0.35 * rig.sample_rate_hz, 3.0 * frequencies[min(frequencies.size - 1, mode + 1)])
    lines = np.geomspace(0.4 * frequencies[mode - 1], top, THRESHOLDS.next_test.random_lines)
    table = RowTable()
    lowest = (level.drive for run in voltage_runs(at_hand) for level in run.levels if math.isfinite(level.drive))
    rms = request.levels[0] if request.levels else min(lowest, default=_LOW_LEVEL_V)
    for number, line in enumerate(lines):
        place = Place(number, 0.0, float(line), rms)
        for channel in range(len(channels)):
            for part in (Part.LOG_MAGNITUDE, Part.PHASE):
                table.add(part, 0.0, THRESHOLDS.next_test.typical_response_std, 0.0, place, channel, 1)
    point = drive_point_of(request, rig, at_hand)
    test = RandomResponses("proposed", point, channels, "voltage", lines, 0.1, "none", rms, 0.0, 60.0)
    return replace(table.observations(test), chains=_chains(at_hand, RandomResponses))


EXPECTED: dict[TestKind, Callable[[TestRequest, Rig, Observations], Observations]] = {
    TestKind.PHASE_RESONANCE: _locked,
    TestKind.RANDOM: _random,
}
"""What foretells the rows of each kind of test."""
