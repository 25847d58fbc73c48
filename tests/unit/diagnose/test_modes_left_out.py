"""Modes that a modal model leaves out: what they add to responses at held amplitudes is noise that rows share."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from unit.diagnose.test_stepped_sine import DAMPER, OMEGA, observations_of, oscillator, swept

from nmt_core.blocks import FloatArray, Quantity
from nmt_diagnose.inference.chain_errors import chain_errors
from nmt_diagnose.inference.problem import Problem
from nmt_diagnose.observations.conditions import MeasuredChannel
from nmt_diagnose.observations.measuring_chain import table_chain
from nmt_diagnose.twin.forward import Forward
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


def left_by_columns(rig: Rig) -> tuple[float, float]:
    """Largest difference that the other mode makes, ln and rad, and what is left of it after the shared errors."""
    test = swept(LINES, 1.0, receptance(True))
    observations = replace(observations_of([test]), chains=(table_chain(),))
    forward = Forward(observations.tests, observations.rows)
    problem = Problem(observations, forward)
    prediction = forward.predict(rig)
    _, columns = chain_errors(problem, rig, prediction)
    difference = problem.difference(prediction.values)
    # The most probable errors of the chain, noise 1e-4.
    found: FloatArray = columns @ np.linalg.solve(
        columns.T @ columns + 1e-8 * np.eye(columns.shape[1]), columns.T @ difference
    )
    return float(np.abs(difference).max()), float(np.abs(difference - found).max())


def test_a_mode_above_the_band_is_within_the_tolerances() -> None:
    before, after = left_by_columns(oscillator())
    assert before > 0.02
    assert after < 0.05 * before


def test_a_model_that_states_its_residual_has_no_such_tolerance() -> None:
    rig = oscillator()
    stated = ResidualSection(flexibility_m_n=[[1e-12]], frequency_hz=5000.0)
    same = rig.model_copy(update={"structure": rig.structure.model_copy(update={"residual": stated})})
    before, after = left_by_columns(same)
    assert after > 0.2 * before


def test_a_force_channel_beside_the_responses_has_no_other_modes() -> None:
    test = swept(LINES, 1.0, receptance(True))
    both = replace(test, channels=(*test.channels, MeasuredChannel("f1", Quantity.FORCE, 1)))
    rig = oscillator()
    found = []
    for own in (test, both):
        observations = replace(observations_of([own]), chains=(table_chain(),))
        forward = Forward(observations.tests, observations.rows)
        found.append(chain_errors(Problem(observations, forward), rig, forward.predict(rig))[1])
    alone, beside = (columns[:, np.any(columns != 0.0, axis=0)] for columns in found)
    np.testing.assert_allclose(beside, alone)
