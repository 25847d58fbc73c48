"""What channels without anti-alias filters see of a drive that is held from sample to sample.

The tone e^{iωt} of the samples becomes Σ_m S(f + m f_h) e^{2πi (f + m f_h) t}, S(x) = sinc(x/f_h) e^{−iπx/f_h}. A
channel that is sampled a time s after the drive has moved on sees all of these turned by 2π (f + m f_h) s. A drive that
moves on in a straight line within a time r has sinc(x r) in addition.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nmt_core.blocks import FloatArray
from nmt_diagnose.twin.linear_model import ComplexArray


@dataclass(frozen=True)
class HeldSteps:
    """The steps of one random test.

    Attributes:
        rate: f_h, Hz.
        sampled_at, rise: s and r, in samples.
        lines: (lines,) Hz.
        nodes: (nodes,) frequencies between which a polynomial does, Hz.
        orders: (images,) that are taken one by one, ascending in size.
        between: (lines, nodes) from the nodes to the lines.
    """

    rate: float
    sampled_at: float
    rise: float
    lines: FloatArray
    nodes: FloatArray
    orders: NDArray[np.int64]
    between: FloatArray

    @property
    def frequencies(self) -> FloatArray:
        """Where responses are wanted, (images · nodes,) Hz."""
        return np.abs(self._places() * self.rate).ravel()

    def seen(
        self, responses: ComplexArray, above: ComplexArray, delays: FloatArray, low_passes: FloatArray
    ) -> ComplexArray:
        """Responses to the samples (lines, channels).

        Args:
            responses: to a smooth drive (lines, channels).
            above: those at ``frequencies``, without delays and low-passes of the sensors (images · nodes, channels).
            delays: of the sensors, s, (channels,).
            low_passes: time constants of their low-passes, s, (channels,); 0 = none.
        """
        at = self.sampled_at - self.rate * delays
        slow = self.rate * low_passes
        place = self._places()[:, :, np.newaxis]
        images = above.reshape((*place.shape[:2], -1))
        images = np.where(place < 0.0, np.conj(images), images)
        folded_down = self.between @ np.sum(
            self._turned(place, at) * images / (1.0 + 2j * np.pi * place * slow), axis=0
        )
        share = (self.lines / self.rate)[:, np.newaxis]
        own = self._turned(share, np.full(1, self.sampled_at))
        # All images of a response of 1 at all frequencies add up to the step that the channel sees: beyond those that
        # are taken one by one nothing resonates, what passes there is passed at once.
        place = (self.lines / self.rate + np.append(0, self.orders)[:, np.newaxis])[:, :, np.newaxis]
        one_by_one = np.sum(self._turned(place, at) / (1.0 + 2j * np.pi * place * slow), axis=0)
        rest = _step(share, at, slow) - one_by_one
        return np.asarray(own * responses + folded_down + rest * images[-1].real.mean(axis=0))

    def _places(self) -> FloatArray:
        """Images of the nodes over the rate, (images, nodes)."""
        return np.asarray(self.nodes / self.rate + self.orders[:, np.newaxis])

    def _turned(self, share: FloatArray, at: FloatArray) -> ComplexArray:
        """S at frequencies over the rate, turned for channels that are sampled at some time, in samples."""
        held = np.sinc(share) * np.sinc(share * self.rise) * np.exp(-1j * np.pi * share)
        result: ComplexArray = held * np.exp(2j * np.pi * share * at)
        return result


def _step(share: FloatArray, at: FloatArray, slow: FloatArray) -> ComplexArray:
    """The held tone of 1 at some time within a sample, behind a low-pass of first order.

    Args:
        share: (lines, 1) frequencies over the rate.
        at: (channels,) times in samples.
        slow: (channels,) time constants in samples.
    """
    z = np.exp(2j * np.pi * share)
    whole = np.floor(at)
    decay, left = (np.exp(-time / np.maximum(slow, 1e-9)) for time in (1.0, at - whole))
    left = np.where(slow > 0.0, left, 0.0)
    result: ComplexArray = z**whole * (1.0 - left + left * (1.0 - decay) / (z - decay))
    return result
