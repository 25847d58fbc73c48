"""What the loops of the bench share: levels to work on, the answer to a block, how they are stopped."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import BlockFlag, SampleBlock
from nmt_core.messages.records import DriveTerm, LevelCommand
from nmt_core.numerics.arrays import FloatArray
from nmt_core.vocabulary import ControlKind, LoopState, TestKind, Waveform
from nmt_pll.detection.lock import LockStateMachine, Transition


@dataclass(frozen=True, slots=True)
class LockWindow:
    """A lock and the window it opens; as ``nmt_msgs/LockEvent``."""

    level: LevelCommand
    sample: int
    frequency_hz: float
    phase_error: float
    first_sample: int
    samples: int
    periods: int


class LoopOutput(NamedTuple):
    """Answer of the loop to one block.

    Attributes:
        last_sample: last sample it is based on.
        frequency_hz: frequency for the next block; 0 with the drive off.
        amplitude: drive amplitude for the next block, V.
        ramp: half-cosine duration for a change of amplitude, s.
        state: loop state.
        phase_error: rad, NaN if not valid.
        force_amplitude: N; response_amplitude: unit of the response.
        level: level worked on, None before the first.
        lock: set with the block in which lock was confirmed.
        transition: set with the block in which the state changed.
        flags: flags of the blocks.
        waveform: of the drive while its amplitude is not zero.
        rate_hz_s: SWEEP: rate of the frequency from the next block on, Hz/s.
        frequency_end_hz: SWEEP: where it ends, Hz.
        band_low_hz, band_high_hz: RANDOM: band of the noise, Hz.
        terms: of the drive next to its fundamental at exciter 1, as in `DriveCommand`.
    """

    last_sample: int
    frequency_hz: float
    amplitude: float
    ramp: float
    state: LoopState
    phase_error: float
    force_amplitude: float
    response_amplitude: float
    level: LevelCommand | None
    lock: LockWindow | None
    transition: Transition | None
    flags: int
    waveform: Waveform = Waveform.SINE
    rate_hz_s: float = 0.0
    frequency_end_hz: float = 0.0
    band_low_hz: float = 0.0
    band_high_hz: float = 0.0
    terms: tuple[DriveTerm, ...] = ()


class LevelLoop(ABC):
    """A loop that works through levels, one block at a time.

    Args:
        drive_point: measurement point of the exciter.
        sample_rate: Hz.
        block_samples: samples a block.
        quiet_ramp: half-cosine to zero after a lost lock, s.

    Attributes:
        machine: lock state machine.
        newest_sequence: sequence number of the newest level received.
    """

    KINDS: ClassVar[tuple[TestKind, ...]] = (TestKind.PHASE_RESONANCE,)
    """Kinds of test the loop can do."""

    def __init__(self, drive_point: int, sample_rate: float, block_samples: int, quiet_ramp: float) -> None:
        self.drive_point = drive_point
        self.sample_rate = sample_rate
        self.block_duration = block_samples / sample_rate
        self.machine = LockStateMachine()
        self.newest_sequence = 0
        self._block_samples = block_samples
        self._quiet_ramp = quiet_ramp
        self._levels: list[LevelCommand] = []
        self._level: LevelCommand | None = None
        self._amplitude = 0.0
        self._ramp = quiet_ramp
        self._deadline: float = math.inf
        self._quiet_reason = ""
        self._limited_since: int | None = None  # since when the drive has stood at the voltage limit
        self._rejected: dict[int, str] = {}

    def set_level(self, level: LevelCommand) -> None:
        """Take a level to be worked on from its ``apply_at_sample`` on.

        Raises:
            BenchError: test kind, amplitude, ramp or control are not usable.
        """
        if level.test not in self.KINDS:
            raise BenchError(f"Level {level.index}: this loop has no {level.test.label} test.")
        if not (math.isfinite(level.amplitude) and level.amplitude >= 0):
            raise BenchError(f"Level {level.index}: the amplitude must be finite and >= 0, got {level.amplitude}.")
        if not (math.isfinite(level.ramp) and level.ramp >= 0):
            raise BenchError(f"Level {level.index}: the ramp must be finite and >= 0 s, got {level.ramp}.")
        self._check_control(level)
        self._take(level)

    def reject(self, level: LevelCommand, reason: str) -> None:
        """Answer a level that :meth:`set_level` refuses by a lost lock with this reason, at its sample."""
        self._rejected[level.sequence] = reason
        self._take(level)

    def _take(self, level: LevelCommand) -> None:
        self._levels.append(level)
        self._levels.sort(key=lambda item: (item.apply_at_sample, item.sequence))
        self.newest_sequence = max(self.newest_sequence, level.sequence)

    def quiet(self, reason: str) -> None:
        """Take the drive to zero from the next block on; a lost lock with this reason."""
        self._quiet_reason = reason

    def warm_up_data(self) -> FloatArray:
        """A silent block of force and response, for compiling before the first real one; (2, samples)."""
        return np.zeros((2, self._block_samples))

    @abstractmethod
    def process(self, force: SampleBlock, response: SampleBlock) -> LoopOutput:
        """Answer one block of force and drive-point response.

        Raises:
            ValueError: the blocks do not cover the same samples, or the response is not what the loop controls.
        """

    @abstractmethod
    def _check_control(self, level: LevelCommand) -> None:
        """Refuse (BenchError) a level whose control the loop does not have."""

    @abstractmethod
    def _start(self, level: LevelCommand, end: int, was_quiet: bool) -> None:
        """Begin to work on a level of positive amplitude; ``end`` is the sample after the present block."""

    def _start_due_levels(self, first: int, end: int) -> None:
        """Begin the levels whose ``apply_at_sample`` this block, starting at ``first``, has reached."""
        while self._levels and self._levels[0].apply_at_sample <= first:
            level = self._levels.pop(0)
            same_level = self._level is not None and self._level.index == level.index
            was_quiet = self._amplitude == 0.0
            self._level = level
            if level.sequence in self._rejected:
                self.machine.acquire(end, f"level {level.index} starts")
                self._give_up(end, self._rejected.pop(level.sequence))
                continue
            self._ramp = level.ramp
            if level.amplitude > 0.0:
                self._start(level, end, was_quiet)
                self.machine.acquire(end, f"level {level.index} starts")
                continue
            self._end_excitation(level, end)
            if self.machine.state != LoopState.LOCK_LOST or not same_level:
                self.machine.fix(end, "the drive goes to zero")

    def _end_excitation(self, level: LevelCommand, end: int) -> None:
        """Begin with a level of amplitude zero."""
        self._amplitude = 0.0

    def _drive_point_rows(self, force: SampleBlock, response: SampleBlock) -> tuple[FloatArray, FloatArray]:
        """Samples of force and response at the drive point, (samples,) each; ValueError if they do not pair."""
        if force.first_sample != response.first_sample or force.samples != response.samples:
            raise ValueError("force and response blocks do not cover the same samples")
        return force.data[self._row(force)], response.data[self._row(response)]

    def _row(self, block: SampleBlock) -> int:
        """Row of the drive point's channel; the only channel where there is but one."""
        if len(block.points) == 1:
            return 0
        try:
            return block.points.index(self.drive_point)
        except ValueError:
            raise ValueError(f"no {block.quantity.topic} channel at the drive point {self.drive_point}") from None

    def _stopped_from_outside(self, flags: int) -> str:
        """Why the drive has to go to zero whatever the phase says; empty if it need not."""
        if self._quiet_reason:
            reason, self._quiet_reason = self._quiet_reason, ""
            return reason
        if not flags:
            return ""
        if flags & BlockFlag.LIMIT:
            return "a safety limit has tripped"
        if flags & BlockFlag.WATCHDOG:
            return "the plant has taken the drive to zero by itself"
        if flags & BlockFlag.STOP:
            return "the drive was stopped at the plant"
        return ""

    def _beyond_the_limit(self, limit: float, patience: int, end: int) -> str:
        """Keep the drive at the rig's voltage limit, which the plant refuses to pass; why the level has to be given up.

        Args:
            limit: V, 0 = none.
            patience: samples that the drive may stand at the limit: an amplitude that is controlled overshoots.
            end: sample after the present block.

        Returns:
            Empty if the level goes on.
        """
        level = self._level
        if level is None or level.control == ControlKind.VOLTAGE or not 0.0 < limit <= self._amplitude:
            self._limited_since = None
            return ""
        self._amplitude = limit
        if self._limited_since is None:
            self._limited_since = end
        if end - self._limited_since <= patience:
            return ""
        return f"the drive would need more than the voltage limit of {limit:g} V; lower the level"

    def _give_up(self, end: int, reason: str) -> None:
        self.machine.lose(end, reason)
        self._amplitude = 0.0
        self._limited_since = None
        self._ramp = self._quiet_ramp

    def _lock(self, end: int, omega: float, error: float, reason: str) -> LockWindow | None:
        """Confirm the lock; the window it opens from ``end`` on, if the level asks for one."""
        self.machine.lock(end, reason)
        level = self._level
        if level is None or level.window_periods == 0:
            return None
        frequency = omega / (2.0 * math.pi)
        samples = round(level.window_periods * self.sample_rate / frequency)
        return LockWindow(level, end - 1, frequency, error, end, samples, level.window_periods)

    def _output(
        self,
        end: int,
        omega: float,
        error: float,
        amplitudes: tuple[float, float],
        lock: LockWindow | None,
        flags: int,
    ) -> LoopOutput:
        return LoopOutput(
            last_sample=end - 1,
            frequency_hz=omega / (2.0 * math.pi),
            amplitude=max(self._amplitude, 0.0),
            ramp=self._ramp,
            state=self.machine.state,
            phase_error=error,
            force_amplitude=amplitudes[0],
            response_amplitude=amplitudes[1],
            level=self._level,
            lock=lock,
            transition=self.machine.take_transition(),
            flags=flags,
        )
