"""Time integration against scipy, closed forms, convergence and the balance of energy."""

from __future__ import annotations

import contextlib

import numpy as np
import pytest
from rig.energies import stored_energy
from scipy.integrate import simpson, solve_ivp
from tiers import with_quick

from nmt_benchmark.plant_speed import solve_ivp_peer
from nmt_rig.model.assembly import (
    OutputRow,
    acceleration_output,
    assemble,
    current_output,
    displacement_output,
    input_output,
)
from nmt_rig.model.chain import lumped_chain
from nmt_rig.model.integration_kernel import move_pairs
from nmt_rig.model.local_elements import ELEMENTS
from nmt_rig.model.local_elements.attachments import BoucWen
from nmt_rig.model.local_elements.contacts import BacklashDamper, TwoSidedGap, UnilateralStop
from nmt_rig.model.local_elements.dampers import (
    AmplitudeDamper,
    EddyBrake,
    LinearDamper,
    PolynomialDamper,
    PowerLawDamper,
    QuadraticDrag,
)
from nmt_rig.model.local_elements.friction import Jenkins, StribeckBelt, TanhFriction, WeakeningFriction
from nmt_rig.model.local_elements.springs import Cogging, CubicSpring, LinearSpring, QuadraticSpring, QuinticSpring
from nmt_rig.model.propagator import state_space
from nmt_rig.model.time_integration import IntegrationError, TimeIntegrator

RATE = 10_000.0


def sine(frequency: float, seconds: float, amplitude: float = 1.0, rate: float = RATE):
    return amplitude * np.sin(frequency * np.arange(round(seconds * rate) + 1) / rate)


def single_mass(*elements, damper=0.5):
    return assemble(lumped_chain([0.5], [], None, [20_000.0], [damper]), elements, 1)


def one(kind, *parameters):
    return kind(np.array([1.0]), *parameters)


def test_linear_steady_state_is_the_frequency_response(linear_system):
    frequency = 2 * np.pi * 25.0
    outputs = [displacement_output(linear_system, 2), linear_system.force, acceleration_output(linear_system, 6)]
    integrator = TimeIntegrator(linear_system, RATE, outputs)
    y = integrator.advance(np.cos(frequency * np.arange(40_001) / RATE))[:, -4000:]
    kernel = 2 / 4000 * np.exp(-1j * frequency * np.arange(36_000, 40_000) / RATE)
    q, force = linear_system.response(frequency)
    expected = [q[linear_system.points[2]], force, -(frequency**2) * q[linear_system.points[6]]]
    # The straight line between samples lowers the fundamental by (ωh)²/12.
    np.testing.assert_allclose(y @ kernel, expected, rtol=2.5e-5)


def test_linear_motion_is_exact_for_a_straight_input(linear_system):
    """A ramp of voltage from rest: the exact solution by Radau at tight tolerance."""
    space = state_space(linear_system)
    integrator = TimeIntegrator(linear_system, RATE, [displacement_output(linear_system, 2)])
    integrator.advance(np.linspace(0.0, 1.0, 201))
    solution = solve_ivp(
        lambda t, s: space.a @ s + space.b_inputs[:, 0] * (t / 0.02), (0, 0.02), np.zeros(space.size), "Radau",
        jac=space.a, rtol=1e-10, atol=1e-14,
    )  # fmt: skip
    scale = np.abs(solution.y).max(axis=1) + 1e-12
    np.testing.assert_allclose(integrator.physical_state / scale, solution.y[:, -1] / scale, atol=1e-6)


def test_beam_with_joint_against_solve_ivp(beam_system):
    frequency, seconds = 2 * np.pi * 21.0, 0.1
    _, states = solve_ivp_peer(beam_system, frequency, 2.0, seconds, rtol=1e-8, atol=1e-11)
    integrator = TimeIntegrator(beam_system, RATE, [], substeps=8)
    integrator.advance(2.0 * np.cos(frequency * np.arange(1001) / RATE))
    assert integrator.corners > 4
    m = beam_system.mechanical_size
    largest = np.abs(states[:m]).max(axis=1)
    difference = np.abs(integrator.physical_state[:m] - states[:m, -1]) / largest
    assert difference.max() < 1e-4


