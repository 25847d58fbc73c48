"""Sweep and stepped sine: the frequency is given, the amplitude of the fundamental is held."""

from __future__ import annotations

import math
from enum import Enum, auto
from typing import ClassVar

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import SampleBlock
from nmt_core.messages.records import LevelCommand
from nmt_core.numerics.ramp import half_cosine
from nmt_core.vocabulary import ControlKind, LoopState, TestKind, Waveform
from nmt_pll.amplitude.held_amplitude import ForceHolder, ResponseHolder, turn
from nmt_pll.detection.lock import Dwell
from nmt_pll.detection.phase_detector import AdaptiveFourierFilter
from nmt_pll.level_loop import LevelLoop, LockWindow, LoopOutput
from nmt_pll.loop_settings import LoopSettings
from nmt_pll.thresholds import SWEEPS


class _Stage(Enum):
    """What the loop does at a level."""

    FADE = auto()  # the old frequency goes to zero amplitude
    LISTEN = auto()  # the drive is at rest: noise of the amplitudes
    PROBE = auto()  # the voltage grows until the amplitude stands out of the noise
    APPROACH = auto()  # the target goes along a half-cosine to its value
    SETTLE = auto()  # amplitudes and phase become stationary
    WINDOW = auto()  # locked: the window, and what follows until the next level


