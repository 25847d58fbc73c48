"""Lock state machine: Fixed, Acquiring, Locked, LockLost."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from nmt_core.numerics.arrays import FloatArray
from nmt_core.numerics.kernels import njit
from nmt_core.vocabulary import LoopState
from nmt_pll.thresholds import PHASE


@dataclass(frozen=True, slots=True)
class Transition:
    """A change of state: at which sample, to what, and why."""

    sample: int
    state: LoopState
    reason: str


# Scatter of the phase error that a decaying swing may still have at lock, in phase tolerances.


@dataclass(frozen=True, slots=True)
class DwellStatistics:
    """Phase error, frequency and amplitude over the dwell.

    Attributes:
        mean: mean phase error, rad.
        mean_std: standard uncertainty of that mean due to noise, rad.
        scatter: standard deviation of the phase error about its trend, rad.
        noise: share of it that is noise and not a transient of the loop, rad.
        frequency_drift, amplitude_drift: relative change over the dwell along a straight-line fit.
        frequency_drift_std, amplitude_drift_std: their standard uncertainties due to noise.
    """

    mean: float
    mean_std: float
    scatter: float
    noise: float
    frequency_drift: float
    frequency_drift_std: float
    amplitude_drift: float
    amplitude_drift_std: float


@njit(cache=True)
def _trend(values: FloatArray, place: FloatArray, norm: float) -> tuple[float, float, float, float]:
    """Mean, scatter about the trend, change along it over the dwell, root mean square second difference."""
    length = values.size
    mean = 0.0
    slope = 0.0
    for k in range(length):
        mean += values[k]
        slope += values[k] * place[k]
    mean /= length
    slope *= norm
    square = 0.0
    for k in range(length):
        square += (values[k] - mean - slope * place[k]) ** 2
    bend = 0.0
    for k in range(1, length - 1):
        bend += (values[k - 1] - 2.0 * values[k] + values[k + 1]) ** 2
    return mean, np.sqrt(square / (length - 2)), slope, np.sqrt(bend / (length - 2))


@njit(cache=True)
def _statistics(ring: FloatArray, start: int, place: FloatArray, result: FloatArray) -> None:
    """Rows of ``result``: ``_trend`` of each of the three rows of ``ring``, oldest value at ``start``."""
    length = ring.shape[1]
    norm = 0.0
    for k in range(length):
        norm += place[k] ** 2
    ordered = np.empty(length)
    for row in range(3):
        for k in range(length):
            ordered[k] = ring[row, (start + k) % length]
        result[row, 0], result[row, 1], result[row, 2], result[row, 3] = _trend(ordered, place, 1.0 / norm)


class Dwell:
    """Sliding record of the loop over the dwell time.

    Neighbouring values are correlated because the adaptive filter smooths them; uncertainties count one
    independent value per correlation time. Noise is distinguished from a transient by second differences: a transient
    of the loop is smooth from block to block, while noise behind a low-pass of cut-off ω_LP is a first-order process
    whose values one block Δt apart correlate with ρ = exp(−ω_LP Δt), and whose second difference has the variance
    σ² (6 − 8ρ + 2ρ²).

    Args:
        length: number of blocks in the dwell.
        correlation_blocks: blocks per independent value, 2 / (ω_LP Δt).
    """

    def __init__(self, length: int, correlation_blocks: float) -> None:
        self.length = max(4, length)
        self._inflation = max(1.0, correlation_blocks)
        neighbour = math.exp(-2.0 / correlation_blocks)
        self._noise_per_bend = 1.0 / math.sqrt(6.0 - 8.0 * neighbour + 2.0 * neighbour**2)
        self._ring = np.zeros((3, self.length))
        self._place = np.linspace(-0.5, 0.5, self.length)
        self._slope_share = float(1.0 / np.sqrt(self._place @ self._place))
        self._result = np.zeros((3, 4))
        self._next = 0
        self._count = 0
        _statistics(self._ring, 0, self._place, self._result)  # compile now, not in the first dwell

    def clear(self) -> None:
        """Forget everything."""
        self._next = self._count = 0

    @property
    def full(self) -> bool:
        """True once the dwell time has passed."""
        return self._count >= self.length

    def add(self, phase_error: float, frequency: float, amplitude: float) -> None:
        """Add one block's values: rad, any frequency unit, any amplitude unit."""
        ring, k = self._ring, self._next
        ring[0, k], ring[1, k], ring[2, k] = phase_error, frequency, amplitude
        self._next = (k + 1) % self.length
        self._count += 1

    def statistics(self) -> DwellStatistics:
        """Statistics of a full dwell."""
        _statistics(self._ring, self._next, self._place, self._result)
        phase, frequency, amplitude = self._result.tolist()
        mean, scatter, _, bend = phase
        f_mean, _, f_slope, f_bend = frequency
        a_mean, _, a_slope, a_bend = amplitude
        noise = bend * self._noise_per_bend
        slope_share = math.sqrt(self._inflation) * self._slope_share * self._noise_per_bend
        return DwellStatistics(
            mean=mean,
            mean_std=noise * math.sqrt(self._inflation / self.length),
            scatter=scatter,
            noise=noise,
            frequency_drift=f_slope / f_mean,
            frequency_drift_std=f_bend * slope_share / f_mean,
            amplitude_drift=a_slope / a_mean,
            amplitude_drift_std=a_bend * slope_share / a_mean,
        )


