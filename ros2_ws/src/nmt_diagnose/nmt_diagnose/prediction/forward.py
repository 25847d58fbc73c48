"""Predicts the observables of a set of tests for any rig, and how they change with its parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nmt_core.errors import BenchError
from nmt_core.numerics.arrays import FloatArray
from nmt_diagnose.effects.parametrisation import Parametrisation
from nmt_diagnose.measurements.backbone_table.backbone_table import BackboneTable
from nmt_diagnose.measurements.backbone_table.predictor import BackbonePredictor
from nmt_diagnose.measurements.driven_record.driven_record import DrivenRecord
from nmt_diagnose.measurements.driven_record.predictor import RecordPredictor
from nmt_diagnose.measurements.imposed_motion.imposed_motion import ImposedMotion
from nmt_diagnose.measurements.imposed_motion.predictor import ImposedMotionPredictor
from nmt_diagnose.measurements.locked_windows.locked_windows import LockedWindows
from nmt_diagnose.measurements.locked_windows.predictor import PhaseResonancePredictor
from nmt_diagnose.measurements.measurement import Measurement
from nmt_diagnose.measurements.random_responses.predictor import RandomPredictor
from nmt_diagnose.measurements.random_responses.random_responses import RandomResponses
from nmt_diagnose.measurements.recorded_decay.predictor import RingDownPredictor
from nmt_diagnose.measurements.recorded_decay.recorded_decay import RecordedDecay
from nmt_diagnose.measurements.stepped_responses.predictor import SteppedSinePredictor, with_growth
from nmt_diagnose.measurements.stepped_responses.stepped_responses import SteppedResponses
from nmt_diagnose.observations.observables import Part, Rows
from nmt_diagnose.prediction.influence import Source, SourceColumn, random_influence, resonance_influence
from nmt_diagnose.prediction.parts_cache import PartsCache, joint_setup
from nmt_diagnose.prediction.prediction_settings import PredictionSettings
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_rig.rig import Rig, SensorSection

_OF_THE_CHANNEL = (Part.LINE, Part.STEP, Part.LIMIT, Part.REPEATS)
_PREDICTORS: dict[type, type] = {
    LockedWindows: PhaseResonancePredictor,
    RandomResponses: RandomPredictor,
    SteppedResponses: SteppedSinePredictor,
    RecordedDecay: RingDownPredictor,
    ImposedMotion: ImposedMotionPredictor,  # a record, too
    DrivenRecord: RecordPredictor,
    BackboneTable: BackbonePredictor,
}


@dataclass(frozen=True)
class Prediction:
    """Observables of the model.

    Attributes:
        values: (m,), NaN where the model has no solution.
        converged: (m,) whether a row's level was solved.
        reasons: sentences, one per level that was not.
        states: solution of each test, start of the next prediction.
    """

    values: FloatArray
    converged: NDArray[np.bool_]
    reasons: tuple[str, ...]
    states: tuple[Any, ...] = field(repr=False, default=())


class Forward:
    """The predictor of a set of tests.

    Args:
        tests: conditions of the tests.
        rows: identity of the observables.
        settings: of the predictor.

    Raises:
        BenchError: a test that the predictor cannot predict.
    """

    def __init__(self, tests: Sequence[Measurement], rows: Rows, settings: PredictionSettings | None = None) -> None:
        self.tests = tuple(tests)
        self.rows = rows
        self.settings = PredictionSettings() if settings is None else settings
        self._phases = np.flatnonzero(np.isin(rows.part, (Part.PHASE, Part.PHASE_ERROR)))
        self._where = [np.flatnonzero(rows.test == index) for index in range(len(self.tests))]
        self._twins: list[Any] = [
            self._twin(test, rows.take(where)) for test, where in zip(self.tests, self._where, strict=True)
        ]
        # Rows that follow no excitation, with the names of their channels.
        self._steps = self._unexcited(Part.STEP, LockedWindows)
        self._limits = self._unexcited(Part.LIMIT, LockedWindows)
        self._repeats = self._unexcited(Part.REPEATS, LockedWindows)
        self._lines = self._unexcited(Part.LINE, LockedWindows, RandomResponses, DrivenRecord)

        # Tests with one drive point share one linear model.
        groups: dict[tuple[tuple[int, ...], bool], list[Any]] = {}
        for predictor in self._twins:
            groups.setdefault((predictor.setup.drive_points, predictor.setup.ideal_force), []).append(predictor)
        for group in groups.values():
            shared = joint_setup(predictor.setup for predictor in group)
            for predictor in group:
                predictor.use(shared)

    def _twin(self, test: Measurement, rows: Rows) -> Any:
        for kind, predictor in _PREDICTORS.items():
            if isinstance(test, kind):
                return predictor(test, rows, self.settings)
        raise BenchError(f"the diagnosis' model cannot predict a test of kind {type(test).__name__}.")

    def _unexcited(
        self, part: Part, *kinds: type[LockedWindows | RandomResponses | DrivenRecord]
    ) -> list[tuple[int, str]]:
        found = []
        for row in np.flatnonzero(self.rows.part == part):
            test = self.tests[self.rows.test[row]]
            if isinstance(test, kinds):
                found.append((int(row), test.channels[self.rows.channel[row]].name))
        return found

    def predict(self, rig: Rig, start: Prediction | None = None) -> Prediction:
        """Observables of a rig; ``start`` is a prediction for a similar one, whose solutions are started from.

        Raises:
            BenchError: the rig does not fit the tests, or has something the predictor does not cover.
        """
        cache = PartsCache(self.settings)
        values = np.full(len(self.rows), np.nan)
        states: list[Any] = []
        reasons: list[str] = []
        for index, (predictor, where) in enumerate(zip(self._twins, self._where, strict=True)):
            if hasattr(predictor, "solve"):
                solved = predictor.solve(rig, cache, start.states[index] if start is not None else None)
                values[where] = predictor.values(rig, cache, solved)
                states.append(tuple(solved))
                reasons += _unsolved(predictor, solved)
            else:
                values[where] = predictor.values(rig, cache)
                states.append(None)
        self._add_unexcited(rig, values)
        return Prediction(values, np.isfinite(values), tuple(reasons), tuple(states))

    def _tangents(self, rig: Rig, prediction: Prediction, cache: PartsCache) -> list[Any]:
        """What each test's solutions need to follow small changes of the rig; None where the test has its own way."""
        return [
            predictor.tangent(rig, cache, prediction.states[index]) if hasattr(predictor, "tangent") else None
            for index, predictor in enumerate(self._twins)
        ]

    def _stepped(self, rig: Rig, prediction: Prediction, cache: PartsCache, tangents: Sequence[Any] = ()) -> FloatArray:
        """Observables of a slightly different rig, one Newton step from a prediction's solutions.

        ``tangents`` are those of the rig of the prediction; without them the step is by the other rig's own Jacobian.
        """
        values = np.full(len(self.rows), np.nan)
        for index, (predictor, where) in enumerate(zip(self._twins, self._where, strict=True)):
            if hasattr(predictor, "solve"):
                tangent = tangents[index] if tangents else None
                states = None if tangent is None else predictor.advanced(rig, cache, tangent)
                if states is None:
                    states = predictor.stepped(rig, cache, prediction.states[index])
                values[where] = predictor.values(rig, cache, states)
            else:
                values[where] = predictor.values(rig, cache)
        self._add_unexcited(rig, values)
        return values

    def _add_unexcited(self, rig: Rig, values: FloatArray) -> None:
        """What follows no excitation: hum by the rig's clock, steps, limits and lost samples of converters."""
        sensors: dict[str, SensorSection] = {}
        for sensor in rig.sensors:
            sensors.setdefault(rig.sensor_channel(sensor), sensor)
        for row, name in self._steps:
            model_sensor = sensors.get(name)
            values[row] = (
                2.0 * model_sensor.range / 2.0**model_sensor.bits
                if model_sensor is not None and model_sensor.bits and model_sensor.range
                else 0.0
            )
        for row, name in self._limits:
            model_sensor = sensors.get(name)
            levels = (
                [level for level in (model_sensor.clip, model_sensor.range) if level is not None]
                if model_sensor is not None
                else []
            )
            values[row] = 1.0 / min(levels) if levels else 0.0
        for row, _ in self._repeats:
            values[row] = 0.0  # a model that loses samples is refused
        for row, name in self._lines:
            model_sensor = sensors.get(name)
            values[row] = 0.0
            if model_sensor is not None and model_sensor.hum_amplitude != 0.0:
                apparent_hz = model_sensor.hum_hz / (1.0 + rig.clock_error)
                if abs(self.rows.frequency_hz[row] / apparent_hz - 1.0) < THRESHOLDS.prediction.line_width:
                    values[row] = model_sensor.hum_amplitude

    def jacobian(
        self,
        parametrisation: Parametrisation,
        theta: FloatArray,
        prediction: Prediction,
        which: Sequence[int] | None = None,
        step: float = 1e-6,
    ) -> FloatArray:
        """∂(observables)/∂θ, (m, n), or of the columns ``which``.

        One Newton step from the solved levels at θ + step: by the implicit function theorem this is the derivative up
        to the order of the step; no level is solved again.

        Args:
            parametrisation: maps θ to rigs.
            theta: (n,) where ``prediction`` was made.
            prediction: of ``parametrisation.rig(theta)``.
            which: columns; all when None.
            step: in prior standard deviations.
        """
        columns = range(len(parametrisation.names)) if which is None else which
        result = np.empty((len(self.rows), len(columns)))
        # A step from the unchanged rig takes the rest of the iteration out of the difference.
        known = PartsCache(self.settings)
        rig = parametrisation.rig(theta)
        tangents = self._tangents(rig, prediction, known)
        base = self._stepped(rig, prediction, known, tangents)
        for position, column in enumerate(columns):
            moved = np.array(theta, dtype=np.float64)
            size = step * parametrisation.prior_std[column]
            moved[column] += size
            stepped = self._stepped(parametrisation.rig(moved), prediction, PartsCache(self.settings, known), tangents)
            result[:, position] = self.difference(stepped, base) / size
        return result

    def influence(
        self, rig: Rig, prediction: Prediction, source: Source
    ) -> tuple[FloatArray, tuple[SourceColumn, ...]]:
        """Response of all rows to unit sources at a place, linearised about a prediction.

        Args:
            rig: the rig of ``prediction``.
            prediction: solved levels.
            source: where they sit; the number of a channel in each test is looked up by its name.

        Returns:
            (m, s) and what each of the s columns is the response to. A unit is 1 % of the fundamental force, or of the
            channel's fundamental; 1 % of phase (rad); for a drift a change by 1 % per 100 s.
        """
        cache = PartsCache(self.settings)
        blocks: list[FloatArray] = []
        names: list[SourceColumn] = []
        if source.kind == "time":
            return self._time_influence(rig, prediction)
        for index, (predictor, where) in enumerate(zip(self._twins, self._where, strict=True)):
            columns: FloatArray = np.zeros((where.size, 0))
            labels: list[SourceColumn] = []
            if source.kind == "controller":
                if isinstance(predictor, PhaseResonancePredictor):
                    held = predictor.rows.part == Part.PHASE_ERROR
                    levels = range(len(predictor.levels))
                    columns = np.stack([0.01 * (held & (predictor.rows.level == level)) for level in levels], axis=1)
                    labels = [SourceColumn(predictor.test.name, "level", level) for level in levels]
            elif isinstance(predictor, PhaseResonancePredictor | RandomPredictor):
                here = source
                if source.kind == "response_sensor":
                    known = [channel.name for channel in predictor.test.channels]
                    if source.channel not in known:
                        continue
                    here = replace(source, index=known.index(source.channel))
                if isinstance(predictor, PhaseResonancePredictor):
                    states = prediction.states[index]
                    columns, labels = resonance_influence(predictor, rig, cache, states, here, self.settings)
                    # Lines and steps follow no excitation: only an error of their own channel adds to them.
                    columns[np.isin(predictor.rows.part, _OF_THE_CHANNEL)] = 0.0
                    direct, more = _channel_sources(predictor, states, here)
                    columns, labels = np.hstack((columns, direct)), labels + more
                else:
                    columns, labels = random_influence(predictor, rig, cache, here, self.settings)
            full = np.zeros((len(self.rows), columns.shape[1]))
            full[where] = columns
            blocks.append(self.difference(full, np.zeros_like(full)))
            names += labels
        return (np.hstack(blocks) if blocks else np.zeros((len(self.rows), 0))), tuple(names)

    def _time_influence(self, rig: Rig, prediction: Prediction) -> tuple[FloatArray, tuple[SourceColumn, ...]]:
        known = PartsCache(self.settings)
        tangents = self._tangents(rig, prediction, known)
        base = self._stepped(rig, prediction, known, tangents)
        columns, names = [], []
        for number, key in enumerate(("stiffness_per_s", "slip_force_per_s", "slip_force_per_cycle")):
            drift = rig.drift.model_copy(update={key: getattr(rig.drift, key) + 1e-6})
            other = rig.model_copy(update={"drift": drift})
            moved = self._stepped(other, prediction, PartsCache(self.settings, known), tangents)
            columns.append(self.difference(moved, base) / 1e-6 * 1e-4)
            names.append(SourceColumn("", "drift", number))
        return np.column_stack(columns), tuple(names)

    def difference(self, a: FloatArray, b: FloatArray) -> FloatArray:
        """a − b with phases brought into (−π, π]."""
        result = a - b
        phases = self._phases
        result[phases] -= 2.0 * np.pi * np.round(result[phases] / (2.0 * np.pi))
        return result