class _GivenFrequencyLoop(LevelLoop):
    """What sweep and stepped sine share.

    Args:
        drive_point: measurement point of the exciter.
        settings: loop settings; cut-off (0 = 0.15 of the frequency), harmonics, floors, tolerances, dwell and limit.
        sample_rate: Hz.
        block_samples: samples a block.
    """

    def __init__(self, drive_point: int, settings: LoopSettings, sample_rate: float, block_samples: int) -> None:
        super().__init__(drive_point, sample_rate, block_samples, settings.quiet_ramp)
        self.settings = settings
        self._delay = settings.latency_blocks * block_samples
        self._stage = _Stage.LISTEN
        self._until = 0
        self._frequency = 0.0
        self._rate = 0.0
        self._frequency_end = 0.0
        self._moves_from = 0
        self._moves_for = 0
        self._target_from = 0.0
        self._target_since = 0
        self._noise: list[float] = []
        self._good_until = 0
        self._reference: complex | None = None
        self._prepare(0.25 * sample_rate)

    def _prepare(self, frequency_hz: float) -> None:
        """Filter, controllers and dwell for a frequency, Hz."""
        settings = self.settings
        most = 0.9 * self.sample_rate / (2.0 * settings.harmonics + 1.0)
        self.cutoff = min(settings.cutoff or SWEEPS.filter_cutoff_ratio * 2.0 * math.pi * frequency_hz, most)
        self.filter = AdaptiveFourierFilter(2, settings.harmonics, self.cutoff, self.sample_rate)
        self.force_holder = ForceHolder(self.cutoff, self.block_duration, settings.latency_blocks)
        self.response_holder = ResponseHolder(self.cutoff, self.block_duration, settings.latency_blocks)
        time = max(settings.dwell_periods / frequency_hz, SWEEPS.shortest_dwell_s)
        length = math.ceil(time / self.block_duration)
        correlation = 2.0 / (self.cutoff * self.block_duration)
        self.dwell = Dwell(length, correlation)
        self.phase_dwell = Dwell(length, correlation)

    def _check_control(self, level: LevelCommand) -> None:
        if level.control not in (ControlKind.VOLTAGE, ControlKind.RESPONSE, ControlKind.FORCE):
            raise BenchError(
                f"Level {level.index}: control {level.control} is not known; use voltage, response or force."
            )
        highest = max(level.frequency_hz, level.frequency_end_hz)
        if level.amplitude > 0 and not (level.frequency_hz > 0 and highest < 0.5 * self.sample_rate):
            raise BenchError(
                f"Level {level.index}: a {level.test.label} needs frequencies between 0 and half the sample rate, "
                f"got {level.frequency_hz:g} and {level.frequency_end_hz:g} Hz."
            )

    # -- one block -----------------------------------------------------------------------------------------------

    def process(self, force: SampleBlock, response: SampleBlock) -> LoopOutput:
        """Answer one block of force and drive-point response.

        Raises:
            ValueError: the blocks do not cover the same samples.
        """
        rows = self._drive_point_rows(force, response)
        end = force.end_sample
        flags = force.flags | response.flags
        phasors = self._measure(force, np.stack(rows))
        if self.machine.state not in (LoopState.ACQUIRING, LoopState.LOCKED):
            self._quiet_reason = ""
        taken = self.force_holder.observe(*phasors, self._commanded) if self._stage != _Stage.LISTEN else 0j
        self._start_due_levels(force.first_sample, end)
        lock = None
        if self.machine.state in (LoopState.ACQUIRING, LoopState.LOCKED):
            reason = self._stopped_from_outside(flags) or self._work_reason(phasors, taken, end)
            if reason:
                self._give_up(end, reason)
            else:
                lock = self._judge(phasors, end)
        self._commanded = self._amplitude
        return self._answer(end, phasors, lock, flags)

    _commanded = 0.0

    def _measure(self, force: SampleBlock, data: np.ndarray) -> tuple[complex, complex]:
        """Complex fundamentals of force and response at the end of the block."""
        phase = force.oscillator
        if math.isnan(phase.cycles) or not phase.frequency_hz > 0:
            # No periodic excitation yet: the noise at the frequency to come.
            if not self._frequency > 0:
                return 0j, 0j
            start = math.fmod(force.first_sample * self._frequency / self.sample_rate, 1.0)
            coefficients = self.filter.process(data, start, self._frequency)
        else:
            coefficients = self.filter.process(data, phase.cycles, phase.frequency_hz, phase.rate_hz_s)
        values = complex(coefficients[0, 1]), complex(coefficients[1, 1])
        if not all(math.isfinite(abs(value)) for value in values):
            self.filter.reset()
            return 0j, 0j
        return values

    def _answer(self, end: int, phasors: tuple[complex, complex], lock: LockWindow | None, flags: int) -> LoopOutput:
        apply = end + self._delay
        frequency = self._frequency_at(apply)
        output = self._output(end, 2.0 * math.pi * frequency, math.nan, (abs(phasors[0]), abs(phasors[1])), lock, flags)
        moving = self._moves_for > 0 and self._moves_from <= apply < self._moves_from + self._moves_for
        if not moving:
            return output._replace(frequency_hz=frequency, waveform=Waveform.SINE)
        return output._replace(
            frequency_hz=frequency,
            waveform=Waveform.SWEEP,
            rate_hz_s=self._rate,
            frequency_end_hz=self._frequency_end,
        )

    def _frequency_at(self, sample: int) -> float:
        """Commanded frequency at a sample, Hz."""
        if self._moves_for == 0 or sample <= self._moves_from:
            return self._frequency
        if sample >= self._moves_from + self._moves_for:
            return self._frequency_end
        return self._frequency + self._rate * (sample - self._moves_from) / self.sample_rate

    def _move(self, first: int, rate: float, frequency_end: float) -> int:
        """Let the frequency go to another from a sample on; number of samples that takes."""
        self._rate, self._frequency_end, self._moves_from = rate, frequency_end, first
        self._moves_for = math.ceil(abs((frequency_end - self._frequency) / rate) * self.sample_rate)
        return self._moves_for

    def _stop_moving(self, end: int) -> None:
        self._frequency = self._frequency_at(end + self._delay)
        self._moves_for = 0

    # -- levels --------------------------------------------------------------------------------------------------

    def _start(self, level: LevelCommand, end: int, was_quiet: bool) -> None:
        self._stop_moving(end)
        self._deadline = math.inf
        near = abs(level.frequency_hz / self._frequency - 1.0) <= self._glide if self._frequency > 0 else False
        if was_quiet:
            self._listen(level, end)
        elif near and self._stage in (_Stage.SETTLE, _Stage.WINDOW, _Stage.APPROACH):
            self._approach(level, end)
        else:
            self._fade(level, end)

    _glide = 0.0
    """Largest relative change of frequency between levels without a stop."""

    def _fade(self, level: LevelCommand, end: int) -> None:
        self._stage = _Stage.FADE
        self._until = end + self._delay + math.ceil(level.ramp * self.sample_rate)
        self._amplitude, self._ramp = 0.0, level.ramp

    def _listen(self, level: LevelCommand, end: int) -> None:
        self._stage = _Stage.LISTEN
        self._amplitude = 0.0
        self._frequency = level.frequency_hz
        self._prepare(level.frequency_hz)
        self._noise = []
        self._until = end + math.ceil((5.0 / self.cutoff) * self.sample_rate) + 5 * self._block_samples

    def _approach(self, level: LevelCommand, end: int) -> None:
        self._stage = _Stage.APPROACH
        self._target_since = end
        self._target_from = self.held
        ramp = max(level.ramp, self.block_duration)
        self._until = end + math.ceil(ramp * self.sample_rate)
        if level.frequency_hz != self._frequency:
            self._move(end + self._delay, (level.frequency_hz - self._frequency) / ramp, level.frequency_hz)
        self._set_deadline(level, self._until)

    def _set_deadline(self, level: LevelCommand, sample: int) -> None:
        self._deadline = sample + level.timeout * self.sample_rate if level.timeout else math.inf

    _held = 0.0
    """Newest value of the held amplitude."""

    def _target(self, level: LevelCommand, end: int) -> float:
        """Present target of the held amplitude; on its way along a half-cosine while approaching."""
        if self._stage != _Stage.APPROACH:
            return level.amplitude
        share = (end - self._target_since) / max(1, self._until - self._target_since)
        weight = float(half_cosine(np.array([min(share, 1.0)]))[0])
        return self._target_from + (level.amplitude - self._target_from) * weight

    # -- control -------------------------------------------------------------------------------------------------

    def _work_reason(self, phasors: tuple[complex, complex], taken: complex, end: int) -> str:
        """One block of work on the level; why it has to be given up, empty if it goes on."""
        level = self._level
        assert level is not None
        self.held = {
            ControlKind.FORCE: abs(phasors[0]),
            ControlKind.RESPONSE: abs(phasors[1]),
            ControlKind.VOLTAGE: self._commanded,
        }[ControlKind(level.control)]
        if self._stage == _Stage.FADE:
            if end < self._until:
                return ""
            self._listen(level, end)
            self.force_holder.clear()
        if self._stage == _Stage.LISTEN:
            return self._listen_on(level, phasors, end)
        if self._stage == _Stage.PROBE:
            return self._probe(level, phasors, end)
        self._ramp = self.block_duration
        target = self._target(level, end)
        if level.control == ControlKind.FORCE:
            wanted = self.force_holder.voltage(self._amplitude, target, phasors[0], taken)
        elif level.control == ControlKind.RESPONSE:
            wanted = self.response_holder.voltage(self._amplitude, target, phasors[1])
        else:
            wanted = target
        self._amplitude = wanted
        if self._stage == _Stage.APPROACH and end >= self._until:
            self._stage = _Stage.SETTLE
            self._stop_moving(end)
            self.dwell.clear()
            self.phase_dwell.clear()
            self._reference = None
            self._good_until = end
            self._until = end + math.ceil(2.0 / self.cutoff * self.sample_rate)
        return self.refusal(level, phasors, end)

    def _listen_on(self, level: LevelCommand, phasors: tuple[complex, complex], end: int) -> str:
        """Wait until the structure rests: the residual then is noise."""
        self._noise = [*self._noise[-4:], self.held]
        self.force_holder.listen(*phasors)
        if end < self._until:
            return ""
        noise = max(self._noise)
        if 2.0 * SWEEPS.probe_noise_ratio * noise > level.amplitude:
            if end < self._until + SWEEPS.longest_rest_s * self.sample_rate:
                return ""
            return (
                f"the target amplitude {level.amplitude:g} is within 2 x {SWEEPS.probe_noise_ratio:g} times what is "
                f"measured with the drive at rest ({noise:.2g}): noise, or a structure that does not come to rest"
            )
        self._ramp = self.block_duration
        if level.control == ControlKind.VOLTAGE:
            self.held = 0.0
            self._approach(level, end)
            self._amplitude = min(SWEEPS.probe_voltage_v, level.amplitude)
        else:
            self._stage = _Stage.PROBE
            self._amplitude = SWEEPS.probe_voltage_v
            self._set_deadline(level, end)
        return ""

    def _probe(self, level: LevelCommand, phasors: tuple[complex, complex], end: int) -> str:
        floor = self.settings.force_floor if level.control == ControlKind.FORCE else self.settings.response_floor
        wanted = max(SWEEPS.probe_noise_ratio * max(self._noise, default=0.0), floor)
        if self.held >= min(wanted, 0.5 * level.amplitude):
            self._approach(level, end)
            return ""
        self._amplitude *= math.exp(SWEEPS.probe_log_growth)
        return self.refusal(level, phasors, end)

    def refusal(self, level: LevelCommand, phasors: tuple[complex, complex], end: int) -> str:
        """Why the level has to be given up, empty if it need not."""
        limit = self.settings.voltage_limit
        if limit > 0 and self._amplitude > limit:
            return (
                f"the drive would need more than {limit:g} V at {self._frequency_at(end):.2f} Hz "
                f"(held amplitude {self.held:.3g} of {level.amplitude:g})"
            )
        if end > self._deadline and self.machine.state == LoopState.ACQUIRING:
            return f"no stationary amplitude within the time-out: {self._obstacle(level) or 'still approaching'}"
        if self._stage == _Stage.WINDOW and level.control != ControlKind.VOLTAGE:
            if self.held > 0 and abs(math.log(self.held / level.amplitude)) < SWEEPS.lost_log_deviation:
                self._good_until = end
            elif end - self._good_until > SWEEPS.lost_duration_s * self.sample_rate:
                return (
                    f"the held amplitude is {self.held:.3g} instead of {level.amplitude:g} at "
                    f"{self._frequency_at(end):.2f} Hz"
                )
        if self._stage in (_Stage.SETTLE, _Stage.WINDOW) and abs(phasors[0]) < self.settings.force_floor:
            return "the force fell below its amplitude floor"
        return ""

    # -- judgement -----------------------------------------------------------------------------------------------

    def _judge(self, phasors: tuple[complex, complex], end: int) -> LockWindow | None:
        """Add a block to the dwell; the window once everything is stationary."""
        level = self._level
        if self._stage != _Stage.SETTLE or end < self._until or level is None or 0j in phasors:
            return None
        ratio = phasors[1] / phasors[0]
        self._reference = self._reference or ratio
        deviation = math.log(self.held / level.amplitude) if self.held > 0 else -math.inf
        self.dwell.add(deviation, abs(phasors[0]), abs(phasors[1]))
        self.phase_dwell.add(0.0, 1.0 + turn(ratio, self._reference), 1.0)
        if not self.dwell.full or self._obstacle(level):
            return None
        reason = f"held amplitude {100.0 * self.dwell.statistics().mean:+.3f} % off its target, everything stationary"
        self._stage = _Stage.WINDOW
        self._good_until = end
        return self._open(level, end, reason)

    def _obstacle(self, level: LevelCommand) -> str:
        """What is not stationary yet, empty if everything is."""
        if not self.dwell.full:
            return "too short since the amplitude reached its target" if self._stage == _Stage.SETTLE else ""
        s, p, tolerance = self.dwell.statistics(), self.phase_dwell.statistics(), self.settings.amplitude_tolerance
        if level.control != ControlKind.VOLTAGE and abs(s.mean) > tolerance + 2.0 * s.mean_std:
            return f"the held amplitude is {100.0 * math.expm1(s.mean):.2f} % off its target"
        if abs(s.frequency_drift) > tolerance + 2.0 * s.frequency_drift_std:
            return f"the force drifts by {100.0 * s.frequency_drift:.2f} % over the dwell"
        if abs(s.amplitude_drift) > tolerance + 2.0 * s.amplitude_drift_std:
            return f"the response drifts by {100.0 * s.amplitude_drift:.2f} % over the dwell"
        if abs(p.frequency_drift) > self.settings.phase_tolerance + 2.0 * p.frequency_drift_std:
            return f"the phase drifts by {math.degrees(p.frequency_drift):.2f} deg over the dwell"
        return ""

    def _open(self, level: LevelCommand, end: int, reason: str) -> LockWindow | None:
        raise NotImplementedError


