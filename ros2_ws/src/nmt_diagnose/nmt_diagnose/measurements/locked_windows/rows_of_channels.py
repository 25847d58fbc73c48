"""Rows of locked windows that follow no excitation: what may be wrong with a channel or its recorder."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from nmt_core.messages.blocks import Quantity
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.measurements.locked_windows.locked_level import LockedLevel
from nmt_diagnose.measurements.locked_windows.locked_window import SURE_DEVIATIONS, LockedWindow
from nmt_diagnose.observations.model_view import ModelView
from nmt_diagnose.observations.noise.floors import Floors
from nmt_diagnose.observations.observables import Part, Place, RowTable
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_signals.channel_faults.clipping import clipping_level
from nmt_signals.channel_faults.converter_faults import converter_step, repeated_share
from nmt_signals.channel_faults.mains_lines import MAINS_HZ

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
                # What the steps of a loop put into a voltage is no hum.
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
        # A step that is as the model has it tells nothing.
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
