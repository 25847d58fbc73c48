"""Observables of locked windows: frequency, phase at lock, and complex harmonics of every channel."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_core.vocabulary import MOTIONS, VELOCITY_LEAD, TestKind
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.measurements.locked_windows.locked_level import PURE_TONE, LockedLevel, Terms
from nmt_diagnose.measurements.locked_windows.locked_windows import LockedWindows
from nmt_diagnose.observations.channels.bag_samples import SampleStretch
from nmt_diagnose.observations.channels.drive_hold import hold_factor, image_responses
from nmt_diagnose.observations.model_view import ModelView
from nmt_diagnose.observations.noise.floors import Floors
from nmt_diagnose.observations.noise.scatter import moderated
from nmt_diagnose.observations.noise.settling import Settling, settling
from nmt_diagnose.observations.observables import Observations, Part, Place, RowTable, empty
from nmt_diagnose.observations.observation_settings import ObservationSettings
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_extract.judgement.uncertainty import sub_window_count
from nmt_record.windows.segments import Segment
from nmt_signals.channel_faults.clipping import clipping_level
from nmt_signals.channel_faults.converter_faults import converter_step, repeated_share
from nmt_signals.channel_faults.mains_lines import MAINS_HZ, Line, mains_line
from nmt_signals.harmonics import (
    Moments,
    resolvable_harmonics,
    segment_moments,
    solve_moments,
    whole_period_bounds,
)
from nmt_signals.sine_fit import fit_frequency

_RESPONSES = (Quantity.DISPLACEMENT, Quantity.ACCELERATION, Quantity.VELOCITY)
# The line of the mains that is observed in any case; the other one only where it stands out by so many deviations.
_COMMON_MAINS = MAINS_HZ[0]
# What is recorded of a drive takes the place of what its oscillator made where it differs by more than both.
_EXACT = 1e-6
_SURE_DEVIATIONS = 4.0


def wrapped(angle: FloatArray) -> FloatArray:
    """Angles in [−π, π)."""
    result: FloatArray = (np.asarray(angle) + math.pi) % (2.0 * math.pi) - math.pi
    return result


@dataclass(frozen=True, eq=False)
class LockedWindow:
    """Harmonics of one window.

    Attributes:
        segment: what named the window.
        stretch: its samples.
        rows: name in the bag of each channel.
        amplitudes: harmonics over the whole window, shape (channels, H + 1), in the frame of the drive; H is above what
            is observed, as far as harmonics of the drive are known.
        without: the same without one sub-window, shape (K, channels, H + 1).
        single: the same of each sub-window, shape (K, channels, H + 1).
        frequency_hz: mean excitation frequency, Hz.
        drive: drive voltage of the first exciter, V peak; NaN where it is not known.
        terms: orders 1, 2, … of the drive of each exciter over that.
        forces: channel of each exciter's force.
        moved: of each exciter whose voltage a loop moved, the row of that voltage.
        referenced: whether phases refer to the drive; else to the force.
        mains: lines of the mains by frequency, Hz, their channels as in ``rows``; those that the window can tell.
        commanded: whether ``drive`` is what was commanded; else it is the recorded voltage.
        recorded: amplitude of the recorded voltage, V; NaN without one.
        turned: whether phases refer to the recorded voltage.
        leans: what the ln of each fundamental was off by before a transient was taken out, in the mean.
    """

    segment: Segment
    stretch: SampleStretch
    rows: tuple[str, ...]
    amplitudes: ComplexArray
    without: ComplexArray
    single: ComplexArray
    frequency_hz: float
    drive: float
    terms: Terms
    forces: tuple[str, ...]
    moved: tuple[int, ...]
    referenced: bool
    mains: Mapping[float, Line]
    commanded: bool
    recorded: float
    turned: bool
    leans: tuple[float, ...]

    def row(self, name: str) -> int:
        """Index of a channel."""
        return self.rows.index(name)

    def lean(self, name: str) -> float:
        """What the ln of a channel's fundamental may still be off by; 0 where there is no such channel."""
        return self.leans[self.row(name)] if name in self.rows else 0.0

    def fundamental(self, name: str) -> float:
        """|Y₁| of a channel in its unit; NaN where there is no such channel."""
        return float(abs(self.amplitudes[self.row(name), 1])) if name in self.rows else math.nan


