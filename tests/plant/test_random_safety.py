"""Watchdog and limits of the simulated rig while the drive is random."""

from __future__ import annotations

import numpy as np

from nmt_core.messages.blocks import BlockFlag, Quantity
from nmt_core.messages.records import DriveCommand
from nmt_core.vocabulary import Waveform
from nmt_plant.devices.simulated_rig import SimulatedRig
from nmt_rig.rig import load_rig


def started(*overrides: str) -> SimulatedRig:
    device = SimulatedRig(load_rig("beam", ["watchdog.blocks=10", *overrides]))
    device.configure()
    device.start()
    device.write(DriveCommand(Waveform.RANDOM, amplitude=0.1, band_low_hz=10.0, band_high_hz=1000.0))
    return device


def voltage(device: SimulatedRig, blocks: int) -> tuple[np.ndarray, int]:
    """Measured voltage over a number of blocks, and the flags of the last."""
    rows, flags = [], 0
    for _ in range(blocks):
        found = {block.quantity: block for block in device.read()}
        rows.append(found[Quantity.VOLTAGE].data[0])
        flags = found[Quantity.VOLTAGE].flags
    return np.concatenate(rows), flags


def test_the_watchdog_ramps_a_random_drive_down() -> None:
    device = started()
    values, flags = voltage(device, 60)
    ramp = round(device.rig.watchdog.ramp_s * device.sample_rate)
    assert "watchdog" in device.tripped
    assert flags & BlockFlag.WATCHDOG
    assert values[1000:2000].std() > 0.05
    last = np.flatnonzero(values)[-1]
    # The tenth block without a command trips; its successor begins the ramp.
    assert 2000 < last <= 10 * device.block_samples + ramp + device.block_samples
    half = 10 * device.block_samples + ramp // 2
    assert values[half : half + ramp // 4].std() < 0.6 * values[: 2 * ramp].std()
    assert device.is_quiet


def test_a_measured_peak_trips_although_the_rms_is_far_below_the_limit() -> None:
    device = started("limits.channels=[{channel: u, abort_peak: 0.3}]")
    values, flags = voltage(device, 40)
    assert "voltage limit" in device.tripped
    assert flags & BlockFlag.LIMIT
    peak = int(np.argmax(np.abs(values) > 0.3))
    assert values[:peak].std() < 0.15
    following = (peak // device.block_samples + 1) * device.block_samples
    ramp = round(device.rig.limits.ramp_s * device.sample_rate)
    assert not values[following + ramp + 1 :].any()
