"""Locked windows of a run at phase resonance."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import FloatArray
from nmt_core.vocabulary import MOTIONS, TestKind
from nmt_diagnose.law.held_levels import HeldLevels
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.measurements.locked_windows.influence import influence_on_levels
from nmt_diagnose.measurements.locked_windows.levels import levels_of_windows
from nmt_diagnose.measurements.locked_windows.locked_level import LockedLevel
from nmt_diagnose.measurements.locked_windows.predictor import PhaseResonancePredictor
from nmt_diagnose.measurements.measurement import Measurement
from nmt_diagnose.observations.observables import Observations, Part, Rows, no_rows
from nmt_diagnose.prediction.influence import Source, SourceColumn
from nmt_diagnose.prediction.parts_cache import PartsCache
from nmt_diagnose.prediction.prediction_settings import PredictionSettings
from nmt_diagnose.prediction.resting_motion import (
    Motion,
    all_unknowns,
)
from nmt_rig.rig import Rig

if TYPE_CHECKING:
    from nmt_diagnose.observations.bag_windows import BagWindows


@dataclass(frozen=True)
class LockedWindows(Measurement):
    """Locked windows of one run.

    Attributes:
        name: unique name of the test.
        drive_points: measurement point of each exciter; phase and amplitude of all refer to the first.
        response_channel: channel whose phase the loop controlled.
        channels: all recorded channels with harmonics.
        harmonics: highest order among the observables.
        held: ``voltage`` (drive known), or ``force`` (drive unknown, |F₁| taken as the given amplitude; the zero of all
            phases is then that of the measured F₁).
        levels: the windows, in time.
        commanded: the drive is the commanded voltage; else the recorded one.
    """

    WORDS: ClassVar[str] = "phase resonance, locked levels"
    FIGURES: ClassVar[tuple[tuple[str, str, tuple[Part, ...]], ...]] = (
        ("frequency", "Frequency and phase error over the {over}", (Part.LOG_FREQUENCY, Part.PHASE_ERROR)),
        ("amplitude", "Amplitudes over the {over}", (Part.LOG_MAGNITUDE,)),
        ("phase", "Phases to the drive over the {over}", (Part.PHASE,)),
        ("line", "Lines that follow no excitation (mains hum)", (Part.LINE,)),
    )
    unexcited: ClassVar[tuple[Part, ...]] = (Part.STEP, Part.LIMIT, Part.REPEATS, Part.LINE)
    ranked: ClassVar[bool] = True
    interleaved: ClassVar[bool] = True
    rising: ClassVar[bool] = True
    linear_chain: ClassVar[bool] = True

    name: str
    drive_points: tuple[int, ...]
    response_channel: str
    channels: tuple[MeasuredChannel, ...]
    harmonics: int
    held: str
    levels: tuple[LockedLevel, ...]
    commanded: bool = False

    @classmethod
    def read(cls, bag: BagWindows) -> list[Observations]:
        """Windows of phase resonance, and of stepped sines that are no frequency response, a test for each kind."""
        from nmt_diagnose.measurements.locked_windows.reading import phase_resonance_observations  # late: it makes them

        bag.drop_implausible()
        found = []
        for kind in (TestKind.PHASE_RESONANCE, TestKind.STEPPED_SINE):
            windows = bag.of_kind(kind)
            if windows and not bag.is_swept(kind):
                name = bag.named(kind)
                found.append(phase_resonance_observations(name, windows, bag))
                bag.note_few_levels(name, len(found[-1].tests[0].locked_levels) if found[-1].tests else 0)
        return found

    @property
    def drive_point(self) -> int:
        """Point at which the loop holds its phase."""
        return self.drive_points[0]

    def predictor(self, rows: Rows, settings: PredictionSettings) -> PhaseResonancePredictor:
        """What predicts its rows."""
        return PhaseResonancePredictor(self, rows, settings)

    @property
    def locked_levels(self) -> tuple[LockedLevel, ...]:
        """Levels at which a loop held the phase."""
        return self.levels

    @property
    def locked_harmonics(self) -> int:
        """Highest order among the observables."""
        return self.harmonics

    @property
    def over_voltage(self) -> bool:
        """Whether its rows refer to the voltage."""
        return self.held == "voltage"

    @property
    def timed_by_drive(self) -> bool:
        """Whether a delay that all sensors share shows in it."""
        return True

    @property
    def span_s(self) -> tuple[float, float] | None:
        """Start of the first and end of the last window, s."""
        if not self.levels:
            return None
        return self.levels[0].start_s, max(level.stop_s for level in self.levels)

    def influence(
        self,
        predictor: PhaseResonancePredictor,
        rig: Rig,
        cache: PartsCache,
        states: Sequence[Any],
        source: Source,
        settings: PredictionSettings,
    ) -> tuple[FloatArray, list[SourceColumn]]:
        """What unit sources at a place would do to its rows, (rows, sources), and what each is."""
        return influence_on_levels(predictor, rig, cache, states, source, settings)

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

    def with_levels(self, change: Callable[[LockedLevel], LockedLevel]) -> LockedWindows:
        """The measurement with every level changed."""
        return replace(self, levels=tuple(change(level) for level in self.levels))

    def turned_by(self, channel: str) -> int:
        """Sign by which an error of a channel's phase turns what the loop held."""
        force = next((c.name for c in self.channels if c.quantity is Quantity.FORCE), "")
        return (channel == self.response_channel) - (channel == force)

    def repeat_key(self, rows: Rows, index: int) -> tuple[object, float]:
        """Level, of a line of the mains its frequency too, and the level of excitation."""
        level, amplitude = int(rows.level[index]), float(f"{rows.amplitude[index]:.3g}")
        line = rows.part[index] == Part.LINE
        return ((level, round(float(rows.frequency_hz[index]), 6)) if line else level), amplitude

    def held_levels(self, observations: Observations, number: int) -> HeldLevels | None:
        """Its levels as complex amplitudes of force and motion."""
        return levels_of_windows(self, observations, number)

    @property
    def axis(self) -> str:
        """Voltage or force."""
        return "drive voltage / V" if self.held == "voltage" else "force / N"
