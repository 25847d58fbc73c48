"""The levels of the topic monitor against NumPy on the samples themselves."""

from __future__ import annotations

import math

import numpy as np
import pytest

from nmt_core.messages.blocks import OscillatorPhase, SampleBlock
from nmt_core.vocabulary import Quantity
from nmt_plant.signal_levels import LevelMeter


def test_levels_are_those_of_the_last_tenth_of_a_second() -> None:
    rate, length = 1000.0, 20
    rng = np.random.default_rng(1)
    force, response = rng.standard_normal((1, 200)), rng.standard_normal((2, 200))
    meter = LevelMeter(rate, length)
    found = []
    for first in range(0, 200, length):
        phase = OscillatorPhase(0.0, 20.0 + first / 200)
        parts = force[:, first : first + length], response[:, first : first + length]
        levels = meter.add(
            [
                SampleBlock(first, rate, Quantity.ACCELERATION, "m/s^2", ("a1", "a2"), (1, 2), parts[1], phase, 0),
                SampleBlock(first, rate, Quantity.FORCE, "N", ("f2",), (2,), parts[0], phase, 2 if first == 60 else 0),
            ]
        )
        if levels is not None:
            found.append(levels)
    assert [levels.last_sample for levels in found] == [99, 199]
    assert [levels.time_ns for levels in found] == [99_000_000, 199_000_000]
    assert [levels.flags for levels in found] == [2, 0]
    newest = found[-1]
    assert newest.frequency_hz == pytest.approx(20.9)
    assert newest.channels == "f2, a1, a2"
    last = np.vstack([force, response])[:, 100:]
    assert newest.peak == pytest.approx(np.abs(last).max(axis=1))
    assert newest.rms == pytest.approx(np.linalg.norm(last, axis=1) / 10.0)
    pairs = dict(zip(list(Quantity)[1:], newest.drive_point, strict=True))
    assert pairs[Quantity.FORCE] == pytest.approx((newest.peak[0], newest.rms[0]))
    assert pairs[Quantity.ACCELERATION] == pytest.approx((newest.peak[2], newest.rms[2]))  # of the driven point
    assert all(math.isnan(value) for value in pairs[Quantity.DISPLACEMENT])


def test_a_stretch_with_lost_samples_has_no_levels_and_spoils_no_others() -> None:
    phase = OscillatorPhase(0.0, 20.0, 0.0)

    def stretch(first: int, value: float) -> list[SampleBlock]:
        return [SampleBlock(first, 100.0, Quantity.FORCE, "N", ("f2",), (2,), np.full((1, 5), value), phase, 0)]

    meter = LevelMeter(100.0, 5)
    assert meter.add(stretch(0, 3.0)) is None
    levels = meter.add([])
    assert levels is not None
    assert (levels.last_sample, levels.peak[0]) == (4, 3.0)
    assert meter.add([]) is None
    assert meter.add([]) is None, "nothing was measured"
    assert meter.add([]) is None
    levels = meter.add(stretch(25, 2.0))
    assert levels is not None
    assert (levels.last_sample, levels.peak[0]) == (29, 2.0)
