"""Observables of locked windows: frequency, phase at lock, and complex harmonics of every channel."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_core.vocabulary import MOTIONS, VELOCITY_LEAD, TestKind
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.measurements.locked_windows import (
    SURE_DEVIATIONS,
    LockedWindow,
    LockedWindows,
    analyse_window,
    driven_as_recorded,
    force_framed,
    without_hold,
)
from nmt_diagnose.measurements.measurement import LockedLevel, Observations, RowTable, empty, locked_levels
from nmt_diagnose.observations.bag_windows import BagWindow, BagWindows
from nmt_diagnose.observations.channels.bag_samples import SampleStretch
from nmt_diagnose.observations.model_view import ModelView
from nmt_diagnose.observations.noise.scatter import moderated
from nmt_diagnose.observations.observables import Part, Place
from nmt_diagnose.observations.observation_settings import Floors, ObservationSettings
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_extract.judgement.uncertainty import jackknife_variance
from nmt_extract.modal.evaluated_window import resonance_std
from nmt_signals.channel_faults.clipping import clipping_level
from nmt_signals.channel_faults.converter_faults import converter_step, repeated_share
from nmt_signals.channel_faults.mains_lines import MAINS_HZ

_RESPONSES = (Quantity.DISPLACEMENT, Quantity.ACCELERATION, Quantity.VELOCITY)


def wrapped(angle: FloatArray) -> FloatArray:
    """Angles in [−π, π)."""
    result: FloatArray = (np.asarray(angle) + math.pi) % (2.0 * math.pi) - math.pi
    return result


def _drift(single: FloatArray) -> FloatArray:
    """Change over the window of the straight line through sub-window values, along the first axis."""
    count = single.shape[0]
    time = (np.arange(count) + 0.5) / count - 0.5
    result: FloatArray = np.tensordot(time, single, axes=1) / float((time * time).sum())
    return result


def phase_lean(single: FloatArray) -> float:
    """How far a loop may still be off that has not settled, from the drift of sub-windows beyond their scatter.

    A transient of the structure that decays over the window by about a half leaves a mean of about twice its change;
    the quantity that the loop holds has no drift.
    """
    count = single.shape[0]
    drift = float(_drift(single))
    time = (np.arange(count) + 0.5) / count - 0.5
    residual = single - single.mean() - drift * time
    scatter = float(residual @ residual) / max(1, count - 2) / float(time @ time)
    return THRESHOLDS.noise.lean_ratio * math.sqrt(max(0.0, drift * drift - scatter))


def locked_windows_of(bag: BagWindows) -> list[Observations]:
    """Windows of phase resonance, and of stepped sines that are no frequency response, a test for each kind.

    Raises:
        BenchError: the bag cannot be of the model's rig.
    """
    bag.drop_implausible()
    found = []
    for kind in (TestKind.PHASE_RESONANCE, TestKind.STEPPED_SINE):
        windows = bag.of_kind(kind)
        if windows and not bag.is_swept(kind):
            name = bag.named(kind)
            found.append(phase_resonance_observations(name, windows, bag))
            bag.note_few_levels(name, len(locked_levels(found[-1].tests)))
    return found


def phase_resonance_observations(name: str, windows: Sequence[BagWindow], bag: BagWindows) -> Observations:
    """Observables of locked windows of one bag.

    Stepped-sine windows near resonance count as locked windows without control of the phase: they have no row for the
    phase, and are left out beyond 60° of phase.

    Args:
        name: name of the test.
        windows: the windows and their samples, in time.
        bag: they are of.
    """
    view, channels, settings = bag.view, bag.channels, bag.settings
    notes: list[str] = []
    kept, levels = _levels(name, windows, bag, notes)
    if not kept:
        return empty(notes)
    notes += _dropped_channels(name, kept, channels)
    held = "voltage" if all(math.isfinite(level.drive) for level in levels) else "force"
    if held == "force":
        kept = [force_framed(window, settings.harmonics) for window in kept]
        levels = [replace(level, terms=window.terms) for level, window in zip(levels, kept, strict=True)]
    levels = _with_direction(levels, held)
    present = [c for c in channels.values() if c.quantity not in (Quantity.VOLTAGE, Quantity.CURRENT)]
    recorded = {model_channel.name: theirs for theirs, model_channel in channels.items()}
    response = _response(kept[0].stretch, view.rig.drive_point, bag.controlled_quantity)
    levels = [
        replace(
            level,
            amplitude_leans=tuple(window.lean(recorded[channel.name]) for channel in present),
            fundamentals=tuple(window.fundamental(recorded[channel.name]) for channel in present),
        )
        for level, window in zip(levels, kept, strict=True)
    ]
    test = LockedWindows(
        name=name,
        drive_points=view.rig.exciter_points,
        response_channel=channels[response.name].name if response and response.name in channels else "",
        channels=tuple(present),
        harmonics=settings.harmonics,
        held=held,
        levels=tuple(levels),
        commanded=held == "voltage" and any(window.commanded for window in kept),
    )
    table = RowTable()
    run = UsedWindows(name, kept, levels, present, recorded, held)
    slopes = [_frequency_per_phase(window, view, response) for window in kept]
    cells = _add_rows_of_levels(run, slopes, settings, table)
    notes += add_rows_of_channels(run, cells, view, settings.floors, table)
    return table.observations(test, notes)


def _levels(
    name: str, windows: Sequence[BagWindow], bag: BagWindows, notes: list[str]
) -> tuple[list[LockedWindow], list[LockedLevel]]:
    """Windows that can be used, with their harmonics, and their conditions; sentences on the others into ``notes``."""
    analysed: list[LockedWindow] = []
    for window in windows:
        try:
            analysed.append(
                analyse_window(window.segment, window.stretch, bag.settings, bag.view, settled=False, sine=bag.sine)
            )
        except BenchError as error:
            notes.append(f"{name}: {error}")
    kept, levels = [], []
    for locked in driven_as_recorded(analysed):
        held = without_hold(locked, bag.view, bag.channels, bag.hold_rate_hz)
        outcome = _level(held, bag.view.rig.drive_point, bag.controlled_quantity)
        if isinstance(outcome, str):
            notes.append(f"{name}: {outcome}")
            continue
        levels.append(outcome)
        kept.append(held)
    return kept, levels


def _add_rows_of_levels(
    run: UsedWindows, slopes: Sequence[float], settings: ObservationSettings, table: RowTable
) -> list[Cell]:
    """Add frequency, phase at lock and harmonics of every level to a table; returns the harmonics with their scatter.

    Args:
        run: the windows.
        slopes: noise of ln ω over that of the phase at lock, of each.
        settings: of the reading.
        table: takes the rows.
    """
    cells: list[Cell] = []
    for index, window in enumerate(run.windows):
        for channel in run.channels:
            theirs = run.recorded[channel.name]
            # A force that is held is an input.
            if theirs in window.rows and not (run.held == "force" and theirs in window.forces):
                cells += _cells(index, channel, window, window.row(theirs), settings.harmonics)
    moderate(cells)
    floors = settings.floors
    index_of = {channel.name: number for number, channel in enumerate(run.channels)}
    for index, (window, level) in enumerate(zip(run.windows, run.levels, strict=True)):
        place = run.place(index, level.frequency_hz)
        std = resonance_std(window.frequency_std / window.frequency_hz, slopes[index], level.phase_error_std)
        floor = floors.window(Part.LOG_FREQUENCY)
        table.add(Part.LOG_FREQUENCY, math.log(2.0 * math.pi * level.frequency_hz), std, floor, place)
        if window.segment.kind is TestKind.PHASE_RESONANCE or window.segment.kind is TestKind.UNKNOWN:
            floor = math.hypot(floors.window(Part.PHASE_ERROR, levels=len(run.levels)), level.phase_lean)
            table.add(Part.PHASE_ERROR, level.phase_error, level.phase_error_std, floor, place)
        for cell in cells:
            if cell.level == index:
                number = index_of[cell.name]
                floor = floors.window(cell.part, run.channels[number].quantity)
                std = math.sqrt(cell.variance) / cell.scale
                table.add(cell.part, cell.value, std, floor, place, number, cell.harmonic)
    return cells


def _response(stretch: SampleStretch, drive_point: int, wanted: Quantity | None) -> MeasuredChannel | None:
    """Drive-point response that the phase is measured with."""
    order = ((wanted,) if wanted is not None else ()) + _RESPONSES
    for quantity in order:
        channel = stretch.find(quantity, drive_point)
        if channel is not None and channel.name not in stretch.faults:
            return channel
    return None


def _level(window: LockedWindow, drive_point: int, wanted: Quantity | None) -> LockedLevel | str:
    """Conditions of a window, or why it cannot be used."""
    segment, stretch = window.segment, window.stretch
    where = f"Level {segment.level_index}"
    response = _response(stretch, drive_point, wanted)
    if response is None:
        return f"{where}: no usable response at the drive point {drive_point}, so the phase is unknown; it is left out."
    lead = VELOCITY_LEAD[response.quantity]
    rows = window.row(window.forces[0]), window.row(response.name)

    def error(amplitudes: ComplexArray) -> FloatArray:
        ratio = amplitudes[..., rows[0], 1] * np.conj(amplitudes[..., rows[1], 1])
        return np.asarray(np.angle(ratio) - lead, dtype=np.float64)

    if not (abs(window.amplitudes[rows[0], 1]) > 0.0 and abs(window.amplitudes[rows[1], 1]) > 0.0):
        return f"{where}: force or drive-point response is zero; it is left out."
    value = float(wrapped(error(window.amplitudes)))
    without = wrapped(error(window.without) - value)
    variance = float(jackknife_variance(without))
    drift = float(_drift(wrapped(error(window.single) - value)))
    if abs(value) > THRESHOLDS.reading.furthest_phase_rad:
        turned = abs(value) > math.pi - THRESHOLDS.reading.furthest_phase_rad
        why = "force or response has the wrong sign" if turned else "not near resonance"
        return f"{where}: force and velocity are {math.degrees(value):.0f}° apart ({why}); it is left out."
    lean = phase_lean(wrapped(error(window.single) - value))
    std = math.sqrt(variance)
    if abs(drift) > THRESHOLDS.noise.drift_sigmas * math.sqrt(12.0) * std:
        std = math.hypot(std, 0.5 * drift)
    return LockedLevel(
        index=segment.level_index,
        drive=window.drive if window.referenced else math.nan,
        phase_error=value,
        phase_error_std=std,
        phase_lean=lean,
        frequency_hz=window.frequency_hz,
        start_s=stretch.start_s,
        stop_s=stretch.stop_s,
        cycles_before=(
            stretch.cycles_before
            if math.isfinite(stretch.cycles_before)
            else window.frequency_hz * 0.5 * (stretch.start_s + stretch.stop_s)
        ),
        direction=1,
        force_n=float(abs(window.amplitudes[rows[0], 1])),
        terms=window.terms,
    )


def _with_direction(levels: list[LockedLevel], held: str) -> list[LockedLevel]:
    """Levels that know whether they were reached from below or from above."""
    size = [level.drive if held == "voltage" else level.force_n for level in levels]
    result = []
    for index, level in enumerate(levels):
        rising = size[index] >= size[index - 1] if index else len(levels) < 2 or size[1] >= size[0]
        result.append(replace(level, direction=1 if rising else -1))
    return result


def _dropped_channels(name: str, windows: list[LockedWindow], channels: dict[str, MeasuredChannel]) -> list[str]:
    lost: dict[tuple[str, str], list[int]] = {}
    for window in windows:
        for channel, fault in window.stretch.faults.items():
            if channel in channels:
                lost.setdefault((channel, fault), []).append(window.segment.level_index)
    return [
        f"{name}: channel {channel} is left out at level {', '.join(map(str, indices))}: {fault}."
        for (channel, fault), indices in lost.items()
    ]


def _cells(level: int, channel: MeasuredChannel, window: LockedWindow, row: int, harmonics: int) -> list[Cell]:
    """Observables of one channel at one level, up to a harmonic."""
    over_window, without, single = window.amplitudes[row], window.without[:, row], window.single[:, row]
    size = float(abs(over_window[1]))
    degrees_of_freedom = without.shape[0] - 1
    if not size > 0.0:
        return []
    cells = []

    def add(harmonic: int, part: Part, value: float, varied: FloatArray, parts: FloatArray) -> None:
        # In the unit of the channel, so that noise of the same kind compares.
        variance, drift = float(jackknife_variance(varied)) * size**2, float(_drift(parts)) * size
        cells.append(Cell(level, channel.name, harmonic, part, value, size, variance, drift, degrees_of_freedom))

    turned = over_window[1] / size
    add(1, Part.LOG_MAGNITUDE, math.log(size), np.log(np.abs(without[:, 1])), np.log(np.abs(single[:, 1])))
    add(
        1,
        Part.PHASE,
        float(np.angle(over_window[1])),
        np.angle(without[:, 1] / turned),
        np.angle(single[:, 1] / turned),
    )
    for harmonic in range(min(over_window.shape[0], harmonics + 1)):
        if harmonic == 1 or (harmonic == 0 and channel.quantity is not Quantity.DISPLACEMENT):
            continue
        for part in (Part.REAL, Part.IMAG) if harmonic else (Part.REAL,):
            pick = np.real if part is Part.REAL else np.imag
            add(
                harmonic, part, float(pick(over_window[harmonic])) / size,
                pick(without[:, harmonic]) / size, pick(single[:, harmonic]) / size,
            )  # fmt: skip
    return cells


def moderate(cells: list[Cell]) -> None:
    """Draw the variances of a channel together, harmonic by harmonic, and add what drifts."""
    groups: dict[tuple[str, object, int], list[Cell]] = {}
    for cell in cells:
        kind: object = cell.part if cell.harmonic == 1 else min(cell.harmonic, 2)
        groups.setdefault((cell.name, kind, cell.degrees_of_freedom), []).append(cell)
    for (_, _, degrees_of_freedom), group in groups.items():
        variances, degrees = moderated(np.array([cell.variance for cell in group]), float(degrees_of_freedom))
        # Residuals over a deviation from d values have the variance d / (d − 2).
        for cell, variance in zip(group, variances * degrees / (degrees - 2.0), strict=True):
            cell.variance = float(variance)
            if cell.drift**2 > THRESHOLDS.noise.drift_sigmas**2 * 12.0 * cell.variance:
                cell.variance += 0.25 * cell.drift**2


def _frequency_per_phase(window: LockedWindow, view: ModelView, response: MeasuredChannel | None) -> float:
    """|d ln ω / d phase| of the resonance, about its damping ratio: noise of the phase at lock is noise of ω for it."""
    if response is None or response.name not in window.rows:
        return 0.05
    omega = 2.0 * math.pi * window.frequency_hz
    displacement = abs(window.amplitudes[window.row(response.name), 1]) / omega ** MOTIONS[response.quantity]
    amplitude = abs(window.amplitudes[window.row(window.forces[0]), 1])
    return float(np.clip(amplitude * view.shape**2 / (2.0 * omega**2 * displacement), 1e-4, 0.5))


# -- rows of channels ------------------------------------------------------------------------------------------------


# The line of the mains that is observed in any case; the other one only where it stands out by so many deviations.
_COMMON_MAINS = MAINS_HZ[0]


@dataclass
class Cell:
    """One observable of one channel on its way: values in the unit of the channel over its fundamental."""

    level: int
    name: str
    harmonic: int
    part: Part
    value: float
    scale: float
    variance: float
    drift: float
    degrees_of_freedom: int


@dataclass(frozen=True, eq=False)
class UsedWindows:
    """The windows of one test that are used.

    Attributes:
        name: of the test.
        windows, levels: the windows and their conditions.
        channels: of the model; recorded: name in the bag of each.
        held: ``voltage`` or ``force``.
    """

    name: str
    windows: Sequence[LockedWindow]
    levels: Sequence[LockedLevel]
    channels: Sequence[MeasuredChannel]
    recorded: Mapping[str, str]
    held: str

    def place(self, index: int, frequency_hz: float) -> Place:
        """Where a row of a window belongs."""
        level = self.levels[index]
        amplitude = level.drive if self.held == "voltage" else level.force_n
        return Place(index, 0.5 * (level.start_s + level.stop_s), frequency_hz, amplitude)


def add_rows_of_channels(
    run: UsedWindows, cells: Sequence[Cell], view: ModelView, floors: Floors, table: RowTable
) -> list[str]:
    """Add the rows that follow no excitation: lines of the mains, steps, limits, lost samples; sentences on them."""
    notes = [*_add_mains(run, floors, table), *_add_steps(run, cells, view, table)]
    _add_limits(run, view, table)
    _add_repeats(run, table)
    return notes


def _add_mains(run: UsedWindows, floors: Floors, table: RowTable) -> list[str]:
    """Add the lines of the mains to a table; sentences on those that stand out."""
    notes = []
    for number, channel in enumerate(run.channels):
        theirs = run.recorded[channel.name]
        for hz in MAINS_HZ:
            found = []
            for index, window in enumerate(run.windows):
                line = window.mains.get(hz)
                # Steps that a loop makes in a voltage are not hum.
                stepped = line is not None and any(
                    line.amplitudes[k] > SURE_DEVIATIONS * line.std[k] for k in window.moved
                )
                if line is not None and not stepped and theirs in window.rows:
                    row = window.row(theirs)
                    floor = floors.harmonic * float(abs(window.amplitudes[row, 1]))
                    found.append((index, float(line.amplitudes[row]), float(line.std[row]), floor))
            if not found:
                continue
            _, values, deviations, least = np.array(found).T
            weights = 1.0 / (deviations**2 + least**2)
            mean = float(weights @ values / weights.sum())
            stands_out = mean * math.sqrt(float(weights.sum())) > THRESHOLDS.reading.hum_sigmas
            if stands_out:
                unit = channel.quantity.unit
                notes.append(f"{run.name}: channel {channel.name} has a line of {mean:.3g} {unit} at {hz:g} Hz.")
            if stands_out or hz == _COMMON_MAINS:
                for index, value, std, floor in found:
                    table.add(Part.LINE, value, std, floor, run.place(index, hz), number)
    return notes


def _add_steps(run: UsedWindows, cells: Sequence[Cell], view: ModelView, table: RowTable) -> list[str]:
    """Add the steps of converters that are not hidden in the noise, measured or of the model; sentences on them."""
    notes = []
    believed = {
        view.rig.sensor_channel(sensor): 2.0 * sensor.range / 2.0**sensor.bits
        for sensor in view.rig.sensors
        if sensor.bits is not None and sensor.range is not None
    }
    for number, channel in enumerate(run.channels):
        theirs = run.recorded[channel.name]
        found = [k for k, window in enumerate(run.windows) if theirs in window.rows]
        variances = [
            0.5 * cell.variance * run.windows[cell.level].stretch.samples
            for cell in cells
            if cell.name == channel.name and cell.harmonic > 1
        ]
        if not found or not variances:
            continue
        steps = [converter_step(run.windows[k].stretch.row(theirs)) for k in found]
        # One converter has one step; at a level of few values it shows as a multiple of it.
        positive = [step for step in steps if step > 0.0]
        step = min(positive) if 2 * len(positive) > len(steps) else 0.0
        total = float(np.median(variances))
        expected = believed.get(channel.name, 0.0)
        # A step that is as the model has it gives no information.
        if max(step, expected) <= THRESHOLDS.reading.hidden_step_share * math.sqrt(total) or math.isclose(
            step, expected, rel_tol=0.01
        ):
            continue
        if step > 0.0:
            size = f"{step:.3g} {channel.quantity.unit}"
            notes.append(f"{run.name}: channel {channel.name} is recorded in steps of {size}.")
        noise = math.sqrt(max(total - step**2 / 12.0, (0.1 * step) ** 2))
        floor = THRESHOLDS.reading.step_std_share * noise * math.sqrt(len(found))
        for k in found:
            table.add(Part.STEP, step, 0.0, floor, run.place(k, run.levels[k].frequency_hz), number)
    return notes


def _add_limits(run: UsedWindows, view: ModelView, table: RowTable) -> None:
    """Add the levels at which channels are clipped, where the model does not say so."""
    believed = believed_limits(view)
    for number, channel in enumerate(run.channels):
        if channel.quantity is Quantity.VOLTAGE:
            continue
        theirs = run.recorded[channel.name]
        found = {
            k: level
            for k, window in enumerate(run.windows)
            if theirs in window.rows and (level := clipping_level(window.stretch.row(theirs))) > 0.0
        }
        for k, level in found.items():
            add_limit(
                table, level, believed.get(channel.name), run.place(k, run.levels[k].frequency_hz), number, len(found)
            )


def believed_limits(view: ModelView) -> dict[str, float | None]:
    """Level at which the model clips each channel, in its unit; None = nowhere."""
    return {view.rig.sensor_channel(sensor): sensor.clip or sensor.range for sensor in view.rig.sensors}


def add_limit(table: RowTable, level: float, expected: float | None, place: Place, channel: int, times: int) -> None:
    """Add the row of a level at which samples of a channel stay, unless the model clips it there.

    Args:
        table: rows of the test.
        level: of the samples, in the channel's unit.
        expected: the model's; None = nowhere.
        place: of the row.
        channel: number of the channel in its test.
        times: rows that say the same: together they count once.
    """
    if expected is None or not math.isclose(level, expected, rel_tol=THRESHOLDS.reading.same_limit_share):
        floor = THRESHOLDS.reading.limit_std_share / level * math.sqrt(times)
        table.add(Part.LIMIT, 1.0 / level, 0.0, floor, place, channel)


def _add_repeats(run: UsedWindows, table: RowTable) -> None:
    """Add the share of samples that channels lost, where the windows show that they did."""
    for number, channel in enumerate(run.channels):
        if channel.quantity is Quantity.VOLTAGE:
            continue
        theirs = run.recorded[channel.name]
        channel_rows = {k: window.stretch.row(theirs) for k, window in enumerate(run.windows) if theirs in window.rows}
        share = repeated_share(*channel_rows.values())
        for k in channel_rows if share > 0.0 else ():
            # All levels together say it once.
            floor = THRESHOLDS.reading.repeats_std_share * share * math.sqrt(len(channel_rows))
            table.add(Part.REPEATS, share, 0.0, floor, run.place(k, run.levels[k].frequency_hz), number)
