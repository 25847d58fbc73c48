"""What every device must do. To put a device under test, add a function that makes one to DEVICES."""

from __future__ import annotations

import numpy as np
import pytest

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import BlockFlag, Quantity
from nmt_core.messages.records import DriveCommand, DriveTerm
from nmt_core.vocabulary import Waveform
from nmt_plant.devices.device import Device, DeviceState, DeviceStateError
from nmt_plant.devices.loopback_device import LoopbackDevice
from nmt_plant.devices.simulated_rig import SimulatedRig
from nmt_rig.rig import load_rig


def simulated_beam() -> Device:
    return SimulatedRig(load_rig("beam", ["watchdog.blocks=5", "watchdog.ramp_s=0.04"]))


def loopback() -> Device:
    return LoopbackDevice(watchdog_blocks=5, quiet_ramp=0.04)


DEVICES = {"simulated_beam": simulated_beam, "loopback": loopback}
SINE = DriveCommand(Waveform.SINE, 22.0, 0.5)


@pytest.fixture(params=list(DEVICES.values()), ids=list(DEVICES))
def device(request):
    device = request.param()
    yield device
    device.close()


@pytest.fixture
def running(device):
    device.configure()
    device.start()
    return device


def voltage(blocks):
    return next(block for block in blocks if block.quantity == Quantity.VOLTAGE).data[0]


def test_call_order_is_enforced(device):
    for call in (device.start, device.read, device.stop, device.reset, lambda: device.write(SINE)):
        with pytest.raises(DeviceStateError):
            call()
    device.configure()
    with pytest.raises(DeviceStateError):
        device.configure()
    device.start()
    device.stop()
    assert device.state is DeviceState.STOPPED
    with pytest.raises(DeviceStateError):
        device.read()


def test_close_works_in_every_state_and_twice(device):
    device.close()
    device.close()
    assert device.state is DeviceState.CLOSED
    with pytest.raises(DeviceStateError):
        device.configure()


def test_blocks_follow_each_other_without_gap(running):
    for n in range(4):
        assert running.next_sample == n * running.block_samples
        blocks = running.read()
        assert {block.first_sample for block in blocks} == {n * running.block_samples}
        assert {block.samples for block in blocks} == {running.block_samples}
        assert len({block.oscillator for block in blocks}) == 1
        for block in blocks:
            assert block.sample_rate == running.sample_rate
            assert block.unit == block.quantity.unit
            assert len(block.channels) == len(block.points) == block.data.shape[0]
            assert np.isfinite(block.data).all()
    assert {Quantity.FORCE, Quantity.VOLTAGE} <= {block.quantity for block in blocks}


def test_drive_is_zero_until_commanded_and_follows_the_oscillator_phase(running):
    assert np.all(voltage(running.read()) == 0.0)
    running.write(SINE)
    blocks = running.read()
    theta = blocks[0].oscillator.phase(running.block_samples, running.sample_rate)
    np.testing.assert_allclose(voltage(blocks), 0.5 * np.cos(theta), atol=1e-6)


def test_a_command_waits_for_its_sample(running):
    at = 2 * running.block_samples
    running.write(DriveCommand(Waveform.SINE, 22.0, 0.5, apply_at_sample=at))
    assert np.all(voltage(running.read()) == 0.0)
    assert np.all(voltage(running.read()) == 0.0)
    assert np.any(voltage(running.read()) != 0.0)


def test_a_command_out_of_its_range_is_refused(running):
    with pytest.raises(BenchError, match="amplitude must be finite and not negative"):
        running.write(DriveCommand(Waveform.SINE, 22.0, -0.5))
    assert np.all(voltage(running.read()) == 0.0)


def test_a_command_beyond_half_the_sample_rate_is_refused(running):
    with pytest.raises(BenchError):
        running.write(DriveCommand(Waveform.SINE, running.sample_rate, 0.5))


@pytest.mark.parametrize(
    "command",
    [
        DriveCommand(Waveform.SINE, 22.0, 1e4),
        DriveCommand(Waveform.SINE, 22.0, 0.3, terms=(DriveTerm(1, 3, 1e6 + 0j, False),)),
        DriveCommand(Waveform.RANDOM, amplitude=1e4, band_low_hz=10.0, band_high_hz=100.0),
        DriveCommand(Waveform.SINE, 22.0, 0.3, apply_at_sample=2**60),
        DriveCommand(Waveform.SINE, 22.0, 0.3, ramp=1e300),
    ],
    ids=["amplitude", "harmonics", "random", "far ahead", "endless ramp"],
)
def test_a_command_beyond_the_output_guard_is_refused_and_the_drive_stays_as_it_was(running, command):
    with pytest.raises(BenchError):
        running.write(command)
    assert np.all(voltage(running.read()) == 0.0)
    assert running.tripped == ""


def test_a_step_is_finite_and_within_its_amplitude(running):
    running.write(DriveCommand(Waveform.SINE, 400.0, 9.0))
    drive = np.concatenate([voltage(running.read()) for _ in range(4)])
    assert np.isfinite(drive).all()
    assert np.abs(drive).max() <= 9.0 + 1e-6


def test_watchdog_ramps_to_zero_and_latches(running):
    running.write(SINE)
    blocks = [running.read() for _ in range(14)]
    # The fifth block without a command is flagged; the ramp begins with the sixth.
    assert [bool(b[0].flags & BlockFlag.WATCHDOG) for b in blocks] == [False] * 4 + [True] * 10
    theta = blocks[0][0].oscillator.phase(5 * running.block_samples, running.sample_rate)
    np.testing.assert_allclose(np.concatenate([voltage(b) for b in blocks[:5]]), 0.5 * np.cos(theta), atol=1e-6)
    assert "watchdog" in running.tripped
    assert np.all(voltage(blocks[-1]) == 0.0)
    drive = np.concatenate([voltage(b) for b in blocks])
    # A half-cosine: no step larger than the sine itself makes.
    assert np.abs(np.diff(drive[1:])).max() < 1.3 * 0.5 * 2 * np.pi * 22.0 / running.sample_rate
    running.write(SINE)
    assert np.all(voltage(running.read()) == 0.0), "latched until reset"
    running.reset()
    running.write(SINE)
    assert np.any(voltage(running.read()) != 0.0)


def test_commands_keep_the_watchdog_away_and_silence_never_trips(running):
    for _ in range(12):
        running.write(SINE)
        running.read()
    assert running.tripped == ""
    running.write(DriveCommand(Waveform.OFF))
    for _ in range(12):
        blocks = running.read()
    assert running.tripped == ""
    assert blocks[0].flags == 0


def test_quiet_is_an_emergency_ramp(running):
    running.write(SINE)
    running.read()
    running.quiet("operator", 0.04)
    assert "operator" in running.tripped
    blocks = [running.read() for _ in range(3)]
    assert np.any(voltage(blocks[0]) != 0.0), "a ramp, not a step"
    assert np.all(voltage(blocks[-1]) == 0.0)
    assert running.is_quiet


def test_quiet_does_not_wait_for_a_slow_ramp(running):
    running.write(SINE)
    running.read()
    running.write(DriveCommand(Waveform.OFF, ramp=3600.0))
    running.read()
    running.quiet("operator", 0.04)
    blocks = [running.read() for _ in range(3)]
    assert np.all(voltage(blocks[-1]) == 0.0)
    assert running.is_quiet


def test_restart_begins_at_sample_zero_with_the_drive_off(running):
    running.write(SINE)
    running.read()
    running.stop()
    running.configure()
    running.start()
    blocks = running.read()
    assert blocks[0].first_sample == 0
    assert np.all(voltage(blocks) == 0.0)
