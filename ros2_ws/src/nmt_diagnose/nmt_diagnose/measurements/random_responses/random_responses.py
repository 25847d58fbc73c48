"""Frequency responses of a low-level random test."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from nmt_core.kinds import kind_class
from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import FloatArray, IntArray
from nmt_core.vocabulary import MOTIONS, TestKind
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.measurements.measurement import Driven
from nmt_diagnose.measurements.random_responses.influence import influence_on_lines
from nmt_diagnose.measurements.random_responses.predictor import RandomPredictor
from nmt_diagnose.observations.channels.measuring_chain import MeasuringChain, table_chain
from nmt_diagnose.observations.observables import Observations, Part, Rows
from nmt_diagnose.prediction.influence import Source, SourceColumn
from nmt_diagnose.prediction.parts_cache import PartsCache
from nmt_diagnose.prediction.prediction_settings import PredictionSettings
from nmt_diagnose.prediction.resting_motion import (
    Motion,
    noise_motion,
)
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_record.exchange.sidecar.calibration_file import CalibrationSheet
from nmt_rig.rig import Rig
from nmt_rig.rig_model import inputs_per_volt

if TYPE_CHECKING:
    from nmt_diagnose.observations.bag_windows import BagWindows
    from nmt_diagnose.observations.tables_together import TablesTogether


@dataclass(frozen=True)
class RandomResponses(Driven):
    """Frequency responses of a low-level random test, referred to the voltage, to the force or to the base.

    Attributes:
        name: unique name.
        drive_point: measurement point of the exciter.
        channels: response channels, in the order of the observables.
        reference: ``voltage``, ``force`` or ``base`` (acceleration of a shaking table).
        lines_hz: frequency lines that became observables, Hz, shape (lines,).
        resolution_hz: spacing of the lines of the estimator, Hz.
        window: ``none``: the expected estimate is the response at the line itself;
            ``hann``: the expected estimate at a line is the response averaged over the neighbouring lines with the
            weights of |W|² (1/6, 2/3, 1/6 in spacings of ``resolution_hz``).
        drive_rms: rms of the reference, V, N or m/s².
        start_s, stop_s: on the clock of its bag, s.
        drive_hold_hz: rate at which the drive went straight from sample to sample, Hz; infinite where it did not. The
            observables are responses to the samples of the drive then: smaller by sinc², and with images of the drive
            around multiples of that rate.
        resting_points: measurement points of further exciters, whose drive is taken out of the responses.
        other_rms: rms of their drive, which moves the structure too, V; empty = nothing.
    """

    WORDS: ClassVar[str] = "random, frequency response"
    FIGURES: ClassVar[tuple[tuple[str, str, tuple[Part, ...]], ...]] = (
        ("frf", "Frequency responses: magnitude", (Part.LOG_MAGNITUDE,)),
        ("frf-phase", "Frequency responses: phase", (Part.PHASE,)),
    )
    unexcited: ClassVar[tuple[Part, ...]] = (Part.LINE,)
    over_frequency: ClassVar[bool] = True
    broad_band: ClassVar[bool] = True
    linear_chain: ClassVar[bool] = True

    name: str
    drive_point: int
    channels: tuple[MeasuredChannel, ...]
    reference: str
    lines_hz: FloatArray
    resolution_hz: float
    window: str
    drive_rms: float
    start_s: float
    stop_s: float
    drive_hold_hz: float = math.inf
    resting_points: tuple[int, ...] = ()
    other_rms: tuple[float, ...] = ()

    @classmethod
    def read(cls, bag: BagWindows) -> list[Observations]:
        """Windows of noise, a test for each and for each exciter."""
        from nmt_diagnose.measurements.random_responses.reading import responses_to_each_exciter  # late: it makes them

        noises = [kind for kind in TestKind if kind_class(kind).is_broad_band]
        return [
            found for name, window in bag.each(noises) for found in responses_to_each_exciter(name, window.stretch, bag)
        ]

    @classmethod
    def read_tables(cls, tables: TablesTogether) -> Observations | None:
        """Frequency responses that no amplitude was held in."""
        from nmt_diagnose.measurements.random_responses.table_reading import response_table_observations  # late, too

        return response_table_observations(tables)

    def predictor(self, rows: Rows, settings: PredictionSettings) -> RandomPredictor:
        """What predicts its rows."""
        return RandomPredictor(self, rows, settings)

    @property
    def over_voltage(self) -> bool:
        """Whether its rows refer to the voltage."""
        return self.reference == "voltage"

    @property
    def over_force(self) -> bool:
        """Whether its rows are responses over the force."""
        return self.reference == "force"

    @property
    def referred_to(self) -> str:
        """What its responses are divided by."""
        return self.reference

    @property
    def divisor(self) -> MeasuredChannel | None:
        """The force that its responses are divided by."""
        if self.reference != "force":
            return None
        return MeasuredChannel(f"f{self.drive_point}", Quantity.FORCE, self.drive_point)

    @property
    def modal_lines_hz(self) -> FloatArray | None:
        """Its lines, infinite where images of a held drive are large, which rise towards half its rate."""
        highest = THRESHOLDS.modes.least_images_share * self.drive_hold_hz
        return np.where(self.lines_hz < highest, self.lines_hz, np.inf)

    @property
    def span_s(self) -> tuple[float, float] | None:
        """Its beginning and end, s."""
        return self.start_s, self.stop_s

    def influence(
        self,
        predictor: RandomPredictor,
        rig: Rig,
        cache: PartsCache,
        states: Sequence[Any],
        source: Source,
        settings: PredictionSettings,
    ) -> tuple[FloatArray, list[SourceColumn]]:
        """What unit sources at a place would do to its rows, (rows, sources), and what each is."""
        if source.kind == "controller":
            return super().influence(predictor, rig, cache, states, source, settings)
        return influence_on_lines(predictor, rig, cache, source, settings)

    def motions(
        self, rig: Rig, channels: tuple[MeasuredChannel, ...], settings: PredictionSettings, frequency_hz: float
    ) -> list[Motion]:
        """Rms of the motion over its lines, by the system linearised at rest."""
        lines, rms = 2.0 * np.pi * self.lines_hz, self.drive_rms
        if self.reference == "base":
            rms /= inputs_per_volt(rig)[0]
        return noise_motion(rig, self.drive_point, channels, settings, lines, rms, self.over_force)

    def measured_sizes(self, observations: Observations, number: int, drive: float) -> dict[str, float]:
        """Rms of each motion channel whose lines are all there."""
        rows, sizes = observations.rows, dict[str, float]()
        for index, channel in enumerate(self.channels):
            selected = (rows.test == number) & (rows.channel == index)
            selected &= (rows.part == Part.LOG_MAGNITUDE) & (rows.harmonic == 1)
            if channel.quantity in MOTIONS and int(selected.sum()) == self.lines_hz.size > 1:
                magnitude = np.empty(self.lines_hz.size)
                magnitude[rows.level[selected]] = np.exp(observations.values[selected])
                weights = np.gradient(self.lines_hz)
                sizes[channel.name] = self.drive_rms * math.sqrt(float(weights @ magnitude**2 / weights.sum()))
        return sizes

    def with_lines_moved(self, share: float) -> RandomResponses:
        """With its lines higher by a share."""
        return replace(self, lines_hz=self.lines_hz * (1.0 + share))

    def response_errors(self, rows: Rows, chain: MeasuringChain) -> dict[str, FloatArray]:
        """Delay of each kind of responses over the force that they are divided by."""
        found: dict[str, FloatArray] = {}
        late = math.sqrt(2.0) * chain.shared_delay_s
        for index, channel in enumerate(self.channels if self.over_force else ()):
            name = f"delay of {channel.quantity.name.lower()} over force"
            selected = (rows.channel == index) & (rows.part == Part.PHASE)
            column = found.setdefault(name, np.zeros(len(rows)))
            column[selected] = late * 2.0 * np.pi * rows.frequency_hz[selected]
        return found

    def table_chain(self, sheet: CalibrationSheet | None) -> MeasuringChain | None:
        """Tolerances of an analyser that has reduced it."""
        return table_chain(self.channels, sheet)

    def repeat_key(self, rows: Rows, index: int) -> tuple[object, float]:
        """Frequency of the line."""
        return round(float(rows.frequency_hz[index]), 6), 0.0

    def line_group(self, channel: int) -> str:
        """The lines of a channel have one noise."""
        return f"lines of {self.channels[channel].name}"

    @property
    def axis(self) -> str:
        """Frequency."""
        return "frequency / Hz"

    @property
    def map_axis(self) -> str:
        """Bands of lines."""
        return "middle of the band / Hz"

    def abscissa(self, rows: Rows, which: IntArray) -> FloatArray:
        """Frequency of the lines, Hz."""
        return rows.frequency_hz[which]

    def thirds(self, rows: Rows, which: IntArray) -> tuple[FloatArray, str]:
        """Frequency of the lines, Hz."""
        return rows.frequency_hz[which], "lines"

    def magnitude_unit(self, channel: MeasuredChannel) -> str:
        """Unit of the responses of a channel."""
        force = "N·m" if channel.turns else "N"
        divisor = {"force": force, "base": "(m/s²)"}.get(self.reference, "V")
        return f"{super().magnitude_unit(channel)} / {divisor}"
