"""Shaking table: transmissibility, the equivalent inertial force, absolute motion, energy, and the loop's force."""

from __future__ import annotations

import numpy as np
import pytest
from rig.energies import stored_energy
from scipy.integrate import solve_ivp

from nmt_core.errors import BenchError
from nmt_core.messages.records import DriveCommand
from nmt_core.vocabulary import Waveform
from nmt_plant.devices.simulated_rig import SimulatedRig
from nmt_rig.linear_description import linear_description
from nmt_rig.model.assembly import acceleration_output, assemble, displacement_output, velocity_output
from nmt_rig.model.beam import element_matrices, euler_bernoulli_beam
from nmt_rig.model.chain import lumped_chain
from nmt_rig.model.linear_modes import damped_modes, sticking_modes
from nmt_rig.model.local_elements.springs import CubicSpring
from nmt_rig.model.shaking_table import ShakingTable, effective_mass
from nmt_rig.model.time_integration import TimeIntegrator
from nmt_rig.reference import compute_reference, single_point_reference
from nmt_rig.rig import load_rig
from nmt_rig.rig_model import build_system

MASS, SPRING, DAMPER = 0.5, 2000.0, 1.5
OSCILLATOR = lumped_chain([MASS], [], None, [SPRING], [DAMPER])
FREQUENCIES = (15.0, 63.0, 200.0)


def output(row, system, frequency):
    """Complex output per unit input."""
    q, _ = system.response(frequency)
    s = 1j * frequency
    return row.displacement @ q + s * (row.velocity @ q) + s * s * (row.acceleration @ q) + row.feedthrough


@pytest.mark.parametrize("frequency", FREQUENCIES)
def test_relative_motion_and_transmissibility_in_closed_form(frequency):
    s = 1j * frequency
    impedance = MASS * s * s + DAMPER * s + SPRING
    relative = assemble(OSCILLATOR, [], 1, table=ShakingTable(MASS))
    x = output(displacement_output(relative, 1), relative, frequency)
    assert x == pytest.approx(-MASS / impedance, rel=1e-12)
    _, force = relative.response(frequency)
    assert force == -MASS
    absolute = assemble(OSCILLATOR, [], 1, table=ShakingTable(MASS, absolute=True))
    acceleration = output(acceleration_output(absolute, 1), absolute, frequency)
    assert acceleration == pytest.approx((DAMPER * s + SPRING) / impedance, rel=1e-12)


@pytest.mark.parametrize("frequency", FREQUENCIES)
def test_table_dynamics_in_closed_form(frequency):
    s, corner, suspension, ratio = 1j * frequency, 400.0, 12.0, 0.6
    low_pass = 1.0 / (1.0 + s / corner)
    high_pass = s * s / (s * s + 2.0 * ratio * suspension * s + suspension**2)
    transmissibility = (DAMPER * s + SPRING) / (MASS * s * s + DAMPER * s + SPRING)
    for table, factor in (
        (ShakingTable(MASS, bandwidth=corner, absolute=True), low_pass),
        (ShakingTable(MASS, suspension=suspension, suspension_damping=ratio, absolute=True), high_pass),
        (ShakingTable(MASS, corner, suspension, ratio, True), low_pass * high_pass),
    ):
        system = assemble(OSCILLATOR, [], 1, table=table)
        found = output(acceleration_output(system, 1), system, frequency)
        assert found == pytest.approx(transmissibility * factor, rel=1e-12)
        assert system.response(frequency)[1] == pytest.approx(-MASS * factor, rel=1e-12)
        if table.suspension is not None:
            x, v = displacement_output(system, 1), velocity_output(system, 1)
            assert output(x, system, frequency) == pytest.approx(found / s**2, rel=1e-12)
            assert output(v, system, frequency) == pytest.approx(found / s, rel=1e-12)
    with pytest.raises(ValueError, match="needs the table's position"):
        displacement_output(assemble(OSCILLATOR, [], 1, table=ShakingTable(MASS, absolute=True)), 1)


@pytest.mark.parametrize("boundary", ["clamped-free", "clamped-clamped", "clamped-pinned", "pinned-pinned"])
def test_beams_move_as_with_prescribed_supports(boundary):
    """Absolute motion from the free beam's matrices with the supports' degrees of freedom prescribed."""
    elements, length = 6, 0.5
    beam = euler_bernoulli_beam(length, 0.02, 0.006, 70e9, 2700.0, elements, 1e-5, boundary=boundary)
    own_mass, own_stiffness = element_matrices(length / elements, 70e9 * 0.02 * 0.006**3 / 12.0, 2700.0 * 0.02 * 0.006)
    n = 2 * (elements + 1)
    mass, stiffness = np.zeros((n, n)), np.zeros((n, n))
    for e in range(elements):
        part = slice(2 * e, 2 * e + 4)
        mass[part, part] += own_mass
        stiffness[part, part] += own_stiffness
    held = {"clamped": 2, "pinned": 1, "free": 0}
    left, right = boundary.split("-")
    fixed = [0, 1][: held[left]] + [n - 2, n - 1][: held[right]]
    free = [i for i in range(n) if i not in fixed]
    frequency = 700.0
    s = 1j * frequency
    impedance = stiffness * (1.0 + 1e-5 * s) + mass * s * s
    base = np.array([1.0 if i % 2 == 0 else 0.0 for i in fixed]) / s**2  # unit acceleration of the supports
    motion = np.linalg.solve(impedance[np.ix_(free, free)], -impedance[np.ix_(free, fixed)] @ base)
    system = assemble(beam, [], 2, table=ShakingTable(1.0, absolute=True))
    for point in beam.points:
        found = output(acceleration_output(system, point), system, frequency)
        assert found == pytest.approx(s * s * motion[free.index(2 * point)], rel=1e-9)


