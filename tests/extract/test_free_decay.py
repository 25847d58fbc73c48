"""Free decays of one channel against closed forms, by what `./nmt extract` writes of them."""

from __future__ import annotations

import math
import re
from collections.abc import Callable

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from nmt_core.vocabulary import Quantity
from nmt_extract.decays.free_decay import FreeDecay, channel_decay

RATE = 10_000.0
OMEGA = 2.0 * math.pi * 150.0
TIME = np.arange(6000) / RATE


def linear(damping: float, omega: float = OMEGA, time: np.ndarray = TIME) -> np.ndarray:
    return np.exp(omega * complex(-damping, math.sqrt(1.0 - damping**2)) * time).real


def found(values: np.ndarray, rate: float = RATE, quantity: Quantity = Quantity.DISPLACEMENT) -> FreeDecay:
    decay = channel_decay(values, rate, quantity, (1, "x1", "m"), 0.0)
    assert decay.reason == ""
    return decay


@pytest.mark.parametrize("damping", [0.0005, 0.004, 0.01, 0.08])
def test_a_linear_decay_has_its_frequency_and_damping(damping: float) -> None:
    decay = found(linear(damping))
    large = decay.amplitude > 1e-6
    np.testing.assert_allclose(2.0 * math.pi * decay.frequency_hz[large], OMEGA, rtol=3e-6)
    np.testing.assert_allclose(decay.damping_ratio[large], damping, rtol=3e-6)
    assert np.all(np.diff(decay.time) > 0.0)
    np.testing.assert_allclose(decay.amplitude, np.exp(-damping * OMEGA * decay.time), rtol=2e-3)


def test_uncertainties_are_those_of_repeated_noise() -> None:
    rng = np.random.default_rng(3)
    deviations = []
    for _ in range(20):
        decay = found(linear(0.004) + 0.005 * rng.standard_normal(TIME.size))
        deviations += [
            (
                (2.0 * math.pi * decay.frequency_hz[1] - OMEGA) / (2.0 * math.pi * decay.frequency_hz_std[1]),
                (decay.damping_ratio[1] - 0.004) / decay.damping_ratio_std[1],
            )
        ]
    for column in zip(*deviations, strict=True):
        assert 0.6 < math.sqrt(np.mean(np.square(column))) < 1.4


@pytest.mark.parametrize(
    ("beside", "frequency", "damping"),
    [
        (0.02 * np.cos(2.0 * math.pi * 100.02 * TIME), 1e-6, 1e-4),  # the mains: 1e-4, 1.4e-2 where it stays in
        (0.8 * linear(0.006, 2.0 * math.pi * 400.0), 3e-5, 2e-3),  # another mode
    ],
)
def test_what_rings_beside_the_mode_leaves_it_as_it_is(beside: np.ndarray, frequency: float, damping: float) -> None:
    decay = found(linear(0.004) + beside)
    np.testing.assert_allclose(2.0 * math.pi * decay.frequency_hz, OMEGA, rtol=frequency)
    np.testing.assert_allclose(decay.damping_ratio, 0.004, rtol=damping)


def test_four_samples_a_period_are_enough() -> None:
    decay = found(linear(0.004, time=np.arange(2000) / 600.0), 600.0)
    np.testing.assert_allclose(2.0 * math.pi * decay.frequency_hz, OMEGA, rtol=1e-7)
    np.testing.assert_allclose(decay.damping_ratio, 0.004, rtol=1e-5)


def motions(restoring: Callable[[float, float], float], seconds: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Displacement, velocity and acceleration of a mass that is let go at 1 m, by an integrator."""
    solution = solve_ivp(
        lambda _, y: (y[1], -restoring(y[0], y[1])), (0.0, seconds), (1.0, 0.0),
        t_eval=np.arange(round(seconds * RATE)) / RATE, rtol=1e-10, atol=1e-13, method="DOP853",
    )  # fmt: skip
    x, v = solution.y
    return x, v, -np.array([restoring(*pair) for pair in zip(x, v, strict=True)])


@pytest.mark.parametrize(
    ("order", "quantity"), enumerate([Quantity.DISPLACEMENT, Quantity.VELOCITY, Quantity.ACCELERATION])
)
def test_a_cubic_spring_shows_its_backbone_and_its_damper(order: int, quantity: Quantity) -> None:
    damping, bend = 0.005, 0.1
    motion = motions(lambda x, v: 2.0 * damping * OMEGA * v + OMEGA**2 * (x + bend * x**3), 0.35)[order]
    decay = found(motion, quantity=quantity)
    omega = 2.0 * math.pi * decay.frequency_hz
    expected = OMEGA * np.sqrt(1.0 + 0.75 * bend * (decay.amplitude / omega**order) ** 2)
    assert expected[0] > 1.02 * OMEGA
    np.testing.assert_allclose(omega, expected, rtol=1e-4)
    # The damper's rate 2 δ̃ω̃ does not depend on the amplitude. Without Ω̇/Ω the error of a displacement were 3 %; with
    # that of a displacement that of an acceleration is 9 %.
    np.testing.assert_allclose(decay.damping_ratio * omega, damping * OMEGA, rtol=5e-3)


@pytest.mark.parametrize(
    ("order", "quantity"), enumerate([Quantity.DISPLACEMENT, Quantity.VELOCITY, Quantity.ACCELERATION])
)
def test_quadratic_drag_agrees_with_averaging(order: int, quantity: Quantity) -> None:
    """F = c |v| v takes 8/3 c ω² a³ from a period: δ̃ = 4 c a / 3π for a unit mass."""
    drag = 0.05
    decay = found(motions(lambda x, v: OMEGA**2 * x + drag * abs(v) * v, 0.5)[order], quantity=quantity)
    amplitude = decay.amplitude / OMEGA**order
    assert np.ptp(np.log(amplitude)) > 1.0
    np.testing.assert_allclose(2.0 * math.pi * decay.frequency_hz, OMEGA, rtol=3e-4)
    np.testing.assert_allclose(decay.damping_ratio, 4.0 * drag * amplitude / (3.0 * math.pi), rtol=4e-3)


def test_coulomb_friction_agrees_with_its_closed_form() -> None:
    friction, half = 0.004, math.pi / OMEGA
    time = TIME[:1700]
    number = np.floor(time / half)
    sign = 1.0 - 2.0 * (number % 2)
    motion = sign * (friction + (1.0 - friction * (2.0 * number + 1.0)) * np.cos(OMEGA * (time - number * half)))
    decay = found(motion)
    np.testing.assert_allclose(2.0 * math.pi * decay.frequency_hz, OMEGA, rtol=1e-4)
    np.testing.assert_allclose(decay.damping_ratio, 2.0 * friction / (math.pi * decay.amplitude), rtol=1e-3)


@pytest.mark.parametrize(
    ("values", "words"),
    [
        (np.full(4000, math.nan), "Samples are missing"),
        (np.ones(4000), "does not move"),
        (np.random.default_rng(1).standard_normal(4000), "cannot be read"),
        (np.zeros(30) + np.arange(30), "30 samples are too few"),
    ],
)
def test_what_is_no_decay_says_why_in_a_sentence(values: np.ndarray, words: str) -> None:
    decay = channel_decay(values, RATE, Quantity.DISPLACEMENT, (1, "x1", "m"), 0.0)
    assert decay.time.size == 0
    assert re.search(words, decay.reason)
    assert decay.reason[0].isupper()
    assert decay.reason.endswith(".")
