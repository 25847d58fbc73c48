"""A device with oscillator, watchdog and limits of its own, working block by block in one fixed order.

Simulated devices and converters without safety functions of their own extend `GuardedDevice`; they say what a
block measures, and everything that keeps the drive safe stays in one place.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, NamedTuple

from nmt_core.blocks import BlockFlag, FloatArray, OscillatorPhase, Quantity, SampleBlock
from nmt_core.records import DriveCommand
from nmt_core.vocabulary import Waveform
from nmt_plant.device import Device
from nmt_plant.limits import LimitGuard
from nmt_plant.oscillator import Oscillator, OscillatorBlock, check_command
from nmt_plant.watchdog import DriveWatchdog

# The order in which `tick` works; tests hold it to this.
TICK_ORDER = ("commands", "measure", "compute", "safety", "actuate", "publish")


class ChannelGroup(NamedTuple):
    """The channels of one quantity: one block of them is published."""

    quantity: Quantity
    unit: str
    channels: tuple[str, ...]
    points: tuple[int, ...]
    rows: slice | list[int]


@dataclass(frozen=True)
class GuardSettings:
    """When a device takes its drive to zero, and how fast.

    Attributes:
        limits: quantity -> largest magnitude, SI.
        limit_ramp: s, ramp to zero after a violation, and of `quiet` unless it names another.
        watchdog_blocks: blocks without a command that trip; 0 = off.
        watchdog_ramp: s, ramp to zero after a trip of the watchdog.
    """

    limits: Mapping[Quantity, float]
    limit_ramp: float
    watchdog_blocks: int
    watchdog_ramp: float


class GuardedDevice(Device):
    """Commands, trips and publishing of a device; `_measure` and `_compute` are left to the device.

    A subclass calls `_prepare` at the end of its constructor.

    Args:
        sample_rate: Hz.
        block_samples: samples in a block.
        groups: published channels, in order; their rows are those of what `_compute` returns.
        settings: limits, watchdog and ramps.
        seed: of the random waveform.
    """

    QUIET_FLAG: ClassVar[BlockFlag] = BlockFlag.NONE
    """Flag of the blocks after `quiet`."""

    def __init__(
        self,
        sample_rate: float,
        block_samples: int,
        groups: Sequence[ChannelGroup],
        settings: GuardSettings,
        seed: int = 0,
    ) -> None:
        super().__init__()
        self._sample_rate = float(sample_rate)
        self._block_samples = block_samples
        self._groups = groups
        self._settings = settings
        self._seed = seed

    def _prepare(self) -> None:
        """State at sample 0: drive at zero, nothing tripped, nothing pending."""
        self._oscillator = Oscillator(self._sample_rate, self._seed)
        self._watchdog = DriveWatchdog(self._settings.watchdog_blocks)
        self._guard = LimitGuard(dict(self._settings.limits))
        self._pending: list[DriveCommand] = []
        self._reason = ""
        self._flags = BlockFlag.NONE
        self._quiet_ramp = 0.0
        self._next_sample = 0

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
        return self._next_sample

    @property
    def tripped(self) -> str:
        """Why the drive was taken to zero and held there; empty if it was not."""
        return self._reason

    @property
    def is_quiet(self) -> bool:
        """Whether the drive is at zero and stays there without a new command."""
        harmless = all(command.waveform == Waveform.OFF for command in self._pending)
        return self._oscillator.is_quiet and (bool(self._reason) or harmless)

    def _start(self) -> None:
        self._prepare()

    def _read(self) -> list[SampleBlock]:
        return self.tick()

    def tick(self) -> list[SampleBlock]:
        """One block, in the order of TICK_ORDER; `read` calls it.

        Commands that are due act on this block's drive; a violation seen in it acts from the next one on.
        """
        self._take_commands()
        drive = self._oscillator.block(self._block_samples)
        true_values = self._measure(drive)
        recorded, overload = self._compute(true_values)
        blocks = self._blocks(recorded, drive.phase)
        self._safety(blocks)
        self._actuate()
        return self._publish(blocks, overload)

    def _take_commands(self) -> None:
        """Apply, in order of arrival, what is due at this block; ignored while tripped."""
        due = [command for command in self._pending if command.apply_at_sample <= self._next_sample]
        self._pending = [command for command in self._pending if command.apply_at_sample > self._next_sample]
        if not self._reason:
            for command in due:
                self._oscillator.apply(command)

    @abstractmethod
    def _measure(self, drive: OscillatorBlock) -> FloatArray:
        """True values of all channels under the drive of this block, shape (channels, samples), SI."""

    def _compute(self, true_values: FloatArray) -> tuple[FloatArray, bool]:
        """Recorded values (channels, samples), SI, and whether a channel was beyond its range."""
        return true_values, False

    def _blocks(self, recorded: FloatArray, phase: OscillatorPhase) -> list[SampleBlock]:
        return [
            SampleBlock(
                self._next_sample,
                self._sample_rate,
                group.quantity,
                group.unit,
                group.channels,
                group.points,
                recorded[group.rows],
                phase,
            )
            for group in self._groups
        ]

    def _safety(self, blocks: Sequence[SampleBlock]) -> None:
        if self._reason:
            return
        if self._guard.check(blocks):
            self._trip(self._guard.reason, BlockFlag.LIMIT, self._settings.limit_ramp)
        elif self._watchdog.block(not self._oscillator.is_quiet):
            self._trip(
                f"watchdog: no drive command for {self._watchdog.missed} blocks",
                BlockFlag.WATCHDOG,
                self._settings.watchdog_ramp,
            )

    def _actuate(self) -> None:
        """Hand the drive to the output: while tripped it can only go to zero."""
        if self._reason:
            self._oscillator.ramp_to_zero(0.0 if self._oscillator.is_quiet else self._quiet_ramp)

    def _publish(self, blocks: Sequence[SampleBlock], overload: bool) -> list[SampleBlock]:
        flags = int(self._flags | (BlockFlag.OVERLOAD if overload else BlockFlag.NONE))
        self._next_sample += self._block_samples
        if not flags:
            return list(blocks)
        return [replace(block, flags=flags) for block in blocks]

    def _trip(self, reason: str, flag: BlockFlag, ramp: float) -> None:
        self._reason = reason
        self._flags |= flag
        self._quiet_ramp = ramp

    def _check(self, command: DriveCommand) -> None:
        """Refuse a command, other than OFF, that the device cannot follow.

        Raises:
            BenchError: a command beyond what the device can do.
        """
        check_command(command, self._sample_rate)

    def _write(self, command: DriveCommand) -> None:
        # A command the oscillator cannot follow is refused here, where its sender can be told.
        if command.waveform != Waveform.OFF:
            self._check(command)
        self._watchdog.command()
        self._pending.append(command)

    def _quiet(self, reason: str, ramp: float | None) -> None:
        if not self._reason:
            self._trip(reason, self.QUIET_FLAG, self._settings.limit_ramp if ramp is None else ramp)
        self._oscillator.ramp_to_zero(self._quiet_ramp)

    def _reset(self) -> None:
        # The tripped drive must be at rest before anybody takes over again.
        self._oscillator.ramp_to_zero(0.0)
        self._pending.clear()
        self._guard.reset()
        self._watchdog.command()
        self._reason = ""
        self._flags = BlockFlag.NONE

    def _stop(self) -> None:
        self._oscillator.ramp_to_zero(0.0)
        self._pending.clear()
