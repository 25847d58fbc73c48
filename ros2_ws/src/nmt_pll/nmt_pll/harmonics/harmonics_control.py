"""Control of the harmonics of the force by harmonics of the drive voltage, one integral controller a harmonic.

An exciter driven by a sine of voltage gives a force with harmonics, because the structure moves with harmonics and the
exciter resists. With complex amplitudes in the frame n θ of the oscillator,

    F_n = G(n f) V_n + d_n,

where G is the force per volt of exciter and structure at n f, and d_n what the motion of the structure makes of the
force without V_n. Each V_n is integrated against the deviation of F_n from its target,

    dV_n/dt = −κ Ĝ(n f)⁻¹ (F_n − F_n*).

The measured F_n has passed the adaptive Fourier filter, a low-pass of cut-off ω_LP, and the command acts after a dead
time T. With κ = m/(1/ω_LP + T) the open loop κ e^{−sT}/(s (1 + s/ω_LP)) has a phase margin of at least 90° − m, since
arctan x ≤ x, and a gain margin of at least π/(2 m); m = 0.35 rad gives 70° and 4.5. Ĝ may be wrong by that much.

What control itself sees tells more of G: over a few blocks ΔF_n = G ΔV_n + Δd_n. A scalar Kalman filter on Ĝ weighs it
against what is known, with what noise and a changing amplitude of the motion may have contributed by Δd_n; its
variance grows with time up to a bound, which is its forgetting. So a Ĝ of wrong sign, which lets V_n run away, is put
right by that very motion.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.files.hardened import json_value
from nmt_core.messages.records import DriveTerm
from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_pll.harmonics.deviation_record import FEWEST_BLOCKS, DeviationRecord
from nmt_pll.thresholds import HARMONICS

ForcePerVolt = Callable[[FloatArray], ComplexArray]
"""G at frequencies in Hz, N/V, both of shape (k,); NaN where it is not known."""


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


class HeldVoltages:
    """Voltages of all harmonics as the adaptive filter would see them at the end of each block.

    Args:
        count: number of harmonics.
        cutoff: ω_LP, rad/s.
        block_duration: s.
        latency_blocks: blocks between a command and the block in which it is carried out.
    """

    _STEPS = 16

    def __init__(self, count: int, cutoff: float, block_duration: float, latency_blocks: int) -> None:
        decay = math.exp(-cutoff * block_duration / self._STEPS)
        share = (np.arange(self._STEPS) + 0.5) / self._STEPS
        left = decay ** np.arange(self._STEPS - 1, -1, -1)
        fade = 0.5 - 0.5 * np.cos(np.pi * share)
        self._kept = decay**self._STEPS
        self._new = float((1.0 - decay) * np.sum(left * fade))
        self._old = float((1.0 - decay) * np.sum(left * (1.0 - fade)))
        self._pending: deque[ComplexArray] = deque(np.zeros(count, complex) for _ in range(latency_blocks))
        self._previous: ComplexArray = np.zeros(count, complex)
        self.value: ComplexArray = np.zeros(count, complex)

    def advance(self, command: ComplexArray) -> ComplexArray:
        """Filtered voltages (V) after the block that goes to ``command`` along a half-cosine of its length."""
        self._pending.append(command.copy())
        target = self._pending.popleft()
        self.value = self._kept * self.value + self._old * self._previous + self._new * target
        self._previous = target
        return self.value

    def clear(self) -> None:
        """Drive at rest."""
        for item in self._pending:
            item[:] = 0.0
        self._previous = np.zeros_like(self._previous)
        self.value = np.zeros_like(self.value)


@dataclass(frozen=True, slots=True)
class HarmonicSetup:
    """How harmonics are controlled.

    Attributes:
        highest: H; harmonics 2 to H are controlled.
        cutoff: ω_LP of the filter that F_n comes from, rad/s.
        block_duration: s.
        latency_blocks: blocks of buffering between command and excitation.
        dead_time: mean delay between measurement and its effect, s.
        dwell_blocks: blocks over which a settled harmonic is judged.
        voltage_limit: V that drive and harmonics together must stay below; 0 = none.
        slew_limit: V/s that they must stay below together; 0 = none.
        sample_rate: Hz.
        tolerance: deviation that counts as settled, of the fundamental.
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


