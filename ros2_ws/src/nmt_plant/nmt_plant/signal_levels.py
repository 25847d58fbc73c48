"""Peak and rms of every channel over a tenth of a second, for tools that plot: blocks in, levels out."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain

import numpy as np

from nmt_core.blocks import SampleBlock
from nmt_core.cdr import bench_time_ns
from nmt_core.records import SignalLevels
from nmt_core.vocabulary import Quantity

PERIOD = 0.1  # s


class LevelMeter:
    """Gathers blocks and gives their levels once there are enough.

    Args:
        sample_rate: Hz.
        block_samples: samples of a block.
    """

    def __init__(self, sample_rate: float, block_samples: int) -> None:
        self._rate = sample_rate
        self._blocks = max(1, round(PERIOD * sample_rate / block_samples))
        self._kept: list[Sequence[SampleBlock]] = []

    def add(self, blocks: Sequence[SampleBlock]) -> SignalLevels | None:
        """Take the blocks of one stretch of time; the levels, if it was the last stretch they need.

        A stretch in which samples were lost has none; the levels are those of the others.
        """
        self._kept.append(blocks)
        if len(self._kept) < self._blocks:
            return None
        whole, self._kept = [blocks for blocks in self._kept if blocks], []
        return self._levels(whole) if whole else None

    def _levels(self, kept: list[Sequence[SampleBlock]]) -> SignalLevels:
        newest = kept[-1]
        single = {quantity: (float("nan"), float("nan")) for quantity in Quantity if quantity}
        point = next((block.points[0] for block in newest if block.quantity is Quantity.FORCE and block.points), None)
        names: list[str] = []
        peaks: list[float] = []
        squares: list[float] = []
        for row in sorted(range(len(newest)), key=lambda item: newest[item].quantity):
            block = newest[row]
            data = np.concatenate([blocks[row].data for blocks in kept], axis=1)
            peak = np.maximum(data.max(axis=1), -data.min(axis=1))
            rms = np.sqrt(np.einsum("ij,ij->i", data, data) / data.shape[1])
            channel = block.points.index(point) if point in block.points else 0
            single[block.quantity] = (float(peak[channel]), float(rms[channel]))
            names += block.channels
            peaks += peak.tolist()
            squares += rms.tolist()
        last = newest[0].end_sample - 1
        flags = 0
        for block in chain.from_iterable(kept):
            flags |= block.flags
        return SignalLevels(
            last,
            newest[0].oscillator.frequency_hz,
            tuple(single.values()),
            ", ".join(names),
            tuple(peaks),
            tuple(squares),
            flags,
            bench_time_ns(last, self._rate),
        )
