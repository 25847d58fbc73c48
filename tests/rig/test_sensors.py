"""Sensors: gain, noise level and reproducibility, converter."""

from __future__ import annotations

import numpy as np
import pytest

from nmt_core.messages.blocks import Quantity
from nmt_rig.sensors import Sensor, SensorChannel

RATE = 10_000.0


def channel(**settings):
    return SensorChannel(Sensor("f2", Quantity.FORCE, 2, **settings), RATE, seed=7)


def test_noise_has_the_variance_of_its_density_and_the_snr_of_the_paper():
    values, _ = channel(noise_psd=2e-9, noise_correlation_time=1e-5).measure(np.zeros(100_000))
    assert np.var(values) == pytest.approx(2e-9 / 1e-5, rel=0.03)
    # The paper's table: 14.5 dB at the lowest level, whose force amplitude is about 0.1 N.
    assert 10 * np.log10(0.5 * 0.1**2 / np.var(values)) == pytest.approx(14.5, abs=1.0)


@pytest.mark.parametrize("held", [0.0, 1e-5, 1e-4, 2.5e-4, 1e-3])
def test_noise_does_not_depend_on_the_block_length(held):
    outcome = []
    for lengths in ([1000], [200] * 5, [1] * 10 + [7, 983]):
        c = channel(noise_psd=1e-6, noise_correlation_time=held)
        outcome.append(np.concatenate([c.measure(np.zeros(n))[0] for n in lengths]))
    assert np.array_equal(outcome[0], outcome[1])
    assert np.array_equal(outcome[0], outcome[2])


def test_long_correlation_holds_values():
    values, _ = channel(noise_psd=1e-6, noise_correlation_time=1e-3).measure(np.zeros(1000))
    assert len(np.unique(values)) == 100
    assert np.all(values[:10] == values[0])


def test_channels_are_independent_of_each_other():
    a = SensorChannel(Sensor("x2", Quantity.DISPLACEMENT, 2, noise_psd=1.0), RATE, 7).measure(np.zeros(5000))[0]
    b = SensorChannel(Sensor("x4", Quantity.DISPLACEMENT, 4, noise_psd=1.0), RATE, 7).measure(np.zeros(5000))[0]
    assert abs(np.corrcoef(a, b)[0, 1]) < 0.06


def test_gain_and_converter():
    values, overload = channel(gain=2.0, adc_range=1.0, adc_bits=3).measure(np.array([0.1, -0.2, 0.49]))
    np.testing.assert_allclose(values, [0.25, -0.5, 1.0])
    assert not overload
    values, overload = channel(adc_range=1.0).measure(np.array([0.0, -3.0]))
    np.testing.assert_allclose(values, [0.0, -1.0])
    assert overload
