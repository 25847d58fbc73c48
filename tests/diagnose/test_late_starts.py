"""Delays that phases of frequency responses tell, on a model whose phases are known."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from nmt_diagnose.inference.late_starts import late_starts
from nmt_diagnose.observations.conditions import RandomTest
from nmt_diagnose.observations.observables import Observations, Part

FREQUENCIES = np.linspace(30.0, 900.0, 117)
CHANNELS = 3


def observations() -> Observations:
    """Rows of the phases, and of the magnitudes, of three responses of one random test."""
    test = object.__new__(RandomTest)
    frequency = np.tile(FREQUENCIES, 2 * CHANNELS)
    part = np.repeat([Part.PHASE, Part.LOG_MAGNITUDE], CHANNELS * FREQUENCIES.size)
    rows = SimpleNamespace(test=np.zeros(part.size, dtype=int), part=part, frequency_hz=frequency)
    return cast(Observations, cast(Any, SimpleNamespace(tests=(test,), rows=rows)))


def slopes(seconds: float) -> list[np.ndarray]:
    """Of a delay of each channel, and of all of them; a unit of strength is so many seconds."""
    found = []
    for late in ([0], [1], [2], [0, 1, 2]):
        phase = np.zeros((CHANNELS, FREQUENCIES.size))
        phase[late] = -2.0 * np.pi * FREQUENCIES * seconds
        found.append(np.concatenate([phase.ravel(), np.zeros(phase.size)]))
    return found


def difference(delays: list[float], seed: int = 3) -> np.ndarray:
    """Measured minus predicted phase: delays, and a resonance that lies beside its place in every channel."""
    generator = np.random.default_rng(seed)
    moved = np.where(np.abs(FREQUENCIES - 300.0) < 60.0, -2.5, 0.0)
    phase = np.array([-2.0 * np.pi * FREQUENCIES * delay + moved for delay in delays])
    phase += 0.1 * generator.standard_normal(phase.shape)
    phase = (phase + np.pi) % (2.0 * np.pi) - np.pi
    return np.concatenate([phase.ravel(), generator.standard_normal(phase.size)])


@pytest.mark.parametrize("delay", [-4e-3, 1.57e-3, 9e-3])
def test_the_late_channel_and_its_delay_are_found(delay: float) -> None:
    found = late_starts(observations(), difference([0.0, delay, 0.0]), slopes(2e-5), 3)
    assert found[0][0] == 1
    assert found[0][1] * 2e-5 == pytest.approx(delay, abs=1e-4)


def test_channels_that_are_late_together_come_before_each_alone() -> None:
    found = late_starts(observations(), difference([8e-4, 8e-4, 8e-4]), slopes(2e-5), 3)
    assert found[0][0] == 3
    assert found[0][1] * 2e-5 == pytest.approx(8e-4, abs=1e-4)
    assert len(found) == 3


def test_a_small_delay_needs_no_start() -> None:
    assert late_starts(observations(), difference([0.0, 5e-5, 0.0]), slopes(2e-5), 3) == []
