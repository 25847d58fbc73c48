"""Harmonics of a locked window and of its parts, in the frame of its drive or of its force."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_core.vocabulary import MOTIONS
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.measurements.held_levels import PURE_TONE, Terms
from nmt_diagnose.observations.channels.bag_samples import SampleStretch
from nmt_diagnose.observations.channels.drive_hold import hold_factor, image_responses
from nmt_diagnose.observations.model_view import ModelView
from nmt_diagnose.observations.noise.settling import Settling, settling
from nmt_diagnose.observations.observation_settings import ObservationSettings
from nmt_extract.modal.evaluated_window import EvaluatedWindow
from nmt_record.windows.segments import Segment
from nmt_signals.channel_faults.mains_lines import MAINS_HZ, Line, mains_line
from nmt_signals.harmonics import (
    resolvable_harmonics,
)
from nmt_signals.sine_fit import fit_frequency

# What is recorded of a drive takes the place of what its oscillator made where it differs by more than both.
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
    """Phase of the excitation at each sample, cycles; from a fit to the force where nobody recorded it."""
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

    Converters that hold the drive and filter what they record do so to all channels alike: beside the recorded voltage
    forces and responses are what they are in a random test. Beside the commanded one they are half a sample late.
    """
    if not any(window.turned for window in windows):
        return windows
    return [
        replace(window, drive=window.recorded, commanded=False) if math.isfinite(window.recorded) else window
        for window in windows
    ]
