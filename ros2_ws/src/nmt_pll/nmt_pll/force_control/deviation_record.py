"""Deviations of harmonics from their targets over a dwell: their mean, and the noise in them."""

from __future__ import annotations

import math

import numpy as np

from nmt_core.numerics.arrays import ComplexArray, FloatArray

FEWEST_BLOCKS = 4
"""Blocks that a record has at least: noise is judged by bends, of three each."""


class DeviationRecord:
    """The newest deviations, a ring over the blocks of a dwell.

    Args:
        blocks: of the dwell.
        shape: of the deviations of a block.
        cutoff: ω_LP of the filter that they come from, rad/s.
        block_duration: s.

    Attributes:
        blocks: that the record holds.
        count: deviations since the last restart.
        correlation: blocks over which the noise behind the filter is alike.
    """

    def __init__(self, blocks: int, shape: tuple[int, ...], cutoff: float, block_duration: float) -> None:
        self.blocks = max(FEWEST_BLOCKS, blocks)
        self.count = 0
        self._values: ComplexArray = np.zeros((2 * self.blocks, *shape), complex)  # twice, so that they lie in a row
        self.correlation = max(1.0, 2.0 / (cutoff * block_duration))
        neighbour = math.exp(-2.0 / self.correlation)
        self._noise_per_bend = 1.0 / math.sqrt(6.0 - 8.0 * neighbour + 2.0 * neighbour**2)

    def restart(self) -> None:
        """Forget them."""
        self.count = 0

    def add(self, deviation: ComplexArray) -> None:
        """Take the deviations of a block."""
        place = self.count % self.blocks
        self._values[place] = self._values[place + self.blocks] = deviation
        self.count += 1

    @property
    def length(self) -> int:
        """How many there are, at most as many as the dwell has blocks."""
        return min(self.count, self.blocks)

    @property
    def is_full(self) -> bool:
        """Whether a dwell has passed."""
        return self.count >= self.blocks

    def mean_and_noise(self) -> tuple[ComplexArray, FloatArray]:
        """Mean, and standard deviation of the noise of one block; of three deviations or more."""
        oldest = self.count % self.blocks if self.count > self.blocks else 0
        record = self._values[oldest : oldest + self.length]
        bend = record[:-2] - 2.0 * record[1:-1] + record[2:]
        # The median: a transient bends a few blocks only, noise all of them; its square is distributed exponentially.
        squares = np.abs(bend) ** 2
        squares.sort(axis=0)
        high = len(squares) // 2
        median = squares[high] if len(squares) % 2 else (squares[high - 1] + squares[high]) / 2.0
        noise = self._noise_per_bend * np.sqrt(median / math.log(2.0))
        return np.add.reduce(record, axis=0) / len(record), noise

    def mean_std(self, noise: FloatArray) -> FloatArray:
        """Standard deviation of the mean for noise of one block."""
        return np.asarray(noise * math.sqrt(self.correlation / max(1, self.length)))
