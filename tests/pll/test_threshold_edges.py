"""What thresholds of the loops decide, on either side of each: small cases whose outcome is known by hand."""

from __future__ import annotations

import math
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_pll.amplitude.response_control import ResponseController
from nmt_pll.force_control.force_controller import most_harmonics
from nmt_pll.force_control.gain_estimate import GainEstimate
from nmt_pll.force_control.modal_power_ratio import ModalPowerRatio, check_modes
from nmt_pll.self_excited.self_excited_control import AmplitudeLaw, SelfExcitedPlant


def waits(error: float) -> bool:
    """Whether the target waits where the amplitude is off by so much, in ln."""
    controller = ResponseController()
    controller.start(1.0)
    controller.target = 1.0
    controller.aim(10.0)
    controller.update(2.0, math.exp(-error), 1.0, 1.0, 1.0)
    return controller.target == 1.0


def learnt(gain: float) -> float:
    """What is learnt of a gain over what was known at first, from a clear move."""
    estimate = GainEstimate(1, 1)
    one = np.ones((1, 1), dtype=complex)
    estimate.learn(one[:, :, None], gain * one, np.zeros((1, 1)), np.full((1, 1), 1e-12))
    return round(float(abs(estimate.correction[0, 0])), 4)


def forgotten() -> float:
    """Variance of a gain of which nothing has been learnt for long."""
    estimate = GainEstimate(1, 1)
    estimate.grow(1e9)
    return float(estimate.covariance[0, 0, 0].real)


def linear(modes: int) -> Any:
    return SimpleNamespace(
        frequencies_rad_s=(1.0,) * modes, points=tuple(range(1, modes + 1)), drive_point=1, shape_matrix=np.eye(modes)
    )


def refused(modes: int) -> bool:
    try:
        check_modes(linear(modes), "Here")
    except BenchError:
        return True
    return False


def largest_target() -> float:
    """Target of a harmonic over the fundamental where the drive point hardly moves in it."""
    response = np.array([[1.0, 1e-3], [0.0, 1.0], [0.0, 0.0]], dtype=complex)
    force = np.array([[1.0j, 0.0]], dtype=complex)
    found = ModalPowerRatio(linear(3)).targets(force, response, Quantity.DISPLACEMENT, 1.0)
    return float(abs(found[0, 1]))


def fed() -> float:
    """Rate that feeds a motion which is far too small, times the dead time."""
    control = AmplitudeLaw(SelfExcitedPlant(10.0, 1.0, 1.0, 0.0, 0.5))
    return 0.5 * max(control.update(1.0, 1e30, 0.01) for _ in range(100))


EDGES: dict[str, tuple[Callable[[], Any], Any]] = {
    "pll.amplitude.waiting_error": (lambda: (waits(0.09), waits(0.11)), (False, True)),
    "pll.harmonics.automatic_highest": (lambda: most_harmonics(1.0, 1e4, 1.0), 15),
    "pll.harmonics.initial_gain_std": (lambda: GainEstimate(1, 1).covariance[0, 0, 0].real, pytest.approx(0.3**2)),
    "pll.harmonics.largest_gain_std": (forgotten, pytest.approx(0.5**2)),
    "pll.harmonics.lowest_gain_correction": (lambda: (learnt(0.009), learnt(0.011)), (1.0, 0.011)),
    "pll.harmonics.modal_target_modes": (lambda: (refused(2), refused(3)), (True, False)),
    "pll.harmonics.largest_target_ratio": (largest_target, pytest.approx(0.3)),
    "pll.self_excited.largest_feeding_rate": (fed, pytest.approx(3.0)),
}


@pytest.mark.parametrize("path", EDGES)
def test_a_threshold_decides(path: str) -> None:
    outcome, expected = EDGES[path]
    assert outcome() == expected
