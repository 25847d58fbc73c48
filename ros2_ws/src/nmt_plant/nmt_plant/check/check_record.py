"""What a check measures: silence, then noise whose peaks stay below one hundredth of the drive's limit."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from nmt_core.messages.records import DriveCommand
from nmt_core.numerics.arrays import FloatArray
from nmt_core.vocabulary import Waveform
from nmt_plant.devices.hardware_rig import HardwareRig
from nmt_rig.linear_description import linear_description

DRIVE_SHARE = 0.01
"""Of the drive's limit: largest sample put out."""
SILENCE, DRIVE = 4.0, 18.0
"""s, of listening and of driving."""
_RAMP = 0.5  # s
_SURE_PEAK = 6.0  # of the rms: passed by one in 5e8 samples of a normal distribution


@dataclass
class CheckRecord:
    """What a check measured: volts at the ports, (inputs, samples), and what was put out, V at the first exciter."""

    silent: FloatArray
    driven: FloatArray
    put_out: FloatArray
    ended: str = ""
    lost_blocks: int = 0
    segments: list[int] = field(default_factory=list)


def drive_level(limit: float) -> float:
    """V rms of a noise whose peaks stay within the share of the limit that a check may use."""
    return DRIVE_SHARE * limit / _SURE_PEAK


def drive_band(device: HardwareRig) -> tuple[float, float]:
    """Hz; about the target mode, with some of its neighbours."""
    target = linear_description(device.rig).frequency_hz
    return 0.4 * target, min(8.0 * target, 0.4 * device.sample_rate)


def record_check(device: HardwareRig, on_progress: Callable[[float], None] | None = None) -> CheckRecord:
    """Listen, then drive; the device is started and ends at zero.

    Raises:
        DeviceFault: the device failed.
    """
    limit = device.rig.limits.voltage_v or 0.0
    low, high = drive_band(device)
    noise = DriveCommand(Waveform.RANDOM, amplitude=drive_level(limit), ramp=_RAMP, band_low_hz=low, band_high_hz=high)
    block = device.block_samples / device.sample_rate
    silent: list[list[FloatArray]] = [[]]  # pieces between losses: across one the time axis is not known
    driven, put_out = [], []
    lost, ended = 0, ""
    total = SILENCE + DRIVE + _RAMP
    blocks = math.ceil(total / block)
    begun = math.ceil(SILENCE / block)
    lead = 0
    for n in range(blocks + 200):
        if n >= begun:
            device.write(noise)
        got = device.read()
        lost += not got
        on = bool(device.put_out.any())
        if n < begun and not on:
            if got:
                silent[-1].append(device.measured.copy())
            else:
                silent.append([])
        elif on:
            lead += 1
            if lead * block > _RAMP:
                driven.append(device.measured.copy() if got else np.full_like(device.measured, math.nan))
                put_out.append(device.put_out.copy() if got else np.zeros_like(device.put_out))
        if device.tripped:
            ended = device.tripped
            break
        if on_progress is not None:
            on_progress(min((n + 1) / blocks, 1.0))
        if len(driven) * block >= DRIVE:
            break
    _to_zero(device)
    inputs, size = device.measured.shape
    nothing = np.zeros((inputs, size))
    return CheckRecord(
        np.concatenate(max(silent, key=len) or [nothing], axis=1),
        _without_losses(np.concatenate(driven or [nothing], axis=1)),
        np.concatenate(put_out or [nothing[0]]),
        ended,
        lost,
    )


def _without_losses(driven: FloatArray) -> FloatArray:
    """The same with the mean of each channel where samples were lost, so that an offset makes no steps there."""
    lost = np.isnan(driven[0])
    if not lost.any():
        return driven
    mean = driven[:, ~lost].mean(axis=1, keepdims=True) if not lost.all() else np.zeros((driven.shape[0], 1))
    return np.where(lost, mean, driven)


def _to_zero(device: HardwareRig) -> None:
    if not device.tripped:
        device.write(DriveCommand(Waveform.OFF, ramp=0.2))
    for _ in range(math.ceil(2.0 * device.sample_rate / device.block_samples)):
        if device.is_quiet:
            return
        device.read()
