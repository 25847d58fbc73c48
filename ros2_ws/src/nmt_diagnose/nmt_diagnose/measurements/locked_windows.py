"""Locked windows of a run at phase resonance."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest
from typing import ClassVar

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_core.vocabulary import MOTIONS
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.measurements.locked_prediction import PhaseResonancePredictor
from nmt_diagnose.measurements.measurement import (
    PURE_TONE,
    CurveAxis,
    HeldLevels,
    LevelSeries,
    LockedLevels,
    Observations,
    Terms,
)
from nmt_diagnose.observations.channels.bag_samples import SampleStretch
from nmt_diagnose.observations.channels.drive_hold import hold_factor, image_responses
from nmt_diagnose.observations.model_view import ModelView
from nmt_diagnose.observations.noise.settling import Settling, settling
from nmt_diagnose.observations.observables import FUNDAMENTAL, HARMONICS, Part, Rows, no_rows
from nmt_diagnose.observations.observation_settings import ObservationSettings
from nmt_diagnose.prediction.parts_cache import PartsCache
from nmt_diagnose.prediction.prediction_settings import PredictionSettings
from nmt_diagnose.prediction.resting_motion import (
    Motion,
    all_unknowns,
)
from nmt_extract.modal.evaluated_window import EvaluatedWindow
from nmt_record.windows.segments import Segment
from nmt_rig.rig import Rig
from nmt_signals.channel_faults.mains_lines import MAINS_HZ, Line, mains_line
from nmt_signals.harmonics import (
    resolvable_harmonics,
)
from nmt_signals.sine_fit import fit_frequency


class LockedWindows(LockedLevels):
    """Locked windows of one run."""

    WORDS: ClassVar[str] = "phase resonance, locked levels"
    unexcited: ClassVar[tuple[Part, ...]] = (Part.STEP, Part.LIMIT, Part.REPEATS, Part.LINE)
    series: ClassVar[LevelSeries] = LevelSeries(ranked=True, interleaved=True, rising=True)

    def predictor(self, rows: Rows, settings: PredictionSettings) -> PhaseResonancePredictor:
        """What predicts its rows."""
        return PhaseResonancePredictor(self, rows, settings)

    @property
    def over_voltage(self) -> bool:
        """Whether its rows refer to the voltage."""
        return self.held == "voltage"

    @property
    def span_s(self) -> tuple[float, float] | None:
        """Start of the first and end of the last window, s."""
        if not self.levels:
            return None
        return self.levels[0].start_s, max(level.stop_s for level in self.levels)

    def motions(
        self, rig: Rig, channels: tuple[MeasuredChannel, ...], settings: PredictionSettings, frequency_hz: float
    ) -> list[Motion]:
        """Phase-resonant motions at the highest and lowest level that the model has a solution for."""
        names = {channel.name for channel in channels}
        wider = replace(self, channels=(*channels, *(c for c in self.channels if c.name not in names)))
        predictor, cache = wider.predictor(no_rows(), settings), PartsCache(settings)
        solved = [
            (level, state)
            for level, state in zip(predictor.levels, predictor.solve(rig, cache, None), strict=True)
            if state is not None
        ]
        solved.sort(key=lambda pair: pair[1].drive)
        found: list[Motion] = []
        for level, state in {id(s): (lv, s) for lv, s in (solved[:1] + solved[-1:])}.values():
            parts = predictor.parts(rig, cache, level)
            unknowns = all_unknowns(parts, state.omega, state.channels[: len(channels), 1], channels)
            found.append((parts, state.omega, state.drive, state.channels[: len(channels), 1], unknowns))
        return found

    def measured_sizes(self, observations: Observations, number: int, drive: float) -> dict[str, float]:
        """Amplitude of each motion channel at the level next to a drive."""
        rows, sizes = observations.rows, dict[str, float]()
        for index, channel in enumerate(self.channels):
            selected = (rows.test == number) & (rows.channel == index)
            selected = np.flatnonzero(selected & (rows.part == Part.LOG_MAGNITUDE) & (rows.harmonic == 1))
            if channel.quantity in MOTIONS and selected.size:
                nearest = selected[np.argmin(np.abs(rows.amplitude[selected] - drive))]
                sizes[channel.name] = math.exp(float(observations.values[nearest]))
        return sizes

    def repeat_key(self, rows: Rows, index: int) -> tuple[object, float]:
        """Level, of a line of the mains its frequency too, and the level of excitation."""
        level, amplitude = int(rows.level[index]), float(f"{rows.amplitude[index]:.3g}")
        line = rows.part[index] == Part.LINE
        return ((level, round(float(rows.frequency_hz[index]), 6)) if line else level), amplitude

    def held_levels(self, observations: Observations, number: int) -> HeldLevels | None:
        """Its levels as complex amplitudes of force and motion."""
        return levels_of_windows(self, observations, number)

    @property
    def axis(self) -> CurveAxis:
        """Voltage or force."""
        label = "drive voltage / V" if self.held == "voltage" else "force / N"
        figures = (
            ("frequency", "Frequency and phase error over the {over}", (Part.LOG_FREQUENCY, Part.PHASE_ERROR)),
            ("amplitude", "Amplitudes over the {over}", (Part.LOG_MAGNITUDE,)),
            ("phase", "Phases to the drive over the {over}", (Part.PHASE,)),
            ("line", "Lines that follow no excitation (mains hum)", (Part.LINE,)),
        )
        return CurveAxis(label, label, figures=figures)


# -- levels ----------------------------------------------------------------------------------------------------------


def levels_of_windows(test: LockedWindows, observations: Observations, number: int) -> HeldLevels | None:
    """Locked windows as levels; None where an exciter has no force, no channel a motion, or a response was held.

    Args:
        test: the windows.
        observations: the real side.
        number: of the test.
    """
    if test.held == "response":
        return None
    rows, here = observations.rows, observations.rows.test == number
    sensors = {c.point: k for k, c in reversed(list(enumerate(test.channels))) if c.quantity is Quantity.FORCE}
    forces = [sensors[point] for point in test.drive_points if point in sensors]
    moved = [k for k, channel in enumerate(test.channels) if channel.quantity in MOTIONS]
    single = test.held == "force" and len(test.drive_points) == 1
    if not moved or (len(forces) < len(test.drive_points) and not single):
        return None
    values, std = complex_amplitudes(observations, rows, here, len(test.levels), len(test.channels), test.harmonics)
    omega = np.full(len(test.levels), np.nan)
    frequency = here & (rows.part == Part.LOG_FREQUENCY)
    omega[rows.level[frequency]] = np.exp(observations.values[frequency])
    force = np.zeros((len(test.drive_points), len(test.levels), test.harmonics + 1), complex)
    force_std = np.zeros(force.shape[:2])
    if single:
        for k, level in enumerate(test.levels):
            terms = np.array(level.terms[0][: test.harmonics])
            force[0, k, 1 : 1 + terms.size] = level.force_n * terms
    else:
        force = np.nan_to_num(np.moveaxis(values[:, forces], 1, 0))
        force_std = np.nan_to_num(np.moveaxis(std[:, forces, 1], 1, 0))
    orders = np.maximum(np.arange(test.harmonics + 1), 1)
    powers = np.array([MOTIONS[test.channels[k].quantity] for k in moved])
    scale = (1j * omega[:, None, None] * orders) ** powers[None, :, None]
    with np.errstate(invalid="ignore"):  # levels that are held out have no frequency
        motion, motion_std = values[:, moved] / scale, std[:, moved] / np.abs(scale)
    size = np.nanmax(np.abs(motion[:, :, 1]), axis=1, initial=0.0)
    usable = np.isfinite(omega) & (np.abs(force[:, :, 1]).max(axis=0) > 0.0) & (size > 0.0)
    order = [int(k) for k in np.argsort(size, kind="stable") if usable[k]]
    chain = observations.chains[number] if observations.chains else None
    channels = tuple(test.channels[k] for k in moved)
    found = HeldLevels(
        test.name, test.drive_points, tuple(level.index for level in test.levels), omega, force, force_std, channels,
        motion, motion_std, chain, recorded=test.channels,
    )  # fmt: skip
    return found.take(order) if order else None


def complex_amplitudes(
    observations: Observations, rows: Rows, here: np.ndarray, levels: int, channels: int, harmonics: int
) -> tuple[ComplexArray, FloatArray]:
    """Complex amplitudes (levels, channels, harmonics + 1) in the units of the channels, and their uncertainties."""
    parts = {part: np.full((levels, channels, harmonics + 1), np.nan) for part in (0, 1)}
    spread = {part: np.full((levels, channels, harmonics + 1), np.nan) for part in (0, 1)}
    for kind in (*FUNDAMENTAL, *HARMONICS):
        part = int(kind.facts.half == "im")
        where = np.flatnonzero(here & (rows.part == kind) & (rows.harmonic > 0))
        at = (rows.level[where], rows.channel[where], rows.harmonic[where])
        parts[part][at] = observations.values[where]
        spread[part][at] = observations.sigma[where]
    size = np.exp(parts[0][:, :, 1:2])
    values = size * (parts[0] + 1j * parts[1])
    values[:, :, 1] = size[:, :, 0] * np.exp(1j * parts[1][:, :, 1])
    values[:, :, 0] = 0.0
    return values, size * np.sqrt(0.5 * (spread[0] ** 2 + spread[1] ** 2))


# -- windows -----------------------------------------------------------------------------------------------------------


# The recorded drive replaces that of the oscillator where they differ by more than both of these.
_EXACT = 1e-6
SURE_DEVIATIONS = 4.0


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
        frequency_hz, frequency_std: mean excitation frequency and its standard uncertainty, Hz.
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
    frequency_std: float
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
        """Possible error of the ln of a channel's fundamental; 0 without such a channel."""
        return self.leans[self.row(name)] if name in self.rows else 0.0

    def fundamental(self, name: str) -> float:
        """|Y₁| of a channel in its unit; NaN without such a channel."""
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
        sine: whether a drive that was not recorded was a sine at one exciter.

    Raises:
        BenchError: why the window cannot be used, one sentence.
    """
    where = f"Level {segment.level_index}"
    forces = _forces(where, stretch, view)
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
    harmonics = resolvable_harmonics(settings.harmonics, used / periods)
    if harmonics < 1:
        raise BenchError(f"{where}: {used / periods:.3g} samples a period resolve no harmonic; the window is left out.")
    # Higher orders than those observed are fitted too, so that they do not leak into the observed ones.
    fitted = resolvable_harmonics(2 * settings.harmonics + 1, used / periods)
    advance = float(cycles[-1] - cycles[0]) + step

    def evaluated(samples: FloatArray) -> EvaluatedWindow:
        return EvaluatedWindow.of(cycles, advance, samples, stretch.sample_rate, fitted, settings.sub_windows)

    found = evaluated(data)
    transient = Settling(np.zeros(len(usable)))
    # Where the loop moves voltages the responses follow them, and the means belong together.
    moved = known and (len(forces) > 1 or not names_voltage)
    if not settled and moved:
        # What moves would leak into the harmonics and the lines of the mains.
        data = _without_drift(data, cycles, found.parts[..., 1])
        before, found = found, evaluated(data)
        found.sets[..., 1], found.parts[..., 1] = before.sets[..., 1], before.parts[..., 1]
    elif not settled:
        transient = _settling(found.parts[..., 1], usable)
        if transient.sizes.any():
            # It would leak into the harmonics, too.
            amplitudes = found.sets[0, :, 1] * np.exp(-transient.leans)
            data = data - (np.outer(amplitudes, np.exp(2j * np.pi * cycles)) * transient.excess(used)).real
            found = evaluated(data)
    over_window, without, single = found.sets[0], found.sets[1:], found.parts
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
            scatter = float(np.std(np.angle(single[:, reference, 1]))) / math.sqrt(found.count)
            if abs(np.angle(over_window[reference, 1])) < max(_EXACT, SURE_DEVIATIONS * scatter):
                reference = None
    else:
        reference = None if known else rows.index(forces[0])
    turned = reference is not None and bool(voltages)
    if reference is not None:
        over_window, without, single = (_turned(part, reference) for part in (over_window, without, single))
    # An oscillator made a sine unless something else stands out.
    certain = 1 if known else harmonics
    terms = drive_terms(over_window, single, voltages, certain) if voltages else PURE_TONE
    frequency = float(cycles[-1] - cycles[0]) / (used - 1) * stretch.sample_rate
    spread = found.frequency_std(None if known else found.parts[:, rows.index(forces[0]), 1])
    lines = {hz: mains_line(cycles, data, stretch.sample_rate, fitted, hz) for hz in MAINS_HZ}
    mains = {hz: line for hz, line in lines.items() if line is not None}
    return LockedWindow(
        segment, stretch, rows, over_window, without, single, frequency, spread, drive, terms, forces,
        tuple(voltages) if moved else (), referenced, mains,
        commanded, recorded, turned, tuple((transient.doubt * transient.leans).tolist()),
    )  # fmt: skip


def _forces(where: str, stretch: SampleStretch, view: ModelView) -> tuple[str, ...]:
    """Channel of each exciter's force; that of one exciter is the first force there is.

    Raises:
        BenchError: one is missing or cannot be used.
    """
    points = view.rig.exciter_points
    found = [stretch.find(Quantity.FORCE, point if len(points) > 1 else None) for point in points]
    names = tuple(channel.name for channel in found if channel is not None)
    if len(names) < len(points):
        raise BenchError(f"{where}: there is no force channel; the window is left out.")
    faults = [stretch.faults[name] for name in names if name in stretch.faults]
    if faults:
        raise BenchError(f"{where}: the force cannot be used ({faults[0]}); the window is left out.")
    return names


def drive_terms(over_window: ComplexArray, single: ComplexArray, rows: Sequence[int], certain: int) -> Terms:
    """Recorded orders 1, 2, … of each exciter's drive over the fundamental of the first.

    Args:
        over_window: harmonics (channels, H + 1).
        single: those of each sub-window, (K, channels, H + 1).
        rows: of the drives.
        certain: orders up to this one are taken as recorded; higher ones where they stand out of their scatter.
    """
    terms = over_window[rows, 1:] / over_window[rows[0], 1]
    shares = single[:, rows, 1:] / single[:, rows[:1], 1:2]
    scatter = np.sqrt(np.var(shares.real, axis=0) + np.var(shares.imag, axis=0)) / math.sqrt(single.shape[0])
    stands_out = np.abs(terms) > np.maximum(_EXACT, SURE_DEVIATIONS * scatter)
    terms = np.where(stands_out | (np.arange(1, over_window.shape[1]) <= certain), terms, 0.0)
    terms[0, 0] = 1.0
    return tuple(tuple(complex(term) for term in np.trim_zeros(row, "b")) or (0j,) for row in terms)


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
        if channel.quantity in (Quantity.FORCE, *MOTIONS) and np.all(fundamentals[:, k] != 0.0)
    ]  # fmt: skip
    responses = np.array([channels[k].quantity in MOTIONS for k in kept], dtype=bool)
    found = settling(np.log(np.abs(fundamentals[:, kept])), responses)
    result[kept] = found.sizes
    return Settling(result, found.rate, found.doubt)


def _cycles(segment: Segment, stretch: SampleStretch, force: str) -> FloatArray:
    """Phase of the excitation at each sample, cycles; from a fit to the force where it was not recorded."""
    if stretch.cycles is not None:
        return stretch.cycles
    guess = segment.frequency_hz if segment.frequency_hz > 0.0 else math.nan
    frequency = fit_frequency(stretch.row(force), stretch.sample_rate, guess)
    return np.asarray(frequency * np.arange(stretch.samples) / stretch.sample_rate, dtype=np.float64)


def without_hold(
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


def force_framed(window: LockedWindow, harmonics: int) -> LockedWindow:
    """Phases referred to the force, which is what drives."""
    rows = [window.row(name) for name in window.forces]
    amplitudes, without, single = (
        _turned(part, rows[0]) for part in (window.amplitudes, window.without, window.single)
    )
    # Shaker and structure act on each other: what drives the structure is the force as it was, not a pure tone.
    terms = drive_terms(amplitudes, single, rows, harmonics)
    return replace(window, amplitudes=amplitudes, without=without, single=single, terms=terms)


def _turned(amplitudes: ComplexArray, reference: int) -> ComplexArray:
    """Phases referred to the fundamental of one channel."""
    angle = np.angle(amplitudes[..., reference, 1])[..., np.newaxis, np.newaxis]
    orders = np.arange(amplitudes.shape[-1])
    result: ComplexArray = amplitudes * np.exp(-1j * angle * orders)
    return result


def driven_as_recorded(windows: list[LockedWindow]) -> list[LockedWindow]:
    """Windows of one test with the recorded voltage as their drive, where phases refer to it.

    Converters hold the drive and filter the recording of all channels alike. Relative to the recorded voltage, forces
    and responses are the same as in a random test. Relative to the commanded one they lag by half a sample.
    """
    if not any(window.turned for window in windows):
        return windows
    return [
        replace(window, drive=window.recorded, commanded=False) if math.isfinite(window.recorded) else window
        for window in windows
    ]
