"""Forced responses against linear transfer functions, closed forms and the time-domain plant."""

from __future__ import annotations

import numpy as np
import pytest

from nmt_core.errors import BenchError
from nmt_rig.model.assembly import assemble
from nmt_rig.model.chain import lumped_chain
from nmt_rig.model.exciter import OutputRow
from nmt_rig.model.forced_response import ForcedProblem, _DriveHeld, _ForceHeld, frequency_response
from nmt_rig.model.fourier_basis import FourierBasis
from nmt_rig.model.local_elements.attachments import BoucWen, FractionalDamper, TunedMassQuadratic
from nmt_rig.model.local_elements.contacts import UnilateralStop
from nmt_rig.model.local_elements.dampers import QuadraticDrag
from nmt_rig.model.local_elements.friction import Jenkins
from nmt_rig.model.local_elements.springs import CubicSpring
from nmt_rig.model.phase_resonance import _Quadrature
from nmt_rig.model.time_integration import TimeIntegrator

ONE = np.array([1.0])
BASIS = FourierBasis.up_to(7)


def duffing(k3: float = 1.0, damping: float = 0.04):
    structure = lumped_chain([1.0], [], None, [1.0], [damping])
    return assemble(structure, [CubicSpring(ONE, k3)], 1)


@pytest.mark.parametrize("with_shaker", [True, False])
def test_sticking_beam_responds_like_the_linear_system(beam, joint, shaker, with_shaker: bool) -> None:
    system = assemble(beam, joint, 4, shaker if with_shaker else None)
    problem = ForcedProblem(system, BASIS, 139.4)
    assert problem.impedance.diagonal != with_shaker
    response = frequency_response(problem, 1e-4, 130.0, 150.0, points=40)
    for item in response.responses:
        q, force = system.response(item.angular_frequency)
        np.testing.assert_allclose(item.unknowns[1], 1e-4 * q, rtol=1e-8, atol=1e-12 * np.abs(q).max() * 1e-4)
        assert item.force[1] == pytest.approx(1e-4 * force, rel=1e-6)
        np.testing.assert_allclose(item.unknowns[[0, 2, 3, 7]], 0.0, atol=1e-14)


def test_linear_rig_without_local_elements(beam, shaker) -> None:
    system = assemble(beam, [], 4, shaker)
    response = frequency_response(ForcedProblem(system, BASIS, 116.5), 1.0, 100.0, 130.0, points=20)
    for item in response.responses:
        np.testing.assert_allclose(item.unknowns[1, :14], system.response(item.angular_frequency)[0][:14], rtol=1e-9)


def test_duffing_one_harmonic_closed_form() -> None:
    problem = ForcedProblem(duffing(), FourierBasis.up_to(1), 1.0)
    force = 0.05
    for item in frequency_response(problem, force, 0.7, 1.6).responses:
        omega, a = item.angular_frequency, abs(item.unknowns[1, 0])
        balance = ((1.0 - omega**2 + 0.75 * a**2) ** 2 + (0.04 * omega) ** 2) * a**2
        assert balance == pytest.approx(force**2, rel=1e-8)


def test_duffing_folds_and_all_three_responses_are_found() -> None:
    response = frequency_response(ForcedProblem(duffing(), FourierBasis.up_to(1), 1.0), 0.05, 0.7, 1.6)
    assert response.branch.folds == 2
    found = response.at(1.25)
    roots = np.roots([0.5625, 1.5 * (1 - 1.25**2), (1 - 1.25**2) ** 2 + (0.04 * 1.25) ** 2, -(0.05**2)])
    expected = np.sort(np.sqrt(roots.real[np.abs(roots.imag) < 1e-12]))
    np.testing.assert_allclose(sorted(abs(item.unknowns[1, 0]) for item in found), expected, rtol=1e-8)


def test_force_held_response_keeps_the_force(beam, joint, shaker) -> None:
    problem = ForcedProblem(assemble(beam, joint, 4, shaker), BASIS, 139.4)
    response = frequency_response(problem, 0.3, 115.0, 150.0, held="force", points=60)
    np.testing.assert_allclose(np.abs(response.force_amplitudes()), 0.3, rtol=1e-9)


def test_force_held_response_of_a_linear_rig_is_its_receptance(beam, shaker) -> None:
    problem = ForcedProblem(assemble(beam, [], 4, shaker), BASIS, 116.5)
    bare = assemble(beam, [], 4)
    index = beam.points[4]
    for item in frequency_response(problem, 2.0, 110.0, 122.0, held="force", points=20).responses:
        receptance = bare.response(item.angular_frequency)[0][index]
        assert item.unknowns[1, index] / item.force[1] == pytest.approx(receptance, rel=1e-7)


def test_jacobians(beam, joint, shaker, finite_differences) -> None:
    elements = [*joint, CubicSpring(beam.direction(5), 1e7), QuadraticDrag(beam.direction(7), 5.0)]
    problem = ForcedProblem(assemble(beam, elements, 4, shaker), FourierBasis.up_to(5), 139.4)
    rng = np.random.default_rng(1)
    linear = problem.linear_start(139.4)
    local = linear + 0.05 * rng.normal(size=linear.size)
    quadrature, drive, force = (_Quadrature(problem), _DriveHeld(problem, 0.0, 30.0), _ForceHeld(problem, 1.0, 30.0))
    assert finite_differences(quadrature, np.concatenate((local, [1.01, 0.0]))) < 1e-7
    assert finite_differences(drive, np.append(local, 139.0 / 30.0)) < 1e-7
    assert finite_differences(force, np.concatenate((local, [0.3, 139.0 / 30.0]))) < 1e-7


