"""Oscillator: continuous phase, ramps, sweep, random, and independence of the block length."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from nmt_core.errors import BenchError
from nmt_core.messages.records import DriveCommand, DriveTerm
from nmt_core.vocabulary import Waveform
from nmt_plant.devices.device import check_drive
from nmt_plant.oscillator import BandNoise, Oscillator

RATE = 10_000.0


def sine(frequency, amplitude=1.0, ramp=0.0, **more):
    return DriveCommand(Waveform.SINE, frequency, amplitude, ramp, **more)


def test_phase_is_continuous_over_frequency_steps():
    oscillator = Oscillator(RATE)
    expected, total = 0.0, []
    for frequency in (20.0, 22.5, 21.1, 370.0):
        oscillator.apply(sine(frequency))
        block = oscillator.block(200)
        assert block.phase.cycles == pytest.approx(expected % 1.0, abs=1e-12)
        assert 0.0 <= block.phase.cycles < 1.0
        k = np.arange(201)
        np.testing.assert_allclose(block.voltage, np.cos(2 * np.pi * (expected + frequency * k / RATE)), atol=1e-9)
        expected += frequency * 200 / RATE
        total.append(block.voltage)
    for before, after in pairwise(total):
        assert before[-1] == pytest.approx(after[0], abs=1e-9)


def test_ramp_is_a_half_cosine_that_repeated_commands_do_not_restart():
    oscillator = Oscillator(RATE)
    levels = []
    for _ in range(6):
        oscillator.apply(sine(25.0, 2.0, 0.1))
        levels.append(oscillator.amplitude)
        oscillator.block(200)
    expected = [2.0 * 0.5 * (1 - np.cos(np.pi * min(200 * n / 1000, 1.0))) for n in range(6)]
    np.testing.assert_allclose(levels, expected, atol=1e-12)


def test_off_ramps_down_and_becomes_quiet():
    oscillator = Oscillator(RATE)
    oscillator.apply(sine(25.0, 1.0, terms=(DriveTerm(1, 3, 0.2 + 0.1j, False),)))
    oscillator.block(200)
    oscillator.apply(DriveCommand(Waveform.OFF, ramp=0.04))
    assert not oscillator.is_quiet
    oscillator.block(200)
    assert oscillator.amplitude == pytest.approx(0.5)
    oscillator.block(200)
    assert oscillator.is_quiet
    assert np.all(oscillator.block(200).voltage == 0.0)


def test_no_slow_ramp_to_zero_keeps_a_fast_one_waiting():
    oscillator = Oscillator(RATE)
    oscillator.apply(sine(25.0, 1.0, terms=(DriveTerm(1, 3, 0.2 + 0.1j, False),)))
    oscillator.block(200)
    oscillator.apply(DriveCommand(Waveform.OFF, ramp=3600.0))
    oscillator.block(200)
    oscillator.ramp_to_zero(0.04)
    assert not oscillator.is_quiet
    oscillator.block(200)
    assert oscillator.amplitude == pytest.approx(0.5, abs=1e-6)
    oscillator.ramp_to_zero(0.04)  # the same again, as a tripped device asks for it every block
    oscillator.block(200)
    assert oscillator.is_quiet


def test_harmonics_that_change_do_so_along_a_half_cosine_of_one_block():
    oscillator = Oscillator(RATE)
    oscillator.apply(sine(50.0, 1.0, terms=(DriveTerm(1, 3, 0.5j, False), DriveTerm(1, 5, 0.2, False))))
    oscillator.block(200)
    oscillator.apply(
        sine(50.0, 1.0, terms=(DriveTerm(1, 3, -0.3, False), DriveTerm(1, 4, 0.1j, False)))
    )  # the fifth is no longer asked for
    assert oscillator.bound(200) >= 1.0 + 0.5 + 0.2 + 0.1
    blocks = [oscillator.block(200) for _ in range(2)]
    fade = 0.5 - 0.5 * np.cos(np.pi * np.arange(201) / 200)
    theta = blocks[0].phase.phase(201, RATE)
    amplitudes = {3: 0.5j + (-0.3 - 0.5j) * fade, 4: 0.1j * fade, 5: 0.2 * (1.0 - fade)}
    expected = np.cos(theta) + sum((value * np.exp(1j * n * theta)).real for n, value in amplitudes.items())
    np.testing.assert_allclose(blocks[0].voltage, expected, atol=1e-12)
    theta = blocks[1].phase.phase(201, RATE)
    steady = np.cos(theta) + (-0.3 * np.exp(3j * theta) + 0.1j * np.exp(4j * theta)).real
    np.testing.assert_allclose(blocks[1].voltage, steady, atol=1e-12)
    assert blocks[0].voltage[-1] == pytest.approx(blocks[1].voltage[0], abs=1e-12)


def test_harmonics_are_relative_to_the_phase():
    oscillator = Oscillator(RATE)
    oscillator.apply(sine(50.0, 1.0, terms=(DriveTerm(1, 3, 0.5j, False),)))
    block = oscillator.block(200)
    theta = block.phase.phase(201, RATE)
    np.testing.assert_allclose(block.voltage, np.cos(theta) - 0.5 * np.sin(3 * theta), atol=1e-12)


def test_sweep_holds_at_its_end():
    oscillator = Oscillator(RATE)
    command = DriveCommand(Waveform.SWEEP, 20.0, 1.0, rate_hz_s=50.0, frequency_end_hz=21.7)
    oscillator.apply(command)
    frequencies = []
    last = None
    for _ in range(4):
        block = oscillator.block(200)
        if last is not None:
            assert block.voltage[0] == pytest.approx(last, abs=1e-9)
        last = block.voltage[-1]
        frequencies.append(block.phase.frequency_hz)
    assert frequencies == pytest.approx([20.0, 21.0, 21.7, 21.7])


@pytest.mark.parametrize("waveform", ["sine", "random", "sweep"])
def test_blocks_of_any_length_agree(waveform):
    commands = {
        "sine": sine(23.0, 1.0, 0.013),
        "random": DriveCommand(Waveform.RANDOM, amplitude=1.0, band_low_hz=10.0, band_high_hz=500.0),
        "sweep": DriveCommand(Waveform.SWEEP, 20.0, 1.0, rate_hz_s=5.0, frequency_end_hz=900.0),
    }
    outcome = []
    for lengths in ([600], [200] * 3, [1, 99, 500]):
        oscillator = Oscillator(RATE, seed=3)
        oscillator.apply(commands[waveform])
        outcome.append(np.concatenate([oscillator.block(n).voltage[:-1] for n in lengths]))
    for other in outcome[1:]:
        np.testing.assert_allclose(other, outcome[0], atol=1e-10)


def test_the_bound_is_the_largest_amplitude_of_the_block_to_come():
    rng = np.random.default_rng(5)
    oscillator = Oscillator(RATE)
    for _ in range(60):
        terms = (DriveTerm(1, 3, complex(rng.normal(), rng.normal()), False),) if rng.random() < 0.5 else ()
        oscillator.apply(sine(40.0, rng.uniform(0.0, 3.0), float(rng.choice([0.0, 0.013, 0.1])), terms=terms))
        for _ in range(3):
            bound = oscillator.bound(250)
            output = oscillator.block(250).voltage[:-1]
            assert np.abs(output).max() <= bound * (1 + 1e-12)
            if not terms and oscillator.amplitude == bound:
                assert np.abs(output).max() == pytest.approx(bound, rel=1e-2), "a whole period of a settled sine"
            assert oscillator.bound(250) >= oscillator.amplitude


def test_random_has_its_rms_and_band():
    noise = BandNoise(50.0, 500.0, RATE, np.random.Generator(np.random.PCG64(1)))
    values = noise.values(200_000)[:-1]
    assert np.std(values) == pytest.approx(1.0, rel=0.02)
    spectrum = np.abs(np.fft.rfft(values)) ** 2
    frequency = np.fft.rfftfreq(values.size, 1 / RATE)
    inside = spectrum[(frequency > 25) & (frequency < 1000)].sum() / spectrum.sum()
    assert inside > 0.99


@pytest.mark.parametrize(
    "command",
    [
        {"waveform": Waveform.UNKNOWN},
        {"waveform": Waveform.SINE, "frequency_hz": 0.0},
        {"waveform": Waveform.SINE, "frequency_hz": float("nan")},
        {"waveform": Waveform.SINE, "frequency_hz": 10.0, "amplitude": -1.0},
        {"waveform": Waveform.RANDOM, "amplitude": 1.0},
        {"waveform": Waveform.SWEEP, "frequency_hz": 10.0, "rate_hz_s": -1.0, "frequency_end_hz": 20.0},
        {"waveform": Waveform.SINE, "frequency_hz": 10.0, "terms": (DriveTerm(1, 0, 1j),)},
    ],
)
def test_bad_commands_are_refused(command):
    with pytest.raises(BenchError, match="drive command"):
        check_drive(DriveCommand(**command))


def test_beyond_half_the_sample_rate_is_refused():
    with pytest.raises(BenchError, match="half the sample rate"):
        Oscillator(RATE).apply(sine(1000.0, terms=(DriveTerm(1, 5, 1.0, False),)))


def test_a_term_of_order_one_turns_the_fundamental() -> None:
    """Half-cosine from one complex amplitude to the next within a block; the bound is that of the sum."""
    oscillator = Oscillator(RATE)
    before, after = -0.6 + 0.2j, 0.1 - 0.5j
    voltages = []
    for value in (before, after):
        size = abs(value)
        oscillator.apply(sine(25.0, size, 0.02, terms=(DriveTerm(1, 1, value - size, False),)))
        assert oscillator.bound(200) == pytest.approx(max(abs(before), size) if voltages else size)
        voltages.append(oscillator.block(200).voltage)
    share = 0.5 - 0.5 * np.cos(np.pi * np.arange(201) / 200)
    wave = np.exp(2j * np.pi * 25.0 * (np.arange(201) + 200) / RATE)
    np.testing.assert_allclose(voltages[1], ((before + (after - before) * share) * wave).real, atol=1e-12)
    assert oscillator.is_feedback


def test_harmonics_begin_at_order_one() -> None:
    check_drive(sine(25.0, terms=(DriveTerm(1, 1, -0.5 + 0j, False),)))
    with pytest.raises(BenchError, match="exciters and orders count from 1"):
        check_drive(sine(25.0, terms=(DriveTerm(1, 0, 0.5 + 0j, False),)))
