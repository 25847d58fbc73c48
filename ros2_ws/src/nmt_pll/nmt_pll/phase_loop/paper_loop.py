"""The phase-locked loop of the paper: product detector, low-pass, PI controller, oscillator.

The paper's appendix gives K, a, b and ω_m, but its block diagram is missing. The structure here is the one
that reaches 90° without bias and needs the reported time to lock (10.7 s after a shift of 5 % with K = 2π):

    f̂ x̂ → 1/(s + a) → K (s + b)/s → ω = ω_m + y

With f̂ = cos(θ_F) and x̂ = cos(θ_x) the product is ½ cos(θ_F − θ_x) + ½ cos(θ_F + θ_x). At phase resonance
the force leads the displacement by 90°; below it by 90° − ε, so the slow part is ½ sin ε: gain ½ about the
lock, positive where the frequency has to rise. The ripple at twice the excitation frequency is left to the
low-pass.

Amplitude: an unscaled product has the gain ½ |F| |x|, about 1e-5 of the gain that the reported lock time needs and
different at each level. So both signals are divided by their running amplitude √(2 ⟨s²⟩), the mean square
taken through a low-pass of the same pole a. Two consequences are properties of this loop, not of the code:
noise counts as amplitude and lowers the gain, to |F||x| / √((|F|² + 2σ_F²)(|x|² + 2σ_x²)); and harmonics
enter the product, so that the sum Σ F_n x̄_n is brought into quadrature rather than its fundamental alone.

The loop closes a while after the first ramp: as long as the mode has not built up, the drive point moves in
phase with the force through the other modes, and a closed loop would run off towards the next mode before it
began. It has no guard band: it may lock on any mode.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import SampleBlock
from nmt_core.messages.linear_description import LinearDescription
from nmt_core.messages.records import LevelCommand
from nmt_core.numerics.arrays import FloatArray
from nmt_core.numerics.kernels import njit
from nmt_core.vocabulary import MOTIONS, ControlKind, LoopState
from nmt_pll.level_loop import LevelLoop, LockWindow, LoopOutput
from nmt_pll.phase_loop.paper_settings import PaperSettings
from nmt_pll.thresholds import PHASE

# x̂ for the product: a displacement, or an acceleration upside down.
_SIGN = {motion: (-1.0) ** (order // 2) for motion, order in MOTIONS.items() if order % 2 == 0}

# Places in the state vector.
_FORCE_SQUARE, _RESPONSE_SQUARE, _FILTERED, _INTEGRAL = range(4)


@njit(cache=True)
def _advance(
    state: FloatArray,
    force: FloatArray,
    response: FloatArray,
    step: float,
    gain: float,
    pole: float,
    zero: float,
    low: float,
    high: float,
    held: float,
) -> tuple[float, float]:
    """Run the loop over one block, sample by sample.

    Args:
        state: mean squares of force and response, low-pass output, integrator (rad/s); changed in place.
        force: (samples,); response: (samples,), sign such that positive products raise the frequency.
        step: sampling interval, s.
        gain: K; pole: a; zero: b, rad/s.
        low, high: bounds of the integrator, rad/s.
        held: normalised product at which the loop rests, ½ sin of the phase it holds.

    Returns:
        Block means of the low-pass output (s) and of the controller output y (rad/s).
    """
    keep = np.exp(-pole * step)
    filtered_sum = 0.0
    output_sum = 0.0
    for k in range(force.size):
        state[0] = keep * state[0] + (1.0 - keep) * force[k] ** 2
        state[1] = keep * state[1] + (1.0 - keep) * response[k] ** 2
        scale = 2.0 * np.sqrt(state[0] * state[1])
        product = force[k] * response[k] / scale - held if scale > 0.0 else 0.0
        state[2] = keep * state[2] + (1.0 - keep) / pole * product
        state[3] = min(max(state[3] + gain * zero * step * state[2], low), high)
        filtered_sum += state[2]
        output_sum += gain * state[2] + state[3]
    return filtered_sum / force.size, output_sum / force.size


class PaperLoop(LevelLoop):
    """Product detector, low-pass, PI controller; levels start at fixed intervals.

    Everything runs sample by sample at the sample rate. The oscillator lives in the plant and takes one
    frequency a block: it gets the mean of ω over the block before, which advances its phase as the continuous
    loop would, one block late, and keeps the ripple at twice the frequency from aliasing.

    Waiting: a level's window opens ``waiting_time`` after its start if over the last ``dwell_periods`` the
    mean phase error is within ``phase_tolerance`` and its scatter within ``scatter_limit``; else as soon as
    that is so, or never (time-out).

    Args:
        linear: linear description of the rig.
        settings: loop settings.
        sample_rate: Hz.
        block_samples: samples a block.
    """

    def __init__(
        self, linear: LinearDescription, settings: PaperSettings, sample_rate: float, block_samples: int
    ) -> None:
        super().__init__(linear.drive_point, sample_rate, block_samples, settings.quiet_ramp)
        self.linear = linear
        self.settings = settings
        self.centre = settings.centre_frequency(linear)
        self.frequency = self.centre
        self._state = np.zeros(4)
        self._bounds = (PHASE.lowest_frequency_ratio - 1.0) * self.centre, 0.5 * math.pi * sample_rate - self.centre
        dwell = settings.dwell_periods * 2.0 * math.pi / self.centre
        self._errors: deque[float] = deque(maxlen=max(2, math.ceil(dwell / self.block_duration)))
        self._window_from = 0
        self._closed_from = 0
        self.process_signals(*self.warm_up_data())  # compile now, not with the first block
        self.reset()

    def _check_control(self, level: LevelCommand) -> None:
        if level.control != ControlKind.VOLTAGE:
            raise BenchError(
                f"Level {level.index}: the paper's loop steps the voltage only; "
                "use the adaptive loop for other controls."
            )
        if level.harmonics_control:
            raise BenchError(
                f"Level {level.index}: the paper's loop does not control harmonics of the force; use the adaptive loop."
            )

    def process(self, force: SampleBlock, response: SampleBlock) -> LoopOutput:
        """Answer one block of force and drive-point response.

        Raises:
            ValueError: the blocks do not cover the same samples, or the response is not a displacement or
                acceleration.
        """
        force_row, response_row = self._drive_point_rows(force, response)
        sign = _SIGN.get(response.quantity)
        if sign is None:
            raise ValueError(
                f"the paper's loop needs a displacement or an acceleration, not a {response.quantity.name.lower()}"
            )
        end = force.end_sample
        flags = force.flags | response.flags
        self._start_due_levels(force.first_sample, end)
        filtered = self._signals(force_row, sign * response_row, end > self._closed_from)
        force_amplitude, response_amplitude = (math.sqrt(2.0 * float(self._state[k])) for k in range(2))
        valid = (
            self._amplitude > 0.0
            and end > self._closed_from
            and force_amplitude >= self.settings.force_floor
            and response_amplitude > self.settings.response_floor
        )
        error = math.asin(min(max(2.0 * self.settings.pole * filtered, -1.0), 1.0)) if valid else math.nan
        lock = None
        if self.machine.state in (LoopState.ACQUIRING, LoopState.LOCKED):
            if valid:
                self._errors.append(error)
            lock = self._judge(end, flags, valid)
        return self._output(end, self.frequency, error, (force_amplitude, response_amplitude), lock, flags)

    def reset(self, frequency: float = 0.0) -> None:
        """Start again from an angular frequency (rad/s); 0 = the centre."""
        self._state[:] = 0.0
        self._state[_INTEGRAL] = frequency - self.centre if frequency else 0.0
        self.frequency = frequency or self.centre

    def process_signals(self, force: FloatArray, response: FloatArray, closed: bool = True) -> float:
        """Detector and controller over one block.

        Args:
            force: (samples,), any unit.
            response: (samples,), displacement or minus acceleration, any unit.
            closed: False holds the frequency; the detector goes on.

        Returns:
            Mean of the low-pass output over the block, s; ½ sin ε / a about the lock.
        """
        s = self.settings
        gain = s.gain if closed else 0.0
        filtered, output = _advance(
            self._state, force, response, 1.0 / self.sample_rate, gain, s.pole, s.zero, *self._bounds,
            -0.5 * math.sin(s.held_lead(self.frequency)),
        )  # fmt: skip
        self.frequency = max(self.centre + output, PHASE.lowest_frequency_ratio * self.centre)
        return float(filtered)

    def _signals(self, force: FloatArray, response: FloatArray, closed: bool) -> float:
        if self._amplitude == 0.0 or not (np.all(np.isfinite(force)) and np.all(np.isfinite(response))):
            return 0.0
        return self.process_signals(np.ascontiguousarray(force), np.ascontiguousarray(response), closed)

    def _start(self, level: LevelCommand, end: int, was_quiet: bool) -> None:
        self._amplitude = level.amplitude
        if was_quiet:
            self.reset(2.0 * math.pi * level.frequency_hz)
            self._closed_from = end + round((level.ramp + self.settings.closing_time) * self.sample_rate)
        self._window_from = end + round(self.settings.waiting_time * self.sample_rate)
        ramp_end = end + level.ramp * self.sample_rate
        self._deadline = ramp_end + level.timeout * self.sample_rate if level.timeout else math.inf
        self._errors.clear()

    def _judge(self, end: int, flags: int, valid: bool) -> LockWindow | None:
        reason = self._reason_to_give_up(flags, end, valid)
        if reason:
            self._give_up(end, reason)
            return None
        full = len(self._errors) == self._errors.maxlen
        if self.machine.state == LoopState.LOCKED or end < self._window_from or not full:
            return None
        mean = self._mean_error()
        scatter = math.sqrt(math.fsum((error - mean) ** 2 for error in self._errors) / (len(self._errors) - 1))
        if abs(mean) > self.settings.phase_tolerance or scatter > self.settings.scatter_limit:
            return None
        reason = f"mean phase error {math.degrees(mean):.3f} deg after the waiting time"
        return self._lock(end, self.frequency, mean, reason)

    def _mean_error(self) -> float:
        return math.fsum(self._errors) / len(self._errors)

    def _reason_to_give_up(self, flags: int, end: int, valid: bool) -> str:
        reason = self._stopped_from_outside(flags)
        if reason:
            return reason
        if self.machine.state == LoopState.ACQUIRING:
            return "no lock within the time-out" if end > self._deadline else ""
        if not valid:
            return "force or response fell below its amplitude floor"
        mean = self._mean_error()
        if abs(mean) > self.settings.unlock_tolerance:
            return (
                f"mean phase error {math.degrees(mean):.2f} deg exceeds "
                f"{math.degrees(self.settings.unlock_tolerance):.2f} deg"
            )
        return ""
