"""Lines of the mains in a record without excitation."""

from __future__ import annotations

import numpy as np
import pytest

from nmt_signals.channel_faults.mains_lines import MAINS_HZ, mains_line

RATE = 5_000.0
TIME = np.arange(20_000) / RATE
NOISE = 2e-4


def silence(seed: int, amplitude: float = 0.0, line_hz: float = 50.0) -> np.ndarray:
    """Two channels of noise with an offset; the first one carries the mains."""
    data = NOISE * np.random.default_rng(seed).standard_normal((2, TIME.size)) + np.array([[0.3], [-0.1]])
    data[0] += amplitude * np.cos(2.0 * np.pi * line_hz * TIME + 0.7)
    return data


@pytest.mark.parametrize("line_hz", MAINS_HZ)
def test_a_line_has_its_amplitude_in_the_channel_that_carries_it(line_hz: float) -> None:
    line = mains_line(None, silence(1, 5e-3, line_hz), RATE, 0, line_hz)
    assert line is not None
    assert line.amplitudes[0] == pytest.approx(5e-3, rel=2e-3)
    assert abs(line.amplitudes[1]) < 1e-5
    other = next(hz for hz in MAINS_HZ if hz != line_hz)
    elsewhere = mains_line(None, silence(1, 5e-3, line_hz), RATE, 0, other)
    assert elsewhere is not None
    assert abs(elsewhere.amplitudes[0]) < 1e-5


def test_without_a_line_the_amplitude_scatters_about_zero_by_its_uncertainty() -> None:
    found = [mains_line(None, silence(seed), RATE, 0, 50.0) for seed in range(60)]
    scores = np.concatenate([line.amplitudes / line.std for line in found if line is not None])
    assert scores.size == 120
    assert abs(np.mean(scores)) < 0.3
    assert 0.8 < np.sqrt(np.mean(scores**2)) < 1.25


def test_of_a_record_that_is_too_short_nothing_is_said() -> None:
    assert mains_line(None, silence(1)[:, :0], RATE, 0, 50.0) is None
    assert mains_line(None, silence(1)[:, :200], RATE, 0, 50.0) is None
    assert mains_line(None, silence(1), 90.0, 0, 50.0) is None  # above half the rate
