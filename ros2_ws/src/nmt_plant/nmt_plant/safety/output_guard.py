"""Guard of the final samples, the last thing between oscillator and converter.

It sees what is put out, whatever made it: harmonics, random peaks, steps, values that are not finite. Nothing
here needs more than numpy, so that a process that owns a converter starts fast.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.numerics.arrays import FloatArray
from nmt_core.numerics.ramp import half_cosine

# Sines below this share of the sample rate pass the default slew limit at the full voltage limit.
_FREE_SHARE = 0.1


def default_slew(limit: float, sample_rate: float) -> float:
    """Slew limit that belongs to a voltage limit, V/s.

    A sine of amplitude ``limit`` (V) at a tenth of the ``sample_rate`` (Hz) just passes; its largest change between
    two samples is 2 limit sin(π / 10).
    """
    return 2.0 * limit * math.sin(math.pi * _FREE_SHARE) * sample_rate


class OutputGuard:
    """Absolute and slew limit of an output, sample by sample, and its ramp to zero.

    A change faster than the slew limit is spread over as many samples as it needs. A sample beyond the absolute
    limit, or not finite, is never put out: from there on the output goes to zero along a half-cosine from its
    present value and stays there until ``reset``. Samples that keep both limits pass unchanged.

    Args:
        sample_rate: Hz.
        limit: largest magnitude, V; None = any finite value.
        slew: largest rate of change, V/s; None = any.
        ramp: s, length of the ramp to zero after a sample beyond the limit; longer where the slew limit asks for it.

    Attributes:
        last: V, value put out last.
        spread: samples that were held back by the slew limit so far.
        violation: index within its block, and value (V), of the sample that was beyond the limit; None = none was.

    Raises:
        BenchError: a limit that is not positive, or a negative ramp.
    """

    def __init__(
        self, sample_rate: float, limit: float | None = None, slew: float | None = None, ramp: float = 0.1
    ) -> None:
        for name, value in (("sample_rate", sample_rate), ("limit", limit), ("slew", slew)):
            if value is not None and not 0.0 < value < math.inf:
                raise BenchError(f"output guard: {name} must be positive and finite, got {value}.")
        if not 0.0 <= ramp < math.inf:
            raise BenchError(f"output guard: ramp must be finite and not negative, got {ramp}.")
        self._sample_rate = float(sample_rate)
        self.limit = limit
        self.slew = slew
        self._bound = sys.float_info.max if limit is None else float(limit)
        self._step = sys.float_info.max if slew is None else float(slew) / self._sample_rate
        self._ramp_time = float(ramp)
        self.reset()

    def reset(self) -> None:
        """Output at zero, nothing tripped; as at the first sample."""
        self.last = 0.0
        self.spread = 0
        self.release()

    def release(self) -> None:
        """End the hold at zero; the next samples are followed again, no faster than the slew limit."""
        self.violation: tuple[int, float] | None = None
        self._start, self._elapsed, self._length = 0.0, 0, 1
        self._held = False

    @property
    def bound(self) -> float:
        """V, magnitude beyond which nothing is put out; the largest finite number without a limit."""
        return self._bound

    @property
    def held(self) -> bool:
        """Whether the guard takes or holds the output at zero, whatever it is given."""
        return self._held

    @property
    def reaches_zero(self) -> bool:
        """Whether the next sample is zero if the guard is given zero."""
        if self._held:
            return self._elapsed + 1 >= self._length
        return abs(self.last) <= self._step

    def to_zero(self, ramp: float | None = None) -> None:
        """Half-cosine to zero from the present value within ``ramp`` s (its own when None), then held until release.

        Where it is on its way already, the shorter of the two ramps counts.
        """
        before = self._length - self._elapsed if self._held else None
        length = self._length_of(self.last, self._ramp_time if ramp is None else ramp)
        if before is None or length < before:
            self._begin(self.last, length)

    def shortest_ramp(self, ramp: float | None = None) -> float:
        """s, length of the ramp to zero from the present value: ``ramp`` (its own when None), or what the slew asks."""
        return self._length_of(self.last, self._ramp_time if ramp is None else ramp) / self._sample_rate

    def _length_of(self, start: float, ramp: float) -> int:
        length = round(min(ramp * self._sample_rate, 1e9))
        # The half-cosine is steepest in its middle: start * pi / (2 length) a sample.
        least = math.ceil(0.5 * math.pi * (abs(start) / self._step))
        return max(length, least, 1)

    def _begin(self, start: float, length: int) -> None:
        self._start, self._elapsed, self._length, self._held = start, 0, length, True

    def _descent(self, count: int) -> FloatArray:
        """The ``count`` samples of the ramp after the present one."""
        done = self._elapsed + 1 + np.arange(count)
        values: FloatArray = self._start * (1.0 - half_cosine(done / self._length))
        values[done >= self._length] = 0.0
        return values

    def block(self, voltage: FloatArray, samples: int | None = None) -> FloatArray:
        """The samples that may be put out in place of the given ones.

        Args:
            voltage: (n,) V wanted.
            samples: how many of them are put out now; those behind are a preview that changes nothing. None = all.

        Returns:
            (n,) V; the array given where nothing had to be done.
        """
        count = voltage.size if samples is None else samples
        if count == 0:
            return voltage
        if self._held:
            values = self._descent(voltage.size)
            self._elapsed += count
            self.last = float(values[count - 1])
            return values
        # NaN passes no comparison.
        if -self._bound <= voltage.min() and voltage.max() <= self._bound and abs(voltage[0] - self.last) <= self._step:
            change = voltage[1:] - voltage[:-1]
            if not change.size or (-self._step <= change.min() and change.max() <= self._step):
                self.last = float(voltage[count - 1])
                return voltage
        return self._restrain(voltage, count)

    def _restrain(self, voltage: FloatArray, count: int) -> FloatArray:
        """Sample by sample: spread what is too fast, begin the ramp at what is too large."""
        result = np.empty(voltage.size)
        present, last = self.last, self.last
        for k in range(voltage.size):
            wanted = float(voltage[k])
            if not abs(wanted) <= self._bound:
                self._begin(present, self._length_of(present, self._ramp_time))
                result[k:] = self._descent(voltage.size - k)
                if k < count:
                    self.violation = (k, wanted)
                    self._elapsed = count - k
                    last = float(result[count - 1])
                else:
                    self._held = False  # seen in the preview only
                break
            change = wanted - present
            if abs(change) > self._step:
                present += math.copysign(self._step, change)
                self.spread += k < count
            else:
                present = wanted
            result[k] = present
            if k < count:
                last = present
        self.last = last
        return result


def all_to_zero(guards: Sequence[OutputGuard], ramp: float | None = None) -> None:
    """All outputs to zero along one half-cosine, as long as the one that needs most time; see `OutputGuard.to_zero`."""
    if len(guards) > 1:
        ramp = max(guard.shortest_ramp(ramp) for guard in guards)
    for guard in guards:
        guard.to_zero(ramp)


def guard_together(
    guards: Sequence[OutputGuard], voltages: Sequence[FloatArray], samples: int | None = None
) -> list[FloatArray]:
    """The samples that may be put out at several outputs: where one is beyond its limit all go to zero from there on.

    Args:
        guards: of each output; all have the same limits.
        voltages: (n,) V wanted at each.
        samples: as in `OutputGuard.block`.

    Returns:
        (n,) V of each.
    """
    count = voltages[0].size if samples is None else samples
    first = count
    if len(guards) > 1 and not any(guard.held for guard in guards):
        for guard, voltage in zip(guards, voltages, strict=True):
            beyond = np.flatnonzero(~(np.abs(voltage[:first]) <= guard.bound))
            first = int(beyond[0]) if beyond.size else first
    if first == count:
        return [guard.block(voltage, samples) for guard, voltage in zip(guards, voltages, strict=True)]
    heads = [guard.block(voltage[:first]) for guard, voltage in zip(guards, voltages, strict=True)]
    all_to_zero(guards)
    for guard, voltage in zip(guards, voltages, strict=True):
        if not abs(float(voltage[first])) <= guard.bound:
            guard.violation = (first, float(voltage[first]))
    tails = [guard.block(voltage[first:], count - first) for guard, voltage in zip(guards, voltages, strict=True)]
    return [np.concatenate(parts) for parts in zip(heads, tails, strict=True)]
