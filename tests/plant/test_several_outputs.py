"""Several outputs of one oscillator: terms, ramps, noise, and one guard that stops them all."""

from __future__ import annotations

import numpy as np
import pytest

from nmt_core.errors import BenchError
from nmt_core.messages.records import DriveCommand, DriveTerm
from nmt_core.vocabulary import Quantity, Waveform
from nmt_plant.devices.simulated_rig import SimulatedRig
from nmt_plant.oscillator import Oscillator
from nmt_rig.rig import load_rig

RATE = 10_000.0
TERMS = (DriveTerm(1, 3, 0.1j), DriveTerm(2, 1, 0.8 * np.exp(0.7j)), DriveTerm(2, 5, -0.05 + 0.02j))


def sine(amplitude=1.0, ramp=0.0, terms=TERMS, frequency=50.0):
    return DriveCommand(Waveform.SINE, frequency, amplitude, ramp, terms=terms)


def expected(amplitude, theta, terms=TERMS):
    own = {1: np.cos(theta), 2: np.zeros(theta.size)}
    for exciter, order, ratio, _ in terms:
        own[exciter] = own[exciter] + (ratio * np.exp(1j * order * theta)).real
    return amplitude * own[1], amplitude * own[2]


def test_every_output_is_the_amplitude_times_its_terms():
    oscillator = Oscillator(RATE, exciters=2)
    oscillator.apply(sine(2.0))
    block = oscillator.block(200)
    first, second = expected(2.0, 2 * np.pi * 50.0 * np.arange(201) / RATE)
    np.testing.assert_allclose(block.voltage, first, atol=1e-12)
    np.testing.assert_allclose(block.voltages[1], second, atol=1e-12)


def test_ratios_change_without_a_step_and_ramps_take_all_outputs_along():
    oscillator = Oscillator(RATE, exciters=2)
    oscillator.apply(sine())
    before = oscillator.block(200)
    oscillator.apply(sine(terms=(DriveTerm(2, 1, -0.9),)))
    change = oscillator.block(200)
    assert change.voltages[1][0] == pytest.approx(before.voltages[1][-1], abs=1e-12)
    assert np.abs(np.diff(change.voltages[1])).max() < 0.05
    after = oscillator.block(200)
    np.testing.assert_allclose(after.voltages[1], -0.9 * after.voltage, atol=1e-12)
    oscillator.apply(DriveCommand(Waveform.OFF, ramp=0.04))
    for _ in range(2):
        block = oscillator.block(200)
        np.testing.assert_allclose(block.voltages[1], -0.9 * block.voltage, atol=1e-12)
    assert oscillator.is_quiet
    assert block.voltages[1][-1] == 0.0


def test_a_ratio_that_drifts_puts_no_line_at_the_block_rate_into_the_voltage():
    """Against a voltage whose ratio grows with time, sample by sample."""
    oscillator, block = Oscillator(RATE, exciters=2), 200
    blocks, frequency = 50, 83.0
    voltage = []
    for number in range(blocks + 1):
        oscillator.apply(sine(terms=(DriveTerm(2, 1, 0.5 + 0.01 * number),), frequency=frequency))
        voltage.append(oscillator.block(block).voltages[1][:-1])
    drifting = np.concatenate(voltage[1:])
    time = np.arange(blocks * block)
    ratio = 0.5 + 0.01 * time / block
    np.testing.assert_allclose(drifting, ratio * np.cos(2 * np.pi * frequency * (time + block) / RATE), atol=1e-9)


def test_the_first_output_is_the_same_whatever_others_there_are():
    alone, first = Oscillator(RATE, seed=4), Oscillator(RATE, seed=4, exciters=3)
    for command in (
        DriveCommand(Waveform.SINE, 41.0, 1.5, 0.1, terms=(DriveTerm(1, 3, 0.1 + 0.2j, False),)),
        DriveCommand(Waveform.RANDOM, amplitude=0.5, band_low_hz=20.0, band_high_hz=300.0),
    ):
        alone.apply(command)
        first.apply(command)
        for _ in range(4):
            one, many = alone.block(100), first.block(100)
            assert np.array_equal(one.voltage, many.voltage)
            assert not many.voltages[1:].any()


def test_random_outputs_are_uncorrelated():
    oscillator = Oscillator(RATE, seed=4, exciters=2)
    oscillator.apply(
        DriveCommand(
            Waveform.RANDOM, amplitude=0.5, band_low_hz=50.0, band_high_hz=2000.0, terms=(DriveTerm(2, 1, 0.6),)
        )
    )
    blocks = [oscillator.block(1000) for _ in range(100)]
    one = np.concatenate([block.voltage[:-1] for block in blocks])
    two = np.concatenate([block.voltages[1][:-1] for block in blocks])
    assert two.std() == pytest.approx(0.6 * one.std(), rel=0.05)
    assert abs(np.corrcoef(one, two)[0, 1]) < 0.02


def started(*changes):
    device = SimulatedRig(load_rig("frame", ["block_samples=50", *changes]))
    device.configure()
    device.start()
    return device


def voltages(blocks):
    return next(block.data for block in blocks if block.quantity is Quantity.VOLTAGE)


def test_what_is_put_out_is_measured_at_every_exciter():
    device = started()
    device.write(sine(0.02))
    measured = np.concatenate([voltages(device.read()) for _ in range(4)], axis=1)
    first, second = expected(0.02, 2 * np.pi * 50.0 * np.arange(200) / RATE)
    np.testing.assert_allclose(measured[:, 50:], np.array([first, second])[:, 50:], atol=1e-9)


@pytest.mark.parametrize(
    ("terms", "words"),
    [
        ((DriveTerm(2, 1, 60.0),), "beyond the voltage limit"),
        ((DriveTerm(3, 1, 0.1),), "exciter 3, but there are 2"),
        ((DriveTerm(1, 1, 0.1),), "is not a term"),
        ((DriveTerm(2, 150, 0.1),), "half the sample rate"),
        ((DriveTerm(2, 1, float("nan")),), "must be finite"),
    ],
)
def test_terms_beyond_what_can_be_are_refused(terms, words):
    device = started()
    with pytest.raises(BenchError, match=words):
        device.write(sine(1.0, terms=terms))


def test_a_limit_at_the_second_exciter_takes_all_outputs_to_zero():
    device = started("limits.force_n=1.0", "limits.rise_from_v=50")
    device.write(sine(0.05, terms=(DriveTerm(2, 1, 20.0),), frequency=180.0))
    seen = []
    for _ in range(80):
        seen.append(voltages(device.read()))
        if device.tripped and device.is_quiet:
            break
    assert "force limit: f2" in device.tripped
    data = np.concatenate(seen, axis=1)
    assert device.is_quiet
    assert not voltages(device.read()).any()
    # Along a ramp of 0.1 s, without a step.
    assert np.abs(np.diff(data[1])).max() < 1.0 * 2 * np.pi * 180.0 / RATE * 1.2


def test_quiet_takes_every_output_to_zero_along_one_ramp():
    device = started()
    device.write(sine(0.5, terms=(DriveTerm(2, 1, 1.0),)))
    for _ in range(10):
        device.read()
    device.quiet("test")
    blocks = []
    while not device.is_quiet:
        blocks.append(voltages(device.read()))
    data = np.concatenate([*blocks, voltages(device.read())], axis=1)
    np.testing.assert_allclose(data[0], data[1], atol=1e-12)
    assert not data[:, -1].any()
    assert 900 <= data.shape[1] <= 1100