class SweepLoop(_GivenFrequencyLoop):
    """Slow sine sweep at a held amplitude of force, response or voltage.

    The amplitude settles at the start frequency; then the loop reports LOCKED, names the window of the whole sweep
    and lets the plant's oscillator sweep. Between two sweeps the drive goes to zero.
    """

    KINDS: ClassVar[tuple[TestKind, ...]] = (TestKind.SWEEP,)

    def _check_control(self, level: LevelCommand) -> None:
        super()._check_control(level)
        way = level.frequency_end_hz - level.frequency_hz
        if level.amplitude > 0 and not (
            level.frequency_end_hz > 0 and math.isfinite(level.rate_hz_s) and way * level.rate_hz_s > 0
        ):
            raise BenchError(
                f"Level {level.index}: a sweep from {level.frequency_hz:g} to {level.frequency_end_hz:g} Hz needs two "
                f"different frequencies and a rate in that direction, got {level.rate_hz_s:g} Hz/s."
            )

    def _open(self, level: LevelCommand, end: int, reason: str) -> LockWindow | None:
        self.machine.lock(end, reason)
        first = end + self._delay
        samples = self._move(first, level.rate_hz_s, level.frequency_end_hz)
        return LockWindow(level, end - 1, level.frequency_hz, math.nan, first, samples, 0)


class SteppedSineLoop(_GivenFrequencyLoop):
    """Steady sine at given frequencies with a held amplitude; a window of whole periods at each.

    From one frequency to a near one the oscillator glides within the level's ramp, the amplitude being held; to a
    distant one the drive goes to zero in between.
    """

    KINDS: ClassVar[tuple[TestKind, ...]] = (TestKind.STEPPED_SINE,)
    _glide = SWEEPS.glide_frequency_step

    def _open(self, level: LevelCommand, end: int, reason: str) -> LockWindow | None:
        window = self._lock(end, 2.0 * math.pi * level.frequency_hz, math.nan, reason)
        return window
