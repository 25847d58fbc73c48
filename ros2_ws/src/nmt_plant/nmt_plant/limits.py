"""Safety limits on measured amplitudes: the first violation latches."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numba import njit

from nmt_core.blocks import FloatArray, Quantity, SampleBlock


@njit(cache=True)
def within_limit(data: FloatArray, limit: float) -> bool:
    """Whether every magnitude is at most ``limit``; NaN is not."""
    for row in range(data.shape[0]):
        for k in range(data.shape[1]):
            if not abs(data[row, k]) <= limit:
                return False
    return True


@dataclass
class LimitGuard:
    """Compares every block with the largest permitted magnitude of its quantity.

    Attributes:
        limits: quantity -> largest magnitude, SI.
        reason: sentence about the violation that tripped, empty while there is none.
    """

    limits: dict[Quantity, float]
    reason: str = field(default="", init=False)

    def check(self, blocks: Sequence[SampleBlock]) -> bool:
        """Latch the first violation; True if tripped now or before. NaN and infinity violate every limit."""
        if self.reason:
            return True
        for block in blocks:
            limit = self.limits.get(block.quantity)
            if limit is None:
                continue
            if not within_limit(block.data, limit):
                within = np.abs(block.data) <= limit
                violating = np.argwhere(~within)
                row, sample = violating[np.argmin(violating[:, 1])]
                self.reason = (
                    f"{block.quantity.name.lower()} limit: {block.channels[row]} reached "
                    f"{block.data[row, sample]:.4g} {block.unit} at sample "
                    f"{block.first_sample + int(sample)}, "
                    f"limit {limit:g} {block.unit}"
                )
                return True
        return False

    def reset(self) -> None:
        """Forget the violation."""
        self.reason = ""
