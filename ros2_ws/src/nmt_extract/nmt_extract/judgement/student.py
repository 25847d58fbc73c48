"""Quantiles of Student's t. Of scipy they alone were needed here, whose import took longer than the evaluation."""

from __future__ import annotations

import math
from functools import lru_cache
from statistics import NormalDist

import numpy as np

_MANY_DEGREES = 1000.0  # from here on the expansion in 1/ν is exact to twelve digits


@lru_cache(maxsize=1024)
def two_sided_quantile(degrees: float, coverage: float) -> float:
    """The t that holds a share of Student's distribution between -t and t.

    Args:
        degrees: of freedom, at least 1, or infinite.
        coverage: the share, between 0 and 1.

    Returns:
        t, relative error below 1e-10.

    Raises:
        ValueError: an argument is out of its range.
    """
    if not (degrees >= 1.0 and 0.0 < coverage < 1.0):
        raise ValueError(f"no quantile for {degrees} degrees of freedom and a coverage of {coverage}")
    normal = NormalDist().inv_cdf(0.5 * (1.0 + coverage))
    if degrees > _MANY_DEGREES:
        return _expanded(normal, degrees)
    nodes, weights = np.polynomial.legendre.leggauss(40)
    density = math.exp(math.lgamma(0.5 * (degrees + 1.0)) - math.lgamma(0.5 * degrees)) / math.sqrt(math.pi)
    t = normal  # below the solution; the share is concave in t, so that Newton's steps never pass it
    for _ in range(200):
        angle = math.atan2(t, math.sqrt(degrees))
        held = angle * density * float(weights @ np.cos(0.5 * angle * (nodes + 1.0)) ** (degrees - 1.0))
        slope = 2.0 * density / math.sqrt(degrees) * math.cos(angle) ** (degrees + 1.0)
        step = (coverage - held) / slope
        t += step
        if abs(step) < 1e-13 * t:
            break
    return t


def _expanded(z: float, degrees: float) -> float:
    """Expansion of Fisher and Cornish about the normal distribution's quantile (Abramowitz and Stegun, 26.7.5)."""
    first = (z**3 + z) / 4.0
    second = (5.0 * z**5 + 16.0 * z**3 + 3.0 * z) / 96.0
    third = (3.0 * z**7 + 19.0 * z**5 + 17.0 * z**3 - 15.0 * z) / 384.0
    return z + first / degrees + second / degrees**2 + third / degrees**3