def test_time_integration_follows_the_equivalent_inertial_force():
    """A chain with a cubic spring on a table of limited bandwidth, against an ordinary solver on its equations."""
    chain = lumped_chain([1.0, 0.5], [3000.0], [1.0], [4000.0, 0.0], [0.5, 0.0])
    cubic, corner = 4e7, 500.0
    table = ShakingTable(1.5, bandwidth=corner)
    rate, omega = 4000.0, 45.0
    system = assemble(chain, [CubicSpring(chain.direction(2, 1), cubic)], 2, table=table)
    rows = [displacement_output(system, 1), displacement_output(system, 2), system.force]
    times = np.arange(4001) / rate
    asked = 8.0 * np.sin(omega * times)
    found = TimeIntegrator(system, rate, rows, 4).advance(asked)

    def slope(t, state):
        x, v, y = state[:2], state[2:4], state[4]
        spring = 3000.0 * (x[1] - x[0]) + 1.0 * (v[1] - v[0]) + cubic * (x[1] - x[0]) ** 3
        force = np.array([spring - 4000.0 * x[0] - 0.5 * v[0], -spring])
        masses = np.array([1.0, 0.5])
        return [*v, *((force - masses * y) / masses), corner * (8.0 * np.sin(omega * t) - y)]

    exact = solve_ivp(slope, (0.0, times[-1]), np.zeros(5), "DOP853", times[:-1], rtol=1e-10, atol=1e-14).y
    largest = np.abs(exact[:2]).max()
    np.testing.assert_allclose(found[:2], exact[:2], atol=2e-4 * largest, rtol=0.0)
    np.testing.assert_allclose(found[2], -1.5 * exact[4], atol=1e-3, rtol=0.0)
    assert cubic * np.abs(exact[1] - exact[0]).max() ** 2 > 0.05 * 3000.0


def test_the_table_does_as_much_work_as_the_structure_takes_up():
    chain = lumped_chain([1.0, 0.5], [3000.0], None, [4000.0, 0.0])
    system = assemble(chain, [CubicSpring(chain.selector(2), 1e7)], 1, table=ShakingTable(1.0))
    rate = 20000.0
    integrator = TimeIntegrator(system, rate, [velocity_output(system, 1), velocity_output(system, 2)])
    acceleration = 5.0 * np.sin(50.0 * np.arange(10001) / rate)
    velocity = integrator.advance(acceleration)
    power = -(np.array([1.0, 0.5]) @ velocity) * acceleration[:-1]
    work = np.trapezoid(power, dx=1.0 / rate)
    # The last sample's state is one step beyond the last velocity.
    assert stored_energy(integrator) == pytest.approx(work + power[-1] / rate, rel=2e-4)
    assert work > 0.01


def test_effective_mass_is_the_force_of_the_same_power():
    beam = euler_bernoulli_beam(0.5, 0.02, 0.006, 70e9, 2700.0, 6)
    mode = sticking_modes(beam, [], 2).full_shapes
    total = 2700.0 * 0.5 * 0.02 * 0.006
    # Effective modal masses of the cantilever's first modes: 61.31 and 18.83 % of the whole.
    for k, share in ((0, 0.6131), (1, 0.1883)):
        participation = beam.base_load @ mode[:, k]
        assert participation**2 / total == pytest.approx(share, abs=5e-4)
        at_drive = beam.selector(6) @ mode[:, k]
        assert effective_mass(beam, mode[:, k], 6) == pytest.approx(participation / at_drive, rel=1e-12)
    symmetric = euler_bernoulli_beam(0.5, 0.02, 0.006, 70e9, 2700.0, 6, boundary="clamped-clamped")
    second = sticking_modes(symmetric, [], 2).full_shapes[:, 1]
    with pytest.raises(ValueError, match="does not excite the mode"):
        effective_mass(symmetric, second, 2)
    with pytest.raises(ValueError, match="is a node"):
        effective_mass(symmetric, second, 3)


ON_TABLE = """name: on_table
structure: {kind: modal, modes: [{frequency_hz: 31.4, damping_ratio: 0.004, participation: 1.57, modal_mass_kg: 0.8}]}
exciter: {kind: shaking_table, point: 1, acceleration_per_volt_m_s2: 2.5}
local_elements: [{kind: cubic_spring, point: 1, stiffness_n_m3: 3.0e+8}]
"""


