"""Closed-form gains: published anchors, pole placement, refusals."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nmt_core.errors import BenchError
from nmt_core.messages.linear_description import LinearDescription
from nmt_pll.phase_loop.gains import ControllerGains, LoopPlant, closed_form_gains
from nmt_pll.thresholds import CURVE

TWO_PI = 2.0 * math.pi
CUTOFF = 84.52533574
VALUES = (TWO_PI * 107.621, 0.0011536, TWO_PI * 107.395, 0.00487154, -0.308784, 0.057)


@pytest.fixture
def plant() -> LoopPlant:
    return LoopPlant.from_values(*VALUES)


def test_conservative_gains_of_a_real_rig(plant):
    gains = closed_form_gains(plant, CUTOFF)
    assert gains.proportional == pytest.approx(6.36543, abs=5e-6)
    assert gains.integral == pytest.approx(69.69129, abs=5e-6)


def test_optimal_gains_of_a_real_rig(plant):
    gains = closed_form_gains(plant, CUTOFF, 0.802809)
    # λ_I is published to six digits: the gains follow to as many.
    assert gains.proportional == pytest.approx(19.15350816, rel=1e-6)
    assert gains.integral == pytest.approx(444.08549784, rel=1e-6)
    assert -(plant.plant_decay / CUTOFF + 1) / 3 == pytest.approx(-0.346367, abs=5e-7)


def test_plant_from_a_description_is_that_of_its_target_mode(plant):
    shapes = ((1.0, -0.308784),)
    modes = (100.0, VALUES[0]), (0.02, VALUES[1])
    linear = LinearDescription("test", 3, 1, (3,), *modes, shapes, VALUES[4], VALUES[2], VALUES[3], 0.057)
    assert LoopPlant.from_description(linear) == plant


@given(
    structure=st.floats(0.05, 50.0),
    ratio=st.floats(1.0, 50.0),
    mu=st.floats(0.0, 0.5),
    cutoff=st.floats(1.0, 200.0),
    imaginary=st.floats(0.0, 2.0),
)
def test_poles_of_the_linearised_loop_lie_where_they_are_put(structure, ratio, mu, cutoff, imaginary):
    """Loop: frequency → phase of the plant, δ_p (1 + μ)/δ_s /(s + δ_p); filter ω_LP/(s + ω_LP); PI."""
    decay = structure * ratio
    gains = closed_form_gains(LoopPlant(structure, decay, mu), cutoff, imaginary)
    slope = (1.0 + mu) / structure  # phase per change of frequency at rest
    open_loop = decay * cutoff * slope
    characteristic = np.polyadd(
        np.polymul([1.0, 0.0], np.polymul([1.0, decay], [1.0, cutoff])),
        open_loop * np.array([gains.proportional, gains.integral]),
    )
    real = -(decay / cutoff + 1.0) / 3.0 * cutoff
    wanted = np.poly([real, real + 1j * imaginary * cutoff, real - 1j * imaginary * cutoff])
    np.testing.assert_allclose(characteristic, wanted.real, rtol=1e-9)


@pytest.mark.parametrize("place", [0, 1, 2, 3])
@pytest.mark.parametrize("value", [0.0, -1.0])
def test_modal_values_must_be_positive(place, value):
    values = list(VALUES)
    values[place] = value
    with pytest.raises(BenchError, match="positive frequencies and damping ratios"):
        LoopPlant.from_values(*values)


def test_a_negative_mass_is_refused():
    with pytest.raises(BenchError, match="mass that is not negative"):
        LoopPlant.from_values(*VALUES[:5], -0.001)


@pytest.mark.parametrize("cutoff", [0.0, -1.0, math.nan])
def test_the_cutoff_must_be_positive(plant, cutoff):
    with pytest.raises(BenchError, match="cut-off of the adaptive filter must be positive"):
        closed_form_gains(plant, cutoff)


@pytest.mark.parametrize("slope", [-60.0, -20.0, 0.0, 20.0, 60.0])
def test_on_a_slope_the_gains_grow_within_their_bounds(slope):
    gains = ControllerGains(27.0, 350.0)
    decay = 1.3
    found = gains.on_slope(slope, decay)
    boost = 1.0 + abs(decay * slope) / (27.0 * decay + 350.0)
    assert found.integral == pytest.approx(350.0 * min(boost, CURVE.largest_boost))
    assert found.proportional == pytest.approx(27.0 * (1.0 if slope >= 0.0 else min(1.0 - decay * slope / 729.0, 1.5)))
    assert gains.on_slope(1e6, decay).integral == pytest.approx(2.5 * 350.0)
    assert gains.on_slope(-1e6, decay).proportional == pytest.approx(1.5 * 27.0)


@pytest.mark.parametrize("slope", [-200.0, -100.0, 0.0, 100.0])
def test_between_the_folds_the_loop_is_stable_with_these_gains(slope):
    # s (s² + 2 δ s + δ dω/dϑ) + (k_p s + k_i) (s + δ), the loop without filter and dead time
    decay = 1.3
    gains = ControllerGains(27.0, 350.0).on_slope(slope, decay)
    poles = np.roots(
        [
            1.0,
            2.0 * decay + gains.proportional,
            decay * slope + gains.proportional * decay + gains.integral,
            gains.integral * decay,
        ]
    )
    assert poles.real.max() < -0.5