class HarmonicsController:
    """Voltages of the harmonics 2 … H that bring the force's harmonics to their targets.

    Args:
        setup: how.
        force_per_volt: G(f) as far as it is known; where it is NaN, it is probed.

    Attributes:
        orders: 2 … H, shape (N,).
        voltages: V_n for the next block, V, shape (N,).
        rate: κ, 1/s.
        given_up: harmonic -> why it is not controlled any more until the drive has been at rest.
    """

    def __init__(self, setup: HarmonicSetup, force_per_volt: ForcePerVolt) -> None:
        self.setup = setup
        self.orders = np.arange(2, setup.highest + 1)
        self.rate = integral_rate(setup.cutoff, setup.dead_time)
        self.given_up: dict[int, str] = {}
        count = self.orders.size
        self.voltages: ComplexArray = np.zeros(count, complex)
        self._force_per_volt = force_per_volt
        self._held = HeldVoltages(count, setup.cutoff, setup.block_duration, setup.latency_blocks)
        self._correction: ComplexArray = np.ones(count, complex)  # Ĝ over what was known at first
        self._probed: ComplexArray = np.full(count, np.nan + 0j)
        self._spread: FloatArray = np.full(count, HARMONICS.initial_gain_std**2)  # variance of that
        lag = max(1, round(1.0 / (setup.cutoff * setup.block_duration)))
        self._past: deque[tuple[ComplexArray, ComplexArray, complex]] = deque(maxlen=lag + 1)
        self._record = DeviationRecord(setup.dwell_blocks, (count,), setup.cutoff, setup.block_duration)
        self._strikes = np.zeros(count, int)
        self._limited: FloatArray = np.zeros(count)
        self._looked_at: FloatArray = np.full(count, np.inf)
        self._since_look: FloatArray = np.zeros(count)
        self._motion = math.inf
        self._probe: tuple[int, int, ComplexArray] | None = None
        self._rest = 0
        self._fundamental = 0.0
        self._deviation: ComplexArray = np.zeros(count, complex)
        self._mean: FloatArray = np.zeros(count)
        self._noise: FloatArray = np.zeros(count)

    # -- levels --------------------------------------------------------------------------------------------------

    def clear(self) -> None:
        """The drive is at rest: voltages are zero, all harmonics are tried again; what was learnt of G stays."""
        self.given_up.clear()
        self.voltages = np.zeros_like(self.voltages)
        self._held.clear()
        self._probe = None
        self.start_level()

    def start_level(self) -> None:
        """A new level begins: voltages stay, and what was given up stays so until the drive is at rest."""
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

    def idle(self, off: bool = False) -> None:
        """A block in which nothing is controlled: voltages stay, or are zero in the drive while ``off``."""
        self._held.advance(np.zeros_like(self.voltages) if off else self.voltages)
        self._past.clear()

    def _known(self, frequency_hz: float) -> ComplexArray:
        """G(n f) as it was known at first, N/V; NaN where it has still to be probed."""
        known = self._force_per_volt(np.asarray(self.orders * frequency_hz, dtype=np.float64))
        return np.where(np.isnan(known), self._probed, known)

    def fit(self, amplitude: float, frequency_hz: float) -> None:
        """Keep the next block's voltages within the limits beside a drive of this amplitude (V), also while idle."""
        self.voltages = self.voltages * self._room(amplitude, frequency_hz)

    def _room(self, amplitude: float, frequency_hz: float) -> float:
        """Share of the present voltages, at most 1, that the limits of voltage and slew leave room for."""
        share = 1.0
        step = math.pi * frequency_hz / self.setup.sample_rate
        for limit, weights in (
            (self.setup.voltage_limit, np.ones(self.orders.size + 1)),
            (self.setup.slew_limit, 2.0 * self.setup.sample_rate * np.sin(step * np.arange(1, self.orders.size + 2))),
        ):
            together = float(np.sum(np.abs(self.voltages) * weights[1:]))
            room = max(0.0, HARMONICS.voltage_limit_share * limit - amplitude * float(weights[0]))
            if limit > 0.0 and together > room:
                share = min(share, room / together)
        return share

    def gain(self, frequency_hz: float) -> ComplexArray:
        """Ĝ(n f) of every harmonic, N/V; NaN where it has still to be probed."""
        result: ComplexArray = self._known(frequency_hz) * self._correction
        return result

    def update(
        self, force: ComplexArray, response: complex, frequency_hz: float, amplitude: float, target: ComplexArray
    ) -> None:
        """One block of control; ``voltages`` are those of the next block.

        Args:
            force: F_1 … F_H behind the adaptive filter, N, shape (H,).
            response: fundamental of the drive-point response, any unit.
            frequency_hz: of the fundamental.
            amplitude: of the drive's fundamental, V.
            target: F_n* of the harmonics 2 … H, N, shape (N,).
        """
        seen = self._held.advance(self.voltages).copy()
        self._fundamental = abs(force[0])
        harmonics = force[1:]
        known = self._known(frequency_hz)
        if np.isnan(known).any():
            self._probe_next(known, harmonics, amplitude)
            return
        if self._rest > 0:  # what the last probe has left in the filter is no deviation
            self._rest -= 1
            self._past.clear()
            return
        self._deviation = harmonics - target
        self._judge_block()
        self._learn(harmonics, seen, response, known)
        gain = known * self._correction
        size_squared = np.abs(self._correction) ** 2
        careful = size_squared / (size_squared + self._spread)  # an uncertain Ĝ is not trusted to be small
        step = -self.rate * self.setup.block_duration * self._quiet_share() * careful * self._deviation / gain
        size = np.abs(step)
        largest = HARMONICS.largest_step_share * amplitude
        step *= np.minimum(1.0, largest / np.maximum(size, 1e-300))
        self.voltages = self.voltages + step
        for order in self.given_up:
            self.voltages[order - 2] = HARMONICS.fade_per_block * (self.voltages[order - 2] - step[order - 2])
        self._limit(amplitude, frequency_hz, gain)
        self._review()

    def _judge_block(self) -> None:
        """Mean deviation and noise over the dwell so far."""
        self._record.add(self._deviation)
        length, most = self._record.length, self._record.blocks
        if length < FEWEST_BLOCKS:
            self._mean = np.abs(self._deviation)
            return
        mean, noise = self._record.mean_and_noise()
        self._mean = np.abs(mean)
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
        return np.clip(ratio, HARMONICS.lowest_gain_share, 1.0)

    def _learn(self, force: ComplexArray, seen: ComplexArray, response: complex, known: ComplexArray) -> None:
        """Put Ĝ right by what the newest changes of voltage have done to the force."""
        self._past.append((force.copy(), seen, response))
        grow = 2.0 ** (self.rate * self.setup.block_duration / HARMONICS.variance_doubling_time_constants)
        largest = HARMONICS.largest_gain_std**2 * np.maximum(1.0, np.abs(self._correction) ** 2)
        self._spread = np.minimum(self._spread * grow, largest)
        if len(self._past) < (self._past.maxlen or 0):
            return
        old_force, old_seen, old_response = self._past[0]
        moved, change = known * (seen - old_seen), force - old_force
        self._motion = motion = abs(response - old_response) / max(abs(response), 1e-300)
        disturbance = np.abs(force - known * self._correction * seen)
        disturbance *= np.minimum(1.0, HARMONICS.motion_disturbance_ratio * self.orders * motion)
        scatter = 2.0 * self._noise**2 + disturbance**2 + (HARMONICS.unexplained_share * self._fundamental) ** 2
        scatter *= len(self._past) - 1  # overlapping differences tell the same thing as often
        # What moves less than the motion may have done tells nothing, and would tell the same wrong thing every time.
        moved = np.where(np.abs(moved) > disturbance, moved, 0j)
        weight = self._spread / np.maximum(self._spread * np.abs(moved) ** 2 + scatter, 1e-300)
        corrected = self._correction + weight * moved.conjugate() * (change - self._correction * moved)
        self._correction = np.where(np.abs(corrected) > HARMONICS.lowest_gain_correction, corrected, self._correction)
        self._spread = np.maximum(self._spread * (1.0 - weight * np.abs(moved) ** 2), 1e-6)

    def _limit(self, amplitude: float, frequency_hz: float, gain: ComplexArray) -> None:
        """Keep every voltage, and all of them together, below what is allowed; name what stays there."""
        largest = np.full(self.orders.size, HARMONICS.largest_voltage_share * amplitude)
        share = self._room(amplitude, frequency_hz)
        if share < 1.0:
            largest = np.minimum(largest, share * np.abs(self.voltages))
        size = np.abs(self.voltages)
        over = (size > largest) | (largest == 0.0)
        self.voltages = np.where(over, self.voltages * largest / np.maximum(size, 1e-300), self.voltages)
        self._limited = np.where(over, self._limited + self.setup.block_duration, 0.0)
        worst = int(np.argmax(np.where(self._limited > HARMONICS.limited_time_constants / self.rate, size, -1.0)))
        order = int(self.orders[worst]) if self.orders.size else 0
        if order and self._limited[worst] > HARMONICS.limited_time_constants / self.rate and order not in self.given_up:
            # One at a time, the greatest first: where all share one limit, the others may then have room.
            self.given_up[order] = (
                f"it would need more than {largest[worst]:.3g} V "
                f"(at {abs(gain[worst]):.3g} N/V, {self._share(worst):.2g} % of the fundamental are left)"
            )
            self._limited[:] = 0.0

    def _review(self) -> None:
        """From time to time: whether every harmonic that is not settled gets nearer to its target."""
        if self._motion > HARMONICS.steady_motion_change or not self._record.is_full:
            return  # what changes by itself says nothing of control
        self._since_look += self.setup.block_duration * self._quiet_share()
        due = self._since_look >= HARMONICS.review_time_constants / self.rate
        if not due.any():
            return
        self._since_look[due] = 0.0
        relative = self._mean / max(self._fundamental, 1e-300)
        stuck = due & ~self.settled & (relative > HARMONICS.progress_share * self._looked_at) & (self._limited == 0.0)
        self._strikes = np.where(stuck, self._strikes + 1, np.where(due & self.settled, 0, self._strikes))
        lower = np.where(np.isinf(self._looked_at), relative, np.minimum(self._looked_at, relative))
        self._looked_at = np.where(due, lower, self._looked_at)
        # What was learnt may be the reason: it is open to doubt at the first look, and forgotten at the second.
        self._spread = np.where(stuck, np.maximum(self._spread, HARMONICS.initial_gain_std**2), self._spread)
        self._correction = np.where(
            stuck & (self._strikes == HARMONICS.reviews_without_progress - 1), 1.0, self._correction
        )
        for index in np.flatnonzero(self._strikes >= HARMONICS.reviews_without_progress).tolist():
            order = int(self.orders[index])
            if order not in self.given_up:
                self.given_up[order] = (
                    f"the force does not follow the drive ({self._share(index):.2g} % of the fundamental are left)"
                )

    def _share(self, index: int) -> float:
        """Mean deviation over the fundamental, %."""
        return 100.0 * float(self._mean[index]) / max(self._fundamental, 1e-300)

    # -- probing -------------------------------------------------------------------------------------------------

    def _probe_next(self, known: ComplexArray, force: ComplexArray, amplitude: float) -> None:
        """Go on with the probing: one harmonic at a time, a small voltage up and then down."""
        wait = math.ceil(4.0 / (self.setup.cutoff * self.setup.block_duration)) + 1 + self.setup.latency_blocks
        if self._probe is None:
            index = int(np.flatnonzero(np.isnan(known))[0])
            self._probe = (index, 0, np.zeros(2, complex))
            self.voltages = np.zeros_like(self.voltages)
            self.voltages[index] = HARMONICS.probe_share * amplitude
            return
        index, blocks, ends = self._probe
        blocks += 1
        if blocks == wait:
            ends[0], ends[1] = force[index], self._held.value[index]
            self.voltages[index] = -HARMONICS.probe_share * amplitude
        elif blocks == 2 * wait:
            moved = self._held.value[index] - ends[1]
            found = (force[index] - ends[0]) / moved if moved != 0 else 0j
            self._probed[index] = found if found != 0 else 1e-12 + 0j
            self._correction[index] = 1.0
            self.voltages[index] = 0.0
            self._probe = None
            self._rest = wait
            return
        self._probe = (index, blocks, ends)

    @property
    def is_probing(self) -> bool:
        """Whether Ĝ is still being measured."""
        return self._probe is not None or self._rest > 0

    # -- judgement -----------------------------------------------------------------------------------------------

    @property
    def settled(self) -> np.ndarray:
        """Whether each harmonic is at its target, bool (N,): within the tolerance, or nothing but noise is left."""
        mean_std = self._record.mean_std(self._noise)
        tolerance = self.setup.tolerance * self._fundamental
        in_mean = self._mean <= tolerance + HARMONICS.noise_sigmas * mean_std
        now = np.abs(self._deviation) <= HARMONICS.newest_value_ratio * tolerance + HARMONICS.noise_sigmas * self._noise
        result: np.ndarray = in_mean & now
        return result

    @property
    def obstacle(self) -> str:
        """What keeps the harmonics from being settled, empty if nothing does; harmonics given up do not count."""
        if self.is_probing:
            return "force per volt of the harmonics is being measured"
        if not self._record.is_full:
            return "the force harmonics have not been controlled for a dwell yet"
        settled = self.settled
        for index, order in enumerate(self.orders.tolist()):
            if not settled[index] and order not in self.given_up:
                return f"force harmonic {order} is {self._share(index):.2g} % of the fundamental off its target"
        return ""

    @property
    def summary(self) -> str:
        """How the harmonics are: the greatest deviation of those that are controlled, and which were given up."""
        residuals = self.residuals()
        kept = {order: value for order, value in residuals.items() if order not in self.given_up}
        parts = []
        if kept:
            worst = max(kept, key=kept.__getitem__)
            share = f"{100.0 * kept[worst]:.2g} % of the fundamental (harmonic {worst})"
            parts.append(f"force harmonics up to {max(kept)} within {share}")
        parts += [f"harmonic {order} given up: {why}" for order, why in sorted(self.given_up.items())]
        return "; ".join(parts)

    def terms(self, off: bool = False) -> tuple[DriveTerm, ...]:
        """Terms of the drive for the next block; all of them zero while ``off``."""
        voltages = np.zeros_like(self.voltages) if off else self.voltages
        return tuple(DriveTerm(1, n, v, False) for n, v in zip(self.orders.tolist(), voltages.tolist(), strict=True))

    def residuals(self) -> dict[int, float]:
        """Harmonic -> mean deviation over the dwell, of the fundamental."""
        scale = max(self._fundamental, 1e-300)
        return {int(n): float(value) / scale for n, value in zip(self.orders, self._mean, strict=True)}