def traced(tests: Sequence[Measurement], prediction: Prediction) -> tuple[Measurement, ...]:
    """The tests with the noise of measured amplitudes propagated as a prediction's solutions say."""
    return tuple(
        with_growth(test, state[0]) if isinstance(test, SteppedResponses) and state is not None else test
        for test, state in zip(tests, prediction.states, strict=True)
    )


def _channel_sources(
    predictor: PhaseResonancePredictor, states: Sequence[Any], source: Source
) -> tuple[FloatArray, list[SourceColumn]]:
    """Lines and steps of a channel, (rows of the test, sources): 1 % of its smallest fundamental, at each level."""
    empty: tuple[FloatArray, list[SourceColumn]] = np.zeros((len(predictor.rows), 0)), []
    if source.kind not in ("force_sensor", "response_sensor"):
        return empty
    channel = predictor.force_row if source.kind == "force_sensor" else predictor.own_row(source.index)
    rows = [index for index in range(len(predictor.test.channels)) if predictor.own_row(index) == channel]
    sizes = [float(abs(state.channels[channel, predictor.basis.fundamental])) for state in states if state is not None]
    columns, names = [], []
    for part in _OF_THE_CHANNEL:
        selected = (predictor.rows.part == part) & np.isin(predictor.rows.channel, rows)
        for level in np.unique(predictor.rows.level[selected]) if sizes else ():
            columns.append(0.01 * min(sizes) * (selected & (predictor.rows.level == level)))
            names.append(SourceColumn(predictor.test.name, "level", int(level), unexcited=part))
    return (np.stack(columns, axis=1), names) if columns else empty


def _unsolved(predictor: Any, states: Sequence[Any]) -> list[str]:
    what = "decay" if isinstance(predictor, RingDownPredictor) else "phase-resonant solution"
    return [
        f"{predictor.test.name}: the model has no {what} at level {position}."
        for position, state in enumerate(states)
        if state is None
    ]
