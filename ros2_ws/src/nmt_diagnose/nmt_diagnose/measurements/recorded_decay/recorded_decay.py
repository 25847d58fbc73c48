"""Free decays: frequency and damping over amplitude."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from nmt_core.numerics.arrays import BoolArray, FloatArray, IntArray
from nmt_core.vocabulary import TestKind
from nmt_diagnose.law.held_levels import HeldLevels, levels_over_amplitude
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.measurements.measurement import Driven
from nmt_diagnose.measurements.recorded_decay.predictor import RingDownPredictor
from nmt_diagnose.observations.observables import Observations, Part, Rows
from nmt_diagnose.prediction.prediction_settings import PredictionSettings
from nmt_diagnose.prediction.resting_motion import (
    Motion,
    motion_at_amplitudes,
)
from nmt_rig.rig import Rig

if TYPE_CHECKING:
    from nmt_diagnose.observations.bag_windows import BagWindows


@dataclass(frozen=True)
class RecordedDecay(Driven):
    """Free decay after switch-off or impact: frequency and decay rate of a response over its amplitude.

    Attributes:
        name: unique name.
        drive_point: measurement point of the exciter (it stays attached, at zero volts).
        channel: response channel that the amplitudes are of.
        amplitudes: fundamental amplitude in the channel's unit at which the observables stand, shape (k,), falling.
        frequency_hz: at the smallest amplitude, Hz; it tells the mode.
        others: further response channels; magnitude and phase of their fundamentals stand relative to the first one's.
        resting_points: measurement points of further exciters, at zero volts too.
    """

    WORDS: ClassVar[str] = "ring-down"
    free: ClassVar[bool] = True
    interleaved: ClassVar[bool] = True
    rising: ClassVar[bool] = True
    linear_chain: ClassVar[bool] = True
    unexcited: ClassVar[tuple[Part, ...]] = (Part.LIMIT,)

    name: str
    drive_point: int
    channel: MeasuredChannel
    amplitudes: FloatArray
    frequency_hz: float
    others: tuple[MeasuredChannel, ...] = ()
    resting_points: tuple[int, ...] = ()

    @classmethod
    def read(cls, bag: BagWindows) -> list[Observations]:
        """Windows of free decays, a test each."""
        from nmt_diagnose.measurements.recorded_decay.reading import ring_down_observations  # late: it makes them

        return [
            ring_down_observations(
                name, window.stretch, window.segment.frequency_hz, bag.view, bag.of_decays, bag.settings,
                bag.controlled_quantity,
            )
            for name, window in bag.each([TestKind.RING_DOWN])
        ]  # fmt: skip

    @property
    def channels(self) -> tuple[MeasuredChannel, ...]:
        """All channels, in the order of the observables."""
        return (self.channel, *self.others)

    def predictor(self, rows: Rows, settings: PredictionSettings) -> RingDownPredictor:
        """What predicts its rows."""
        return RingDownPredictor(self, rows, settings)

    @property
    def given_channel(self) -> MeasuredChannel | None:
        """Channel at whose amplitudes the model is solved."""
        return self.channel

    def motions(
        self, rig: Rig, channels: tuple[MeasuredChannel, ...], settings: PredictionSettings, frequency_hz: float
    ) -> list[Motion]:
        """Largest and smallest amplitude, by the system linearised at rest."""
        if not self.amplitudes.size:
            return []
        points, channel = self.drive_points, self.channel
        return motion_at_amplitudes(rig, points, channel, self.amplitudes, channels, settings, self.frequency_hz)

    def resonance_rows(self, rows: Rows) -> BoolArray:
        """Its frequencies."""
        return np.asarray(rows.part == Part.LOG_FREQUENCY)

    def repeat_key(self, rows: Rows, index: int) -> tuple[object, float]:
        """Number of the amplitude."""
        return int(rows.level[index]), 0.0

    def held_levels(self, observations: Observations, number: int) -> HeldLevels | None:
        """Its amplitudes as levels."""
        return levels_over_amplitude(self.drive_points, self.channels, self.amplitudes, observations, number)

    def abscissa(self, rows: Rows, which: IntArray) -> FloatArray:
        """Amplitude of the first channel."""
        return self.amplitudes[rows.level[which]]
