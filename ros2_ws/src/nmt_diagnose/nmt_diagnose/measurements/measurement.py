"""What every kind of measurement is: conditions under which rows were recorded, and all that depends on the kind.

A further kind is a folder beside the others: its class overrides what is not as it stands here.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from nmt_core.numerics.arrays import BoolArray, ComplexArray, FloatArray, IntArray
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.observations.observables import Observations, Part, Rows
from nmt_diagnose.prediction.influence import Source, SourceColumn
from nmt_diagnose.prediction.parts_cache import PartsCache
from nmt_diagnose.prediction.prediction_settings import PredictionSettings
from nmt_diagnose.prediction.predictor import Predictor
from nmt_rig.rig import Rig

if TYPE_CHECKING:
    from nmt_diagnose.law.held_levels import HeldLevels
    from nmt_diagnose.measurements.driven_record.driven_record import DrivenRecord
    from nmt_diagnose.measurements.imposed_motion.imposed_motion import ImposedMotion
    from nmt_diagnose.measurements.locked_windows.locked_level import LockedLevel
    from nmt_diagnose.observations.bag_windows import BagWindows
    from nmt_diagnose.observations.channels.measuring_chain import MeasuringChain
    from nmt_diagnose.observations.tables_together import TablesTogether
    from nmt_diagnose.prediction.resting_motion import Motion
    from nmt_record.exchange.sidecar.calibration_file import CalibrationSheet


class Measurement:
    """One measurement of a real side; its rows stand in observations.

    Attributes:
        WORDS: what the kind is called in tables.
        FIGURES: figures of a report: key, title, and parts of the rows; ``{over}`` in a title is what the levels are.
        unexcited: parts of its rows that follow no excitation.
        over_frequency: its rows are lines of frequency responses.
        free: it decays without excitation.
        broad_band: its lines were excited together, over many modes.
        over_time: its rows are samples.
        reduced: someone else made its rows; no chain of the bench's own measured them.
        ranked: its levels are a series over the amplitude, in which a trend is looked for.
        interleaved: every second of its levels may be held out.
        rising: its highest levels may be held out.
        linear_chain: errors of its measuring chain act on magnitudes and phases, a column each.
        held_amplitude: its responses are compared at the amplitude of their first channel.
        given_channel: channel at whose amplitudes the model is solved; None where the drive is given.
        locked_levels: levels at which a loop held the phase.
        locked_harmonics: highest order among the observables of those levels.
        commanded: the drive is the commanded voltage; else the recorded one.
        over_voltage: its rows refer to the voltage.
        driven_by_voltage: the voltage is given, or its rows refer to it.
        timed_by_drive: a delay that all sensors share shows in it.
        over_force: its rows are responses over a force, or over what held its amplitude.
        referred_to: what its responses are divided by.
        imposed_scales: displacement (m) and force (N) of an imposed motion, the largest; None where none was imposed.
        limits: magnitude at which the samples of each channel stay again and again; empty = not looked at.
        noise_degrees: degrees of freedom of the variance that the noise was estimated as; infinite where it is stated.
        recorded: channels beside those of the motion, whose names errors of a force take.
    """

    WORDS: ClassVar[str]
    FIGURES: ClassVar[tuple[tuple[str, str, tuple[Part, ...]], ...]] = (
        ("decay", "Frequency and damping over the amplitude", (Part.LOG_FREQUENCY, Part.DAMPING)),
    )
    unexcited: ClassVar[tuple[Part, ...]] = ()
    over_frequency: ClassVar[bool] = False
    free: ClassVar[bool] = False
    broad_band: ClassVar[bool] = False
    over_time: ClassVar[bool] = False
    reduced: ClassVar[bool] = False
    ranked: ClassVar[bool] = False
    interleaved: ClassVar[bool] = False
    rising: ClassVar[bool] = False
    linear_chain: ClassVar[bool] = False
    held_amplitude: ClassVar[bool] = False

    commanded: bool = False
    noise_degrees: float = math.inf
    limits: FloatArray = np.zeros(0)

    if TYPE_CHECKING:

        @property
        def name(self) -> str:
            """Unique name."""

        @property
        def drive_point(self) -> int:
            """Measurement point of the exciter, of several the first."""

        @property
        def drive_points(self) -> tuple[int, ...]:
            """Measurement point of each exciter."""

        @property
        def channels(self) -> tuple[MeasuredChannel, ...]:
            """Channels, in the order of the rows."""

    # -- reading -------------------------------------------------------------------------------------------------------

    @classmethod
    def read(cls, bag: BagWindows) -> list[Observations]:
        """Its measurements among the windows of a bag; the kinds are asked in the order of the registry.

        Raises:
            BenchError: the bag cannot be of the model's rig.
        """
        return []

    @classmethod
    def read_tables(cls, tables: TablesTogether) -> Observations | None:
        """Its measurement where tables that someone else has reduced are one; None of other tables.

        Raises:
            BenchError: what they say does not fit together.
        """
        return None

    # -- what drove it, and how it is referred -------------------------------------------------------------------------

    @property
    def given_channel(self) -> MeasuredChannel | None:
        """Channel at whose amplitudes the model is solved."""
        return None

    @property
    def locked_levels(self) -> tuple[LockedLevel, ...]:
        """Levels at which a loop held the phase."""
        return ()

    @property
    def locked_harmonics(self) -> int:
        """Highest order among the observables of locked levels; 0 where there are none."""
        return 0

    @property
    def over_voltage(self) -> bool:
        """Whether its rows refer to the voltage."""
        return False

    @property
    def driven_by_voltage(self) -> bool:
        """Whether the voltage is given, or its rows refer to it."""
        return self.over_voltage

    @property
    def timed_by_drive(self) -> bool:
        """Whether a delay that all sensors share shows in it."""
        return self.over_voltage

    @property
    def over_force(self) -> bool:
        """Whether its rows are responses over a force, or over what held its amplitude."""
        return False

    @property
    def referred_to(self) -> str:
        """What its responses are divided by."""
        return ""

    @property
    def divisor(self) -> MeasuredChannel | None:
        """The force that its responses are divided by, where that is none of its channels."""
        return None

    @property
    def imposed_scales(self) -> tuple[float, float] | None:
        """Displacement (m) and force (N) of an imposed motion, the largest; None where none was imposed."""
        return None

    @property
    def moved_as(self) -> ImposedMotion | None:
        """The record of a motion that the drive point was moved by; None where forces drove."""
        return None

    @property
    def driven_as(self) -> DrivenRecord | None:
        """The record whose samples of the responses are known where it was driven; None of other kinds."""
        return None

    @property
    def modal_lines_hz(self) -> FloatArray | None:
        """Lines of responses that identify modes, Hz, infinite where they do not; None for other kinds."""
        return None

    @property
    def span_s(self) -> tuple[float, float] | None:
        """Its first and last moment on the clock of its bag, s; None where it has no rows."""
        return 0.0, 0.0

    @property
    def scatter_key(self) -> object | None:
        """What sweeps have in common whose scatter is taken together; None where the noise is stated."""
        return None

    @property
    def sweep_key(self) -> object | None:
        """What frequency responses at several amplitudes have in common, which are one figure and one set of levels."""
        return None

    @property
    def level_name(self) -> str:
        """What it is called beside others of its sweep."""
        return self.name

    # -- prediction ----------------------------------------------------------------------------------------------------

    def predictor(self, rows: Rows, settings: PredictionSettings) -> Predictor:
        """What predicts its rows.

        Raises:
            BenchError: the model cannot predict it.
        """
        raise NotImplementedError

    def influence(
        self,
        predictor: Any,
        rig: Rig,
        cache: PartsCache,
        states: Sequence[Any],
        source: Source,
        settings: PredictionSettings,
    ) -> tuple[FloatArray, list[SourceColumn]]:
        """What unit sources at a place would do to its rows, (rows, sources), and what each is; none by default."""
        return np.zeros((len(predictor.rows), 0)), []

    def traced(self, states: Sequence[Any] | None) -> Measurement:
        """The measurement with the noise of measured amplitudes propagated as a prediction's solutions say."""
        return self

    def motions(
        self, rig: Rig, channels: tuple[MeasuredChannel, ...], settings: PredictionSettings, frequency_hz: float
    ) -> list[Motion]:
        """Largest and smallest motion of the model under its conditions.

        Args:
            rig: the model.
            channels: whose amplitudes are wanted; among them a probe at each point.
            settings: of the predictor.
            frequency_hz: measured at the smallest amplitude; NaN where that is not known.
        """
        return []

    def measured_sizes(self, observations: Observations, number: int, drive: float) -> dict[str, float]:
        """Amplitude, or rms, that each motion channel shows at a drive; empty where a motion is given or not known."""
        return {}

    # -- measuring chain -----------------------------------------------------------------------------------------------

    def with_levels(self, change: Callable[[LockedLevel], LockedLevel]) -> Measurement:
        """The measurement with every locked level changed."""
        return self

    def larger(self, share: float) -> Measurement | None:
        """With the motion at which the model is solved larger by a share; None where the drive is given."""
        return None

    def with_lines_moved(self, share: float) -> Measurement | None:
        """With its lines higher by a share; None where it has none."""
        return None

    def resonance_rows(self, rows: Rows) -> BoolArray:
        """Rows of its own that a shift of the resonance moves alone, (rows,)."""
        return np.zeros(len(rows), dtype=bool)

    def response_errors(self, rows: Rows, chain: MeasuringChain) -> dict[str, FloatArray]:
        """Errors that its rows alone have, (rows,) each, by name.

        Args:
            rows: magnitudes and phases of its responses.
            chain: tolerances.
        """
        return {}

    def record_errors(
        self, rows: Rows, rig: Rig, cache: PartsCache, settings: PredictionSettings, chain: MeasuringChain | None
    ) -> tuple[dict[str, FloatArray], dict[str, float]]:
        """Zeros, gains and beginning of a record, (rows,) each, and standard deviations of the zeros, by name."""
        return {}, {}

    def turned_by(self, channel: str) -> int:
        """Sign by which an error of a channel's phase turns what the loop held; 0 where the loop does not know it."""
        return 0

    def measured_responses(self, level: IntArray, channel: IntArray) -> ComplexArray | None:
        """Measured responses of rows; None where they are compared with a mean of measured and predicted ones."""
        return None

    def table_chain(self, sheet: CalibrationSheet | None) -> MeasuringChain | None:
        """Tolerances of an analyser that has reduced it; None where its noise says all."""
        return None

    # -- noise ---------------------------------------------------------------------------------------------------------

    def repeat_key(self, rows: Rows, index: int) -> tuple[object, float]:
        """What a row has in common with that of a repeat: its place in the measurement, and the level of excitation."""
        return round(float(rows.time_s[index]), 9), 0.0

    def line_group(self, channel: int) -> str:
        """Name of the group of rows with one noise that the lines of a channel are; empty = by their part."""
        return ""

    def with_scatter(self, before: float, after: float, degrees: float) -> Measurement:
        """The measurement whose scatter, of some standard deviation before, has another after."""
        return self

    # -- law -----------------------------------------------------------------------------------------------------------

    def held_levels(self, observations: Observations, number: int) -> HeldLevels | None:
        """Its levels as complex amplitudes of force and motion; None where it has none."""
        return None

    # -- curves --------------------------------------------------------------------------------------------------------

    @property
    def axis(self) -> str:
        """What the abscissa of its curves is, with unit."""
        return f"{self.channels[0].quantity.name.lower()} amplitude / {self.channels[0].unit}"

    @property
    def map_axis(self) -> str:
        """What the columns of its residual map are."""
        return self.axis

    def abscissa(self, rows: Rows, which: IntArray) -> FloatArray:
        """Where rows stand on the axis, (which,)."""
        return rows.amplitude[which]

    def thirds(self, rows: Rows, which: IntArray) -> tuple[FloatArray, str]:
        """What rows are told apart by, (which,), and what its steps are called."""
        return rows.amplitude[which], "levels"

    def magnitude_unit(self, channel: MeasuredChannel) -> str:
        """Unit of the magnitudes of a channel."""
        return channel.unit.replace("s^2", "s²")


class Driven(Measurement):
    """A measurement that names the point of its exciter, and those of further ones that it sees at rest."""

    resting_points: tuple[int, ...] = ()

    @property
    def drive_points(self) -> tuple[int, ...]:
        """Measurement point of each exciter."""
        return (self.drive_point, *self.resting_points)
