"""The loop of self-excited tests: holds or releases a motion that the structure feeds, and ends by damping it.

The oscillator follows the response, and the drive is a force in its frame
(:mod:`nmt_pll.self_excited.self_excited_control`), so that force and damping ratio may pass through zero. A level is
an amplitude of the response, reached by one of three methods:

* ``amplitude``: held by velocity feedback and a proportional part, on stable and unstable parts alike;
* ``feedback``: held by velocity feedback alone, where the damping ratio grows with the amplitude;
* ``envelope``: brought next to the amplitude, released, and measured as the free motion passes it.

``auto`` holds the amplitude of a rig whose growth at rest the dead time allows. Others are released, and held by
velocity feedback beyond the amplitude at which their free motion settles. A level whose amplitude cannot be held is
released as well.

Without a drive such a rig does not come to rest. Loss of control and the end of a level plan therefore damp the motion
by feedback first; the drive goes to zero by a ramp when the response is down, or when the time for it is over.
"""

from __future__ import annotations

import cmath
import math
from collections import deque
from enum import Enum
from typing import ClassVar

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.kinds import METHODS
from nmt_core.messages.blocks import OscillatorPhase, SampleBlock
from nmt_core.messages.linear_description import LinearDescription
from nmt_core.messages.records import DriveTerm, LevelCommand
from nmt_core.vocabulary import MOTIONS, ControlKind, LoopState, TestKind
from nmt_pll.detection.lock import Dwell, DwellStatistics, Transition
from nmt_pll.detection.phase_detector import AdaptiveFourierFilter
from nmt_pll.level_loop import LevelLoop, LockWindow, LoopOutput
from nmt_pll.loop_settings import LoopSettings
from nmt_pll.phase_loop.controller import FrequencyController
from nmt_pll.phase_loop.gains import ControllerGains
from nmt_pll.self_excited.self_excited_control import AmplitudeLaw, SelfExcitedPlant
from nmt_pll.thresholds import SELF_EXCITED


class _Act(Enum):
    """What the loop does with the motion."""

    REST = "nothing"
    HOLD = "bring to an amplitude and hold"
    FREE = "leave alone"
    DAMP = "damp"


