"""Peak and rms of every channel over a tenth of a second, for tools that plot: blocks in, levels out."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from nmt_core.messages.blocks import SampleBlock
from nmt_core.messages.cdr import bench_time_ns
from nmt_core.messages.records import SignalLevels
from nmt_core.numerics.arrays import FloatArray
from nmt_core.numerics.kernels import njit
from nmt_core.vocabulary import Quantity

PERIOD = 0.1  # s
_QUANTITIES = tuple(quantity for quantity in Quantity if quantity)


class LevelMeter:
    """Gathers blocks and gives their levels once there are enough.

    Args:
        sample_rate: Hz.
        block_samples: samples of a block.
    """

    def __init__(self, sample_rate: float, block_samples: int) -> None:
        self._rate = sample_rate
        self._blocks = max(1, round(PERIOD * sample_rate / block_samples))
        self._heard = 0
        self._newest: Sequence[SampleBlock] = ()
        self._sums: list[FloatArray] = []
        self._samples = 0
        self._flags = 0

    def add(self, blocks: Sequence[SampleBlock]) -> SignalLevels | None:
        """Take the blocks of one stretch of time; the levels, if it was the last stretch they need.

        A stretch in which samples were lost has none; the levels are those of the others.
        """
        self._heard += 1
        if blocks:
            self._take(blocks)
        if self._heard < self._blocks:
            return None
        levels = self._levels(self._newest) if self._newest else None
        self._heard, self._newest = 0, ()
        return levels

    def _take(self, blocks: Sequence[SampleBlock]) -> None:
        if not self._newest:
            self._sums = [np.zeros((2, block.data.shape[0])) for block in blocks]
            self._samples = self._flags = 0
        self._newest = blocks
        self._samples += blocks[0].samples
        for block, sums in zip(blocks, self._sums, strict=True):
            _add_rows(block.data, sums)
            self._flags |= block.flags

    def _levels(self, newest: Sequence[SampleBlock]) -> SignalLevels:
        single = dict.fromkeys(_QUANTITIES, (float("nan"), float("nan")))
        point = next((block.points[0] for block in newest if block.quantity is Quantity.FORCE and block.points), None)
        names: list[str] = []
        peaks: list[float] = []
        rms: list[float] = []
        for row in sorted(range(len(newest)), key=lambda item: newest[item].quantity):
            block = newest[row]
            peak, square = self._sums[row].tolist()
            root = [math.sqrt(value / self._samples) for value in square]
            channel = block.points.index(point) if point in block.points else 0
            single[block.quantity] = (peak[channel], root[channel])
            names += block.channels
            peaks += peak
            rms += root
        last = newest[0].end_sample - 1
        return SignalLevels(
            last,
            newest[0].oscillator.frequency_hz,
            tuple(single.values()),
            ", ".join(names),
            tuple(peaks),
            tuple(rms),
            self._flags,
            bench_time_ns(last, self._rate),
        )


@njit(cache=True)
def _add_rows(data: FloatArray, sums: FloatArray) -> None:
    """Rows of ``sums``: largest magnitude and sum of squares of every row of ``data`` so far."""
    for row in range(data.shape[0]):
        peak = sums[0, row]
        square = sums[1, row]
        for k in range(data.shape[1]):
            magnitude = abs(data[row, k])
            if peak == peak and not magnitude <= peak:  # what is not a number stays
                peak = magnitude
            square += magnitude * magnitude
        sums[0, row] = peak
        sums[1, row] = square
