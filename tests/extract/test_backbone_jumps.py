"""Jumps of a backbone are named, and nothing else is."""

from __future__ import annotations

import math

import numpy as np
import pytest

from nmt_core.messages.modal_point import ModalPoint
from nmt_core.vocabulary import PointStatus
from nmt_extract.curves.backbone_jumps import direction_difference, find_jumps


def point(index: int, level: float, frequency_hz: float, std: float = 1e-6) -> ModalPoint:
    status = PointStatus.OK if math.isfinite(frequency_hz) else PointStatus.NOT_LOCKED
    return ModalPoint(
        index, status, "", level, "m", frequency_hz=frequency_hz, frequency_hz_std=std * frequency_hz, force_n=1.0
    )


def backbone(levels, frequency, std: float = 1e-6) -> list[ModalPoint]:
    return [point(index, level, frequency(level), std) for index, level in enumerate(levels)]


def steep(level: float) -> float:
    return 20.0 * (1.0 + 0.02 * np.tanh(3.0 * np.log(level)))


@pytest.mark.parametrize("step", [1.1, 1.3, 1.6])
@pytest.mark.parametrize(
    "frequency", [lambda a: 20.0 * (1.0 + 0.05 * a**2), lambda a: 20.0 - a**0.5, steep], ids=["cubic", "slip", "steep"]
)
def test_a_smooth_backbone_has_no_jump(frequency, step):
    levels = [0.1 * step**k for k in range(round(math.log(100.0) / math.log(step)))]
    assert find_jumps(backbone(levels, frequency)) == []


@pytest.mark.parametrize("direction", [1, -1])
def test_a_jump_is_named_with_its_levels_and_size(direction):
    levels = list(np.geomspace(0.5, 2.0, 15))[::direction]
    (jump,) = find_jumps(backbone(levels, lambda a: 20.0 + 0.1 * a + (0.2 if a > 1.02 else 0.0)))
    low, high = sorted((jump.before.level, jump.after.level))
    assert low < 1.02 < high
    assert abs(jump.size) == pytest.approx(0.01, rel=0.05)
    assert "jumps between" in jump.sentence


def test_levels_without_lock_in_a_jump_are_named():
    def frequency(level: float) -> float:
        return math.nan if 1.0 < level < 1.1 else 20.0 + (0.2 if level > 1.02 else 0.0)

    (jump,) = find_jumps(backbone([0.7, 0.8, 0.9, 0.95, 1.05, 1.2, 1.3, 1.4], frequency))
    assert jump.lost == (1.05,)
    assert jump.sentence.endswith("no lock at 1.05.")


def test_noise_is_no_jump():
    rng = np.random.default_rng(3)
    points = backbone(np.geomspace(0.1, 10.0, 40), lambda a: 20.0 * (1.0 + 1e-4 * rng.standard_normal()), 1e-4)
    assert find_jumps(points) == []


def test_up_and_down_are_compared_level_by_level():
    up = [0.5, 0.7, 1.0, 1.4, 2.0]
    levels = [*up, *up[-2::-1]]

    def frequency(place: int) -> float:
        level = levels[place]
        return 20.0 + level + (0.3 if level == 1.4 and place > 4 else 0.0)

    points = [point(place, level, frequency(place)) for place, level in enumerate(levels)]
    difference = direction_difference(points)
    assert difference is not None
    assert difference.levels == 4
    assert difference.largest == 0.0
    assert [item[0] for item in difference.different] == [1.4]
    assert difference.sentence.endswith("from 1.4 to 1.4 m they differ by up to 1.4 %: a fold.")
    assert direction_difference(points[:5]) is None
