"""Local elements beyond the model's own: each against equations written anew, limits, energy, order."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from rig.effect_rigs import DAMPER, MASS, RATE, SPRING, harmonic, oscillator, run
from scipy.integrate import cumulative_simpson, solve_ivp

from nmt_rig.linear_description import linear_description
from nmt_rig.model.assembly import assemble, displacement_output
from nmt_rig.model.chain import lumped_chain
from nmt_rig.model.local_elements.attachments import BoucWen, FractionalDamper, LuGre
from nmt_rig.model.local_elements.friction import Jenkins
from nmt_rig.model.time_integration import TimeIntegrator
from nmt_rig.rig_model import build_system

FORCE, HZ = 8.0, 30.0


def peer(rate, states, seconds=0.12, **settings):
    """x(t) at the samples by scipy; rate(x, v, z) -> (element force, ż…)."""

    def equations(t, s):
        g, *inner = rate(s[0], s[1], s[2:])
        drive = FORCE * np.cos(2 * np.pi * HZ * t)
        return [s[1], (drive - SPRING * s[0] - DAMPER * s[1] - g) / MASS, *inner]

    times = np.arange(round(seconds * RATE)) / RATE
    settings = {"method": "DOP853", "rtol": 1e-10, "atol": 1e-13, "max_step": 1e-4, **settings}
    return solve_ivp(equations, (0, seconds), [0.0] * (2 + states), t_eval=times, **settings).y


def eddy(x, v, z):
    return (12.0 * v / (1 + (v / 0.3) ** 2),)


def backlash(x, v, z):
    e = abs(x) - 2e-4
    return (np.sign(x) * max(e * (60_000.0 + 5e4 * np.sign(x) * v), 0.0) if e > 0 else 0.0,)


def bouc_wen(x, v, z):
    slope = 1 - abs(z[0] / 3e-4) ** 2 * (0.7 * np.sign(v * z[0]) + 0.3)
    return 9000.0 * (0.1 * x + 0.9 * z[0]), v * slope


def lugre(x, v, z):
    level = 1.0 + 0.5 * np.exp(-((v / 0.02) ** 2))
    slope = v - 2e4 * abs(v) * z[0] / level
    return 2e4 * z[0] + 3.0 * slope + 1.0 * v, slope


def slack(x, v, z):
    held = np.clip((np.sign(v) * z[0] / 3e-4 - 1.0) / 2e-3 + 1.0, 0.0, None)
    return np.sign(z[0]) * 9000.0 * max(abs(z[0]) - 1e-4, 0.0), v * (1.0 - held)


def tuned(x, v, z):
    y, w = z
    pull = -0.02 * (2 * np.pi * 60) ** 2 * y - 2 * 0.01 * 2 * np.pi * 60 * 0.02 * w - 4e5 * x**2
    return 2 * 4e5 * x * y, w, pull / 0.02


def rattle(x, v, z):
    y, w = z
    d, rate = x - y, v - w
    e = abs(d) - 2e-4
    contact = np.sign(d) * max(e * (3e4 + 2e4 * np.sign(d) * rate), 0.0) if e > 0 else 0.0
    g = contact + 0.3 * rate
    return g, w, g / 0.03


CASES = {
    "eddy_brake": (eddy, 0, {"damping_ns_m": 12.0, "critical_velocity_m_s": 0.3}, 2e-4),
    "backlash_damper": (backlash, 0, {"stiffness_n_m": 60_000.0, "damping_ns_m2": 5e4, "gap_m": 2e-4}, 2e-4),
    "bouc_wen": (
        bouc_wen,
        1,
        {"stiffness_n_m": 9000.0, "yield_displacement_m": 3e-4, "exponent": 2.0, "post_yield_ratio": 0.1, "shape": 0.7},
        2e-4,
    ),
    "lugre": (
        lugre,
        1,
        {
            "bristle_stiffness_n_m": 2e4,
            "bristle_damping_ns_m": 3.0,
            "viscous_damping_ns_m": 1.0,
            "coulomb_force_n": 1.0,
            "static_force_n": 1.5,
            "stribeck_velocity_m_s": 0.02,
        },
        2e-4,
    ),
    # Its slip sets in over the last percent of its way.
    "slack_slider": (slack, 1, {"tangential_stiffness_n_m": 9000.0, "slip_force_n": 1.8, "slack_m": 1e-4}, 5e-3),
    "tuned_mass_quadratic": (
        tuned,
        2,
        {"mass_kg": 0.02, "frequency_hz": 60.0, "damping_ratio": 0.01, "coupling_n_m2": 4e5},
        2e-4,
    ),
    "rattling_mass": (
        rattle,
        2,
        {
            "mass_kg": 0.03,
            "gap_m": 2e-4,
            "contact_stiffness_n_m": 3e4,
            "contact_damping_ns_m2": 2e4,
            "friction_ns_m": 0.3,
        },
        5e-4,
    ),
}


@pytest.mark.parametrize("kind", CASES)
def test_motion_against_equations_written_anew(kind):
    rate, states, keys, tolerance = CASES[kind]
    rig = oscillator([{"kind": kind, "point": 1, **keys}], substeps=2)
    ours = run(rig, HZ, FORCE, 0.12)["x1"]
    theirs = peer(rate, states, rtol=1e-7 if kind in ("bouc_wen", "slack_slider") else 1e-10)[0]
    bare = run(oscillator(), HZ, FORCE, 0.12)["x1"]
    scale = np.abs(theirs).max()
    assert np.abs(theirs - bare).max() > 0.05 * scale, "the element must be at work"
    assert np.abs(ours - theirs).max() < tolerance * scale


@pytest.mark.parametrize("kind", CASES)
def test_result_does_not_depend_on_the_block_length(kind):
    system = build_system(oscillator([{"kind": kind, "point": 1, **CASES[kind][2]}]))
    drive = FORCE * np.cos(2 * np.pi * HZ * np.arange(601) / RATE)
    outcome = []
    for lengths in ([600], [200, 1, 199, 150, 50]):
        integrator = TimeIntegrator(system, RATE, [displacement_output(system, 1), system.force])
        edges = np.cumsum([0, *lengths])
        parts = [integrator.advance(drive[a : b + 1]) for a, b in itertools.pairwise(edges)]
        outcome.append(np.concatenate(parts, axis=1))
    assert np.array_equal(*outcome)


def _end(attachment, substeps, rate=2000.0):
    structure = lumped_chain([MASS], [], None, [SPRING], [DAMPER])
    system = assemble(structure, [], 1, None, [attachment])
    integrator = TimeIntegrator(system, rate, [], substeps)
    times = np.arange(round(0.1 * rate) + 1) / rate
    integrator.advance(FORCE * np.sin(2 * np.pi * HZ * times))
    return integrator.physical_state


@pytest.mark.parametrize(
    "attachment",
    [BoucWen(np.array([1.0]), 9000.0, 3e-4, 2.0, 0.1, 0.7), LuGre(np.array([1.0]), 2e4, 3.0, 1.0, 1.0, 1.5, 0.05)],
    ids=["bouc_wen", "lugre"],
)
def test_friction_with_a_state_converges_with_second_order(attachment):
    reference = _end(attachment, 256)
    errors = [np.abs(_end(attachment, n) - reference).max() / np.abs(reference).max() for n in (2, 4, 8, 16)]
    observed = -np.polyfit(np.log([2, 4, 8, 16]), np.log(errors), 1)[0]
    assert observed > 1.7, errors


def test_bouc_wen_becomes_the_jenkins_element():
    """a = 0, b = ½ and a large exponent: slip force k z_y, and its dissipation 4 μN (X - μN / k) a cycle."""
    structure = lumped_chain([MASS], [], None, [SPRING], [DAMPER])
    smooth = assemble(structure, [], 1, None, [BoucWen(np.array([1.0]), 1e4, 3e-4, 20.0)])
    sharp = assemble(structure, [Jenkins(np.array([1.0]), 1e4, 3.0)], 1)
    drive = FORCE * np.sin(2 * np.pi * HZ * np.arange(10_001) / RATE)
    x = [TimeIntegrator(s, RATE, [displacement_output(s, 1)], 2).advance(drive)[0] for s in (smooth, sharp)]
    bare = assemble(structure, [], 1)
    without = TimeIntegrator(bare, RATE, [displacement_output(bare, 1)]).advance(drive)[0]
    assert np.abs(without - x[1]).max() > 0.3 * np.abs(x[1]).max()
    assert np.abs(x[0] - x[1])[-4000:].max() < 0.02 * np.abs(x[1]).max()


@pytest.mark.parametrize("kind", CASES)
def test_a_test_of_a_rig_with_it_can_be_planned(kind):
    """A mode of an attachment that moves no point of the structure is not mistaken for the mode under test."""
    element = {"kind": kind, "point": 1, **CASES[kind][2]}
    with_it = linear_description(oscillator([element]))
    bare = linear_description(oscillator([]))
    assert with_it.plant_frequency_rad_s == pytest.approx(with_it.frequencies_rad_s[0], rel=0.2)
    if kind == "tuned_mass_quadratic":  # at rest it does not touch the structure
        assert with_it.plant_frequency_rad_s == pytest.approx(bare.plant_frequency_rad_s, rel=1e-9)


@pytest.mark.parametrize("kind", ["bouc_wen", "lugre", "eddy_brake", "backlash_damper", "rattling_mass"])
def test_what_the_drive_puts_in_is_what_dampers_and_elements_lose(kind):
    """Energy balance over steady periods: input = viscous loss + loss of the element, the latter positive."""
    rig = oscillator([{"kind": kind, "point": 1, **CASES[kind][2]}], substeps=2)
    y = run(rig, 25.0, FORCE, 3.2)
    period = 400
    x, f, a = y["x1"], y["f1"], y["a1"]
    v = np.gradient(x, 1 / RATE)
    # Element force from the equation of motion at the mass, hence its work.
    g = f - MASS * a - SPRING * x - DAMPER * v
    last = slice(-8 * period - 1, None)
    t = np.arange(8 * period + 1) / RATE
    work = [cumulative_simpson(force[last] * v[last], x=t)[-1] for force in (f, DAMPER * v, g)]
    assert work[2] > 0.02 * work[0]
    if kind != "rattling_mass":  # whose motion need not repeat
        assert work[0] == pytest.approx(work[1] + work[2], rel=2e-3)


def test_fractional_damper_has_its_complex_stiffness():
    for order in (0.2, 0.5, 0.8):
        damper = FractionalDamper(np.array([1.0]), 3.0, order, 2 * np.pi * 1.0, 2 * np.pi * 1000.0)
        _, damping, stiffness = damper.matrices()
        for hz in np.geomspace(1.0, 1000.0, 13):
            s = 2j * np.pi * hz
            z = stiffness + s * damping
            seen = z[0, 0] - z[0, 1:] @ np.linalg.solve(z[1:, 1:], z[1:, 0])
            assert abs(seen / (3.0 * s**order) - 1) < 1e-3


def test_fractional_damper_in_the_time_domain():
    element = {"kind": "fractional_damper", "point": 1, "coefficient_n_sa_m": 200.0, "order": 0.5}
    x = run(oscillator([element]), 25.0, FORCE, 3.0)["x1"]
    s = 2j * np.pi * 25.0
    expected = FORCE / (SPRING + s * DAMPER + s * s * MASS + 200.0 * s**0.5)
    assert abs(harmonic(x, 25.0) / expected - 1) < 1e-3
    assert abs(expected * (SPRING + s * DAMPER + s * s * MASS) / FORCE - 1) > 0.1


def test_tuned_mass_quadratic_leaves_small_motions_alone_and_answers_at_twice_the_frequency():
    keys = CASES["tuned_mass_quadratic"][2]
    element = {"kind": "tuned_mass_quadratic", "point": 1, **keys}
    small = run(oscillator([element]), HZ, 1e-3, 0.2)["x1"]
    bare = run(oscillator(), HZ, 1e-3, 0.2)["x1"]
    assert np.abs(small - bare).max() < 1e-5 * np.abs(bare).max()
    system = build_system(oscillator([element]))
    assert system.size == 2
    assert system.first_order == 0


def test_rattling_mass_rests_until_the_gap_is_reached():
    element = {"kind": "rattling_mass", "point": 1, **CASES["rattling_mass"][2], "friction_ns_m": 0.0}
    quiet = run(oscillator([element]), HZ, 0.25, 0.2)["x1"]
    bare = run(oscillator(), HZ, 0.25, 0.2)["x1"]
    assert np.abs(bare).max() < 2e-4
    np.testing.assert_allclose(quiet, bare, atol=1e-9 * np.abs(bare).max())


@pytest.mark.parametrize(
    ("values", "soft"),
    [
        ({"kind": "cubic_spring", "stiffness_n_m3": -1e9}, True),
        ({"kind": "quadratic_drag", "drag_ns2_m2": 3.0}, True),
        ({"kind": "amplitude_damper", "damping_ns_m3": 3.0}, True),
        ({"kind": "power_law_damper", "coefficient_n_sp_mp": 2.0, "exponent": 1.5}, True),
        ({"kind": "power_law_damper", "coefficient_n_sp_mp": 2.0, "exponent": 1.0}, False),
        ({"kind": "linear_damper", "damping_ns_m": 3.0}, False),
        ({"kind": "tanh_friction", "slip_force_n": 1.0, "reference_velocity_m_s": 0.1}, False),
        ({"kind": "jenkins", "tangential_stiffness_n_m": 1e4, "slip_force_n": 1.0}, False),
        ({"kind": "two_sided_gap", "stiffness_n_m": 1e4, "gap_m": 1e-4}, False),
        ({"kind": "iwan", "tangential_stiffness_n_m": 1e4, "slip_force_n": 1.0}, False),
        ({"kind": "bouc_wen", "stiffness_n_m": 1e4, "yield_displacement_m": 1e-4}, False),
    ],
)
def test_what_modes_at_rest_do_not_know(values, soft):
    """Smooth forces of higher than the first order; the slopes of all others do not vanish, or they have corners."""
    (section,) = oscillator([{"point": 1, **values}]).local_elements
    assert section.soft_at_rest == soft