def steady_state(system, rows, drive, omega, periods, per_period):
    """Fourier amplitudes of the time-domain plant's outputs after many periods: (outputs, 8)."""
    rate = per_period * omega / (2.0 * np.pi)
    # The input is straight between samples: its fundamental is smaller by sinc².
    half_step = np.pi / per_period
    hold = (np.sin(half_step) / half_step) ** 2
    plant = TimeIntegrator(system, rate, rows)
    phase = 2.0 * np.pi * np.arange(per_period + 1) / per_period
    for _ in range(periods):
        signals = plant.advance(drive / hold * np.cos(phase))
    spectrum = np.fft.fft(signals, axis=1)[:, :8] * 2.0 / per_period
    spectrum[:, 0] *= 0.5
    return spectrum


def displacement_row(system, index):
    zero = np.zeros(system.size)
    row = zero.copy()
    row[index] = 1.0
    return OutputRow(zero, zero, row, 0.0)


@pytest.mark.parametrize(("omega", "drive"), [(132.0, 1.5), (120.0, 4.0)])
def test_agreement_with_the_time_domain_plant(beam, joint, shaker, omega: float, drive: float) -> None:
    system = assemble(beam, joint, 4, shaker)
    sensors = [system.points[point] for point in (2, 4, 6)]
    rows = [*(displacement_row(system, index) for index in sensors), system.force]
    measured = steady_state(system, rows, drive, omega, 250, 2048)
    problem = ForcedProblem(system, FourierBasis.up_to(31, odd_only=True), 139.4)
    item = frequency_response(problem, drive, 150.0, omega - 1.0, points=60).at(omega)[0]
    computed = np.vstack((item.unknowns[:, sensors].T, item.force))
    odd = list(item.orders[:4])
    scale = np.abs(computed[:, :1])
    np.testing.assert_allclose((measured[:, odd] - computed[:, :4]) / scale, 0.0, atol=1e-5)


def test_agreement_of_stop_and_mean_value_with_the_time_domain_plant() -> None:
    structure = lumped_chain([1.0], [], None, [400.0], [2.0])
    system = assemble(structure, [UnilateralStop(ONE, 300.0, 0.01)], 1)
    omega = 22.0
    measured = steady_state(system, [displacement_row(system, 0)], 1.0, omega, 80, 4096)[0]
    problem = ForcedProblem(system, FourierBasis.up_to(30), 20.0)
    item = frequency_response(problem, 1.0, 10.0, 23.0, points=60).at(omega)[0]
    np.testing.assert_allclose((measured[:6] - item.unknowns[:6, 0]) / abs(item.unknowns[1, 0]), 0.0, atol=1e-5)


def test_agreement_of_attachments_with_the_time_domain_plant() -> None:
    """A fractional damper and an oscillator at twice the frequency, quadratically coupled: harmonics 0 to 5."""
    structure = lumped_chain([1.0], [], None, [400.0], [0.5])
    attachments = [FractionalDamper(ONE, 2.0, 0.5, 5.0, 500.0), TunedMassQuadratic(ONE, 0.1, 43.0, 0.02, 600.0)]
    system = assemble(structure, [], 1, None, attachments)
    omega = 20.8
    measured = steady_state(system, [displacement_row(system, 0)], 2.0, omega, 120, 2048)[0]
    problem = ForcedProblem(system, FourierBasis.up_to(12), 20.0)
    found = frequency_response(problem, 2.0, 10.0, 24.0, points=80).at(omega)
    nearest = min(np.abs(measured[:6] - item.unknowns[:6, 0]).max() for item in found)
    assert nearest < 1e-5 * abs(measured[1])
    assert abs(measured[3]) > 1e-3 * abs(measured[1])


def test_what_harmonic_balance_does_not_cover_is_refused() -> None:
    structure = lumped_chain([1.0], [], None, [400.0], [0.5])
    with pytest.raises(BenchError, match="forces of two arguments"):
        ForcedProblem(assemble(structure, [], 1, None, [BoucWen(ONE, 10.0, 1e-3)]), BASIS, 20.0)
    behind = assemble(structure, [], 1, None, [], [CubicSpring(ONE, 1e3)])
    with pytest.raises(BenchError, match="side of the exciter"):
        ForcedProblem(behind, BASIS, 20.0)


def test_dissipated_power_equals_the_drive_power(beam, joint) -> None:
    system = assemble(beam, joint, 4)
    problem = ForcedProblem(system, BASIS, 139.4)
    item = frequency_response(problem, 0.5, 150.0, 125.0, points=40).at(130.0)[0]
    omega = item.angular_frequency
    speed = 1j * item.orders[:, None] * omega * item.unknowns
    power_in = 0.5 * np.sum(speed[:, system.points[4]] * item.force.conj()).real
    viscous = 0.5 * np.einsum("ni,ij,nj->", speed.conj(), system.damping, speed).real
    force = BASIS.to_complex(problem.local.forces(item.local_displacement, omega)[0])[0]
    friction = 0.5 * np.sum(speed @ joint[0].direction * force.conj()).real
    assert friction > 0.3 * power_in
    assert viscous + friction == pytest.approx(power_in, rel=1e-9)


def test_refusals(beam, joint) -> None:
    problem = ForcedProblem(assemble(beam, joint, 4), BASIS, 139.4)
    with pytest.raises(BenchError, match="amplitude"):
        frequency_response(problem, 0.0, 100.0, 110.0)
    with pytest.raises(BenchError, match="two different"):
        frequency_response(problem, 1.0, 100.0, 100.0)
    with pytest.raises(BenchError, match="reference frequency"):
        ForcedProblem(assemble(beam, [Jenkins(beam.direction(3), 1.0, 1.0)], 4), BASIS, 0.0)
