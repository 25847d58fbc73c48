"""Predicts the observables of a set of tests for any rig, and how they change with its parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nmt_core.numerics.arrays import FloatArray
from nmt_diagnose.effects.parametrisation import Parametrisation
from nmt_diagnose.measurements.measurement import Measurement
from nmt_diagnose.observations.observables import ANGLES, Part, Rows
from nmt_diagnose.prediction.influence import Source, SourceColumn
from nmt_diagnose.prediction.parts_cache import PartsCache, joint_setup
from nmt_diagnose.prediction.prediction_settings import PredictionSettings
from nmt_diagnose.prediction.predictor import Predictor
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_rig.rig import Rig, SensorSection


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
        self._phases = np.flatnonzero(np.isin(rows.part, ANGLES))
        self._where = [np.flatnonzero(rows.test == index) for index in range(len(self.tests))]
        self._twins = [
            test.predictor(rows.take(where), self.settings) for test, where in zip(self.tests, self._where, strict=True)
        ]
        # Rows that follow no excitation, with the names of their channels.
        self._steps = self._unexcited(Part.STEP)
        self._limits = self._unexcited(Part.LIMIT)
        self._repeats = self._unexcited(Part.REPEATS)
        self._lines = self._unexcited(Part.LINE)

        # Tests with one drive point share one linear model.
        groups: dict[tuple[tuple[int, ...], bool], list[Predictor]] = {}
        for predictor in self._twins:
            groups.setdefault((predictor.setup.drive_points, predictor.setup.ideal_force), []).append(predictor)
        for group in groups.values():
            shared = joint_setup(predictor.setup for predictor in group)
            for predictor in group:
                predictor.use(shared)

    def _unexcited(self, part: Part) -> list[tuple[int, str]]:
        found = []
        for row in np.flatnonzero(self.rows.part == part):
            test = self.tests[self.rows.test[row]]
            if part in test.unexcited:
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
            solved = predictor.solve(rig, cache, start.states[index] if start is not None else None)
            values[where] = predictor.values(rig, cache, solved or ())
            states.append(None if solved is None else tuple(solved))
            reasons += [
                f"{self.tests[index].name}: the model has no {predictor.SOLUTION} at level {position}."
                for position, state in enumerate(solved or ())
                if state is None
            ]
        self.add_unexcited(rig, values)
        return Prediction(values, np.isfinite(values), tuple(reasons), tuple(states))

    def _tangents(self, rig: Rig, prediction: Prediction, cache: PartsCache) -> list[Any]:
        """What each test's solutions need to follow small changes of the rig; None where the test has its own way."""
        return [
            None if prediction.states[index] is None else predictor.tangent(rig, cache, prediction.states[index])
            for index, predictor in enumerate(self._twins)
        ]

    def _stepped(self, rig: Rig, prediction: Prediction, cache: PartsCache, tangents: Sequence[Any] = ()) -> FloatArray:
        """Observables of a slightly different rig, one Newton step from a prediction's solutions.

        ``tangents`` are those of the rig of the prediction; without them the step is by the other rig's own Jacobian.
        """
        values = np.full(len(self.rows), np.nan)
        for index, (predictor, where) in enumerate(zip(self._twins, self._where, strict=True)):
            states: Sequence[Any] = ()
            if prediction.states[index] is not None:
                tangent = tangents[index] if tangents else None
                advanced = None if tangent is None else predictor.advanced(rig, cache, tangent)
                states = advanced or predictor.stepped(rig, cache, prediction.states[index])
            values[where] = predictor.values(rig, cache, states)
        self.add_unexcited(rig, values)
        return values

    def add_unexcited(self, rig: Rig, values: FloatArray) -> None:
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
            here = source
            if source.kind == "response_sensor":
                known = [channel.name for channel in self.tests[index].channels]
                if source.channel not in known:
                    continue
                here = replace(source, index=known.index(source.channel))
            columns, labels = predictor.influence(rig, cache, prediction.states[index], here)
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
    each = zip(tests, prediction.states, strict=True)
    return tuple(test if test.lines is None else test.lines.traced(states) for test, states in each)
