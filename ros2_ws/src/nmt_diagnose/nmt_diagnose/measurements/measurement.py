"""What every kind of measurement is: conditions under which rows were recorded, and all that depends on the kind.

Levels, lines, records and the axis are its parts: who asks about one of these asks the part, which other kinds lack.
A further kind is a file in this folder: its class overrides what differs from here.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, ClassVar, Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.signal import welch

from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import ComplexArray, FloatArray, IntArray
from nmt_diagnose.measurements.channel import MeasuredChannel, with_magnitudes
from nmt_diagnose.observations.channels.measuring_chain import MeasuringChain
from nmt_diagnose.observations.observables import Part, Place, Rows, no_rows
from nmt_diagnose.observations.origin import Origin
from nmt_diagnose.prediction.parts_cache import PartsCache
from nmt_diagnose.prediction.prediction_settings import PredictionSettings
from nmt_diagnose.prediction.predictor import Predictor
from nmt_diagnose.prediction.resting_motion import Motion
from nmt_rig.rig import Rig

Terms: TypeAlias = tuple[tuple[complex, ...], ...]
"""Orders 1, 2, … of the drive of each exciter over the fundamental of the first."""

PURE_TONE: Terms = ((1.0 + 0.0j,),)
"""Terms of a sine at one exciter."""


@dataclass(frozen=True)
class LockedLevel:
    """One locked window.

    Attributes:
        index: level number in its plan.
        drive: fundamental of the drive voltage at the first exciter, V peak; its phase is the zero of all phases. NaN
            where it is not known.
        phase_error: measured arg F₁ − arg(iωψ_k,1) at the drive point, rad: where the loop stood; an input of the
            model.
        phase_error_std: its standard uncertainty, rad.
        frequency_hz: measured excitation frequency, Hz (start of the solution).
        start_s, stop_s: window on the clock of its bag, s.
        cycles_before: excitation periods since the start of the bag until the middle of the window.
        direction: +1 while the level rises, −1 while it falls.
        force_n: measured |F₁|, N: the given amplitude where the force is held.
        phase_lean: how far the loop may still have been off because it had not settled, rad.
        terms: what drove the structure, voltage of each exciter, or its force where that is held.
        amplitude_leans: of each channel of the test, how far its amplitude may still be from where it would have
            settled, its transient taken out, relative; empty = nowhere.
        fundamentals: |Y₁| of each channel of the test, in its unit; empty = not known.
    """

    index: int
    drive: float
    phase_error: float
    phase_error_std: float
    frequency_hz: float
    start_s: float
    stop_s: float
    cycles_before: float
    direction: int
    force_n: float = math.nan
    phase_lean: float = 0.0
    terms: Terms = PURE_TONE
    amplitude_leans: tuple[float, ...] = ()
    fundamentals: tuple[float, ...] = ()


@dataclass(frozen=True)
class HeldLevels:
    """Levels of one test, ascending motion.

    Attributes:
        name: of the test.
        drive_points: measurement point of each exciter.
        over_base: the force is the acceleration of a base.
        alone: fundamentals alone determine a law, whatever shaker stays attached.
        recorded: channels of the test, where forces are among them.
        numbers: of each level in the plan of the test, (L,).
        omega: angular frequency, rad/s, (L,).
        force: harmonics 0 … H of the measured force of each exciter, N, or of the acceleration of the base, m/s²,
            (E, L, H + 1); order 0 is 0.
        force_std: standard uncertainties of their fundamentals, N, (E, L).
        ratio, ratio_std: damping ratio of each level in the place of the force, and what frequency and damping are
            uncertain by together, (L,); None where the force is measured.
        channels: of the responses, C.
        motion: harmonics of the displacements, m, (L, C, H + 1); order 0 is 0, NaN where a channel was not used.
        motion_std: their standard uncertainties, m, (L, C, H + 1).
        chain: tolerances of the measuring chain; None = it measures as the rig file says.
    """

    name: str
    drive_points: tuple[int, ...]
    numbers: tuple[int, ...]
    omega: FloatArray
    force: ComplexArray
    force_std: FloatArray
    channels: tuple[MeasuredChannel, ...]
    motion: ComplexArray
    motion_std: FloatArray
    chain: MeasuringChain | None
    ratio: FloatArray | None = None
    ratio_std: FloatArray | None = None
    over_base: bool = False
    alone: bool = False
    recorded: tuple[MeasuredChannel, ...] = ()

    @property
    def count(self) -> int:
        """Number of levels L."""
        return int(self.omega.size)

    @property
    def harmonics(self) -> int:
        """Highest order H."""
        return int(self.motion.shape[2]) - 1

    def take(self, kept: list[int]) -> HeldLevels:
        """Some of the levels."""
        return replace(
            self, numbers=tuple(self.numbers[k] for k in kept), omega=self.omega[kept], force=self.force[:, kept],
            force_std=self.force_std[:, kept], motion=self.motion[kept], motion_std=self.motion_std[kept],
            ratio=None if self.ratio is None else self.ratio[kept],
            ratio_std=None if self.ratio_std is None else self.ratio_std[kept],
        )  # fmt: skip


@dataclass(frozen=True)
class CurveAxis:
    """What the curves of a measurement are drawn over.

    Attributes:
        label: of its abscissa, with unit.
        map_label: of the columns of its residual map.
        along: column of the rows that stands on it.
        nodes: what levels stand at in the place of a column, by their number; empty = the column.
        steps: name of the steps that order its rows; empty = they have no order in size.
        divisor: unit that its magnitudes are divided by; empty = by none.
        figures: of a report: key, title, and parts of the rows; ``{over}`` in a title is what the levels are.
    """

    label: str
    map_label: str
    along: Literal["amplitude", "frequency_hz", "time_s"] = "amplitude"
    nodes: FloatArray = field(default_factory=lambda: np.zeros(0))
    steps: Literal["levels", "lines", ""] = "levels"
    divisor: str = ""
    figures: tuple[tuple[str, str, tuple[Part, ...]], ...] = (
        ("decay", "Frequency and damping over the amplitude", (Part.LOG_FREQUENCY, Part.DAMPING)),
    )

    def abscissa(self, rows: Rows, which: IntArray) -> FloatArray:
        """Where rows stand on it, (which,)."""
        return self.nodes[rows.level[which]] if self.nodes.size else np.asarray(getattr(rows, self.along)[which])

    def thirds(self, rows: Rows, which: IntArray) -> FloatArray:
        """Values that order rows in size, (which,); empty without such an order."""
        return {"levels": rows.amplitude[which], "lines": rows.frequency_hz[which]}.get(self.steps, np.zeros(0))

    def magnitude_unit(self, channel: MeasuredChannel) -> str:
        """Unit of the magnitudes of a channel."""
        unit = channel.unit.replace("s^2", "s²")
        if not self.divisor:
            return unit
        return f"{unit} / {'N·m' if self.divisor == 'N' and channel.turns else self.divisor}"


class LevelSeries(NamedTuple):
    """What the levels of a measurement are to each other.

    Attributes:
        ranked: they are a series over the amplitude, which is tested for a trend.
        interleaved: every second may be held out.
        rising: the highest may be held out.
    """

    ranked: bool = False
    interleaved: bool = False
    rising: bool = False


class Measurement:
    """One measurement of a real side; its rows stand in observations.

    Attributes:
        WORDS: what the kind is called in tables.
        name: unique name.
        drive_point: measurement point of the exciter, of several the first.
        channels: channels, in the order of the rows.
        unexcited: parts of its rows that follow no excitation.
        free: it decays without excitation.
        reduced: someone else made its rows; no chain of the bench's own measured them.
        series: what its levels are to each other.
        noise_degrees: degrees of freedom of the variance that the noise was estimated as; infinite where it is stated.
        over_voltage: its rows refer to the voltage.
        locked: the measurement as levels at which a loop held the phase; None of other kinds.
        lines: the measurement as lines of frequency responses; None of other kinds.
        record: the measurement as samples of a record; None of other kinds.
        axis: what its curves are drawn over.
        given_channel: channel at whose amplitudes the model is solved; None where the drive is given.
        imposed_scales: displacement (m) and force (N) of an imposed motion, the largest; None where none was imposed.
        span_s: its first and last moment on the clock of its bag, s; None where it has no rows.
    """

    WORDS: ClassVar[str]
    unexcited: ClassVar[tuple[Part, ...]] = ()
    free: ClassVar[bool] = False
    reduced: ClassVar[bool] = False
    series: ClassVar[LevelSeries] = LevelSeries()

    noise_degrees: float = math.inf

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

    @property
    def over_voltage(self) -> bool:
        """Whether its rows refer to the voltage."""
        return False

    # -- parts ---------------------------------------------------------------------------------------------------------

    @property
    def locked(self) -> LockedLevels | None:
        """The measurement as levels at which a loop held the phase; None without such levels."""
        return None

    @property
    def lines(self) -> ResponseLines | None:
        """The measurement as lines of frequency responses; None of other kinds."""
        return None

    @property
    def record(self) -> Record | None:
        """The measurement as samples of a record; None of other kinds."""
        return None

    @property
    def axis(self) -> CurveAxis:
        """What its curves are drawn over."""
        raise NotImplementedError

    def held_levels(self, observations: Observations, number: int) -> HeldLevels | None:
        """Its levels as complex amplitudes of force and motion; None where it has none."""
        return None

    # -- prediction ----------------------------------------------------------------------------------------------------

    def predictor(self, rows: Rows, settings: PredictionSettings) -> Predictor:
        """What predicts its rows.

        Raises:
            BenchError: the model cannot predict it.
        """
        raise NotImplementedError

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

    @property
    def given_channel(self) -> MeasuredChannel | None:
        """Channel at whose amplitudes the model is solved; None where the drive is given."""
        return None

    def larger(self, share: float) -> Measurement | None:
        """With the motion at which the model is solved larger by a share; None where a gain of the chain covers it."""
        return None

    @property
    def imposed_scales(self) -> tuple[float, float] | None:
        """Displacement (m) and force (N) of an imposed motion, the largest; None where none was imposed."""
        return None

    # -- time and repeats ----------------------------------------------------------------------------------------------

    @property
    def span_s(self) -> tuple[float, float] | None:
        """Its first and last moment on the clock of its bag, s; None where it has no rows."""
        return 0.0, 0.0

    def repeat_key(self, rows: Rows, index: int) -> tuple[object, float]:
        """What a row has in common with that of a repeat: its place in the measurement, and the level of excitation."""
        return round(float(rows.time_s[index]), 9), 0.0


class Driven(Measurement):
    """A measurement that names the point of its exciter, and those of further ones that it sees at rest."""

    resting_points: tuple[int, ...] = ()

    @property
    def drive_points(self) -> tuple[int, ...]:
        """Measurement point of each exciter."""
        return (self.drive_point, *self.resting_points)


@dataclass(frozen=True)
class LockedLevels(Measurement):
    """Levels at which a loop held the phase.

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

    name: str
    drive_points: tuple[int, ...]
    response_channel: str
    channels: tuple[MeasuredChannel, ...]
    harmonics: int
    held: str
    levels: tuple[LockedLevel, ...]
    commanded: bool = False

    @property
    def locked(self) -> LockedLevels | None:
        """Itself; None without levels."""
        return self if self.levels else None

    @property
    def drive_point(self) -> int:
        """Point at which the loop holds its phase."""
        return self.drive_points[0]

    def turned_by(self, channel: str) -> int:
        """Sign by which an error of a channel's phase turns what the loop held; 0 where the loop does not know it."""
        force = next((c.name for c in self.channels if c.quantity is Quantity.FORCE), "")
        return (channel == self.response_channel) - (channel == force)


