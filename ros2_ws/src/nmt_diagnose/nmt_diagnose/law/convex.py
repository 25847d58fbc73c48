"""Coefficients of a law: least squares with errors of chain and model under their priors, most of them not negative.

Levels are left out one at a time by taking their part off the normal equations.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nmt_core.numerics.arrays import BoolArray, FloatArray
from nmt_diagnose.choose.bounded import constrained

_JITTER = 1e-12


@dataclass(frozen=True)
class Solution:
    """A fit.

    Attributes:
        nuisance: errors of chain and model in their standard deviations, (m,).
        names: of these errors.
        corrected: whitened rows less these errors, (L, M).
        coefficients: of the columns, (k,).
        squares: sum of squared residuals of each level, (L,).
        score: rms of whitened rows of levels that the fit did not see; NaN if none was left out.
        covariance: of the coefficients that are not zero and, before them, of the errors; for unit noise.
    """

    nuisance: FloatArray
    names: tuple[str, ...]
    corrected: FloatArray
    coefficients: FloatArray
    squares: FloatArray
    score: float
    covariance: FloatArray

    @property
    def cost(self) -> float:
        """Squared residuals and what the priors of the errors count."""
        return float(self.squares.sum() + self.nuisance @ self.nuisance)


class ConvexFit:
    """Least squares of levels by errors of chain and model and by the columns of a law.

    Args:
        target: whitened rows, (L, M).
        nuisance: whitened columns of one standard deviation each, (L, M, m).
        left_out: levels that are left out in turn.
        names: of the errors.
    """

    def __init__(
        self, target: FloatArray, nuisance: FloatArray, left_out: list[int], names: tuple[str, ...] = ()
    ) -> None:
        self.target, self.nuisance, self.left_out, self.names = target, nuisance, left_out, names
        self.counts = np.isfinite(target).sum(axis=1)
        self.tt = np.einsum("lm,lm->l", target, target)
        self.nn = np.einsum("lmi,lmj->lij", nuisance, nuisance)
        self.nt = np.einsum("lmi,lm->li", nuisance, target)

    def solve(self, columns: FloatArray, signed: BoolArray) -> Solution:
        """Fit columns (L, M, k); ``signed`` (k,) of those that may have either sign."""
        m = self.nn.shape[1]
        gram, right, norms = self._normal(columns)
        all_normal, all_right = gram.sum(axis=0), right.sum(axis=0)
        theta = constrained(all_normal, all_right, m, signed)
        squares = self._squares(theta, gram, right)
        found = np.nan
        if self.left_out:
            found = self._predicted([[level] for level in self.left_out], gram, right, signed)
        active = np.flatnonzero(np.concatenate([np.ones(m, bool), theta[m:] != 0.0]))
        normal = all_normal[np.ix_(active, active)] + np.diag(np.where(active < m, 1.0, _JITTER))
        covariance = np.linalg.pinv(normal)
        sizes = np.concatenate([np.ones(m), 1.0 / np.where(norms > 0.0, norms, 1.0)])[active]
        return Solution(
            theta[:m], self.names, self.target - self.nuisance @ theta[:m],
            theta[m:] / np.where(norms > 0.0, norms, 1.0), squares, found, covariance * np.outer(sizes, sizes),
        )  # fmt: skip

    def predicted(self, columns: FloatArray, signed: BoolArray, out: list[int]) -> float:
        """rms of whitened rows of some levels that a fit to the others predicts."""
        gram, right, _ = self._normal(columns)
        return self._predicted([out], gram, right, signed)

    def without(self, columns: FloatArray, signed: BoolArray, out: list[int]) -> tuple[FloatArray, FloatArray]:
        """Errors (m,) and coefficients (k,) of a fit to all levels but some."""
        gram, right, norms = self._normal(columns)
        others = np.delete(np.arange(len(self.tt)), out)
        theta = constrained(gram[others].sum(axis=0), right[others].sum(axis=0), self.nn.shape[1], signed)
        m = self.nn.shape[1]
        return theta[:m], np.asarray(theta[m:] / np.where(norms > 0.0, norms, 1.0))

    def _normal(self, columns: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Normal equations of each level, (L, m + k, m + k) and (L, m + k), and what columns were divided by."""
        m, k = self.nn.shape[1], columns.shape[2]
        norms = np.sqrt(np.einsum("lmk,lmk->k", columns, columns))
        scaled = columns / np.where(norms > 0.0, norms, 1.0)
        gram = np.zeros((len(self.tt), m + k, m + k))
        right = np.zeros((len(self.tt), m + k))
        gram[:, :m, :m], right[:, :m] = self.nn, self.nt
        if k:
            across = np.matmul(scaled.transpose(0, 2, 1), self.nuisance)
            gram[:, m:, :m], gram[:, :m, m:] = across, across.transpose(0, 2, 1)
            gram[:, m:, m:] = np.matmul(scaled.transpose(0, 2, 1), scaled)
            right[:, m:] = np.einsum("lmi,lm->li", scaled, self.target)
        return gram, right, norms

    def _predicted(self, groups: list[list[int]], gram: FloatArray, right: FloatArray, signed: BoolArray) -> float:
        m = self.nn.shape[1]
        all_normal, all_right = gram.sum(axis=0), right.sum(axis=0)
        total, count = 0.0, 0
        for out in groups:
            other = constrained(all_normal - gram[out].sum(axis=0), all_right - right[out].sum(axis=0), m, signed)
            total += float(self._squares(other, gram, right)[out].sum())
            count += int(self.counts[out].sum())
        return float(np.sqrt(max(total, 0.0) / count))

    def _squares(self, theta: FloatArray, gram: FloatArray, right: FloatArray) -> FloatArray:
        values = self.tt - 2.0 * right @ theta + np.einsum("i,lij,j->l", theta, gram, theta)
        return np.asarray(np.maximum(values, 0.0))
