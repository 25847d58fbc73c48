"""Backbones that someone else has reduced."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

from nmt_core.numerics.arrays import FloatArray, IntArray
from nmt_diagnose.law.held_levels import HeldLevels, levels_over_amplitude
from nmt_diagnose.measurements.backbone_table.predictor import BackbonePredictor
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.measurements.measurement import Driven
from nmt_diagnose.observations.observables import Observations, Rows
from nmt_diagnose.prediction.prediction_settings import PredictionSettings
from nmt_diagnose.prediction.resting_motion import (
    Motion,
    mode_under_test,
    motion_at_amplitudes,
)
from nmt_rig.rig import Rig

if TYPE_CHECKING:
    from nmt_diagnose.observations.bag_windows import BagWindows
    from nmt_diagnose.observations.tables_together import TablesTogether


@dataclass(frozen=True)
class BackboneTable(Driven):
    """A backbone reduced by someone else: frequency (and damping ratio) over response amplitude at the drive point.

    Attributes:
        name: unique name.
        drive_point: measurement point of the exciter.
        channel: response channel of the amplitudes.
        amplitudes: shape (k,).
        noise_degrees: degrees of freedom of the variance that the noise of frequencies was estimated as; infinite where
            it is stated.
    """

    WORDS: ClassVar[str] = "backbone table"
    reduced: ClassVar[bool] = True
    ranked: ClassVar[bool] = True
    interleaved: ClassVar[bool] = True
    rising: ClassVar[bool] = True

    name: str
    drive_point: int
    channel: MeasuredChannel
    amplitudes: FloatArray
    noise_degrees: float = math.inf

    @classmethod
    def read(cls, bag: BagWindows) -> list[Observations]:
        """Windows of phase resonance that no force was recorded of; no other kind reads them."""
        from nmt_diagnose.measurements.backbone_table.unforced import unforced_observations  # late: it makes them

        return unforced_observations(bag)

    @classmethod
    def read_tables(cls, tables: TablesTogether) -> Observations | None:
        """Frequency and damping ratio over amplitude."""
        from nmt_diagnose.measurements.backbone_table.reading import backbone_observations  # late, too

        return backbone_observations(tables)

    @property
    def channels(self) -> tuple[MeasuredChannel, ...]:
        """The channel of the amplitudes."""
        return (self.channel,)

    def predictor(self, rows: Rows, settings: PredictionSettings) -> BackbonePredictor:
        """What predicts its rows."""
        return BackbonePredictor(self, rows, settings)

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
        frequency = frequency_hz if frequency_hz > 0.0 else mode_under_test(rig)
        points, channel = self.drive_points, self.channel
        return motion_at_amplitudes(rig, points, channel, self.amplitudes, channels, settings, frequency)

    def larger(self, share: float) -> BackboneTable:
        """With its amplitudes larger by a share."""
        return replace(self, amplitudes=self.amplitudes * (1.0 + share))

    def held_levels(self, observations: Observations, number: int) -> HeldLevels | None:
        """Its amplitudes as levels."""
        return levels_over_amplitude(self.drive_points, self.channels, self.amplitudes, observations, number)

    def abscissa(self, rows: Rows, which: IntArray) -> FloatArray:
        """Amplitude of its channel."""
        return self.amplitudes[rows.level[which]]