class ResponseLines(Driven):
    """Lines of frequency responses.

    Attributes:
        reference: what its responses are divided by: ``force``, ``base`` or ``voltage``.
        broad_band: its lines were excited together, over many modes.
        held_amplitude: its responses are compared at the amplitude of their first channel.
        noise_group: words before a channel whose rows share one noise; empty = one noise of all channels.
    """

    broad_band: ClassVar[bool] = False
    held_amplitude: ClassVar[bool] = False
    noise_group: ClassVar[str] = ""

    reference: str

    @property
    def lines(self) -> ResponseLines:
        """Itself."""
        return self

    @property
    def over_force(self) -> bool:
        """Whether its rows are responses over a force, or over what held its amplitude."""
        return self.reference == "force"

    @property
    def divisor(self) -> MeasuredChannel | None:
        """The force that its responses are divided by, where that is none of its channels."""
        return None

    @property
    def modal_hz(self) -> FloatArray | None:
        """Lines of responses that identify modes, Hz, infinite where they do not; None of others."""
        return None

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
        """Its name within its sweep."""
        return self.name

    @property
    def axis(self) -> CurveAxis:
        """Frequency."""
        figures = (
            ("frf", "Frequency responses: magnitude", (Part.LOG_MAGNITUDE,)),
            ("frf-phase", "Frequency responses: phase", (Part.PHASE,)),
        )
        divisor = {"force": "N", "base": "(m/s²)"}.get(self.reference, "V")
        steps: Literal["levels", "lines"] = "lines" if self.broad_band else "levels"
        return CurveAxis(
            "frequency / Hz", "middle of the band / Hz", "frequency_hz", steps=steps, divisor=divisor, figures=figures
        )

    def shifted(self, share: float) -> ResponseLines:
        """With its lines higher by a share."""
        raise NotImplementedError

    def errors(self, rows: Rows, chain: MeasuringChain) -> dict[str, FloatArray]:
        """Errors that its rows alone have, (rows,) each, by name.

        Args:
            rows: magnitudes and phases of its responses.
            chain: tolerances.
        """
        raise NotImplementedError

    def measured_responses(self, level: IntArray, channel: IntArray) -> ComplexArray | None:
        """Measured responses of rows; None where they are compared with a mean of measured and predicted ones."""
        return None

    def traced(self, states: Sequence[Any] | None) -> ResponseLines:
        """With the noise of measured amplitudes propagated as a prediction's solutions say."""
        return self

    def with_scatter(self, before: FloatArray, factor: float, degrees: float) -> ResponseLines:
        """The measurement whose lines scatter by a factor more than some standard deviations, (lines,)."""
        return self


