"""The law for several exciters on a plant of known matrices: closed form, wrong and unknown gains, limits, giving up."""

from __future__ import annotations

import cmath
import math

import numpy as np
import pytest
from pll.force_plant import BLOCK, CUTOFF, FREQUENCY, FUNDAMENTAL_RATIO, HIGHEST, ForcePlant, matrices
from scipy.optimize import brentq

from nmt_pll.force_control.gain_estimate import GainEstimate, solved
from nmt_pll.thresholds import HARMONICS


def turned(degrees: float) -> complex:
    return cmath.rect(1.0, math.radians(degrees))


@pytest.mark.parametrize("exciters", [1, 2, 3])
@pytest.mark.parametrize("latency", [0, 1, 3])
def test_deviations_decay_as_the_closed_form_says(exciters, latency):
    """With the right matrix each force is a loop of its own: s (1 + s/ω_LP) + κ e^(−sT) = 0."""
    plant = ForcePlant(exciters, latency)
    rate, dead = plant.controller.rate, (1.0 + latency) * BLOCK  # half a block of the hold, half of the straight line
    closed = [s for s in np.linspace(-1.5 * rate, -0.5 * rate, 400)]
    loop = lambda s: s * (1 + s / CUTOFF) + rate * math.exp(-s * dead)  # noqa: E731
    first = next(k for k in range(398, -1, -1) if loop(closed[k]) * loop(closed[k + 1]) <= 0.0)
    slowest = brentq(loop, closed[first], closed[first + 1])
    plant.run(2.0 / rate)
    before, begun = np.abs(plant.deviation[0, 2]), plant.blocks
    plant.run(3.0 / rate)
    measured = math.log(np.abs(plant.deviation[0, 2]) / before) / ((plant.blocks - begun) * BLOCK)
    assert measured == pytest.approx(slowest, rel=0.15)
