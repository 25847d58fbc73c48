"""What the plant node does with messages, free of ROS and wall time: drive commands and run states in, blocks out."""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Sequence
from dataclasses import dataclass

from nmt_core.messages.blocks import SampleBlock
from nmt_core.messages.cdr import bench_time_ns
from nmt_core.messages.command_judge import LONGEST_AHEAD, CommandJudge
from nmt_core.messages.records import DriveCommand, DriveStop, RunState, SignalLevels
from nmt_core.messages.run_announcement import TAKEN_TOPICS
from nmt_core.vocabulary import OutputState, Quantity, RunPhase, StopCause
from nmt_plant.devices.device import Device, DeviceState, check_drive
from nmt_plant.signal_levels import LevelMeter

_ACTIVE = (RunPhase.RUNNING, RunPhase.PAUSED, RunPhase.STOPPING, RunPhase.DONE)
_LONGEST_RAMP = 60.0  # s of bench time
_LONGEST_END = 10.0  # s of bench time
_LONGEST_STALL = 10.0  # s that the loop may miss in real time
READERS = tuple(TAKEN_TOPICS)
"""Nodes that are waited for in lockstep: what they have not taken waits in memory."""


@dataclass
class LockstepGate:
    """Holds back block n + 1 + latency until the drive computed from block n has arrived.

    Attributes:
        block_samples: samples a block.
        latency_blocks: blocks the plant may run ahead of its commands.
        answered: last sample that a command was computed from, -1 before the first.
        horizon: first sample that may not be produced yet.
    """

    block_samples: int
    latency_blocks: int
    answered: int = -1
    horizon: int = 0

    def may_produce(self, next_sample: int) -> bool:
        """Whether the block that starts at ``next_sample`` is due."""
        needed = next_sample - self.latency_blocks * self.block_samples - 1
        return next_sample + self.block_samples <= self.horizon and self.answered >= needed

    def starved(self, next_sample: int) -> bool:
        """Whether a command is missing although the horizon would let the block pass, or the horizon stands still."""
        return not self.may_produce(next_sample)


