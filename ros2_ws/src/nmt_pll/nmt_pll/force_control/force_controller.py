"""The law that brings the forces of one exciter or several to their targets: an integral controller on all their terms.

An exciter driven by a sine of voltage gives a force with harmonics, because the structure moves with harmonics and the
exciter resists them; and where there are several exciters, each moves the points of the others. With the complex
amplitudes F_n, V_n (exciters,) of harmonic n in the frame n θ of the oscillator,

    F_n = G(n f) V_n + d_n,

where G is the force at every exciter per volt of every exciter at n f, and d_n what the motion of the structure makes
of the forces without V_n. Each V_n is integrated against the deviations of F_n from their targets,

    dV_n/dt = −κ Ĝ(n f)⁻¹ (F_n − F_n*).

One term is left out: the fundamental of the first exciter is the reference. Its amplitude is the level, and the phase
loop brings it into phase resonance.

The measured F_n have passed the adaptive Fourier filter, a low-pass of cut-off ω_LP, and the command acts after a dead
time T. With κ = m/(1/ω_LP + T) the open loop κ e^{−sT}/(s (1 + s/ω_LP)) has a phase margin of at least 90° − m, since
arctan x ≤ x, and a gain margin of at least π/(2 m); m = 0.35 rad gives 70° and 4.5. For several exciters that holds for
every eigenvalue of G Ĝ⁻¹: Ĝ may be wrong by that much.

* Harmonics: Ĝ is what was known or probed, corrected by what control itself sees
  (:mod:`~nmt_pll.force_control.gain_estimate`). A Ĝ of wrong sign, which lets V_n run away, is put right by that
  motion.
* Fundamentals of exciters 2, 3, …: Ĝ is diagonal and stays, as a force near the resonance does not follow its voltage
  at once (:func:`~nmt_pll.force_control.force_per_volt.fundamental_gain`).
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from nmt_core.messages.records import DriveTerm
from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_pll.force_control.deviation_record import FEWEST_BLOCKS, DeviationRecord
from nmt_pll.force_control.force_per_volt import ForcePerVolt
from nmt_pll.force_control.gain_estimate import GainEstimate, applied, solved
from nmt_pll.force_control.held_voltages import HeldVoltages
from nmt_pll.thresholds import HARMONICS


def integral_rate(cutoff: float, dead_time: float, margin: float = HARMONICS.phase_margin_rad) -> float:
    """κ = m/(1/ω_LP + T) in 1/s: phase margin at least π/2 − m, gain margin at least π/(2 m).

    Args:
        cutoff: ω_LP of the adaptive filter, rad/s.
        dead_time: T, mean delay between measurement and its effect, s.
        margin: m, rad.
    """
    return margin / (1.0 / cutoff + dead_time)


def most_harmonics(
    frequency_hz: float, sample_rate: float, cutoff: float, wanted: int = HARMONICS.automatic_highest
) -> int:
    """Highest harmonic, at most ``wanted``, that stays below half the sample rate and that the filter can track.

    Args:
        frequency_hz: highest frequency of the fundamental.
        sample_rate: Hz.
        cutoff: ω_LP of the adaptive filter, rad/s.
        wanted: number asked for.
    """
    below_nyquist = math.ceil(0.5 * sample_rate / frequency_hz) - 1
    tracked = math.ceil(sample_rate / (2.0 * cutoff) - 0.5) - 2  # the filter has one harmonic more
    return max(1, min(wanted, below_nyquist, tracked))


@dataclass(frozen=True, slots=True)
class ForceSetup:
    """How the forces are controlled.

    Attributes:
        highest: H; harmonics 2 to H of every force are controlled, 1 = none.
        cutoff: ω_LP of the filter that F_n comes from, rad/s.
        block_duration: s.
        latency_blocks: blocks of buffering between command and excitation.
        dead_time: mean delay between measurement and its effect, s.
        dwell_blocks: blocks over which a settled force is judged.
        voltage_limit: V that the terms of an exciter together must stay below; 0 = none.
        slew_limit: V/s that they must stay below together; 0 = none.
        sample_rate: Hz.
        tolerance: deviation that counts as settled, of the first exciter's fundamental.
    """

    highest: int
    cutoff: float
    block_duration: float
    latency_blocks: int
    dead_time: float
    dwell_blocks: int
    voltage_limit: float = 0.0
    slew_limit: float = 0.0
    sample_rate: float = 1e4
    tolerance: float = HARMONICS.settled_share


class ForceController:
    """Terms of the drive that bring the harmonics 1 … H of N forces to their targets.

    Arrays have the shape (N, H), row j the exciter and column n - 1 the harmonic.

    Args:
        setup: how.
        force_per_volt: G(f) as far as it is known; where it is NaN, it is probed.
        start: V_j/V_1 of the fundamentals after rest, shape (N,).
        fundamental_gain: Ĝ_j of the fundamentals, N/V, shape (N,).

    Attributes:
        orders: 1 … H.
        terms: values for the next block: fundamentals over that of the first exciter, harmonics in V of one exciter, of
            several over that fundamental, too.
        rate: κ, 1/s.
        off: whether the harmonics are zero in the drive and not controlled.
        given_up: (exciter from 1, harmonic) -> why it is not controlled any more until the drive has been at rest.
    """

    def __init__(
        self,
        setup: ForceSetup,
        force_per_volt: ForcePerVolt,
        start: ComplexArray | None = None,
        fundamental_gain: ComplexArray | None = None,
    ) -> None:
        self.setup = setup
        self.orders = np.arange(1, setup.highest + 1)
        self.rate = integral_rate(setup.cutoff, setup.dead_time)
        self.off = False
        self.given_up: dict[tuple[int, int], str] = {}
        self._start: ComplexArray = np.ones(1, complex) if start is None else start
        self._fundamental_gain: ComplexArray = np.ones(1, complex) if fundamental_gain is None else fundamental_gain
        count = self._start.size
        shape = count, setup.highest
        self.terms: ComplexArray = np.zeros(shape, complex)
        self.terms[:, 0] = self._start
        self._relative = count > 1  # they all follow one amplitude up and down
        self._known_later: ComplexArray = np.full((setup.highest - 1, count, count), np.nan + 0j)
        self._force_per_volt = force_per_volt
        self._estimate = GainEstimate(setup.highest - 1, count)
        self._held = HeldVoltages(
            shape, setup.cutoff, setup.block_duration, setup.latency_blocks, straight=self._relative
        )
        lag = max(1, round(1.0 / (setup.cutoff * setup.block_duration)))
        self._past: deque[tuple[ComplexArray, ComplexArray, Sequence[complex]]] = deque(maxlen=lag + 1)
        self._record = DeviationRecord(
            setup.dwell_blocks, (count * setup.highest - 1,), setup.cutoff, setup.block_duration
        )
        self._strikes = np.zeros((count, setup.highest - 1), int)
        self._limited: FloatArray = np.zeros((count, setup.highest - 1))
        self._looked_at: FloatArray = np.full((count, setup.highest - 1), np.inf)
        self._since_look: FloatArray = np.zeros((count, setup.highest - 1))
        self._motion = math.inf
        self._probe: tuple[int, int, int, list[complex]] | None = None
        self._rest = 0
        self._fundamental = 0.0
        self._deviation: ComplexArray = np.zeros(shape, complex)
        self._mean: FloatArray = np.zeros(shape)
        self._noise: FloatArray = np.zeros(shape)

    @property
    def exciters(self) -> int:
        """Number N of exciters."""
        return int(self.terms.shape[0])

    @property
    def controls(self) -> bool:
        """Whether there is anything to control."""
        return self._relative or not self.off

    @property
    def _active(self) -> np.ndarray:
        """Which terms are controlled, bool (N, H), given up or not."""
        active = np.full(self.terms.shape, not self.off)
        active[:, 0] = True
        active[0, 0] = False
        return active

    @property
    def _without_control(self) -> np.ndarray:
        """Which terms were given up, bool (N, H)."""
        result = np.zeros(self.terms.shape, bool)
        for exciter, order in self.given_up:
            result[exciter - 1, order - 1] = True
        return result

    def _scale(self, amplitude: float) -> FloatArray:
        """V that a term of one has beside a drive of this amplitude, shape (H,)."""
        scale = np.full(self.orders.size, amplitude if self._relative else 1.0)
        scale[0] = amplitude
        return scale

    def _in_drive(self) -> ComplexArray:
        if not self.off:
            return self.terms
        terms = np.zeros_like(self.terms)
        terms[:, 0] = self.terms[:, 0]
        return terms

    # -- levels --------------------------------------------------------------------------------------------------

    def clear(self) -> None:
        """The drive is at rest: terms are those of the start, all are tried again; what was learnt of G stays."""
        self.given_up.clear()
        self.terms = np.zeros_like(self.terms)
        self.terms[:, 0] = self._start
        self._held.clear()
        self._probe = None
        self.start_level()

    def take_over(self, before: ForceController) -> None:
        """Begin with the fundamentals of another controller of as many exciters."""
        self.terms[:, 0] = before.terms[:, 0]

    def start_level(self) -> None:
        """A new level begins: terms stay, and what was given up stays so until the drive is at rest."""
        self._strikes[:] = 0
        self._limited[:] = 0.0
        self._past.clear()
        self.restart_dwell()

    def restart_dwell(self) -> None:
        """Judge what comes from now on."""
        self._record.restart()
        self._looked_at[:] = np.inf
        self._since_look[:] = 0.0

    # -- one block -----------------------------------------------------------------------------------------------

    def idle(self, amplitude: float) -> None:
        """A block in which nothing is controlled: terms stay beside a drive of this amplitude, V."""
        self._held.advance(self._in_drive() * self._scale(amplitude))
        self._past.clear()

    def rest(self) -> None:
        """The drive is on its way to zero: what follows its amplitude goes along, what does not is zero at once."""
        if self._relative:
            self.idle(0.0)
        else:
            self.clear()

    def _known(self, frequency_hz: float) -> ComplexArray:
        """G(n f) of the harmonics as it was known at first, N/V, (H - 1, N, N); NaN where it has to be probed."""
        if self.orders.size == 1:
            return self._known_later
        known = self._force_per_volt(np.asarray(self.orders[1:] * frequency_hz, dtype=np.float64))
        return np.where(np.isnan(known), self._known_later, known)

    def fit(self, amplitude: float, frequency_hz: float) -> None:
        """Keep the next block's terms within the limits beside a drive of this amplitude (V), also while idle.

        Fundamentals go first: harmonics have the room that is left.
        """
        if amplitude > 0.0:
            for limit, weights in self._limits(frequency_hz):
                largest = HARMONICS.voltage_limit_share * limit / (float(weights[0]) * amplitude)
                size = np.abs(self.terms[1:, 0])
                self.terms[1:, 0] *= np.minimum(1.0, largest / np.maximum(size, 1e-300))
        self.terms[:, 1:] = self.terms[:, 1:] * self._room(amplitude, frequency_hz)

    def _limits(self, frequency_hz: float) -> list[tuple[float, FloatArray]]:
        """Limits there are, each with what a volt of every harmonic takes of it, (H,)."""
        step = math.pi * frequency_hz / self.setup.sample_rate
        limits = [
            (self.setup.voltage_limit, np.ones(self.orders.size)),
            (self.setup.slew_limit, 2.0 * self.setup.sample_rate * np.sin(step * self.orders)),
        ]
        return [(limit, weights) for limit, weights in limits if limit > 0.0]

    def _room(self, amplitude: float, frequency_hz: float) -> FloatArray:
        """Share of the present harmonics of each exciter, at most 1, that the limits leave room for, (N, 1)."""
        share = np.ones(self.exciters)
        fundamentals = np.abs(self.terms[:, 0]) * amplitude
        sizes = np.abs(self.terms[:, 1:]) * self._scale(amplitude)[1:]
        for limit, weights in self._limits(frequency_hz):
            together = np.sum(sizes * weights[1:], axis=1)
            room = np.maximum(0.0, HARMONICS.voltage_limit_share * limit - fundamentals * float(weights[0]))
            share = np.where(together > room, np.minimum(share, room / np.maximum(together, 1e-300)), share)
        return np.asarray(share[:, None])

    def gain(self, frequency_hz: float) -> ComplexArray:
        """Ĝ(n f) of the harmonics 2 … H, N/V, shape (H - 1, N, N); NaN where it has still to be probed."""
        return self._estimate.gain(self._known(frequency_hz))

    def update(
        self,
        force: ComplexArray,
        response: Sequence[complex],
        frequency_hz: float,
        amplitude: float,
        target: ComplexArray,
        ramp_from: float = 0.0,
    ) -> None:
        """One block of control; ``terms`` are those of the next block.

        Args:
            force: F_jn behind the adaptive filter, N, shape (N, H).
            response: fundamentals of the response at points that tell whether the motion changes, any unit.
            frequency_hz: of the fundamental.
            amplitude: of the first exciter's fundamental, V.
            target: F_jn*, N, shape (N, H).
            ramp_from: V that the amplitude comes from where it is still on its way.
        """
        scale = self._scale(max(amplitude, ramp_from))  # rather too small a change of a ratio than too great a one
        seen = self._held.advance(self._in_drive() * self._scale(amplitude)).copy()
        self._fundamental = abs(force[0, 0])
        known = self._known(frequency_hz)
        if np.isnan(known).any() and not self.off:
            self._probe_next(known, force, amplitude, scale)
            return
        if self._rest > 0:  # what the last probe has left in the filter is no deviation
            self._rest -= 1
            self._past.clear()
            return
        active = self._active
        self._deviation = np.where(active, force - target, 0j)
        self._judge_block(active)
        if self._relative and ramp_from > 0.0:  # the ramp itself moves the voltages
            self._past.clear()
        elif self.orders.size > 1 and not self.off:
            self._learn(force, seen[:, 1:], response, known, frequency_hz)
        gain = self._estimate.gain(known)
        step = self._step(gain, active) / scale
        largest = HARMONICS.largest_step_share * amplitude / scale
        step *= np.minimum(1.0, largest / np.maximum(self._sizes(step, active), 1e-300))
        self.terms = self.terms + step
        self.terms = np.where(self._without_control, HARMONICS.fade_per_block * (self.terms - step), self.terms)
        if not self.off:
            self._limit(amplitude, scale, frequency_hz, gain)
            self._review()

    def _step(self, gain: ComplexArray, active: np.ndarray) -> ComplexArray:
        """Changes of the voltages, V, (N, H), without bounds."""
        matrices = np.zeros((self.orders.size, self.exciters, self.exciters), complex)
        matrices[0] = np.diag(self._fundamental_gain)
        matrices[1:] = np.eye(self.exciters) if self.off else gain
        # Who was given up does not work for the others, and they do not work for it.
        works = (active & ~self._without_control).T
        together = (works[:, :, None] & works[:, None, :]) | np.eye(self.exciters, dtype=bool)
        trust = np.ones(self.terms.shape)
        trust[:, 1:] = self._estimate.trust.T
        wanted = -self.rate * self.setup.block_duration * self._quiet_share() * trust * self._deviation
        return solved(np.where(together, matrices, 0j), wanted.T).T

    def _sizes(self, step: ComplexArray, active: np.ndarray) -> FloatArray:
        """What bounds every change: the largest of those that work together, else its size, (N, H)."""
        size = np.abs(step)
        works = active & ~self._without_control
        return np.where(works, np.max(np.where(works, size, 0.0), axis=0), size)

    def _judge_block(self, active: np.ndarray) -> None:
        """Mean deviation and noise over the dwell so far."""
        controlled = np.ones(active.shape, bool)
        controlled[0, 0] = False
        self._record.add(self._deviation[controlled])
        length, most = self._record.length, self._record.blocks
        if length < FEWEST_BLOCKS:
            self._mean = np.abs(self._deviation)
            return
        mean, bends = self._record.mean_and_noise()
        self._mean[controlled] = np.abs(mean)
        noise = np.zeros(active.shape)
        noise[controlled] = bends
        if length < most:  # too few values; what is there from before counts
            noise = np.where(self._noise > 0.0, np.minimum(noise, self._noise), noise)
        grow = 2.0 ** (1.0 / (HARMONICS.noise_doubling_dwells * most))
        self._noise = np.where(self._noise > 0.0, np.minimum(noise, self._noise * grow), noise)

    def _quiet_share(self) -> FloatArray:
        """Share of κ: in noise so small that the noise which control puts into F_n stays below the tolerance.

        Noise σ behind the filter comes back with the variance σ² κ/ω_LP.
        """
        wanted = 0.5 * self.setup.tolerance * self._fundamental
        ratio = (wanted / np.maximum(self._noise, 1e-3 * wanted + 1e-300)) ** 2 * self.setup.cutoff / self.rate
        share = np.clip(ratio, HARMONICS.lowest_gain_share, 1.0)
        share[:, 0] = 1.0  # near the resonance Ĝ is more than the gain at which noise comes through
        return np.asarray(share)

    def _learn(
        self,
        force: ComplexArray,
        seen: ComplexArray,
        response: Sequence[complex],
        known: ComplexArray,
        frequency_hz: float,
    ) -> None:
        """Put Ĝ of the harmonics right by what the newest changes of voltage have done to the forces."""
        self._past.append((force.copy(), seen, response))
        self._estimate.grow(2.0 ** (self.rate * self.setup.block_duration / HARMONICS.variance_doubling_time_constants))
        if len(self._past) < (self._past.maxlen or 0):
            return
        old_force, old_seen, old_response = self._past[0]
        moved = max(abs(now - before) for now, before in zip(response, old_response, strict=True))
        self._motion = motion = moved / max(*map(abs, response), 1e-300)
        harmonics, orders = force[:, 1:].T, self.orders[1:, None]
        change = (force - old_force).T
        disturbance = np.abs(harmonics - applied(self._estimate.gain(known), seen.T))
        disturbance *= np.minimum(1.0, HARMONICS.motion_disturbance_ratio * orders * motion)
        if self._relative:  # fundamentals are moved here, and the filter lets some of that into the harmonics
            disturbance += self.setup.cutoff / (2.0 * math.pi * frequency_hz * (orders - 1)) * np.abs(change[0])
        noise = self._noise[:, 1:].T
        scatter = 2.0 * noise**2 + disturbance**2 + (HARMONICS.unexplained_share * self._fundamental) ** 2
        scatter *= len(self._past) - 1  # overlapping differences tell the same thing as often
        self._estimate.learn(known * (seen - old_seen).T[:, None, :], change[1:], disturbance, scatter)

    def _limit(self, amplitude: float, scale: FloatArray, frequency_hz: float, gain: ComplexArray) -> None:
        """Keep every harmonic, and all of them together, below what is allowed; name what stays there."""
        if self.orders.size == 1:
            return
        size = np.abs(self.terms[:, 1:] * scale[1:])
        largest = np.full(size.shape, HARMONICS.largest_voltage_share * amplitude)
        share = self._room(amplitude, frequency_hz)
        largest = np.where(share < 1.0, np.minimum(largest, share * size), largest)
        over = (size > largest) | (largest == 0.0)
        self.terms[:, 1:] = np.where(over, self.terms[:, 1:] * largest / np.maximum(size, 1e-300), self.terms[:, 1:])
        self._limited = np.where(over, self._limited + self.setup.block_duration, 0.0)
        for_long = self._limited > HARMONICS.limited_time_constants / self.rate
        row, column = divmod(int(np.argmax(np.where(for_long, size, -1.0))), size.shape[1])
        place = row + 1, column + 2
        if for_long[row, column] and place not in self.given_up:
            # One at a time, the greatest first: where all share one limit, the others may then have room.
            self.given_up[place] = (
                f"it would need more than {largest[row, column]:.3g} V (at {abs(gain[column, row, row]):.3g} N/V, "
                f"{self._share(*place):.2g} % of the fundamental are left)"
            )
            self._limited[:] = 0.0

    def _review(self) -> None:
        """From time to time: whether every harmonic that is not settled gets nearer to its target."""
        if self._motion > HARMONICS.steady_motion_change or not self._record.is_full:
            return  # what changes by itself says nothing of control
        self._since_look += self.setup.block_duration * self._quiet_share()[:, 1:]
        due = self._since_look >= HARMONICS.review_time_constants / self.rate
        if not due.any():
            return
        self._since_look[due] = 0.0
        settled = self.settled[:, 1:]
        relative = self._mean[:, 1:] / max(self._fundamental, 1e-300)
        stuck = due & ~settled & (relative > HARMONICS.progress_share * self._looked_at) & (self._limited == 0.0)
        self._strikes = np.where(stuck, self._strikes + 1, np.where(due & settled, 0, self._strikes))
        lower = np.where(np.isinf(self._looked_at), relative, np.minimum(self._looked_at, relative))
        self._looked_at = np.where(due, lower, self._looked_at)
        # What was learnt may be the reason: it is open to doubt at the first look, and forgotten at the second.
        self._estimate.doubt(stuck.T)
        self._estimate.forget((stuck & (self._strikes == HARMONICS.reviews_without_progress - 1)).T)
        for row, column in np.argwhere(self._strikes >= HARMONICS.reviews_without_progress).tolist():
            place = row + 1, column + 2
            if place not in self.given_up:
                share = f"{self._share(*place):.2g} % of the fundamental are left"
                self.given_up[place] = f"the force does not follow the drive ({share})"

    def _share(self, exciter: int, order: int) -> float:
        """Mean deviation over the fundamental, %."""
        return 100.0 * float(self._mean[exciter - 1, order - 1]) / max(self._fundamental, 1e-300)

    # -- probing -------------------------------------------------------------------------------------------------

    def _probe_next(self, known: ComplexArray, force: ComplexArray, amplitude: float, scale: FloatArray) -> None:
        """Go on with the probing: one harmonic of one exciter at a time, a small voltage up and then down."""
        wait = math.ceil(4.0 / (self.setup.cutoff * self.setup.block_duration)) + 1 + self.setup.latency_blocks
        if self._probe is None:
            index, _, exciter = np.argwhere(np.isnan(known))[0].tolist()
            self._probe = (index, exciter, 0, [])
            self.terms[:, 1:] = 0.0
            self.terms[exciter, index + 1] = HARMONICS.probe_share * amplitude / scale[index + 1]
            return
        index, exciter, blocks, ends = self._probe
        place, blocks = (exciter, index + 1), blocks + 1
        if blocks == wait:
            ends = [*force[:, index + 1].tolist(), complex(self._held.value[place])]
            self.terms[place] = -HARMONICS.probe_share * amplitude / scale[index + 1]
        elif blocks == 2 * wait:
            moved = complex(self._held.value[place]) - ends[-1]
            for row in range(self.exciters):
                found = (complex(force[row, index + 1]) - ends[row]) / moved if moved != 0 else 0j
                self._known_later[index, row, exciter] = found if found != 0 else 1e-12 + 0j
            self._estimate.forget(np.arange(self.orders.size - 1)[:, None] == np.full(self.exciters, index))
            self.terms[place] = 0.0
            self._probe = None
            self._rest = wait
            return
        self._probe = (index, exciter, blocks, ends)

    @property
    def is_probing(self) -> bool:
        """Whether Ĝ is still being measured."""
        return self._probe is not None or self._rest > 0

    # -- judgement -----------------------------------------------------------------------------------------------

    @property
    def settled(self) -> np.ndarray:
        """Whether each force is at its target, bool (N, H): within the tolerance, or nothing but noise is left."""
        mean_std = self._record.mean_std(self._noise)
        tolerance = self.setup.tolerance * self._fundamental
        in_mean = self._mean <= tolerance + HARMONICS.noise_sigmas * mean_std
        now = np.abs(self._deviation) <= HARMONICS.newest_value_ratio * tolerance + HARMONICS.noise_sigmas * self._noise
        result: np.ndarray = in_mean & now
        return result

    def _name(self, exciter: int, order: int) -> str:
        return f"harmonic {order}" + (f" of the force of exciter {exciter}" if self._relative else "")

    @property
    def obstacle(self) -> str:
        """What keeps the forces from being settled, empty if nothing does; harmonics given up do not count."""
        if not self.controls:
            return ""
        if self.is_probing:
            return "force per volt of the harmonics is being measured"
        if not self._record.is_full:
            return "the forces have not been controlled for a dwell yet"
        open_terms = self._active & ~self.settled & ~self._without_control
        if not open_terms.any():
            return ""
        place = np.unravel_index(int(np.argmax(np.where(open_terms, self._mean, -1.0))), open_terms.shape)
        exciter, order = int(place[0]) + 1, int(place[1]) + 1
        name = self._name(exciter, order)
        name = name if self._relative else f"force {name}"
        return f"{name} is {self._share(exciter, order):.2g} % of the fundamental off its target"

    @property
    def summary(self) -> str:
        """How the forces are: the greatest deviation of those that are controlled, and which were given up."""
        if not self.controls:
            return ""
        parts = []
        kept = self._active & ~self._without_control
        if kept.any():
            row, column = np.unravel_index(int(np.argmax(np.where(kept, self._mean, -1.0))), kept.shape)
            share = f"{self._share(int(row) + 1, int(column) + 1):.2g} % of the fundamental"
            highest = int(self.orders[kept.any(axis=0)].max())
            if self._relative:
                parts.append(f"forces of {self.exciters} exciters within {share}")
            else:
                parts.append(f"force harmonics up to {highest} within {share} (harmonic {int(column) + 1})")
        parts += [f"{self._name(*place)} given up: {why}" for place, why in sorted(self.given_up.items())]
        return "; ".join(parts)

    def drive_terms(self) -> tuple[DriveTerm, ...]:
        """Terms of the drive for the next block; harmonics are zero while ``off``."""
        values = self._in_drive().tolist()
        return tuple(
            DriveTerm(row + 1, column + 1, value, self._relative)
            for row, line in enumerate(values)
            for column, value in enumerate(line)
            if (row, column) != (0, 0)
        )
