"""Modes that a modal model leaves out, and late sensors: noise that the rows of frequency responses share."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from diagnose.test_stepped_sine import DAMPER, OMEGA, observations_of, oscillator, swept

from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import FloatArray
from nmt_diagnose.chain.chain_columns import linear_chain
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.measurements.random_responses import RandomResponses
from nmt_diagnose.measurements.stepped_responses import SteppedResponses
from nmt_diagnose.observations.channels.measuring_chain import table_chain
from nmt_diagnose.prediction.forward import Forward
from nmt_rig.rig import ResidualSection, Rig

LINES = np.linspace(40.0, 62.0, 34)
MASS_OF_ANOTHER, ANOTHER_HZ = 3.0, 160.0  # kg, Hz


def receptance(other: bool) -> np.ndarray:
    """Displacement over force of the mode, with another one above the band or without, closed form."""
    omega = 2.0 * math.pi * LINES
    found = 1.0 / (OMEGA**2 - omega**2 + 1j * DAMPER * omega)
    if other:
        found = found + 1.0 / (MASS_OF_ANOTHER * ((2.0 * math.pi * ANOTHER_HZ) ** 2 - omega**2))
    return np.asarray(found)


def without_level(test: SteppedResponses) -> RandomResponses:
    return RandomResponses(
        "responses", 1, test.channels, "force", test.lines_hz, float(np.diff(LINES)[0]), "none", 0.0, 0.0, 0.0
    )


def left_by_columns(rig: Rig, response: np.ndarray, levelled: bool = True) -> tuple[float, float]:
    """Largest difference of measured responses, ln and rad, and what is left of it after the shared errors."""
    test = swept(LINES, 1.0, response)
    observations = replace(observations_of([test]), chains=(table_chain(),))
    if not levelled:
        observations = replace(observations, tests=(without_level(test),))
    forward = Forward(observations.tests, observations.rows)
    prediction = forward.predict(rig)
    columns = linear_chain(observations, rig, prediction).columns
    difference = forward.difference(observations.values, prediction.values)
    # The most probable errors of the chain, noise 1e-4.
    found: FloatArray = columns @ np.linalg.solve(
        columns.T @ columns + 1e-8 * np.eye(columns.shape[1]), columns.T @ difference
    )
    return float(np.abs(difference).max()), float(np.abs(difference - found).max())


@pytest.mark.parametrize("levelled", [True, False])
def test_a_mode_above_the_band_is_within_the_tolerances(levelled: bool) -> None:
    before, after = left_by_columns(oscillator(), receptance(True), levelled)
    assert before > 0.02
    assert after < 0.05 * before


def chain_columns(levelled: bool) -> float:
    """Change of the last line's phase by the standard deviations of all delays together."""
    test = swept(LINES, 1.0, receptance(False))
    observations = replace(observations_of([test]), chains=(table_chain(),))
    if not levelled:
        observations = replace(observations, tests=(without_level(test),))
    forward = Forward(observations.tests, observations.rows)
    rig = oscillator()
    found = linear_chain(observations, rig, forward.predict(rig))
    delays = [k for k, name in enumerate(found.names) if name.startswith("delay")]
    return float(np.linalg.norm(found.columns[-1, delays]))


def test_a_model_that_states_its_residual_has_no_such_tolerance() -> None:
    rig = oscillator()
    stated = ResidualSection(flexibility_m_n=[[1e-12]], frequency_hz=5000.0)
    same = rig.model_copy(update={"structure": rig.structure.model_copy(update={"residual": stated})})
    before, after = left_by_columns(same, receptance(True))
    assert after > 0.2 * before


@pytest.mark.parametrize("levelled", [True, False])
@pytest.mark.parametrize("delay", [1e-4, -1e-4])
def test_a_late_force_or_response_is_within_the_tolerances(levelled: bool, delay: float) -> None:
    """What is left beyond the direction goes with the square of the gain's error of 1 %."""
    late = 1.01 * receptance(False) * np.exp(-2j * math.pi * LINES * delay)
    before, after = left_by_columns(oscillator(), late, levelled)
    assert before > 2.0 * math.pi * 50.0 * 1e-4
    assert after < 0.03 * before
    # Force and displacement, 100 microseconds each.
    assert chain_columns(levelled) == pytest.approx(math.sqrt(2.0) * 2.0 * math.pi * LINES[-1] * 1e-4, rel=0.03)


def test_a_force_channel_beside_the_responses_has_no_other_modes() -> None:
    test = swept(LINES, 1.0, receptance(True))
    both = replace(test, channels=(*test.channels, MeasuredChannel("f1", Quantity.FORCE, 1)))
    rig = oscillator()
    found = []
    for own in (test, both):
        observations = replace(observations_of([own]), chains=(table_chain(),))
        forward = Forward(observations.tests, observations.rows)
        found.append(linear_chain(observations, rig, forward.predict(rig)).columns)
    alone, beside = (columns[:, np.any(columns != 0.0, axis=0)] for columns in found)
    np.testing.assert_allclose(beside, alone)