@dataclass(frozen=True)
class Record(Driven):
    """Samples of a record.

    Attributes:
        name: unique name.
        drive_point: measurement point of the exciter.
        sample_rate: of the input, Hz: that of the recording or a whole multiple of it, so fine that the input may be
            taken as straight from sample to sample.
        input_channel: measured input (voltage, force, or an imposed motion).
        input: samples as they were recorded, shape (n,), V, N or the unit of the motion.
        channels: response channels, in the order of the observables.
        segment_bounds: first input sample of each scored segment and the end of the last, shape (segments + 1,).
        start_s: time of the first sample on the clock of its bag, s: an observable of time t is sample
            (t − start_s) · sample_rate of the input.
        noise: what of the input is known to be its noise, shape (n,), in its unit; empty = nothing.
        zeros: standard deviation of the zero of the input and of each channel, shape (1 + channels,), in their units;
            empty = they have none. Where a force drove, the observables are without the mean of their channel, which
            is part of its zero.
        limits: magnitude at which the samples of each channel stay again and again, shape (channels,), in their units;
            0 = nowhere; empty = not looked at.
        head: first samples of the channels, without the same mean, shape (channels, h); empty = it begins at rest.
        head_stride: samples of the input from one of these to the next.
        begins_in_motion: whether the model may not start at rest.
        followed: further channels, which a force may follow, at the samples of the input, by what they are.
        responses: the channels as they were recorded, shape (channels, samples); empty = not kept.
        motion: displacement, velocity and acceleration of the drive point, where that was moved, at the samples of the
            input, shape (3, n), m, m/s, m/s²; empty = forces drove.
        gain_std: relative standard uncertainty of the gain of that motion and of each channel.
        frequency_hz: middle frequency of that motion, rms velocity over rms displacement, Hz.
        size: half of the span of that displacement, m.
        force_n: largest measured force, N.
        force: measured force at the recorded samples, N; NaN where it is not an observable.
    """

    name: str
    drive_point: int
    sample_rate: float
    input_channel: MeasuredChannel
    input: FloatArray
    channels: tuple[MeasuredChannel, ...]
    segment_bounds: FloatArray
    start_s: float = 0.0
    noise: FloatArray = field(default_factory=lambda: np.zeros(0))
    zeros: FloatArray = field(default_factory=lambda: np.zeros(0))
    limits: FloatArray = field(default_factory=lambda: np.zeros(0))
    head: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    head_stride: int = 1
    begins_in_motion: bool = False
    followed: dict[str, FloatArray] = field(default_factory=dict)
    responses: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    motion: FloatArray = field(default_factory=lambda: np.zeros((3, 0)))
    gain_std: float = 0.0
    frequency_hz: float = math.nan
    size: float = math.nan
    force_n: float = math.nan
    force: FloatArray = field(default_factory=lambda: np.zeros(0))

    @property
    def record(self) -> Record:
        """Itself."""
        return self

    @property
    def band_hz(self) -> tuple[float, float]:
        """Frequencies between which it has power, Hz: of its channels, or of its input where they are not kept."""
        rate = self.sample_rate / (self.head_stride if self.responses.size else 1)
        bands = [occupied_band(row, rate) for row in (self.responses if self.responses.size else (self.input,))]
        return min(low for low, _ in bands), max(high for _, high in bands)

    @property
    def signals(self) -> dict[str, FloatArray]:
        """Measured channels that the strength of a force may follow, at the samples of the input, (n,) each."""
        return with_magnitudes(self.followed)

    @property
    def span_s(self) -> tuple[float, float] | None:
        """Its beginning on the clock of its bag, s; its end is not kept."""
        return self.start_s, 0.0

    @property
    def axis(self) -> CurveAxis:
        """Time."""
        figures = (("record", "Record", (Part.SAMPLE,)),)
        return CurveAxis("time / s", "segment", "time_s", steps="", figures=figures)

    def errors(
        self, rows: Rows, rig: Rig, cache: PartsCache, settings: PredictionSettings, chain: MeasuringChain | None
    ) -> tuple[dict[str, FloatArray], dict[str, float]]:
        """Zeros, gains and beginning of the record, (rows,) each, and standard deviations of the zeros, by name."""
        names = (self.input_channel.name, *(channel.name for channel in self.channels))
        zeros = {f"zero of {it} in {self.name}": float(std) for it, std in zip(names, self.zeros, strict=False)}
        return self.predictor(rows, settings).errors(rig, cache, chain), zeros


