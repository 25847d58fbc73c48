"""Standard uncertainties from sub-windows.

A window is cut into K sub-windows of whole periods. Each quantity is evaluated K times on the window without
one of them, and the scatter of these values gives its standard uncertainty (delete-one jackknife). For a mean
this is the scatter of the sub-windows divided by √K; for damping, PBMIF and other nonlinear functions it
evaluates them at nearly the noise level of the whole window, where evaluating single sub-windows would
exaggerate their bias.
"""

from __future__ import annotations

import math

import numpy as np

from nmt_core.numerics.arrays import ComplexArray, FloatArray


def sub_window_count(periods: int, wanted: int = 10) -> int:
    """Number of sub-windows K.

    Ten by default: the stated uncertainty is then itself known to 1/√(2(K − 1)) = 24 %, while each sub-window
        of the
    usual 80 to 200 periods is still long (8 to 20 periods) compared with the periods over which a lightly damped
    structure or the loop's filter correlates the noise. A sub-window has at least two periods.

    Args:
        periods: whole periods in the window.
        wanted: K for long windows.

    Returns:
        K, or 0 if the window is too short (K would be below 3).
    """
    count = min(wanted, periods // 2)
    return count if count >= 3 else 0


def jackknife_variance(values: ComplexArray | FloatArray) -> FloatArray:
    """Variance from delete-one values along the first axis, K at least 2; of complex ones of both parts together."""
    count = values.shape[0]
    deviations = values - values.mean(axis=0)
    return np.asarray((count - 1) / count * (np.abs(deviations) ** 2).sum(axis=0), dtype=np.float64)


def jackknife(values: FloatArray, whole: float) -> float:
    """Standard uncertainty from delete-one values.

    The jackknife's estimate of the bias is added in quadrature: noise alone lowers indicators that are
    largest without it (PBMIF, fundamental contents, MAC), and this bias does not belong to the scatter. It
    vanishes for linear quantities.

    Args:
        values: value without sub-window k, shape ``(K,)``, K at least 2.
        whole: value over the whole window.

    Returns:
        √((K − 1)/K Σ (x_k − x̄)² + (K − 1)² (x̄ − x)²).
    """
    bias = (values.shape[0] - 1) * (float(values.mean()) - whole)
    return math.sqrt(float(jackknife_variance(values)) + bias * bias)


def slope_uncertainty(time: FloatArray, values: FloatArray) -> float:
    """Standard uncertainty of the slope of a straight line through equally trusted values.

    Args:
        time: shape ``(K,)``.
        values: shape ``(K,)``.

    Returns:
        Slope's standard uncertainty, from the scatter about the fitted line; NaN below three values.
    """
    count = time.shape[0]
    if count < 3:
        return math.nan
    centred = time - time.mean()
    spread = float((centred * centred).sum())
    slope = float((centred * values).sum()) / spread
    residual = values - values.mean() - slope * centred
    return math.sqrt(float((residual * residual).sum()) / (count - 2) / spread)
