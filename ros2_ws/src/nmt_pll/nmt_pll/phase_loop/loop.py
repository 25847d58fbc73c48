"""The phase-locked loop: detector, controllers and lock logic, one block at a time."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import ClassVar

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.kinds import kind_class
from nmt_core.messages.blocks import OscillatorPhase, Quantity, SampleBlock
from nmt_core.messages.linear_description import LinearDescription
from nmt_core.messages.records import LevelCommand
from nmt_core.numerics.arrays import FloatArray
from nmt_core.vocabulary import MOTIONS, VELOCITY_LEAD, ControlKind, CurveParameter, LoopState, TestKind
from nmt_pll.amplitude.response_control import ResponseController
from nmt_pll.detection.lock import Dwell, DwellStatistics, LockCriteria
from nmt_pll.detection.phase_detector import AdaptiveFourierFilter, phase_error
from nmt_pll.force_control.force_control import ForceControl
from nmt_pll.force_control.force_per_volt import ForcePerVolt
from nmt_pll.level_loop import LevelLoop, LockWindow, LoopOutput
from nmt_pll.loop_settings import LoopSettings
from nmt_pll.phase_loop.controller import AmplitudeController, FrequencyController, GainSchedule
from nmt_pll.phase_loop.gains import LoopPlant
from nmt_pll.phase_loop.multisine import Multisine
from nmt_pll.phase_loop.prospect import Prospect, largest_share
from nmt_pll.thresholds import CURVE, PHASE


class PhaseLockedLoop(LevelLoop):
    """Adaptive Fourier filter, scheduled PI controller and lock state machine.

    A level of a ring-down test is switched off at its lock; it counts as locked while the structure decays, and the
    oscillator goes on at the locked frequency as the reference of the phase.

    Args:
        linear: linear description of the rig.
        settings: loop settings.
        sample_rate: Hz.
        block_samples: samples a block.
        force_per_volt: force at every exciter per volt of every exciter, as far as it is known; None = as the linear
            description says.

    Attributes:
        forces: control of the forces' harmonics, and of all forces of several exciters; the phase loop has the
            fundamental of the first.

    Raises:
        BenchError: the linear description does not say enough for its exciters.
    """

    KINDS: ClassVar[tuple[TestKind, ...]] = (
        TestKind.PHASE_RESONANCE, TestKind.RING_DOWN, TestKind.RESPONSE_CURVE,
    )  # fmt: skip

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
        self.schedule = self._force_schedule = GainSchedule(self.plant, settings, self.cutoff, dead_time)
        # A release needs no more bandwidth than other tests, and with more it would chase what rings at its start.
        gentle = max(dead_time, PHASE.dead_time_blocks * CURVE.release_block_s)
        usual = min(self.cutoff, LoopSettings().resolved_cutoff(linear))
        self._release_schedule = GainSchedule(self.plant, settings, usual, gentle)
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
        self._prospect = Prospect(self.plant.structure_decay, dwell_time)
        self._response_quantity = Quantity.DISPLACEMENT
        self._closed_from = 0
        self._judged_from = 0
        self._running_from = 0
        self._bound_since: int | None = None
        self._good_frequency = self.start_frequency
        self._deviation = 0.0
        self._decaying = False
        self.forces = ForceControl(
            linear, settings, sample_rate, block_samples, self.cutoff, dead_time, self.dwell.length,
            self.controller.high / (2.0 * math.pi), force_per_volt,
        )  # fmt: skip
        self._amplitude_before = 0.0
        self._ramp_end = 0
        self._multisine = Multisine()
        # An exciter that damps couples force and phase away from resonance: a strong phase loop swings with both.
        self._is_gentle = self.plant.plant_decay > CURVE.exciter_decay_ratio * self.plant.structure_decay
        self._release = 0.0  # response amplitude that is held until the force takes over; 0 = the level's own
        self._motion = 0j  # fundamental of the response
        self._phase = 0.0  # held by the level now, rad
        self._glide = (0.0, 0, 0)  # phase it comes from, first and last sample of the way
        self._glided = 0.0  # share of the way so far
        self._foreseen = 0.0  # change of the frequency along the way, rad/s
        self._slope = 0.0  # of the frequency over the lag along the way, rad/s a rad
        self._parameter = CurveParameter.LAG  # what the level is held by
        self._logarithms = (0.0, 0.0)  # ln of the response at the start of the way and at its end
        self._aim = 0.0  # ln of the response of the combination that is held now
        self._found_phase = 0.0  # by which the force leads the velocity: as measured, and over the dwell
        self._mean_phase = 0.0

    def _check_control(self, level: LevelCommand) -> None:
        if level.control not in (ControlKind.VOLTAGE, ControlKind.RESPONSE, ControlKind.FORCE):
            raise BenchError(
                f"Level {level.index}: control {level.control} is not known; use voltage, response or force."
            )
        if level.test is TestKind.RING_DOWN and level.amplitude > 0.0 and not 0.0 < level.duration < math.inf:
            raise BenchError(f"Level {level.index}: a ring-down needs a duration above 0 s, got {level.duration}.")
        if level.parameter and not level.held_response > 0.0:
            raise BenchError(
                f"Level {level.index}: a point off the lag needs a response above 0, got {level.held_response}."
            )
        self.forces.check(level)
        highest = self.forces.highest(level.harmonics_control)
        if level.harmonics_control > highest:
            raise BenchError(
                f"Level {level.index}: harmonics of the force can be controlled up to {highest} at this sample rate "
                f"and cut-off of the filter, not up to {level.harmonics_control}; ask for fewer, or for auto."
            )

    def process(self, force: SampleBlock, response: SampleBlock) -> LoopOutput:
        """Answer one block of force and drive-point response (first channel of each), or of all forces and responses.

        Raises:
            ValueError: the blocks do not cover the same samples, the response is not a motion, or a channel that
                control of the forces needs is missing.
        """
        rows = self._drive_point_rows(force, response)
        end = force.end_sample
        flags = force.flags | response.flags
        present = force.oscillator.frequency_hz
        self._response_quantity = response.quantity
        error, force_amplitude, response_amplitude = self._measure(*rows, force.oscillator)
        forces = self.forces.measure(force, response, self._row(force))
        if self.machine.state not in (LoopState.ACQUIRING, LoopState.LOCKED):
            self._quiet_reason = ""  # the drive is at zero already; the next level is not to suffer for it
        self._start_due_levels(force.first_sample, end)
        lead = self.settings.held_lead(2.0 * math.pi * present)
        if lead != 0.0:  # the loop takes the phase it holds for phase resonance
            error = math.remainder(error + lead, 2.0 * math.pi)
        power_phase, held = error, self._held_phase(end)
        if held != 0.0:
            error = math.remainder(error + held, 2.0 * math.pi)
        self._found_phase = held - error
        steered = self._steered(error, response_amplitude)
        lock = None
        state = self.machine.state
        controls = state in (LoopState.ACQUIRING, LoopState.LOCKED) and not self._decaying
        if not controls or math.isnan(error) or end <= self._closed_from:
            forces = None
        begins = self._judged_from - self._block_samples < end <= self._judged_from
        self.forces.control(forces, self._motion, present, self._amplitude, end, begins, self._ramp_from(end))
        if self._decaying and state == LoopState.LOCKED:
            reason = self._stopped_from_outside(flags)
            if reason:
                self._give_up(end, reason)
        elif state in (LoopState.ACQUIRING, LoopState.LOCKED):
            valid = not math.isnan(error) and end > self._closed_from
            if valid:
                self._control(steered, power_phase, force_amplitude, response_amplitude, end)
            reason = self._reason_to_give_up(flags, end, valid)
            if reason:
                self._give_up(end, reason)
            elif valid and self._running_from and end >= self._running_from:
                self._running_from = 0
                lock = self._open_window(end, error, "the lock is carried on along the ramp")
            elif valid and end > self._judged_from:
                if self._parameter is CurveParameter.FREQUENCY:  # what is to be steady is the lag
                    self.dwell.add(0.0, present * math.exp(error), response_amplitude)
                else:
                    self.dwell.add(steered, present, response_amplitude)
                if self.dwell.full:
                    lock = self._judge(end)
        amplitudes = force_amplitude, response_amplitude
        output = self._output(end, self.controller.output, error, amplitudes, lock, flags)
        if lock is not None:
            self._multisine = Multisine(lock.level.perturbation, lock.first_sample, lock.samples)
        if state == LoopState.LOCKED and output.amplitude > 0.0:
            size, pace = self._multisine.factors(end)
            output = output._replace(amplitude=size * output.amplitude, frequency_hz=pace * output.frequency_hz)
        return output._replace(terms=self.forces.drive_terms(max(output.amplitude, self._ramp_from(end))))

    def _held_phase(self, end: int) -> float:
        """Phase by which the force is to lead the velocity now, rad: a half-cosine to that of the level."""
        if self._level is None or self._level.amplitude <= 0.0:
            return self._phase
        before, first, last = self._glide
        way = min(max((end - first) / (last - first), 0.0), 1.0) if last > first else 1.0
        share = 0.5 - 0.5 * math.cos(math.pi * way)
        self._phase = before + (self._level.held_phase - before) * share
        if self._foreseen != 0.0:
            self.controller.shift(self._foreseen * (share - self._glided))
        self._glided = share
        self._aim = self._logarithms[0] + (self._logarithms[1] - self._logarithms[0]) * share
        return self._phase

    def _steered(self, error: float, response: float) -> float:
        """What the frequency is to bring to zero, rad: along a secant the combination of lag and response."""
        level = self._level
        if self._parameter is not CurveParameter.SECANT or level is None or response <= 0.0:
            return error
        return error + level.phase_per_response * (self._aim - math.log(response))

    def _resting_frequency(self, level: LevelCommand) -> float:
        """Frequency to start with from rest, rad/s; away from phase resonance that of the linear mode at the lag."""
        if level.held_phase == 0.0:
            return self._good_frequency
        return self.start_frequency + self.plant.structure_decay * math.tan(level.held_phase)

    def _begin_glide(self, level: LevelCommand, end: int, ramp_end: int, was_quiet: bool) -> None:
        """Turn the held phase to that of the level along its ramp, and the frequency to the one foreseen there."""
        before, self._parameter = self._parameter, CurveParameter(level.parameter)
        lag_held = before is self._parameter is CurveParameter.LAG
        if not lag_held and math.isfinite(self._found_phase):
            self._phase = self._found_phase  # the lag was free: the way begins where it is
        self._glide = (level.held_phase if was_quiet else self._phase, end, ramp_end)
        self._glided = self._foreseen = self._slope = 0.0
        turned = level.held_phase - self._phase
        if self._parameter is not CurveParameter.LAG:
            aim = math.log(level.held_response)
            present = aim if was_quiet or self._motion == 0.0 else math.log(abs(self._motion))
            self._logarithms = (present, aim)
        if self._parameter is CurveParameter.FREQUENCY:
            self.controller.reset(self.controller.output)
        if kind_class(level.test).is_curve and level.frequency_hz > 0.0 and not was_quiet:
            self._foreseen = 2.0 * math.pi * level.frequency_hz - self.controller.integrator
            if turned != 0.0 and level.control == ControlKind.FORCE and self._parameter is CurveParameter.LAG:
                self._slope = self._foreseen / turned

    def _ramp_from(self, end: int) -> float:
        """V that the amplitude comes from while it is on its way to a level; else 0."""
        return self._amplitude_before if end <= max(self._judged_from, self._ramp_end) else 0.0

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
            start = 2.0 * math.pi * level.frequency_hz or self._resting_frequency(level)
            self.controller.reset(start)
            self.filter.reset()
            self.decay = self.plant.structure_decay
        warm_up = 5.0 / self.cutoff if was_quiet else 0.0
        # Off resonance a fast loop would chase the free vibration.
        if was_quiet and level.held_phase != 0.0 and not level.release:
            warm_up = max(warm_up, level.ramp + CURVE.free_decays / self.plant.plant_decay)
        ramp = level.ramp
        if level.parameter != CurveParameter.LAG:  # the response is to follow along the way
            ramp = max(ramp, CURVE.way_decays / self.plant.structure_decay)
        ramp_end = end + round(ramp * self.sample_rate)
        self._closed_from = end + round(max(warm_up, 0.5 * level.ramp if was_quiet else 0.0) * self.sample_rate)
        self._judged_from = max(ramp_end, self._closed_from) + round(2.0 / self.cutoff * self.sample_rate)
        if level.parameter == CurveParameter.SECANT:  # the combination settles more slowly than the lag
            self._judged_from += round(CURVE.secant_decays / self.plant.structure_decay * self.sample_rate)
        self._begin_glide(level, end, ramp_end, was_quiet)
        self._deadline = self._judged_from + level.timeout * self.sample_rate if level.timeout else math.inf
        self._bound_since = None
        self._decaying = False
        # A lock carried on: the window opens during the ramp, and only then does the loop judge itself.
        self._running_from = 0
        if self.settings.ramp_delay_periods > 0 and self.machine.state == LoopState.LOCKED and not was_quiet:
            delay = self.settings.ramp_delay_periods * 2.0 * math.pi / self.controller.output
            self._running_from = self._judged_from = end + round(delay * self.sample_rate)
        self._amplitude_before, self._ramp_end = self._amplitude, ramp_end
        if was_quiet:
            self._release = level.release if kind_class(level.test).is_curve else 0.0
        self.schedule = self._release_schedule if self._release > 0.0 else self._force_schedule
        self._amplitude = self._start_voltage(level, was_quiet)
        if was_quiet:
            self.response_controller.start(self._amplitude)
        self.response_controller.aim(max(level.ramp, 2.0 / self.schedule.amplitude_bandwidth))
        self.forces.start_level(level, end, was_quiet)
        self.dwell.clear()
        self._deviation = 0.0
        self._prospect.begin()

    @property
    def _on_curve(self) -> bool:
        """Whether the level is a point of a response curve at a held force."""
        level = self._level
        return level is not None and kind_class(level.test).is_curve and level.control == ControlKind.FORCE

    def _held(self, level: LevelCommand) -> tuple[int, float]:
        """What the amplitude controller holds now, and at what amplitude."""
        return (ControlKind.RESPONSE, self._release) if self._release > 0.0 else (level.control, level.amplitude)

    def _start_voltage(self, level: LevelCommand, was_quiet: bool) -> float:
        """Drive voltage a level starts with; controlled amplitudes start from the linear estimate."""
        control, amplitude = self._held(level)
        if control == ControlKind.VOLTAGE:
            return amplitude
        if not was_quiet:
            return self._amplitude
        per_volt = self.linear.displacement_per_volt
        if control == ControlKind.FORCE:
            per_volt = self.linear.force_per_volt
        else:
            per_volt *= self._per_displacement()
        return amplitude / per_volt if per_volt > 0 else 1.0e-3

    def _per_displacement(self) -> float:
        """Amplitude of the response quantity for a unit displacement at the present frequency."""
        return self.controller.output ** MOTIONS.get(self._response_quantity, 0)

    def _control(self, error: float, power_phase: float, force: float, response: float, end: int) -> None:
        omega = self.controller.output
        displacement = response / self._per_displacement()
        decay = force * self.linear.drive_point_shape**2 * math.cos(power_phase) / (2.0 * omega * displacement)
        weight = min(1.0, self.cutoff * self.block_duration)
        self.decay += weight * (min(max(decay, 0.0), 0.3 * omega) - self.decay)
        gains = self.schedule.gains(self.decay)
        if self._slope != 0.0:
            gains = gains.on_slope(self._slope, self.decay)
        if self._is_gentle and self._on_curve and self._parameter is CurveParameter.LAG:
            gains = gains.scaled(CURVE.gentle_share)
        if self._parameter is CurveParameter.SECANT and self._level is not None and not self._level.phase_per_response:
            gains = self.schedule.gains(self.decay).scaled(CURVE.slow_share)
        if self._parameter is not CurveParameter.FREQUENCY:
            self.controller.update(error, gains, self.block_duration)
        self._mean_phase += 2.0 / self.dwell.length * (self._found_phase - self._mean_phase)
        level = self._level
        if level is not None and level.control != ControlKind.VOLTAGE and end > self._closed_from:
            control, amplitude = self._held(level)
            measured = force if control == ControlKind.FORCE else response
            if control == ControlKind.FORCE:
                self.amplitude_controller.bandwidth = self.schedule.force_bandwidth(self.decay)
                self._amplitude = self.amplitude_controller.update(
                    self._amplitude, amplitude, measured, self.block_duration
                )
            else:
                self._amplitude = self.response_controller.update(
                    amplitude,
                    measured,
                    self.schedule.amplitude_bandwidth,
                    self.schedule.plant_decay(self.decay),
                    self.block_duration,
                    error,
                )
            self._ramp = self.block_duration
            deviation = math.log(max(measured, 1e-300) / amplitude)
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
        reason = self._beyond_the_limit(self.settings.voltage_limit, self.dwell.length * self._block_samples, end)
        if reason:
            return reason
        if end > self._deadline and self.machine.state == LoopState.ACQUIRING:
            self._is_gentle ^= (
                self._on_curve and self._parameter is CurveParameter.LAG
            )  # between folds only strong gains hold, elsewhere gentle ones may
            return f"no lock within the time-out: {self._obstacle(valid)}"
        if self.machine.state == LoopState.LOCKED and not valid:
            return "force or response fell below its amplitude floor"
        return ""

    def _obstacle(self, valid: bool) -> str:
        """What keeps the loop from locking."""
        if not valid:
            return "force or response below its amplitude floor"
        if not self.dwell.full:
            return f"not {self.settings.dwell_periods:g} periods since the phase became valid"
        return self.criteria.obstacle(self.dwell.statistics(), self._deviation) or self.forces.obstacle

    def _judge(self, end: int) -> LockWindow | None:
        statistics = self.dwell.statistics()
        if self.machine.state == LoopState.LOCKED:
            reason = self.criteria.lost(statistics)
            if reason:
                self._give_up(end, reason)
            return None
        if not self.criteria.locked(statistics, self._deviation) or self.forces.obstacle:
            self._give_up_early(statistics, end)
            return None
        astray = self._astray()
        if astray:
            self._give_up(end, astray)
            return None
        if self._release > 0.0:  # what it needs is near the force of the level, which is held from now on
            self._release, self.schedule = 0.0, self._force_schedule
            self.dwell.clear()
            self._deviation = 0.0
            return None
        reason = f"phase error {math.degrees(statistics.mean):.3f} deg over {self.settings.dwell_periods:g} periods"
        if self.forces.summary:
            reason += f"; {self.forces.summary}"
        return self._open_window(end, statistics.mean, reason)

    def _give_up_early(self, statistics: DwellStatistics, end: int) -> None:
        """Give a point of a response curve up whose errors do not come down as those of one that will lock."""
        level = self._level
        held = level is not None and kind_class(level.test).is_curve and self._parameter is CurveParameter.LAG
        if level is None or not held or not level.timeout or self._release > 0.0:
            return
        share = largest_share(statistics, self.criteria, self._deviation)
        if self._prospect.is_hopeless(share, end / self.sample_rate, self._deadline / self.sample_rate):
            self._is_gentle ^= self._on_curve
            obstacle = self.criteria.obstacle(statistics, self._deviation) or self.forces.obstacle
            self._give_up(end, f"it cannot be held, as its errors do not come down: {obstacle}")

    def _astray(self) -> str:
        """Why the orbit is not one of the curve that is followed; empty if it is, or where the lag is held."""
        level = self._level
        if self._parameter is CurveParameter.LAG or level is None:
            return ""
        turned = math.remainder(self._mean_phase - level.held_phase, 2.0 * math.pi)
        grown = math.log(max(abs(self._motion), 1e-300) / level.held_response)
        way = math.hypot(level.held_phase - self._glide[0], self._logarithms[1] - self._logarithms[0])
        if math.hypot(turned, grown) <= CURVE.branch_distance + 1.5 * way:
            return ""
        return (
            f"the lag is {math.degrees(abs(turned)):.0f}° and the response {100.0 * math.expm1(grown):.0f} % off the "
            "point of the curve that was foreseen, so this is another branch"
        )

    def _open_window(self, end: int, error: float, reason: str) -> LockWindow | None:
        self._good_frequency = self.controller.output
        if self._level is not None and self._level.test is TestKind.RING_DOWN:
            return self._switch_off(self._level, end, error, reason)
        window = self._lock(end, self.controller.output, error, reason)
        if window is None or self._parameter is CurveParameter.LAG:
            return window
        return replace(window, level=replace(window.level, held_phase=self._mean_phase))

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
