"""What is watched of a converter while it runs: its clock against the computer's, and its delay."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from nmt_core.numerics.arrays import FloatArray

LARGEST_CLOCK_ERROR = 30.0
"""Millionths; beyond them it is said. The computer's clock itself is held within some ten by its time service."""
LARGEST_DRIFT = 1.0
"""Samples that the delay may move."""
_LEAST_TIME = 20.0  # s before a rate is named
_BUCKET = 1.0  # s, of which the least late report counts
_MOST_BUCKETS = 600
_AVERAGED = 25  # blocks of one figure of the delay
_SAME_FREQUENCY = 0.01  # relative; within it a filter's delay is the same
_LARGEST_SCATTER = 0.2  # samples, of a figure that counts


class ClockWatch:
    """Rate of a converter's samples against the computer's steady clock.

    Reports come late by chance, never early: of each second the least late one counts, and a straight line through
    those of all seconds gives the rate.

    Args:
        sample_rate: Hz, nominal.
    """

    def __init__(self, sample_rate: float) -> None:
        self._rate = sample_rate
        self._restart()

    def _restart(self) -> None:
        self._start: tuple[float, int] | None = None
        self._least: deque[tuple[float, float]] = deque(maxlen=_MOST_BUCKETS)
        self._bucket = -1

    def add(self, time: float, samples: int, lost: bool = False) -> None:
        """Take a report: at a time on the steady clock, s, so many samples had passed; starts over after a loss."""
        if lost or self._start is None:
            self._restart()
            self._start = (time, samples)
            return
        nominal = (samples - self._start[1]) / self._rate
        late = time - self._start[0] - nominal
        bucket = int(nominal / _BUCKET)
        if bucket > self._bucket:
            self._bucket = bucket
            self._least.append((nominal, late))
        elif self._least and late < self._least[-1][1]:
            self._least[-1] = (nominal, late)

    @property
    def fit(self) -> tuple[float, float]:
        """Rate error in millionths and its standard error; NaN before enough time has passed."""
        if len(self._least) < 3 or self._least[-1][0] < _LEAST_TIME:
            return math.nan, math.nan
        at, late = np.array(list(self._least)[:-1]).T
        # A computer that was busy for a whole second is late in all of it: the lower half of the residuals counts.
        chosen = np.ones(at.size, dtype=bool)
        for _ in range(3):
            slope, offset = np.polyfit(at[chosen], late[chosen], 1)
            rest = late - slope * at - offset
            chosen = rest <= np.quantile(rest, 0.6)
        scatter = float(np.std(rest[chosen])) / max(float(np.std(at[chosen])), 1e-9) / math.sqrt(chosen.sum())
        return -1e6 * float(slope), 1e6 * scatter

    @property
    def ppm(self) -> float:
        """Millionths by which the converter is fast; NaN before enough time has passed."""
        return self.fit[0]

    @property
    def sentence(self) -> str:
        """What is wrong with the clock; empty while nothing is."""
        ppm, error = self.fit
        if not abs(ppm) > LARGEST_CLOCK_ERROR + 3.0 * error:
            return ""
        return (
            f"the converter's clock is {abs(ppm):.0f} ppm {'fast' if ppm > 0 else 'slow'} of this computer's "
            f"({self._rate * (1.0 + 1e-6 * ppm):.6g} Hz for {self._rate:.6g} Hz); frequencies are wrong by as much"
        )


class DelayWatch:
    """Where the delay from drive to monitor moves to, from the signals of the test itself.

    With x put out and y measured, y ≈ g (x - τ x'): gain g and a small delay τ follow by least squares. What matters is
    how τ moves at one frequency; a filter on the way may give it a constant part.

    Args:
        sample_rate: Hz.
    """

    def __init__(self, sample_rate: float) -> None:
        self._rate = sample_rate
        self._sums = np.zeros(6)
        self._blocks = 0
        self._frequency = 0.0
        self._first: tuple[float, float] | None = None
        self._samples = 0
        self.drift = math.nan
        self.fastest = math.nan

    def add(self, put_out: FloatArray, measured: FloatArray, frequency_hz: float) -> None:
        """Take a block of both, V, and the frequency of the drive, Hz; 0 = it has none."""
        self._samples += put_out.size
        if not frequency_hz > 0.0 or not put_out.any():
            self._reset()
            return
        if abs(frequency_hz / (self._frequency or math.inf) - 1.0) > _SAME_FREQUENCY:
            self._frequency = frequency_hz
            self._reset()
        slope = np.gradient(put_out)
        pairs = ((put_out, put_out), (slope, slope), (put_out, slope), (put_out, measured), (slope, measured))
        self._sums[:5] += [one @ other for one, other in pairs]
        self._sums[5] += measured @ measured
        self._blocks += 1
        if self._blocks == _AVERAGED:
            self._take_figure(_AVERAGED * put_out.size)

    def _take_figure(self, samples: int) -> None:
        power, bent, cross, with_value, with_slope, whole = self._sums
        self._sums[:], self._blocks = 0.0, 0
        determinant = power * bent - cross**2
        if determinant <= 1e-9 * power * bent:
            return
        gain, bend = np.linalg.solve([[power, cross], [cross, bent]], [with_value, with_slope])
        if gain == 0.0:
            return
        rest = max(float(whole - gain * with_value - bend * with_slope), 0.0) / samples
        if math.sqrt(rest / bent) > _LARGEST_SCATTER * abs(gain):
            return
        delay = -float(bend / gain)
        now = self._samples / self._rate
        if self._first is None:
            self._first = (now, delay)
            return
        moved = delay - self._first[1]
        if not abs(moved) < abs(self.drift):
            self.drift = moved
            self.fastest = moved / (now - self._first[0])

    def _reset(self) -> None:
        self._sums[:], self._blocks, self._first = 0.0, 0, None

    @property
    def sentence(self) -> str:
        """What is wrong with the delay; empty while nothing is."""
        if not abs(self.drift) > LARGEST_DRIFT:
            return ""
        rate = 1e6 * self.fastest / self._rate
        return (
            f"the delay from drive to monitor has moved by {self.drift:+.1f} samples ({self.fastest:+.2f} a second): "
            f"outputs and inputs do not share one clock (they differ by {abs(rate):.0f} ppm), or samples were lost "
            "unseen; use one device, or devices with a common clock"
        )
