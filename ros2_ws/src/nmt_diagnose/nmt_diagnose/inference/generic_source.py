"""Evidence for an unnamed source at a place: competes with every named effect.

A generic source is a combination of columns B (responses to equivalent forces or channel errors at a place, smooth
over the level) with amplitudes of unknown size, Gaussian with standard deviation τ. Its evidence is known in closed
form, the calibration parameters marginalised too:

    ln Z(τ) − ln Z(0) = ½ bᵀ (τ⁻² + G)⁻¹ b − ½ ln |1 + τ² G|,   b = Bᵀ K⁻¹ r,   G = Bᵀ K⁻¹ B,   K = 1 + J S² Jᵀ.

A named effect that explains the residual with one parameter beats it; where none does, the generic source wins, says at
which place, and the verdict is `unknown`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nmt_core.arrays import FloatArray
from nmt_diagnose.effects.placement import Placement
from nmt_diagnose.inference.fit import Fit
from nmt_diagnose.inference.scan import Projector

_SIZES = np.geomspace(0.3, 300.0, 13)


@dataclass(frozen=True)
class SourceScore:
    """Evidence for a generic source.

    Attributes:
        placement: where the source sits.
        gain: ln Z of the source over ln Z without it, mean over the sizes τ.
        explained: fall of χ² at the best size.
        degrees_of_freedom: effective number of columns used at the best size.
    """

    placement: Placement
    gain: float
    explained: float
    degrees_of_freedom: float


def source_score(fit: Fit, columns: FloatArray, placement: Placement, calibrated: int | None = None) -> SourceScore:
    """Evidence for a source with the given whitened columns, over the fit's own model.

    Args:
        fit: fit of the model that the source is added to.
        columns: whitened responses, shape (m, s); their scale does not matter.
        placement: for the result.
        calibrated: parameters of the fit that the model has, see :func:`nmt_diagnose.inference.scan.scores`.
    """
    rows = fit.used
    chosen = np.where(np.isfinite(columns[rows]), columns[rows], 0.0)
    prior = fit.open_prior(fit.theta.size if calibrated is None else calibrated)
    projector = Projector(fit.jacobian[rows], prior)
    if not np.any(chosen):
        return SourceScore(placement, 0.0, 0.0, 0.0)
    matrix = projector.inner(chosen, chosen)
    # τ in units of what the strongest column does to the observables.
    size = float(np.sqrt(np.max(np.diag(matrix))))
    if not size > 0.0:
        return SourceScore(placement, 0.0, 0.0, 0.0)
    matrix, chosen = matrix / size**2, chosen / size
    values, vectors = np.linalg.eigh(0.5 * (matrix + matrix.T))
    values = np.maximum(values, 0.0)
    along = (vectors.T @ (chosen.T @ fit.settled_residual(prior))) ** 2
    keep = values > 1e-9 * values.max(initial=0.0)
    values, along = values[keep], along[keep]
    shrunk = values[None, :] + _SIZES[:, None] ** -2.0
    explained = (along / shrunk).sum(axis=1)
    gains = 0.5 * explained - 0.5 * np.log1p(_SIZES[:, None] ** 2 * values).sum(axis=1)
    best = int(np.argmax(gains))
    top = float(gains[best])
    mean = top + float(np.log(np.mean(np.exp(gains - top))))
    return SourceScore(placement, mean, float(explained[best]), float((values / shrunk[best]).sum()))
