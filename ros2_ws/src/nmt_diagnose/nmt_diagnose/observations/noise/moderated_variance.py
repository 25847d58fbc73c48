"""Variances of many rows, each from few values: every one leans on the others of its kind.

A standard uncertainty from ten sub-windows is itself uncertain by a quarter, and residuals over it have the tails of
Student's distribution. Rows of one kind have similar noise, so their variances are drawn towards a common one, as far
as they scatter no more than such few values must (empirical Bayes; G. K. Smyth, 2004, Statistical Applications in
Genetics and Molecular Biology 3, 3).
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import brentq
from scipy.special import digamma, polygamma

from nmt_core.numerics.arrays import FloatArray
from nmt_diagnose.thresholds import THRESHOLDS


def moderated(variances: FloatArray, degrees_of_freedom: float) -> tuple[FloatArray, FloatArray]:
    """Variances drawn towards the common one.

    Args:
        variances: s² of one kind of row, shape (k,); zeros and NaN stay as they are.
        degrees_of_freedom: degrees of freedom of each.

    Returns:
        The moderated variances, shape (k,), and their degrees of freedom, shape (k,).
    """
    result = variances.copy()
    usable = np.isfinite(variances) & (variances > 0.0)
    degrees = np.full(variances.shape, degrees_of_freedom)
    if int(usable.sum()) < THRESHOLDS.noise.moderated_fewest:
        return result, degrees
    logs = np.log(variances[usable]) - digamma(0.5 * degrees_of_freedom) + np.log(0.5 * degrees_of_freedom)
    excess = float(np.var(logs, ddof=1)) - float(polygamma(1, 0.5 * degrees_of_freedom))
    prior = _degrees_of_freedom_of(excess)
    common = float(np.exp(logs.mean() + digamma(0.5 * prior) - np.log(0.5 * prior)))
    result[usable] = (degrees_of_freedom * variances[usable] + prior * common) / (degrees_of_freedom + prior)
    degrees[usable] = degrees_of_freedom + prior
    return result, degrees


def _degrees_of_freedom_of(excess: float) -> float:
    """Degrees of freedom d with ψ'(d/2) = excess, at most 1e4."""
    smallest = float(polygamma(1, 0.5 * THRESHOLDS.noise.most_degrees_of_freedom))
    if excess <= smallest:
        return THRESHOLDS.noise.most_degrees_of_freedom
    return 2.0 * float(
        brentq(lambda half: float(polygamma(1, half)) - excess, 1e-3, 0.5 * THRESHOLDS.noise.most_degrees_of_freedom)
    )
