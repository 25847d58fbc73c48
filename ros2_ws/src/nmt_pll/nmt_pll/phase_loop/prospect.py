"""Whether a point of a response curve can still be held: the trend of the errors that keep the loop from locking.

The shares that phase, scatter, drifts and amplitude are of their limits come down to one at lock. What settles comes
down exponentially with the decays of structure and loop; what swings or runs away does not. So the logarithm of the
largest share is averaged over spans of some time constants, and where it no longer falls from span to span, or falls so
slowly that its line does not reach one before the time-out, no lock is to come.
"""

from __future__ import annotations

import math

from nmt_pll.detection.lock import DwellStatistics, LockCriteria
from nmt_pll.thresholds import CURVE, PHASE


def largest_share(statistics: DwellStatistics, criteria: LockCriteria, deviation: float) -> float:
    """Largest share that what is to settle has of its limit, with the noise that a lock may have; at lock at most 1.

    Args:
        statistics: over the dwell.
        criteria: of the lock.
        deviation: logarithm of the controlled amplitude over its target.
    """
    s = statistics
    scatter_limit = min(criteria.scatter_limit, PHASE.swing_tolerances * criteria.phase_tolerance + 2.0 * s.noise)
    return max(
        abs(s.mean) / (criteria.phase_tolerance + 2.0 * s.mean_std),
        s.scatter / scatter_limit,
        abs(s.frequency_drift) / (criteria.frequency_tolerance + 2.0 * s.frequency_drift_std),
        abs(s.amplitude_drift) / (criteria.amplitude_tolerance + 2.0 * s.amplitude_drift_std),
        abs(deviation) / (2.0 * criteria.amplitude_tolerance),
    )


class Prospect:
    """Trend of a point that is not locked yet.

    Args:
        decay: of the structure, rad/s.
        dwell_s: duration of a dwell, s.
    """

    def __init__(self, decay: float, dwell_s: float) -> None:
        self._span = CURVE.prospect_decays / decay + dwell_s
        self.begin()

    def begin(self) -> None:
        """Begin with another point."""
        self._ends: float | None = None
        self._sum, self._count = 0.0, 0
        self._levels: list[float] = []

    def is_hopeless(self, share: float, now: float, deadline: float) -> bool:
        """Whether no lock is to come before the deadline.

        Args:
            share: as of :func:`largest_share`.
            now, deadline: bench time, s; the deadline may be infinite.
        """
        if self._ends is None:
            self._ends = now + self._span
        self._sum += math.log(max(share, 1e-9))
        self._count += 1
        if now < self._ends:
            return False
        self._levels.append(self._sum / self._count)
        self._ends = now + self._span
        self._sum, self._count = 0.0, 0
        if len(self._levels) < CURVE.prospect_spans:
            return False
        first, last = self._levels[-int(CURVE.prospect_spans)], self._levels[-1]
        fall = (first - last) / (CURVE.prospect_spans - 1)
        if last <= CURVE.prospect_near:
            return False
        if fall <= CURVE.prospect_fall:
            return True
        return now + last / fall * self._span > deadline
