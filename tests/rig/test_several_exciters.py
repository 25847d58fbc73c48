"""Several exciters: the file, the equations against mechanical impedances, one input after the other, one at a time."""

from __future__ import annotations

import numpy as np
import pytest

from nmt_core.errors import BenchError
from nmt_plant.devices.simulated_rig import SimulatedRig, sensor_row
from nmt_rig.model.assembly import acceleration_output
from nmt_rig.model.time_integration import TimeIntegrator
from nmt_rig.rig import load_rig
from nmt_rig.rig_model import build_system
from nmt_rig.rig_places import find_rig

RATE = 10_000.0
FREE = "local_elements.0.tangential_stiffness_n_m=1e-6"


def shaker_at(exciter, frequency):
    """Force on the structure per volt, and per displacement of its table, from the shaker's own equations."""
    s = 2j * np.pi * frequency
    e = exciter
    joint = e.coil_stiffness_n_m + s * e.coil_damping_ns_m
    circuit = e.resistance_ohm + s * e.inductance_h
    # Coil: (s² m_C + joint + s G²/Z) x_C = joint x + G u / Z.
    coil = s * s * e.coil_mass_kg + joint + s * e.force_factor_n_a**2 / circuit
    per_volt = joint * e.force_factor_n_a / circuit / coil
    table = s * s * e.table_mass_kg + s * e.table_damping_ns_m + e.table_stiffness_n_m
    return per_volt, -(table + joint - joint * joint / coil)


def forces_by_impedance(rig, frequency):
    """(exciters, exciters) N/V of the frame without its joint, by modal receptances and the shakers' impedances."""
    omega = 2 * np.pi * frequency
    shapes = np.array([mode.shape for mode in rig.structure.modes]).T
    poles = np.array(
        [
            (2 * np.pi * mode.frequency_hz) ** 2
            + 2j * mode.damping_ratio * 2 * np.pi * mode.frequency_hz * omega
            - omega**2
            for mode in rig.structure.modes
        ]
    )
    rows = [rig.structure.points.index(point) for point in rig.exciter_points]
    receptance = (shapes[rows] / poles) @ shapes[rows].T
    shakers = [shaker_at(exciter, frequency) for exciter in rig.all_exciters]
    driven, resisting = np.diag([a for a, _ in shakers]), np.diag([z for _, z in shakers])
    return np.linalg.solve(np.eye(len(rows)) - resisting @ receptance, driven)


@pytest.mark.parametrize("frequency", [37.0, 99.6, 101.4, 260.0, 303.0, 900.0])
def test_forces_are_those_of_impedances(frequency):
    rig = load_rig("frame", [FREE])
    _, forces = build_system(rig).responses(2 * np.pi * frequency)
    np.testing.assert_allclose(forces, forces_by_impedance(rig, frequency), rtol=1e-6)


def test_time_integration_meets_the_responses_of_both_inputs():
    rig = load_rig("frame", [FREE])
    system = build_system(rig)
    outputs = [sensor_row(system, rig, row) for row in range(len(rig.sensors))]
    integrator = TimeIntegrator(system, RATE, outputs)
    frequency, volts = 125.0, np.array([0.7, 0.4 * np.exp(1.1j)])
    time = np.arange(120_001) / RATE
    drive = (volts[:, None] * np.exp(2j * np.pi * frequency * time)).real
    measured = np.concatenate([integrator.advance(drive[:, k : k + 401]) for k in range(0, 120_000, 400)], axis=1)
    last = slice(-8000, None)
    found = 2 * measured[:, last] @ np.exp(-2j * np.pi * frequency * time[:-1][last]) / 8000
    unknowns, forces = system.responses(2 * np.pi * frequency)
    np.testing.assert_allclose(found[:2], forces @ volts, rtol=2e-3)
    accelerations = [
        acceleration_output(system, point).acceleration @ unknowns @ volts * -((2 * np.pi * frequency) ** 2)
        for point in rig.structure.points
    ]
    np.testing.assert_allclose(found[2:6], accelerations, rtol=2e-3)
    np.testing.assert_allclose(found[6:], volts, rtol=1e-9)