AGAINST_SOLVE_IVP = [
    one(CubicSpring, 4e10),
    one(QuinticSpring, 1e16),
    one(QuadraticSpring, 8e5),
    one(Cogging, 2.0, 3e-4, 0.7),
    one(QuadraticDrag, 40.0),
    one(AmplitudeDamper, 4e7),
    one(PowerLawDamper, 40.0, 1.5),
    one(PolynomialDamper, -3.0, 4e7, 1e13),
    one(StribeckBelt, 1.0, 3.0, 0.3, 0.2),
    one(TanhFriction, 0.5, 0.05),
    one(WeakeningFriction, 0.5, 0.05, 0.1),
    one(UnilateralStop, 50_000.0, 2e-4),
    one(TwoSidedGap, 50_000.0, 2e-4),
    one(LinearSpring, 9000.0),
    one(LinearDamper, 6.0),
]
# Jenkins elements have a closed form below, the others tests in test_effect_elements.py.
ELSEWHERE = {Jenkins, EddyBrake, BacklashDamper}


def test_every_local_element_is_integrated_in_a_test():
    assert {type(element) for element in AGAINST_SOLVE_IVP} | ELSEWHERE == set(ELEMENTS)


@pytest.mark.parametrize("element", AGAINST_SOLVE_IVP, ids=lambda e: type(e).__name__)
def test_local_elements_against_solve_ivp(element):
    seconds, frequency, force = 0.2, 180.0, 8.0
    system = single_mass(element)
    integrator = TimeIntegrator(system, RATE, [displacement_output(system, 1)], substeps=4)
    y = integrator.advance(sine(frequency, seconds, force))[0]

    def rate(t, s):
        if hasattr(element, "response"):
            g = element.response(*element.values, s[0], s[1])[0]
        else:
            side = element.next_branch(*element.values, 0, s[0], s[1], 0.0)
            g = element.frozen(*element.values, side, s[0], s[1], 0.0)[0]
        return [s[1], (force * np.sin(frequency * t) - 20_000.0 * s[0] - 0.5 * s[1] - g) / 0.5]

    times = np.arange(y.size) / RATE
    solution = solve_ivp(rate, (0, seconds), [0.0, 0.0], "DOP853", times, rtol=1e-10, atol=1e-13, max_step=1e-4)
    assert np.abs(solution.y[0]).max() > 3e-4, "the element must be at work"
    assert np.abs(y - solution.y[0]).max() < 2e-4 * np.abs(solution.y[0]).max()


def _end(system, substeps, rate=2000.0, corner_levels=8):
    integrator = TimeIntegrator(system, rate, [], substeps=substeps, corner_levels=corner_levels)
    integrator.advance(sine(180.0, 0.1, 8.0, rate))
    return integrator.physical_state


@pytest.mark.parametrize(
    ("element", "order"),
    [(one(CubicSpring, 4e10), 4), (one(QuadraticDrag, 40.0), 2), (one(Jenkins, 10_000.0, 3.0), 2)],
    ids=["cubic", "drag", "jenkins"],
)
def test_order_of_convergence(element, order):
    system = single_mass(element)
    reference = _end(system, 128)
    errors = [np.abs((_end(system, n) - reference) / reference).max() for n in (1, 2, 4, 8)]
    observed = np.polyfit(np.log([1, 2, 4, 8]), np.log(errors), 1)[0]
    assert -observed > order - 0.3, errors


