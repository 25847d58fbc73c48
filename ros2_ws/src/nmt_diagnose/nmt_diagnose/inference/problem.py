"""What a fit works on: observations, the model that predicts it, and whitened residuals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nmt_core.arrays import BoolArray, FloatArray, IntArray
from nmt_diagnose.inference.shared_errors import SharedErrors
from nmt_diagnose.observations.observables import Observations, Part
from nmt_diagnose.twin.forward import Forward, Prediction


@dataclass(frozen=True)
class Nuisance:
    """An error that several rows share, of known size.

    Attributes:
        rows: indices of the rows.
        direction: what a standard deviation of it adds to these rows, over their own σ, as a unit vector.
        size: length of that vector.
    """

    rows: IntArray
    direction: FloatArray
    size: float

    def whiten(self, values: FloatArray) -> None:
        """Multiply rows of values, shape (m,) or (m, n), by (1 + size² d dᵀ)^(-½), in place."""
        part = values[self.rows]
        along = self.direction @ part
        factor = 1.0 / np.sqrt(1.0 + self.size**2) - 1.0
        values[self.rows] = part + factor * (np.multiply.outer(self.direction, along))


@dataclass(frozen=True)
class Problem:
    """Observations and model.

    Attributes:
        observations: the real side.
        forward: predicts its observables.
        nuisances: errors that rows share, no row in two of them.
        shared: errors of the measuring chain; None = there are none.
        offset: what predictions are too high by, shape (m,), see true_phase.py; None = nothing.
    """

    observations: Observations
    forward: Forward
    nuisances: tuple[Nuisance, ...] = ()
    shared: SharedErrors | None = None
    offset: FloatArray | None = None

    @property
    def size(self) -> int:
        """Number of observables m."""
        return len(self.observations.rows)

    def difference(self, values: FloatArray) -> FloatArray:
        """Measured minus predicted, phases on the shortest way, shape (m,)."""
        result: FloatArray = self.observations.values - values
        if self.offset is not None:
            result += np.nan_to_num(self.offset)
        phases = np.isin(self.observations.rows.part, (Part.PHASE, Part.PHASE_ERROR))
        result[phases] = (result[phases] + np.pi) % (2.0 * np.pi) - np.pi
        return result

    def whitened(self, values: FloatArray) -> FloatArray:
        """Values, shape (m,) or (m, n), over their uncertainty: Σ^(-½) values."""
        sigma = self.observations.sigma
        result: FloatArray = values / (sigma if values.ndim == 1 else sigma[:, None])
        for nuisance in self.nuisances:
            nuisance.whiten(result)
        return result if self.shared is None else self.shared.whitened(result)

    def log_volume(self, used: BoolArray) -> float:
        """ln of what the density of the noise is divided by, √det Σ, of some rows, (m,).

        Fits of the same values under other noise compare when it is taken off: more noise explains anything.
        """
        result = float(np.sum(np.log(self.observations.sigma[used])))
        result += sum(0.5 * float(np.log1p(nuisance.size**2)) for nuisance in self.nuisances)
        return result if self.shared is None else result + self.shared.log_volume

    def residual(self, prediction: Prediction) -> FloatArray:
        """Whitened residual Σ^(-½) (measured − predicted), shape (m,)."""
        return self.whitened(self.difference(prediction.values))
