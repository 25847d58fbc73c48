"""Backbones that someone else has reduced, and those of windows without a force: frequency and damping over amplitude.

The model predicts phase resonance at given amplitudes of a response, and the damping ratio of its power balance.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import FloatArray
from nmt_core.vocabulary import MOTIONS, TestKind
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.measurements.locked_prediction import PeriodicLevels
from nmt_diagnose.measurements.measurement import (
    CurveAxis,
    Driven,
    HeldLevels,
    LevelSeries,
    LockedLevel,
    LockedLevels,
    Observations,
    RowTable,
    axis_of_amplitudes,
    empty,
    joined,
)
from nmt_diagnose.observations.bag_windows import BagWindow, BagWindows
from nmt_diagnose.observations.model_view import ModelView, nearest_ratio
from nmt_diagnose.observations.noise.scatter import neighbour_cubics
from nmt_diagnose.observations.observables import Part, Place, Rows
from nmt_diagnose.observations.observation_settings import ObservationSettings
from nmt_diagnose.observations.tables_together import TablesTogether
from nmt_diagnose.prediction.parts_cache import PartsCache
from nmt_diagnose.prediction.periodic_state import PeriodicState
from nmt_diagnose.prediction.prediction_settings import PredictionSettings
from nmt_diagnose.prediction.resting_motion import Motion, mode_under_test, motion_at_amplitudes
from nmt_diagnose.prediction.rig_parts import RigParts
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_record.exchange.reduced.observables import ObservableTable
from nmt_record.exchange.sidecar.import_sidecar import TableKind
from nmt_rig.model.linear_modes import damped_modes
from nmt_rig.rig import Rig, ShakerSection
from nmt_signals.harmonics import harmonic_amplitudes
from nmt_signals.sine_fit import fit_frequency


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
    series: ClassVar[LevelSeries] = LevelSeries(ranked=True, interleaved=True, rising=True)

    name: str
    drive_point: int
    channel: MeasuredChannel
    amplitudes: FloatArray
    noise_degrees: float = math.inf

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

    @property
    def axis(self) -> CurveAxis:
        """Amplitude of its channel."""
        return axis_of_amplitudes(self.channel, self.amplitudes)

    def held_levels(self, observations: Observations, number: int) -> HeldLevels | None:
        """Its amplitudes as levels."""
        return levels_over_amplitude(self.drive_points, self.channels, self.amplitudes, observations, number)


# -- predictor -----------------------------------------------------------------------------------------------------


class BackbonePredictor(PeriodicLevels):
    """Predicts a backbone: frequency and damping over the amplitude of a response.

    A table is the nonlinear mode's own, as from free decays: only the sensor of the amplitudes has a part in it.
    The damping ratio is that of the method, δ̃ = P₁ / (ω̃³ φ̃ᴴ M φ̃) with the structure's own mass matrix.

    Args:
        test: the table.
        rows: its rows.
        settings: of the predictor.
    """

    def __init__(self, test: BackboneTable, rows: Rows, settings: PredictionSettings) -> None:
        levels = []
        for position, amplitude in enumerate(test.amplitudes):
            frequency_hz = rows.frequency_hz[rows.level == position]
            frequency = float(frequency_hz[0]) if frequency_hz.size else np.nan
            levels.append(LockedLevel(position, float(amplitude), 0.0, 0.0, frequency, 0.0, 0.0, 0.0, 1))
        probe = MeasuredChannel("motion", Quantity.DISPLACEMENT, test.drive_point, ideal=True)
        force = MeasuredChannel("force", Quantity.FORCE, test.drive_point, ideal=True)
        channels = tuple(dict.fromkeys((test.channel, force, probe)))
        inner = LockedLevels(
            test.name, test.drive_points, probe.name, channels, settings.harmonics, "response", tuple(levels)
        )
        super().__init__(inner, rows, settings)

    def values(self, rig: Rig, cache: PartsCache, states: Sequence[Any]) -> FloatArray:
        """Observables of the test's rows."""
        count = len(self.levels)
        log_omega, damping = np.full(count, np.nan), np.full(count, np.nan)
        groups: dict[int, tuple[RigParts, list[int]]] = {}
        for position, state in enumerate(states):
            if state is not None and state.omega > 0.0:  # one Newton step may lead anywhere
                log_omega[position] = np.log(state.omega / (1.0 + rig.clock_error))
                parts = self.parts(rig, cache, self.levels[position])
                groups.setdefault(id(parts), (parts, []))[1].append(position)
        if np.any(self.rows.part == Part.DAMPING):
            for parts, positions in groups.values():
                solved = [state for position in positions if (state := states[position]) is not None]
                damping[positions] = self._damping(rig, parts, solved)
        result = np.full(len(self.rows), np.nan)
        for kind, values in ((Part.LOG_FREQUENCY, log_omega), (Part.DAMPING, damping)):
            which = self.rows.part == kind
            result[which] = values[self.rows.level[which]]
        return result

    def _damping(self, rig: Rig, parts: RigParts, states: Sequence[PeriodicState]) -> FloatArray:
        """Damping ratios of some levels of one rig, (levels,)."""
        shapes, force = self.fundamental_unknowns(parts, states)
        omega = np.array([state.omega for state in states])
        system = parts.system
        n = system.structure_size
        mass = system.mass[:n, :n]
        if isinstance(rig.exciter, ShakerSection):
            drive = system.selector(system.drive_point)[:n]
            mass = mass - rig.exciter.table_mass_kg * np.outer(drive, drive)
        velocity = 1j * omega * np.array([system.motion(system.drive_point, shape) for shape in shapes])
        power = 0.5 * (velocity * np.conj(force)).real
        moving = np.einsum("la,ab,lb->l", np.conj(shapes[:, :n]), mass, shapes[:, :n]).real
        return np.asarray(power / (omega**3 * moving))