def occupied_band(samples: FloatArray, sample_rate: float) -> tuple[float, float]:
    """Frequencies below and above which samples, (n,), have a hundredth of their power, Hz."""
    frequency, power = welch(samples - samples.mean(), sample_rate, nperseg=min(samples.size, 1024))
    share = np.cumsum(power) / max(float(np.sum(power)), 1e-300)
    low, high = np.searchsorted(share, (_BEYOND_BAND, 1.0 - _BEYOND_BAND))
    return float(frequency[low]), float(frequency[: high + 1][-1])


_BEYOND_BAND = 0.01
"""Share of the power of samples on either side of their band."""


def axis_of_amplitudes(channel: MeasuredChannel, amplitudes: FloatArray) -> CurveAxis:
    """Amplitudes of a channel, one for each level, (k,)."""
    label = f"{channel.quantity.name.lower()} amplitude / {channel.unit}"
    return CurveAxis(label, label, nodes=amplitudes)


def locked_levels(tests: Iterable[Measurement]) -> list[LockedLevel]:
    """Levels of all tests at which a loop held the phase."""
    return [level for test in tests if test.locked is not None for level in test.locked.levels]


def is_broad_band(test: Measurement) -> bool:
    """Whether its rows are lines that were excited together."""
    return test.lines is not None and test.lines.broad_band