def analyse_window(
    segment: Segment,
    stretch: SampleStretch,
    settings: ObservationSettings,
    view: ModelView,
    settled: bool = True,
    sine: bool = True,
) -> LockedWindow:
    """Harmonics of a locked window with those of its sub-windows.

    Args:
        segment: what names the window.
        stretch: its samples.
        settings: of the reading.
        view: the model, driven at the test's drive points.
        settled: whether amplitudes are taken as they are; else a transient of theirs is taken out.
        sine: whether a drive that nobody recorded was a sine at one exciter.

    Raises:
        BenchError: why the window cannot be used, one sentence.
    """
    where = f"Level {segment.level_index}"
    forces = _forces(stretch, view)
    if not forces:
        raise BenchError(f"{where}: there is no force channel; the window is left out.")
    faults = [stretch.faults[name] for name in forces if name in stretch.faults]
    if faults:
        raise BenchError(f"{where}: the force cannot be used ({faults[0]}); the window is left out.")
    usable = [c for c in stretch.channels if c.name not in stretch.faults]
    data = np.stack([stretch.row(channel.name) for channel in usable])
    known, names_voltage = stretch.cycles is not None, segment.level_unit == "V"
    cycles = _cycles(segment, stretch, forces[0])
    # The window ends where its whole periods end.
    step = float(cycles[-1] - cycles[0]) / (cycles.size - 1)
    periods = math.floor(cycles[-1] + step - cycles[0] + 0.02)
    if periods < settings.fewest_periods:
        raise BenchError(
            f"{where}: the window holds {periods} whole periods; at least {settings.fewest_periods} are needed to tell "
            "signal from noise, so it is left out."
        )
    used = int(np.searchsorted(cycles, cycles[0] + periods - 1e-9))
    cycles, data = cycles[:used], data[:, :used]
    count = sub_window_count(periods, settings.sub_windows)
    harmonics = resolvable_harmonics(settings.harmonics, used / periods)
    if harmonics < 1:
        raise BenchError(f"{where}: {used / periods:.3g} samples a period resolve no harmonic; the window is left out.")
    # Higher orders than those observed are fitted too, so that they do not leak into the observed ones.
    fitted = resolvable_harmonics(2 * settings.harmonics + 1, used / periods)
    bounds = whole_period_bounds(cycles, periods, count)
    moments = segment_moments(cycles, data, fitted, bounds)
    transient = Settling(np.zeros(len(usable)))
    # Where the loop moves voltages the responses follow them, and the means belong together.
    moved = known and (len(forces) > 1 or not names_voltage)
    parts = _parts(moments)
    if not settled and moved:
        # What moves would leak into the harmonics and the lines of the mains.
        data = _without_drift(data, cycles, parts[2][..., 1])
        cleared = _parts(segment_moments(cycles, data, fitted, bounds))
        for part, before in zip(cleared, parts, strict=True):
            part[..., 1] = before[..., 1]
        parts = cleared
    elif not settled:
        transient = _settling(parts[2][..., 1], usable)
        if transient.sizes.any():
            # It would leak into the harmonics, too.
            amplitudes = parts[0][:, 1] * np.exp(-transient.leans)
            data = data - (np.outer(amplitudes, np.exp(2j * np.pi * cycles)) * transient.excess(used)).real
            parts = _parts(segment_moments(cycles, data, fitted, bounds))
    over_window, without, single = parts
    rows = tuple(channel.name for channel in usable)
    voltages = [rows.index(name) for name in view.voltages(usable) if name in rows]
    # Voltage channels that hold nothing are no reference, and no drive if one of several exciters has none.
    if len(voltages) < len(view.rig.all_exciters) or not abs(over_window[voltages[0], 1]) > 0.0:
        voltages = []
    referenced = known
    recorded = float(abs(over_window[voltages[0], 1])) if voltages else math.nan
    commanded = names_voltage and known and (sine or bool(voltages))
    drive = segment.level if commanded else recorded
    if voltages:
        reference: int | None = voltages[0]
        referenced = True
        if known:
            # The oscillator's own phase is exact: the voltage takes its place only where it says something else.
            scatter = float(np.std(np.angle(single[:, reference, 1]))) / math.sqrt(count)
            if abs(np.angle(over_window[reference, 1])) < max(_EXACT, _SURE_DEVIATIONS * scatter):
                reference = None
    else:
        reference = None if known else rows.index(forces[0])
    turned = reference is not None and bool(voltages)
    if reference is not None:
        over_window, without, single = (_turned(part, reference) for part in (over_window, without, single))
    # An oscillator made a sine unless something else stands out.
    certain = 1 if known else harmonics
    terms = _terms(over_window, single, voltages, certain) if voltages else PURE_TONE
    frequency = float(cycles[-1] - cycles[0]) / (used - 1) * stretch.sample_rate
    lines = {hz: mains_line(cycles, data, stretch.sample_rate, fitted, hz) for hz in MAINS_HZ}
    mains = {hz: line for hz, line in lines.items() if line is not None}
    return LockedWindow(
        segment, stretch, rows, over_window, without, single, frequency, drive, terms, forces,
        tuple(voltages) if moved else (), referenced, mains,
        commanded, recorded, turned, tuple((transient.doubt * transient.leans).tolist()),
    )  # fmt: skip