# -- reading -------------------------------------------------------------------------------------------------------


def backbone_observations(tables: TablesTogether) -> Observations | None:
    """Observables of a backbone that someone else has reduced; None of other tables."""
    name, table, view, settings = tables.name, tables.tables[0], tables.view, tables.settings
    if table.kind != TableKind.BACKBONE:
        return None
    frequency, amplitude = table.columns["frequency_hz"], table.columns["amplitude"]
    good = np.isfinite(frequency) & (frequency > 0.0) & np.isfinite(amplitude) & (amplitude > 0.0)
    if not good.any():
        return empty((f"{name}: left out: it has no row with frequency and amplitude.",))
    ratios = [nearest_ratio(float(value), view.frequencies_hz) for value in frequency[good]]
    if all(max(ratio, 1.0 / ratio) > THRESHOLDS.reading.wrong_frequency_ratio for ratio in ratios):
        return empty((f"{name}: left out: its frequencies lie at no mode of the model {view.rig.name}.",))
    damping, damping_std = table.column("damping_ratio"), table.column("damping_ratio_std")
    frequency_std = table.column("frequency_hz_std")
    floors = settings.floors
    rows = RowTable()
    where = np.flatnonzero(good)
    unstated = max(floors.table_log_frequency, scatter_about_a_course(amplitude[good], np.log(frequency[good])))
    scatter = _scatter_of_damping(amplitude[good], damping[good])
    notes = [] if good.all() else [f"{name}: {int((~good).sum())} of {good.size} rows have no value and are left out."]
    # A relative uncertainty has no meaning at a damping of 0: there it refers to the model's damping.
    model_damping = _damping_near(view, float(np.median(frequency[where])))
    for level, index in enumerate(where):
        place = Place(level, 0.0, float(frequency[index]), float(amplitude[index]))
        stated = frequency_std[index] / frequency[index]
        known = math.isfinite(stated) and stated > 0.0
        rows.add(
            Part.LOG_FREQUENCY, math.log(2.0 * math.pi * frequency[index]), stated if known else 0.0,
            floors.log_frequency if known else unstated, place, 0, 1,
        )  # fmt: skip
        if math.isfinite(damping[index]):
            known = math.isfinite(damping_std[index]) and damping_std[index] > 0.0
            share = floors.decay_damping if known else max(floors.table_damping, scatter)
            rows.add(
                Part.DAMPING, float(damping[index]), float(damping_std[index]) if known else 0.0,
                share * (abs(float(damping[index])) or model_damping), place, 0, 1,
            )  # fmt: skip
    degrees = math.inf
    if np.any(damping[where] == 0.0):
        notes.append(f"{name}: a damping of 0 is that of a motion that something drives, such as a limit cycle.")
    if not np.any(np.isfinite(frequency_std[where])):
        degrees = where.size / (2.0 * THRESHOLDS.noise.cubic_relative_std**2)
        notes.append(f"{name}: no uncertainties are given; {100 * unstated:.2g} % is taken for every frequency.")
    test = BackboneTable(name, view.rig.drive_point, tables.channels[0], amplitude[where].copy(), degrees)
    return rows.observations(test, notes)


