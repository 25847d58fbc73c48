"""The harmonics of a window and of its sub-windows: what the table of a run and a diagnosis both read."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from nmt_core.numerics.arrays import ComplexArray, FloatArray, IntArray
from nmt_extract.judgement.uncertainty import jackknife, slope_uncertainty, sub_window_count
from nmt_signals.harmonics import Moments, segment_moments, solve_moments, whole_period_bounds


@dataclass(frozen=True, eq=False)
class EvaluatedWindow:
    """Harmonics of all channels over a window (set 0) and without each of its sub-windows (sets 1 to K).

    Attributes:
        cycles: phase of the excitation at each sample, cycles, shape ``(samples,)``.
        advance: of that phase over the window, cycles.
        sample_rate: Hz.
        count: K; 0 = the window is too short.
        bounds: first sample of each sub-window and the end of the last.
        moments: of the sub-windows; of the window where K is 0.
        sets: shape ``(1 + K, channels, H + 1)``.
        parts: of each sub-window, shape ``(K, channels, H + 1)``; of the window where K is 0.
    """

    cycles: FloatArray
    advance: float
    sample_rate: float
    count: int
    bounds: IntArray
    moments: Moments
    sets: ComplexArray
    parts: ComplexArray

    @classmethod
    def of(
        cls, cycles: FloatArray, advance: float, data: FloatArray, sample_rate: float, harmonics: int, sub_windows: int
    ) -> EvaluatedWindow:
        """The harmonics of samples.

        Args:
            cycles, advance, sample_rate: as of the class; the window holds whole periods.
            data: shape ``(channels, samples)``.
            harmonics: H, at least 1.
            sub_windows: K of long windows.
        """
        periods = round(advance)
        count = sub_window_count(periods, sub_windows)
        bounds = whole_period_bounds(cycles, periods, max(1, count))
        moments = segment_moments(cycles, data, harmonics, bounds)
        sets = total = moments.total()
        if count:
            without = moments.leave_one_out()
            sets = Moments(
                np.concatenate((total.basis, without.basis)), np.concatenate((total.projections, without.projections))
            )
        return cls(cycles, advance, sample_rate, count, bounds, moments, solve_moments(sets), solve_moments(moments))

    @cached_property
    def frequencies_hz(self) -> FloatArray:
        """Mean excitation frequency of each set, shape ``(1 + K,)``."""
        samples = int(self.bounds[-1])
        edges = np.append(self.cycles[self.bounds[:-1]], self.cycles[0] + self.advance)
        found = np.full(1 + self.count, self.advance / (samples / self.sample_rate))
        if self.count:
            found[1:] = (self.advance - np.diff(edges)) / ((samples - np.diff(self.bounds)) / self.sample_rate)
        return found

    def frequency_std(self, fitted: ComplexArray | None = None) -> float:
        """Standard uncertainty of the excitation frequency, Hz; NaN where the window is too short.

        A loop takes slow noise out of the phase that it measures and puts it into the frequency. So the phase of the
        window tells less than its whole uncertainty, and the frequencies of the sub-windows tell the rest.

        Args:
            fitted: fundamental of each sub-window that the frequency was fitted to, shape ``(K,)``; None where the
                phase of the excitation is known.
        """
        if not self.count:
            return float("nan")
        if fitted is None:
            return jackknife(self.frequencies_hz[1:], float(self.frequencies_hz[0]))
        middle = np.asarray(0.5 * (self.bounds[1:] + self.bounds[:-1]) / self.sample_rate, dtype=np.float64)
        # About their mean phase, so that no jump of 2π comes between.
        phases = np.angle(fitted * np.conj(fitted.sum())) / (2.0 * np.pi)
        return slope_uncertainty(middle, np.asarray(phases, dtype=np.float64))


def resonance_std(frequency_std: float, damping: float, phase_std: float) -> float:
    """Standard uncertainty of the frequency at which a loop held a phase, in the unit of its first argument.

    Args:
        frequency_std: of the excitation frequency.
        damping: by how much the frequency follows the phase: the damping ratio times the frequency.
        phase_std: of the phase, rad.
    """
    return float(np.hypot(frequency_std, damping * phase_std))