def test_jenkins_closed_form_of_dissipation():
    """Dissipated energy per cycle 4 μN (X - μN / k_t) at the motion's own amplitude X."""
    element = one(Jenkins, 10_000.0, 3.0)
    system = single_mass(element, damper=2.0)
    integrator = TimeIntegrator(system, RATE, [displacement_output(system, 1)])
    period = 2 * np.pi / 180.0
    drive = sine(180.0, 60 * period, 8.0)
    integrator.advance(drive)
    before = integrator.slider_dissipation[0]
    fine = integrator
    phase = 180.0 * (drive.size - 1) / RATE
    more = 8.0 * np.sin(phase + 180.0 * np.arange(round(20 * period * RATE) + 1) / RATE)
    y = fine.advance(more)[0]
    amplitude = 0.5 * (y.max() - y.min())
    lost = (fine.slider_dissipation[0] - before) / ((more.size - 1) / RATE / period)
    assert lost == pytest.approx(4 * 3.0 * (amplitude - 3.0 / 10_000.0), rel=2e-3)


def test_slow_jenkins_loop_has_its_corners_exactly():
    """Quasi-static cycling between ±X: yield at μN, reversal stiffness k_t, area in closed form."""
    element = one(Jenkins, 8000.0, 1.0)
    heavy = assemble(lumped_chain([0.01], [], None, [1e5], [30.0]), [element], 1)
    amplitude = 100.0
    integrator = TimeIntegrator(heavy, RATE, [displacement_output(heavy, 1)])
    drive = amplitude * np.sin(2 * np.pi * np.arange(20_001) / RATE)
    y = integrator.advance(drive[:10_001])[0]
    start = integrator.slider_dissipation[0]
    y = integrator.advance(drive[10_000:])[0]
    swing = 0.5 * (y.max() - y.min())
    expected = 4 * 1.0 * (swing - 1.0 / 8000.0)
    assert integrator.slider_dissipation[0] - start == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("attachments", [(), (BoucWen(np.array([1.0]), 1e-6, 1.0),)], ids=["elements", "with coupling"])
@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_a_slider_pulled_one_way_loses_slip_force_times_way(attachments, sense):
    """μN (X - μN / k_t) from the first step on: the part of a step that lies behind the onset of slip is loss too."""
    stiffness, limit = 8000.0, 1.0
    heavy = assemble(
        lumped_chain([0.01], [], None, [1e5], [30.0]), [one(Jenkins, stiffness, limit)], 1, None, attachments
    )
    # Steps as wide as they come: the slider yields in the middle of one.
    integrator = TimeIntegrator(heavy, 50.0, [displacement_output(heavy, 1)], corner_levels=0)
    y = integrator.advance(sense * 40.0 * np.arange(12))[0]
    assert np.all(np.diff(sense * y) > 0.0)
    onset = int(np.argmax(sense * y > limit / stiffness))
    assert sense * y[onset] - limit / stiffness > 0.1 * limit / stiffness
    # The state is a step ahead of the last output.
    way = sense * integrator.physical_state[0] - limit / stiffness
    assert integrator.slider_dissipation[0] == pytest.approx(limit * way, rel=1e-9)


@pytest.mark.parametrize("amplitude", [0.05, 1.5])
def test_energy_balance_of_the_beam(beam_system, amplitude):
    """Electrical work in = heat in the coil + viscous losses + friction + stored, to 1e-6 of the work."""
    m = beam_system.mechanical_size
    zero = np.zeros(beam_system.size)
    rows = [OutputRow(zero, np.eye(beam_system.size)[i], zero, 0.0) for i in range(m)]
    rows += [current_output(beam_system), input_output(beam_system)]
    rate = 80_000.0
    integrator = TimeIntegrator(beam_system, rate, rows)
    times = np.arange(round(0.4 * rate) + 2) / rate
    drive = amplitude * np.sin(2 * np.pi * 21.0 * times) * np.clip(times / 0.05, 0, 1) ** 2
    last = integrator.advance(drive[:-1])
    stored = stored_energy(integrator)
    friction = integrator.slider_dissipation.sum()
    y = np.hstack([last, integrator.advance(drive[-2:])])
    velocity, current, voltage = y[:m], y[m], y[m + 1]
    work = simpson(voltage * current, dx=1 / rate)
    heat = simpson(3.0 * current**2, dx=1 / rate)
    viscous = simpson(np.einsum("ik,ij,jk->k", velocity, beam_system.damping[:m, :m], velocity), dx=1 / rate)
    assert (friction > 0) == (amplitude > 1)
    assert heat + viscous + friction + stored == pytest.approx(work, rel=1e-6)


