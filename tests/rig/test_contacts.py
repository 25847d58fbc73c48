"""Friction and contacts at many places."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from rig.energies import stored_energy
from scipy.integrate import solve_ivp
from tiers import with_quick

from nmt_rig.model.assembly import ElectromechanicalSystem, acceleration_output, assemble, displacement_output
from nmt_rig.model.beam import euler_bernoulli_beam
from nmt_rig.model.chain import lumped_chain
from nmt_rig.model.local_elements.contacts import TwoSidedGap, UnilateralStop
from nmt_rig.model.local_elements.element import LocalElement
from nmt_rig.model.local_elements.friction import Jenkins
from nmt_rig.model.local_elements.springs import CubicSpring
from nmt_rig.model.propagator import state_space
from nmt_rig.model.shaker import ElectrodynamicShaker
from nmt_rig.model.time_integration import TimeIntegrator

RATE = 10_000.0
SHAKER = ElectrodynamicShaker(0.024, 20707.0, 28.33, 0.019, 8.42e7, 57.17, 15.48, 140e-6, 3.0)


def drive(frequency_hz: float, seconds: float, amplitude: float = 1.0, rate: float = RATE) -> np.ndarray:
    return amplitude * np.sin(2 * np.pi * frequency_hz * np.arange(round(seconds * rate) + 1) / rate)


def beam_with(kind: str, count: int = 12) -> ElectromechanicalSystem:
    beam = euler_bernoulli_beam(0.7, 0.00527668, 0.01156978, 185e9, 7830.0, 20, 1e-4)
    elements: list[LocalElement] = []
    for place in np.linspace(2, 20, count).astype(int):
        direction = beam.selector(int(place))
        if kind != "gaps":
            elements.append(Jenkins(direction, 8000.0 / count, 0.4 / count))
        if kind != "joints":
            elements.append(TwoSidedGap(direction, 2000.0, 8e-5))
    return assemble(beam, elements, 6, SHAKER)


def chain_of_contacts() -> ElectromechanicalSystem:
    """Four masses: sliders to the ground and between masses, two on one direction, a gap and a preloaded stop."""
    chain = lumped_chain([0.5, 0.4, 0.6, 0.3], [3e4, 2e4, 4e4], None, [2e4, 0.0, 0.0, 1e4], [1.0, 1.0, 1.0, 1.0])
    between = chain.selector(3) - chain.selector(2)
    elements = [
        Jenkins(chain.selector(1), 9000.0, 2.0),
        Jenkins(chain.selector(1), 4000.0, 0.5),
        Jenkins(between, 2e4, 1.5),
        TwoSidedGap(chain.selector(4), 6e4, 1.5e-4),
        UnilateralStop(chain.selector(3), 5e4, -2e-5),
        Jenkins(chain.selector(4), 8000.0, 1.0),
    ]
    return assemble(chain, elements, 1)


def independent_motion(
    system: ElectromechanicalSystem, frequency_hz: float, amplitude: float, end: float
) -> np.ndarray:
    """State at `end` by solve_ivp from rest: branches of every element of its own, each corner a terminal event."""
    space = state_space(system)
    m, elements = space.mechanical_size, space.elements
    rows = np.array([element.direction[:m] for element in elements])
    columns = [space.b_ports[:, q] for q in space.element_port]
    branch = [1 if isinstance(e, UnilateralStop) and e.gap < 0 else 0 for e in elements]
    slider = np.zeros(len(elements))
    state, now = np.zeros(space.size), 0.0

    def force(e: int, w: float) -> float:
        element = elements[e]
        if isinstance(element, Jenkins):
            if branch[e]:
                return branch[e] * element.slip_force
            return element.tangential_stiffness * (w - slider[e])
        return element.stiffness * (w - branch[e] * element.gap) if branch[e] else 0.0

    def rate(t: float, y: np.ndarray) -> np.ndarray:
        result = space.a @ y + space.b_inputs[:, 0] * (amplitude * np.sin(2 * np.pi * frequency_hz * t))
        for e, column in enumerate(columns):
            result = result + column * force(e, rows[e] @ y[:m])
        return result

    def left(e: int, side: int):
        """Falls through zero where element e leaves its branch, for `side` where there are two ways."""
        element = elements[e]

        def function(t: float, y: np.ndarray) -> float:
            w, v = rows[e] @ y[:m], rows[e] @ y[m : 2 * m]
            if isinstance(element, Jenkins):
                if branch[e]:
                    return branch[e] * v if side > 0 else 1.0
                return element.slip_force - side * element.tangential_stiffness * (w - slider[e])
            if branch[e]:
                return branch[e] * w - element.gap if side > 0 else 1.0
            return element.gap - side * w if side > 0 or isinstance(element, TwoSidedGap) else 1.0

        function.terminal, function.direction = True, -1.0
        return function

    while now < end:
        events = [left(e, side) for e in range(len(elements)) for side in (1, -1)]
        solution = solve_ivp(rate, (now, end), state, "DOP853", rtol=1e-10, atol=1e-13, events=events, max_step=5e-4)
        assert solution.success, solution.message
        state, now = solution.y[:, -1], float(solution.t[-1])
        fired = {(k // 2, 1 - 2 * (k % 2)) for k, times in enumerate(solution.t_events) if len(times)}
        # Sliders on one direction stop together; scipy names only one of them.
        fired |= {
            (e, 1)
            for e, element in enumerate(elements)
            if isinstance(element, Jenkins) and branch[e] and branch[e] * (rows[e] @ state[m : 2 * m]) <= 1e-9
        }
        for e, side in fired:
            element, w = elements[e], rows[e] @ state[:m]
            if branch[e] and isinstance(element, Jenkins):
                slider[e] = w - branch[e] * element.slip_force / element.tangential_stiffness
            branch[e] = 0 if branch[e] else side
    return state


def test_many_contacts_against_solve_ivp():
    system, frequency, amplitude, end = chain_of_contacts(), 31.0, 12.0, 0.15
    expected = independent_motion(system, frequency, amplitude, end)
    integrator = TimeIntegrator(system, RATE, [], substeps=8)
    integrator.advance(drive(frequency, end, amplitude))
    assert integrator.corners > 40
    scale = np.abs(expected[:4]).max()
    assert np.abs(integrator.physical_state[:4] - expected[:4]).max() < 1e-4 * scale


@pytest.mark.parametrize("kind", with_quick(["joints", "gaps", "both"], "both"))
def test_modal_and_physical_coordinates_are_as_accurate(kind):
    system = beam_with(kind)
    outputs = [displacement_output(system, 20), system.force, acceleration_output(system, 6)]
    found, whole, fine = (
        TimeIntegrator(system, RATE, outputs, substeps, dense=dense)
        for dense, substeps in ((False, 1), (True, 1), (True, 8))
    )
    assert found.modal
    assert not whole.modal
    y, z, exact = (integrator.advance(drive(20.0, 0.2, 1.5)) for integrator in (found, whole, fine))
    assert found.corners > 60
    assert found.corners == pytest.approx(whole.corners, rel=0.02)
    errors = [np.sqrt(np.mean((values - exact) ** 2, axis=1) / np.mean(exact**2, axis=1)) for values in (y, z)]
    assert np.all(errors[0] < np.maximum(1.2 * errors[1], 1e-6))  # below that both are exact
    assert np.all(errors[0] < 2e-4)
    np.testing.assert_allclose(
        found.slider_dissipation, fine.slider_dissipation, rtol=1e-3, atol=1e-5 * fine.slider_dissipation.max()
    )
    assert stored_energy(found) == pytest.approx(stored_energy(fine), rel=1e-4)


def test_stiff_contacts_are_solved_for_at_once():
    """Contacts as stiff as the step allows."""
    chain = lumped_chain([0.01] * 3, [2e4, 2e4], None, [2e4, 0.0, 2e4], [0.2] * 3)
    stops = [TwoSidedGap(chain.selector(p), 2e5, 1e-5) for p in (1, 2, 3)]
    system = assemble(chain, [*stops, Jenkins(chain.selector(2), 1e5, 0.5)], 1)
    rows = [displacement_output(system, p) for p in (1, 2, 3)]
    y, z, exact = (
        TimeIntegrator(system, RATE, rows, substeps, dense=dense).advance(drive(60.0, 0.05, 3.0))
        for dense, substeps in ((False, 1), (True, 1), (True, 32))
    )
    errors = [np.sqrt(np.mean((values - exact) ** 2)) for values in (y, z)]
    assert errors[0] < 1.2 * errors[1]
    assert errors[0] < 1e-3 * np.abs(exact).max()


@pytest.mark.parametrize("kind", ["joints", "both"])
def test_blocks_of_any_length_give_the_same_bits(kind):
    system = beam_with(kind)
    outputs = [displacement_output(system, 20), system.force, acceleration_output(system, 6)]
    inputs = drive(20.0, 0.2, 1.5)
    integrator = TimeIntegrator(system, RATE, outputs)
    whole = integrator.advance(inputs)
    assert integrator.corners > 60
    for lengths in ([1] * 600 + [7] * 20, [200] * 10, [333, 4, 1000]):
        integrator = TimeIntegrator(system, RATE, outputs)
        parts, k = [], 0
        for n in lengths:
            parts.append(integrator.advance(inputs[k : k + n + 1]))
            k += n
        assert np.array_equal(np.hstack(parts), whole[:, :k])


def test_places_that_rest_leave_the_motion_linear():
    """Below slip and gap the beam is linear with the sliders' springs: no corner, and the response in closed form."""
    system, frequency = beam_with("both"), 2 * np.pi * 25.0
    integrator = TimeIntegrator(system, RATE, [displacement_output(system, 20)])
    y = integrator.advance(1e-3 * np.cos(frequency * np.arange(40_001) / RATE))[:, -4000:]
    assert integrator.corners == 0
    assert integrator.steps == 40_000
    response, _ = system.response(frequency)
    found = 2 / 4000 * (y @ np.exp(-1j * frequency * np.arange(36_000, 40_000) / RATE))
    np.testing.assert_allclose(found, [1e-3 * response[system.points[20]]], rtol=2.5e-5)


