"""Thins signals for the screen: smallest and largest value of every stretch, so that no peak is lost."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nmt_core.numerics.arrays import FloatArray


def min_max(data: FloatArray, buckets: int) -> FloatArray:
    """Extremes of a signal, in the order in which they occur within each stretch.

    Args:
        data: shape ``(samples,)``.
        buckets: largest number of stretches.

    Returns:
        Shape ``(2 * stretches,)``, or the signal itself if that is not longer.
    """
    if data.size <= 2 * buckets:
        return np.array(data, dtype=np.float64)
    length = -(-data.size // buckets)
    stretches = -(-data.size // length)
    # the last stretch may be shorter: its last value is not a new extreme
    padded = np.full(stretches * length, data[-1])
    padded[: data.size] = data
    rows: FloatArray = padded.reshape(stretches, length)
    result = np.empty(2 * stretches)
    low, high = rows.argmin(axis=1), rows.argmax(axis=1)
    every = np.arange(stretches)
    result[0::2] = rows[every, np.minimum(low, high)]
    result[1::2] = rows[every, np.maximum(low, high)]
    return result


class Strip:
    """Smallest and largest value of every channel of a topic over stretches of equal length, the newest ones.

    Stretch n covers the samples from ``n * length`` on. Samples that did not come leave their stretch empty (NaN).

    Args:
        channels: number of channels.
        length: samples of a stretch.
        stretches: how many are kept.
    """

    def __init__(self, channels: int, length: int, stretches: int) -> None:
        self.length = length
        self.stretches = stretches
        self.newest = -1
        """Number of the newest stretch that is complete or being filled; -1 before the first sample."""
        self._low = np.full((channels, stretches), np.nan)
        self._high = np.full((channels, stretches), np.nan)

    def add(self, first_sample: int, data: FloatArray) -> None:
        """Take samples, shape ``(channels, samples)``; what is older than the newest stretch is passed over."""
        samples = data.shape[1]
        first, last = first_sample // self.length, (first_sample + samples - 1) // self.length
        if not samples or first < self.newest:
            return
        self._advance(last)
        starts = np.arange(first, last + 1) * self.length - first_sample
        starts[0] = 0
        low, high = np.minimum.reduceat(data, starts, axis=1), np.maximum.reduceat(data, starts, axis=1)
        kept = min(last - first + 1, self.stretches)
        columns = np.arange(last - kept + 1, last + 1) % self.stretches
        self._low[:, columns] = np.fmin(self._low[:, columns], low[:, -kept:])
        self._high[:, columns] = np.fmax(self._high[:, columns], high[:, -kept:])

    def _advance(self, to: int) -> None:
        """Empty the stretches between the newest and the one that comes."""
        if to <= self.newest:
            return
        passed = np.arange(max(self.newest + 1, to - self.stretches + 1), to + 1) % self.stretches
        self._low[:, passed] = self._high[:, passed] = np.nan
        self.newest = to

    def since(self, number: int) -> tuple[int, FloatArray, FloatArray]:
        """Complete stretches from a number on, as far as they are kept.

        Returns:
            Number of the first one, smallest and largest values, each of shape ``(channels, stretches)``.
        """
        first = max(number, self.newest - self.stretches + 1, 0)
        columns = np.arange(first, max(first, self.newest)) % self.stretches
        return first, self._low[:, columns], self._high[:, columns]


class Recent:
    """The newest samples of every channel of a topic, without a gap.

    Args:
        channels: number of channels.
        samples: how many are kept.
    """

    def __init__(self, channels: int, samples: int) -> None:
        self._data = np.zeros((channels, 2 * samples))
        self._kept = samples
        self._filled = 0
        self.end_sample = 0

    def add(self, first_sample: int, data: FloatArray) -> None:
        """Take samples, shape ``(channels, samples)``; a gap starts over."""
        if first_sample != self.end_sample:
            self._filled = 0
        self.end_sample = first_sample + data.shape[1]
        data = data[:, -self._kept :]
        count = data.shape[1]
        if self._filled + count > self._data.shape[1]:
            left = min(self._filled, self._kept)
            self._data[:, :left] = self._data[:, self._filled - left : self._filled]
            self._filled = left
        self._data[:, self._filled : self._filled + count] = data
        self._filled += count

    def last(self, samples: int) -> FloatArray:
        """The newest samples, shape ``(channels, at most samples)``; a view, to be used at once."""
        count = min(samples, self._filled, self._kept)
        return self._data[:, self._filled - count : self._filled]


def as_float32(data: FloatArray) -> NDArray[np.float32]:
    """Values for the browser; what is too large for it becomes infinite."""
    with np.errstate(over="ignore"):
        return data.astype("<f4")
