"""Random excitation of a level: no loop is closed, but levels, windows and stops are those of the loops."""

from __future__ import annotations

import math
from typing import ClassVar

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import SampleBlock
from nmt_core.messages.records import DriveTerm, LevelCommand
from nmt_core.vocabulary import ControlKind, LoopState, TestKind, Waveform
from nmt_pll.level_loop import LevelLoop, LockWindow, LoopOutput


class RandomDrive(LevelLoop):
    """Band-limited random voltage of a given rms; the window opens when ramp and settling time are over.

    The amplitudes that it reports are the rms of force and response over the block.

    Args:
        drive_point: measurement point of the exciter.
        sample_rate: Hz.
        block_samples: samples a block.
        quiet_ramp: half-cosine to zero after a stop, s.
        settling_time: between the end of the ramp and the window, s.
        latency_blocks: blocks of buffering between command and excitation.
        exciters: number of exciters, each with a noise of its own.
    """

    KINDS: ClassVar[tuple[TestKind, ...]] = (TestKind.RANDOM,)

    def __init__(
        self,
        drive_point: int,
        sample_rate: float,
        block_samples: int,
        quiet_ramp: float = 0.5,
        settling_time: float = 2.0,
        latency_blocks: int = 0,
        exciters: int = 1,
    ) -> None:
        super().__init__(drive_point, sample_rate, block_samples, quiet_ramp)
        self.settling_time = settling_time
        self._terms = tuple(DriveTerm(number, 1, 1.0 + 0j) for number in range(2, exciters + 1))
        self._delay = latency_blocks * block_samples
        self._settled_from = 0
        self._band = (0.0, 0.0)

    def process(self, force: SampleBlock, response: SampleBlock) -> LoopOutput:
        """Answer one block of force and drive-point response.

        Raises:
            ValueError: the blocks do not cover the same samples.
        """
        rows = self._drive_point_rows(force, response)
        end, flags = force.end_sample, force.flags | response.flags
        if self.machine.state not in (LoopState.ACQUIRING, LoopState.LOCKED):
            self._quiet_reason = ""
        self._start_due_levels(force.first_sample, end)
        lock = None
        if self.machine.state in (LoopState.ACQUIRING, LoopState.LOCKED):
            reason = self._stopped_from_outside(flags)
            if reason:
                self._give_up(end, reason)
            elif self.machine.state == LoopState.ACQUIRING and end >= self._settled_from:
                lock = self._open_random_window(end)
        amplitudes = tuple(math.sqrt(float(row @ row) / row.size) for row in rows)
        output = self._output(end, 0.0, math.nan, (amplitudes[0], amplitudes[1]), lock, flags)
        if not output.amplitude > 0.0:
            return output
        low, high = self._band
        return output._replace(waveform=Waveform.RANDOM, band_low_hz=low, band_high_hz=high, terms=self._terms)

    def _check_control(self, level: LevelCommand) -> None:
        if level.control != ControlKind.VOLTAGE:
            raise BenchError(f"Level {level.index}: a random drive has levels of voltage (V rms) only.")
        if level.amplitude == 0.0:
            return
        if not 0.0 < level.band_low_hz < level.band_high_hz < 0.5 * self.sample_rate:
            raise BenchError(
                f"Level {level.index}: the random band of {level.band_low_hz:g} to {level.band_high_hz:g} Hz must lie "
                f"between 0 and half the sample rate, {0.5 * self.sample_rate:g} Hz."
            )
        if not 0.0 < level.duration < math.inf:
            raise BenchError(f"Level {level.index}: a random window needs a duration above 0 s, got {level.duration}.")

    def _start(self, level: LevelCommand, end: int, was_quiet: bool) -> None:
        self._amplitude = level.amplitude
        self._band = (level.band_low_hz, level.band_high_hz)
        wait = level.ramp + self.settling_time
        self._settled_from = end + self._delay + math.ceil(wait * self.sample_rate)

    def _open_random_window(self, end: int) -> LockWindow:
        level = self._level
        assert level is not None
        self.machine.lock(end, f"ramp and settling time of {self.settling_time:g} s are over")
        samples = max(1, round(level.duration * self.sample_rate))
        return LockWindow(level, end - 1, 0.0, math.nan, end, samples, 0)
