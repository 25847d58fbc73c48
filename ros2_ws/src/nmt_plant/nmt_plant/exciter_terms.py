"""Terms of the drive beside its fundamental at exciter 1: harmonics and ratios that all follow one amplitude.

With the common amplitude A(t) exciter j gets u_j = A(t) · Re Σ r_jn exp(i n θ); r_11 = 1 is the fundamental.
So every ramp of the amplitude, and every end of a test, takes all exciters along. Ratios that change go to their new
values along a half-cosine within one block.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_core.numerics.ramp import half_cosine


class ExciterTerms:
    """Ratios r_jn at work.

    Args:
        exciters: number of exciters.
    """

    def __init__(self, exciters: int) -> None:
        self.exciters = exciters
        self._now: dict[tuple[int, int], complex] = {}
        self._before: dict[tuple[int, int], complex] | None = None

    def aim(self, terms: Sequence[tuple[int, int, complex]], at_rest: bool) -> None:
        """Go to other ratios within the next block, at once where the drive is at rest; what is not named goes to zero.

        Args:
            terms: (exciter from 1, harmonic number, ratio).
            at_rest: whether the amplitude is zero.
        """
        if self._before is None:
            self._before = self._now
        self._now = {(exciter - 1, order): ratio for exciter, order, ratio in terms}
        if at_rest:
            self._before = None

    @property
    def largest(self) -> float:
        """Largest sum of |r_jn| of any exciter in the next block, the fundamental's 1 included."""
        sums = np.zeros(self.exciters)
        sums[0] = 1.0
        before = self._before or {}
        for key in {**before, **self._now}:
            sums[key[0]] += max(abs(self._now.get(key, 0.0)), abs(before.get(key, 0.0)))
        return float(sums.max())

    def __bool__(self) -> bool:
        """Whether there are any, now or at the beginning of the next block."""
        return bool(self._now or self._before)

    def signals(self, theta: FloatArray) -> FloatArray:
        """Re Σ r_jn exp(i n θ) over the next block.

        Args:
            theta: (samples + 1,) phase at the samples and the first of the next block, rad.

        Returns:
            (exciters, samples + 1), without the fundamental's 1.
        """
        before, self._before = self._before, None
        result = np.zeros((self.exciters, theta.size))
        fade = half_cosine(np.arange(theta.size) / (theta.size - 1))
        powers: dict[int, ComplexArray] = {}
        for key in {**(before or {}), **self._now}:
            exciter, order = key
            if order not in powers:
                powers[order] = np.exp(1j * order * theta)
            target = self._now.get(key, 0j)
            start = target if before is None else before.get(key, 0j)
            ratio = target if start == target else start + (target - start) * fade
            result[exciter] += (ratio * powers[order]).real
        return result

    def clear(self) -> None:
        """The drive is at rest."""
        self._now, self._before = {}, None
