"""Whether a re-fitted model still is the one that was given, or several parameters are far from what is believed.

A gain of the force cell that nobody names is taken by all modal masses, an error of the clock by all natural
frequencies. One parameter that is far off is a slip in the model file; several at once have a common cause.
"""

from __future__ import annotations

import math

import numpy as np

from nmt_diagnose.inference.fitted_model import FittedModel

_KNOWN = 0.1
"""Relative standard deviation up to which a parameter counts as known; damping, for one, is a guess."""


def prior_conflict(model: FittedModel) -> float:
    """ln of how much more probable the model's own parameters are if all that is believed of them is less certain.

    The standard deviations of all priors are multiplied by one factor, the best one; the parameter that is farthest off
    does not count.

    Args:
        model: a fit.

    Returns:
        0 where they are as probable as they are believed to be.
    """
    parametrisation = model.fit.parametrisation
    known = np.array([parameter.std <= _KNOWN for parameter in parametrisation.calibration], dtype=bool)
    theta = model.fit.theta[: known.size][known]
    squares = np.sort(theta**2)[:-1]
    size = float(squares.sum())
    if not squares.size or size <= squares.size:
        return 0.0
    return 0.5 * (size - squares.size - squares.size * math.log(size / squares.size))
