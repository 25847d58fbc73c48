"""Memory that the process which makes samples and the one which owns the converter share.

Three lines of samples by index: what is fed, what was put out, what was measured. The memory has no name: it lives as
long as one of the two processes. Each line has one writer. Indices come by messages, which also order memory: what
is written before a message is sent is read after it is received.
"""

from __future__ import annotations

import mmap
import os

import numpy as np

from nmt_core.numerics.arrays import FloatArray


class SampleLine:
    """A ring of samples of some channels, addressed by sample index.

    Args:
        memory: shape (channels, samples of the ring).
    """

    def __init__(self, memory: FloatArray) -> None:
        self._memory = memory
        self._size = memory.shape[1]

    def write(self, first: int, values: FloatArray) -> None:
        """Write (channels, n) values from an index on; n is at most the ring's length."""
        start = first % self._size
        head = min(values.shape[1], self._size - start)
        self._memory[:, start : start + head] = values[:, :head]
        if head < values.shape[1]:
            self._memory[:, : values.shape[1] - head] = values[:, head:]

    def read(self, first: int, samples: int) -> FloatArray:
        """A copy of the values from an index on, shape (channels, samples)."""
        start = first % self._size
        head = min(samples, self._size - start)
        if head == samples:
            return self._memory[:, start : start + head].copy()
        return np.concatenate([self._memory[:, start:], self._memory[:, : samples - head]], axis=1)


class SharedSamples:
    """The three lines in shared memory.

    Args:
        outputs: channels that are put out.
        inputs: channels that are measured; may be 0.
        samples: length of the rings.
        descriptor: of the memory, made by the other side; None = make it.

    Attributes:
        fed: (outputs) V, what is to be put out.
        put_out: (outputs) V, what was put out in its place.
        measured: (inputs) what was taken in.
        descriptor: to be handed to the other side.
    """

    def __init__(self, outputs: int, inputs: int, samples: int, descriptor: int | None = None) -> None:
        counts = (outputs, outputs, inputs)
        size = 8 * samples * sum(counts)
        self.descriptor = os.memfd_create("nmt-output") if descriptor is None else descriptor
        if descriptor is None:
            os.ftruncate(self.descriptor, size)
        whole = np.frombuffer(mmap.mmap(self.descriptor, size), np.float64).reshape(-1, samples)
        ends = np.cumsum(counts)
        self.fed, self.put_out, self.measured = (SampleLine(part) for part in np.split(whole, ends[:-1]))

    def close(self) -> None:
        """Close the descriptor; the memory is freed when its lines are unused."""
        os.close(self.descriptor)
