"""Locked windows of a run at phase resonance."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import ClassVar

import numpy as np

from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_core.vocabulary import MOTIONS
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.measurements.held_levels import HeldLevels
from nmt_diagnose.measurements.locked_prediction import PhaseResonancePredictor
from nmt_diagnose.measurements.measurement import CurveAxis, LevelSeries, LockedLevels, Observations
from nmt_diagnose.observations.observables import FUNDAMENTAL, HARMONICS, Part, Rows, no_rows
from nmt_diagnose.prediction.parts_cache import PartsCache
from nmt_diagnose.prediction.prediction_settings import PredictionSettings
from nmt_diagnose.prediction.resting_motion import (
    Motion,
    all_unknowns,
)
from nmt_rig.rig import Rig


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