def table_of(rows: Sequence[Sequence[float]]) -> ForcePerVolt:
    """G(f) from rows of frequency (Hz), real and imaginary part (N/V), linear in between; NaN outside of them."""
    table = np.array(sorted(map(tuple, rows)), float).reshape(-1, 3)
    frequency, values = table[:, 0].copy(), table[:, 1] + 1j * table[:, 2]

    def value(frequency_hz: FloatArray) -> ComplexArray:
        if not frequency.size:
            return np.full(np.shape(frequency_hz), math.nan, complex)
        return np.asarray(np.interp(frequency_hz, frequency, values, math.nan, math.nan), dtype=np.complex128)

    return value


def table_from_json(text: str) -> ForcePerVolt:
    """`table_of` the rows of a JSON text; an empty text knows nothing.

    Raises:
        BenchError: it is not JSON, or not rows of three finite numbers.
    """
    if not text:
        return table_of(())
    rows = json_value(text, "The force per volt")
    good = isinstance(rows, list) and all(
        isinstance(row, list) and len(row) == 3 and all(isinstance(x, int | float) and math.isfinite(x) for x in row)
        for row in rows
    )
    if not good:
        raise BenchError(
            "The force per volt (force_per_volt_json) must be rows of frequency in Hz, real and imaginary part in N/V."
        )
    return table_of(rows)