def holds_amplitude(test: Measurement) -> bool:
    """Whether its rows are responses that are compared at the amplitude of their first channel."""
    return test.lines is not None and test.lines.held_amplitude


def with_levels(tests: Iterable[Measurement], change: Callable[[LockedLevel], LockedLevel]) -> tuple[Measurement, ...]:
    """Tests with every locked level changed; the others stay the same objects."""
    return tuple(
        test if test.locked is None else replace(test.locked, levels=tuple(map(change, test.locked.levels)))
        for test in tests
    )


@dataclass(frozen=True)
class Observations:
    """All observables of a real side.

    Attributes:
        tests: the tests, in the order of ``rows.test``.
        rows: identity of the observables.
        values: measured values, shape (m,).
        std: standard uncertainty of each (noise; no model floor), shape (m,).
        floor: standard deviation between repeats of the same test, or from the finite accuracy of estimator, lock and
            model, shape (m,).
        notes: sentences on what was found, left out and why (shown to the user).
        inputs: bags with their SHA-256.
        chains: tolerances of the measuring chain of each test, None = it measures as the rig file says; may be empty.
        origins: what made each of ``inputs``; may be empty.
        matters: smallest relative size of a difference that matters, by kind (frequency, damping, response,
            harmonics); empty = a model may not be off at all.
    """

    tests: tuple[Measurement, ...]
    rows: Rows
    values: FloatArray
    std: FloatArray
    floor: FloatArray
    notes: tuple[str, ...] = ()
    inputs: tuple[tuple[str, str], ...] = ()
    chains: tuple[MeasuringChain | None, ...] = ()
    origins: tuple[Origin, ...] = ()
    matters: Mapping[str, float] = field(default_factory=dict)

    @property
    def turns(self) -> bool:
        """Whether angles and torques were recorded."""
        return any(channel.turns for test in self.tests for channel in test.channels)

    @property
    def sigma(self) -> FloatArray:
        """What residuals are divided by, √(std² + floor²), shape (m,)."""
        return np.hypot(self.std, self.floor)

    def take(self, which: NDArray[np.bool_] | IntArray) -> Observations:
        """Part of the observations; the tests stay as they are."""
        return Observations(
            self.tests, self.rows.take(which), self.values[which], self.std[which], self.floor[which], self.notes,
            self.inputs, self.chains, self.origins, self.matters,
        )  # fmt: skip


