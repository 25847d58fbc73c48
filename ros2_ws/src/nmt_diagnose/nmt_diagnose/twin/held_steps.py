"""What channels without anti-alias filters see of a drive that is held from sample to sample.

The tone e^{iωt} of the samples becomes Σ_m S(f + m f_h) e^{2πi (f + m f_h) t}, S(x) = sinc(x/f_h) e^{−iπx/f_h}. A
channel that is sampled a time s after the drive has moved on sees all of these turned by 2π (f + m f_h) s. A drive that
moves on in a straight line within a time r has sinc(x r) in addition.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from nmt_core.arrays import ComplexArray, FloatArray

LEAST_RISE = 0.02
"""Time that a held drive takes to move on, at least, in samples."""


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

    @cached_property
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
        place, below, held = self._of_nodes
        images = above.reshape((*place.shape[:2], -1))
        images = np.where(below, np.conj(images), images)
        turned = held * self._turns(self.nodes / self.rate, self.orders, at)
        folded_down = self.between @ np.sum(_behind(turned * images, place, slow), axis=0)
        # All images of a response of 1 at all frequencies add up to the step that the channel sees: beyond those that
        # are taken one by one nothing resonates, what passes there is passed at once.
        place, share, held, own = self._of_lines
        turned = held * self._turns(self.lines / self.rate, np.append(0, self.orders), at)
        rest = _ramp(share, at, slow, max(self.rise, LEAST_RISE)) - np.sum(_behind(turned, place, slow), axis=0)
        return np.asarray(own * responses + folded_down + rest * images[-1].real.mean(axis=0))

    @cached_property
    def _of_nodes(self) -> tuple[FloatArray, NDArray[np.bool_], ComplexArray]:
        """Images of the nodes over the rate (images, nodes, 1), which lie below zero, and S there."""
        place = self._places()[:, :, np.newaxis]
        return place, place < 0.0, self._held(place)

    @cached_property
    def _of_lines(self) -> tuple[FloatArray, FloatArray, ComplexArray, ComplexArray]:
        """Lines with their images over the rate (1 + images, lines, 1), lines alone (lines, 1), S at both, turned."""
        share = (self.lines / self.rate)[:, np.newaxis]
        place = (self.lines / self.rate + np.append(0, self.orders)[:, np.newaxis])[:, :, np.newaxis]
        own = self._held(share) * np.exp(2j * np.pi * share * self.sampled_at)
        return place, share, self._held(place), np.asarray(own)

    def _places(self) -> FloatArray:
        """Images of the nodes over the rate, (images, nodes)."""
        return np.asarray(self.nodes / self.rate + self.orders[:, np.newaxis])

    def _held(self, share: FloatArray) -> ComplexArray:
        """S at frequencies over the rate."""
        return np.asarray(np.sinc(share) * np.sinc(share * self.rise) * np.exp(-1j * np.pi * share))

    @staticmethod
    def _turns(share: FloatArray, orders: NDArray[np.int64], at: FloatArray) -> ComplexArray:
        """Turn of images of frequencies over the rate, seen at some times in samples, (images, frequencies, times)."""
        return np.asarray(np.exp(2j * np.pi * np.outer(orders, at))[:, None] * np.exp(2j * np.pi * np.outer(share, at)))


def _behind(values: ComplexArray, place: FloatArray, slow: FloatArray) -> ComplexArray:
    """Values of channels behind low-passes of first order, at frequencies over the rate."""
    return values / (1.0 + 2j * np.pi * place * slow) if np.any(slow) else values


def _ramp(share: FloatArray, at: FloatArray, slow: FloatArray, rise: float) -> ComplexArray:
    """The same of a drive that moves on in a straight line: within the rise a channel sees a part of the step.

    Args:
        share, at, slow: as for `_step`.
        rise: in samples.
    """
    beside = at - np.round(at)
    moving = np.abs(beside) < 0.5 * rise
    if not moving.any():
        return _step(share, at, slow)
    passed = 0.5 + beside / rise
    before, after = (_step(share, np.where(moving, np.round(at) + turn * rise, at), slow) for turn in (-0.5, 0.5))
    return np.asarray(np.where(moving, (1.0 - passed) * before + passed * after, after))


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
