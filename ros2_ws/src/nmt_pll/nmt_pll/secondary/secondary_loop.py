"""Secondary resonances: a phase loop on the resonant order of the response, and the release onto an isola.

Orders and lags are those of :mod:`nmt_core.messages.secondary_resonance`. With the lag θ held, the resonant order
behaves as a mode in phase resonance does: its lag moves with the frequency as that of a first-order system, with the
decay δ (3:1) or 3 δ (1:3). So the closed-form gains of the phase-locked loop serve, in terms of the resonant frequency
kΩ/ν and of the phase of the resonant order, θ/ν.

The subharmonic resonance is an isola: at rest its order does not grow. There the loop holds phase resonance of the mode
itself at a stated response amplitude, then turns the drive to ν times the frequency at a moment at which the lag comes
out as wanted (the release), and holds the lag. Where the response leaves the isola, the release is tried again with
other amplitudes.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import replace
from enum import Enum, auto
from typing import ClassVar

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import SampleBlock
from nmt_core.messages.linear_description import LinearDescription
from nmt_core.messages.records import LevelCommand
from nmt_core.messages.secondary_resonance import RESONANCES, SecondaryResonance, resonance_of
from nmt_core.numerics.arrays import FloatArray
from nmt_core.vocabulary import MOTIONS, ControlKind, LoopState, TestKind
from nmt_pll.detection.lock import Dwell, LockCriteria
from nmt_pll.detection.phase_detector import AdaptiveFourierFilter
from nmt_pll.level_loop import LevelLoop, LockWindow, LoopOutput
from nmt_pll.loop_settings import LoopSettings
from nmt_pll.phase_loop.controller import AmplitudeController, FrequencyController, GainSchedule
from nmt_pll.phase_loop.gains import LoopPlant
from nmt_pll.phase_loop.loop import PhaseLockedLoop
from nmt_pll.thresholds import PHASE, SECONDARY


class _Stage(Enum):
    """What the loop does at a level."""

    RELEASE = auto()  # phase resonance of the mode at the amplitude of the release
    TRACK = auto()  # the lag of the resonant order is held


class SecondaryResonanceLoop(LevelLoop):
    """Holds the lag of the resonant order; levels are voltages or forces.

    Args:
        linear: linear description of the rig.
        settings: loop settings; tolerances, floors, guard band and start frequency mean the resonant order.
        sample_rate: Hz.
        block_samples: samples a block.
    """

    KINDS: ClassVar[tuple[TestKind, ...]] = (TestKind.SECONDARY_RESONANCE,)

    def __init__(
        self, linear: LinearDescription, settings: LoopSettings, sample_rate: float, block_samples: int
    ) -> None:
        super().__init__(linear.drive_point, sample_rate, block_samples, settings.quiet_ramp)
        self.linear = linear
        self.settings = settings
        self._mode = linear.frequencies_rad_s[linear.target_mode]
        self._dead_time = (PHASE.dead_time_blocks + settings.latency_blocks) * self.block_duration
        self._delay = settings.latency_blocks * block_samples
        self.controller = FrequencyController(
            self._mode, settings.guard_low * self._mode, settings.guard_high * self._mode
        )
        self.amplitude_controller = AmplitudeController(0.0)
        self.criteria = LockCriteria(
            settings.phase_tolerance,
            settings.frequency_tolerance,
            settings.amplitude_tolerance,
            settings.scatter_limit,
            settings.unlock_tolerance,
        )
        self._primary: PhaseLockedLoop | None = None
        self._stage = _Stage.TRACK
        self._releases = 0
        self._switch_until = math.inf
        self._base = 0.0  # cycles of the base frequency at the next block's start
        self._turn = 0.0  # phase of the force over that of the drive, rad
        self._closed_from: float = 0
        self._judged_from: float = 0
        self._deviation = 0.0
        self._bound_since: int | None = None
        self._prepare(RESONANCES[0])

    def _prepare(self, resonance: SecondaryResonance) -> None:
        """Filter, gains and dwell for a resonance."""
        self.resonance = resonance
        base = self._mode / resonance.response_order
        settings = self.settings
        highest = max(settings.harmonics, resonance.response_order, resonance.force_order)
        self.cutoff = settings.cutoff or SECONDARY.filter_cutoff_ratio * base
        self.filter = AdaptiveFourierFilter(2, highest, self.cutoff, self.sample_rate)
        plant = LoopPlant.from_description(self.linear)
        self.schedule = GainSchedule(plant, settings, self.cutoff, self._dead_time)
        self.amplitude_controller.bandwidth = self.schedule.amplitude_bandwidth
        dwell = settings.dwell_periods * 2.0 * math.pi / base
        self.dwell = Dwell(math.ceil(dwell / self.block_duration), 2.0 / (self.cutoff * self.block_duration))

    def _check_control(self, level: LevelCommand) -> None:
        if level.control not in (ControlKind.VOLTAGE, ControlKind.FORCE):
            raise BenchError(
                f"Level {level.index}: in a secondary resonance a level is a voltage or a force; use --control voltage "
                "or force."
            )
        resonance = resonance_of(level.response_order, level.force_order)
        if not 0.0 <= level.release < math.inf:
            raise BenchError(f"Level {level.index}: the release must be finite and >= 0, got {level.release}.")
        if level.release > 0.0 and not resonance.needs_release:
            raise BenchError(f"Level {level.index}: a {resonance.label} resonance needs no release; leave it out.")

    # -- one block -----------------------------------------------------------------------------------------------

    def process(self, force: SampleBlock, response: SampleBlock) -> LoopOutput:
        """Answer one block of force and drive-point response.

        Raises:
            ValueError: the blocks do not cover the same samples, or the response is not a motion.
        """
        rows = self._drive_point_rows(force, response)
        if response.quantity not in MOTIONS:
            raise ValueError(f"the response is {response.quantity.name.lower()}, not a motion")
        end = force.end_sample
        flags = force.flags | response.flags
        error, force_size, size, share = self._measure(force, response, np.stack(rows))
        if self.machine.state not in (LoopState.ACQUIRING, LoopState.LOCKED):
            self._quiet_reason = ""
        self._start_due_levels(force.first_sample, end)
        lock = None
        if self.machine.state in (LoopState.ACQUIRING, LoopState.LOCKED):
            reason = self._stopped_from_outside(flags)
            if not reason and self.machine.state is LoopState.ACQUIRING and end > self._deadline:
                reason = f"no lock within the time-out: {self._obstacle(error, share)}"
            if not reason and self._stage is _Stage.RELEASE:
                reason = self._release(force, response, end)
            elif not reason:
                reason = self._track(error, force_size, size, end)
                if not reason and end > self._judged_from and not math.isnan(error):
                    self.dwell.add(error, self.controller.output, size)
                    lock = self._judge(error, share, end) if self.dwell.full else None
            patience = self.dwell.length * self._block_samples
            reason = reason or self._beyond_the_limit(self.settings.voltage_limit, patience, end)
            if reason:
                self._give_up(end, reason)
        frequency = self._drive_frequency()
        return self._output(end, frequency, error, (force_size, size), lock, flags)

    def _drive_frequency(self) -> float:
        """Angular frequency of the drive for the next block, rad/s."""
        if self._stage is _Stage.RELEASE and self._primary is not None:
            return self._primary.controller.output
        return self.controller.output * self.resonance.force_order / self.resonance.response_order

    def _measure(
        self, force: SampleBlock, response: SampleBlock, data: FloatArray
    ) -> tuple[float, float, float, float]:
        """Error of the resonant order's phase (rad, NaN if not valid), force (N), its amplitude and its share."""
        phase = force.oscillator
        if math.isnan(phase.cycles) or not phase.frequency_hz > 0.0:
            return math.nan, 0.0, 0.0, 0.0
        k, nu = self.resonance[:2]
        releasing = self._driven_at_resonance
        order = 1 if releasing else nu
        base_hz = phase.frequency_hz / order
        coefficients = self.filter.process(data, self._base, base_hz, phase.rate_hz_s / order)
        duration = force.samples / self.sample_rate
        advance = duration * (phase.frequency_hz + 0.5 * phase.rate_hz_s * duration)
        self._base = math.fmod(self._base + advance / order, 1.0)
        if not np.isfinite(coefficients).all():
            self.filter.reset()
            return math.nan, 0.0, 0.0, 0.0
        held, resonant, forced = (complex(coefficients[row, n]) for row, n in ((0, nu), (1, k), (1, nu)))
        floors = self.settings.force_floor, self.settings.response_floor
        share = abs(resonant) / abs(forced) if forced else 0.0
        if releasing or abs(held) < floors[0] or abs(resonant) <= floors[1] or not abs(resonant):
            return math.nan, abs(held), abs(resonant), share
        self._turn = cmath.phase(held) + 2.0 * math.pi * (nu * self._base - phase.cycles - advance)
        displacement = resonant * cmath.rect(1.0, -0.5 * math.pi * MOTIONS[response.quantity])
        lag = k * cmath.phase(held) - nu * cmath.phase(displacement)
        left = self.resonance.lag + self.settings.phase_offset_rad - lag
        return math.remainder(left, 2.0 * math.pi) / nu, abs(held), abs(resonant), share

    _driven_at_resonance = False
    """Whether the present block was driven at the resonant frequency itself, before a release."""

    # -- levels --------------------------------------------------------------------------------------------------

    def _start(self, level: LevelCommand, end: int, was_quiet: bool) -> None:
        resonance = resonance_of(level.response_order, level.force_order)
        again = was_quiet or resonance != self.resonance
        if again:
            self._prepare(resonance)
            self._turn = 0.0
        self._deadline = end + (level.ramp + level.timeout) * self.sample_rate if level.timeout else math.inf
        self._bound_since = None
        self._deviation = 0.0
        self._releases = 0
        self.dwell.clear()
        ratio = resonance.response_order / resonance.force_order
        start = 2.0 * math.pi * (level.frequency_hz or self.settings.start_frequency_hz) * ratio or self._mode
        if again and level.release > 0.0:
            self._begin_release(level, end)
            return
        self._stage = _Stage.TRACK
        if again:
            self.controller.reset(start)
        self._amplitude = self._start_voltage(level, again)
        warm_up = 5.0 / self.cutoff if again else 0.0
        self._close(end + round(max(level.ramp, warm_up) * self.sample_rate))
        if not again:
            self._closed_from = end

    def _close(self, sample: int) -> None:
        """The loop is closed from a sample on, and judged a little later."""
        self._closed_from = sample
        self._judged_from = sample + round(2.0 / self.cutoff * self.sample_rate)
        self.dwell.clear()

    def _start_voltage(self, level: LevelCommand, again: bool) -> float:
        """Voltage a level starts with; a controlled force starts from the linear estimate."""
        if level.control == ControlKind.VOLTAGE:
            return level.amplitude
        if not again and self._amplitude > 0.0:
            return self._amplitude
        per_volt = self.linear.force_per_volt
        return level.amplitude / per_volt if per_volt > 0.0 else 1.0e-3

    # -- release -------------------------------------------------------------------------------------------------

    def _begin_release(self, level: LevelCommand, end: int) -> None:
        """Phase resonance of the mode at the amplitude of the next release."""
        self._stage = _Stage.RELEASE
        self._driven_at_resonance = True
        amplitude = level.release * SECONDARY.release_ratios[self._releases]
        floors = replace(self.settings, force_floor=0.0, response_floor=SECONDARY.response_floor_ratio * amplitude)
        self._primary = PhaseLockedLoop(self.linear, floors, self.sample_rate, self._block_samples)
        self._releases += 1
        self._switch_until = math.inf
        self._primary.set_level(
            LevelCommand(1, level.index, amplitude, 0, level.ramp, ControlKind.RESPONSE, test=TestKind.PHASE_RESONANCE)
        )
        self._amplitude = 0.0
        self._ramp = level.ramp

    def _release(self, force: SampleBlock, response: SampleBlock, end: int) -> str:
        """One block of the release; why the level has to be given up, empty if it goes on."""
        level, primary = self._level, self._primary
        assert level is not None
        assert primary is not None
        output = primary.process(force, response)
        self._amplitude, self._ramp = output.amplitude, output.ramp
        if output.state is LoopState.LOCK_LOST:
            why = "" if output.transition is None else output.transition.reason
            return f"no phase resonance at the release's amplitude: {why}"
        if output.state is not LoopState.LOCKED:
            return ""
        if math.isinf(self._switch_until):
            self._switch_until = end + SECONDARY.release_wait_s * self.sample_rate
        waited = 1.0 - (self._switch_until - end) / (SECONDARY.release_wait_s * self.sample_rate)
        allowed = SECONDARY.release_phase_rad + max(waited, 0.0) * math.pi
        if abs(self._lag_after_switch(force, response, output.frequency_hz)) <= allowed:
            self._switch(level, primary, end)
        return ""

    def _lag_after_switch(self, force: SampleBlock, response: SampleBlock, frequency_hz: float) -> float:
        """Lag that the next command would bring if it turned the drive to ν times the frequency, less θ, rad.

        With the drive's phase ϑ at the switch, the force F_ν in advance of it by ``turn`` and the displacement x in
        terms of it, the lag is (1 − ν) ϑ + turn − ν arg x.
        """
        assert self._primary is not None
        phase = force.oscillator
        duration = force.samples / self.sample_rate
        ahead = self._delay / self.sample_rate * frequency_hz
        at_switch = 2.0 * math.pi * (phase.cycles + phase.frequency_hz * duration + ahead)
        motion = self._primary.filter.coefficients[1, 1] * cmath.rect(1.0, -0.5 * math.pi * MOTIONS[response.quantity])
        nu = self.resonance.force_order
        lag = (1 - nu) * at_switch + self._turn - nu * cmath.phase(complex(motion))
        return math.remainder(self.resonance.lag + self.settings.phase_offset_rad - lag, 2.0 * math.pi)

    def _switch(self, level: LevelCommand, primary: PhaseLockedLoop, end: int) -> None:
        """Turn the drive to ν times the frequency of the mode, at the level's amplitude."""
        self.controller.reset(primary.controller.output)
        self._stage = _Stage.TRACK
        self._switched_at = end + self._delay
        self._primary = None
        self._amplitude = self._start_voltage(level, True)
        self._ramp = SECONDARY.switch_periods * 2.0 * math.pi / self.controller.output
        self._close(self._switched_at + round((self._ramp + 2.0 / self.cutoff) * self.sample_rate))

    _switched_at = 0

    # -- tracking ------------------------------------------------------------------------------------------------

    def _track(self, error: float, force: float, size: float, end: int) -> str:
        """One block with the lag held; why the level has to be given up, empty if it goes on."""
        level = self._level
        assert level is not None
        if self._driven_at_resonance and end >= self._switched_at:
            self._driven_at_resonance = False
        if end <= self._closed_from:
            return ""
        if level.release > 0.0 and size < SECONDARY.isola_left_ratio * level.release:
            if self.machine.state is LoopState.LOCKED or self._releases >= len(SECONDARY.release_ratios):
                return f"the response has left the isola after {self._releases} releases"
            self._begin_release(level, end)
            return ""
        if math.isnan(error):
            locked = self.machine.state is LoopState.LOCKED
            return "force or response fell below its amplitude floor" if locked else ""
        decay = self.resonance.force_order * self.schedule.plant.structure_decay
        self.controller.update(error, self.schedule.gains(decay), self.block_duration)
        if level.control == ControlKind.FORCE:
            self._amplitude = self.amplitude_controller.update(
                self._amplitude, level.amplitude, force, self.block_duration
            )
            self._ramp = self.block_duration
            deviation = math.log(max(force, 1e-300) / level.amplitude)
            self._deviation += 2.0 / self.dwell.length * (deviation - self._deviation)
        return self._at_bound(end)

    def _at_bound(self, end: int) -> str:
        if not self.controller.at_bound:
            self._bound_since = None
            return ""
        self._bound_since = self._bound_since or end
        if end - self._bound_since <= self.dwell.length * self._block_samples:
            return ""
        side = "lower" if self.controller.integrator <= self.controller.low else "upper"
        return (
            f"the resonant order stays at the {side} end of the guard band "
            f"({self.controller.integrator / (2 * math.pi):.2f} Hz): there is no {self.resonance.label} resonance here"
        )

    def _obstacle(self, error: float, share: float) -> str:
        """What keeps the loop from locking, empty if nothing does."""
        if self._stage is _Stage.RELEASE:
            return "no phase resonance at the release's amplitude yet"
        if math.isnan(error):
            return "force or response below its amplitude floor"
        if share < (SECONDARY.isola_resonant_share if self.resonance.needs_release else SECONDARY.resonant_share):
            return f"the resonant order is {100.0 * share:.1f} % of the order of the force in the response"
        if not self.dwell.full:
            return f"not {self.settings.dwell_periods:g} base periods since the phase became valid"
        return self.criteria.obstacle(self.dwell.statistics(), self._deviation)

    def _judge(self, error: float, share: float, end: int) -> LockWindow | None:
        statistics = self.dwell.statistics()
        if self.machine.state is LoopState.LOCKED:
            reason = self.criteria.lost(statistics)
            if reason:
                self._give_up(end, reason)
            return None
        if self._obstacle(error, share):
            return None
        k, nu = self.resonance[:2]
        lag = math.degrees(self.resonance.lag - nu * statistics.mean)
        reason = f"lag {lag:.2f} deg of order {k} over {self.settings.dwell_periods:g} base periods"
        if self._releases:
            reason += f", after {self._releases} release{'s' if self._releases > 1 else ''}"
        lock = self._lock(end, self._drive_frequency(), error, reason)
        if lock is None or nu == 1:
            return lock
        periods = nu * math.ceil(lock.periods / nu)  # whole base periods
        return replace(lock, periods=periods, samples=round(periods * self.sample_rate / lock.frequency_hz))
