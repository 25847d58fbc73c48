"""The rows that a test which has not been made would have, with uncertainties as they are in the tests at hand.

A table has a function for every kind of test that the diagnosis takes; of the others a sentence says why they are not
predicted. Rows that show faults of a recording are never predicted: lines of the mains, steps, limits and repeated
samples of channels.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.kinds import PhaseResonanceTest, ResponseCurveTest
from nmt_core.kinds.request import TestRequest
from nmt_core.messages.blocks import Quantity
from nmt_core.messages.driven_test import DrivenTest
from nmt_core.numerics.arrays import FloatArray
from nmt_core.vocabulary import MOTIONS, ControlKind, TestKind
from nmt_diagnose.coverage import covers
from nmt_diagnose.effects.rig_edit import with_value
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.measurements.locked_windows import LockedWindows
from nmt_diagnose.measurements.measurement import (
    LockedLevel,
    LockedLevels,
    Measurement,
    Observations,
    RowTable,
    holds_amplitude,
    is_broad_band,
    joined,
    locked_levels,
)
from nmt_diagnose.measurements.random_responses import RandomResponses
from nmt_diagnose.measurements.recorded_decay import RecordedDecay
from nmt_diagnose.measurements.stepped_responses import SteppedResponses
from nmt_diagnose.observations.channels.measuring_chain import MeasuringChain
from nmt_diagnose.observations.model_view import ModelView
from nmt_diagnose.observations.observables import FUNDAMENTAL, Part, Place
from nmt_diagnose.observations.observation_settings import ObservationSettings
from nmt_diagnose.prediction.forward import Forward
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_rig.model.linear_modes import sticking_modes
from nmt_rig.rig import Rig
from nmt_rig.rig_model import build_elements, build_structure
from nmt_sequencer.level_plan import directed
from nmt_signals.decays.decay_nodes import SEGMENT_MOST_PERIODS
from nmt_signals.decays.decay_reading import DEMODULATION_WIDTHS
from nmt_signals.harmonics import resolvable_harmonics

# Lines of a random test that is computed ahead.
_RANDOM_LINES = 80

_READ = ObservationSettings()
_LEVEL_S = 6.0
"""Time from level to level that is reckoned with where none was measured, s."""
_DECADES_OF_A_DECAY = 100.0
"""Largest over smallest amplitude of a decay that is reckoned with, where it lasts long enough."""
_CURVE_REACH, _CURVE_GRID = 1.5, 4001
"""Range of frequencies about that of the mode, and their number, from which points of a response curve are taken."""
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
        raise BenchError(reason_against(request.kind.NUMBER))
    return foretell(request, rig_of(request, rig), at_hand)


def reason_against(kind: TestKind) -> str:
    """Why the rows of a kind of test are not all foretold; empty = they are."""
    if kind in NOT_FORETOLD:
        return NOT_FORETOLD[kind]
    return "" if kind in EXPECTED else covers(DrivenTest(kind=kind))


def voltage_runs(observations: Observations) -> list[LockedLevels]:
    """Runs of locked levels whose drive is known."""
    return [test.locked for test in observations.tests if test.locked is not None and test.over_voltage]


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


def _is_locked(test: Measurement) -> bool:
    return test.locked is not None


def _is_free(test: Measurement) -> bool:
    return test.free


def _typical(
    observations: Observations, alike: Callable[[Measurement], bool], part: Part, harmonic: int, fraction: float
) -> float:
    """Median uncertainty of a kind of observable in the tests at hand, near a level given as a fraction of all."""
    selected = np.zeros(len(observations.rows), dtype=bool)
    for number, test in enumerate(observations.tests):
        if alike(test):
            selected |= observations.rows.test == number
    selected &= (observations.rows.part == part) & (observations.rows.harmonic == harmonic)
    if not selected.any():
        return part.facts.typical_std
    amplitude = observations.rows.amplitude[selected]
    order = np.argsort(amplitude, kind="stable")
    sigma = observations.sigma[selected][order]
    middle = round(fraction * (sigma.size - 1))
    reach = max(1, sigma.size // 6)
    return float(np.median(sigma[max(0, middle - reach) : middle + reach + 1]))


def _chains(observations: Observations, alike: Callable[[Measurement], bool]) -> tuple[MeasuringChain | None, ...]:
    """Tolerances of a test that has not been made: those of the first of its kind, else of the first test."""
    found = list(zip(observations.tests, observations.chains, strict=False))
    return tuple([chain for test, chain in found if alike(test)] or [chain for _, chain in found])[:1]


def _locked(request: TestRequest, rig: Rig, at_hand: Observations) -> Observations:
    """A run of locked levels."""
    frequency_hz = float(model_frequencies(rig)[mode_of(request, rig) - 1])
    drives = _drives(request, rig, at_hand, np.array([frequency_hz]))
    return _windows(request, rig, at_hand, _levels(drives, request, at_hand, frequency_hz))


def _stepped(request: TestRequest, rig: Rig, at_hand: Observations) -> Observations:
    """Windows at given frequencies: those near resonance are read as levels without control of the phase.

    The linear model gives the distance of each from resonance.
    """
    count = len(request.levels)
    frequencies = np.array(request.frequencies_hz * (count if len(request.frequencies_hz) == 1 else 1))
    view = ModelView.of(rig, [drive_point_of(request, rig, at_hand)])
    force, motion = view.responses(_force_and_motion(view), frequencies)
    phases = np.angle(force / (2j * np.pi * frequencies * motion))
    drives = _drives(request, rig, at_hand, frequencies)
    near = np.flatnonzero(np.abs(phases) <= THRESHOLDS.reading.furthest_phase_rad)
    if not near.size:
        raise BenchError("Stepped sines are levels only near resonance, and none of these lies within 60° of it.")
    levels = tuple(
        LockedLevel(
            number, drives[k], float(phases[k]), 1e-3, float(frequencies[k]), number * _LEVEL_S,
            (number + 0.7) * _LEVEL_S, (number + 0.5) * _LEVEL_S * float(frequencies[k]), 1,
        )
        for number, k in enumerate(near)
    )  # fmt: skip
    return _windows(request, rig, at_hand, levels)


def _windows(request: TestRequest, rig: Rig, at_hand: Observations, levels: tuple[LockedLevel, ...]) -> Observations:
    """Rows of windows at given levels; of those that the loop held the phase is one."""
    channels, point = channels_of(request, rig, at_hand), drive_point_of(request, rig, at_hand)
    ideal = MeasuredChannel(f"x{point}", Quantity.DISPLACEMENT, point)
    response = next((c for c in channels if c.quantity in MOTIONS and c.point == point), ideal)
    harmonics = max(
        (test.locked.harmonics for test in at_hand.tests if test.locked is not None), default=_READ.harmonics
    )
    table = RowTable()
    sizes = sorted({level.drive for level in levels})
    for level in levels:
        place = Place(level.index, 0.5 * (level.start_s + level.stop_s), level.frequency_hz, level.drive)
        fraction = sizes.index(level.drive) / max(1, len(sizes) - 1)

        def add(part: Part, channel: int = -1, harmonic: int = -1, place: Place = place, at: float = fraction) -> None:
            std = _typical(at_hand, _is_locked, part, harmonic, at)
            table.add(part, 0.0, std, 0.0, place, channel, harmonic)

        add(Part.LOG_FREQUENCY)
        if request.kind.closes_phase_loop:
            add(Part.PHASE_ERROR)
        resolved = resolvable_harmonics(harmonics, float(rig.sample_rate_hz) / level.frequency_hz)
        for number, channel in enumerate(channels):
            add(Part.LOG_MAGNITUDE, number, 1)
            add(Part.PHASE, number, 1)
            if channel.quantity is Quantity.DISPLACEMENT:
                add(Part.REAL, number, 0)
            for harmonic in range(2, resolved + 1):
                add(Part.REAL, number, harmonic)
                add(Part.IMAG, number, harmonic)
    test = LockedWindows("proposed", (point,), response.name, channels, harmonics, "voltage", levels)
    return replace(table.observations(test), chains=_chains(at_hand, _is_locked))


def _drives(request: TestRequest, rig: Rig, at_hand: Observations, frequencies_hz: FloatArray) -> tuple[float, ...]:
    """Drive of each level at its frequency or at one for all, V: where something else is held, by the linear model."""
    levels = np.array(request.levels)
    if request.control is ControlKind.VOLTAGE:
        return request.levels
    view = ModelView.of(rig, [drive_point_of(request, rig, at_hand)])
    per_volt = np.abs(view.responses(_force_and_motion(view), frequencies_hz))
    return tuple((levels / per_volt[0 if request.control is ControlKind.FORCE else 1]).tolist())


def _force_and_motion(view: ModelView) -> tuple[MeasuredChannel, MeasuredChannel]:
    """Force and displacement at the drive point."""
    point = view.rig.drive_point
    return MeasuredChannel("f", Quantity.FORCE, point), MeasuredChannel("x", Quantity.DISPLACEMENT, point)


def _levels(
    drives: Sequence[float], request: TestRequest, at_hand: Observations, frequency_hz: float
) -> tuple[LockedLevel, ...]:
    """Levels in their order; where they fall, they do so after all that was measured."""
    drives = drives if request.direction == "given" else directed(drives, request.direction)
    falling = request.direction in ("down", "both")
    start, cycles, length = 0.0, 0.0, _LEVEL_S
    locked = locked_levels(at_hand.tests)
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
    lines = np.geomspace(0.4 * frequencies[mode - 1], top, _RANDOM_LINES)
    table = RowTable()
    lowest = (level.drive for level in locked_levels(voltage_runs(at_hand)) if math.isfinite(level.drive))
    rms = request.levels[0] if request.levels else min(lowest, default=_LOW_LEVEL_V)
    for number, line in enumerate(lines):
        place = Place(number, 0.0, float(line), rms)
        for channel in range(len(channels)):
            for part in FUNDAMENTAL:
                table.add(part, 0.0, THRESHOLDS.next_test.typical_response_std, 0.0, place, channel)
    point = drive_point_of(request, rig, at_hand)
    test = RandomResponses("proposed", point, channels, "voltage", lines, 0.1, "none", rms, 0.0, 60.0)
    return replace(table.observations(test), chains=_chains(at_hand, is_broad_band))


def _decays(request: TestRequest, rig: Rig, at_hand: Observations) -> Observations:
    """Free decays from locked levels, one for each.

    They begin at the amplitude of the model as it is, and fall with the damping of its mode.
    """
    mode = mode_of(request, rig)
    locked = expected(replace(request, kind=PhaseResonanceTest()), rig, at_hand)
    motions = [(k, c) for k, c in enumerate(locked.tests[0].channels) if c.quantity in MOTIONS]
    if not motions:
        raise BenchError("A decay is read from a response, and the rig has no sensor of one.")
    point = drive_point_of(request, rig, at_hand)
    order = (Quantity.DISPLACEMENT, Quantity.ACCELERATION, Quantity.VELOCITY)
    motions.sort(key=lambda it: (it[1].point != point, order.index(it[1].quantity)))
    begins = Forward(locked.tests, locked.rows).predict(rig).values
    structure = build_structure(rig)
    damping = float(sticking_modes(structure, build_elements(rig, structure)).damping_ratios[mode - 1])
    parts, rows = [], locked.rows
    for level in range(len(request.levels)):
        here = rows.level == level
        first = here & (rows.channel == motions[0][0]) & (rows.part == Part.LOG_MAGNITUDE)
        size = float(np.exp(begins[first][0]))
        omega = float(np.exp(begins[here & (rows.part == Part.LOG_FREQUENCY)][0]))
        if not math.isfinite(size * omega):
            raise BenchError(f"The model {rig.name} has no solution at the level of {request.levels[level]:g}.")
        lasts = min(request.kind.window_s or math.inf, math.log(_DECADES_OF_A_DECAY) / max(damping * omega, 1e-12))
        most = lasts * omega / (2.0 * np.pi) / (SEGMENT_MOST_PERIODS * float(np.median(DEMODULATION_WIDTHS)))
        count = int(np.clip(round(most), 1, _READ.decay_points))
        amplitudes = size * np.exp(-damping * omega * np.linspace(0.0, lasts, count + 1)[:-1])
        decay = RecordedDecay(
            f"proposed {level + 1}", point, motions[0][1], amplitudes, omega / (2.0 * np.pi),
            tuple(channel for _, channel in motions[1:]),
        )  # fmt: skip
        parts.append(replace(_decay_rows(decay, damping, lasts, at_hand), chains=_chains(at_hand, _is_free)))
    return joined(parts)


def _decay_rows(decay: RecordedDecay, damping: float, lasts: float, at_hand: Observations) -> Observations:
    """Rows of a decay that lasts so many seconds."""
    table, count, floors = RowTable(), decay.amplitudes.size, _READ.floors
    sizes = enumerate(decay.amplitudes.tolist())
    places = [Place(k, lasts * k / count, decay.frequency_hz, amplitude) for k, amplitude in sizes]

    def add(part: Part, place: Place, channel: int, floor: float, scale: float = 1.0) -> None:
        std = scale * _typical(at_hand, _is_free, part, 1, 1.0 - place.level / max(1, count - 1))
        table.add(part, 0.0, std, floor, place, channel, 1)

    for place in places:
        add(Part.LOG_FREQUENCY, place, 0, floors.decay_log_frequency)
        add(Part.DAMPING, place, 0, floors.decay_damping * damping)
    for number in range(1, 1 + len(decay.others)):
        for place in places:
            add(Part.LOG_MAGNITUDE, place, number, floors.decay_shape)
            add(Part.PHASE, place, number, floors.decay_shape)
    return table.observations(decay)


def _curves(request: TestRequest, rig: Rig, at_hand: Observations) -> Observations:
    """Response curves, one for each level, with points as they lie along the curve of the linear model."""
    kind = request.kind
    assert isinstance(kind, ResponseCurveTest)
    point = drive_point_of(request, rig, at_hand)
    channels = [c for c in channels_of(request, rig, at_hand) if c.quantity in MOTIONS]
    channels.sort(key=lambda channel: channel.point != point)
    view = ModelView.of(rig, [point])
    frequency_hz = float(model_frequencies(rig)[mode_of(request, rig) - 1])
    grid = frequency_hz * np.geomspace(1.0 / _CURVE_REACH, _CURVE_REACH, _CURVE_GRID)
    force, motion, *responses = view.responses([*_force_and_motion(view), *channels], grid)
    lag = -np.angle(motion / force)
    # Another mode or an antiresonance passes the same lags.
    inside = np.flatnonzero((lag > min(kind.lag_from, kind.lag_to)) & (lag < max(kind.lag_from, kind.lag_to)))
    pieces = np.split(inside, np.flatnonzero(np.diff(inside) > 1) + 1)
    inside = min(pieces, key=lambda piece: float(np.min(np.abs(np.log(grid[piece] / frequency_hz)), initial=math.inf)))
    if inside.size < 2 or not channels:
        raise BenchError(f"The model {rig.name} has no such lags about its mode at {frequency_hz:.4g} Hz.")
    along = np.log(motion[inside] / force[inside])
    steps = np.hypot(np.abs(np.diff(along)), kind.FREQUENCY_WEIGHT * np.diff(np.log(grid[inside])))
    way = np.concatenate(([0.0], np.cumsum(steps)))
    marks = np.linspace(0.0, way[-1], max(2, 1 + math.ceil(way[-1] / kind.spacing)))
    lines = inside[np.clip(np.searchsorted(way, marks), 0, inside.size - 1)]
    lines = lines if kind.lag_from < kind.lag_to else lines[::-1]
    measured = np.column_stack([response[lines] / force[lines] for response in responses])
    held = "response" if request.control is ControlKind.RESPONSE else "force"
    parts = []
    for number, level in enumerate(request.levels):
        forces = level / np.abs(motion[lines] / force[lines]) if held == "response" else np.full(lines.size, level)
        noise = np.full(lines.size, math.hypot(Part.PHASE.facts.typical_std, _READ.floors.stepped))
        order = slice(None, None, -1 if number % 2 else 1)  # there and back
        test = SteppedResponses(
            f"proposed {number + 1}", point, tuple(channels), "force", held, grid[lines][order], forces[order],
            measured[order], noise,
        )  # fmt: skip
        table = RowTable()
        for k, line in enumerate(test.lines_hz):
            place = Place(k, k * _LEVEL_S, float(line), float(test.levels[k]))
            for channel in range(len(channels)):
                for part in FUNDAMENTAL:
                    std = _typical(at_hand, holds_amplitude, part, 1, 0.5)
                    table.add(part, 0.0, std, _READ.floors.stepped, place, channel, 1)
        parts.append(replace(table.observations(test), chains=_chains(at_hand, holds_amplitude)))
    return joined(parts)


NOT_FORETOLD = {
    TestKind.RANDOM: "At which lines a random test is read follows from its own noise; their parts and channels are "
    "foretold, on lines spread evenly over the band about the mode.",
    TestKind.RING_DOWN: "At which amplitudes a decay is read follows from its own noise; their parts and channels are "
    "foretold, at amplitudes that the linear damping leaves.",
    TestKind.RESPONSE_CURVE: "How many points a response curve has follows from how it bends; their parts and channels "
    "are foretold, with as many as the linear model has.",
    TestKind.RECORD: "The bench does no record test, so none is asked for.",
}
"""Why a test has rows other than those that are expected of it."""
EXPECTED: dict[TestKind, Callable[[TestRequest, Rig, Observations], Observations]] = {
    TestKind.PHASE_RESONANCE: _locked,
    TestKind.RANDOM: _random,
    TestKind.STEPPED_SINE: _stepped,
    TestKind.RING_DOWN: _decays,
    TestKind.RESPONSE_CURVE: _curves,
}
"""What foretells the rows of each kind of test."""
