"""Nonlinear modes against closed forms, linear limits, the given table, and finite differences."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.linalg import eigh
from scipy.special import ellipk

from nmt_core.errors import BenchError
from nmt_rig.model.chain import lumped_chain
from nmt_rig.model.epmc import EpmcProblem, epmc_backbone
from nmt_rig.model.fourier_basis import FourierBasis
from nmt_rig.model.local_elements.dampers import AmplitudeDamper, PowerLawDamper
from nmt_rig.model.local_elements.friction import Jenkins
from nmt_rig.model.local_elements.springs import CubicSpring
from nmt_rig.model.structure import Structure

ONE = np.array([1.0])


def test_linear_limit_of_the_sticking_beam(beam, joint) -> None:
    result = epmc_backbone(beam, joint, np.geomspace(1e-7, 1e-5, 4))
    stiffness = beam.stiffness + 8000.0 * np.outer(joint[0].direction, joint[0].direction)
    squares, _ = eigh(stiffness, beam.mass)
    # Damping acts on K without k_t, so the mode is slightly complex: solve that eigenproblem independently.
    omega = np.sqrt(squares[0])
    for _ in range(20):
        p, _ = np.linalg.eig(np.linalg.solve(beam.mass, stiffness + 1j * omega * beam.damping))
        p = p[np.argmin(np.abs(p))]
        omega = np.sqrt(p.real)
    np.testing.assert_allclose(result.omega_rad_s, omega, rtol=1e-10)
    np.testing.assert_allclose(result.damping_ratio, p.imag / omega / (2.0 * omega), rtol=1e-9)


def test_linear_limit_without_any_local_element(beam) -> None:
    result = epmc_backbone(beam, [], np.geomspace(1e-5, 1e-2, 5))
    squares, _ = eigh(beam.stiffness, beam.mass)
    omega = np.sqrt(squares[0])
    np.testing.assert_allclose(result.omega_rad_s, omega, rtol=1e-10)
    np.testing.assert_allclose(result.damping_ratio, 0.5e-4 * omega, rtol=1e-10)


def test_second_linear_mode(beam, joint) -> None:
    result = epmc_backbone(beam, joint, np.array([1e-7, 1e-6]), mode=1)
    squares, _ = eigh(beam.stiffness + 8000.0 * np.outer(joint[0].direction, joint[0].direction), beam.mass)
    np.testing.assert_allclose(result.omega_rad_s, np.sqrt(squares[1]), rtol=1e-5)


def test_duffing_one_harmonic_closed_form() -> None:
    m, c, k, k3 = 2.0, 0.4, 50.0, 30.0
    structure = lumped_chain([m], [], None, [k], [c])
    q = np.geomspace(1e-3, 3.0, 20)
    result = epmc_backbone(structure, [CubicSpring(ONE, k3)], q, FourierBasis.up_to(1))
    amplitude = q / np.sqrt(m)
    omega = np.sqrt((k + 0.75 * k3 * amplitude**2) / m)
    np.testing.assert_allclose(result.omega_rad_s, omega, rtol=1e-10)
    np.testing.assert_allclose(result.damping_ratio, c / m / (2.0 * omega), rtol=1e-9)


@pytest.mark.parametrize("exponent", [1.0, 1.5, 2.0, 3.0])
def test_dampers_that_grow_with_amplitude_one_harmonic_closed_form(exponent: float) -> None:
    """ζ from the energy of a cycle: E = 2π ζ m ω² a² for the viscous damping that stands for it."""
    m, k, c = 2.0, 50.0, 0.3
    structure = lumped_chain([m], [], None, [k], [0.0])
    q = np.geomspace(1e-2, 2.0, 6)
    a, omega = q / np.sqrt(m), np.sqrt(k / m)
    result = epmc_backbone(structure, [AmplitudeDamper(ONE, c)], q, FourierBasis.up_to(1))
    energy = 0.25 * np.pi * c * omega * a**4
    np.testing.assert_allclose(result.omega_rad_s, omega, rtol=1e-10)
    np.testing.assert_allclose(result.damping_ratio, energy / (2.0 * np.pi * m * omega**2 * a**2), rtol=1e-9)
    result = epmc_backbone(structure, [PowerLawDamper(ONE, c, exponent)], q, FourierBasis.up_to(1))
    cycle, _ = quad(lambda angle: abs(np.sin(angle)) ** (exponent + 1.0), 0.0, 2.0 * np.pi)
    energy = c * omega**exponent * a ** (exponent + 1.0) * cycle
    np.testing.assert_allclose(result.damping_ratio, energy / (2.0 * np.pi * m * omega**2 * a**2), rtol=1e-6)


def test_undamped_duffing_converges_to_the_elliptic_integral() -> None:
    m, k, k3 = 1.0, 1.0, 1.0
    structure = lumped_chain([m], [], None, [k], [0.0])
    q = np.geomspace(1e-2, 2.0, 8)
    result = epmc_backbone(structure, [CubicSpring(ONE, k3)], q, FourierBasis.up_to(15, odd_only=True))
    peak = np.abs(np.sum(result.normalised_shape[:, :, 0], axis=1)) * q
    parameter = k3 * peak**2 / (2.0 * (k + k3 * peak**2))
    exact = np.pi * np.sqrt(k + k3 * peak**2) / (2.0 * ellipk(parameter))
    np.testing.assert_allclose(result.omega_rad_s, exact, rtol=1e-10)


def test_jenkins_oscillator_one_harmonic_closed_form() -> None:
    m, k, kt, limit = 1.5, 100.0, 60.0, 0.3
    structure = lumped_chain([m], [], None, [k], [0.0])
    reach = limit / kt
    amplitude = reach * np.array([0.2, 0.9, 1.05, 1.5, 3.0, 20.0, 200.0])
    result = epmc_backbone(structure, [Jenkins(ONE, kt, limit)], amplitude * np.sqrt(m), FourierBasis.up_to(1))
    turn = np.arccos(1.0 - 2.0 * np.minimum(reach / amplitude, 1.0))
    omega = np.sqrt((k + kt / np.pi * (turn - 0.5 * np.sin(2.0 * turn))) / m)
    dissipated = 4.0 * limit * np.maximum(amplitude - reach, 0.0)
    np.testing.assert_allclose(result.omega_rad_s, omega, rtol=1e-10)
    np.testing.assert_allclose(
        result.damping_ratio, dissipated / (2.0 * np.pi * m * omega**2 * amplitude**2), atol=1e-12
    )


def test_given_backbone_of_the_beam(beam, joint, published_backbone) -> None:
    q, omega, damping = published_backbone.T
    result = epmc_backbone(beam, joint, q)
    assert q.size == 100
    np.testing.assert_allclose(result.omega_rad_s, omega, rtol=1e-4)
    np.testing.assert_allclose(result.damping_ratio, damping, rtol=1e-4)
    assert result.single_valued


def test_harmonics_converge_and_even_ones_stay_out(beam, joint) -> None:
    q = np.geomspace(1e-5, 0.02, 30)
    results = {h: epmc_backbone(beam, joint, q, FourierBasis.up_to(h)) for h in (1, 3, 5, 7, 20)}
    errors = [np.abs(results[h].damping_ratio / results[20].damping_ratio - 1.0).max() for h in (1, 3, 5, 7)]
    assert errors == sorted(errors, reverse=True)
    assert errors[-1] < 3e-3
    odd = epmc_backbone(beam, joint, q, FourierBasis.up_to(7, odd_only=True))
    np.testing.assert_allclose(odd.omega_rad_s, results[7].omega_rad_s, rtol=1e-11)
    np.testing.assert_allclose(odd.damping_ratio, results[7].damping_ratio, rtol=1e-9)


def test_shapes_are_normalised_and_satisfy_the_full_equation_of_motion(beam, joint) -> None:
    q = np.array([1e-5, 3e-4, 5e-3])
    result = epmc_backbone(beam, joint, q)
    problem = EpmcProblem(beam, joint, FourierBasis.up_to(7))
    direction = joint[0].direction
    for k in range(q.size):
        shapes = result.normalised_shape[k]
        omega, xi = result.omega_rad_s[k], 2.0 * result.damping_ratio[k] * result.omega_rad_s[k]
        assert (shapes[1].conj() @ beam.mass @ shapes[1]).real == pytest.approx(1.0, rel=1e-9)
        local = problem.basis.to_real((shapes @ direction)[None, :]) * q[k]
        force = problem.basis.to_complex(problem.local.forces(local, omega)[0])[0]
        for position, n in enumerate(result.orders):
            s = 1j * n * omega
            motion = beam.stiffness + s * (beam.damping - xi * beam.mass) + s**2 * beam.mass
            residual = motion @ shapes[position] * q[k] + direction * force[position]
            assert np.abs(residual).max() < 1e-9 * np.abs(beam.stiffness @ shapes[1]).max() * q[k]


@pytest.mark.parametrize("proportional", [True, False])
@pytest.mark.parametrize("log_amplitude", [-5.0, -3.3, -2.0])
def test_jacobian(beam, joint, finite_differences, proportional: bool, log_amplitude: float) -> None:
    damping = beam.damping.copy()
    if not proportional:
        damping[0, 0] += 0.1
    structure = Structure(beam.mass, damping, beam.stiffness, beam.points)
    problem = EpmcProblem(structure, joint, FourierBasis.up_to(7))
    assert problem.impedance.diagonal == proportional
    z = problem.linear_start(log_amplitude)
    z[:-1] += 0.02 * np.random.default_rng(0).normal(size=z.size - 1)
    assert finite_differences(problem, z) < 1e-8


def test_slipping_beam_approaches_the_free_beam(beam, joint) -> None:
    result = epmc_backbone(beam, joint, np.array([1e-5, 1.0]))
    assert result.omega_rad_s[1] / result.omega_rad_s[0] == pytest.approx(0.836, abs=1e-3)


def test_amplitudes_that_all_slip_give_the_same_as_a_range_that_starts_linear(beam) -> None:
    stiff = [Jenkins(beam.direction(2), 1e5, 1.0)]
    q = np.array([1e-5, 1e-4, 1e-3])
    short = epmc_backbone(beam, stiff, q, mode=1)
    long = epmc_backbone(beam, stiff, np.concatenate(([1e-8, 1e-6], q)), mode=1)
    np.testing.assert_allclose(short.damping_ratio, long.damping_ratio[2:], rtol=1e-9)


def test_refusals(beam, joint) -> None:
    with pytest.raises(BenchError, match="ascending"):
        epmc_backbone(beam, joint, np.array([2e-5, 1e-5]))
    with pytest.raises(BenchError, match="positive"):
        epmc_backbone(beam, joint, np.array([0.0, 1e-5]))
    with pytest.raises(BenchError, match="mode 99"):
        epmc_backbone(beam, joint, np.array([1e-5]), mode=98)
    lopsided = beam.damping.copy()
    lopsided[0, 1] += 1.0
    with pytest.raises(BenchError, match="symmetric"):
        epmc_backbone(Structure(beam.mass, lopsided, beam.stiffness), joint, np.array([1e-5]))
