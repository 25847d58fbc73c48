"""Exciter: circuit, amplifier, force factor that varies, elements behind the force sensor."""

from __future__ import annotations

import numpy as np
import pytest
from rig.effect_rigs import DAMPER, MASS, RATE, SPRING, beam, harmonic, oscillator, run
from scipy.integrate import cumulative_simpson, solve_ivp

from nmt_core.errors import BenchError
from nmt_rig.linear_description import linear_description
from nmt_rig.model.assembly import current_output, displacement_output, velocity_output
from nmt_rig.model.time_integration import TimeIntegrator
from nmt_rig.reference import compute_reference, single_point_reference, with_exciter_at
from nmt_rig.rig import find_rig, load_rig
from nmt_rig.rig_model import build_system

SHAKER = {
    "kind": "electrodynamic_shaker",
    "point": 1,
    "table_mass_kg": 0.1,
    "table_stiffness_n_m": 1000.0,
    "table_damping_ns_m": 3.0,
    "coil_mass_kg": 0.05,
    "coil_stiffness_n_m": 2e5,
    "coil_damping_ns_m": 20.0,
    "force_factor_n_a": 15.0,
    "inductance_h": 2e-3,
    "resistance_ohm": 3.0,
}


def shaken(*elements, **exciter):
    return oscillator(elements, exciter={**SHAKER, **exciter})


def coil_equations(b1=0.0, b2=0.0, volts=30.0, hz=20.0, table=lambda x: 0.0):
    """ẏ of (x, v, x_C, v_C, i) written anew."""

    def rate(t, y):
        x, v, c, vc, i = y
        factor = 15.0 * (1 + b1 * c + b2 * c * c)
        between = 2e5 * (x - c) + 20.0 * (v - vc)
        return [
            v,
            (-(SPRING + 1000.0) * x - (DAMPER + 3.0) * v - between - table(x)) / (MASS + 0.1),
            vc,
            (between + factor * i) / 0.05,
            (volts * np.cos(2 * np.pi * hz * t) - 3.0 * i - factor * vc) / 2e-3,
        ]

    return rate


def solve(rate, seconds):
    times = np.arange(round(seconds * RATE)) / RATE
    return solve_ivp(rate, (0, seconds), np.zeros(5), "DOP853", times, rtol=1e-9, atol=1e-13).y


def test_source_resistance_adds_to_that_of_the_coil():
    parts, sum_ = shaken(source_resistance_ohm=2.0), shaken(resistance_ohm=5.0)
    a, b = (run(rig, 20.0, 5.0, 0.1) for rig in (parts, sum_))
    for channel in ("f1", "x1", "u"):
        assert np.array_equal(a[channel], b[channel])
    assert linear_description(parts) == linear_description(sum_)


@pytest.mark.parametrize(("b1", "b2"), [(40.0, 0.0), (0.0, -8000.0), (-25.0, 5000.0)])
def test_varying_force_factor_against_equations_written_anew(b1, b2):
    rig = shaken(force_factor_linear_per_m=b1, force_factor_quadratic_per_m2=b2, inductance_h=2e-3)
    rig = rig.model_copy(update={"substeps": 2})
    ours = run(rig, 20.0, 30.0, 0.24)
    y = solve(coil_equations(b1, b2), 0.24)
    bare = solve(coil_equations(), 0.24)
    scale = np.abs(y[0]).max()
    assert np.abs(y[0] - bare[0]).max() > 0.02 * scale
    assert np.abs(ours["x1"] - y[0]).max() < 1e-4 * scale
    # Stinger force from the structure's own equation of motion.
    acceleration = np.array([coil_equations(b1, b2)(t, s)[1] for t, s in zip(np.arange(2400) / RATE, y.T, strict=True)])
    force = MASS * acceleration + SPRING * y[0] + DAMPER * y[1]
    assert np.abs(ours["f1"] - force).max() < 2e-4 * np.abs(force).max()


