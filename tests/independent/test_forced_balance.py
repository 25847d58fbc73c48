"""The balance that judges response curves, against closed forms, time integration and the other balance."""

from __future__ import annotations

import math

import numpy as np
import pytest
from independent.harmonic_continuation import CubicModes, PhaseBranch, Solution

from nmt_laboratories.epmc_by_receptance import coulomb_force
from nmt_laboratories.forced_balance import OneElement, cantilever, chain_of_one, cubic, stops


def pure(balance: OneElement, force: float) -> np.ndarray:
    found = np.zeros(balance.orders.size, complex)
    found[0] = force
    return found


@pytest.mark.parametrize("lag", [0.4, 1.5, 2.6])
def test_without_an_element_the_response_is_the_receptance(lag):
    balance = chain_of_one(100.0, 0.4, cubic(0.0))
    orbit = balance.at_lag(lag, pure(balance, 2.0), 10.0, 0.3 * np.exp(-1j * lag))
    assert math.atan2(0.4 * orbit.omega, 100.0 - orbit.omega**2) == pytest.approx(lag, rel=1e-8)
    assert orbit.response == pytest.approx(2.0 * math.sin(lag) / (0.4 * orbit.omega), rel=1e-8)


def test_a_cubic_spring_is_that_of_the_balance_with_a_jacobian_of_modes():
    one = np.array([1.0])
    other = CubicModes(one, np.array([0.01]), one, one, 1.0, 15)
    series = np.zeros((other.orders.size, 1), complex)
    series[0, 0] = -1.0j
    expected = PhaseBranch(other, 90.0, 1.0).at_force(Solution(series, 1.32, 0.03), 0.03)
    balance = chain_of_one(1.0, 0.02, cubic(1.0))
    orbit = balance.at_lag(0.5 * math.pi, pure(balance, 0.03), 1.32, -1.0j)
    assert orbit.omega == pytest.approx(expected.omega_b, rel=1e-8)
    assert np.abs(orbit.drive - expected.series[:, 0]).max() < 1e-8


def test_the_force_of_a_held_response_is_the_one_that_leads_to_it():
    balance = chain_of_one(1.0, 0.02, cubic(1.0))
    orbit, force = balance.at_response(1.3, 0.8, 1.2, 0.02)
    again = balance.at_lag(1.3, pure(balance, force), orbit.omega, orbit.drive[0])
    assert orbit.response == pytest.approx(0.8, rel=1e-9)
    assert again.response == pytest.approx(0.8, rel=1e-8)
    assert again.omega == pytest.approx(orbit.omega, rel=1e-9)


def test_stops_keep_the_orbit_of_a_time_integration():
    balance = chain_of_one(16000.0, 2.53, stops(8000.0, 3e-4), highest=25)
    orbit = balance.at_lag(1.2, pure(balance, 0.2), 133.0, 5.5e-4 * np.exp(-1.2j))
    found = balance.simulate(orbit, 0.2, 6, lambda w, v: 8000.0 * (max(w - 3e-4, 0.0) - max(-w - 3e-4, 0.0)))
    assert abs(found - orbit.drive[0]) < 2e-4 * orbit.response


def test_a_slipping_joint_takes_the_power_that_the_force_gives():
    beam = cantilever(
        7, 0.7, 0.00527668, 0.01156978, 185.0e9, 7830.0, 1.0e-4, 3, 2,
        lambda w, v: coulomb_force(w, 8000.0, 1.0), highest=9, samples=1024,
    )  # fmt: skip
    orbit = beam.at_lag(0.5 * math.pi, pure(beam, 0.6), 138.0, -2e-4j)
    size = abs(orbit.local[0])
    assert size > 1.0 / 8000.0  # it slips
    # Work of a loop of the element per period: 4 μN (w − μN / k_t) with the peak of w; of the beam β K: π ω x̄ᵀ C x.
    peak = np.abs((orbit.local @ np.exp(2j * math.pi * np.outer(beam.orders, np.arange(1024) / 1024))).real).max()
    g = beam.element(orbit.local, orbit.omega)
    lost = 4.0 * (peak - 1.0 / 8000.0)
    for k, order in enumerate(beam.orders):
        s = 1j * order * orbit.omega
        load = pure(beam, 0.6)[k] * beam.driven - g[k] * beam.local
        x = np.linalg.solve(beam.stiffness + s * beam.damping + s * s * beam.mass, load)
        lost += math.pi * order**2 * orbit.omega * float((x.conj() @ beam.damping @ x).real)
    fed = math.pi * 0.6 * orbit.response
    assert fed == pytest.approx(lost, rel=1e-5)


def test_exponents_of_a_linear_orbit_are_its_poles_less_the_frequency():
    balance = chain_of_one(100.0, 0.4, cubic(0.0))
    orbit = balance.at_lag(1.0, pure(balance, 2.0), 9.9, 0.3 * np.exp(-1j))
    found = balance.exponents(orbit)
    assert found.real == pytest.approx([-0.2, -0.2], rel=1e-6)
    assert np.abs(found.imag) == pytest.approx([abs(math.sqrt(100.0 - 0.04) - orbit.omega)] * 2, rel=1e-5)


def test_one_exponent_passes_through_zero_at_a_fold():
    balance = chain_of_one(16000.0, 2.5298221281347035, cubic(1.6e10), samples=128)
    force = pure(balance, 0.32)
    lag, orbit = balance.fold(1.63, force, 155.0, 0.8e-3, 1.0)
    assert balance.exponents(orbit)[0].real == pytest.approx(0.0, abs=0.05)
    before, after = (
        balance.exponents(balance.at_lag(lag + side, force, orbit.omega, orbit.drive[0])) for side in (-0.1, 0.1)
    )
    assert before[0].real < -0.5
    assert after[0].real > 0.5
    assert after.real.sum() == pytest.approx(-2.5298221281347035, rel=1e-6)  # as the damping says


def test_a_fold_is_where_the_frequency_turns():
    balance = chain_of_one(16000.0, 2.5298221281347035, cubic(1.6e10), samples=128)
    force = pure(balance, 0.32)
    lag, orbit = balance.fold(1.63, force, 155.0, 0.8e-3, 1.0)
    assert abs(balance.slope(orbit, lag, force)) < 1e-2
    for side in (-0.05, 0.05):
        near = balance.at_lag(lag + side, force, orbit.omega, orbit.drive[0])
        assert near.omega < orbit.omega