def _damping_near(view: ModelView, frequency_hz: float) -> float:
    """Damping ratio of the model's mode nearest to a frequency, Hz."""
    poles = damped_modes(view.system).eigenvalues
    poles = poles[poles.imag > 0.0]
    if not poles.size:
        return 0.0
    nearest = poles[np.argmin(np.abs(np.log(np.abs(poles) / (2.0 * math.pi * frequency_hz))))]
    return float(-nearest.real / abs(nearest))


def _scatter_of_damping(amplitude: FloatArray, damping: FloatArray) -> float:
    """Relative scatter of damping ratios about a smooth course over the amplitude; 0 where some are not positive."""
    known = np.isfinite(damping)
    if not known.any() or np.any(damping[known] <= 0.0):
        return 0.0
    return scatter_about_a_course(amplitude[known], np.log(damping[known]))


def scatter_about_a_course(x: FloatArray, y: FloatArray) -> float:
    """Standard deviation of y about a smooth course over x: each point against the cubic through its four neighbours.

    Args:
        x: places, any order, shape (n,).
        y: values, shape (n,).

    Returns:
        The standard deviation; 0 for fewer than seven different places.
    """
    x, first = np.unique(x, return_index=True)
    y = y[first]
    if x.size < THRESHOLDS.noise.table_fewest_for_scatter:
        return 0.0
    middle, near, weights = neighbour_cubics(x)
    residual = y[middle] - np.sum(weights * y[near], axis=1)
    return math.sqrt(float(np.mean(residual**2 / (1.0 + np.sum(weights**2, axis=1)))))


# -- unforced ------------------------------------------------------------------------------------------------------

_PARTS = 6
"""Parts of a window whose scatter gives the uncertainty of its frequency."""


def unforced_observations(bag: BagWindows) -> list[Observations]:
    """Observables of windows of phase resonance of one exciter that no force was recorded of; takes them out.

    Several exciters hold a mode among neighbours by the ratio of their forces, which a backbone of one point lacks.
    """
    windows = [
        segment for segment in bag.of_kind(TestKind.PHASE_RESONANCE) if segment.stretch.find(Quantity.FORCE) is None
    ]
    if not windows or len(bag.model.all_exciters) > 1:
        return []
    name = bag.part_named(windows, "unforced")
    found = _backbone(name, windows, bag)
    bag.note_few_levels(name, len(found.rows))
    bag.take(windows)
    return [found]


def _backbone(name: str, windows: Sequence[BagWindow], bag: BagWindows) -> Observations:
    """Rows of a backbone, one a window: frequency of the motion at the amplitude of its fundamental, and no damping.

    At phase resonance, forced or in a limit cycle, that is the frequency of the nonlinear mode; the power that it takes
    cannot be known without a force.
    """
    view, settings = bag.view, bag.settings
    notes, rows = [], []
    responses = [c for c in bag.channels.values() if c.quantity in MOTIONS]
    if not responses:
        return empty((f"{name}: left out: it has no response channel that the model {view.rig.name} has too.",))
    at_drive = [c for c in responses if c.point == view.rig.drive_point]
    channel = (at_drive or responses)[0]
    for window in windows:
        segment, stretch = window.segment, window.stretch
        where = f"{name}: level {segment.level_index}"
        if channel.name in stretch.faults or channel.name not in [c.name for c in stretch.channels]:
            notes.append(f"{where} is left out: it lacks channel {channel.name}.")
            continue
        signal = stretch.row(channel.name)
        try:
            rows.append(_row(signal - float(np.mean(signal)), stretch.sample_rate, segment.frequency_hz, settings))
        except BenchError as error:
            notes.append(f"{where} is left out: its motion tells no frequency ({str(error).rstrip('.')}).")
    if not rows:
        return empty(notes)
    notes.append(f"{name}: no force was recorded, so that it tells frequencies over amplitudes and no damping.")
    columns = dict(zip(("frequency_hz", "frequency_hz_std", "amplitude"), np.array(rows).T, strict=True))
    units = {"amplitude": "rad" if channel.turns else "m"}
    table = ObservableTable(
        TableKind.BACKBONE, columns, units, channel.quantity, point=channel.point, drive_point=view.rig.drive_point
    )
    driven = ModelView.of(view.rig, (view.rig.drive_point,))
    found = backbone_observations(TablesTogether(name, (table,), driven, (channel,), settings))
    return joined([empty(notes), *([] if found is None else [found])])