def _forces(stretch: SampleStretch, view: ModelView) -> tuple[str, ...]:
    """Channel of each exciter's force; none where one is missing. That of one exciter is the first force there is."""
    points = view.rig.exciter_points
    found = [stretch.find(Quantity.FORCE, point if len(points) > 1 else None) for point in points]
    return tuple(channel.name for channel in found if channel is not None) if None not in found else ()


def _terms(over_window: ComplexArray, single: ComplexArray, rows: Sequence[int], certain: int) -> Terms:
    """Orders 1, 2, … of what was recorded of each exciter's drive over the fundamental of the first.

    Args:
        over_window: harmonics (channels, H + 1).
        single: those of each sub-window, (K, channels, H + 1).
        rows: of the drives.
        certain: orders up to this one are taken as recorded; higher ones where they stand out of their scatter.
    """
    terms = over_window[rows, 1:] / over_window[rows[0], 1]
    shares = single[:, rows, 1:] / single[:, rows[:1], 1:2]
    scatter = np.sqrt(np.var(shares.real, axis=0) + np.var(shares.imag, axis=0)) / math.sqrt(single.shape[0])
    stands_out = np.abs(terms) > np.maximum(_EXACT, _SURE_DEVIATIONS * scatter)
    terms = np.where(stands_out | (np.arange(1, over_window.shape[1]) <= certain), terms, 0.0)
    terms[0, 0] = 1.0
    return tuple(tuple(complex(term) for term in np.trim_zeros(row, "b")) or (0j,) for row in terms)


def _parts(moments: Moments) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """Harmonics over the whole window, without each sub-window, and of each sub-window."""
    return solve_moments(moments.total())[0], solve_moments(moments.leave_one_out()), solve_moments(moments)


def _without_drift(data: FloatArray, cycles: FloatArray, fundamentals: ComplexArray) -> FloatArray:
    """Samples (channels, n) with fundamentals that stay at their means; those of sub-windows are (K, channels)."""

    def powers(count: int) -> FloatArray:
        found = np.vander((np.arange(count) + 0.5) / count - 0.5, 4)[:, :-1]
        return np.asarray(found - found.mean(axis=0))

    slopes = np.linalg.lstsq(powers(len(fundamentals)), fundamentals - fundamentals.mean(axis=0), rcond=None)[0]
    moves = (powers(data.shape[1]) @ slopes).T * np.exp(2j * np.pi * cycles)
    return np.asarray(data - moves.real)


def _settling(fundamentals: ComplexArray, channels: Sequence[MeasuredChannel]) -> Settling:
    """The transient of a window's fundamentals, (K, channels), in the responses and in the force."""
    result = np.zeros(len(channels))
    kept = [
        k for k, channel in enumerate(channels)
        if channel.quantity in (Quantity.FORCE, *_RESPONSES) and np.all(fundamentals[:, k] != 0.0)
    ]  # fmt: skip
    responses = np.array([channels[k].quantity in _RESPONSES for k in kept], dtype=bool)
    found = settling(np.log(np.abs(fundamentals[:, kept])), responses)
    result[kept] = found.sizes
    return Settling(result, found.rate, found.doubt)


def _cycles(segment: Segment, stretch: SampleStretch, force: str) -> FloatArray:
    """Phase of the excitation at each sample, cycles; from a fit to the force where nobody recorded it."""
    if stretch.cycles is not None:
        return stretch.cycles
    guess = segment.frequency_hz if segment.frequency_hz > 0.0 else math.nan
    frequency = fit_frequency(stretch.row(force), stretch.sample_rate, guess)
    return np.asarray(frequency * np.arange(stretch.samples) / stretch.sample_rate, dtype=np.float64)


