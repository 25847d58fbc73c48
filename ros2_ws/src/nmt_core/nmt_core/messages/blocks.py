"""Blocks of samples and the oscillator phase that comes with them.

The sample index is the clock of the bench: everything that happens is named by the sample it happened at.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from nmt_core.numerics.arrays import FloatArray
from nmt_core.vocabulary import SAMPLE_TOPICS, BlockFlag, Quantity

__all__ = [
    "SAMPLE_TOPICS",
    "UNKNOWN_PHASE",
    "BlockFlag",
    "OscillatorPhase",
    "Quantity",
    "SampleBlock",
    "rounded",
]


class OscillatorPhase(NamedTuple):
    """Phase of the excitation over a block.

    At sample k of the block the phase is ``cycles + f t + rate t² / 2`` with ``t = k / sample_rate``, in cycles.

    Attributes:
        cycles: phase at the first sample, cycles in [0, 1); NaN if not known.
        frequency_hz: frequency at the first sample, Hz; 0 without periodic excitation.
        rate_hz_s: rate of change of the frequency, Hz/s.
    """

    cycles: float
    frequency_hz: float
    rate_hz_s: float = 0.0

    def phase(self, samples: int, sample_rate: float) -> FloatArray:
        """Phase at each sample of the block.

        Args:
            samples: number of samples.
            sample_rate: Hz.

        Returns:
            Phase in rad, shape ``(samples,)``, starting in [0, 2π) and not wrapped within the block.
        """
        time = np.arange(samples) / sample_rate
        return 2.0 * np.pi * (self.cycles + time * (self.frequency_hz + 0.5 * self.rate_hz_s * time))


UNKNOWN_PHASE = OscillatorPhase(float("nan"), float("nan"))


def rounded(values: FloatArray, bits: int) -> FloatArray:
    """Values with so many significant bits, to the nearest, halves away from zero; what is not finite stays.

    The other bits are zero, which a compression of the bag makes use of. The relative error is at most 2 to the power
    of minus ``bits``.

    Args:
        values: of any shape.
        bits: 1 to 53; 53 changes nothing, 24 are those of single precision.

    Returns:
        New values of the same shape.
    """
    if not 1 <= bits <= 53:
        raise ValueError(f"bits must be 1 to 53, got {bits}")
    result = np.array(values, dtype=np.float64)
    dropped = 53 - bits
    if dropped == 0:
        return result
    pattern = result.view(np.uint64)
    half, kept = np.uint64(1 << (dropped - 1)), np.uint64(2**64 - 2**dropped)
    # A carry into the exponent is right: the next power of two. Infinity and NaN are left out of it.
    np.copyto(pattern, (pattern + half) & kept, where=np.isfinite(result))
    return result


@dataclass(slots=True)
class SampleBlock:
    """Simultaneously sampled channels of one quantity; not to be changed once made.

    (Not a frozen dataclass, because making one of those takes longer than reading the block.)

    Attributes:
        first_sample: index of the first sample since the start of acquisition.
        sample_rate: Hz.
        quantity: what the channels measure.
        unit: unit of the data.
        channels: channel names, one a row of ``data``.
        points: measurement point of each channel, 0 where it belongs to none.
        data: shape ``(channels, samples)``.
        oscillator: phase of the excitation.
        flags: see :class:`BlockFlag`.
    """

    first_sample: int
    sample_rate: float
    quantity: Quantity
    unit: str
    channels: tuple[str, ...]
    points: tuple[int, ...]
    data: FloatArray
    oscillator: OscillatorPhase = UNKNOWN_PHASE
    flags: int = 0

    def at_point(self, point: int) -> SampleBlock:
        """The channel at a measurement point alone; the block itself if it has one channel, or none at the point."""
        if len(self.channels) == 1 or point not in self.points:
            return self
        row = self.points.index(point)
        return SampleBlock(
            self.first_sample,
            self.sample_rate,
            self.quantity,
            self.unit,
            self.channels[row : row + 1],
            self.points[row : row + 1],
            self.data[row : row + 1],
            self.oscillator,
            self.flags,
        )

    @property
    def samples(self) -> int:
        """Number of samples in the block."""
        return int(self.data.shape[1])

    @property
    def end_sample(self) -> int:
        """Index of the sample after the last one: the next block's ``first_sample``."""
        return self.first_sample + self.samples
