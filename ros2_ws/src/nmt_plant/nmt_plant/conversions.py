"""Drive messages to device commands."""

from __future__ import annotations

from typing import Any

from nmt_core.errors import BenchError
from nmt_core.wire import read_drive
from nmt_plant.device import DriveCommand, Waveform


def command_from_message(message: Any) -> DriveCommand:
    """Read ``nmt_msgs/Drive``.

    Raises:
        BenchError: unknown waveform, or a value the command refuses.
    """
    try:
        waveform = Waveform(message.waveform)
    except ValueError:
        raise _unknown_waveform(message.waveform) from None
    harmonics: tuple[tuple[int, complex], ...] = ()
    if message.harmonics:
        if not len(message.harmonics) == len(message.harmonics_real) == len(message.harmonics_imag):
            raise BenchError("drive command: harmonics, harmonics_real and harmonics_imag must have equal lengths.")
        harmonics = tuple(
            (int(order), complex(real, imag))
            for order, real, imag in zip(message.harmonics, message.harmonics_real, message.harmonics_imag, strict=True)
        )
    return DriveCommand(
        waveform=waveform,
        frequency_hz=message.frequency_hz,
        amplitude=message.amplitude,
        ramp=message.ramp,
        apply_at_sample=message.apply_at_sample,
        based_on_sample=message.based_on_sample,
        harmonics=harmonics,
        band_low_hz=message.band_low_hz,
        band_high_hz=message.band_high_hz,
        rate_hz_s=message.rate_hz_s,
        frequency_end_hz=message.frequency_end_hz,
    )


def command_from_bytes(raw: bytes) -> tuple[DriveCommand | None, int]:
    """Read a serialised ``nmt_msgs/Drive``.

    Returns:
        The command, None if it has harmonics and needs the full deserialisation; and the last sample it is based on.

    Raises:
        BenchError: unknown waveform, or a value the command refuses.
        ValueError: not a whole message.
    """
    drive = read_drive(raw)
    if drive is None:
        return None, -1
    try:
        waveform = Waveform(drive.waveform)
    except ValueError:
        raise _unknown_waveform(drive.waveform) from None
    command = DriveCommand(
        waveform=waveform,
        frequency_hz=drive.frequency_hz,
        amplitude=drive.amplitude,
        ramp=drive.ramp,
        apply_at_sample=drive.apply_at_sample,
        based_on_sample=drive.based_on_sample,
        band_low_hz=drive.band_low_hz,
        band_high_hz=drive.band_high_hz,
        rate_hz_s=drive.rate_hz_s,
        frequency_end_hz=drive.frequency_end_hz,
    )
    return command, drive.based_on_sample


def _unknown_waveform(value: int) -> BenchError:
    return BenchError(f"drive command: waveform {value} is unknown; use OFF, SINE, RANDOM or SWEEP.")
