"""The harmonic balance that judges continuation and secondary resonances, against closed forms and time simulation."""

from __future__ import annotations

import math

import numpy as np
import pytest
from independent.harmonic_continuation import CubicModes, PhaseBranch, Solution, response_curve

ONE = np.array([1.0])


def oscillator(zeta: float = 0.01, force_order: int = 1, response_order: int = 1, cubic: float = 1.0) -> CubicModes:
    """ẍ + 2 ζ ẋ + x + x³ = F cos(ν τ)."""
    return CubicModes(ONE, np.array([zeta]), ONE, ONE, cubic, 25, force_order, response_order)


def single(system: CubicModes, **amplitudes: complex) -> np.ndarray:
    """A series of one mode; ``x3=0.1`` is its third order."""
    series = np.zeros((system.orders.size, 1), complex)
    for name, value in amplitudes.items():
        series[np.flatnonzero(system.orders == int(name[1:]))[0]] = value
    return series


def simulated(system: CubicModes, solution: Solution, periods: int = 1) -> np.ndarray:
    """Orders of the drive point in the last of so many base periods of a time simulation from the solution."""
    start = system.start_state(solution.series, solution.omega_b)
    motion, _ = system.simulate(start, solution.omega_b, solution.force, periods, 256)
    spectrum = 2.0 * np.fft.fft(motion @ system.drive_shape) / 256
    return spectrum[system.orders]


def test_without_a_spring_phase_resonance_is_the_linear_one():
    system = oscillator(cubic=0.0)
    branch = PhaseBranch(system, 90.0, 1.0)
    solution = branch.at_force(Solution(single(system, x1=-0.4j), 0.99, 0.01), 0.01)
    assert solution.omega_b == pytest.approx(1.0, rel=1e-9)
    assert solution.series[0, 0] == pytest.approx(-0.5j, rel=1e-9)


def test_a_weak_spring_hardens_as_the_method_of_averaging_says():
    system = oscillator(cubic=0.01)
    branch = PhaseBranch(system, 90.0, 1.0)
    solution = branch.at_amplitude(Solution(single(system, x1=-0.5j), 1.0, 0.01), 0.5)
    assert solution.omega_b == pytest.approx(1.0 + 0.375 * 0.01 * 0.25, rel=1e-6)
    assert solution.force == pytest.approx(0.02 * 0.5, rel=2e-3)


@pytest.mark.parametrize(
    ("orders", "lag", "guess", "force"),
    [
        ((1, 1), 90.0, (1.32, {"x1": -1.0j}), 0.03),
        ((1, 3), 270.0, (0.363, {"x1": 0.286, "x3": 0.287j}), 0.3),
        ((1, 3), 270.0, (0.478, {"x1": 0.418, "x3": 0.969j}), 1.0),
        ((3, 1), 90.0, (2.287, {"x1": 2.33 * np.exp(-1j * math.pi / 6), "x3": -0.088}), 1.0),
    ],
    ids=["phase resonance", "3:1, small", "3:1, large", "1:3, tip"],
)
def test_each_resonance_is_a_motion_of_the_time_simulation(orders, lag, guess, force):
    system = oscillator(force_order=orders[0], response_order=orders[1])
    omega_b, amplitudes = guess
    solution = PhaseBranch(system, lag, 1.0).at_force(Solution(single(system, **amplitudes), omega_b, force), force)
    assert math.degrees(system.lag(solution.series)) % 360.0 == pytest.approx(lag % 360.0, abs=1e-6)
    # After one period the motion is where it was, and has the orders of the balance.
    expected = solution.series @ system.drive_shape
    assert np.abs(simulated(system, solution) - expected).max() < 2e-4 * np.abs(expected).max()


@pytest.mark.parametrize("force", [0.3, 0.5, 1.0])
def test_at_the_peak_of_the_third_harmonic_its_lag_is_270_degrees(force):
    system = oscillator(response_order=3)
    guess = {0.3: (0.363, 0.286, 0.287), 0.5: (0.4015, 0.355, 0.566), 1.0: (0.478, 0.418, 0.969)}[force]
    start = Solution(single(system, x1=guess[1], x3=1j * guess[2]), guess[0], force)
    solution = PhaseBranch(system, 270.0, 1.0).at_force(start, force)
    near = solution.omega_b * (1.0 + np.linspace(0.0, 0.005, 21))
    curve = [*response_curve(system, solution, near), *response_curve(system, solution, near[0] - (near - near[0]))]
    highest = max(curve, key=lambda item: abs(item.series[1, 0]))
    assert math.degrees(system.lag(highest.series)) % 360.0 == pytest.approx(270.0, abs=5.0)
    assert highest.omega_b == pytest.approx(solution.omega_b, rel=1e-3)
