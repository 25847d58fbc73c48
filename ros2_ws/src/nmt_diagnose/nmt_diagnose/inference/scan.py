"""Linearised scan: what every candidate could explain of the residual after the calibration took its part.

At the fitted model without effect, a small strength of a candidate moves the observables along a direction v. What the
calibration parameters can imitate is projected out under their prior; the rest of v against the residual tells how
many standard deviations the strength is away from zero and how much χ² falls. One solution of the model serves all
candidates, so hundreds of them cost little.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from nmt_core.arrays import FloatArray
from nmt_diagnose.inference.fit import Fit


@dataclass(frozen=True)
class Direction:
    """One direction in the space of observables.

    Attributes:
        candidate: index of the candidate it belongs to.
        start: parameters of the candidate for which it was computed, dimensionless; the strength is the first.
        column: whitened derivative with respect to the strength, shape (m,).
        signed: the strength may be negative.
    """

    candidate: int
    start: FloatArray
    column: FloatArray
    signed: bool


@dataclass(frozen=True)
class Score:
    """What a direction explains.

    Attributes:
        direction: the direction.
        strength: its best strength, dimensionless.
        sigmas: strength over its standard uncertainty, calibration parameters free.
        gain: fall of χ² plus prior, strength without prior.
        reach: |v| after the calibration took its part: σ per unit of strength.
    """

    direction: Direction
    strength: float
    sigmas: float
    gain: float
    reach: float


class Projector:
    """Takes out of whitened vectors what the parameters of a fit can imitate within their prior.

    Args:
        jacobian: whitened sensitivities, shape (m, n).
        prior_std: of the parameters, shape (n,).
    """

    def __init__(self, jacobian: FloatArray, prior_std: FloatArray) -> None:
        self._jacobian = jacobian
        n = jacobian.shape[1]
        normal = jacobian.T @ jacobian + np.diag(prior_std**-2.0)
        self._factor = np.linalg.cholesky(normal + 1e-12 * np.diag(np.diag(normal))) if n else None

    def inner(self, left: FloatArray, right: FloatArray) -> FloatArray:
        """leftᵀ (1 + J S² Jᵀ)⁻¹ right: products in the metric that the calibration leaves; (m, …) each."""
        plain: FloatArray = left.T @ right
        if self._factor is None:
            return plain
        a = np.linalg.solve(self._factor, self._jacobian.T @ left)
        b = np.linalg.solve(self._factor, self._jacobian.T @ right)
        result: FloatArray = plain - a.T @ b
        return result


def scores(fit: Fit, directions: Sequence[Direction], calibrated: int | None = None) -> list[Score]:
    """Score every direction against the residual of a fit, best first.

    Args:
        fit: fit without the candidates.
        directions: of the candidates, at the fit's solution.
        calibrated: parameters of the fit that the model has; the others are of effects and their prior lets go. None =
            all.
    """
    if not directions:
        return []
    rows = fit.used
    prior = fit.open_prior(fit.theta.size if calibrated is None else calibrated)
    projector = Projector(fit.jacobian[rows], prior)
    # The prior pulls the parameters too; at the estimate residual and pull balance: the residual alone is the score.
    residual = fit.settled_residual(prior)
    columns = np.column_stack([direction.column[rows] for direction in directions])
    columns = np.where(np.isfinite(columns), columns, 0.0)
    along = columns.T @ residual
    _, n = columns.shape
    squares = np.array([projector.inner(columns[:, k], columns[:, k]) for k in range(n)], dtype=np.float64)
    result = []
    for k, direction in enumerate(directions):
        square = float(squares[k])
        if not square > 1e-12:
            result.append(Score(direction, 0.0, 0.0, 0.0, 0.0))
            continue
        strength = float(along[k]) / square
        if not direction.signed and strength < 0.0:
            result.append(Score(direction, 0.0, 0.0, 0.0, square**0.5))
            continue
        sigmas = float(along[k]) / square**0.5
        result.append(Score(direction, strength, sigmas, sigmas**2, square**0.5))
    return sorted(result, key=lambda score: -score.gain)