@dataclass(frozen=True, slots=True)
class LockCriteria:
    """Tolerances; as in :class:`nmt_pll.loop_settings.LoopSettings`."""

    phase_tolerance: float
    frequency_tolerance: float
    amplitude_tolerance: float
    scatter_limit: float
    unlock_tolerance: float

    def locked(self, statistics: DwellStatistics, deviation: float = 0.0) -> bool:
        """True if phase, frequency and amplitude are stationary within tolerance.

        A controlled amplitude must also be within twice the amplitude tolerance of its target; ``deviation`` is the
        logarithm of their ratio.

        Noise must not keep a loop from locking whose means are right, so each drift may exceed its tolerance by
        two of its own standard uncertainties; ``scatter_limit`` bounds how much noise that excuses. A loop that
        still swings has means that pass through zero by the way: what scatters beyond noise must be small as well.
        """
        return not self.obstacle(statistics, deviation)

    def obstacle(self, statistics: DwellStatistics, deviation: float = 0.0) -> str:
        """The criterion that keeps the loop from being locked, empty if it is."""
        s = statistics
        scatter_limit = min(self.scatter_limit, PHASE.swing_tolerances * self.phase_tolerance + 2.0 * s.noise)
        if s.scatter > scatter_limit:
            return (
                f"phase scatter {math.degrees(s.scatter):.2f} deg exceeds {math.degrees(scatter_limit):.2f} deg "
                f"({math.degrees(s.noise):.2f} deg are noise)"
            )
        if abs(s.mean) > self.phase_tolerance + 2.0 * s.mean_std:
            return f"mean phase error {math.degrees(s.mean):.2f} deg"
        if abs(s.frequency_drift) > self.frequency_tolerance + 2.0 * s.frequency_drift_std:
            return f"the frequency drifts by {100.0 * s.frequency_drift:.3f} % over the dwell"
        if abs(s.amplitude_drift) > self.amplitude_tolerance + 2.0 * s.amplitude_drift_std:
            return f"the response drifts by {100.0 * s.amplitude_drift:.2f} % over the dwell"
        if abs(deviation) > 2.0 * self.amplitude_tolerance:
            return f"the controlled amplitude is {100.0 * math.expm1(deviation):.2f} % off its target"
        return ""

    def lost(self, statistics: DwellStatistics) -> str:
        """Why a lock has to be given up, empty if it holds; wider than the lock criteria lest lock flicker.

        As there, noise excuses two standard uncertainties of the mean: a short dwell in much noise is not a lost lock.
        """
        limit = self.unlock_tolerance + 2.0 * statistics.mean_std
        if abs(statistics.mean) > limit:
            return f"mean phase error {math.degrees(statistics.mean):.2f} deg exceeds {math.degrees(limit):.2f} deg"
        if statistics.scatter > 2.0 * self.scatter_limit:
            return (
                f"phase scatter {math.degrees(statistics.scatter):.1f} deg exceeds "
                f"{math.degrees(2 * self.scatter_limit):.1f} deg"
            )
        return ""


class LockStateMachine:
    """Keeps the state and records each transition with its sample and reason.

    LOCK_LOST is latched: only :meth:`acquire` or :meth:`fix` leaves it.
    """

    def __init__(self) -> None:
        self.state = LoopState.FIXED
        self.transition: Transition | None = None

    def _go(self, sample: int, state: LoopState, reason: str) -> None:
        self.state = state
        self.transition = Transition(sample, state, reason)

    def fix(self, sample: int, reason: str) -> None:
        """Nothing is controlled from here on."""
        if self.state != LoopState.FIXED:
            self._go(sample, LoopState.FIXED, reason)

    def acquire(self, sample: int, reason: str) -> None:
        """A new level starts."""
        self._go(sample, LoopState.ACQUIRING, reason)

    def lock(self, sample: int, reason: str) -> None:
        """Acquiring has succeeded.

        Raises:
            RuntimeError: the loop is not acquiring (a programming error).
        """
        if self.state != LoopState.ACQUIRING:
            raise RuntimeError(f"cannot lock from {self.state.name}")
        self._go(sample, LoopState.LOCKED, reason)

    def lose(self, sample: int, reason: str) -> None:
        """Lock was lost or could not be had; latched."""
        if self.state in (LoopState.ACQUIRING, LoopState.LOCKED):
            self._go(sample, LoopState.LOCK_LOST, reason)

    def take_transition(self) -> Transition | None:
        """The newest transition, once."""
        transition, self.transition = self.transition, None
        return transition