def _without_hold(
    window: LockedWindow, view: ModelView, channels: dict[str, MeasuredChannel], rate_hz: float
) -> LockedWindow:
    """The window with the drive that the linear interpolation makes of its samples, and without its images."""
    if math.isinf(rate_hz) or not math.isfinite(window.drive) or not window.referenced:
        return window
    model_channels = [channels[name] for name in window.rows if name in channels]
    where = [row for row, name in enumerate(window.rows) if name in channels]
    parts = [part.copy() for part in (window.amplitudes, window.without, window.single)]
    terms = np.array(list(zip_longest(*window.terms, fillvalue=0j)))
    orders = np.arange(1, len(terms) + 1, dtype=np.float64)
    factors = hold_factor(window.frequency_hz * orders, rate_hz)
    for order, of_order in enumerate(terms, start=1):
        if np.any(of_order) and order < parts[0].shape[-1]:
            frequency = np.array([order * window.frequency_hz])
            images = np.zeros(len(window.rows), dtype=np.complex128)
            images[where] = window.drive * image_responses(view, model_channels, frequency, rate_hz, of_order)[:, 0]
            for part in parts:
                part[..., order] -= images
    held = tuple(
        tuple(term * float(factor) for term, factor in zip(each, factors / factors[0], strict=False))
        for each in window.terms
    )
    drive = window.drive * float(factors[0])
    return replace(window, amplitudes=parts[0], without=parts[1], single=parts[2], drive=drive, terms=held)


def _force_framed(window: LockedWindow, harmonics: int) -> LockedWindow:
    """Phases referred to the force, which is what drives."""
    rows = [window.row(name) for name in window.forces]
    amplitudes, without, single = (
        _turned(part, rows[0]) for part in (window.amplitudes, window.without, window.single)
    )
    # Shaker and structure act on each other: what drives the structure is the force as it was, not a pure tone.
    terms = _terms(amplitudes, single, rows, harmonics)
    return replace(window, amplitudes=amplitudes, without=without, single=single, terms=terms)


def _turned(amplitudes: ComplexArray, reference: int) -> ComplexArray:
    """Phases referred to the fundamental of one channel."""
    angle = np.angle(amplitudes[..., reference, 1])[..., np.newaxis, np.newaxis]
    orders = np.arange(amplitudes.shape[-1])
    result: ComplexArray = amplitudes * np.exp(-1j * angle * orders)
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


def _lean(single: FloatArray) -> float:
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


@dataclass
class _Cell:
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


def phase_resonance_observations(
    name: str,
    windows: Sequence[tuple[Segment, SampleStretch]],
    view: ModelView,
    channels: dict[str, MeasuredChannel],
    settings: ObservationSettings,
    response_quantity: Quantity | None = None,
    hold_rate_hz: float = math.inf,
    sine: bool = True,
) -> Observations:
    """Observables of the locked windows of one bag.

    Stepped-sine windows near resonance count as locked windows whose phase nobody controlled: they have no row for the
    phase, and are left out beyond 60° of phase.

    Args:
        name: name of the test.
        windows: the windows and their samples, in time.
        view: the model, driven at the test's drive points.
        channels: the model's channel for each recorded one.
        settings: settings.
        response_quantity: quantity whose phase the loop controlled; None = the first that there is at the drive point.
        hold_rate_hz: rate at which the drive is interpolated linearly, see drive_hold.py.
        sine: whether a drive that nobody recorded was a sine at one exciter; else the forces are what is known.
    """
    notes: list[str] = []
    analysed: list[LockedWindow] = []
    for segment, stretch in windows:
        try:
            analysed.append(analyse_window(segment, stretch, settings, view, settled=False, sine=sine))
        except BenchError as error:
            notes.append(f"{name}: {error}")
    analysed = [_without_hold(window, view, channels, hold_rate_hz) for window in _driven_as_recorded(analysed)]
    drive_point = view.rig.drive_point
    levels: list[LockedLevel] = []
    kept: list[LockedWindow] = []
    for window in analysed:
        outcome = _level(window, drive_point, response_quantity, len(analysed))
        if isinstance(outcome, str):
            notes.append(f"{name}: {outcome}")
            continue
        levels.append(outcome)
        kept.append(window)
    if not kept:
        return empty(notes)
    notes += _dropped_channels(name, kept, channels)
    held = "voltage" if all(math.isfinite(level.drive) for level in levels) else "force"
    if held == "force":
        kept = [_force_framed(window, settings.harmonics) for window in kept]
        levels = [replace(level, terms=window.terms) for level, window in zip(levels, kept, strict=True)]
    levels = _with_direction(levels, held)
    present = [c for c in channels.values() if c.quantity not in (Quantity.VOLTAGE, Quantity.CURRENT)]
    recorded = {model_channel.name: theirs for theirs, model_channel in channels.items()}
    response = _response(kept[0].stretch, drive_point, response_quantity)
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
    cells: list[_Cell] = []
    for index, window in enumerate(kept):
        for channel in present:
            theirs = recorded[channel.name]
            # A force that is held is an input.
            if theirs in window.rows and not (held == "force" and theirs in window.forces):
                cells += _cells(index, channel, window, window.row(theirs), settings.harmonics)
    _moderate(cells)
    index_of = {channel.name: number for number, channel in enumerate(present)}
    floors = settings.floors
    run = _Run(name, kept, levels, present, recorded, held)
    quantity_of = {channel.name: channel.quantity for channel in present}
    for index, (window, level) in enumerate(zip(kept, levels, strict=True)):
        place = run.place(index, level.frequency_hz)
        omega = 2.0 * math.pi * level.frequency_hz
        slope = _frequency_per_phase(window, view, response)
        table.add(
            Part.LOG_FREQUENCY, math.log(omega), slope * level.phase_error_std, floors.window(Part.LOG_FREQUENCY), place
        )
        if window.segment.kind is TestKind.PHASE_RESONANCE or window.segment.kind is TestKind.UNKNOWN:
            floor = floors.window(Part.PHASE_ERROR, levels=len(levels))
            floor = math.hypot(floor, level.phase_lean)
            table.add(Part.PHASE_ERROR, level.phase_error, level.phase_error_std, floor, place)
        for cell in cells:
            if cell.level == index:
                std = math.sqrt(cell.variance) / cell.scale
                floor = floors.window(cell.part, quantity_of[cell.name])
                table.add(cell.part, cell.value, std, floor, place, index_of[cell.name], cell.harmonic)
    notes += _mains(run, floors, table)
    notes += _steps(run, cells, view, table)
    _limits(run, view, table)
    _repeats(run, table)
    return table.observations(test, notes)


