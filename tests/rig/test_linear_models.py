"""Structures, shaker and modes against published figures and closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from nmt_rig.model.assembly import assemble
from nmt_rig.model.beam import euler_bernoulli_beam
from nmt_rig.model.chain import lumped_chain
from nmt_rig.model.linear_modes import damped_modes, sticking_modes
from nmt_rig.model.local_elements.friction import Jenkins
from nmt_rig.model.propagator import phi_functions, propagator, state_space
from nmt_rig.model.shaker import ElectrodynamicShaker
from nmt_rig.model.structure import Structure


def test_beam_meets_the_anchors(beam, joint):
    modes = sticking_modes(beam, [joint], 3)
    np.testing.assert_allclose(modes.frequencies, [139.42, 762.3, 2050.0], rtol=5e-5)
    np.testing.assert_allclose(100 * modes.damping_ratios, [0.51, 3.50, 10.21], atol=0.005)


def test_damping_with_the_joint_stiffness_meets_the_other_anchor(beam, joint):
    direction = joint.direction
    stiffness = beam.stiffness + 8000.0 * np.outer(direction, direction)
    modes = sticking_modes(Structure(beam.mass, 1e-4 * stiffness, stiffness, beam.points), [], 3)
    np.testing.assert_allclose(100 * modes.damping_ratios, [0.70, 3.81, 10.25], atol=0.005)


def test_full_slip_lowers_mode_one(beam, joint):
    ratio = sticking_modes(beam, [], 1).frequencies[0] / sticking_modes(beam, [joint], 1).frequencies[0]
    assert ratio == pytest.approx(0.836, abs=5e-4)


def test_many_elements_reach_the_continuous_cantilever():
    structure = euler_bernoulli_beam(0.7, 0.00527668, 0.01156978, 185e9, 7830.0, 30)
    area, inertia = 0.00527668 * 0.01156978, 0.00527668 * 0.01156978**3 / 12
    roots = np.array([1.87510407, 4.69409113, 7.85475744])
    exact = roots**2 * np.sqrt(185e9 * inertia / (7830.0 * area * 0.7**4))
    np.testing.assert_allclose(sticking_modes(structure, [], 3).frequencies, exact, rtol=1e-5)


def test_shapes_are_mass_normalised(beam, joint):
    shapes = sticking_modes(beam, [joint], 4).full_shapes
    np.testing.assert_allclose(shapes.T @ beam.mass @ shapes, np.eye(4), atol=1e-10)


def test_chain_of_two_masses():
    chain = lumped_chain([1.0, 1.0], [100.0], ground_springs=[100.0, 100.0])
    np.testing.assert_allclose(sticking_modes(chain).frequencies, np.sqrt([100.0, 300.0]))


@pytest.mark.parametrize("arguments", [([],), ([1.0, -1.0], [1.0]), ([1.0, 1.0], [1.0, 2.0]), ([1.0, 1.0], [-1.0])])
def test_chain_refuses_nonsense(arguments):
    arguments = arguments if len(arguments) > 1 else (*arguments, [])
    with pytest.raises(ValueError, match=r"mass|springs|negative"):
        lumped_chain(*arguments)


@pytest.mark.parametrize("frequency", [5.0, 139.4, 900.0, 6.0e4])
def test_shaker_on_a_single_mass_in_closed_form(frequency):
    """Impedances in series by hand: circuit, coil, table and mass as scalars."""
    mass, spring, damper = 0.3, 4000.0, 2.0
    shaker = ElectrodynamicShaker(0.024, 20707.0, 28.33, 0.019, 8.42e7, 57.17, 15.48, 140e-6, 3.0)
    system = assemble(lumped_chain([mass], [], None, [spring], [damper]), [], 1, shaker)
    q, force = system.response(frequency)
    s = 1j * frequency
    structure = mass * s * s + damper * s + spring
    table = 0.024 * s * s + 28.33 * s + 20707.0
    link = 57.17 * s + 8.42e7
    electrical = 140e-6 * s + 3.0
    # Coil: (m_C s² + link + G² s / Z) x_C - link x = G u / Z.
    # Table and mass: (structure + table + link) x = link x_C.
    coil = 0.019 * s * s + link + 15.48**2 * s / electrical
    x = (15.48 / electrical) * link / (coil * (structure + table + link) - link**2)
    assert q[0] == pytest.approx(x, rel=1e-8)
    assert force == pytest.approx(structure * x, rel=1e-6)


def test_force_accelerates_the_structure(beam_system, beam, joint):
    """The stinger force that comes out is what moves the structure: S_structure q = direction f."""
    frequency = 130.0
    q, force = beam_system.response(frequency)
    stiffness = beam.stiffness + 8000.0 * np.outer(joint.direction, joint.direction)
    dynamic = stiffness + 1j * frequency * beam.damping - frequency**2 * beam.mass
    expected = np.zeros(beam.size, dtype=complex)
    expected[beam.points[2]] = force
    np.testing.assert_allclose(dynamic @ q[: beam.size], expected, atol=1e-7 * abs(force))


def test_damped_modes_are_eigenvalues_of_the_state_matrix(linear_system):
    values = np.linalg.eigvals(state_space(linear_system).a)
    expected = np.sort(np.abs(values[values.imag > 1.0]))
    modes = damped_modes(linear_system)
    np.testing.assert_allclose(modes.frequencies, expected, rtol=1e-6)
    assert np.all(modes.damping_ratios > 0)


def test_phi_functions_by_their_integrals():
    z = np.array([-30.0, -1.0, 1e-9, 0.3 + 2.0j, -0.99, 5j])
    nodes, weights = np.polynomial.legendre.leggauss(60)
    tau, weights = 0.5 * (nodes + 1), 0.5 * weights
    phi = phi_functions(z.astype(complex), 4)
    for k, factorial in ((1, 1.0), (2, 1.0), (3, 2.0), (4, 6.0)):
        integral = (np.exp(z[:, None] * (1 - tau)) * tau ** (k - 1) / factorial) @ weights
        np.testing.assert_allclose(phi[k], integral, rtol=1e-10)


def test_modal_and_dense_propagators_agree(beam_system):
    space = state_space(beam_system)
    modal, dense = propagator(space, 1e-4, 2), propagator(space, 1e-4, 2, force_dense=True)
    assert modal.modal
    assert not dense.modal
    rng = np.random.default_rng(0)
    scale = np.abs(np.linalg.inv(space.a)).sum(axis=1) + 1.0
    s = rng.standard_normal(space.size) / scale
    for level in range(3):
        z = modal.to_working @ s
        half = z.size // 2
        x, y = z[:half], z[half:]
        xx, xy, yx, yy = modal.pair[level]
        moved = modal.from_working @ np.concatenate([xx * x + xy * y, yx * x + yy * y])
        expected = dense.dense[level] @ s
        np.testing.assert_allclose(moved, expected, rtol=1e-6, atol=1e-8 * np.abs(expected).max())


@pytest.mark.parametrize("bad", [0.0, -1.0, float("nan"), float("inf")])
def test_elements_refuse_bad_parameters(bad):
    with pytest.raises(ValueError, match="slip_force"):
        Jenkins(np.array([1.0]), 1000.0, bad)
