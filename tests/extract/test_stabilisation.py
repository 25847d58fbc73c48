"""Stabilisation diagram and choice of stable poles."""

from __future__ import annotations

import numpy as np
import pytest

from nmt_core.errors import BenchError
from nmt_extract.linear.residuals import modal_receptance
from nmt_extract.linear.stabilisation import MINIMUM_RUN, OrderPoles, order_poles, stable_poles

MODES = [(40.0, 0.01, [0.3, 0.5]), (125.0, 0.03, [0.2, -0.4]), (126.0 * 2, 0.008, [0.3, 0.1])]


def accelerance(frequency: np.ndarray) -> np.ndarray:
    total = sum(modal_receptance(np.array(shape), 2 * np.pi * f, zeta, frequency) for f, zeta, shape in MODES)
    return -((2 * np.pi * frequency) ** 2) * total


# Spacings at which filling up by arange gives the right number of lines, and one at which it does not.
@pytest.mark.parametrize("spacing", [0.125, 1 / 6, 0.1])
def test_poles_of_known_modes_at_their_place_whatever_the_spacing_of_lines(spacing):
    frequency = np.arange(round(10 / spacing), round(400 / spacing)) * spacing
    noise = np.random.default_rng(0).standard_normal((2, 2, frequency.size))
    data = accelerance(frequency)
    data = data * (1 + 0.01 * (noise[0] + 1j * noise[1]))
    poles = stable_poles(order_poles(data, frequency, (10.0, 390.0)))
    assert [pole.frequency_hz for pole in poles] == pytest.approx([f for f, _, _ in MODES], rel=5e-4)
    assert [pole.damping_ratio for pole in poles] == pytest.approx([z for _, z, _ in MODES], rel=0.03)


def test_noise_has_no_stable_pole():
    frequency = np.arange(10.0, 400.0, 0.125)
    noise = np.random.default_rng(1).standard_normal((2, 2, frequency.size))
    assert stable_poles(order_poles(noise[0] + 1j * noise[1], frequency, (10.0, 390.0))) == []


def diagram(*orders: list[tuple[float, float]]) -> list[OrderPoles]:
    return [
        OrderPoles(
            number, np.array([f for f, _ in poles]), np.array([z for _, z in poles]), np.zeros(len(poles), dtype=bool)
        )
        for number, poles in enumerate(orders, start=1)
    ]


def test_a_pole_must_stay_over_enough_orders():
    steady = [(100.0, 0.01)]
    assert stable_poles(diagram(*[steady] * (MINIMUM_RUN - 1))) == []
    (pole,) = stable_poles(diagram(*[steady] * MINIMUM_RUN))
    assert (pole.orders, pole.highest_order) == (MINIMUM_RUN, MINIMUM_RUN)


def test_a_pole_whose_damping_wanders_is_not_stable():
    wandering = [[(100.0, 0.01 * 1.2**number)] for number in range(12)]
    assert stable_poles(diagram(*wandering)) == []


def test_heavily_damped_poles_are_no_modes():
    assert stable_poles(diagram(*[[(100.0, 0.5)]] * 12)) == []


def test_a_second_diagram_adds_only_what_the_first_lacks():
    first = diagram(*[[(100.0, 0.01)]] * 8)
    second = diagram(*[[(20.0, 0.02), (100.4, 0.03)]] * 8)
    assert [pole.frequency_hz for pole in stable_poles(first, second)] == [20.0, 100.0]


def test_too_few_lines_are_refused():
    frequency = np.arange(10.0, 400.0, 5.0)
    with pytest.raises(BenchError, match="longer segments"):
        order_poles(accelerance(frequency), frequency, (10.0, 390.0))
