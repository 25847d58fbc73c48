"""A small multisine on top of a drive within a window: what an orbit answers to it tells its Floquet exponents."""

from __future__ import annotations

import math
from dataclasses import dataclass

from nmt_pll.thresholds import CURVE


@dataclass(frozen=True, slots=True)
class Multisine:
    """The lowest lines of a window, in the amplitude and, with other phases, in the frequency.

    The phases are those of Schroeder (IEEE Trans. Inf. Theory 16 (1970) 85).

    Attributes:
        share: rms of the change of the amplitude over it; 0 = none.
        first_sample, samples: of the window.
    """

    share: float = 0.0
    first_sample: int = 0
    samples: int = 0

    def factors(self, sample: int) -> tuple[float, float]:
        """Factors of amplitude and frequency from a sample on."""
        place = sample - self.first_sample
        if not (self.share > 0.0 and 0 <= place < self.samples):
            return 1.0, 1.0
        size, pace = (self._course(2.0 * math.pi * place / self.samples, turn) for turn in (1.0, 1.7))
        return 1.0 + self.share * size, 1.0 + CURVE.perturbed_frequency_share * self.share * pace

    @staticmethod
    def _course(angle: float, turn: float) -> float:
        count = round(CURVE.perturbed_lines)
        lines = (math.cos(k * angle - turn * math.pi * k * (k - 1) / count) for k in range(1, count + 1))
        return sum(lines) / math.sqrt(0.5 * count)
