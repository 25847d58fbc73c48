"""Sample blocks and the oscillator's phase."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from nmt_core.messages.blocks import SAMPLE_TOPICS, UNKNOWN_PHASE, BlockFlag, OscillatorPhase, Quantity, SampleBlock


def block(first: int = 400, samples: int = 200) -> SampleBlock:
    phase = OscillatorPhase(0.5, 20.0)
    return SampleBlock(first, 1e4, Quantity.FORCE, "N", ("f2", "f4"), (2, 4), np.zeros((2, samples)), phase)


def test_samples_and_end():
    assert block().samples == 200
    assert block().end_sample == 600
    assert block(0, 1).end_sample == 1


def test_a_block_without_a_phase_says_so():
    plain = SampleBlock(0, 1e4, Quantity.VOLTAGE, "V", ("u",), (0,), np.zeros((1, 4)))
    assert plain.oscillator is UNKNOWN_PHASE
    assert np.isnan(plain.oscillator.cycles)
    assert plain.flags == BlockFlag.NONE


def test_phase_of_a_steady_sine():
    phase = OscillatorPhase(0.25, 50.0).phase(5, 200.0)
    np.testing.assert_allclose(phase, 2 * np.pi * np.array([0.25, 0.5, 0.75, 1.0, 1.25]))


def test_phase_of_a_sweep_is_the_integral_of_its_frequency():
    rate, samples = 1e4, 400
    phase = OscillatorPhase(0.1, 30.0, 8.0).phase(samples, rate)
    time = np.arange(samples) / rate
    frequency = 30.0 + 8.0 * time
    steps = 0.5 * (frequency[1:] + frequency[:-1]) / rate  # exact for a linear integrand
    expected = 2 * np.pi * (0.1 + np.concatenate([[0.0], np.cumsum(steps)]))
    np.testing.assert_allclose(phase, expected, rtol=1e-12)


@given(st.floats(0.0, 0.999), st.floats(0.1, 500.0), st.floats(-50.0, 50.0), st.integers(1, 300))
def test_phase_goes_on_in_the_next_block(cycles, frequency, rate_hz_s, samples):
    sample_rate = 1e4
    whole = OscillatorPhase(cycles, frequency, rate_hz_s).phase(2 * samples, sample_rate)
    duration = samples / sample_rate
    moved = cycles + duration * (frequency + 0.5 * rate_hz_s * duration)
    later = OscillatorPhase(moved, frequency + rate_hz_s * duration, rate_hz_s)
    np.testing.assert_allclose(later.phase(samples, sample_rate), whole[samples:], atol=1e-9)


def test_units_and_topics():
    units = {"FORCE": "N", "DISPLACEMENT": "m", "VELOCITY": "m/s", "ACCELERATION": "m/s^2", "VOLTAGE": "V"}
    assert {name: Quantity[name].unit for name in units} == units
    assert Quantity.CURRENT.unit == "A"
    assert Quantity.UNKNOWN.unit == ""
    assert Quantity.ACCELERATION.topic == "acceleration"
    assert SAMPLE_TOPICS == ("force", "displacement", "velocity", "acceleration", "voltage", "current")


def test_the_channel_at_a_point_alone():
    data = np.arange(6.0).reshape(3, 2)
    phase = OscillatorPhase(0.25, 20.0, 0.0)
    block = SampleBlock(40, 1e3, Quantity.ACCELERATION, "m/s^2", ("a", "b", "c"), (3, 7, 7), data, phase, 2)
    alone = block.at_point(7)
    assert (alone.channels, alone.points) == (("b",), (7,))
    assert alone.data.tolist() == [[2.0, 3.0]]
    assert (alone.first_sample, alone.sample_rate, alone.quantity, alone.unit) == (40, 1e3, block.quantity, "m/s^2")
    assert (alone.oscillator, alone.flags) == (phase, 2)
    assert block.at_point(5) is block  # the loop says that it has no such channel
    assert alone.at_point(9) is alone  # one channel is the drive point's
