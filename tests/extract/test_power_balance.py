from __future__ import annotations

import math

import numpy as np
import pytest
from extract.synthetic import OMEGA, RATE, linear_description, lock_event
from scipy.integrate import solve_ivp

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_core.vocabulary import PointStatus
from nmt_extract.extraction_settings import ExtractionSettings
from nmt_extract.modal.point import modal_point
from nmt_extract.modal.power_balance import balance, part_count
from nmt_extract.modal.window import Channel, Window

ZETA, MASS = 0.03, 0.5
LINEAR = linear_description(
    np.array([[1.0 / math.sqrt(MASS)]]), points=(2,), frequencies_rad_s=(OMEGA,), damping_ratios=(ZETA,)
)
SETTINGS = ExtractionSettings(harmonics=3, topics=("force", "displacement"), power_balance=True)


def window_of(time, force, response, omega, periods):
    cycles = omega * time / (2.0 * np.pi)
    channels = (Channel("f2", Quantity.FORCE, 2), Channel("x2", Quantity.DISPLACEMENT, 2))
    end = omega * (time[-1] + 1.0 / RATE) / (2.0 * np.pi)
    lock = lock_event(0, time.size, periods)
    return Window(lock, RATE, channels, np.array([force, response]), cycles, end)


def oscillator(omega, growth, stiffening=0.0, periods=20, settle=3.0):
    """Oscillator with x'' + 2 ζ ω₀ x' + ω₀² x (1 + stiffening x²) driven at ``omega`` with a growing force."""
    skip = round(settle * RATE)
    samples = round(periods * 2.0 * np.pi / omega * RATE)
    time = np.arange(skip + samples) / RATE

    def force(t):
        return np.exp(growth * (t - settle)) * np.cos(omega * t)

    def rate(t, y):
        x, v = y.tolist()
        pull = math.exp(growth * (t - settle)) * math.cos(omega * t) / MASS
        return [v, pull - 2 * ZETA * OMEGA * v - OMEGA**2 * x * (1.0 + stiffening * x**2)]

    solution = solve_ivp(rate, (0.0, time[-1]), [0.0, 0.0], method="DOP853", t_eval=time, rtol=1e-9, atol=1e-13)
    chosen = slice(skip, None)
    window = window_of(time[: time.size - skip], force(time)[chosen], solution.y[0][chosen], omega, periods)
    # Phase zero of the oscillator at the window's start.
    shift = omega * skip / RATE / (2.0 * np.pi)
    return Window(window.lock, RATE, window.channels, window.data, window.cycles + shift, window.end_cycles + shift)


@pytest.mark.parametrize("detuning", [0.99, 1.0, 1.01])
@pytest.mark.parametrize("growth", [0.0, 0.3])
def test_frequency_and_damping_of_an_oscillator_off_resonance_on_a_ramp(detuning, growth):
    window = oscillator(detuning * OMEGA, growth)
    point = modal_point(window, LINEAR, SETTINGS)
    assert point.status is PointStatus.OK, point.reason
    # The driving frequency itself is off by the detuning and the steady-state damping by the growth.
    assert point.omega_rad_s == pytest.approx(OMEGA, rel=2e-4)
    assert point.damping_ratio == pytest.approx(ZETA, rel=3e-3)
    assert point.damping_ratio_std < 0.02 * ZETA
    if growth:
        steady = modal_point(window, LINEAR, ExtractionSettings(3, ("force", "displacement")))
        assert abs(steady.damping_ratio / ZETA - 1.0) > 0.03


def test_a_steady_level_gives_the_same_with_and_without_the_balance():
    window = oscillator(OMEGA, 0.0, settle=6.0)
    plain = modal_point(window, LINEAR, ExtractionSettings(3, ("force", "displacement")))
    balanced = modal_point(window, LINEAR, SETTINGS)
    for name in ("omega_rad_s", "damping_ratio", "modal_amplitude", "self_excitation"):
        assert getattr(balanced, name) == pytest.approx(getattr(plain, name), rel=1e-4), name
    assert balanced.pbmif == plain.pbmif


def test_a_softening_oscillator_keeps_its_damping_on_a_ramp():
    """Its frequency follows the amplitude: ω̃ = ω₀ (1 + ⅜ κ a²) with the amplitude a."""
    kappa = -0.1 / 1e-3**2
    force_scale = 2.0 * ZETA * OMEGA**2 * MASS * 4e-4
    window = oscillator(0.995 * OMEGA, 0.25, stiffening=kappa / (1.0 / force_scale) ** 2)
    point = modal_point(window, LINEAR, SETTINGS)
    assert point.status is PointStatus.OK
    a = point.modal_amplitude / math.sqrt(MASS)
    expected = OMEGA * math.sqrt(1.0 + 0.75 * kappa / (1.0 / force_scale) ** 2 * a**2)
    assert expected < 0.995 * OMEGA
    assert point.omega_rad_s == pytest.approx(expected, rel=2e-4)
    assert point.damping_ratio == pytest.approx(ZETA * OMEGA / expected, rel=2e-3)  # ξ is constant


def test_a_short_window_is_refused_with_what_to_do():
    window = oscillator(OMEGA, 0.0, periods=8)
    point = modal_point(window, LINEAR, SETTINGS)
    assert point.status is PointStatus.REJECTED
    assert "lengthen the window" in point.reason
    assert part_count(9) == 4
    assert part_count(50) == 10


def test_a_property_that_bends_within_the_window_says_so():
    time = np.linspace(0.05, 0.95, 10)
    amplitude = np.exp(0.3 * time)
    omega = np.full(10, 100.0)
    corner = np.where(amplitude > 1.2, 1.0 + 8.0 * (amplitude - 1.2), 1.0)
    energy = 0.5 * (omega * amplitude) ** 2

    def run(excitation):
        power = energy * (excitation + 0.6)  # 0.6 = growth of the action, 2 · 0.3
        zero = np.zeros(10)
        return balance(time, 1.0, omega, amplitude, power, zero, zero)

    straight, bent = run(np.ones(10)), run(corner)
    assert straight.self_excitation == pytest.approx(1.0, rel=1e-6)
    assert straight.self_excitation_std < 1e-6
    at_mean = np.interp(bent.modal_amplitude, amplitude, corner)
    mean = float(np.average(corner, weights=energy))
    assert abs(bent.self_excitation - at_mean) < 0.2 * abs(mean - at_mean)
    assert abs(bent.self_excitation - at_mean) < 2.0 * bent.self_excitation_std
    with pytest.raises(BenchError, match="parts"):
        balance(*(np.ones(4) if k != 1 else 1.0 for k in range(7)))
