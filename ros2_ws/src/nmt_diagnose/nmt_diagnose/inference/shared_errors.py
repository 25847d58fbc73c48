"""Errors that many rows share: the measuring chain, marginalised.

A gain, a phase, a delay of a channel, a drive held from sample to sample move the observables along a few known
directions U (m, r), each by a Gaussian amount of known size. Marginalised they add U Uᵀ to the covariance of the noise
(Rasmussen and Williams, Gaussian Processes for Machine Learning, 2006, section 2.7), so that neither a candidate nor
an unnamed source gains anything by what they explain within their tolerances, and all it explains beyond.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nmt_core.arrays import FloatArray


@dataclass(frozen=True)
class SharedErrors:
    """Low-rank part of a covariance 1 + U Uᵀ.

    Attributes:
        basis: orthonormal directions Q in the space of whitened rows, shape (m, r).
        factors: 1 / √(1 + s²) − 1 of each, s its size, shape (r,).
    """

    basis: FloatArray
    factors: FloatArray

    @classmethod
    def of(cls, columns: FloatArray) -> SharedErrors:
        """From what one standard deviation of each error adds to the whitened rows, shape (m, r)."""
        basis, sizes, _ = np.linalg.svd(columns, full_matrices=False)
        keep = sizes > 1e-3
        return cls(np.ascontiguousarray(basis[:, keep]), 1.0 / np.sqrt(1.0 + sizes[keep] ** 2) - 1.0)

    @property
    def log_volume(self) -> float:
        """½ ln det (1 + U Uᵀ)."""
        return -float(np.sum(np.log1p(self.factors)))

    def whitened(self, values: FloatArray) -> FloatArray:
        """(1 + U Uᵀ)^(-½) values, shape (m,) or (m, n); rows that are not finite stay so and tell nothing."""
        along = self.basis.T @ np.where(np.isfinite(values), values, 0.0)
        factors = self.factors if values.ndim == 1 else self.factors[:, None]
        result: FloatArray = values + self.basis @ (factors * along)
        return result
