"""Lock state machine: Fixed, Acquiring, Locked, LockLost."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from nmt_core.blocks import FloatArray


class LoopState(IntEnum):
    """State of the loop; values as in ``nmt_msgs/Frequency``."""

    UNKNOWN = 0
    FIXED = 1
    ACQUIRING = 2
    LOCKED = 3
    LOCK_LOST = 4


@dataclass(frozen=True, slots=True)
class Transition:
    """A change of state: at which sample, to what, and why."""

    sample: int
    state: LoopState
    reason: str


@dataclass(frozen=True, slots=True)
class DwellStatistics:
    """Phase error, frequency and amplitude over the dwell.

    Attributes:
        mean: mean phase error, rad.
        mean_std: standard uncertainty of that mean, rad.
        scatter: standard deviation of the phase error about its trend, rad.
        frequency_drift, amplitude_drift: relative change over the dwell along a straight-line fit.
        frequency_drift_std, amplitude_drift_std: their standard uncertainties.
    """

    mean: float
    mean_std: float
    scatter: float
    frequency_drift: float
    frequency_drift_std: float
    amplitude_drift: float
    amplitude_drift_std: float


class Dwell:
    """Sliding record of the loop over the dwell time.

    Neighbouring values are correlated because the adaptive filter smooths them; uncertainties count one independent
    value per correlation time.

    Args:
        length: number of blocks in the dwell.
        correlation_blocks: blocks per independent value.
    """

    def __init__(self, length: int, correlation_blocks: float) -> None:
        self.length = max(4, length)
        self._inflation = max(1.0, correlation_blocks)
        self._values: deque[tuple[float, float, float]] = deque(maxlen=self.length)
        place = np.linspace(-0.5, 0.5, self.length)
        self._trend = place / (place @ place)
        self._place = place

    def clear(self) -> None:
        """Forget everything."""
        self._values.clear()

    @property
    def full(self) -> bool:
        """True once the dwell time has passed."""
        return len(self._values) == self.length

    def add(self, phase_error: float, frequency: float, amplitude: float) -> None:
        """Add one block's values: rad, any frequency unit, any amplitude unit."""
        self._values.append((phase_error, frequency, amplitude))

    def statistics(self) -> DwellStatistics:
        """Statistics of a full dwell."""
        values = np.array(self._values).T
        mean, scatter, _, _ = self._fit(values[0])
        f_mean, _, f_slope, f_slope_std = self._fit(values[1])
        a_mean, _, a_slope, a_slope_std = self._fit(values[2])
        return DwellStatistics(
            mean=mean,
            mean_std=scatter * math.sqrt(self._inflation / self.length),
            scatter=scatter,
            frequency_drift=f_slope / f_mean,
            frequency_drift_std=f_slope_std / f_mean,
            amplitude_drift=a_slope / a_mean,
            amplitude_drift_std=a_slope_std / a_mean,
        )

    def _fit(self, values: FloatArray) -> tuple[float, float, float, float]:
        """Mean, scatter about the trend, change over the dwell and its standard uncertainty."""
        mean = float(values.mean())
        slope = float(self._trend @ values)
        residual = values - mean - slope * self._place
        scatter = math.sqrt(float(residual @ residual) / (self.length - 2))
        slope_std = scatter * math.sqrt(self._inflation) * float(np.sqrt(self._trend @ self._trend))
        return mean, scatter, slope, slope_std


@dataclass(frozen=True, slots=True)
class LockCriteria:
    """Tolerances; as in :class:`nmt_pll.settings.LoopSettings`."""

    phase_tolerance: float
    frequency_tolerance: float
    amplitude_tolerance: float
    scatter_limit: float
    unlock_tolerance: float

    def locked(self, statistics: DwellStatistics) -> bool:
        """True if phase, frequency and amplitude are stationary within tolerance.

        Noise must not keep a loop from locking whose means are right, so each drift may exceed its tolerance by two of
        its own standard uncertainties; ``scatter_limit`` bounds how much noise that excuses.
        """
        s = statistics
        return (
            s.scatter <= self.scatter_limit
            and abs(s.mean) <= self.phase_tolerance + 2.0 * s.mean_std
            and abs(s.frequency_drift) <= self.frequency_tolerance + 2.0 * s.frequency_drift_std
            and abs(s.amplitude_drift) <= self.amplitude_tolerance + 2.0 * s.amplitude_drift_std
        )

    def lost(self, statistics: DwellStatistics) -> str:
        """Why a lock has to be given up, empty if it holds. Wider than the lock criteria, so that lock does not flicker."""
        if abs(statistics.mean) > self.unlock_tolerance:
            return (
                f"mean phase error {math.degrees(statistics.mean):.2f} deg exceeds "
                f"{math.degrees(self.unlock_tolerance):.2f} deg"
            )
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
