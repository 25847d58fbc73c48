"""Frequency responses at held amplitudes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from nmt_core.numerics.arrays import ComplexArray, FloatArray, IntArray
from nmt_core.text.number_words import significant
from nmt_core.vocabulary import MOTIONS, TestKind
from nmt_diagnose.law.held_levels import HeldLevels
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.measurements.measurement import Driven
from nmt_diagnose.measurements.stepped_responses.levels import levels_of_lines
from nmt_diagnose.measurements.stepped_responses.predictor import SteppedSinePredictor, gain_error, with_growth
from nmt_diagnose.observations.channels.measuring_chain import MeasuringChain, table_chain
from nmt_diagnose.observations.observables import Observations, Part, Rows
from nmt_diagnose.prediction.parts_cache import PartsCache, Setup
from nmt_diagnose.prediction.prediction_settings import PredictionSettings
from nmt_diagnose.prediction.resting_motion import (
    Motion,
    nearest_frequency,
    resting_frequencies,
    resting_response,
)
from nmt_record.exchange.sidecar.calibration_file import CalibrationSheet
from nmt_rig.model.fourier_basis import FourierBasis
from nmt_rig.rig import Rig

if TYPE_CHECKING:
    from nmt_diagnose.observations.bag_windows import BagWindows
    from nmt_diagnose.observations.tables_together import TablesTogether


@dataclass(frozen=True)
class SteppedResponses(Driven):
    """Frequency responses at an amplitude that was held while the frequency was stepped.

    Attributes:
        name: unique name.
        drive_point: measurement point of the exciter.
        channels: response channels, in the order of the observables; the first is the one whose amplitude the model is
            given.
        reference: what the responses are divided by: ``force``, ``base`` (acceleration of a shaking table) or
            ``voltage``.
        held: what had the given amplitude: ``force``, ``base``, ``voltage``, or ``response`` (the first channel).
        lines_hz: frequencies that became observables, Hz, ascending, shape (lines,).
        levels: amplitude of what was held at each line, in its SI unit, shape (lines,).
        measured: measured responses, shape (lines, channels): they say how large the motion was and on which branch.
        noise: relative standard uncertainty of each line's magnitude and phase (rad), shape (lines,).
        direction: +1 while the frequency rose, −1 while it fell, 0 where it is not known.
        growth: ∂ ln R / ∂ ln s of the reference R over the first channel's amplitude s, by which an error of s counts,
            shape (lines,); None = 1, that of a linear rig.
        moved: ln of the amplitude about which an error of s counts to first order, over the measured one, shape
            (lines,); None = 0.
        scale: true over recorded amplitude of the first channel.
        noise_degrees: degrees of freedom of the variance that the noise was estimated as; infinite where it is stated.
        phase_known: whether the responses have a phase; else they are magnitudes, and no observable is a phase.
        imposed: whether the motion of the drive point was a sine, and the force what it takes; else the force was one.
    """

    WORDS: ClassVar[str] = "frequency response at a held amplitude"
    FIGURES: ClassVar[tuple[tuple[str, str, tuple[Part, ...]], ...]] = (
        ("frf", "Frequency responses: magnitude", (Part.LOG_MAGNITUDE,)),
        ("frf-phase", "Frequency responses: phase", (Part.PHASE,)),
    )
    over_frequency: ClassVar[bool] = True
    linear_chain: ClassVar[bool] = True
    held_amplitude: ClassVar[bool] = True

    name: str
    drive_point: int
    channels: tuple[MeasuredChannel, ...]
    reference: str
    held: str
    lines_hz: FloatArray
    levels: FloatArray
    measured: ComplexArray
    noise: FloatArray
    direction: int = 0
    growth: ComplexArray | None = None
    moved: FloatArray | None = None
    scale: float = 1.0
    noise_degrees: float = math.inf
    phase_known: bool = True
    imposed: bool = False

    @classmethod
    def read(cls, bag: BagWindows) -> list[Observations]:
        """Stepped sines of an import that are frequency responses, and response curves."""
        from nmt_diagnose.measurements.stepped_responses.reading import stepped_sine_observations  # late: it makes them

        bag.drop_implausible()
        swept = [
            kind
            for kind in (TestKind.STEPPED_SINE, TestKind.RESPONSE_CURVE)
            if bag.is_swept(kind) and bag.of_kind(kind)
        ]
        return [stepped_sine_observations(bag.named(kind), bag.of_kind(kind), bag) for kind in swept]

    @classmethod
    def read_tables(cls, tables: TablesTogether) -> Observations | None:
        """Frequency responses with the amplitude that was held, or with a measured force at each line."""
        from nmt_diagnose.measurements.stepped_responses.table_reading import stepped_table_observations  # late, too

        return stepped_table_observations(tables)

    @property
    def amplitudes(self) -> FloatArray:
        """Amplitude of the first channel at each line, in its unit; NaN where only the voltage is known, (lines,)."""
        if self.held == "response":
            return self.levels
        if self.held == self.reference:
            return np.asarray(np.abs(self.measured[:, 0]) * self.levels, dtype=np.float64)
        return np.full(self.levels.shape, math.nan)

    def predictor(self, rows: Rows, settings: PredictionSettings) -> SteppedSinePredictor:
        """What predicts its rows."""
        return SteppedSinePredictor(self, rows, settings)

    @property
    def given_channel(self) -> MeasuredChannel | None:
        """Channel at whose amplitudes the model is solved."""
        return self.channels[0]

    @property
    def over_force(self) -> bool:
        """Whether its rows are responses over what held its amplitude."""
        return self.held != "response"

    @property
    def referred_to(self) -> str:
        """What its responses are divided by."""
        return self.reference

    @property
    def scatter_key(self) -> object | None:
        """Sweeps of the same channels over the same have one scatter, where that is estimated."""
        return (self.channels, self.reference) if math.isfinite(self.noise_degrees) else None

    @property
    def sweep_key(self) -> object | None:
        """Drive point, channels, reference, what was held and whether there are phases."""
        return self.drive_point, frozenset(self.channels), self.reference, self.held, self.phase_known

    @property
    def level_name(self) -> str:
        """Level and direction of the frequency."""
        units = {"force": "N·m" if self.channels[0].turns else "N", "base": "m/s²", "voltage": "V"}
        level = f"{significant(float(np.median(self.levels)), 3)} {units.get(self.held, self.channels[0].unit)}"
        return level + {1: " ↑", -1: " ↓"}.get(self.direction, "")

    @property
    def imposed_scales(self) -> tuple[float, float] | None:
        """Displacement (m) and force (N) of an imposed motion, the largest."""
        if not self.imposed or self.reference != "force":
            return None
        order = MOTIONS[self.channels[0].quantity]
        force = float(np.max(self.levels / np.abs(self.measured[:, 0])))
        return float(np.max(self.levels / (2.0 * np.pi * self.lines_hz) ** order)), force

    def traced(self, states: Sequence[Any] | None) -> SteppedResponses:
        """The measurement with the noise of measured amplitudes propagated as a prediction's solutions say."""
        return self if states is None else with_growth(self, states[0])

    def motions(
        self, rig: Rig, channels: tuple[MeasuredChannel, ...], settings: PredictionSettings, frequency_hz: float
    ) -> list[Motion]:
        """Lines of largest and smallest motion, in the shape of the system linearised at rest at its resonance."""
        lead = self.channels[0]
        order = MOTIONS[lead.quantity]
        motion = self.amplitudes / (2.0 * np.pi * self.lines_hz) ** order
        if not np.any(np.isfinite(motion)):
            return []
        setup = Setup(self.drive_points, False, (*channels, lead), FourierBasis.up_to(1))
        parts, resting, found = PartsCache(settings).parts(rig, setup), resting_frequencies(rig), list[Motion]()
        for line in (int(np.nanargmax(motion)), int(np.nanargmin(motion))):
            omega = 2.0 * np.pi * nearest_frequency(resting, float(self.lines_hz[line]))
            q, y = resting_response(parts, omega)
            scale = float(motion[line]) * omega**order / max(abs(y[-1]), 1e-300)
            drive = float(self.levels[line]) if self.held == "voltage" else scale / parts.input_per_volt[0]
            found.append((parts, omega, drive, y[: len(channels)] * scale, q * scale))
        return found

    def larger(self, share: float) -> SteppedResponses:
        """With the motion of the first channel larger by a share."""
        return replace(self, scale=self.scale * (1.0 + share))

    def with_lines_moved(self, share: float) -> SteppedResponses:
        """With its lines higher by a share."""
        return replace(self, lines_hz=self.lines_hz * (1.0 + share))

    def response_errors(self, rows: Rows, chain: MeasuringChain) -> dict[str, FloatArray]:
        """Gain, phase and delay of each response and of the reference.

        An error of the first response is one of the amplitude at which the others are compared, too.
        """
        found: dict[str, FloatArray] = {}
        place, turned = (rows.level, rows.channel), rows.part == Part.PHASE
        omega = 2.0 * np.pi * rows.frequency_hz
        for channel, name in (*enumerate(c.name for c in self.channels), (None, f"the {self.reference}")):
            tolerance = chain.of("" if channel is None else name)
            late = math.hypot(tolerance.delay_s, chain.shared_delay_s)
            errors = (gain_error(self, channel, error)[place] for error in (1.0, 1j))
            of_gain, of_phase = (np.where(turned, e.imag, e.real) for e in errors)
            found[f"gain of {name} in responses"] = tolerance.gain * of_gain
            found[f"phase of {name} in responses"] = tolerance.phase * of_phase
            found[f"delay of {name} in responses"] = late * omega * of_phase
        return found

    def measured_responses(self, level: IntArray, channel: IntArray) -> ComplexArray | None:
        """Measured responses of rows."""
        return np.asarray(self.measured[level, channel])

    def table_chain(self, sheet: CalibrationSheet | None) -> MeasuringChain | None:
        """Tolerances of an analyser that has reduced it."""
        return table_chain(self.channels, sheet)

    def with_scatter(self, before: float, after: float, degrees: float) -> SteppedResponses:
        """The measurement whose scatter, of some standard deviation before, has another after."""
        noise = np.sqrt(np.maximum(self.noise**2 - before**2, 0.0) + after**2)
        return replace(self, noise=noise, noise_degrees=degrees)

    def held_levels(self, observations: Observations, number: int) -> HeldLevels | None:
        """Lines about the resonance at several forces as levels."""
        return levels_of_lines(self, observations, number)

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

    def magnitude_unit(self, channel: MeasuredChannel) -> str:
        """Unit of the responses of a channel."""
        force = "N·m" if channel.turns else "N"
        divisor = {"force": force, "base": "(m/s²)"}.get(self.reference, "V")
        return f"{super().magnitude_unit(channel)} / {divisor}"
