"""What is left where model and measuring chain stay within what is believed of them.

A fit takes a gain of 1 % to 2.5 % and a spring five standard deviations away where that saves more than it costs, and
the surer the noise, the further. How well the model does without is another fit, with limits.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import lsq_linear

from nmt_diagnose.fit.fitting import Data, FitResult, chain_errors_at, predicted
from nmt_diagnose.thresholds import THRESHOLDS


def within_belief(data: Data, fitted: FitResult) -> FitResult | None:
    """A fit with the model's parameters and the chain's tolerances within three standard deviations of their priors.

    The noise is no smaller than stated here: what is surer than that by a learnt scale moves nothing away from what is
    believed. The limits are found with the derivatives of the fit.

    Args:
        data: what was fitted.
        fitted: its parameters of effects stay free.

    Returns:
        The fit itself where it keeps the limits; None where the model has no solution within them.
    """
    limit, errors, count = THRESHOLDS.comparison.credible_sigmas, fitted.errors, fitted.theta.size
    now = np.concatenate([fitted.theta, errors.chain])
    model = np.arange(count) < len(fitted.parametrisation.calibration)
    held = np.concatenate([model, data.tolerances])
    if not np.any(np.abs(now[held]) > limit):
        return fitted
    columns = np.column_stack([fitted.jacobian, errors.slopes])
    weights = np.minimum(errors.weights, 1.0)
    precision = np.concatenate([fitted.parametrisation.prior_std**-2.0, np.ones(errors.chain.size)])
    root = cholesky(columns.T @ (weights[:, None] * columns) + np.diag(precision), lower=True)
    gradient = columns.T @ (weights * errors.residual) - precision * now
    low, high = (np.where(held, side * limit - now, side * np.inf) for side in (-1.0, 1.0))
    step = lsq_linear(root.T, solve_triangular(root, gradient, lower=True), (low, high)).x
    theta, chain = np.split(now + step, [count])
    prediction = predicted(data, fitted.parametrisation, theta, fitted.prediction)
    if prediction is None:
        return None
    return replace(fitted, theta=theta, prediction=prediction, errors=chain_errors_at(data, prediction.values, chain))
