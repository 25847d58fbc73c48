"""Decays of a structure, with its modes and the recorded force, against ones that are known exactly."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_core.messages.linear_description import LinearDescription
from nmt_extract.decays.structure_decay import decay_of
from nmt_study.comparison_analysis import average_decays

RATE = 10_000.0
OMEGA = 2.0 * math.pi * 150.0


def one_mass(mass: float = 1.0) -> LinearDescription:
    """Description of a single mass."""
    return LinearDescription("test", 1, 0, (1,), (OMEGA,), (0.01,), ((mass**-0.5,),), mass**-0.5, OMEGA, 0.01, 0.0)


def records(displacement: np.ndarray, force: np.ndarray | float = 0.0) -> np.ndarray:
    return np.stack([np.broadcast_to(force, displacement.shape), displacement])


@pytest.mark.parametrize("damping", [0.0005, 0.01, 0.08])
@pytest.mark.parametrize("quantity", [Quantity.DISPLACEMENT, Quantity.VELOCITY, Quantity.ACCELERATION])
def test_linear_decay_is_exact(damping: float, quantity: Quantity) -> None:
    mass, amplitude = 2.5, 3e-4
    s = OMEGA * complex(-damping, math.sqrt(1.0 - damping**2))
    time = np.arange(5000) / RATE
    order = {Quantity.DISPLACEMENT: 0, Quantity.VELOCITY: 1, Quantity.ACCELERATION: 2}[quantity]
    motion = (amplitude * s**order * np.exp(s * time)).real
    found = decay_of(records(motion), RATE, one_mass(mass), quantity)
    large = found.modal_amplitude > 1e-6 * amplitude
    np.testing.assert_allclose(found.omega_rad_s[large], OMEGA, rtol=3e-6)
    np.testing.assert_allclose(found.damping_ratio[large], damping, rtol=1e-5)
    np.testing.assert_allclose(
        found.modal_amplitude, math.sqrt(mass) * amplitude * np.exp(s.real * found.time), rtol=2e-3
    )


def test_recorded_force_takes_the_exciter_out() -> None:
    mass, damping, added, brake = 2.0, 0.004, 0.05, 20.0
    total = mass + added
    stiffness, viscous = mass * OMEGA**2, 2.0 * damping * OMEGA * mass
    decay, square = (viscous + brake) / (2.0 * total), stiffness / total
    s = complex(-decay, math.sqrt(square - decay**2))
    time = np.arange(6000) / RATE
    x = 1e-3 * np.exp(s * time)
    force = (-(added * s * s + brake * s) * x).real
    found = decay_of(records((s * s * x).real, force), RATE, one_mass(mass), Quantity.ACCELERATION)
    np.testing.assert_allclose(found.omega_rad_s, OMEGA, rtol=1e-7)
    np.testing.assert_allclose(found.damping_ratio, damping, rtol=1e-5)
    np.testing.assert_allclose(found.apparent_omega_rad_s, math.sqrt(square), rtol=1e-7)
    np.testing.assert_allclose(found.apparent_damping_ratio, decay / math.sqrt(square), rtol=1e-5)
    assert found.apparent_damping_ratio[0] > 1.9 * damping


def test_cubic_spring_agrees_with_averaging() -> None:
    damping, bend = 0.005, 0.1
    solution = solve_ivp(
        lambda _, y: (y[1], -2.0 * damping * OMEGA * y[1] - OMEGA**2 * (y[0] + bend * y[0] ** 3)),
        (0.0, 0.35),
        (1.0, 0.0),
        t_eval=np.arange(3500) / RATE,
        rtol=1e-9,
        atol=1e-12,
        method="DOP853",
    )
    found = decay_of(records(solution.y[0]), RATE, one_mass(), Quantity.DISPLACEMENT)
    expected = OMEGA * np.sqrt(1.0 + 0.75 * bend * found.modal_amplitude**2)
    assert found.omega_rad_s[0] > 1.02 * OMEGA
    np.testing.assert_allclose(found.omega_rad_s, expected, rtol=4e-4)
    # The viscous damper's rate 2 δ̃ω̃ does not depend on the amplitude; without Ω̇/Ω the error were 3 %.
    np.testing.assert_allclose(found.damping_ratio * found.omega_rad_s, damping * OMEGA, rtol=5e-3)


def coulomb_decay(amplitude: float, friction: float, samples: int) -> np.ndarray:
    """Exact motion of a mass with Coulomb friction: half cosines about ±friction/stiffness."""
    half = math.pi / OMEGA
    time = np.arange(samples) / RATE
    number = np.floor(time / half)
    sign = 1.0 - 2.0 * (number % 2)
    return sign * (friction + (amplitude - friction * (2.0 * number + 1.0)) * np.cos(OMEGA * (time - number * half)))


def test_coulomb_friction_agrees_with_its_closed_form() -> None:
    friction = 0.004
    motion = coulomb_decay(1.0, friction, 3500)
    found = decay_of(records(motion), RATE, one_mass(), Quantity.DISPLACEMENT)
    keep = found.modal_amplitude > 0.15
    assert np.count_nonzero(keep) > 4
    np.testing.assert_allclose(found.omega_rad_s[keep], OMEGA, rtol=1e-4)
    expected = 2.0 * friction / (math.pi * found.modal_amplitude[keep])
    np.testing.assert_allclose(found.damping_ratio[keep], expected, rtol=1e-3)


def jenkins_decay(stiffness: float, reach: float, samples: int, fine: int = 40) -> np.ndarray:
    """Motion of a unit mass on a spring and a Jenkins slider, by small steps."""
    step = 1.0 / (RATE * fine)
    x, v, slider = 1.0, 0.0, stiffness * reach
    motion = np.empty(samples)
    for k in range(samples * fine):
        if k % fine == 0:
            motion[k // fine] = x
        v += step * (-(OMEGA**2) * x - slider)
        move = step * v
        x += move
        slider = min(max(slider + stiffness * move, -stiffness * reach), stiffness * reach)
    return motion


def test_decay_of_a_sliding_joint_obeys_its_balance_of_energy() -> None:
    """While the joint slides it holds all the energy it can, so nothing of that comes back as the amplitude falls.

    The balance of power counts the joint's mean stiffness as a store of energy; a decay therefore shows a slightly
    higher damping than a steady vibration of the same amplitude, by about the joint's share of the stiffness.
    """
    share, reach = 0.05, 0.05
    stiffness = share * OMEGA**2
    found = decay_of(records(jenkins_decay(stiffness, reach, 6000)), RATE, one_mass(), Quantity.DISPLACEMENT)
    keep = (found.modal_amplitude > 3.5 * reach) & (found.modal_amplitude < 8.0 * reach)
    q = found.modal_amplitude[keep]
    assert q.size > 1
    slip = np.arccos(1.0 - 2.0 * reach / q)
    elastic = stiffness / math.pi * (slip - 0.5 * np.sin(2.0 * slip))
    steady = 4.0 * stiffness * reach * (q - reach) / (2.0 * math.pi * (OMEGA**2 + elastic) * q**2)
    np.testing.assert_allclose(found.omega_rad_s[keep], np.sqrt(OMEGA**2 + elastic), rtol=5e-4)
    ratio = found.damping_ratio[keep] / steady
    rise = 1e-6 * q
    slip_beside = np.arccos(1.0 - 2.0 * reach / (q + rise))
    slope = q * (stiffness / math.pi * (slip_beside - 0.5 * np.sin(2.0 * slip_beside)) - elastic) / rise
    # Growth of the action by the mode's balance over what the balance of energy, k₀ a ȧ = −D Ω/2π, gives.
    expected = (OMEGA**2 + elastic + 0.25 * slope) / OMEGA**2
    np.testing.assert_allclose(ratio, expected, atol=1e-3)
    assert np.all(expected > 1.002)
    assert np.all(ratio > 1.002)


@pytest.mark.campaign
def test_uncertainties_are_those_of_repeated_noise() -> None:
    rng = np.random.default_rng(3)
    s = complex(-0.004 * OMEGA, OMEGA)
    time = np.arange(6000) / RATE
    clean = np.exp(s * time).real
    omegas, dampings = [], []
    for _ in range(30):
        data = records(clean + 0.02 * rng.standard_normal(time.size), 0.0)
        found = decay_of(data, RATE, one_mass(), Quantity.DISPLACEMENT)
        omegas.append((found.omega_rad_s[1] - OMEGA) / found.omega_rad_s_std[1])
        dampings.append((found.damping_ratio[1] - 0.004) / found.damping_ratio_std[1])
    for deviations in (omegas, dampings):
        assert 0.6 < math.sqrt(np.mean(np.square(deviations))) < 1.35


def test_a_mean_is_as_certain_as_its_number_says() -> None:
    rng = np.random.default_rng(5)
    s = complex(-0.004 * OMEGA, OMEGA)
    clean = np.exp(s * np.arange(6000) / RATE).real
    decays = [
        decay_of(records(clean + 0.02 * rng.standard_normal(clean.size)), RATE, one_mass(), Quantity.DISPLACEMENT)
        for _ in range(8)
    ]
    mean = average_decays(decays)
    assert mean.damping_ratio_std[2] < 0.75 * decays[0].damping_ratio_std[2]
    assert abs(mean.damping_ratio[2] - 0.004) < 4.0 * mean.damping_ratio_std[2]
    assert np.array_equal(average_decays(decays[:1]).damping_ratio, decays[0].damping_ratio)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (np.random.default_rng(1).standard_normal((2, 4000)), "cannot be read"),
        (np.full((2, 4000), math.nan), "Samples are missing"),
        (np.zeros((2, 50)), "50 samples are too few"),
    ],
)
def test_what_is_no_decay_is_refused(data: np.ndarray, words: str) -> None:
    with pytest.raises(BenchError, match=words):
        decay_of(data, RATE, one_mass(), Quantity.DISPLACEMENT)