def test_varying_force_factor_converts_without_loss():
    """Electrical power minus ohmic loss is what the circuit stores and the coil does in work."""
    system = build_system(shaken(force_factor_linear_per_m=40.0, force_factor_quadratic_per_m2=-5000.0))
    coil = system.coil
    row = displacement_output(system, 1)
    of_coil = np.zeros(system.size)
    of_coil[coil] = 1.0
    zero = np.zeros(system.size)
    outputs = [current_output(system), type(row)(zero, zero, of_coil, 0.0), type(row)(zero, of_coil, zero, 0.0)]
    integrator = TimeIntegrator(system, RATE, [*outputs, velocity_output(system, 1), row], 4)
    u = 30.0 * np.sin(2 * np.pi * 20.0 * np.arange(4001) / RATE)
    i, c, vc, v, x = integrator.advance(u)
    factor = 15.0 * (1 + 40.0 * c - 5000.0 * c * c)
    t = np.arange(4000) / RATE
    put_in = cumulative_simpson(u[:-1] * i - 3.0 * i * i, x=t)
    turned = cumulative_simpson(factor * i * vc, x=t)
    stored = 0.5 * 2e-3 * i**2
    assert np.abs(put_in - turned - stored[1:] + stored[0]).max() < 1e-3 * np.abs(turned).max()
    mechanical = cumulative_simpson(20.0 * (v - vc) ** 2 + (DAMPER + 3.0) * v * v, x=t)
    energy = 0.5 * (0.05 * vc**2 + (MASS + 0.1) * v**2 + 2e5 * (x - c) ** 2 + (SPRING + 1000.0) * x**2)
    assert np.abs(turned - mechanical - energy[1:] + energy[0]).max() < 1e-3 * np.abs(turned).max()


def test_small_motions_do_not_see_the_force_factor_vary():
    a = run(shaken(force_factor_linear_per_m=40.0, force_factor_quadratic_per_m2=-5000.0), 20.0, 1e-4, 0.1)
    b = run(shaken(), 20.0, 1e-4, 0.1)
    assert np.abs(a["x1"] - b["x1"]).max() < 1e-5 * np.abs(b["x1"]).max()


def test_amplifier_saturates_statically_and_the_voltage_is_measured_before_it():
    limit, volts = 6.0, 10.0
    y = run(shaken(amplifier_saturation_v=limit), 25.0, volts, 4.0)
    angle = 2 * np.pi * np.arange(4096) / 4096
    shape = limit * np.tanh(volts * np.cos(angle) / limit)
    system = build_system(shaken())
    for order in (1, 3, 5):
        amplitude = 2 / 4096 * shape @ np.cos(order * angle)
        q, force = system.response(2 * np.pi * 25.0 * order)
        # The straight line between samples lowers the n-th harmonic by (nωh)²/12: 5e-4 at the fifth.
        amplitude *= 1 - (order * 2 * np.pi * 25.0 / RATE) ** 2 / 12
        assert harmonic(y["x1"], 25.0, order) == pytest.approx(amplitude * q[0], rel=2e-5)
        assert harmonic(y["f1"], 25.0, order) == pytest.approx(amplitude * force, rel=2e-5)
    assert harmonic(y["u"], 25.0) == pytest.approx(volts, rel=1e-9)
    assert abs(harmonic(y["u"], 25.0, 3)) < 1e-9


def test_a_high_limit_of_the_amplifier_is_none():
    a, b = run(shaken(amplifier_saturation_v=1e4), 20.0, 5.0, 0.1), run(shaken(), 20.0, 5.0, 0.1)
    assert np.abs(a["x1"] - b["x1"]).max() < 1e-6 * np.abs(b["x1"]).max()


@pytest.mark.parametrize(
    ("keys", "law"),
    [
        ({"kind": "cubic_spring", "stiffness_n_m3": 3e9}, lambda x, v: 3e9 * x**3),
        ({"kind": "linear_spring", "stiffness_n_m": 5000.0}, lambda x, v: 5000.0 * x),
        ({"kind": "linear_damper", "damping_ns_m": 30.0}, lambda x, v: 30.0 * v),
        ({"kind": "quadratic_drag", "drag_ns2_m2": 60.0}, lambda x, v: 60.0 * v * abs(v)),
    ],
    ids=lambda item: item["kind"] if isinstance(item, dict) else "",
)
@pytest.mark.parametrize("ideal", [True, False], ids=["force", "shaker"])
def test_the_force_of_an_element_behind_the_sensor_is_measured_with_the_exciters(keys, law, ideal):
    """The same motion on either side; measured forces differ by the element's."""
    make = oscillator if ideal else lambda elements: shaken(*elements)
    outer, inner = (make([{"point": 1, "side": side, **keys}]) for side in ("exciter", "structure"))
    a, b = (run(rig, 25.0, 6.0, 0.2) for rig in (outer, inner))
    np.testing.assert_allclose(a["x1"], b["x1"], rtol=0, atol=1e-9 * np.abs(b["x1"]).max())
    v = np.gradient(b["x1"], 1 / RATE)[1:-1]
    g = np.array([law(x, rate) for x, rate in zip(b["x1"][1:-1], v, strict=True)])
    assert np.abs(g).max() > 0.1
    assert np.abs((b["f1"] - a["f1"])[1:-1] - g).max() < 2e-3 * np.abs(g).max()
    if keys["kind"].startswith("linear"):
        s = 2j * np.pi * 25.0
        q, force = build_system(outer).response(2 * np.pi * 25.0)
        expected = (SPRING + s * DAMPER + s * s * MASS) * q[0]
        assert force == pytest.approx(expected, rel=1e-9)