def joined(parts: Sequence[Observations]) -> Observations:
    """Several sets of observations as one; tests are renumbered."""
    tests: list[Measurement] = []
    rows: list[Rows] = []
    for part in parts:
        shifted = {name: getattr(part.rows, name) for name in Rows.__dataclass_fields__}
        shifted["test"] = part.rows.test + len(tests)
        rows.append(Rows(**shifted))
        tests.extend(part.tests)
    columns = [np.concatenate([getattr(row, name) for row in rows]) for name in Rows.__dataclass_fields__]
    return Observations(
        tuple(tests),
        Rows(*columns),
        np.concatenate([part.values for part in parts]),
        np.concatenate([part.std for part in parts]),
        np.concatenate([part.floor for part in parts]),
        tuple(note for part in parts for note in part.notes),
        tuple(item for part in parts for item in part.inputs),
        tuple(chain for part in parts for chain in (part.chains or (None,) * len(part.tests))),
        tuple(origin for part in parts for origin in part.origins),
    )


class RowTable:
    """Observables of one test, in the order in which they are added."""

    def __init__(self) -> None:
        self._identity: list[tuple[float, ...]] = []
        self._numbers: list[tuple[float, float, float]] = []

    def __len__(self) -> int:
        return len(self._numbers)

    def add(
        self, part: Part, value: float, std: float, floor: float, place: Place, channel: int = -1, harmonic: int = -1
    ) -> None:
        """One observable; channel and harmonic are −1 where it belongs to none."""
        self._identity.append(
            (place.level, channel, harmonic, int(part), place.time_s, place.frequency_hz, place.amplitude)
        )
        self._numbers.append((value, std, floor))

    def observations(self, test: Measurement, notes: Sequence[str] = ()) -> Observations:
        """The rows as observations of one test; rows that are not finite are left out."""
        identity = np.array(self._identity, dtype=np.float64).reshape(-1, 7)
        numbers = np.array(self._numbers, dtype=np.float64).reshape(-1, 3)
        level, channel, harmonic, part = (identity[:, column].astype(np.int64) for column in range(4))
        time_s, frequency_hz, amplitude = (identity[:, column].copy() for column in (4, 5, 6))
        number = np.zeros(len(self), dtype=np.int64)
        rows = Rows(number, level, channel, harmonic, part, time_s, frequency_hz, amplitude)
        result = Observations((test,), rows, numbers[:, 0], numbers[:, 1], numbers[:, 2], tuple(notes))
        usable: NDArray[np.bool_] = np.asarray(np.isfinite(numbers).all(axis=1))
        return result if usable.all() else result.take(usable)


def empty(notes: Sequence[str] = ()) -> Observations:
    """No observables, only notes."""
    real = np.zeros(0)
    return Observations((), no_rows(), real, real, real, tuple(notes))
