"""Tests that have not been made, about a fit: their rows, and what may still move them.

Parameters and errors of the measuring chain move them, as far as the recordings at hand leave both open together.
Errors of the chain that the further test has alone, such as the phase at which each of its levels truly stands, are as
large as their tolerance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np
from scipy.linalg import cho_factor, cho_solve, solve_triangular

from nmt_core.numerics.arrays import BoolArray, FloatArray
from nmt_diagnose.chain.chain_columns import Chain, linear_chain
from nmt_diagnose.fit.fitting import FitResult, Metric
from nmt_diagnose.measurements.measurement import Observations
from nmt_diagnose.prediction.forward import Forward


class Ahead:
    """A fit in tests that have not been made.

    Args:
        fitted: the fit.
        chain_names: of its errors of the measuring chain.
        left: observables of the tests with expected uncertainties; values are not set.
        chain: errors of the measuring chain in the tests; None = they are computed.

    Raises:
        BenchError: the model has no solution for one of the tests.

    Attributes:
        forward: predicts the rows.
        base: their prediction.
        chain: errors of the measuring chain.
        columns: what parameters, errors of the chain at hand and errors of its own move them by, over σ, (m, k).
    """

    def __init__(
        self, fitted: FitResult, chain_names: Sequence[str], left: Observations, chain: Chain | None = None
    ) -> None:
        self._fitted, self.sigma = fitted, left.sigma
        self.forward = Forward(left.tests, left.rows)
        rig = fitted.parametrisation.rig(fitted.theta)
        self.base = self.forward.predict(rig)
        slopes = self.forward.jacobian(fitted.parametrisation, fitted.theta, self.base)
        self.chain = chain or linear_chain(replace(left, values=np.nan_to_num(self.base.values)), rig, self.base)
        known = {name: number for number, name in enumerate(chain_names)}
        shared = np.zeros((len(left.rows), len(known)))
        unshared = []
        for name, column in zip(self.chain.names, self.chain.columns.T, strict=True):
            if name in known:
                shared[:, known[name]] = column
            else:
                unshared.append(column)
        alone = np.column_stack(unshared) if unshared else np.zeros((len(left.rows), 0))
        self.columns = self.over_sigma(np.column_stack([slopes, shared, alone]))
        self._unshared = alone.shape[1]

    def over_sigma(self, values: FloatArray) -> FloatArray:
        """Changes of the rows, (m, n), over σ; 0 where the model has no solution."""
        return np.asarray(np.nan_to_num(values / self.sigma[:, None], posinf=0.0, neginf=0.0))

    @cached_property
    def precision(self) -> FloatArray:
        """What is known of all that moves the rows before the test, (k, k)."""
        count = self.columns.shape[1] - self._unshared
        result = np.eye(count + self._unshared)
        result[:count, :count] = self._at_hand.normal
        return result

    @cached_property
    def _at_hand(self) -> Metric:
        errors, prior = self._fitted.errors, self._fitted.parametrisation.prior_std
        columns = np.column_stack([self._fitted.jacobian, errors.slopes])
        return Metric(columns, np.concatenate([prior**-2.0, np.ones(errors.chain.size)]), errors.weights)

    def beyond(self, change: FloatArray, rows: BoolArray) -> FloatArray:
        """What some of the rows keep of a change over σ, (m,), once all that moves them has followed: (rows,).

        (1 + X P⁻¹ Xᵀ)⁻¹ Δ, X the columns, P the precision.
        """
        factor = np.linalg.cholesky(self.precision)
        spread = solve_triangular(factor, self.columns[rows].T, lower=True).T
        metric = Metric(spread, np.ones(spread.shape[1]), np.ones(len(spread)))
        left, _ = metric.project(change[rows, None])
        return np.asarray(left[:, 0])

    def apart(self, change: FloatArray, rows: BoolArray) -> float:
        """Standard deviations of a change over σ, (m,), on some of the rows that nuisance parameters cannot explain.

        √(Δᵀ (1 + X P⁻¹ Xᵀ)⁻¹ Δ).
        """
        return float(np.sqrt(max(0.0, float(change[rows] @ self.beyond(change, rows)))))

    def reach(self, at_hand: FloatArray, ahead: FloatArray, rows: BoolArray | None) -> FloatArray:
        """Standard deviations for each unit of strength of effects in the recordings at hand and some rows of the test.

        Args:
            at_hand: what a unit of each effect changes in the recordings at hand, over σ, (m₀, n).
            ahead: the same in the rows of the test, (m, n).
            rows: those that count, (m,); None = the recordings at hand alone.

        Returns:
            (n,).
        """
        errors = self._fitted.errors
        columns = np.column_stack([self._fitted.jacobian, errors.slopes])
        weighted = at_hand * errors.weights[:, None]
        squares = np.sum(at_hand * weighted, axis=0)
        along = np.vstack([columns.T @ weighted, np.zeros((self._unshared, at_hand.shape[1]))])
        precision = self.precision
        if rows is not None:
            squares = squares + np.sum(ahead[rows] ** 2, axis=0)
            along = along + self.columns[rows].T @ ahead[rows]
            precision = precision + self.columns[rows].T @ self.columns[rows]
        taken = np.sum(along * cho_solve(cho_factor(precision), along), axis=0)
        return np.asarray(np.sqrt(np.maximum(squares - taken, 0.0)))
