"""Masses, loss factor, compliant clamp, refined mesh: closed forms of the linear structure and the motion itself."""

from __future__ import annotations

import numpy as np
import pytest
from rig.effect_rigs import DAMPER, MASS, SPRING, beam, harmonic, oscillator, run
from scipy.linalg import eigh
from scipy.optimize import brentq

from nmt_core.errors import BenchError
from nmt_rig.linear_description import linear_description
from nmt_rig.model.linear_modes import damped_modes, sticking_modes
from nmt_rig.rig_model import build_structure, build_system

LENGTH, WIDTH, HEIGHT, YOUNG, DENSITY = 0.7, 0.00527668, 0.01156978, 185e9, 7830.0
BENDING = YOUNG * WIDTH * HEIGHT**3 / 12
LINE_MASS = DENSITY * WIDTH * HEIGHT


def frequencies(*overrides):
    return sticking_modes(build_structure(beam(*overrides)), ()).frequencies


def analytical(rotational=np.inf, lateral=np.inf, mode=0):
    """ω of a free-ended beam whose other end sits on a rotational and a lateral spring."""

    def determinant(beta):
        b, x = beta, beta * LENGTH
        # w = A cosh bx + B sinh bx + C cos bx + D sin bx; rows: moment and force at the root, at the tip.
        c, s, ch, sh = np.cos(x), np.sin(x), np.cosh(x), np.sinh(x)
        r = BENDING * b / rotational
        t = BENDING * b**3 / lateral
        return np.linalg.det(
            [
                [r, -1.0, -r, -1.0],  # EI w'' = k_r w'
                [1.0, t, 1.0, -t],  # EI w''' = -k_l w
                [ch, sh, -c, -s],
                [sh, ch, s, -c],
            ]
        )

    grid = np.linspace(0.3, 15.0, 4000) / LENGTH
    values = [determinant(b) for b in grid]
    roots = [
        brentq(determinant, a, b, xtol=1e-13)
        for a, b, u, v in zip(grid[:-1], grid[1:], values[:-1], values[1:], strict=True)
        if u * v < 0
    ]
    return roots[mode] ** 2 * np.sqrt(BENDING / LINE_MASS)


@pytest.mark.parametrize(
    ("keys", "springs"),
    [
        ([], {}),
        (["structure.clamp_rotational_stiffness_nm_rad=200"], {"rotational": 200.0}),
        (["structure.clamp_lateral_stiffness_n_m=20000"], {"lateral": 20_000.0}),
        (
            ["structure.clamp_rotational_stiffness_nm_rad=200", "structure.clamp_lateral_stiffness_n_m=20000"],
            {"rotational": 200.0, "lateral": 20_000.0},
        ),
    ],
)
def test_clamp_springs_and_mesh_meet_the_characteristic_equation(keys, springs):
    found = frequencies("structure.mesh_refinement=4", *keys)
    for mode in range(3):
        assert found[mode] == pytest.approx(analytical(**springs, mode=mode), rel=5e-6)


def test_the_mesh_converges_with_fourth_order_and_points_stay():
    exact = analytical(mode=2)
    errors = [frequencies(f"structure.mesh_refinement={n}")[2] / exact - 1 for n in (1, 2, 4)]
    assert np.diff(np.log2(errors)) == pytest.approx([-4, -4], abs=0.2)
    coarse, fine = (build_structure(beam(f"structure.mesh_refinement={n}")) for n in (1, 3))
    assert list(fine.points) == list(coarse.points) == [1, 2, 3, 4, 5, 6, 7]
    # A static force bends both the same: cubic shape functions are exact at nodes.
    for point in (2, 7):
        bend = [np.linalg.solve(s.stiffness, s.selector(5)) @ s.selector(point) for s in (coarse, fine)]
        assert bend[0] == pytest.approx(bend[1], rel=1e-9)


def test_a_stiff_clamp_is_the_rigid_one():
    stiff = frequencies(
        "structure.clamp_rotational_stiffness_nm_rad=1e10", "structure.clamp_lateral_stiffness_n_m=1e13"
    )
    np.testing.assert_allclose(stiff[:5], frequencies()[:5], rtol=1e-6)


def test_beam_damping_is_that_of_the_beam_without_its_clamp():
    plain, soft = (build_structure(beam(*keys)) for keys in ([], ["structure.clamp_rotational_stiffness_nm_rad=200"]))
    np.testing.assert_allclose(soft.damping[1:, 1:], plain.damping, rtol=1e-12)
    assert soft.damping[0, 0] == pytest.approx(1e-4 * (soft.stiffness[0, 0] - 200.0))