class SelfExcitedLoop(LevelLoop):
    """One method for each level, and damping at its end.

    Args:
        linear: linear description of the rig; damping ratios may be negative.
        settings: loop settings.
        sample_rate: Hz.
        block_samples: samples a block.
        method: one of `METHODS`.
        response_limit: of the response at the drive point, in its unit; 0 = none.

    Raises:
        BenchError: the method is not known, or the description lacks what the control needs.
    """

    KINDS: ClassVar[tuple[TestKind, ...]] = (TestKind.SELF_EXCITED,)

    def __init__(
        self,
        linear: LinearDescription,
        settings: LoopSettings,
        sample_rate: float,
        block_samples: int,
        method: str = "auto",
        response_limit: float = 0.0,
    ) -> None:
        super().__init__(linear.drive_point, sample_rate, block_samples, settings.quiet_ramp)
        if method not in METHODS:
            raise BenchError(f"The method '{method}' of self-excited tests is not known; use {', '.join(METHODS)}.")
        self.settings = settings
        omega = linear.frequencies_rad_s[linear.target_mode]
        self.cutoff = settings.cutoff or SELF_EXCITED.filter_cutoff_ratio * omega
        self.filter = AdaptiveFourierFilter(2, settings.harmonics, self.cutoff, sample_rate)
        dead_time = (1.5 + settings.latency_blocks) * self.block_duration + 1.0 / self.cutoff
        self.plant = SelfExcitedPlant.of(linear, dead_time)
        rate = self.plant.tracking_rate
        self._tracking = ControllerGains(rate, 0.25 * rate**2)
        self.controller = FrequencyController(
            2.0 * math.pi * settings.start_frequency_hz or omega,
            settings.guard_low * omega,
            settings.guard_high * omega,
        )
        dwell_time = settings.dwell_periods * 2.0 * math.pi / omega
        self.dwell = Dwell(math.ceil(dwell_time / self.block_duration), 2.0 / (self.cutoff * self.block_duration))
        self.method = method
        self._chosen = method if method != "auto" else "amplitude" if self.plant.holds_amplitude else "envelope"
        self._limit = SELF_EXCITED.response_limit_share * response_limit if response_limit > 0.0 else math.inf
        self._largest = (
            SELF_EXCITED.voltage_limit_share * settings.voltage_limit if settings.voltage_limit > 0.0 else math.inf
        )
        self._laws = {name: AmplitudeLaw(self.plant, name != "feedback") for name in METHODS[1:]}
        self._act = _Act.REST
        self._order = 2  # of the response as a derivative of the displacement
        self._drive = 0j
        self._free = True  # whether the drive could give what was asked for
        self._quadrature = 0.0
        self._reference: float | None = None
        self._phases: deque[float] = deque(maxlen=2)
        length = max(3, round(SELF_EXCITED.growth_periods * 2.0 * math.pi / omega / self.block_duration))
        self._logarithms: deque[float] = deque(maxlen=length + 1)
        self._amplitude_now = 0.0
        self._target = self._from = 0.0
        self._ramp_from = self._ramp_end = self._ramp_samples = self._approached = 0
        self._engaged = False
        self._release_from = 0
        self._lowest = math.inf
        self._from_above = False
        self._tried: set[bool] = set()
        self._settled_at: float | None = None  # amplitude at which a free motion was seen to settle
        self._damped_until = 0
        self._damped_from = 0
        self._reason = ""
        self._window_until = 0
        self._judged_from = 0

    # -- levels ----------------------------------------------------------------------------------------------------

    def _check_control(self, level: LevelCommand) -> None:
        if level.amplitude > 0.0 and level.control != ControlKind.RESPONSE:
            raise BenchError(
                f"Level {level.index}: a self-excited test has levels of the response; use --control response."
            )
        if level.amplitude >= self._limit:
            raise BenchError(
                f"Level {level.index}: {level.amplitude:g} is beyond {100 * SELF_EXCITED.response_limit_share:g} % of "
                "the limit of the response; lower the level."
            )
        if level.amplitude > 0.0 and not 0.0 < level.duration < math.inf:
            raise BenchError(
                f"Level {level.index}: a self-excited test needs a duration above 0 s, got {level.duration}."
            )

    def _start(self, level: LevelCommand, end: int, was_quiet: bool) -> None:
        self._lowest = min(self._lowest, level.amplitude)
        self._tried.clear()
        self._deadline = end + (level.ramp + (level.timeout or math.inf)) * self.sample_rate
        if self._act in (_Act.REST, _Act.FREE):
            self._reference = None
            self._engaged = False
        self._begin(level, end)

    def _begin(self, level: LevelCommand, end: int) -> None:
        """Begin to work on a level by the method that is chosen."""
        self._window_until = 0
        if self.method == "auto" and self._chosen == "feedback":
            self._chosen = "envelope"  # that was for the level before
        if self._chosen != "envelope":
            self._approach(level.amplitude, level, end)
            return
        # Free motions are sought on the side from which the one that is known comes; else from below, where they grow.
        if self._tried:
            above = not next(iter(self._tried))
        elif self._settled_at is not None:
            above = level.amplitude > self._settled_at
        else:
            above = self.plant.growth <= 0.0
        if above and self.method == "auto" and self.plant.growth > 0.0:
            # Beyond the limit cycle of an unstable rest the damping ratio grows with the amplitude.
            self._chosen = "feedback"
            self._approach(level.amplitude, level, end)
            return
        self._from_above = above
        self._tried.add(above)
        self._approach(
            level.amplitude * math.exp(SELF_EXCITED.release_log_lead if above else -SELF_EXCITED.release_log_lead),
            level,
            end,
        )

    @property
    def window_time(self) -> float:
        """Length of a window about an amplitude that a free motion passes with its present growth, s."""
        shortest = SELF_EXCITED.shortest_free_window_periods * 2.0 * math.pi / self.plant.omega
        return min(max(shortest, SELF_EXCITED.free_window_log_span / max(abs(self._growth), 1e-9)), 10.0 * shortest)

    def _approach(self, target: float, level: LevelCommand, end: int) -> None:
        """Bring the amplitude to a target along a half-cosine of its logarithm."""
        if self._limit < math.inf:
            target = min(target, 0.97 * self._limit)
        self._act = _Act.HOLD
        self._target = target
        self._from = max(self._amplitude_now, SELF_EXCITED.phase_amplitude_ratio * target)
        # No faster than the law can follow.
        seconds = max(
            level.ramp,
            abs(math.log(target / self._from)) / (SELF_EXCITED.target_rate_ratio * self._laws[self._chosen].rate),
        )
        self._ramp_samples = max(1, round(seconds * self.sample_rate))
        self._approached = end
        self._begin_ramp(end)

    def _begin_ramp(self, end: int) -> None:
        self._ramp_from, self._ramp_end = end, end + self._ramp_samples
        self._judged_from = self._ramp_end + round(3.0 / self.cutoff * self.sample_rate)
        self.dwell.clear()

    def _wanted(self, end: int) -> float:
        """Present target of the amplitude."""
        share = min(1.0, (end - self._ramp_from) / (self._ramp_end - self._ramp_from))
        weight = 0.5 - 0.5 * math.cos(math.pi * share)
        return self._from * math.exp(weight * math.log(self._target / self._from))

    # -- blocks ----------------------------------------------------------------------------------------------------

    def process(self, force: SampleBlock, response: SampleBlock) -> LoopOutput:
        """Answer one block of force and drive-point response.

        Raises:
            ValueError: the blocks do not cover the same samples, or the response is not a motion.
        """
        rows = self._drive_point_rows(force, response)
        if response.quantity not in MOTIONS:
            raise ValueError(f"the response is {response.quantity.name.lower()}, not a motion")
        self._order = MOTIONS[response.quantity]
        end, flags = force.end_sample, force.flags | response.flags
        force_phasor, motion = self._measure(np.stack(rows), force.oscillator)
        self._amplitude_now = abs(motion)
        self._logarithms.append(math.log(max(abs(motion), 1e-300)))
        if self.machine.state not in (LoopState.ACQUIRING, LoopState.LOCKED) and self._act is _Act.REST:
            self._quiet_reason = ""
        self._start_due_levels(force.first_sample, end)
        velocity = motion * cmath.rect(1.0, 0.5 * math.pi * (1 - self._order))
        lock = self._work(force_phasor, velocity, force.oscillator.frequency_hz, end)
        reason = self._stopped_from_outside(flags)
        if reason:
            self._give_up(end, reason)
        error = math.nan
        if abs(force_phasor) > self.settings.force_floor and abs(velocity) > 0.0:
            error = self._phase(force_phasor, velocity)
        self._amplitude = abs(self._drive)
        output = self._output(end, self.controller.output, error, (abs(force_phasor), abs(motion)), lock, flags)
        turned = self._drive - self._amplitude
        return output._replace(terms=(DriveTerm(1, 1, turned, relative=False),)) if self._drive else output

    def _measure(self, data: np.ndarray, phase: OscillatorPhase) -> tuple[complex, complex]:
        """Fundamentals of force and response after the block; a second pass is not needed while nothing is known."""
        if math.isnan(phase.cycles):
            return 0j, 0j
        frequency = phase.frequency_hz or self.controller.output / (2.0 * math.pi)
        values = self.filter.process(data, phase.cycles, frequency, phase.rate_hz_s)
        if not np.isfinite(values).all():
            self.filter.reset()
            return 0j, 0j
        return complex(values[0, 1]), complex(values[1, 1])

    def _work(self, force: complex, velocity: complex, frequency_hz: float, end: int) -> LockWindow | None:
        """Drive for the next block, and the window it may open."""
        lock = None
        direction = self._follow(velocity, frequency_hz)
        if self._act is not _Act.REST and self._amplitude_now > self._limit and self._act is not _Act.DAMP:
            self._give_up(end, f"the response passed {100 * SELF_EXCITED.response_limit_share:g} % of its limit")
        if self._act is _Act.HOLD:
            lock = self._hold(force, velocity, direction, frequency_hz, end)
        if self._act is _Act.FREE:
            lock = lock or self._watch(end)
        if self._act is _Act.DAMP:
            self._damp(direction, end)
        if self._act in (_Act.FREE, _Act.REST):
            self._drive = 0j
            self._ramp = self.block_duration if self._act is _Act.FREE else self._quiet_ramp
        else:
            self._ramp = self.block_duration
        return lock

    def _follow(self, velocity: complex, frequency_hz: float) -> complex:
        """Unit phasor of the velocity; while there is a drive the oscillator's frequency follows its phase."""
        least = (
            0.5 * SELF_EXCITED.decayed_ratio * self._lowest
            if self._act is _Act.DAMP
            else SELF_EXCITED.phase_amplitude_ratio * (self._target or math.inf)
        )
        valid = self._engaged if self._act is _Act.HOLD else self._amplitude_now > least
        if self._act in (_Act.REST, _Act.FREE) or not valid:
            self._reference = None
            return velocity / abs(velocity) if valid else 1 + 0j
        phase = cmath.phase(velocity)
        if self._reference is None:
            self._reference = phase
            self.controller.reset(2.0 * math.pi * frequency_hz or self.controller.output)
        error = math.remainder(phase - self._reference, 2.0 * math.pi)
        self.controller.update(error, self._tracking, self.block_duration)
        return velocity / abs(velocity)

    def _apply(self, rate: float, direction: complex, amplitude: float) -> None:
        """Drive that makes a motion of an amplitude grow with a rate (1/s)."""
        displacement = amplitude / self.plant.omega**self._order
        along = rate * displacement / self.plant.rate_per_force
        drive = direction * complex(along, self._quadrature) / self.plant.force_per_volt
        self._free = abs(drive) <= self._largest
        self._drive = drive if self._free else drive * (self._largest / abs(drive))

    def _hold(
        self, force: complex, velocity: complex, direction: complex, frequency_hz: float, end: int
    ) -> LockWindow | None:
        least = SELF_EXCITED.phase_amplitude_ratio * self._target
        target, amplitude = self._wanted(end), max(self._amplitude_now, least)
        valid = self._engaged = self._amplitude_now > least * (
            SELF_EXCITED.phase_released_ratio if self._engaged else SELF_EXCITED.phase_engaged_ratio
        )
        if not valid:  # a force that grows until there is a motion to follow
            waited = (end - self._approached) / self.sample_rate
            self._begin_ramp(end)
            target = (
                SELF_EXCITED.first_target_ratio
                * least
                * math.exp(min(SELF_EXCITED.target_rate_ratio * self._laws[self._chosen].rate * waited, 10.0))
            )
        across = (force * direction.conjugate()).imag if valid else 0.0
        self._quadrature -= self.plant.quadrature_rate * self.block_duration * across
        law = self._laws[self._chosen]
        if valid:
            rate = law.update(amplitude, target, self.block_duration, self._free)
        else:
            rate = law.rate * math.log(target / amplitude)
        self._apply(rate, direction, amplitude)
        level = self._level
        assert level is not None
        if self._chosen == "envelope":
            side = 1.0 if self._from_above else -1.0
            reached = side * math.log(amplitude / self._target) > -SELF_EXCITED.release_log_tolerance
            # As far as the drive carries it is enough, if the level lies behind.
            reached |= (
                abs(self._drive) > 0.9 * self._largest
                and side * math.log(amplitude / level.amplitude) > SELF_EXCITED.shortest_log_lead
            )
            if valid and reached and end >= self._ramp_end:
                self._act, self._release_from = _Act.FREE, end
            elif end > self._deadline:
                self._give_up(end, "the amplitude to release from was not reached within the time-out")
            return None
        if not valid:
            if end > self._deadline:
                self._give_up(end, "no response within the time-out")
            return None
        detuning = across * self.plant.rate_per_force / (self._displacement * self.plant.omega)
        if amplitude > SELF_EXCITED.lost_control_ratio * max(self._target, self._from) or (
            self.machine.state == LoopState.LOCKED and abs(math.log(amplitude / target)) > SELF_EXCITED.lost_lock_change
        ):
            self._lose(level, end, f"the amplitude left its target by {100 * (amplitude / target - 1):.0f} %")
            return None
        if end <= self._judged_from:
            return None
        self.dwell.add(detuning, frequency_hz, amplitude)
        if self.machine.state == LoopState.ACQUIRING and self.dwell.full:
            statistics = self.dwell.statistics()
            obstacle = self.obstacle(statistics, target)
            if not obstacle:
                return self._lock(
                    end, self.controller.output, self._phase(force, velocity), self._lock_words(statistics)
                )
            if end > self._deadline:
                self._lose(level, end, f"no lock within the time-out: {obstacle}")
        return None

    @property
    def _displacement(self) -> float:
        """Amplitude of the displacement at the drive point, m."""
        return self._amplitude_now / self.plant.omega**self._order

    @staticmethod
    def _phase(force: complex, velocity: complex) -> float:
        """Phase of the velocity from the line of the force, rad: the force may work either way."""
        return math.remainder(cmath.phase(velocity * force.conjugate()), math.pi) if force else math.nan

    def obstacle(self, s: DwellStatistics, target: float) -> str:
        """What keeps a held amplitude from being locked; noise excuses two standard uncertainties."""
        settings = self.settings
        if abs(s.mean) > SELF_EXCITED.largest_detuning + 2.0 * s.mean_std:
            return f"the force at right angles to the velocity shifts the frequency by {100 * s.mean:.3f} %"
        if abs(s.frequency_drift) > settings.frequency_tolerance + 2.0 * s.frequency_drift_std:
            return f"the frequency drifts by {100 * s.frequency_drift:.3f} % over the dwell"
        if abs(s.amplitude_drift) > settings.amplitude_tolerance + 2.0 * s.amplitude_drift_std:
            return f"the response drifts by {100 * s.amplitude_drift:.2f} % over the dwell"
        error = self._amplitude_now / target - 1.0
        if abs(error) > 5.0 * settings.amplitude_tolerance + 2.0 * s.amplitude_drift_std:
            return f"the amplitude is {100 * error:.2f} % off its target"
        return ""

    def _lock_words(self, s: DwellStatistics) -> str:
        names = {"amplitude": "amplitude control", "feedback": "velocity feedback"}
        return f"{names[self._chosen]}: frequency {100 * s.mean:.4f} % off by the force across the velocity"

    # -- free motion -----------------------------------------------------------------------------------------------

    @property
    def _growth(self) -> float:
        """Growth of the response over the last periods, 1/s."""
        values = self._logarithms
        return (values[-1] - values[0]) / ((len(values) - 1) * self.block_duration) if len(values) > 2 else 0.0

    def _watch(self, end: int) -> LockWindow | None:
        """Follow a free motion; a window opens half of it before the level's amplitude is passed."""
        level = self._level
        assert level is not None
        if self._window_until:
            if end >= self._window_until:
                self._window_until = 0
            return None
        if self.machine.state != LoopState.ACQUIRING:
            return None
        since = (end - self._release_from) / self.sample_rate
        if since < 2.0 / self.cutoff + (2 + self.settings.latency_blocks) * self.block_duration:
            return None
        growth = self._growth
        # The filter is late by its time constant.
        distance = math.log(level.amplitude) - (self._logarithms[-1] + growth / self.cutoff)
        settled = (
            since > 4.0 * SELF_EXCITED.growth_periods * 2.0 * math.pi / self.plant.omega
            and abs(growth) < self.still_growth
        )
        if settled and abs(distance) < SELF_EXCITED.limit_cycle_log_distance:
            return self._open(level, end, growth)
        if distance > 0.0 if self._from_above else distance < 0.0:
            return self._open(level, end, growth)
        late = since > 3.0 * SELF_EXCITED.growth_periods * 2.0 * math.pi / self.plant.omega
        away = late and (growth < -self.still_growth if not self._from_above else growth > self.still_growth)
        if settled or away or since > level.duration:
            if settled:
                self._settled_at = self._amplitude_now
            self._again(level, end, "settled" if settled else "went the other way" if away else "took too long")
        return None

    @property
    def still_growth(self) -> float:
        """Growth that counts as none, 1/s."""
        return SELF_EXCITED.settled_growth_ratio * self.plant.omega

    def _open(self, level: LevelCommand, end: int, growth: float) -> LockWindow:
        """Name the window about the moment in which the level's amplitude is passed: it begins before now."""
        side = "steady" if abs(growth) < self.still_growth else "ring-down" if growth < 0.0 else "ring-up"
        self.machine.lock(end, f"envelope, {side}: the response grows by {growth:.4g} 1/s")
        half = 0.5 * self.window_time * self.sample_rate
        released = self._release_from + (2 + self.settings.latency_blocks) * self._block_samples
        first = max(released, end - round(half))
        self._window_until = end + max(round(half), self._block_samples)
        frequency = self.controller.output / (2.0 * math.pi)
        return LockWindow(level, end - 1, frequency, math.nan, first, self._window_until - first, 0)

    def _again(self, level: LevelCommand, end: int, why: str) -> None:
        """Release from the other side, once; then the level is lost."""
        if len(self._tried) > 1 or end > self._deadline:
            self._give_up(
                end, f"the free motion {why}" + ("; from the other side as well" if len(self._tried) > 1 else "")
            )
            return
        self._begin(level, end)

    # -- loss and end ----------------------------------------------------------------------------------------------

    def _lose(self, level: LevelCommand, end: int, reason: str) -> None:
        """An amplitude could not be held: released instead where the method is the loop's choice."""
        if self.method == "auto" and self._chosen == "amplitude" and self.machine.state == LoopState.ACQUIRING:
            self._chosen = "envelope"
            self._deadline = end + (level.ramp + (level.timeout or math.inf)) * self.sample_rate
            self._begin(level, end)
            return
        self._give_up(end, reason)

    def _give_up(self, end: int, reason: str) -> None:
        self.machine.lose(end, reason)
        self._begin_damping(end)

    def _begin_damping(self, end: int) -> None:
        """Damp the motion; the drive goes to zero when it is down or the time is over."""
        if self._act is _Act.DAMP:
            return
        if self._act is _Act.REST:
            self._drive = 0j
            return
        duration = self._level.duration if self._level is not None and self._level.duration else self._last_duration
        self._act = _Act.DAMP
        self._quadrature = 0.0
        self._damped_from, self._damped_until = end, end + round(duration * self.sample_rate)

    _last_duration = 5.0

    def _damp(self, direction: complex, end: int) -> None:
        down = self._amplitude_now <= SELF_EXCITED.decayed_ratio * self._lowest
        if down or end >= self._damped_until:
            seconds = (end - self._damped_from) / self.sample_rate
            what = "the response is down" if down else "the time is over"
            self.ending = (
                f"damping feedback for {seconds:.2f} s, {what} at {self._amplitude_now:.3g}; "
                "the drive goes to zero by a ramp"
            )
            self._act = _Act.REST
            self.machine.transition = Transition(end, self.machine.state, self.ending)
            return
        self._apply(self.plant.damping_rate, direction, self._amplitude_now)

    ending = ""

    def _end_excitation(self, level: LevelCommand, end: int) -> None:
        """A level of amplitude zero: damp, then ramp."""
        self._last_duration = level.duration or self._last_duration
        self._begin_damping(end)
