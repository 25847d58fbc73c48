"""A line of the mains beside a decaying mode: it is found and taken out, and nothing is where there is none."""

from __future__ import annotations

import numpy as np
import pytest

from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import FloatArray
from nmt_signals.decays.decay_hum import Hum, without_hum
from nmt_signals.decays.decay_signal import ridges

RATE = 2048.0
TIME = np.arange(int(4.0 * RATE)) / RATE
NOISE = 0.002


def decay(frequency_hz: float, ratio: float = 0.003, hardening: float = 0.0) -> FloatArray:
    """Unit amplitude at first; the frequency falls by ``hardening`` with the square of the amplitude."""
    rate = 2.0 * np.pi * frequency_hz * ratio
    square = np.exp(-2.0 * rate * TIME)
    phase = 2.0 * np.pi * frequency_hz * (TIME + hardening * (1.0 - square) / (2.0 * rate))
    return np.asarray(np.sqrt(square) * np.cos(phase))


def separated(signal: FloatArray, hum: FloatArray, seed: int = 1) -> tuple[FloatArray, tuple[Hum, ...]]:
    """What is taken out of a record of both with noise."""
    samples = signal + hum + NOISE * np.random.default_rng(seed).standard_normal(TIME.size)
    (ridge, *_) = ridges(samples, RATE, Quantity.VELOCITY)
    clean, found = without_hum(samples, RATE, ridge, 1)
    return samples - clean, found


def line(hertz: float, amplitude: float) -> FloatArray:
    return np.asarray(amplitude * np.sin(2.0 * np.pi * hertz * TIME + 1.0))


@pytest.mark.parametrize(
    ("frequency_hz", "hardening", "hertz", "amplitude"),
    [
        (47.0, 0.0, 50.02, 0.002),
        (47.0, 0.02, 49.97, 0.02),
        (49.0, 0.0, 50.0, 0.01),
        (53.0, 0.05, 50.0, 0.01),
        (46.4, 0.26, 50.0, 0.002),
        (49.7, 0.0, 60.0, 0.01),
        (97.0, 0.0, 100.0, 0.005),
    ],
)
def test_a_line_beside_the_mode_is_taken_out(
    frequency_hz: float, hardening: float, hertz: float, amplitude: float
) -> None:
    hum = line(hertz, amplitude)
    taken, found = separated(decay(frequency_hz, hardening=hardening), hum)
    assert [each.frequency_hz for each in found] == pytest.approx([hertz], abs=0.02)
    assert found[0].amplitude == pytest.approx(amplitude, abs=5e-4)
    assert abs(found[0].amplitude - amplitude) < 4.0 * found[0].std < 2e-3
    assert np.std(taken - hum) < 3e-4


@pytest.mark.parametrize("frequency_hz", [47.0, 49.7, 58.0, 133.0])
def test_nothing_is_taken_out_where_there_is_no_line(frequency_hz: float) -> None:
    taken, found = separated(decay(frequency_hz), 0.0 * TIME)
    assert found == ()
    assert not taken.any()


@pytest.mark.parametrize(("frequency_hz", "hardening"), [(49.9, 0.0), (49.0, 0.08), (49.95, 0.4)])
def test_a_line_that_the_mode_meets_is_left(frequency_hz: float, hardening: float) -> None:
    taken, found = separated(decay(frequency_hz, hardening=hardening), line(50.0, 0.01))
    assert found == ()
    assert not taken.any()


def test_a_second_mode_that_decays_there_is_no_line() -> None:
    signal = decay(47.0)
    taken, found = separated(signal + 0.02 * decay(50.0, 0.004), 0.0 * TIME)
    assert found == () or np.std(taken) < NOISE