def test_added_mass_and_sensor_mass_lower_the_frequency_alike():
    added = oscillator(
        structure={
            "kind": "chain",
            "masses_kg": [MASS],
            "ground_springs_n_m": [SPRING],
            "ground_dampers_ns_m": [DAMPER],
            "added_masses": [{"point": 1, "mass_kg": 0.05}],
        }
    )
    sensors = [
        {"quantity": "force", "point": "drive"},
        {"quantity": "displacement", "point": 1, "mass_kg": 0.03},
        {"quantity": "acceleration", "point": 1, "mass_kg": 0.02},
    ]
    for rig in (added, oscillator(sensors=sensors)):
        assert linear_description(rig).frequencies_rad_s[0] == pytest.approx(np.sqrt(SPRING / 0.55), rel=1e-12)
        x = run(rig, 25.0, 8.0, 8.0)["x1"]
        s = 2j * np.pi * 25.0
        assert harmonic(x, 25.0) == pytest.approx(8.0 / (SPRING + s * DAMPER + s * s * 0.55), rel=5e-5)


def test_an_added_mass_on_the_beam_follows_rayleigh():
    base = sticking_modes(build_structure(beam()), ())
    heavy = frequencies("structure.added_masses=[{point: 7, mass_kg: 1e-5}]")
    shape = base.shapes[base.points.index(7)]
    np.testing.assert_allclose(heavy[:3] / base.frequencies[:3] - 1, -0.5 * 1e-5 * shape[:3] ** 2, rtol=2e-3)


def test_masses_that_leave_nothing_are_refused():
    rig = oscillator(
        structure={
            "kind": "chain",
            "masses_kg": [MASS],
            "ground_springs_n_m": [SPRING],
            "added_masses": [{"point": 1, "mass_kg": -0.6}],
        }
    )
    with pytest.raises(BenchError, match="added_masses"):
        build_structure(rig)


def test_loss_factor_is_twice_the_damping_ratio_of_every_mode():
    rig = beam(
        "structure.stiffness_damping_s=0.0",
        "structure.loss_factor=0.02",
        "structure.added_masses=[{point: 4, mass_kg: 0.05}]",
    )
    structure = build_structure(rig)
    squares, shapes = eigh(structure.stiffness, structure.mass)
    np.testing.assert_allclose(np.diag(shapes.T @ structure.damping @ shapes), 0.02 * np.sqrt(squares), rtol=1e-8)
    assert np.abs(structure.damping - structure.damping.T).max() < 1e-9 * np.abs(structure.damping).max()


def test_damping_factors_scale_the_modes_they_name_and_the_last_all_above():
    plain, changed = (build_structure(beam(f"structure.damping_factors={own}")) for own in ("[]", "[2.0, 1.0, 0.1]"))
    _, shapes = eigh(plain.stiffness, plain.mass)
    before, after = (np.diag(shapes.T @ own.damping @ shapes) for own in (plain, changed))
    expected = np.ones(before.size)
    expected[0], expected[2:] = 2.0, 0.1
    np.testing.assert_allclose(after / before, expected, rtol=1e-6)


def test_damping_that_couples_modes_follows_their_factors_and_stays_a_loss():
    """A soft clamp without damping of its own couples the modes of a beam that is damped by its stiffness."""
    soft = "structure.clamp_rotational_stiffness_nm_rad=200"
    plain, twice, small = (
        build_structure(beam(soft, f"structure.damping_factors={each}"))
        for each in ("[]", "[2.0]", "[1.0, 0.01, 0.01]")
    )
    size = np.abs(plain.damping).max()
    np.testing.assert_allclose(twice.damping, 2.0 * plain.damping, atol=1e-8 * size)
    _, shapes = eigh(plain.stiffness, plain.mass)
    coupled = shapes.T @ plain.damping @ shapes, shapes.T @ small.damping @ shapes
    assert coupled[1][0, 1] == pytest.approx(0.1 * coupled[0][0, 1], rel=1e-6)
    assert np.linalg.eigvalsh(small.damping).min() > -1e-8 * size


def test_loss_factor_in_the_time_domain_gives_the_resonance_of_complex_stiffness():
    structure = {"kind": "chain", "masses_kg": [MASS], "ground_springs_n_m": [SPRING], "loss_factor": 0.05}
    omega = np.sqrt(SPRING / MASS)
    hz = omega / (2 * np.pi)
    rate = 200 * hz  # whole samples a period
    x = run(oscillator(structure=structure, sample_rate_hz=rate), hz, 1.0, 2.0)["x1"]
    measured = harmonic(x, hz, rate=rate)
    assert measured == pytest.approx(1.0 / (1j * 0.05 * SPRING), rel=2e-4)


def test_rotational_spring_at_a_point_is_a_rotational_stiffness():
    """Against the beam of two elements with the spring put into its matrix by hand."""
    rig = beam(
        "structure.elements=2",
        "local_elements=[{kind: linear_spring, point: 1, rotation: true, stiffness_n_m: 50}]",
        "exciter.point=1",
        "sensors=[{quantity: force, point: drive}, {quantity: displacement, point: 1}, "
        "{quantity: displacement, point: 2}]",
    )
    structure = build_structure(rig)
    stiffness = structure.stiffness.copy()
    stiffness[1, 1] += 50.0
    expected = np.sqrt(eigh(stiffness, structure.mass, eigvals_only=True))
    assert linear_description(rig).frequencies_rad_s[0] == pytest.approx(expected[0], rel=1e-12)
    assert damped_modes(build_system(rig)).frequencies.size > 0
