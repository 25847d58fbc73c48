"""Least squares by normal equations with unit priors and unknowns that are not negative.

Unknowns of either sign are projected out; what remains is non-negative least squares (Lawson and Hanson, Solving Least
Squares Problems, 1974), which has one optimum.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import cholesky
from scipy.linalg.lapack import dpotrf, dpotrs, dtrtrs
from scipy.optimize import nnls

from nmt_core.numerics.arrays import BoolArray, FloatArray

_JITTER = 1e-12


def constrained(gram: FloatArray, right: FloatArray, fixed: int, signed: BoolArray) -> FloatArray:
    """Unknowns (m + k,) of least squares.

    Args:
        gram, right: normal equations, (m + k, m + k) and (m + k,).
        fixed: m, the first unknowns, which have unit priors and either sign.
        signed: which of the others may have either sign, (k,); the rest is not negative.

    Raises:
        LinAlgError: columns of either sign are sums of others of them.
    """
    normal = gram.copy()
    normal.flat[:: right.size + 1] += np.where(np.arange(right.size) < fixed, 1.0, _JITTER)
    free = np.concatenate([np.ones(fixed, bool), signed])
    if not free.any():
        return _not_negative(normal, right)
    a, b = np.flatnonzero(free), np.flatnonzero(~free)
    theta = np.zeros(right.size)
    # LAPACK itself: this runs thousands of times a reading, and checks of its arguments take as long as it does.
    factor, fault = dpotrf(normal[a[:, np.newaxis], a])
    if fault:
        raise np.linalg.LinAlgError("the columns of either sign are no more than others of them")
    if b.size:
        across = normal[a[:, np.newaxis], b]
        by_free = dpotrs(factor, np.column_stack([across, right[a]]))[0]
        schur = normal[b[:, np.newaxis], b] - across.T @ by_free[:, :-1]
        theta[b] = _not_negative(schur, right[b] - across.T @ by_free[:, -1])
        theta[a] = by_free[:, -1] - by_free[:, :-1] @ theta[b]
    else:
        theta[a] = dpotrs(factor, right[a])[0]
    return theta


def _not_negative(gram: FloatArray, right: FloatArray) -> FloatArray:
    """Least squares by normal equations whose unknowns are not negative."""
    scale = np.sqrt(np.maximum(gram.diagonal(), 1e-300))
    gram, right = gram / np.multiply.outer(scale, scale), right / scale
    gram.flat[:: right.size + 1] += _JITTER * 1e2
    upper, fault = dpotrf(gram)
    if fault:
        upper = cholesky(gram + 1e-6 * np.eye(right.size))
    found = dpotrs(upper, right)[0]
    if found.min() < 0.0:
        found = nnls(upper, dtrtrs(upper, right, trans=1)[0])[0]
    return np.asarray(found / scale)
