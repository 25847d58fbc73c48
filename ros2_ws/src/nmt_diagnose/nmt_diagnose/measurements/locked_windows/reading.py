"""Observables of locked windows: frequency, phase at lock, and complex harmonics of every channel."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_core.vocabulary import MOTIONS, VELOCITY_LEAD, TestKind
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.measurements.locked_windows.locked_level import LockedLevel
from nmt_diagnose.measurements.locked_windows.locked_window import (
    LockedWindow,
    analyse_window,
    driven_as_recorded,
    force_framed,
    without_hold,
)
from nmt_diagnose.measurements.locked_windows.locked_windows import LockedWindows
from nmt_diagnose.measurements.locked_windows.rows_of_channels import Cell, UsedWindows, add_rows_of_channels
from nmt_diagnose.observations.bag_windows import BagWindows, Window
from nmt_diagnose.observations.channels.bag_samples import SampleStretch
from nmt_diagnose.observations.model_view import ModelView
from nmt_diagnose.observations.noise.scatter import moderated
from nmt_diagnose.observations.observables import Observations, Part, RowTable, empty
from nmt_diagnose.observations.observation_settings import ObservationSettings
from nmt_diagnose.thresholds import THRESHOLDS

_RESPONSES = (Quantity.DISPLACEMENT, Quantity.ACCELERATION, Quantity.VELOCITY)


def wrapped(angle: FloatArray) -> FloatArray:
    """Angles in [−π, π)."""
    result: FloatArray = (np.asarray(angle) + math.pi) % (2.0 * math.pi) - math.pi
    return result


def _jackknife(without: FloatArray) -> FloatArray:
    """Variance from delete-one values along the first axis."""
    count = without.shape[0]
    deviations = without - without.mean(axis=0)
    result: FloatArray = (count - 1) / count * (deviations * deviations).sum(axis=0)
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
    what the loop was told to hold has no drift.
    """
    count = single.shape[0]
    drift = float(_drift(single))
    time = (np.arange(count) + 0.5) / count - 0.5
    residual = single - single.mean() - drift * time
    scatter = float(residual @ residual) / max(1, count - 2) / float(time @ time)
    return THRESHOLDS.noise.lean_ratio * math.sqrt(max(0.0, drift * drift - scatter))


def phase_resonance_observations(name: str, windows: Sequence[Window], bag: BagWindows) -> Observations:
    """Observables of locked windows of one bag.

    Stepped-sine windows near resonance count as locked windows whose phase nobody controlled: they have no row for the
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
    name: str, windows: Sequence[Window], bag: BagWindows, notes: list[str]
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
        std = slopes[index] * level.phase_error_std
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
    variance = float(_jackknife(without))
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
        variance, drift = float(_jackknife(varied)) * size**2, float(_drift(parts)) * size
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
