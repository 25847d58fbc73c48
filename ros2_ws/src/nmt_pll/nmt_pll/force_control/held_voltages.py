"""Voltages as the adaptive Fourier filter would see them: how changes of the drive arrive in what is measured."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from nmt_core.numerics.arrays import ComplexArray


class HeldVoltages:
    """Voltages of all terms as the adaptive filter would see them at the end of each block.

    Args:
        shape: of the voltages.
        cutoff: ω_LP, rad/s.
        block_duration: s.
        latency_blocks: blocks between a command and the block in which it is carried out.
        straight: whether voltages go to a command along a straight line, else along a half-cosine.

    Attributes:
        value: V, of that shape.
    """

    _STEPS = 16

    def __init__(
        self,
        shape: tuple[int, ...],
        cutoff: float,
        block_duration: float,
        latency_blocks: int,
        straight: bool = False,
    ) -> None:
        decay = math.exp(-cutoff * block_duration / self._STEPS)
        share = (np.arange(self._STEPS) + 0.5) / self._STEPS
        left = decay ** np.arange(self._STEPS - 1, -1, -1)
        fade = share if straight else 0.5 - 0.5 * np.cos(np.pi * share)
        self._kept = decay**self._STEPS
        self._new = float((1.0 - decay) * np.sum(left * fade))
        self._old = float((1.0 - decay) * np.sum(left * (1.0 - fade)))
        self._pending: deque[ComplexArray] = deque(np.zeros(shape, complex) for _ in range(latency_blocks))
        self._previous: ComplexArray = np.zeros(shape, complex)
        self.value: ComplexArray = np.zeros(shape, complex)

    def advance(self, command: ComplexArray) -> ComplexArray:
        """Filtered voltages (V) after the block that goes to ``command``."""
        self._pending.append(command.copy())
        target = self._pending.popleft()
        self.value = self._kept * self.value + self._old * self._previous + self._new * target
        self._previous = target
        return self.value

    def clear(self) -> None:
        """Drive at rest."""
        for item in self._pending:
            item[:] = 0.0
        self._previous = np.zeros_like(self._previous)
        self.value = np.zeros_like(self.value)
