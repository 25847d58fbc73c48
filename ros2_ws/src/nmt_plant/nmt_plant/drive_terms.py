"""Terms of the drive next to its fundamental at exciter 1, over the amplitude or in V.

With the common amplitude A(t) exciter j gets u_j = A(t) Re Σ r_jn exp(i n θ) + W(t) Re Σ v_jn exp(i n θ); r_11 = 1 is
the fundamental. So every ramp of the amplitude, and every end of a test, takes all exciters along; terms in V ramp with
a weight W from 0 to 1 of their own. Terms that change go to their new values within one block, so
that a controller of theirs does not make steps: those in V along a half-cosine, those over the amplitude along a
straight line. The latter drift as long as the other exciters follow the shape of the motion; half-cosines, which stop
at the end of every block, would put a line at the block rate into the voltage.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from nmt_core.messages.records import DriveTerm
from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_core.numerics.ramp import half_cosine

_Key = tuple[int, int, bool]  # exciter from 0, order, whether relative
_TURNING = (0, 1, False)


class DriveTerms:
    """Terms at work.

    Args:
        exciters: number of exciters.
    """

    def __init__(self, exciters: int) -> None:
        self.exciters = exciters
        self._now: dict[_Key, complex] = {}
        self._before: dict[_Key, complex] = {}

    def aim(self, terms: Sequence[DriveTerm], amplitude_rests: bool, weight_rests: bool) -> None:
        """Go to other values within the next block; what is not named goes to zero.

        Args:
            terms: the new ones.
            amplitude_rests, weight_rests: whether A, W is zero: what follows it is then there at once.
        """
        if not terms and not self._now:
            return
        wanted = {(exciter - 1, order, relative): value for exciter, order, value, relative in terms}
        rests = {True: amplitude_rests, False: weight_rests}
        for key in {**self._now, **wanted}:
            if rests[key[2]]:
                self._before.pop(key, None)
            else:
                self._before.setdefault(key, self._now.get(key, 0j))
        self._now = wanted | {key: 0j for key in self._before if key not in wanted}

    def __bool__(self) -> bool:
        """Whether there are any."""
        return bool(self._now)

    @property
    def in_volts(self) -> bool:
        """Whether there are any in V."""
        return any(not relative for _, _, relative in self._now)

    @property
    def turns_fundamental(self) -> bool:
        """Whether the fundamental of exciter 1 is turned."""
        return _TURNING in self._now

    @property
    def turning(self) -> tuple[complex, complex]:
        """Term that turns the fundamental at the beginning and at the end of the next block, V."""
        after = self._now.get(_TURNING, 0j)
        return self._before.get(_TURNING, after), after

    def largest(self, amplitude: float, weight: float, fundamental: float | None = None) -> float:
        """Largest sum of the amplitudes of any exciter's terms in the next block, V.

        Args:
            amplitude, weight: largest A (V) and W.
            fundamental: of exciter 1 together with what turns it, V; None = that adds up as any other term.
        """
        sums = np.zeros(self.exciters)
        sums[0] = amplitude if fundamental is None else fundamental
        for key, value in self._now.items():
            if key != _TURNING or fundamental is None:
                size = max(abs(value), abs(self._before.get(key, 0.0)))
                sums[key[0]] += (amplitude if key[2] else weight) * size
        return float(sums.max())

    def add_to(self, voltages: FloatArray, theta: FloatArray, amplitude: FloatArray, weight: FloatArray) -> None:
        """Add the terms over the next block, which are then at their new values.

        Args:
            voltages: (exciters, samples + 1) V.
            theta: (samples + 1,) phase at the samples and the first of the next block, rad.
            amplitude, weight: (samples + 1,) A (V) and W.
        """
        before = self._before
        straight = np.arange(theta.size) / (theta.size - 1)
        fades = {True: straight, False: half_cosine(straight)} if before else {}
        powers: dict[int, ComplexArray] = {}
        for key, value in self._now.items():
            exciter, order, relative = key
            if order not in powers:
                powers[order] = np.exp(1j * order * theta)
            start = before.get(key, value)
            present = value if start == value else start + (value - start) * fades[relative]
            voltages[exciter] += (amplitude if relative else weight) * (present * powers[order]).real
        if before:
            self._now = {key: value for key, value in self._now.items() if value != 0.0}
            self._before = {}

    def clear(self) -> None:
        """The drive is at rest."""
        self._now, self._before = {}, {}
