"""The phase-locked loop: detector, controllers and lock logic, one block at a time."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import OscillatorPhase, Quantity, SampleBlock
from nmt_core.messages.linear_description import LinearDescription
from nmt_core.messages.records import LevelCommand
from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_core.vocabulary import AUTOMATIC, MOTIONS, VELOCITY_LEAD, ControlKind, HarmonicsTarget, LoopState, TestKind
from nmt_pll.amplitude.response_control import ResponseController
from nmt_pll.detection.lock import Dwell, LockCriteria
from nmt_pll.detection.phase_detector import AdaptiveFourierFilter, phase_error
from nmt_pll.harmonics.harmonics_control import (
    ForcePerVolt,
    HarmonicsController,
    HarmonicSetup,
    most_harmonics,
    table_of,
)
from nmt_pll.harmonics.harmonics_target import ModalPowerRatio, check_modes
from nmt_pll.level_loop import LevelLoop, LockWindow, LoopOutput
from nmt_pll.loop_settings import LoopSettings
from nmt_pll.phase_loop.controller import AmplitudeController, FrequencyController, GainSchedule
from nmt_pll.phase_loop.gains import LoopPlant
from nmt_pll.thresholds import HARMONICS, PHASE


class PhaseLockedLoop(LevelLoop):
    """Adaptive Fourier filter, scheduled PI controller and lock state machine.

    A level of a ring-down test is switched off at its lock; it counts as locked while the structure decays, and the
    oscillator goes on at the locked frequency as the reference of the phase.

    Args:
        linear: linear description of the rig.
        settings: loop settings.
        sample_rate: Hz.
        block_samples: samples a block.
        force_per_volt: force per volt of drive at a frequency, N/V, as far as it is known; for control of harmonics.

    Attributes:
        harmonics: controller of the force's harmonics; None until a level asks for it.
    """

    KINDS: ClassVar[tuple[TestKind, ...]] = (TestKind.PHASE_RESONANCE, TestKind.RING_DOWN)

    def __init__(
        self,
        linear: LinearDescription,
        settings: LoopSettings,
        sample_rate: float,
        block_samples: int,
        force_per_volt: ForcePerVolt | None = None,
    ) -> None:
        super().__init__(linear.drive_point, sample_rate, block_samples, settings.quiet_ramp)
        self.linear = linear
        self.settings = settings
        self.cutoff = settings.resolved_cutoff(linear)
        self.filter = AdaptiveFourierFilter(2, settings.harmonics, self.cutoff, sample_rate)
        dead_time = (PHASE.dead_time_blocks + settings.latency_blocks) * self.block_duration
        self.plant = LoopPlant.from_description(linear)
        self.schedule = GainSchedule(self.plant, settings, self.cutoff, dead_time)
        mode = linear.frequencies_rad_s[linear.target_mode]
        self.controller = FrequencyController(
            2.0 * math.pi * settings.start_frequency_hz or mode, settings.guard_low * mode, settings.guard_high * mode
        )
        self.start_frequency = self.controller.output
        self.amplitude_controller = AmplitudeController(self.schedule.amplitude_bandwidth)
        self.response_controller = ResponseController()
        self.criteria = LockCriteria(
            settings.phase_tolerance,
            settings.frequency_tolerance,
            settings.amplitude_tolerance,
            settings.scatter_limit,
            settings.unlock_tolerance,
        )
        dwell_time = settings.dwell_periods * 2.0 * math.pi / mode
        self.dwell = Dwell(math.ceil(dwell_time / self.block_duration), 2.0 / (self.cutoff * self.block_duration))
        self.decay = self.plant.structure_decay
        self._response_quantity = Quantity.DISPLACEMENT
        self._closed_from = 0
        self._judged_from = 0
        self._running_from = 0
        self._bound_since: int | None = None
        self._good_frequency = self.start_frequency
        self._deviation = 0.0
        self._decaying = False
        self._dead_time = dead_time
        self._force_per_volt = force_per_volt or table_of(())
        self.harmonics: HarmonicsController | None = None
        self._harmonic_filter: AdaptiveFourierFilter | None = None
        self._harmonics_target = HarmonicsTarget.ZERO
        self._ratio: ModalPowerRatio | None = None
        self._harmonics_from: float = 0  # sample from which on that filter has forgotten its start
        self._amplitude_before = 0.0
        self._motion = 0j  # fundamental of the response

    def _check_control(self, level: LevelCommand) -> None:
        if level.control not in (ControlKind.VOLTAGE, ControlKind.RESPONSE, ControlKind.FORCE):
            raise BenchError(
                f"Level {level.index}: control {level.control} is not known; use voltage, response or force."
            )
        if level.test is TestKind.RING_DOWN and level.amplitude > 0.0 and not 0.0 < level.duration < math.inf:
            raise BenchError(f"Level {level.index}: a ring-down needs a duration above 0 s, got {level.duration}.")
        if level.harmonics_control and level.harmonics_target == HarmonicsTarget.MODAL:
            self._check_modes(level)
        if level.harmonics_control > self._most_harmonics(level.harmonics_control):
            raise BenchError(
                f"Level {level.index}: harmonics of the force can be controlled up to "
                f"{self._most_harmonics(level.harmonics_control)} at this sample rate and cut-off of the filter, not "
                f"up to {level.harmonics_control}; ask for fewer, or for auto."
            )

    def _check_modes(self, level: LevelCommand) -> None:
        """Refuse (BenchError) the modal target where the linear description has too few modes."""
        check_modes(self.linear, f"Level {level.index}")

    def _most_harmonics(self, wanted: int) -> int:
        return most_harmonics(self.controller.high / (2.0 * math.pi), self.sample_rate, self.cutoff, wanted)

    def process(self, force: SampleBlock, response: SampleBlock) -> LoopOutput:
        """Answer one block of force and drive-point response (first channel of each).

        Raises:
            ValueError: the blocks do not cover the same samples, or the response is not a motion.
        """
        rows = self._drive_point_rows(force, response)
        end = force.end_sample
        flags = force.flags | response.flags
        present = force.oscillator.frequency_hz
        self._response_quantity = response.quantity
        error, force_amplitude, response_amplitude = self._measure(*rows, force.oscillator)
        lead = self.settings.held_lead(2.0 * math.pi * present)
        if lead != 0.0:  # the loop takes the phase it holds for phase resonance
            error = math.remainder(error + lead, 2.0 * math.pi)
        harmonics = self._force_harmonics(rows[0], response, force.oscillator)
        if self.machine.state not in (LoopState.ACQUIRING, LoopState.LOCKED):
            self._quiet_reason = ""  # the drive is at zero already; the next level is not to suffer for it
        self._start_due_levels(force.first_sample, end)
        lock = None
        state = self.machine.state
        controls = state in (LoopState.ACQUIRING, LoopState.LOCKED) and not self._decaying
        self._control_harmonics(harmonics, present, controls and not math.isnan(error) and end > self._closed_from, end)
        if self._decaying and state == LoopState.LOCKED:
            reason = self._stopped_from_outside(flags)
            if reason:
                self._give_up(end, reason)
        elif state in (LoopState.ACQUIRING, LoopState.LOCKED):
            valid = not math.isnan(error) and end > self._closed_from
            if valid:
                self._control(error, force_amplitude, response_amplitude, end)
            reason = self._reason_to_give_up(flags, end, valid)
            if reason:
                self._give_up(end, reason)
            elif valid and self._running_from and end >= self._running_from:
                self._running_from = 0
                lock = self._open_window(end, error, "the lock is carried on along the ramp")
            elif valid and end > self._judged_from:
                self.dwell.add(error, present, response_amplitude)
                if self.dwell.full:
                    lock = self._judge(end)
        amplitudes = force_amplitude, response_amplitude
        output = self._output(end, self.controller.output, error, amplitudes, lock, flags)
        if self.harmonics is None:
            return output
        before = self._amplitude_before if end <= self._judged_from else 0.0  # it may still be on its way down
        self.harmonics.fit(max(output.amplitude, before), self.controller.high / (2.0 * math.pi))
        return output._replace(terms=self.harmonics.terms(off=not self._harmonics_wanted))

    @property
    def _harmonics_wanted(self) -> bool:
        """Whether the present level asks for control of the force's harmonics."""
        return self._level is not None and self._level.harmonics_control != 0

    def _force_harmonics(self, force: FloatArray, response: SampleBlock, phase: OscillatorPhase) -> ComplexArray | None:
        """F_1 … F_H after the block (N), shape (1, H), where harmonics are controlled and the drive is periodic.

        Where their target is a ratio, the responses at the points of the linear description follow, (1 + points, H).
        """
        if self._harmonic_filter is None or math.isnan(phase.cycles) or not phase.frequency_hz > 0:
            return None
        rows = force[None, :]
        if self._ratio is not None:
            rows = np.concatenate([rows, response.data[self._ratio.rows(response.points)]])
        values = self._harmonic_filter.process(rows, phase.cycles, phase.frequency_hz, phase.rate_hz_s)
        if not np.isfinite(values).all():
            self._harmonic_filter.reset()
            self._harmonics_from = math.inf
            return None
        result: ComplexArray = values[:, 1:-1].copy()
        return result  # one harmonic more is tracked, so that it does not leak into the others

    @property
    def _harmonics_step(self) -> float:
        """Share by which a target that is measured follows in a block: as slowly as control itself."""
        return 1.0 if self.harmonics is None else min(1.0, self.harmonics.rate * self.block_duration)

    def _control_harmonics(self, force: ComplexArray | None, frequency_hz: float, controls: bool, end: int) -> None:
        """One block of control of the force's harmonics."""
        controller = self.harmonics
        if controller is None:
            return
        if math.isinf(self._harmonics_from):
            self._harmonics_from = end + self._filter_warm_up
        if self._amplitude == 0.0:
            controller.clear()
        elif force is None or not controls or not self._harmonics_wanted or end <= self._harmonics_from:
            controller.idle(off=not self._harmonics_wanted)
        else:
            if self._judged_from - self._block_samples < end <= self._judged_from:
                controller.restart_dwell()
            target = np.zeros(force.shape[1] - 1, complex)
            if self._ratio is not None:
                target = self._ratio.target(force[0], force[1:], self._response_quantity, self._harmonics_step)
            controller.update(force[0], self._motion, frequency_hz, self._amplitude, target)

    @property
    def _filter_warm_up(self) -> int:
        """Samples after which the filter of the harmonics has forgotten its start."""
        return round(5.0 / self.cutoff * self.sample_rate)

    def _prepare_harmonics(self, level: LevelCommand, end: int, was_quiet: bool) -> None:
        """Have a controller for the harmonics that a level asks for; what was learnt stays while they are as many."""
        warm_up = self._filter_warm_up
        if level.harmonics_control:
            wanted = level.harmonics_control
            highest = self._most_harmonics(HARMONICS.automatic_highest if wanted == AUTOMATIC else wanted)
            target = HarmonicsTarget(level.harmonics_target)
            if self.harmonics is None or self.harmonics.setup.highest != highest or target != self._harmonics_target:
                self._harmonics_target = target
                self._ratio = ModalPowerRatio(self.linear) if target is HarmonicsTarget.MODAL else None
                setup = HarmonicSetup(
                    highest,
                    self.cutoff,
                    self.block_duration,
                    self.settings.latency_blocks,
                    self._dead_time,
                    self.dwell.length,
                    self.settings.voltage_limit,
                    self.settings.slew_limit,
                    self.sample_rate,
                )
                self.harmonics = HarmonicsController(setup, self._force_per_volt)
                channels = 1 if self._ratio is None else 1 + len(self.linear.points)
                self._harmonic_filter = AdaptiveFourierFilter(channels, highest + 1, self.cutoff, self.sample_rate)
                self._harmonics_from = end + warm_up
        if self.harmonics is None or self._harmonic_filter is None:
            return
        if was_quiet:
            if self._ratio is not None:
                self._ratio.clear()
            self.harmonics.clear()
            self._harmonic_filter.reset()
            self._harmonics_from = end + warm_up
        self.harmonics.start_level()

    def _measure(self, force: FloatArray, response: FloatArray, phase: OscillatorPhase) -> tuple[float, float, float]:
        """Phase error (NaN if not valid), force amplitude and response amplitude after the block."""
        if math.isnan(phase.cycles) or not phase.frequency_hz > 0:
            return math.nan, 0.0, 0.0
        lead = VELOCITY_LEAD.get(self._response_quantity)
        if lead is None:
            raise ValueError(f"the response is {self._response_quantity.name.lower()}, not a motion")
        data = np.empty((2, force.size))
        data[0], data[1] = force, response
        coefficients = self.filter.process(data, phase.cycles, phase.frequency_hz, phase.rate_hz_s)
        fundamental = complex(coefficients[0, 1]), complex(coefficients[1, 1])
        force_amplitude, response_amplitude = abs(fundamental[0]), abs(fundamental[1])
        self._motion = fundamental[1]
        if not (math.isfinite(force_amplitude) and math.isfinite(response_amplitude)):
            self.filter.reset()
            return math.nan, 0.0, 0.0
        if force_amplitude < self.settings.force_floor or response_amplitude <= self.settings.response_floor:
            return math.nan, force_amplitude, response_amplitude
        return phase_error(fundamental[0], fundamental[1], lead), force_amplitude, response_amplitude

    def _start(self, level: LevelCommand, end: int, was_quiet: bool) -> None:
        if was_quiet:
            start = 2.0 * math.pi * level.frequency_hz or self._good_frequency
            self.controller.reset(start)
            self.filter.reset()
            self.decay = self.plant.structure_decay
        warm_up = 5.0 / self.cutoff if was_quiet else 0.0
        ramp_end = end + round(level.ramp * self.sample_rate)
        self._closed_from = end + round(max(warm_up, 0.5 * level.ramp if was_quiet else 0.0) * self.sample_rate)
        self._judged_from = max(ramp_end, self._closed_from) + round(2.0 / self.cutoff * self.sample_rate)
        self._deadline = self._judged_from + level.timeout * self.sample_rate if level.timeout else math.inf
        self._bound_since = None
        self._decaying = False
        # A lock carried on: the window opens during the ramp, and only then does the loop judge itself.
        self._running_from = 0
        if self.settings.ramp_delay_periods > 0 and self.machine.state == LoopState.LOCKED and not was_quiet:
            delay = self.settings.ramp_delay_periods * 2.0 * math.pi / self.controller.output
            self._running_from = self._judged_from = end + round(delay * self.sample_rate)
        self._amplitude_before = self._amplitude
        self._amplitude = self._start_voltage(level, was_quiet)
        if was_quiet:
            self.response_controller.start(self._amplitude)
        self.response_controller.aim(max(level.ramp, 2.0 / self.schedule.amplitude_bandwidth))
        self._prepare_harmonics(level, end, was_quiet)
        self.dwell.clear()
        self._deviation = 0.0

    def _start_voltage(self, level: LevelCommand, was_quiet: bool) -> float:
        """Drive voltage a level starts with; controlled amplitudes start from the linear estimate."""
        if level.control == ControlKind.VOLTAGE:
            return level.amplitude
        if not was_quiet:
            return self._amplitude
        per_volt = self.linear.displacement_per_volt
        if level.control == ControlKind.FORCE:
            per_volt = self.linear.force_per_volt
        else:
            per_volt *= self._per_displacement()
        return level.amplitude / per_volt if per_volt > 0 else 1.0e-3

    def _per_displacement(self) -> float:
        """Amplitude of the response quantity for a unit displacement at the present frequency."""
        return self.controller.output ** MOTIONS.get(self._response_quantity, 0)

    def _control(self, error: float, force: float, response: float, end: int) -> None:
        omega = self.controller.output
        displacement = response / self._per_displacement()
        decay = force * self.linear.drive_point_shape**2 * math.cos(error) / (2.0 * omega * displacement)
        weight = min(1.0, self.cutoff * self.block_duration)
        self.decay += weight * (min(max(decay, 0.0), 0.3 * omega) - self.decay)
        self.controller.update(error, self.schedule.gains(self.decay), self.block_duration)
        level = self._level
        if level is not None and level.control != ControlKind.VOLTAGE and end > self._closed_from:
            measured = force if level.control == ControlKind.FORCE else response
            if level.control == ControlKind.FORCE:
                self.amplitude_controller.bandwidth = self.schedule.force_bandwidth(self.decay)
                self._amplitude = self.amplitude_controller.update(
                    self._amplitude, level.amplitude, measured, self.block_duration
                )
            else:
                self._amplitude = self.response_controller.update(
                    level.amplitude,
                    measured,
                    self.schedule.amplitude_bandwidth,
                    self.schedule.plant_decay(self.decay),
                    self.block_duration,
                    error,
                )
            self._ramp = self.block_duration
            deviation = math.log(max(measured, 1e-300) / level.amplitude)
            self._deviation += 2.0 / self.dwell.length * (deviation - self._deviation)
        if self.controller.at_bound:
            self._bound_since = self._bound_since or end
        else:
            self._bound_since = None

    def _reason_to_give_up(self, flags: int, end: int, valid: bool) -> str:
        reason = self._stopped_from_outside(flags)
        if reason:
            return reason
        if self._bound_since is not None and end - self._bound_since > self.dwell.length * self._block_samples:
            side = "lower" if self.controller.integrator <= self.controller.low else "upper"
            return (
                f"the frequency stays at the {side} end of the guard band "
                f"({self.controller.integrator / (2 * math.pi):.2f} Hz): this is not the target mode"
            )
        if end > self._deadline and self.machine.state == LoopState.ACQUIRING:
            return f"no lock within the time-out: {self._obstacle(valid)}"
        if self.machine.state == LoopState.LOCKED and not valid:
            return "force or response fell below its amplitude floor"
        return ""

    @property
    def _harmonics_obstacle(self) -> str:
        """What keeps the force's harmonics from being settled, empty if nothing does."""
        if self.harmonics is None or not self._harmonics_wanted:
            return ""
        return self.harmonics.obstacle

    @property
    def _settled_words(self) -> str:
        """How what is controlled besides the phase is at the lock; empty if nothing is."""
        return self.harmonics.summary if self.harmonics is not None and self._harmonics_wanted else ""

    def _obstacle(self, valid: bool) -> str:
        """What keeps the loop from locking."""
        if not valid:
            return "force or response below its amplitude floor"
        if not self.dwell.full:
            return f"not {self.settings.dwell_periods:g} periods since the phase became valid"
        return self.criteria.obstacle(self.dwell.statistics(), self._deviation) or self._harmonics_obstacle

    def _judge(self, end: int) -> LockWindow | None:
        statistics = self.dwell.statistics()
        if self.machine.state == LoopState.LOCKED:
            reason = self.criteria.lost(statistics)
            if reason:
                self._give_up(end, reason)
            return None
        if not self.criteria.locked(statistics, self._deviation) or self._harmonics_obstacle:
            return None
        reason = f"phase error {math.degrees(statistics.mean):.3f} deg over {self.settings.dwell_periods:g} periods"
        if self._settled_words:
            reason += f"; {self._settled_words}"
        return self._open_window(end, statistics.mean, reason)

    def _open_window(self, end: int, error: float, reason: str) -> LockWindow | None:
        self._good_frequency = self.controller.output
        if self._level is not None and self._level.test is TestKind.RING_DOWN:
            return self._switch_off(self._level, end, error, reason)
        return self._lock(end, self.controller.output, error, reason)

    def _switch_off(self, level: LevelCommand, end: int, error: float, reason: str) -> LockWindow:
        """End the excitation at the lock; the window is the free decay from the switch-off on."""
        self.machine.lock(end, f"{reason}; the drive is switched of")
        frequency = self.controller.output / (2.0 * math.pi)
        self._decaying = True
        self._amplitude = 0.0
        self._ramp = self.settings.switch_off_periods / frequency
        first = end + self.settings.latency_blocks * self._block_samples
        samples = max(1, round(level.duration * self.sample_rate))
        return LockWindow(level, end - 1, frequency, error, first, samples, 0)
