"""Loopback device: output wired to input, as on a bench without a structure.

The force channel records `newton_per_volt` times the drive voltage, delayed by `delay_samples`; the
acceleration channel records the same in m/s². For checking cabling, sequencing and phase without a rig.
"""

from __future__ import annotations

import numpy as np

from nmt_core.blocks import BlockFlag, Quantity, SampleBlock

from .device import Device, DriveCommand, Waveform
from .limits import LimitGuard
from .oscillator import Oscillator, check_command
from .watchdog import DriveWatchdog


class LoopbackDevice(Device):
    """Loopback with voltage limit and watchdog.

    Args:
        sample_rate: Hz.
        block_samples: samples in a block.
        newton_per_volt: gain of the force channel; that of the acceleration channel has the same figure.
        delay_samples: delay of both.
        voltage_limit: V.
        watchdog_blocks: blocks without a command that trip; 0 = off.
        quiet_ramp: s, ramp to zero after a trip.
        point: measurement point of both channels.
    """

    def __init__(
        self,
        sample_rate: float = 10_000.0,
        block_samples: int = 200,
        newton_per_volt: float = 1.0,
        delay_samples: int = 0,
        voltage_limit: float = 10.0,
        watchdog_blocks: int = 50,
        quiet_ramp: float = 0.1,
        point: int = 1,
    ) -> None:
        super().__init__()
        self._sample_rate, self._block_samples = float(sample_rate), int(block_samples)
        self._gain, self._delay, self._limit = newton_per_volt, delay_samples, voltage_limit
        self._watchdog_blocks, self._ramp, self._point = watchdog_blocks, quiet_ramp, point
        self._prepare()

    def _prepare(self) -> None:
        self._oscillator = Oscillator(self._sample_rate)
        self._watchdog = DriveWatchdog(self._watchdog_blocks)
        self._guard = LimitGuard({Quantity.VOLTAGE: self._limit})
        self._pending: list[DriveCommand] = []
        self._delayed = np.zeros(self._delay)
        self._reason = ""
        self._flags = BlockFlag.NONE
        self._sample = 0

    @property
    def sample_rate(self) -> float:
        """Sample rate, Hz."""
        return self._sample_rate

    @property
    def block_samples(self) -> int:
        """Samples in a block."""
        return self._block_samples

    @property
    def next_sample(self) -> int:
        """Index of the first sample of the next block."""
        return self._sample

    @property
    def tripped(self) -> str:
        """Why the drive was taken to zero and held there; empty if it was not."""
        return self._reason

    @property
    def is_quiet(self) -> bool:
        """Whether the drive is at zero and stays there without a new command."""
        return self._oscillator.is_quiet and (bool(self._reason) or not self._pending)

    def _configure(self) -> None:
        pass

    def _start(self) -> None:
        self._prepare()

    def _read(self) -> list[SampleBlock]:
        due = [command for command in self._pending if command.apply_at_sample <= self._sample]
        self._pending = [command for command in self._pending if command.apply_at_sample > self._sample]
        if not self._reason:
            for command in due:
                self._oscillator.apply(command)
        n = self._block_samples
        drive = self._oscillator.block(n)
        voltage = drive.voltage[:n]
        line = np.concatenate([self._delayed, voltage])
        delayed, self._delayed = line[:n], line[n:]

        def block(quantity: Quantity, channel: str, point: int, row: np.ndarray) -> SampleBlock:
            return SampleBlock(
                self._sample, self._sample_rate, quantity, quantity.unit, (channel,), (point,),
                row[None, :].copy(), drive.phase, int(self._flags),
            )  # fmt: skip

        def blocks() -> list[SampleBlock]:
            return [
                block(Quantity.FORCE, f"f{self._point}", self._point, self._gain * delayed),
                block(Quantity.ACCELERATION, f"a{self._point}", self._point, self._gain * delayed),
                block(Quantity.VOLTAGE, "u", 0, voltage),
            ]

        if not self._reason:
            if self._guard.check(blocks()):
                self._trip(self._guard.reason, BlockFlag.LIMIT, self._ramp)
            elif self._watchdog.block(not self._oscillator.is_quiet):
                missed = self._watchdog.missed
                self._trip(f"watchdog: no drive command for {missed} blocks", BlockFlag.WATCHDOG, self._ramp)
        result = blocks()
        self._sample += n
        return result

    def _trip(self, reason: str, flag: BlockFlag, ramp: float) -> None:
        self._reason = reason
        self._flags |= flag
        self._oscillator.ramp_to_zero(ramp)

    def _write(self, command: DriveCommand) -> None:
        if command.waveform != Waveform.OFF:
            check_command(command, self._sample_rate)
        self._watchdog.command()
        self._pending.append(command)

    def _quiet(self, reason: str, ramp: float | None) -> None:
        if not self._reason:
            self._trip(reason, BlockFlag.NONE, self._ramp if ramp is None else ramp)

    def _reset(self) -> None:
        self._oscillator.ramp_to_zero(0.0)
        self._pending.clear()
        self._guard.reset()
        self._watchdog.command()
        self._reason = ""
        self._flags = BlockFlag.NONE

    def _stop(self) -> None:
        self._oscillator.ramp_to_zero(0.0)
        self._pending.clear()

    def _close(self) -> None:
        pass