def _row(signal: FloatArray, rate: float, guess_hz: float, settings: ObservationSettings) -> tuple[float, float, float]:
    """Frequency and its standard uncertainty, Hz, and amplitude of the fundamental."""
    if not np.ptp(signal) > 0.0:
        raise BenchError("it stands still")
    frequency = fit_frequency(signal, rate, guess_hz)
    periods = signal.size * frequency / rate
    if periods < settings.fewest_periods:
        raise BenchError(f"{periods:.1f} periods, of at least {settings.fewest_periods}")
    cycles = np.arange(signal.size, dtype=np.float64) * frequency / rate
    amplitude = abs(harmonic_amplitudes(cycles, signal[None, :], 3)[0, 1])
    parts = [fit_frequency(part, rate, frequency) for part in np.array_split(signal, min(_PARTS, int(periods // 2)))]
    return frequency, float(np.std(parts, ddof=1)) / math.sqrt(len(parts)), float(amplitude)


# -- levels ----------------------------------------------------------------------------------------------------------

_MOST_NODES = 12
"""Amplitudes of a decay or a table: more say the same again."""


def levels_over_amplitude(
    drive_points: tuple[int, ...],
    channels: tuple[MeasuredChannel, ...],
    amplitudes: FloatArray,
    observations: Observations,
    number: int,
) -> HeldLevels | None:
    """Amplitudes of a decay or a table as levels, spread evenly over the logarithm of the amplitude.

    Args:
        drive_points: measurement point of each exciter.
        channels: the first is the one of the amplitudes.
        amplitudes: in its unit, (k,).
        observations: the real side.
        number: of the measurement.
    """
    if channels[0].quantity not in MOTIONS:
        return None
    rows, here, count = observations.rows, observations.rows.test == number, len(amplitudes)
    found = {part: (np.full(count, np.nan), np.full(count, np.nan)) for part in (Part.LOG_FREQUENCY, Part.DAMPING)}
    for part, (value, std) in found.items():
        where = here & (rows.part == part)
        value[rows.level[where]], std[rows.level[where]] = observations.values[where], observations.sigma[where]
    (log_omega, log_std), (ratio, ratio_std) = found[Part.LOG_FREQUENCY], found[Part.DAMPING]
    values, std = np.full((count, len(channels), 2), np.nan, complex), np.full((count, len(channels), 2), np.nan)
    values[:, 0, 1], std[:, 0, 1] = amplitudes, 0.0
    for channel in range(1, len(channels)):
        for part in (Part.LOG_MAGNITUDE, Part.PHASE):
            where = here & (rows.part == part) & (rows.channel == channel)
            level, value = rows.level[where], observations.values[where]
            known = values[level, channel, 1] if part is Part.PHASE else 1.0
            values[level, channel, 1] = known * np.exp(value if part is Part.LOG_MAGNITUDE else 1j * value)
            std[level, channel, 1] = np.abs(values[level, channel, 1]) * observations.sigma[where]
    omega = np.exp(log_omega)
    scale = (1j * omega[:, None, None]) ** np.array([MOTIONS[c.quantity] for c in channels])[None, :, None]
    values[:, :, 0], std[:, :, 0] = 0.0, 0.0
    usable = np.flatnonzero(np.isfinite(omega) & np.isfinite(ratio) & (np.asarray(amplitudes) > 0.0))
    if not usable.size:
        return None
    order = usable[np.argsort(np.asarray(amplitudes)[usable], kind="stable")]
    spots = np.linspace(0, order.size - 1, min(order.size, _MOST_NODES)).round().astype(int)
    chain = observations.chains[number] if observations.chains else None
    chosen = [int(k) for k in order[spots]]
    complete = np.flatnonzero(np.isfinite(values[chosen]).all(axis=(0, 2)))
    with np.errstate(invalid="ignore"):  # amplitudes that are held out have no frequency
        values, std = (values / scale)[:, complete], (std / np.abs(scale))[:, complete]
    levels = HeldLevels(
        observations.tests[number].name, drive_points, tuple(range(count)), omega,
        np.zeros((1, count, 2), complex), np.zeros((1, count)),
        tuple(channels[int(k)] for k in complete), values, std,
        chain, ratio, np.hypot(log_std, ratio_std),
    )  # fmt: skip
    return levels.take(chosen)
