"""The ratio of force harmonics that modal power needs, against power counted mode by mode."""

from __future__ import annotations

import numpy as np
import pytest

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_core.messages.linear_description import LinearDescription
from nmt_pll.force_control.modal_power_ratio import ModalPowerRatio, check_modes
from nmt_pll.thresholds import HARMONICS

POINTS = (2, 4, 5, 6)
SHAPES = np.array([[0.4, 1.6, 2.6], [1.3, 2.5, -0.6], [1.9, 0.9, -2.3], [2.5, -1.3, 0.4]])  # 1/√kg
OMEGA = 140.0


def description(modes=3, points=POINTS, drive=2) -> LinearDescription:
    shapes = tuple(map(tuple, SHAPES[: len(points), :modes].tolist()))
    return LinearDescription(
        "test", drive, 0, points, (140.0, 760.0, 2050.0)[:modes], (0.005,) * modes, shapes, 0.4, 140.0, 0.02, 0.043
    )


def motion(order: int = 5, seed: int = 3) -> tuple[np.ndarray, np.ndarray]:
    """Modal coordinates (3, H) and displacements (4, H), harmonics falling with their order."""
    rng = np.random.default_rng(seed)
    modal = rng.normal(size=(3, order)) + 1j * rng.normal(size=(3, order))
    modal *= np.array([1.0, 0.0, 0.01, 0.0, 0.004])[:order] * np.array([[1.0], [0.1], [0.03]])
    return modal, SHAPES @ modal


def harmonics(ratio, force, response, quantity):
    """F_2* … F_H* after a second."""
    return ratio.targets(force[None, :], response, quantity, 1.0)[0, 1:]


FACTOR = {Quantity.DISPLACEMENT: 0, Quantity.VELOCITY: 1, Quantity.ACCELERATION: 2}


@pytest.mark.parametrize("quantity", FACTOR)
def test_each_harmonic_gets_the_power_that_the_mode_needs(quantity):
    modal, displacement = motion()
    order = np.arange(1, 6)
    velocity = 1j * order * OMEGA * displacement[0]
    force = np.array([0.7 * np.exp(1j * np.angle(velocity[0])), 0.01, 0.02j, 0.0, 0.03])
    response = displacement * (1j * order * OMEGA) ** FACTOR[quantity]
    target = harmonics(ModalPowerRatio(description()), force, response, quantity)
    # ξ from the fundamental, then what it asks of each harmonic: ½ ξ (nω)² Σ |η_j|²
    xi = (force[0] * velocity[0].conj()).real / (OMEGA**2 * np.sum(np.abs(modal[:, 0]) ** 2))
    for n in (3, 5):
        wanted = 0.5 * xi * (n * OMEGA) ** 2 * np.sum(np.abs(modal[:, n - 1]) ** 2)
        given = 0.5 * target[n - 2] * velocity[n - 1].conj()
        assert given.real == pytest.approx(wanted, rel=1e-9)
        assert abs(given.imag) < 1e-9 * wanted  # of all forces with that power the smallest
    assert np.abs(target[[0, 2]]).max() < 1e-12


def test_one_mode_alone_gets_the_force_that_its_own_damping_asks_for():
    """Where all harmonics move in one mode, the force is in proportion to velocity, harmonic by harmonic."""
    modal = np.zeros((3, 5), complex)
    modal[0] = [1e-3, 2e-6j, 3e-5, 0.0, 1e-5 * (1 + 1j)]
    displacement = SHAPES @ modal
    velocity = 1j * np.arange(1, 6) * displacement[0]
    force = np.zeros(5, complex)
    force[0] = 2.0 * velocity[0]
    target = harmonics(ModalPowerRatio(description()), force, displacement, Quantity.DISPLACEMENT)
    np.testing.assert_allclose(target, 2.0 * velocity[1:], rtol=1e-9, atol=1e-15)


def test_a_drive_point_that_does_not_move_gets_a_bounded_force():
    modal, displacement = motion()
    displacement[0, 2] = 1e-12
    force = np.array([0.7j, 0, 0, 0, 0]) * np.exp(1j * np.angle(displacement[0, 0]))
    target = harmonics(ModalPowerRatio(description()), force, displacement, Quantity.DISPLACEMENT)
    assert abs(target[1]) == pytest.approx(HARMONICS.largest_target_ratio * 0.7)
    assert modal.size


def test_the_ratio_follows_slowly_and_is_zero_against_the_power():
    _, displacement = motion()
    force = np.array([0.7j, 0, 0, 0, 0]) * np.exp(1j * np.angle(displacement[0, 0]))
    at_once = harmonics(ModalPowerRatio(description()), force, displacement, Quantity.DISPLACEMENT)
    slow = ModalPowerRatio(description(), 0.1)
    first = harmonics(slow, force, displacement, Quantity.DISPLACEMENT)
    np.testing.assert_allclose(first, 0.1 * at_once, atol=1e-15)
    for _ in range(200):
        last = harmonics(slow, force, displacement, Quantity.DISPLACEMENT)
    np.testing.assert_allclose(last, at_once, rtol=1e-6, atol=1e-12)
    slow.clear()
    np.testing.assert_allclose(harmonics(slow, force, displacement, Quantity.DISPLACEMENT), first, atol=1e-15)
    assert (harmonics(ModalPowerRatio(description()), -force, displacement, Quantity.DISPLACEMENT) == 0).all()


@pytest.mark.parametrize(
    ("linear", "words"),
    [
        (description(modes=2), "needs a linear description of 3 modes, this one has 2"),
        (description(points=(2, 4)), "needs responses at 3 points"),
        (description(drive=3), "one of them the drive point 3"),
    ],
)
def test_too_few_modes_or_points_are_refused(linear, words):
    with pytest.raises(BenchError, match=words):
        check_modes(linear, "Level 0")