def test_slip_forces_and_stiffness_may_drift():
    """A change of slip forces, then of the structure, at samples of their own."""
    results = []
    for dense in (False, True):
        system = beam_with("joints")
        integrator = TimeIntegrator(system, RATE, [displacement_output(system, 20), system.force], dense=dense)
        parts = [integrator.advance(drive(20.0, 0.1, 1.5))]
        weaker = [replace(e, slip_force=0.8 * e.slip_force) for e in system.elements if isinstance(e, Jenkins)]
        integrator.change(replace(system, elements=tuple(weaker)))
        parts.append(integrator.advance(drive(20.0, 0.1, 1.5)))
        integrator.change(replace(system, elements=tuple(weaker), stiffness=1.01 * system.stiffness))
        parts.append(integrator.advance(drive(20.0, 0.1, 1.5)))
        results.append(np.hstack(parts))
    scale = np.abs(results[1]).max(axis=1, keepdims=True)
    np.testing.assert_allclose(results[0] / scale, results[1] / scale, atol=1e-4)


def test_smooth_elements_and_contacts_in_both_coordinates():
    chain = lumped_chain([0.5, 0.4], [3e4], None, [2e4, 2e4], [1.0, 1.0])
    elements = [Jenkins(chain.selector(1), 9000.0, 2.0), CubicSpring(chain.selector(2), 4e10)]
    system = assemble(chain, elements, 1)
    rows = [displacement_output(system, 1), displacement_output(system, 2)]
    y, z = (TimeIntegrator(system, RATE, rows, dense=dense).advance(drive(30.0, 0.1, 10.0)) for dense in (False, True))
    np.testing.assert_allclose(y, z, atol=1e-6 * np.abs(z).max())
