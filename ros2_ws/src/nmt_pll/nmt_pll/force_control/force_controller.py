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
from dataclasses import dataclass, field

import numpy as np

from nmt_core.messages.records import DriveTerm
from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_core.vocabulary import AUTOMATIC
from nmt_pll.force_control.deviation_record import FEWEST_BLOCKS, DeviationRecord
from nmt_pll.force_control.force_per_volt import ForcePerVolt
from nmt_pll.force_control.gain_estimate import GainEstimate, applied, solved
from nmt_pll.force_control.held_voltages import HeldVoltages
from nmt_pll.thresholds import HARMONICS


def integral_rate(cutoff: float, dead_time: float) -> float:
    """κ = m/(1/ω_LP + T) in 1/s: phase margin at least π/2 − m, gain margin at least π/(2 m).

    Args:
        cutoff: ω_LP of the adaptive filter, rad/s.
        dead_time: T, mean delay between measurement and its effect, s.
    """
    return HARMONICS.phase_margin_rad / (1.0 / cutoff + dead_time)


def most_harmonics(frequency_hz: float, sample_rate: float, cutoff: float, wanted: int = AUTOMATIC) -> int:
    """Highest harmonic, at most ``wanted``, that stays below half the sample rate and that the filter can track.

    Args:
        frequency_hz: highest frequency of the fundamental.
        sample_rate: Hz.
        cutoff: ω_LP of the adaptive filter, rad/s.
        wanted: number asked for, or ``AUTOMATIC``.
    """
    wanted = HARMONICS.automatic_highest if wanted == AUTOMATIC else wanted
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
    tolerance: float = field(default_factory=lambda: HARMONICS.settled_share)


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
        self._places = [divmod(place, setup.highest) for place in range(1, count * setup.highest)]
        self._masks: tuple[tuple[object, ...], np.ndarray, np.ndarray] | None = None
        self._motion_shares: FloatArray = HARMONICS.motion_disturbance_ratio * self.orders[1:, None].astype(np.float64)
        self._allowed, self._taken = self._limits()
        self._known_later: ComplexArray = np.full((setup.highest - 1, count, count), np.nan + 0j)
        self._force_per_volt = force_per_volt
        self._estimate = GainEstimate(setup.highest - 1, count)
        self._held = HeldVoltages(
            (count, setup.highest - 1),
            setup.cutoff,
            setup.block_duration,
            setup.latency_blocks,
            straight=self._relative,
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
        self._quiet: FloatArray = np.ones((count, setup.highest - 1))

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
        return self._given_up_and_works()[0]

    def _given_up_and_works(self) -> tuple[np.ndarray, np.ndarray]:
        """Which terms were given up, and which are controlled and were not, bool (N, H); made where that changes."""
        state = self.off, *self.given_up
        if self._masks is None or self._masks[0] != state:
            given_up = np.zeros(self.terms.shape, bool)
            for exciter, order in self.given_up:
                given_up[exciter - 1, order - 1] = True
            self._masks = state, given_up, self._active & ~given_up
        return self._masks[1:]

    def _unit(self, amplitude: float) -> float:
        """V that a controlled term of one has next to a drive of this amplitude."""
        return amplitude if self._relative else 1.0

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
        """A block in which nothing is controlled: terms stay next to a drive of this amplitude, V."""
        self._held.advance(self._in_drive()[:, 1:] * self._unit(amplitude))
        self._past.clear()

    def rest(self) -> None:
        """The drive is on its way to zero: what follows its amplitude goes along, what does not is zero at once."""
        if self._relative:
            self.idle(0.0)
        else:
            self.clear()

    def _known(self, frequency_hz: float) -> tuple[ComplexArray, bool]:
        """G(n f) of the harmonics as it was known at first, N/V, (H - 1, N, N), and whether it is known everywhere.

        It is NaN where it has to be probed.
        """
        if self.orders.size == 1:
            return self._known_later, True
        known = self._force_per_volt(np.asarray(self.orders[1:] * frequency_hz, dtype=np.float64))
        missing = np.isnan(known)
        if not missing.any():
            return known, True
        known = np.where(missing, self._known_later, known)
        return known, not np.isnan(known).any()

    def fit(self, amplitude: float, frequency_hz: float) -> None:
        """Keep the next block's terms within the limits next to a drive of this amplitude (V), also while idle.

        Fundamentals go first: harmonics have the room that is left.
        """
        taken = self._taken_at(frequency_hz)
        if self._relative and amplitude > 0.0:
            for allowed, weights in zip(self._allowed.tolist(), taken, strict=True):
                largest = allowed / (float(weights[0]) * amplitude)
                size = np.abs(self.terms[1:, 0])
                self.terms[1:, 0] *= np.minimum(1.0, largest / np.maximum(size, 1e-300))
        room = self._room(np.abs(self.terms[:, 1:]) * self._unit(amplitude), amplitude, taken)
        if room is not None:
            self.terms[:, 1:] *= room

    def _limits(self) -> tuple[FloatArray, FloatArray]:
        """What terms may take of each limit there is, (L,), and what a volt of each takes, (L, H), but for slew."""
        limits = [limit for limit in (self.setup.voltage_limit, self.setup.slew_limit) if limit > 0.0]
        allowed = HARMONICS.voltage_limit_share * np.array(limits, float)
        return allowed, np.ones((len(limits), self.orders.size))

    def _taken_at(self, frequency_hz: float) -> FloatArray:
        """What a volt of every term takes of each limit at a frequency, (L, H); good until the next call."""
        if self.setup.slew_limit > 0.0:
            step = math.pi * frequency_hz / self.setup.sample_rate
            self._taken[-1] = 2.0 * self.setup.sample_rate * np.sin(step * self.orders)
        return self._taken

    def _room(self, sizes: FloatArray, amplitude: float, taken: FloatArray) -> FloatArray | None:
        """Share of the harmonics of each exciter, at most 1, that the limits leave room for, (N, 1); None = of all.

        Args:
            sizes: of the harmonics, V, shape (N, H - 1).
            amplitude: of the first exciter's fundamental, V.
            taken: of `_taken_at`.
        """
        if not self._allowed.size:
            return None
        together = np.add.reduce(sizes * taken[:, None, 1:], axis=2)
        fundamentals = np.abs(self.terms[:, 0]) * amplitude
        room = np.maximum(0.0, self._allowed[:, None] - fundamentals * taken[:, :1])
        over = together > room
        if not over.any():
            return None
        shares = np.where(over, room / np.maximum(together, 1e-300), 1.0)
        return np.asarray(np.minimum.reduce(shares, axis=0)[:, None])

    def gain(self, frequency_hz: float) -> ComplexArray:
        """Ĝ(n f) of the harmonics 2 … H, N/V, shape (H - 1, N, N); NaN where it has still to be probed."""
        return self._estimate.gain(self._known(frequency_hz)[0])

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
        unit = self._unit(max(amplitude, ramp_from))  # rather too small a change of a ratio than too great a one
        seen = self._held.advance(self._in_drive()[:, 1:] * self._unit(amplitude))
        self._fundamental = abs(force[0, 0])
        known, everywhere = self._known(frequency_hz)
        if not everywhere and not self.off:
            self._probe_next(known, force, amplitude, unit)
            return
        if self._rest > 0:  # what the last probe has left in the filter is not a deviation
            self._rest -= 1
            self._past.clear()
            return
        self._deviation = force - target
        self._deviation[0, 0] = 0.0
        if self.off:
            self._deviation[:, 1:] = 0.0
        self.judge_block()
        self._quiet = self.quiet_share()
        if self._relative and ramp_from > 0.0:  # the ramp itself moves the voltages
            self._past.clear()
        elif self.orders.size > 1 and not self.off:
            self.learn_gains(force, seen, response, known, frequency_hz)
        gain = self._estimate.gain(known)
        step = self._step(gain)
        largest = HARMONICS.largest_step_share * amplitude
        size = np.abs(step)
        if (size > largest).any():
            # The largest of those that work together bounds them all.
            works = self._given_up_and_works()[1]
            size = np.where(works, np.max(np.where(works, size, 0.0), axis=0), size)
            step *= np.minimum(1.0, largest / np.maximum(size, 1e-300))
        if self._relative:
            step /= unit
        self.terms = self.terms + step
        if self.given_up:
            self.terms = np.where(self._without_control, HARMONICS.fade_per_block * (self.terms - step), self.terms)
        if not self.off and self.orders.size > 1:
            self.limit_terms(amplitude, unit, frequency_hz, gain)
            self.review()

    def _step(self, gain: ComplexArray) -> ComplexArray:
        """Changes of the voltages, V, (N, H), without bounds."""
        step = np.zeros(self.terms.shape, complex)
        share = -self.rate * self.setup.block_duration
        step[1:, 0] = share * self._deviation[1:, 0] / self._fundamental_gain[1:]
        if self.off:
            return step
        if self.given_up:  # who was given up does not work for the others, and they do not work for it
            works = self._given_up_and_works()[1][:, 1:].T
            together = (works[:, :, None] & works[:, None, :]) | np.eye(self.exciters, dtype=bool)
            gain = np.where(together, gain, 0j)
        wanted = share * self._quiet * self._estimate.trust.T * self._deviation[:, 1:]
        step[:, 1:] = solved(gain, wanted.T).T
        return step

    def judge_block(self) -> None:
        """Mean deviation and noise over the dwell so far."""
        self._record.add(self._deviation.ravel()[1:])  # without the reference
        length, most = self._record.length, self._record.blocks
        if length < FEWEST_BLOCKS:
            self._mean = np.abs(self._deviation)
            return
        mean, bends = self._record.mean_and_noise()
        self._mean.flat[1:] = np.abs(mean)
        noise = np.zeros(self._mean.shape)
        noise.flat[1:] = bends
        if length < most:  # too few values; what is there from before counts
            noise = np.where(self._noise > 0.0, np.minimum(noise, self._noise), noise)
        grow = 2.0 ** (1.0 / (HARMONICS.noise_doubling_dwells * most))
        self._noise = np.where(self._noise > 0.0, np.minimum(noise, self._noise * grow), noise)

    def quiet_share(self) -> FloatArray:
        """Share of κ, (N, H - 1), so small in noise that what control puts of it into F_n stays below the tolerance.

        Noise σ behind the filter comes back with the variance σ² κ/ω_LP. Fundamentals have all of κ: near the resonance
        Ĝ is more than the gain at which noise comes through.
        """
        wanted = 0.5 * self.setup.tolerance * self._fundamental
        noise = np.maximum(self._noise[:, 1:], 1e-3 * wanted + 1e-300)
        ratio = (wanted / noise) ** 2 * self.setup.cutoff / self.rate
        return np.asarray(np.minimum(np.maximum(ratio, HARMONICS.lowest_gain_share), 1.0))

    def learn_gains(
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
        change = (force - old_force).T
        disturbance = np.abs(force[:, 1:].T - applied(self._estimate.gain(known), seen.T))
        disturbance *= np.minimum(1.0, self._motion_shares * motion)
        if self._relative:  # fundamentals are moved here, and the filter lets some of that into the harmonics
            steps = self.orders[:-1, None]  # from the fundamental
            disturbance += self.setup.cutoff / (2.0 * math.pi * frequency_hz * steps) * np.abs(change[0])
        noise = self._noise[:, 1:].T
        scatter = 2.0 * noise**2 + disturbance**2 + (HARMONICS.unexplained_share * self._fundamental) ** 2
        scatter *= len(self._past) - 1  # overlapping differences tell the same thing as often
        self._estimate.learn(known * (seen - old_seen).T[:, None, :], change[1:], disturbance, scatter)

    def limit_terms(self, amplitude: float, unit: float, frequency_hz: float, gain: ComplexArray) -> None:
        """Keep every harmonic, and all of them together, below what is allowed; name what stays there."""
        magnitude = np.abs(self.terms[:, 1:])
        size = magnitude * unit
        share = self._room(magnitude * self._unit(amplitude), amplitude, self._taken_at(frequency_hz))
        most = HARMONICS.largest_voltage_share * amplitude
        if share is None and most > 0.0 and not (size > most).any():
            self._limited[:] = 0.0
            return
        largest = np.full(size.shape, most)
        if share is not None:
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

    def review(self) -> None:
        """From time to time: whether every harmonic that is not settled gets nearer to its target."""
        if self._motion > HARMONICS.steady_motion_change or not self._record.is_full:
            return  # what changes by itself says nothing of control
        self._since_look += self.setup.block_duration * self._quiet
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

    def _probe_next(self, known: ComplexArray, force: ComplexArray, amplitude: float, unit: float) -> None:
        """Go on with the probing: one harmonic of one exciter at a time, a small voltage up and then down."""
        wait = math.ceil(4.0 / (self.setup.cutoff * self.setup.block_duration)) + 1 + self.setup.latency_blocks
        if self._probe is None:
            index, _, exciter = np.argwhere(np.isnan(known))[0].tolist()
            self._probe = (index, exciter, 0, [])
            self.terms[:, 1:] = 0.0
            self.terms[exciter, index + 1] = HARMONICS.probe_share * amplitude / unit
            return
        index, exciter, blocks, ends = self._probe
        place, blocks = (exciter, index + 1), blocks + 1
        if blocks == wait:
            ends = [*force[:, index + 1].tolist(), complex(self._held.value[exciter, index])]
            self.terms[place] = -HARMONICS.probe_share * amplitude / unit
        elif blocks == 2 * wait:
            moved = complex(self._held.value[exciter, index]) - ends[-1]
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
        open_terms = self._given_up_and_works()[1] & ~self.settled
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
        kept = self._given_up_and_works()[1]
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
        values = self._in_drive().ravel().tolist()[1:]
        return tuple(
            DriveTerm(row + 1, column + 1, value, self._relative)
            for (row, column), value in zip(self._places, values, strict=True)
        )