def test_blocks_of_any_length_give_the_same_bits():
    rig = load_rig("frame", ["local_elements.0.slip_force_n=0.02"])
    generator = np.random.default_rng(3)
    drive = generator.standard_normal((2, 2001))
    results = []
    for length in (2000, 250, 8):
        device = SimulatedRig(rig)
        device.configure()
        integrator = device.integrator
        integrator.reset()
        parts = [integrator.advance(drive[:, k : k + length + 1]) for k in range(0, 2000, length)]
        results.append(np.concatenate(parts, axis=1))
        assert integrator.corners > 10
    assert np.array_equal(results[0], results[1])
    assert np.array_equal(results[0], results[2])


def test_what_both_exciters_do_is_lost_in_structure_joint_and_shakers():
    """Over whole periods of the steady state the forces' work is the joint's loss and the modes' viscous loss."""
    rig = load_rig("frame", ["local_elements.0.slip_force_n=0.05"])
    system = build_system(rig)
    points = [rig.structure.points.index(point) for point in rig.exciter_points]
    outputs = [sensor_row(system, rig, row) for row in (0, 1)]
    integrator = TimeIntegrator(system, RATE, outputs)
    time = np.arange(100_001) / RATE
    drive = np.array([np.cos(2 * np.pi * 100.0 * time), 0.5 * np.sin(2 * np.pi * 100.0 * time)])
    shapes = np.array([mode.shape for mode in rig.structure.modes])
    modes = shapes.shape[0]
    rates = np.array([4 * np.pi * mode.frequency_hz * mode.damping_ratio for mode in rig.structure.modes])
    work = viscous = 0.0
    for k in range(100_000):
        # The state before the step: modal velocities stand behind all displacements.
        velocity = integrator.physical_state[system.mechanical_size :][:modes]
        force = integrator.advance(drive[:, k : k + 2])[:, 0]
        if k >= 98_000:
            work += float(force @ (shapes[:, points].T @ velocity)) / RATE
            viscous += float(rates @ velocity**2) / RATE
        if k == 97_999:
            before = integrator.slider_dissipation.sum()
    friction = integrator.slider_dissipation.sum() - before
    assert friction > 0.1 * work
    assert work == pytest.approx(viscous + friction, rel=2e-3)


def test_one_of_several_is_a_rig_with_one():
    rig = load_rig("frame", ["exciter.point=2"])
    assert rig.exciters is None
    assert rig.drive_point == 2
    assert [rig.sensor_channel(sensor) for sensor in rig.sensors] == ["f2", "a1", "a2", "a3", "a4", "u"]
    assert len(build_system(rig).exciters) == 1


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (["exciter.point=3"], "exciters of frame.yaml are at points 1, 2"),
        (["exciters.1.point=1"], "another exciter is at point 1 already"),
        (["exciters.1.point=3"], "no force is measured at point 3"),
        (["extraction.linear_modes=1"], "linear_modes must be at least the number of exciters"),
        (["sensors.4.quantity=force"], "write point: drive, or one of 1, 2"),
        (["sensors.7.exciter=3"], "the rig has 2"),
        (["sensors.1.exciter=2"], "remove it from a force sensor"),
        (["exciters.1.kind=shaking_table"], "exciters"),
    ],
)
def test_what_does_not_fit_is_refused(changes, words):
    with pytest.raises(BenchError, match=words):
        load_rig("frame", changes)


def test_a_file_with_exciter_and_other_exciters_is_refused(tmp_path):
    text = load_text = tmp_path / "rig.yaml"
    from nmt_rig.rig import find_rig

    load_text.write_text(find_rig("frame").read_text() + "\nexciter: {kind: force, point: 1}\n")
    with pytest.raises(BenchError, match="either exciter or exciters"):
        load_rig(text)


def test_a_kind_of_the_first_of_several_exciters_that_is_not_there_is_named(tmp_path):
    text = find_rig("frame").read_text().replace("kind: electrodynamic_shaker", "kind: electrody", 1)
    (tmp_path / "rig.yaml").write_text(text)
    with pytest.raises(BenchError, match=r"exciter\.kind must be one of .*'electrodynamic_shaker'.*got 'electrody'"):
        load_rig(tmp_path / "rig.yaml")