class PlantCore:
    """A device and, in lockstep, the gate that says when its next block is due.

    Args:
        device: the device; it is configured and started here.
        latency_blocks: blocks the plant may run ahead of its commands.
        lockstep: blocks wait for the commands computed from those before.
        reader_lead: samples by which the blocks of a run in lockstep may be ahead of the position of each of
            ``READERS``, as it has taken; 0 = any number.

    Attributes:
        phase: phase of the run, as last heard of.
        running: whether a run has begun.
        judge: whether a drive command can be meant.
        quantities: what the device measures, in the order of its blocks.

    Raises:
        BenchError: the device refuses its configuration.
    """

    def __init__(self, device: Device, latency_blocks: int = 0, lockstep: bool = True, reader_lead: int = 0) -> None:
        self.device = device
        self._reader_lead, self._taken = reader_lead, dict.fromkeys(READERS, 0)
        self.lockstep = lockstep
        self.phase = RunPhase.UNKNOWN
        self.running = False
        self._begun_at = 0
        self._last_stop: DriveStop | None = None
        self._rest_shown = True  # whether the drive was at zero throughout the newest block
        self._meter = LevelMeter(device.sample_rate, device.block_samples)
        self._gate = LockstepGate(device.block_samples, latency_blocks)
        block_rate = device.sample_rate / device.block_samples
        self.judge = CommandJudge(
            device.block_samples,
            horizon=round(LONGEST_AHEAD * device.sample_rate),
            most_missing=latency_blocks if lockstep else round(_LONGEST_STALL * block_rate),
        )
        self.quantities: tuple[Quantity, ...] = device.quantities
        device.configure()
        device.start()

    def take_state(self, state: RunState) -> bool:
        """Take the state of the run; True if the run begins with it."""
        if self.phase == RunPhase.UNKNOWN and state.phase in _ACTIVE and state.sample > self.device.next_sample:
            return False  # a run of the plant before this one
        if state.phase == RunPhase.RUNNING and self.phase not in (*_ACTIVE[:-1], RunPhase.UNKNOWN):
            # The loop may have been started again since the last run, with a block of that run unanswered.
            self.judge.release()
            self._gate.answered = max(self._gate.answered, self.device.next_sample - 1)
            self._gate.horizon = 0
        if state.phase == RunPhase.RUNNING and self.phase not in _ACTIVE[:-1]:
            self._begun_at = self.device.next_sample
        self.phase = state.phase
        if self.lockstep and state.phase in _ACTIVE:
            self._gate.horizon = max(self._gate.horizon, state.horizon_sample)
        if self.running or state.phase != RunPhase.RUNNING:
            return False
        self.running = True
        return True

    def take_progress(self, reader: str, sample: int) -> None:
        """Take the first sample that a reader has not taken yet."""
        self._taken[reader] = sample

    def take_drive(self, command: DriveCommand, source: Hashable = "loop") -> str:
        """Hand a command to the device; the block that waits for it may then be due.

        Args:
            command: the command.
            source: who sent it, see `nmt_core.messages.command_judge.CommandJudge.judge`.

        Returns:
            Empty if the command is taken, otherwise the sentence why it cannot be meant; then nothing has changed.

        Raises:
            BenchError: the command is out of its range, or beyond what the device can do.
        """
        check_drive(command)
        why = self.judge.judge(
            source,
            next_sample=self.device.next_sample,
            based_on=command.based_on_sample,
            apply_at=command.apply_at_sample,
            values={"frequency_hz": command.frequency_hz, "amplitude": command.amplitude, "ramp": command.ramp},
        )
        if why:
            return why
        self._gate.answered = max(self._gate.answered, command.based_on_sample)
        self.device.write(command)
        return ""

    @property
    def second_source(self) -> str:
        """A sentence that names who else has sent drive commands; empty if none has."""
        names = self.judge.second_source
        return f"topic drive has a second publisher: {names}" if names else ""

    @property
    def in_run(self) -> bool:
        """Whether a run is under way, its ramp to zero included."""
        return self.running and self.phase in _ACTIVE[:-1]

    @property
    def due(self) -> bool:
        """Whether the next block is due in lockstep: one for every answer, up to the horizon."""
        due = self.lockstep and self.running and self._gate.may_produce(self.device.next_sample)
        return due and not self.waits_for

    @property
    def waits_for(self) -> str:
        """The reader that holds the next block of a run back, since it is too far behind; empty if none does."""
        if not self.lockstep or not self._reader_lead or self.phase != RunPhase.RUNNING:
            return ""
        reader, taken = min(self._taken.items(), key=lambda item: item[1])
        ahead = self.device.next_sample - max(taken, self._begun_at)
        return reader if ahead >= self._reader_lead else ""

    @property
    def starved(self) -> bool:
        """Whether a command or the horizon holds the next block back."""
        return self._gate.starved(self.device.next_sample)

    def produce(self) -> list[SampleBlock]:
        """The next block of every quantity.

        Raises:
            DeviceFault: the device failed.
        """
        self._rest_shown = self.device.is_quiet
        return self.device.read()

    @property
    def at_rest(self) -> bool:
        """Whether the drive is at zero and, in lockstep, was so throughout the newest block.

        With the last sample of a ramp the drive is at zero, but its block still shows the ramp; in lockstep no other
        block follows by itself.
        """
        return self.device.is_quiet and (self._rest_shown or not self.lockstep)

    def levels(self, blocks: Sequence[SampleBlock]) -> SignalLevels | None:
        """Levels of the signals, if these blocks complete a tenth of a second; to be asked with every block once."""
        return self._meter.add(blocks)

    def stop(self) -> DriveStop | None:
        """What is to be told of a stop of the drive: when it begins, is at zero, or is released; else None.

        To be asked after every block and after everything that may stop or release the drive.
        """
        cause = self.device.stop_cause
        told = self._last_stop
        if cause is StopCause.UNKNOWN:
            if told is None:
                return None
            self._last_stop, reason = None, ""
            cause, output = StopCause.RELEASED, OutputState.AT_ZERO
        else:
            output, reason = self.device.output_state, self.device.tripped
            if told is not None and (told.cause, told.output, told.reason) == (cause, output, reason):
                return None
        sample = self.device.next_sample
        stop = DriveStop(sample, cause, output, reason, bench_time_ns(sample, self.device.sample_rate))
        if cause is not StopCause.RELEASED:
            self._last_stop = stop
        return stop

    def failure(self, reason: str) -> DriveStop:
        """What is to be told when the device has failed and is closed."""
        sample = self.device.next_sample
        time_ns = bench_time_ns(sample, self.device.sample_rate)
        self._last_stop = DriveStop(sample, StopCause.DEVICE, self.device.output_state, reason, time_ns)
        return self._last_stop

    def quiet_down(self, reason: str, cause: StopCause = StopCause.NODE) -> Iterator[list[SampleBlock]]:
        """Emergency ramp to zero: the blocks of the ramp, since in lockstep only this moves bench time on.

        The last block shows the drive at zero. In real time the blocks come by themselves and none is given.

        Raises:
            DeviceFault: the device failed.
        """
        if self.device.state is not DeviceState.RUNNING:
            return
        if not self.device.is_quiet:
            yield from self.stop_drive(reason, cause)
        elif self.running and not self.at_rest:
            yield self.produce()

    def stop_drive(self, reason: str, cause: StopCause) -> Iterator[list[SampleBlock]]:
        """As `quiet_down`, but latched at zero also where the drive was there already; a longer ramp is cut short.

        Raises:
            DeviceFault: the device failed.
        """
        if not self.device.tripped or cause is not StopCause.NODE:
            self.device.quiet(reason, cause=cause)
        if not self.lockstep or not self.running or self.device.is_quiet:
            return
        yield from self._ramp_blocks()
        yield self.produce()

    def _ramp_blocks(self) -> Iterator[list[SampleBlock]]:
        period = self.device.block_samples / self.device.sample_rate
        blocks = 0
        while not self.device.is_quiet and blocks * period < _LONGEST_RAMP:
            yield self.produce()
            blocks += 1

    def shut_down(self, reason: str) -> None:
        """Take the drive to zero along its ramp, whatever its blocks were, and release the device."""
        device = self.device
        try:
            if device.state is DeviceState.RUNNING and not device.is_quiet:
                device.quiet(reason, cause=StopCause.NODE)
                blocks = int(_LONGEST_END * device.sample_rate / device.block_samples)
                while blocks > 0 and not device.is_quiet:
                    device.read()
                    blocks -= 1
        finally:
            device.close()
