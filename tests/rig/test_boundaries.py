"""Ends of a beam against the roots of their frequency equations, and free beams on soft springs."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import brentq

from nmt_core.errors import BenchError
from nmt_rig.linear_description import linear_description
from nmt_rig.model.assembly import assemble
from nmt_rig.model.beam import Supports, euler_bernoulli_beam
from nmt_rig.model.continuation import NotConvergedError
from nmt_rig.model.epmc import epmc_backbone
from nmt_rig.model.exciter import OutputRow
from nmt_rig.model.fourier_basis import FourierBasis
from nmt_rig.model.linear_modes import sticking_modes
from nmt_rig.model.local_elements.springs import CubicSpring
from nmt_rig.model.time_integration import TimeIntegrator
from nmt_rig.rig import load_rig

LENGTH, WIDTH, HEIGHT, MODULUS, DENSITY = 0.6, 0.03, 0.005, 70e9, 2700.0
BENDING = MODULUS * WIDTH * HEIGHT**3 / 12.0
PER_LENGTH = DENSITY * WIDTH * HEIGHT

EQUATIONS = {
    "clamped-free": (lambda x: np.cos(x) + 1.0 / np.cosh(x), (1.5, 4.0, 7.0)),
    "clamped-clamped": (lambda x: np.cos(x) - 1.0 / np.cosh(x), (4.2, 7.4, 10.5)),
    "free-free": (lambda x: np.cos(x) - 1.0 / np.cosh(x), (4.2, 7.4, 10.5)),
    "clamped-pinned": (lambda x: np.sin(x) - np.tanh(x) * np.cos(x), (3.5, 6.5, 9.7)),
    "pinned-pinned": (np.sin, (3.0, 6.0, 9.0)),
}


def beam(boundary, elements, **more):
    return euler_bernoulli_beam(LENGTH, WIDTH, HEIGHT, MODULUS, DENSITY, elements, boundary=boundary, **more)


def exact(boundary):
    equation, starts = EQUATIONS[boundary]
    roots = np.array([brentq(equation, start, start + 1.2) for start in starts])
    return roots**2 * np.sqrt(BENDING / PER_LENGTH) / LENGTH**2


def test_roots_are_those_of_the_textbooks():
    roots = {name: np.sqrt(exact(name) * LENGTH**2 / np.sqrt(BENDING / PER_LENGTH)) for name in EQUATIONS}
    np.testing.assert_allclose(roots["clamped-clamped"], [4.7300, 7.8532, 10.9956], atol=5e-5)
    np.testing.assert_allclose(roots["clamped-pinned"], [3.9266, 7.0686, 10.2102], atol=5e-5)
    np.testing.assert_allclose(roots["clamped-free"], [1.8751, 4.6941, 7.8548], atol=5e-5)


@pytest.mark.parametrize("boundary", EQUATIONS)
def test_frequencies_converge_with_the_fourth_power_of_the_mesh(boundary):
    rigid = 2 if boundary == "free-free" else 0
    errors = []
    for elements in (8, 16):
        found = sticking_modes(beam(boundary, elements)).frequencies[rigid : rigid + 3]
        errors.append(np.abs(found / exact(boundary) - 1.0))
    assert np.all(errors[1] < 1e-3)
    np.testing.assert_allclose(np.log2(errors[0] / errors[1]), 4.0, atol=0.25)


@pytest.mark.parametrize("boundary", EQUATIONS)
def test_points_are_the_nodes_that_move(boundary):
    structure = beam(boundary, 6, refinement=2)
    shapes = sticking_modes(structure, [], 3)
    count = {"clamped-free": 6, "free-free": 7}.get(boundary, 5)
    assert shapes.points == tuple(range(1, count + 1))
    assert structure.size == 2 * 13 - {"clamped-free": 2, "free-free": 0, "clamped-clamped": 4}.get(
        boundary, {"clamped-pinned": 3, "pinned-pinned": 2}.get(boundary)
    )
    # Alike at both ends: the first elastic shape is symmetric about the middle.
    if boundary in ("clamped-clamped", "pinned-pinned"):
        np.testing.assert_allclose(shapes.shapes[:, 0], shapes.shapes[::-1, 0], rtol=1e-6)
        assert np.argmax(np.abs(shapes.shapes[:, 0])) == 2


def test_free_beams_have_two_modes_at_exactly_zero():
    modes = sticking_modes(beam("free-free", 8))
    assert np.all(modes.frequencies[:2] == 0.0)
    assert modes.frequencies[2] > 0.0
    assert np.all(np.isfinite(modes.damping_ratios))


def test_a_free_beam_bounces_on_its_soft_springs():
    structure = beam("free-free", 12, supports=Supports(suspension_stiffness=2.0, suspension_damping=0.1))
    modes = sticking_modes(structure)
    mass = PER_LENGTH * LENGTH
    # Rigid body on two springs at its ends: bounce and rocking (inertia m L²/12); the beam is 10⁵ times stiffer.
    np.testing.assert_allclose(modes.frequencies[0], np.sqrt(2.0 * 2.0 / mass), rtol=1e-3)
    np.testing.assert_allclose(
        modes.frequencies[1], np.sqrt(2.0 * 2.0 * LENGTH**2 / 4.0 / (mass * LENGTH**2 / 12.0)), rtol=1e-3
    )
    np.testing.assert_allclose(modes.damping_ratios[0], 2.0 * 0.1 / (2.0 * mass * modes.frequencies[0]), rtol=1e-3)
    np.testing.assert_allclose(modes.frequencies[2:5], exact("free-free"), rtol=2e-3)


def test_stiff_springs_make_a_clamp_and_soft_ones_a_hinge():
    clamped = sticking_modes(beam("clamped-clamped", 8), [], 3).frequencies
    held = beam("clamped-clamped", 8, supports=Supports(clamp_rotational_stiffness=1e9))
    np.testing.assert_allclose(sticking_modes(held, [], 3).frequencies, clamped, rtol=1e-6)
    hinged = beam("clamped-clamped", 8, supports=Supports(clamp_rotational_stiffness=1e-6))
    pinned = sticking_modes(beam("pinned-pinned", 8), [], 3).frequencies
    np.testing.assert_allclose(sticking_modes(hinged, [], 3).frequencies, pinned, rtol=1e-6)


def test_the_points_of_a_beam_are_the_ends_of_its_parts():
    own = euler_bernoulli_beam(LENGTH, WIDTH, HEIGHT, MODULUS, DENSITY, 5, 1e-5, 2)
    assert own.points == {node: 4 * node - 2 for node in range(1, 6)}


@pytest.mark.parametrize(
    ("override", "says"),
    [
        ("structure.boundary=clamped", "structure.boundary must be 'clamped-free', 'clamped-clamped'"),
        ("structure.suspension_stiffness_n_m=3", "suspension_stiffness_n_m carries a free-free beam"),
    ],
)
def test_ends_that_do_not_fit_are_refused(override, says):
    with pytest.raises(BenchError, match=says):
        load_rig("beam", [override])


def test_springs_of_an_end_that_is_not_there_are_refused():
    with pytest.raises(BenchError, match="needs a clamped end, and the beam is pinned-pinned"):
        load_rig("beam", ["structure.boundary=pinned-pinned", "structure.clamp_lateral_stiffness_n_m=1e6"])
    with pytest.raises(BenchError, match=r"sensors\.4\.point is 6, but the structure has points 1 to 5"):
        load_rig("beam", ["structure.boundary=clamped-clamped", "structure.elements=6"])


def test_a_free_beam_is_tested_at_an_elastic_mode():
    free = ["structure.boundary=free-free", "local_elements=[]"]
    with pytest.raises(BenchError, match="modes 1 to 2 are rigid-body modes of rig beam at 0 Hz"):
        load_rig("beam", free)
    linear = linear_description(load_rig("beam", [*free, "test.mode=3", "extraction.linear_modes=3"]))
    assert linear.frequencies_rad_s[:2] == (0.0, 0.0)
    assert linear.frequency_hz > 100.0


def test_a_floating_beam_needs_its_cords_for_the_mean_position():
    amplitudes = np.geomspace(1e-6, 1e-3, 4)

    def backbone(basis, **more):
        free = beam("free-free", 6, stiffness_damping=1e-6, **more)
        return epmc_backbone(free, [CubicSpring(free.direction(1, 4), 1e8)], amplitudes, basis, mode=2)

    with pytest.raises(NotConvergedError, match="has no mean position"):
        backbone(FourierBasis.up_to(5))
    odd = backbone(FourierBasis.up_to(5, odd_only=True))
    held = backbone(FourierBasis.up_to(5), supports=Supports(suspension_stiffness=0.2))
    np.testing.assert_allclose(held.omega_rad_s, odd.omega_rad_s, rtol=2e-5)
    assert odd.omega_rad_s[-1] > 1.1 * odd.omega_rad_s[0]


@pytest.mark.parametrize("cubic", [0.0, 1e9])
def test_a_floating_beam_moves_off_as_a_rigid_body(cubic):
    """The centre of mass goes on under ∫∫ F / m, whatever bends: mean of the displacement, weighted by the mass."""
    free = beam("free-free", 4, stiffness_damping=1e-5)
    mass = PER_LENGTH * LENGTH
    # Σ (row of M) q over lateral degrees of freedom is m times the centre's displacement.
    centre = OutputRow(np.zeros(free.size), np.zeros(free.size), free.base_load / mass, 0.0)
    elements = [CubicSpring(free.direction(1, 3), cubic)] if cubic else []
    system = assemble(free, elements, 2)
    time = np.arange(4001) / 5000.0
    found = TimeIntegrator(system, 5000.0, [centre], 4).advance(2.0 * np.sin(60.0 * time))[0]
    exact = 2.0 / mass * (time / 60.0 - np.sin(60.0 * time) / 60.0**2)
    np.testing.assert_allclose(found, exact[:-1], atol=2e-5 * exact.max())