def _driven_as_recorded(windows: list[LockedWindow]) -> list[LockedWindow]:
    """Windows of one test with the recorded voltage as their drive, where phases refer to it.

    Converters that hold the drive and filter what they record do so to all channels alike: beside the recorded voltage
    forces and responses are what they are in a random test. Beside the commanded one they are half a sample late.
    """
    if not any(window.turned for window in windows):
        return windows
    return [
        replace(window, drive=window.recorded, commanded=False) if math.isfinite(window.recorded) else window
        for window in windows
    ]


@dataclass(frozen=True, eq=False)
class _Run:
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


def _mains(run: _Run, floors: Floors, table: RowTable) -> list[str]:
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
                    line.amplitudes[k] > _SURE_DEVIATIONS * line.std[k] for k in window.moved
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


def _steps(run: _Run, cells: Sequence[_Cell], view: ModelView, table: RowTable) -> list[str]:
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


def _limits(run: _Run, view: ModelView, table: RowTable) -> None:
    """Add the levels at which channels are clipped, where the model does not say so."""
    believed = {view.rig.sensor_channel(sensor): sensor.clip or sensor.range for sensor in view.rig.sensors}
    for number, channel in enumerate(run.channels):
        if channel.quantity is Quantity.VOLTAGE:
            continue
        theirs = run.recorded[channel.name]
        found = {
            k: level
            for k, window in enumerate(run.windows)
            if theirs in window.rows and (level := clipping_level(window.stretch.row(theirs))) > 0.0
        }
        expected = believed.get(channel.name)
        for k, level in found.items():
            if expected is None or not math.isclose(level, expected, rel_tol=THRESHOLDS.reading.same_limit_share):
                # All levels together say it once.
                floor = THRESHOLDS.reading.limit_std_share / level * math.sqrt(len(found))
                table.add(Part.LIMIT, 1.0 / level, 0.0, floor, run.place(k, run.levels[k].frequency_hz), number)


def _repeats(run: _Run, table: RowTable) -> None:
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


def _response(stretch: SampleStretch, drive_point: int, wanted: Quantity | None) -> MeasuredChannel | None:
    """Drive-point response that the phase is measured with."""
    order = ((wanted,) if wanted is not None else ()) + _RESPONSES
    for quantity in order:
        channel = stretch.find(quantity, drive_point)
        if channel is not None and channel.name not in stretch.faults:
            return channel
    return None


def _level(window: LockedWindow, drive_point: int, wanted: Quantity | None, levels: int) -> LockedLevel | str:
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
    lean = _lean(wrapped(error(window.single) - value))
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


def _cells(level: int, channel: MeasuredChannel, window: LockedWindow, row: int, harmonics: int) -> list[_Cell]:
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
        cells.append(_Cell(level, channel.name, harmonic, part, value, size, variance, drift, degrees_of_freedom))

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


def _moderate(cells: list[_Cell]) -> None:
    """Draw the variances of a channel together, harmonic by harmonic, and add what drifts."""
    groups: dict[tuple[str, object, int], list[_Cell]] = {}
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
