"""Floquet multipliers against exponentials of the linear system, folds, and the decay of transients."""

from __future__ import annotations

import numpy as np
import pytest

from nmt_rig.model.assembly import OutputRow, assemble
from nmt_rig.model.chain import lumped_chain
from nmt_rig.model.forced_response import ForcedProblem, frequency_response
from nmt_rig.model.fourier_basis import FourierBasis
from nmt_rig.model.linear_modes import damped_modes
from nmt_rig.model.local_elements import CubicSpring, Jenkins, UnilateralStop
from nmt_rig.model.stability import floquet_stability
from nmt_rig.model.time_integration import TimeIntegrator

ONE = np.array([1.0])


def test_linear_rig_with_shaker_has_the_exponentials_of_its_eigenvalues(beam, joint, shaker) -> None:
    system = assemble(beam, joint, 4, shaker)
    problem = ForcedProblem(system, FourierBasis.up_to(5), 139.4)
    item = frequency_response(problem, 1e-3, 135.0, 140.0, points=10).responses[0]
    result = floquet_stability(problem, item)
    period = 2.0 * np.pi / item.angular_frequency
    expected = np.exp(damped_modes(system).eigenvalues[0] * period)
    assert result.stable
    assert np.abs(result.multipliers - expected).min() < 1e-8
    slowest = float(damped_modes(system).eigenvalues.real.max())
    assert abs(result.multipliers[0]) == pytest.approx(np.exp(slowest * period), rel=1e-6)


def test_folding_branch_of_the_duffing_oscillator_is_unstable() -> None:
    structure = lumped_chain([1.0], [], None, [1.0], [0.04])
    problem = ForcedProblem(assemble(structure, [CubicSpring(ONE, 1.0)], 1), FourierBasis.up_to(9), 1.0)
    response = frequency_response(problem, 0.05, 0.8, 1.6)
    parts = response.at(1.25)
    assert len(parts) == 3
    results = [floquet_stability(problem, item) for item in parts]
    assert [result.stable for result in results] == [True, False, True]
    # Liouville: the product of the multipliers is exp(−c T).
    expected = np.exp(-0.04 * 2.0 * np.pi / 1.25)
    for result in results:
        assert np.prod(result.multipliers) == pytest.approx(expected, rel=1e-9)


def test_one_multiplier_passes_one_at_the_fold() -> None:
    structure = lumped_chain([1.0], [], None, [1.0], [0.04])
    problem = ForcedProblem(assemble(structure, [CubicSpring(ONE, 1.0)], 1), FourierBasis.up_to(9), 1.0)
    response = frequency_response(problem, 0.05, 0.8, 1.6, points=120)
    fold = int(np.argmax(np.diff(response.omega_rad_s) < 0.0))
    assert 0 < fold < len(response.responses) - 4

    def beyond_one(item) -> float:
        return float(np.prod(1.0 - floquet_stability(problem, item).multipliers).real)

    assert beyond_one(response.responses[fold - 3]) > 0.0
    assert beyond_one(response.responses[fold + 4]) < 0.0


def transient_recurrence(system, drive: float, omega: float, skip: int, count: int) -> tuple[float, float]:
    """Trace and determinant of the one-period map, fitted to the decay of a transient (one dof)."""
    per_period = 4096
    rate = per_period * omega / (2.0 * np.pi)
    row = np.ones(1)
    plant = TimeIntegrator(system, rate, [OutputRow(np.zeros(1), np.zeros(1), row, 0.0)])
    voltage = drive * np.cos(2.0 * np.pi * np.arange(per_period + 1) / per_period)
    states = []
    for _ in range(skip + count):
        plant.advance(voltage)
        states.append(plant.physical_state[:2].copy())
    for _ in range(300):
        plant.advance(voltage)
    deviation = np.array(states[skip:]) - plant.physical_state[:2]
    # d_{k+2} = trace d_{k+1} − det d_k for both states.
    left = np.column_stack((deviation[1:-1].T.ravel(), -deviation[:-2].T.ravel()))
    trace, determinant = np.linalg.lstsq(left, deviation[2:].T.ravel(), rcond=None)[0]
    return float(trace), float(determinant)


def test_decay_of_a_friction_transient() -> None:
    system = assemble(lumped_chain([1.0], [], None, [400.0], [1.2]), [Jenkins(ONE, 150.0, 0.5)], 1)
    omega = 19.0
    problem = ForcedProblem(system, FourierBasis.up_to(41), 20.0)
    item = frequency_response(problem, 1.0, 12.0, omega + 0.5, points=60).at(omega)[0]
    multipliers = floquet_stability(problem, item).multipliers
    trace, determinant = transient_recurrence(system, 1.0, omega, 25, 8)
    expected = np.sort_complex(np.roots([1.0, -trace, determinant]))
    np.testing.assert_allclose(np.sort_complex(multipliers[:2]), expected, atol=2e-3)


def test_stop_against_the_perturbed_map_of_one_period() -> None:
    system = assemble(lumped_chain([1.0], [], None, [400.0], [1.2]), [UnilateralStop(ONE, 300.0, 0.01)], 1)
    omega, per_period = 22.0, 8192
    problem = ForcedProblem(system, FourierBasis.up_to(41), 20.0)
    item = frequency_response(problem, 1.0, 12.0, omega + 0.5, points=60).at(omega)[0]
    rate = per_period * omega / (2.0 * np.pi)
    plant = TimeIntegrator(system, rate, [OutputRow(np.zeros(1), np.zeros(1), ONE, 0.0)])
    voltage = np.cos(2.0 * np.pi * np.arange(per_period + 1) / per_period)
    for _ in range(150):
        plant.advance(voltage)
    settled = plant.physical_state[:2].copy()

    def after_a_period(state: np.ndarray) -> np.ndarray:
        plant.set_state(state[:1], state[1:])
        plant.advance(voltage)
        return plant.physical_state[:2].copy()

    steps = np.diag([1e-6, 2e-5])
    columns = [(after_a_period(settled + step) - after_a_period(settled - step)) / (2.0 * step.sum()) for step in steps]
    expected = np.linalg.eigvals(np.array(columns).T)
    multipliers = floquet_stability(problem, item).multipliers
    np.testing.assert_allclose(np.sort_complex(multipliers), np.sort_complex(expected), atol=2e-3)