def test_blocks_of_any_length_give_the_same_bits(beam_system):
    outputs = [displacement_output(beam_system, 2), beam_system.force, acceleration_output(beam_system, 2)]
    drive = sine(133.0, 0.5, 2.0)
    whole = TimeIntegrator(beam_system, RATE, outputs).advance(drive)
    for lengths in ([1] * 50 + [7] * 10, [200] * 25, [333, 4]):
        integrator = TimeIntegrator(beam_system, RATE, outputs)
        parts, k = [], 0
        for n in lengths:
            parts.append(integrator.advance(drive[k : k + n + 1]))
            k += n
        assert np.array_equal(np.hstack(parts), whole[:, :k])


@pytest.mark.parametrize("samples", [1, 200, 1024, 2048])
def test_rows_of_the_history_do_not_share_a_place_of_the_cache(linear_system, samples):
    """An odd number of cache lines of 64 bytes apart; blocks of 2^n samples took 1.3 to 2.2 times as long."""
    integrator = TimeIntegrator(linear_system, RATE, [])
    integrator.advance(np.zeros(samples + 1))
    apart, rest = divmod(integrator._history.strides[0], 64)
    assert rest == 0
    assert apart % 2 == 1


def test_modal_and_dense_state_agree(beam_system):
    outputs = [displacement_output(beam_system, 6), beam_system.force]
    drive = sine(133.0, 0.3, 2.0)
    modal = TimeIntegrator(beam_system, RATE, outputs).advance(drive)
    dense = TimeIntegrator(beam_system, RATE, outputs, dense=True).advance(drive)
    np.testing.assert_allclose(modal, dense, atol=1e-6 * np.abs(modal).max(axis=1, keepdims=True).max())


def test_a_free_body_falls_back_to_dense():
    """Two rigid-body eigenvalues with one eigenvector: no modal form exists."""
    system = assemble(lumped_chain([2.0], []), [], 1)
    integrator = TimeIntegrator(system, 100.0, [displacement_output(system, 1)])
    assert not integrator.modal
    y = integrator.advance(np.ones(101))[0]
    np.testing.assert_allclose(y, 0.5 * 0.5 * (np.arange(100) / 100.0) ** 2, atol=1e-12)


def test_parallel_jenkins_elements_share_a_port_and_equal_one():
    single = single_mass(one(Jenkins, 10_000.0, 3.0))
    halves = single_mass(one(Jenkins, 5000.0, 1.5), one(Jenkins, 5000.0, 1.5))
    drive = sine(180.0, 0.2, 8.0)
    results = [TimeIntegrator(s, RATE, [displacement_output(s, 1)]).advance(drive) for s in (single, halves)]
    np.testing.assert_allclose(results[0], results[1], atol=1e-9 * np.abs(results[0]).max())


def test_two_ports_agree_with_one_when_uncoupled():
    """Elements on two directions are solved together; masses that do not touch must not notice."""
    pair = lumped_chain([0.5, 0.5], [0.0], None, [20_000.0, 20_000.0], [0.5, 0.5])
    first, second = (Jenkins(pair.selector(p), 10_000.0, 3.0) for p in (1, 2))
    drive = sine(180.0, 0.2, 8.0)
    system = assemble(pair, [first, second], 1)
    both = TimeIntegrator(system, RATE, [displacement_output(system, p) for p in (1, 2)]).advance(drive)
    alone = single_mass(one(Jenkins, 10_000.0, 3.0))
    expected = TimeIntegrator(alone, RATE, [displacement_output(alone, 1)]).advance(drive)[0]
    np.testing.assert_allclose(both[0], expected, atol=1e-9 * np.abs(expected).max())
    assert np.all(both[1] == 0.0)


