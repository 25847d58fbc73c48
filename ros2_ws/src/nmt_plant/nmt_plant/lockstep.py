"""When a simulated plant may produce its next block."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass
class LockstepGate:
    """Holds back block n + 1 + latency until the drive computed from block n has arrived.

    Attributes:
        block_samples: samples a block.
        latency_blocks: blocks the plant may run ahead of its commands.
        answered: last sample that a command was computed from, -1 before the first.
        horizon: first sample that may not be produced yet.
    """

    block_samples: int
    latency_blocks: int
    answered: int = -1
    horizon: int = 0

    def may_produce(self, next_sample: int) -> bool:
        """Whether the block that starts at ``next_sample`` is due."""
        needed = next_sample - self.latency_blocks * self.block_samples - 1
        return next_sample + self.block_samples <= self.horizon and self.answered >= needed

    def starved(self, next_sample: int) -> bool:
        """Whether a command is missing although the horizon would let the block pass, or the horizon stands still."""
        return not self.may_produce(next_sample)
