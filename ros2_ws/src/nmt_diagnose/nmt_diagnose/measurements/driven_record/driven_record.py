"""Records of any excitation."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import FloatArray, IntArray
from nmt_core.vocabulary import TestKind
from nmt_diagnose.measurements.channel import MeasuredChannel, with_magnitudes
from nmt_diagnose.measurements.driven_record.predictor import RecordPredictor
from nmt_diagnose.measurements.imposed_motion.predictor import ImposedMotionPredictor
from nmt_diagnose.measurements.measurement import Driven
from nmt_diagnose.observations.channels.measuring_chain import MeasuringChain
from nmt_diagnose.observations.observables import Part, Rows
from nmt_diagnose.prediction.parts_cache import PartsCache
from nmt_diagnose.prediction.prediction_settings import PredictionSettings
from nmt_diagnose.prediction.resting_motion import (
    Motion,
    noise_motion,
)
from nmt_rig.rig import Rig

if TYPE_CHECKING:
    from nmt_diagnose.observations.bag_windows import BagWindows
    from nmt_diagnose.observations.observables import Observations


@dataclass(frozen=True)
class DrivenRecord(Driven):
    """Any excitation: the model is driven by the measured input.

    Attributes:
        name: unique name.
        drive_point: measurement point of the exciter.
        sample_rate: of the input, Hz: that of the recording or a whole multiple of it, so fine that the input may be
            taken as straight from sample to sample.
        input_channel: measured input (voltage, or force).
        input: samples as they were recorded, shape (n,), V or N.
        channels: response channels, in the order of the observables.
        segment_bounds: first input sample of each scored segment and the end of the last, shape (segments + 1,).
        start_s: time of the first sample on the clock of its bag, s: an observable of time t is sample
            (t − start_s) · sample_rate of the input.
        zeros: standard deviation of the zero of the input and of each channel, shape (1 + channels,), in their units;
            empty = they have none. The observables are without the mean of their channel, which is part of its zero.
        limits: magnitude at which the samples of each channel stay again and again, shape (channels,), in their units;
            0 = nowhere; empty = not looked at.
        head: first samples of the channels, without the same mean, shape (channels, h); empty = it begins at rest.
        head_stride: samples of the input from one of these to the next.
        begins_in_motion: whether the model may not start at rest.
        followed: further channels, which a force may follow, at the samples of the input, by what they are.
        responses: the channels as they were recorded, shape (channels, samples); empty = not kept.
    """

    WORDS: ClassVar[str] = "record, driven by the measured input"
    FIGURES: ClassVar[tuple[tuple[str, str, tuple[Part, ...]], ...]] = (("record", "Record", (Part.SAMPLE,)),)
    unexcited: ClassVar[tuple[Part, ...]] = (Part.LINE,)
    over_time: ClassVar[bool] = True
    interleaved: ClassVar[bool] = True

    name: str
    drive_point: int
    sample_rate: float
    input_channel: MeasuredChannel
    input: FloatArray
    channels: tuple[MeasuredChannel, ...]
    segment_bounds: FloatArray
    start_s: float = 0.0
    zeros: FloatArray = field(default_factory=lambda: np.zeros(0))
    limits: FloatArray = field(default_factory=lambda: np.zeros(0))
    head: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    head_stride: int = 1
    begins_in_motion: bool = False
    followed: dict[str, FloatArray] = field(default_factory=dict)
    responses: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))

    @property
    def driven_as(self) -> DrivenRecord | None:
        """Itself, where its responses are known sample by sample."""
        return self if self.responses.size else None

    @property
    def signals(self) -> dict[str, FloatArray]:
        """Measured channels that the strength of a force may follow, at the samples of the input, (n,) each."""
        return with_magnitudes(self.followed)

    @classmethod
    def read(cls, bag: BagWindows) -> list[Observations]:
        """Windows of records."""
        from nmt_diagnose.measurements.driven_record.reading import record_observations  # late: it makes them

        stretches = [window.stretch for window in bag.of_kind(TestKind.RECORD)]
        return [record_observations(bag.named(TestKind.RECORD), stretches, bag)] if stretches else []

    def predictor(self, rows: Rows, settings: PredictionSettings) -> RecordPredictor | ImposedMotionPredictor:
        """What predicts its rows."""
        return RecordPredictor(self, rows, settings)

    @property
    def driven_by_voltage(self) -> bool:
        """Whether its input is the voltage."""
        return self.input_channel.quantity is Quantity.VOLTAGE

    @property
    def timed_by_drive(self) -> bool:
        """Whether a delay that all sensors share shows in it."""
        return True

    @property
    def span_s(self) -> tuple[float, float] | None:
        """Its beginning on the clock of its bag, s; its end is not kept."""
        return self.start_s, 0.0

    def motions(
        self, rig: Rig, channels: tuple[MeasuredChannel, ...], settings: PredictionSettings, frequency_hz: float
    ) -> list[Motion]:
        """Rms of the motion that flat noise as large as its input makes, by the system linearised at rest."""
        lines = 2.0 * np.pi * np.geomspace(1e-3, 0.4, 200) * self.sample_rate
        ideal = self.input_channel.quantity == Quantity.FORCE
        return noise_motion(rig, self.drive_point, channels, settings, lines, float(np.std(self.input)), ideal)

    def record_errors(
        self, rows: Rows, rig: Rig, cache: PartsCache, settings: PredictionSettings, chain: MeasuringChain | None
    ) -> tuple[dict[str, FloatArray], dict[str, float]]:
        """Zeros, gains and beginning of the record, (rows,) each, and standard deviations of the zeros, by name."""
        predictor = self.predictor(rows, settings)
        names = (self.input_channel.name, *(channel.name for channel in self.channels))
        zeros = {f"zero of {it} in {self.name}": float(std) for it, std in zip(names, self.zeros, strict=False)}
        return predictor.errors(rig, cache, chain), zeros

    @property
    def axis(self) -> str:
        """Time."""
        return "time / s"

    @property
    def map_axis(self) -> str:
        """Segments."""
        return "segment"

    def abscissa(self, rows: Rows, which: IntArray) -> FloatArray:
        """Time of the samples, s."""
        return rows.time_s[which]

    def thirds(self, rows: Rows, which: IntArray) -> tuple[FloatArray, str]:
        """Segments have no order in size."""
        return np.zeros(0), ""
