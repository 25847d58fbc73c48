"""Stepping through a record with one coordinate: the loop without arrays against the one for any number of them."""

from __future__ import annotations

import numpy as np
import pytest

from nmt_diagnose.prediction.record_kernel import SteppedModel, _step_all, _step_one, step_through
from nmt_diagnose.prediction.rig_tables import local_tables
from nmt_diagnose.prediction.timed_elements import no_timed_elements
from nmt_rig.model.fourier_basis import FourierBasis
from nmt_rig.model.local_elements.contacts import TwoSidedGap, UnilateralStop
from nmt_rig.model.local_elements.dampers import AmplitudeDamper, PowerLawDamper
from nmt_rig.model.local_elements.element import LocalElement
from nmt_rig.model.local_elements.friction import Jenkins, TanhFriction
from nmt_rig.model.local_elements.springs import CubicSpring

RATE = 2000.0
ONE = np.ones(1)
ELEMENTS: dict[str, tuple[LocalElement, ...]] = {
    "cubic": (CubicSpring(ONE, stiffness=2e9),),
    "stop": (UnilateralStop(ONE, stiffness=3e4, gap=1e-3),),
    "gap": (TwoSidedGap(ONE, stiffness=3e4, gap=1e-3),),
    "Jenkins": (
        Jenkins(ONE, tangential_stiffness=2e4, slip_force=5.0),
        Jenkins(ONE, tangential_stiffness=1e4, slip_force=12.0),
    ),
    "friction": (TanhFriction(ONE, slip_force=3.0, reference_velocity=0.05),),
    "power law": (PowerLawDamper(ONE, coefficient=8.0, exponent=1.6),),
    "many": (
        CubicSpring(ONE, stiffness=1e9),
        Jenkins(ONE, tangential_stiffness=1e4, slip_force=8.0),
        UnilateralStop(ONE, stiffness=2e4, gap=2e-3),
        AmplitudeDamper(ONE, damping=1e5),
    ),
}


def oscillators() -> SteppedModel:
    """Recursion of two modes of 50 and 180 Hz, 1 kg each, forced and observed at one point."""
    step = 1.0 / RATE
    frequencies, damping = 2.0 * np.pi * np.array([50.0, 180.0]), np.array([0.01, 0.02])
    poles = frequencies * (-damping + 1j * np.sqrt(1.0 - damping**2))
    z = poles * step
    first, second = (np.exp(z) - 1.0) / z, (np.exp(z) - 1.0 - z) / z**2
    inputs = np.array([[1.0, 1.0], [0.7, 0.7]]) / (2j * poles.imag)[:, np.newaxis]
    early, late = step * (first - second)[:, np.newaxis] * inputs, step * second[:, np.newaxis] * inputs
    shapes = 2.0 * np.array([1.0, 0.7])
    outputs = np.array([shapes + 0j, shapes * poles, shapes * poles**2])
    velocities = outputs[1:2]
    direct = np.array([[0.0, 0.0], [0.0, 0.0], [1.49, 1.49]])
    return SteppedModel(np.exp(z), early, late, outputs, velocities, direct)


@pytest.mark.parametrize("substeps", [1, 3])
@pytest.mark.parametrize("name", list(ELEMENTS))
def test_one_coordinate_is_the_general_case(name: str, substeps: int) -> None:
    drive = 60.0 * np.random.default_rng(5).standard_normal(3000)
    tables = local_tables([ELEMENTS[name]], FourierBasis.up_to(1), 16)
    model, factor = oscillators(), np.zeros(3)
    start = np.array([1e-3 + 2e-3j, -5e-4j])
    general = _step_all(drive[np.newaxis], substeps, 1, model, factor, tables.elements, no_timed_elements(1), start)
    one = _step_one(drive, substeps, model, tables.elements, start)
    assert one.shape == (2, 3000 // substeps)
    # Sums run in another order; where an iteration ends, that may be a step earlier or later.
    np.testing.assert_allclose(one, general, atol=1e-8 * np.abs(general).max())
    np.testing.assert_array_equal(step_through(drive[np.newaxis], substeps, 1, model, factor, tables, start), one)
    at_rest = step_through(drive[np.newaxis], substeps, 1, model, factor, tables)
    assert np.abs(one[:, :100] - at_rest[:, :100]).max() > 0.0, "the start counts"
    free = step_through(drive[np.newaxis], substeps, 1, model, factor, local_tables([()], FourierBasis.up_to(1), 16))
    assert np.abs(one - free).max() > 0.05 * np.abs(free).max(), "the elements act"
