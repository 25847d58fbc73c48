"""Predicts the observables of a set of tests for any rig, and how they change with its parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from nmt_core.blocks import FloatArray
from nmt_core.errors import BenchError
from nmt_diagnose.evidence.conditions import PhaseResonanceTest, RandomTest, Test
from nmt_diagnose.evidence.observables import Part, Rows
from nmt_plant.rig import Rig

from .parts_cache import PartsCache, joint_setup
from .phase_resonance_twin import PeriodicState, PhaseResonanceTwin
from .random_twin import RandomTwin
from .settings import TwinSettings


class Parameters(Protocol):
    """What ``Forward.jacobian`` needs of a parametrisation."""

    @property
    def names(self) -> tuple[str, ...]:
        """Name of each entry of θ."""

    @property
    def prior_std(self) -> FloatArray:
        """Prior standard deviation of each entry."""

    def rig(self, theta: FloatArray) -> Rig:
        """Rig of parameters θ."""


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
    """The twin of a set of tests.

    Args:
        tests: conditions of the tests.
        rows: identity of the observables.
        settings: of the twin.

    Raises:
        BenchError: a test that the twin cannot predict.
    """

    def __init__(self, tests: Sequence[Test], rows: Rows, settings: TwinSettings | None = None) -> None:
        self.tests = tuple(tests)
        self.rows = rows
        self.settings = TwinSettings() if settings is None else settings
        self._where = [np.flatnonzero(rows.test == index) for index in range(len(self.tests))]
        self._twins: list[Any] = [
            self._twin(test, rows.take(where)) for test, where in zip(self.tests, self._where, strict=True)
        ]

        # Tests with one drive point share one linear model.
        drives = {(twin.setup.drive_point, twin.setup.ideal_force) for twin in self._twins if hasattr(twin, "setup")}
        for drive in drives:
            group = [
                twin
                for twin in self._twins
                if hasattr(twin, "setup") and (twin.setup.drive_point, twin.setup.ideal_force) == drive
            ]
            shared = joint_setup(twin.setup for twin in group)
            for twin in group:
                twin.use(shared)

    def _twin(self, test: Test, rows: Rows) -> Any:
        if isinstance(test, PhaseResonanceTest):
            return PhaseResonanceTwin(test, rows, self.settings)
        if isinstance(test, RandomTest):
            return RandomTwin(test, rows, self.settings)
        raise BenchError(f"the diagnosis' model cannot predict a test of kind {type(test).__name__}.")

    def predict(self, rig: Rig, start: Prediction | None = None) -> Prediction:
        """Observables of a rig; ``start`` is a prediction for a similar one.

        Raises:
            BenchError: the rig does not fit the tests, or has something the twin does not cover.
        """
        cache = PartsCache(self.settings)
        values = np.full(len(self.rows), np.nan)
        states: list[Any] = []
        reasons: list[str] = []
        for index, (twin, where) in enumerate(zip(self._twins, self._where, strict=True)):
            before = start.states[index] if start is not None else None
            if isinstance(twin, PhaseResonanceTwin):
                solved = twin.solve(rig, cache, before)
                values[where] = twin.values(rig, cache, solved)
                states.append(tuple(solved))
                reasons += _unsolved(twin, solved)
            else:
                values[where] = twin.values(rig, cache)
                states.append(None)
        return Prediction(values, np.isfinite(values), tuple(reasons), tuple(states))

    def _stepped(self, rig: Rig, prediction: Prediction, cache: PartsCache) -> FloatArray:
        """Observables of a slightly different rig, one Newton step from a prediction's solutions."""
        values = np.full(len(self.rows), np.nan)
        for index, (twin, where) in enumerate(zip(self._twins, self._where, strict=True)):
            if isinstance(twin, PhaseResonanceTwin):
                values[where] = twin.values(rig, cache, twin.stepped(rig, cache, prediction.states[index]))
            else:
                values[where] = twin.values(rig, cache)
        return values

    def jacobian(
        self,
        parametrisation: Parameters,
        theta: FloatArray,
        prediction: Prediction,
        which: Sequence[int] | None = None,
        step: float = 3e-4,
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
        base = self._stepped(parametrisation.rig(theta), prediction, known)
        for position, column in enumerate(columns):
            moved = np.array(theta, dtype=np.float64)
            size = step * parametrisation.prior_std[column]
            moved[column] += size
            stepped = self._stepped(parametrisation.rig(moved), prediction, PartsCache(self.settings, known))
            result[:, position] = self.difference(stepped, base) / size
        return result

    def difference(self, a: FloatArray, b: FloatArray) -> FloatArray:
        """a − b with phases brought into (−π, π]."""
        result = a - b
        phases = (self.rows.part == Part.PHASE) | (self.rows.part == Part.PHASE_ERROR)
        result[phases] -= 2.0 * np.pi * np.round(result[phases] / (2.0 * np.pi))
        return result


def _unsolved(twin: PhaseResonanceTwin, states: Sequence[PeriodicState | None]) -> list[str]:
    return [
        f"{twin.test.name}: the model has no phase-resonant solution at level {position} "
        f"({level.amplitude:.3g} V, near {level.frequency_hz:.4g} Hz)."
        for position, (level, state) in enumerate(zip(twin.levels, states, strict=True))
        if state is None
    ]
