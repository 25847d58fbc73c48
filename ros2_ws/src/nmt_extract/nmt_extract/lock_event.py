"""The event that names the window of a level."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class LockEvent:
    """The loop is locked; these samples are to be captured and extracted.

    Attributes:
        level_index: level number in the plan, from 0.
        level: the level's target amplitude, in ``level_unit``.
        level_unit: V, N, m or m/s^2.
        sample: sample at which lock was confirmed.
        frequency_hz: commanded frequency at the lock, Hz; NaN if not known (imported data).
        phase_error: rad, at the lock; NaN if not known.
        window_first_sample: first sample of the window.
        window_samples: number of samples of the window.
        window_periods: whole excitation periods in the window; 0 = as many as the samples hold.
    """

    level_index: int
    level: float
    level_unit: str
    sample: int
    frequency_hz: float
    phase_error: float
    window_first_sample: int
    window_samples: int
    window_periods: int

    @property
    def window_end(self) -> int:
        """Index of the sample after the window."""
        return self.window_first_sample + self.window_samples
