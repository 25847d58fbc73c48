"""Sweeps and stepped sines: the frequency is given and an amplitude is held."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from nmt_core.errors import BenchError
from nmt_core.kinds.kind_of_test import LONGEST, KindOfTest
from nmt_core.vocabulary import TestKind


@dataclass(frozen=True, kw_only=True)
class SweepTest(KindOfTest):
    """The frequency moves from that of the level to the end; the window is the whole sweep.

    Attributes:
        rate_hz_s: Hz/s, sign = direction.
        frequency_end_hz: Hz.
    """

    NUMBER: ClassVar[TestKind] = TestKind.SWEEP
    one_exciter: ClassVar[str] = "A sweep drives"
    sweeps: ClassVar[bool] = True
    needs_frequencies: ClassVar[bool] = True

    rate_hz_s: float = 0.0
    frequency_end_hz: float = 0.0

    def check(self, frequencies_hz: Sequence[float], levels: int, control: int, sample_rate: float) -> None:
        """Refuse (BenchError) a rate that does not lead to the end."""
        super().check(frequencies_hz, levels, control, sample_rate)
        end, rate, nyquist = self.frequency_end_hz, self.rate_hz_s, 0.5 * sample_rate
        if not 0.0 < end < nyquist:
            raise BenchError(
                f"The sweep's end of {end:g} Hz must lie between 0 and half the sample rate, {nyquist:g} Hz."
            )
        if rate == 0.0:
            raise BenchError("A sweep needs a rate other than 0 Hz/s.")
        for start in frequencies_hz:
            if not 0.0 < (end - start) / rate < LONGEST:
                raise BenchError(
                    f"A rate of {rate:g} Hz/s does not lead from {start:g} to {end:g} Hz within 1e6 s; mind its sign."
                )


@dataclass(frozen=True, kw_only=True)
class SteppedSineTest(KindOfTest):
    """One window of whole periods at the frequency of each level."""

    NUMBER: ClassVar[TestKind] = TestKind.STEPPED_SINE
    one_exciter: ClassVar[str] = "A stepped sine drives"
    needs_frequencies: ClassVar[bool] = True