def load(tmp_path, text, overrides=()):
    file = tmp_path / "rig.yaml"
    file.write_text(text)
    return load_rig(file, overrides)


def test_phase_resonance_on_a_table_is_that_of_the_equivalent_force(tmp_path):
    table = load(tmp_path, ON_TABLE)
    # F = Γ m a per volt at the drive point of one mode.
    force = load(tmp_path, ON_TABLE, [f"exciter={{kind: force, point: 1, newton_per_volt: {1.57 * 0.8 * 2.5}}}"])
    levels = [0.001, 0.01, 0.05]
    one, other = (single_point_reference(rig, None, levels).mode for rig in (table, force))
    for name in ("omega_rad_s", "damping_ratio", "force_n", "modal_amplitude", "pbmif"):
        np.testing.assert_allclose(getattr(one, name), getattr(other, name), rtol=1e-9)
    assert one.omega_rad_s[-1] > 1.001 * one.omega_rad_s[0]
    ours, theirs = (compute_reference(rig, points=5) for rig in (table, force))
    np.testing.assert_allclose(ours.omega_rad_s, theirs.omega_rad_s, rtol=1e-9)
    a, b = linear_description(table), linear_description(force)
    assert a.force_per_volt == pytest.approx(b.force_per_volt, rel=1e-12)
    assert a.displacement_per_volt == pytest.approx(b.displacement_per_volt, rel=1e-9)
    assert a.moving_mass_kg == 0.0


def test_the_mode_of_the_table_is_not_taken_for_the_structures(tmp_path):
    rig = load(tmp_path, ON_TABLE, ["exciter.suspension_hz=3", "exciter.bandwidth_hz=500"])
    linear = linear_description(rig)
    assert linear.plant_frequency_rad_s == pytest.approx(2.0 * np.pi * 31.4, rel=1e-9)
    assert linear.plant_damping_ratio == pytest.approx(0.004, rel=1e-6)


def test_a_simulated_table_measures_force_and_motion(tmp_path):
    rig = load(tmp_path, ON_TABLE, ["sample_rate_hz=2000", "local_elements=[]"])
    device = SimulatedRig(rig)
    device.configure()
    device.start()
    device.read()
    blocks = {}
    for _ in range(400):
        device.write(DriveCommand(Waveform.SINE, 20.0, 0.1, 0.1))
        blocks = {block.quantity.name: block.data[0] for block in device.read()}
    device.close()
    # Below resonance the steady state follows the force: x = F / (m (ω₀² - ω²)).
    stiffness = 0.8 * (2.0 * np.pi) ** 2 * (31.4**2 - 20.0**2)
    assert np.abs(blocks["FORCE"]).max() == pytest.approx(1.57 * 0.8 * 2.5 * 0.1, rel=1e-2)
    assert np.abs(blocks["DISPLACEMENT"]).max() == pytest.approx(np.abs(blocks["FORCE"]).max() / stiffness, rel=2e-2)


def test_added_masses_are_moved_by_the_base(tmp_path):
    chain = lumped_chain([1.0, 0.5], [3000.0], None, [4000.0, 0.0])
    heavier = chain.with_masses([(2, 0.25)])
    np.testing.assert_allclose(heavier.base_load, [1.0, 0.75])
    system = assemble(heavier, [], 1, table=ShakingTable(1.0))
    plain = assemble(lumped_chain([1.0, 0.75], [3000.0], None, [4000.0, 0.0]), [], 1, table=ShakingTable(1.0))
    np.testing.assert_allclose(system.response(40.0)[0], plain.response(40.0)[0], rtol=1e-12)
    np.testing.assert_allclose(
        np.sort(damped_modes(system).frequencies), sticking_modes(heavier).frequencies, rtol=1e-6
    )


@pytest.mark.parametrize(
    ("overrides", "says"),
    [
        (["structure.modes.0.participation=null"], "structure.modes.0 lacks participation"),
        (["structure.modes.0.participation=0.0"], "no effective mass on mode 1: a motion of the base does not excite"),
        (["exciter.effective_mass_kg=0.0"], "effective_mass_kg must not be zero"),
        (["exciter.bandwidth_hz=-5"], "bandwidth_hz must be positive"),
        (["local_elements.0.side=exciter"], "does not go with a shaking_table"),
        (
            ["local_elements=[{kind: rattling_mass, point: 1, mass_kg: 1, gap_m: 1, contact_stiffness_n_m: 1}]"],
            "none with a mass of its own",
        ),
    ],
)
def test_tables_that_do_not_fit_are_refused(tmp_path, overrides, says):
    with pytest.raises(BenchError, match=says.replace(".", r"\.")):
        linear_description(load(tmp_path, ON_TABLE, overrides))


def test_absolute_displacements_need_no_stated_suspension(tmp_path):
    """They are the accelerations over s², on a suspension far below the test."""
    rig = load(tmp_path, ON_TABLE, ["exciter.responses=absolute"])
    system = build_system(rig)
    for omega in (100.0, 300.0):
        found = output(displacement_output(system, 1), system, omega)
        assert found == pytest.approx(-output(acceleration_output(system, 1), system, omega) / omega**2, rel=1e-9)
