"""A problem whose model is a known function of the parameters, for tests of the inference."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nmt_core.messages.blocks import Quantity
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.measurements.locked_windows import LockedWindows
from nmt_diagnose.measurements.measurement import Observations
from nmt_diagnose.measurements.random_responses import RandomResponses
from nmt_diagnose.observations.observables import Part, Rows


@dataclass(frozen=True)
class Values:
    values: np.ndarray
    theta: np.ndarray


class FunctionModel:
    """y = f(θ); the "rig" is θ itself."""

    def __init__(self, function, derivative=None):
        self.function = function
        self.derivative = derivative
        self.calls = 0

    def predict(self, rig, start=None):
        self.calls += 1
        return Values(np.array(self.function(rig), dtype=float), rig)

    def jacobian(self, parametrisation, theta, prediction, which=None):
        if self.derivative is not None:
            return self.derivative(theta)
        base = self.function(theta)
        columns = []
        for k in range(theta.size):
            moved = theta.copy()
            moved[k] += 1e-6
            columns.append((self.function(moved) - base) / 1e-6)
        return np.column_stack(columns)


@dataclass(frozen=True)
class Plain:
    """Parametrisation whose rig is its vector."""

    prior_std: np.ndarray
    lower: np.ndarray
    names: tuple[str, ...]
    log_prior: float = 0.0

    @classmethod
    def of(cls, size, std=1.0, lower=-np.inf):
        return cls(np.full(size, float(std)), np.full(size, float(lower)), tuple(f"p{k}" for k in range(size)))

    def rig(self, theta):
        return np.asarray(theta, dtype=float)

    def index_of(self, candidate):
        """One entry of θ for each candidate, none for the model."""
        return slice(candidate, candidate + 1)


def rows_of(m, levels=None, test=0, part=Part.REAL):
    levels = np.zeros(m, dtype=np.int64) if levels is None else np.asarray(levels, dtype=np.int64)
    whole = lambda value: np.full(m, value, dtype=np.int64)  # noqa: E731
    return Rows(
        whole(test), levels, whole(0), whole(1), whole(int(part)), np.zeros(m), np.ones(m), levels.astype(float) + 1.0
    )


SENSOR = MeasuredChannel("a1", Quantity.ACCELERATION, 1)


def observations_of(values, std, levels=None, part=Part.REAL, tests=("run",)):
    m = len(values)
    kinds = tuple(LockedWindows(name, (1,), "a1", (SENSOR,), 1, "voltage", ()) for name in tests)
    return Observations(
        kinds,
        rows_of(m, levels, part=part),
        np.asarray(values, float),
        np.broadcast_to(std, m).astype(float),
        np.zeros(m),
    )


def random_test(name):
    return RandomResponses(name, 1, (), "voltage", np.ones(1), 1.0, "hann", 1.0, 0.0, 1.0)