def test_a_suspension_cubic_in_displacement_at_the_same_point_as_a_joint():
    """Elements of one direction on both sides have ports of their own."""
    both = oscillator(
        [
            {"kind": "cubic_spring", "point": 1, "stiffness_n_m3": 1e9},
            {"kind": "cubic_spring", "point": 1, "stiffness_n_m3": 2e9, "side": "exciter"},
        ]
    )
    y = run(both, 25.0, 8.0, 0.2)
    rest = y["f1"] - (MASS * y["a1"] + SPRING * y["x1"] + DAMPER * np.gradient(y["x1"], 1 / RATE) + 1e9 * y["x1"] ** 3)
    assert np.abs(rest[1:-1]).max() < 1e-3 * np.abs(y["f1"]).max()


def test_a_moment_of_the_stinger_is_no_part_of_the_measured_force():
    key = "local_elements=[{kind: linear_spring, point: 2, rotation: true, side: exciter, stiffness_n_m: 80}]"
    rig = beam(key)
    system, plain = build_system(rig), build_system(beam("local_elements=[]"))
    assert np.array_equal(system.force.displacement, plain.force.displacement)
    difference = system.stiffness - plain.stiffness
    index = system.points[2] + 1
    assert difference[index, index] == 80.0
    assert np.count_nonzero(difference) == 1
    # Nor of the structure whose modes are looked for.
    with_spring, without = linear_description(rig), linear_description(beam("local_elements=[]"))
    assert with_spring.frequencies_rad_s == without.frequencies_rad_s
    assert with_spring.plant_frequency_rad_s > without.plant_frequency_rad_s


@pytest.mark.parametrize(
    "override",
    [
        "exciter.amplifier_saturation_v=3.0",
        "exciter.force_factor_linear_per_m=10.0",
        "exciter.force_factor_quadratic_per_m2=100.0",
        "local_elements=[{kind: cubic_spring, point: 2, side: exciter, stiffness_n_m3: 1e9}]",
        "local_elements=[{kind: lugre, point: 2, bristle_stiffness_n_m: 1e4, coulomb_force_n: 1, static_force_n: 1.5, "
        "stribeck_velocity_m_s: 0.01}]",
        "drift.slip_force_per_s=-0.01",
    ],
)
def test_what_harmonic_balance_does_not_cover_is_refused(override):
    with pytest.raises(BenchError, match="harmonic balance does not cover"):
        single_point_reference(beam(override), levels=[0.1])


@pytest.mark.parametrize(
    ("override", "covered"),
    [
        ("exciter.force_factor_linear_per_m=10.0", True),
        ("exciter.amplifier_saturation_v=3.0", True),
        ("sensors.0.delay_s=1e-4", True),
        ("structure.loss_factor=0.01", True),
        ("drift.stiffness_per_s=1e-5", False),
        ("local_elements=[{kind: eddy_brake, point: 2, damping_ns_m: 1, critical_velocity_m_s: 1}]", True),
        ("local_elements=[{kind: backlash_damper, point: 2, stiffness_n_m: 1, damping_ns_m2: 1, gap_m: 1e-4}]", False),
        ("local_elements=[{kind: fractional_damper, point: 2, coefficient_n_sa_m: 1}]", False),
    ],
)
def test_the_backbone_of_the_structure_does_not_mind_its_exciter(override, covered):
    if covered:
        assert compute_reference(beam(override), harmonics=3, points=3).omega_rad_s.size == 3
    else:
        with pytest.raises(BenchError, match="harmonic balance does not cover"):
            compute_reference(beam(override), harmonics=3, points=3)


def test_elements_on_the_side_of_the_exciter_go_with_it(tmp_path):
    text = (
        find_rig("beam")
        .read_text(encoding="utf-8")
        .replace(
            "local_elements:\n",
            "local_elements:\n  - {kind: cubic_spring, point: 2, side: exciter, stiffness_n_m3: 1e9}\n",
        )
    )
    path = tmp_path / "rig.yaml"
    path.write_text(text, encoding="utf-8")
    assert [element.point for element in load_rig(path).local_elements] == [2, 3]
    moved = load_rig(path, ["exciter.point=5"])
    assert [element.point for element in moved.local_elements] == [5, 3]
    assert [element.point for element in with_exciter_at(load_rig(path), 6).local_elements] == [6, 3]
