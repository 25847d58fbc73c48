"""Maximum-a-posteriori fit by damped Gauss–Newton steps, and its evidence by Laplace's method."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from nmt_core.arrays import BoolArray, FloatArray
from nmt_core.errors import BenchError
from nmt_diagnose.effects.parametrisation import Parametrisation
from nmt_diagnose.inference.problem import Problem
from nmt_diagnose.twin.forward import Prediction

STEPS = 25
_TRIALS = 10
# Falls of χ² over what a degree of freedom has left, since that is the noise of a model that does not fit.
_SMALL = 0.02  # not worth a step
_CONVERGED = 1.0  # what a whole step may still promise
_SCATTERED = 2.0  # χ² per degree of freedom that is no chance
_LET_GO = 1e3
_RETURNS = 6  # steps that bring a step back into the valley of χ²
_STEEP = 100.0  # how much more than the prior the observations tell across the valley
_RETURNING = 0.5  # fall of χ² by each of them at least
_COOLING = 6.0  # fall of the inflated noise from step to step of a cold fit
_COOLING_STEPS = 25


@dataclass(frozen=True)
class Fit:
    """Outcome of a fit.

    Attributes:
        parametrisation: what the parameters mean.
        theta: estimate, shape (n,).
        covariance: of the estimate, shape (n, n).
        residual: whitened residual of all rows, used for the fit or not, shape (m,).
        jacobian: whitened sensitivities ∂f/∂θ / σ of all rows at the estimate, shape (m, n).
        used: rows that the fit used, shape (m,).
        prediction: the model's solution at the estimate.
        chi_square: Σ r² over the used rows.
        penalty: Σ (θ/std)² of the prior.
        log_evidence: ln ∫ likelihood · prior dθ by Laplace's method, without the constant of the rows.
        converged: by its sensitivities no step from the estimate promises a fall that matters.
        fresh: its sensitivities are those at the estimate, not from nearby.
    """

    parametrisation: Parametrisation
    theta: FloatArray
    covariance: FloatArray
    residual: FloatArray
    jacobian: FloatArray
    used: BoolArray
    prediction: Prediction
    chi_square: float
    penalty: float
    log_evidence: float
    converged: bool
    fresh: bool = False

    @property
    def std(self) -> FloatArray:
        """Standard uncertainties of the estimate, shape (n,)."""
        result: FloatArray = np.sqrt(np.maximum(np.diag(self.covariance), 1e-300))
        return result

    @property
    def scatter(self) -> float:
        """By how much more the used rows scatter about the fit than stated; 1 where that may be chance.

        Standard uncertainties that are reported are multiplied by it (Birge, Phys. Rev. 40 (1932) 207): what a model
        leaves beyond the noise makes its parameters uncertain too.
        """
        told = float(np.sum(1.0 - (self.std / self.parametrisation.prior_std) ** 2))
        ratio = self.chi_square / max(1.0, int(self.used.sum()) - told)
        return math.sqrt(ratio) if ratio > _SCATTERED else 1.0

    def settled_residual(self, prior_std: FloatArray | None = None) -> FloatArray:
        """Whitened residual of the used rows after the last linear step to the optimum, shape (used,).

        A fit ends where a step is not worth its cost. What is left of the gradient then is no evidence: a direction
        that the parameters imitate nearly would pass for one.

        Args:
            prior_std: prior for that step, shape (n,); None = that of the parametrisation.
        """
        rows, std = self.used, self.parametrisation.prior_std if prior_std is None else prior_std
        jacobian = self.jacobian[rows]
        gradient = jacobian.T @ self.residual[rows] - self.theta / std**2
        normal = jacobian.T @ jacobian + np.diag(std**-2.0)
        step = _bounded_step(normal, gradient, 0.0, self.theta, self.parametrisation.lower)
        result: FloatArray = self.residual[rows] - jacobian @ step
        return result

    def open_prior(self, calibrated: int) -> FloatArray:
        """The prior with everything after the first so many parameters let go, shape (n,).

        A strength that its prior holds back leaves a part of its own mark; that is no sign of something else.
        """
        result = self.parametrisation.prior_std.copy()
        result[calibrated:] *= _LET_GO
        return result

    @property
    def predictive_std(self) -> FloatArray:
        """Standard deviation of a whitened residual that was not fitted: noise (1) and what the estimate leaves open.

        shape (m,)
        """
        # By eigenvalues: of parameters that hardly differ, rounding leaves a covariance that is not quite positive.
        values, vectors = np.linalg.eigh(0.5 * (self.covariance + self.covariance.T))
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        result: FloatArray = np.sqrt(1.0 + np.sum((self.jacobian @ root) ** 2, axis=1))
        return result


class FitError(ArithmeticError):
    """The model has no solution where the fit would have to start."""


def fit(
    problem: Problem,
    parametrisation: Parametrisation,
    theta: FloatArray,
    used: BoolArray | None = None,
    start: Prediction | None = None,
    jacobian: FloatArray | None = None,
    steps: int = STEPS,
    exact: bool = True,
    refreshes: int = STEPS,
    known: FloatArray | None = None,
    only: bool = False,
) -> Fit:
    """Fit by Levenberg's damping, within bounds.

    Sensitivities cost more than a solution of the model and change little near the optimum, so they are computed anew
    only where a step does not do what they promised.

    Args:
        problem: observations and model.
        parametrisation: parameters with prior.
        theta: where to start, shape (n,).
        used: rows to fit; None = all.
        start: a solution to start from; None = far from the optimum, which is approached with noise that counts large
            at first.
        jacobian: whitened sensitivities near the start, shape (m, n); None = computed.
        steps: most steps.
        exact: compute the sensitivities anew at the estimate.
        refreshes: how often sensitivities may be computed anew on the way; a fit that needs more ends unconverged.
        known: whitened sensitivities at ``theta`` itself, shape (m, n), so that they need not be computed there.
        only: the estimate is all that is wanted: rows that are not used are not predicted.

    Raises:
        FitError: the model cannot be solved at the start.
    """
    rows = np.ones(problem.size, dtype=bool) if used is None else used
    theta = np.maximum(np.asarray(theta, dtype=np.float64), parametrisation.lower)
    std, lower = parametrisation.prior_std, parametrisation.lower
    unasked = ~rows if only else None
    prediction = _predicted(problem, parametrisation, theta, start, left=unasked)
    if prediction is None:
        raise FitError("the rig at the start of the fit cannot be built")
    if start is None and jacobian is None and steps > 0:
        theta, prediction = _approached(problem, parametrisation, theta, rows, prediction, unasked)
    residual = problem.residual(prediction)
    # Levels that have no solution even here cannot be compared; they are left out of this fit as a whole.
    solvable = np.isfinite(residual)
    if not np.any(solvable & rows):
        raise FitError("the model has no solution for any of the observables")
    rows = rows & solvable
    # What has no solution here is not asked for again on the way: every attempt would try all ways to it.
    unasked = ~rows if only else ~solvable
    begun = theta
    damping = 1e-4
    cost = _cost(residual, rows, theta, std)
    fresh = jacobian is None
    if jacobian is None:
        jacobian = _whitened_jacobian(problem, parametrisation, theta, prediction) if known is None else known
    for _ in range(steps):
        used_jacobian = jacobian[rows]
        normal = used_jacobian.T @ used_jacobian + np.diag(std**-2.0)
        gradient = used_jacobian.T @ residual[rows] - theta / std**2
        trial = None
        damped = True
        for _ in range(_TRIALS):
            step = _bounded_step(normal, gradient, damping, theta, lower)
            # A step beyond a few prior deviations leaves the range in which the linearisation means anything.
            step *= min(1.0, 3.0 / max(float(np.max(np.abs(step) / np.maximum(std, 1e-12), initial=0.0)), 1e-300))
            moved = np.maximum(theta + step, lower)
            step = moved - theta
            promised = float(2.0 * gradient @ step - step @ normal @ step)
            small = (_SMALL if damped else _CONVERGED) * _noise_of(cost, rows) + 1e-7 * cost
            if promised < small:
                if not damped or damping == 0.0:
                    break
                # Damping holds most what the observations tell least; the whole step may promise more.
                damped, damping = False, 0.0
                continue
            trial = _predicted(problem, parametrisation, moved, prediction, rows, unasked)
            if trial is not None:
                trial_residual = problem.residual(trial)
                trial_cost = _cost(trial_residual, rows, moved, std)
                if trial_cost <= cost:
                    break
                back = _back_into_valley(
                    problem, parametrisation, moved, rows, unasked, trial, trial_residual, used_jacobian, normal, cost
                )
                if back is not None:
                    moved, trial, trial_residual, trial_cost = back
                    break
                trial = None
            if not fresh:
                break
            damping = max(damping, 1e-6) * 8.0
        if trial is None:
            # Sensitivities from elsewhere may promise nothing where those at the estimate would lead on.
            done = promised < small and not exact
            if fresh or done or refreshes <= 0:
                break
            jacobian = _whitened_jacobian(problem, parametrisation, theta, prediction) if known is None else known
            fresh = True
            refreshes -= 1
            continue
        kept = cost - trial_cost > 0.5 * promised
        theta, prediction, residual, cost = moved, trial, trial_residual, trial_cost
        damping *= 0.1
        fresh, known = False, None
        if not kept and refreshes > 0:
            jacobian, fresh = _whitened_jacobian(problem, parametrisation, theta, prediction), True
            refreshes -= 1
    if theta is not begun and not only and np.any(unasked):
        whole = _predicted(problem, parametrisation, theta, prediction)
        if whole is not None:
            prediction, residual = whole, problem.residual(whole)
    if exact and not fresh:
        jacobian = _whitened_jacobian(problem, parametrisation, theta, prediction) if known is None else known
    return _finished(problem, parametrisation, theta, rows, prediction, residual, jacobian, fresh or exact)


def _back_into_valley(
    problem: Problem,
    parametrisation: Parametrisation,
    theta: FloatArray,
    rows: BoolArray,
    unasked: BoolArray,
    prediction: Prediction,
    residual: FloatArray,
    jacobian: FloatArray,
    normal: FloatArray,
    limit: float,
) -> tuple[FloatArray, Prediction, FloatArray, float] | None:
    """A step that has left a curved valley brought back into it by steps with the same sensitivities.

    Where parameters make up for one another (force factor, resistance and damping of a shaker whose current was not
    measured) the valley of χ² is narrow and curved, and damped steps creep along it. Across it the sensitivities still
    hold at the end of a step: one more step with them is the geodesic acceleration of Transtrum and Sethna
    (arXiv 1201.5885) with the second derivative taken over the whole step.

    Args:
        theta, prediction, residual: where the step ended, and what the model gives there.
        rows: rows that count.
        unasked: rows that are not predicted.
        jacobian, normal: whitened sensitivities of those rows where the step began, and their normal matrix.
        limit: cost that has to be reached.

    Returns:
        Parameters, prediction, residual and cost; None where the valley is not found again.
    """
    std, lower = parametrisation.prior_std, parametrisation.lower
    before = _cost(residual, rows, theta, std)
    # Along the valley the old sensitivities say nothing; across it the observations tell far more than the prior.
    values, vectors = np.linalg.eigh(normal * np.outer(std, std))
    steep = values > _STEEP
    across = std[:, None] * vectors[:, steep]
    for _ in range(_RETURNS):
        if not np.isfinite(before) or not np.any(steep):
            return None
        gradient = jacobian.T @ residual[rows] - theta / std**2
        slope = across.T @ gradient
        if before - slope @ (slope / values[steep]) > limit:
            return None  # it promises too little
        theta = np.maximum(theta + across @ (slope / values[steep]), lower)
        moved = _predicted(problem, parametrisation, theta, prediction, rows, unasked)
        if moved is None:
            return None
        prediction, residual = moved, problem.residual(moved)
        cost = _cost(residual, rows, theta, std)
        if cost <= limit:
            return theta, prediction, residual, cost
        if cost > _RETURNING * before:
            return None
        before = cost
    return None


def _approached(
    problem: Problem,
    parametrisation: Parametrisation,
    theta: FloatArray,
    rows: BoolArray,
    prediction: Prediction,
    unasked: BoolArray | None,
) -> tuple[FloatArray, Prediction]:
    """Parameters near the optimum, from a start that may be thousands of σ away.

    As long as the residual is large the linearisation is wrong by more than the noise. Taken at face value it throws
    parameters that the observations hardly separate many prior deviations away, into valleys of their own. So the noise
    counts as large as what is left, and less from step to step: the prior holds those parameters meanwhile.
    """
    std, lower = parametrisation.prior_std, parametrisation.lower
    residual = problem.residual(prediction)
    rows = rows & np.isfinite(residual)
    count = int(rows.sum())
    if count == 0 or theta.size == 0:
        return theta, prediction
    left = float(residual[rows] @ residual[rows])
    inflation = max(1.0, left / count)
    if inflation == 1.0:
        return theta, prediction
    jacobian = _whitened_jacobian(problem, parametrisation, theta, prediction)[rows]
    for _ in range(_COOLING_STEPS):
        if inflation <= 1.0:
            break
        normal = jacobian.T @ jacobian / inflation + np.diag(std**-2.0)
        gradient = jacobian.T @ residual[rows] / inflation - theta / std**2
        moved = np.maximum(theta + _bounded_step(normal, gradient, 0.0, theta, lower), lower)
        trial = _predicted(problem, parametrisation, moved, prediction, rows, unasked)
        if trial is None:
            break
        trial_residual = problem.residual(trial)
        if not np.all(np.isfinite(trial_residual[rows])):
            break
        trial_left = float(trial_residual[rows] @ trial_residual[rows])
        if trial_left > 1.5 * left:
            inflation *= 4.0
        else:
            theta, prediction, residual, left = moved, trial, trial_residual, trial_left
            inflation = max(1.0, min(inflation / _COOLING, left / count))
        if left > 1.05 * count:
            jacobian = _whitened_jacobian(problem, parametrisation, theta, prediction)[rows]
    return theta, prediction


def _finished(
    problem: Problem,
    parametrisation: Parametrisation,
    theta: FloatArray,
    rows: BoolArray,
    prediction: Prediction,
    residual: FloatArray,
    jacobian: FloatArray,
    fresh: bool,
) -> Fit:
    std = parametrisation.prior_std
    used = jacobian[rows]
    normal = used.T @ used + np.diag(std**-2.0)
    # Undamped: where damped steps help no more there may still be a way down that they are too short for.
    gradient = used.T @ residual[rows] - theta / std**2
    step = _bounded_step(normal, gradient, 0.0, theta, parametrisation.lower)
    chi_square = float(residual[rows] @ residual[rows])
    promised = float(2.0 * gradient @ step - step @ normal @ step)
    converged = promised < _CONVERGED * _noise_of(chi_square, rows)
    penalty = float(np.sum((theta / std) ** 2))
    _, log_determinant = np.linalg.slogdet(normal)
    log_evidence = -0.5 * (chi_square + penalty) - 0.5 * float(log_determinant) - float(np.sum(np.log(std)))
    log_evidence += parametrisation.log_prior
    covariance = np.asarray(np.linalg.inv(normal), dtype=np.float64)
    return Fit(
        parametrisation, theta, covariance, residual, jacobian, rows, prediction, chi_square, penalty, log_evidence,
        converged, fresh,
    )  # fmt: skip


def _predicted(
    problem: Problem,
    parametrisation: Parametrisation,
    theta: FloatArray,
    start: Prediction | None,
    needed: BoolArray | None = None,
    left: BoolArray | None = None,
) -> Prediction | None:
    """The model's prediction; None where the parameters make no rig (a mass below zero, for example).

    It is None as well where a row that is needed has no solution.
    """
    try:
        return problem.forward.predict(parametrisation.rig(theta), start, None, needed, left)
    except (BenchError, ValueError, ArithmeticError, np.linalg.LinAlgError):
        return None


def _whitened_jacobian(
    problem: Problem, parametrisation: Parametrisation, theta: FloatArray, prediction: Prediction
) -> FloatArray:
    if theta.size == 0:
        return np.zeros((problem.size, 0))
    try:
        columns = problem.forward.jacobian(parametrisation, theta, prediction)
    except (BenchError, ValueError, ArithmeticError, np.linalg.LinAlgError) as error:
        raise FitError(f"the model has no sensitivities there ({error})") from error
    jacobian = problem.whitened(columns)
    return np.where(np.isfinite(jacobian), jacobian, 0.0)


def _cost(residual: FloatArray, rows: BoolArray, theta: FloatArray, std: FloatArray) -> float:
    used = residual[rows]
    if not np.all(np.isfinite(used)):
        return float("inf")
    return float(used @ used + np.sum((theta / std) ** 2))


def _noise_of(cost: float, rows: BoolArray) -> float:
    """Mean square of what a fit leaves in its rows, at least the stated noise."""
    return max(1.0, cost / max(1, int(rows.sum())))


def _bounded_step(
    normal: FloatArray, gradient: FloatArray, damping: float, theta: FloatArray, lower: FloatArray
) -> FloatArray:
    """Damped step; parameters at their bound that would leave it stay there."""
    free = ~((theta <= lower) & (gradient < 0.0))
    step = np.zeros_like(theta)
    if np.any(free):
        matrix = normal[np.ix_(free, free)]
        matrix = matrix + damping * np.diag(np.diag(matrix))
        step[free] = np.linalg.solve(matrix, gradient[free])
    return step