def test_sampling_error_at_10_khz(beam_system):
    """Phase and amplitude of force and drive-point displacement against a 16 times finer step.

    Steady state near phase resonance in the strongly slipping range. ω̃ follows from the phase: dω/ω = δ̃
    dφ near resonance; δ̃ from power over amplitude squared.
    """
    frequency = 2 * np.pi * 20.0
    outputs = [displacement_output(beam_system, 2), beam_system.force]
    found = []
    for substeps in (1, 16):
        integrator = TimeIntegrator(beam_system, RATE, outputs, substeps=substeps)
        y = integrator.advance(np.cos(frequency * np.arange(30_001) / RATE))[:, -10_000:]
        assert integrator.corners > 100
        found.append(y @ np.exp(-1j * frequency * np.arange(10_000) / RATE) * 2e-4)
    (x1, f1), (x2, f2) = found
    phase = np.angle((f1 / x1) / (f2 / x2))
    power = [(0.5j * frequency * x * np.conj(f)).real / abs(x) ** 2 for x, f in found]
    assert abs(phase) * 0.07 < 0.0002
    assert abs(power[0] / power[1] - 1) < 0.002


def test_motion_that_blows_up_is_reported():
    system = single_mass(one(CubicSpring, -4e10))
    integrator = TimeIntegrator(system, RATE, [displacement_output(system, 1)])
    with pytest.raises(IntegrationError, match="not finite"):
        integrator.advance(np.full(501, 500.0))


@pytest.mark.parametrize("damping", with_quick([-1e3, -1e5, -1e7, -1e9], -1e9))
@pytest.mark.parametrize(
    "element",
    [pytest.param(one(CubicSpring, 1e9), marks=pytest.mark.campaign), one(Jenkins, 2e4, 5.0), one(QuadraticDrag, 5.0)],
)
def test_negative_damping_that_nothing_bounds_is_reported(element, damping):
    """Also where the motion of one sample is beyond all numbers."""
    integrator = TimeIntegrator(single_mass(element, one(LinearDamper, damping)), RATE, [])
    bounded = isinstance(element, QuadraticDrag) and damping > -1e7
    with contextlib.nullcontext() if bounded else pytest.raises(IntegrationError, match="not finite"):
        # Growth by friction of any velocity is exponential; a hardening spring's stays where a step is a period for a
        # while, for how long is a matter of rounding.
        integrator.advance(np.full(501 if isinstance(element, QuadraticDrag) else 5001, 500.0))
    assert not bounded or np.isfinite(integrator.physical_state).all()


def test_bad_inputs_are_refused(beam_system):
    with pytest.raises(ValueError, match="sample_rate"):
        TimeIntegrator(beam_system, 0.0, [])
    with pytest.raises(ValueError, match="finite"):
        TimeIntegrator(beam_system, RATE, []).advance(np.array([0.0, np.nan]))


@pytest.mark.parametrize("pairs", [1, 5, 11, 12, 16, 33])
def test_free_motion_of_few_and_of_many_pairs_has_the_same_bits(pairs):
    rng = np.random.default_rng(pairs)
    pair, weights = rng.standard_normal((2, 4, pairs)), rng.standard_normal((2, 4, 2 * pairs))
    state, forces, u = rng.standard_normal(2 * pairs), rng.standard_normal(2), rng.standard_normal(2)
    end = np.full(2 * pairs, np.nan)
    move_pairs(pair, weights, 1, *u, forces, state, end)
    x, y = state[:pairs], state[pairs:]
    a, w = pair[1], weights[1]
    moved = np.concatenate([a[0] * x + a[1] * y, a[2] * x + a[3] * y])
    expected = (moved + (w[0] * u[0] + w[1] * u[1])) + (w[2] * forces[0] + w[3] * forces[1])
    assert np.array_equal(end, expected)
