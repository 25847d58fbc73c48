"""What the page keeps of the samples of one topic: strips, the newest samples, peaks and rms with their limits."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from nmt_bench.page.decimation import Recent, Strip
from nmt_core.messages.blocks import OscillatorPhase, SampleBlock
from nmt_core.numerics.arrays import FloatArray
from nmt_core.vocabulary import Quantity

STRIP_SECONDS = 10.0
STRETCHES = 1000
_RECENT_SECONDS = 2.0
_MOST_RECENT = 65_536
_MEMORY_BYTES = 64_000_000  # of the newest samples of one topic
_LEVEL_SECONDS = 1.0  # over which peaks are held and squares are averaged

FLOOR_SHARE, LEAST = 1e-9, 1e-30
"""Share of the largest magnitude so far below which a value is rounding, and what no sensor resolves in SI units."""

_COMMON = {
    Quantity.FORCE: "force_n",
    Quantity.ACCELERATION: "acceleration_m_s2",
    Quantity.VELOCITY: "velocity_m_s",
    Quantity.DISPLACEMENT: "displacement_m",
    Quantity.VOLTAGE: "voltage_v",
}


@dataclass(frozen=True)
class Levels:
    """Warning and abort levels of a channel in its unit; NaN = none."""

    warning_peak: float = math.nan
    abort_peak: float = math.nan
    warning_rms: float = math.nan
    abort_rms: float = math.nan


def channel_levels(limits: Mapping[str, Any], quantity: Quantity, channel: str) -> Levels:
    """Levels of a channel by the section ``limits`` of a rig file; numbers that make no sense count as none."""
    common = _number(limits.get(_COMMON.get(quantity, "")))
    share = _number(limits.get("warning_share", 0.8))
    listed = limits.get("channels")
    own: Mapping[str, Any] = {}
    for item in listed if isinstance(listed, list) else ():
        if isinstance(item, Mapping) and item.get("channel") == channel:
            own = item
    abort_peak = float(np.fmin(common, _number(own.get("abort_peak"))))
    abort_rms = _number(own.get("abort_rms"))
    warning_peak, warning_rms = _number(own.get("warning_peak")), _number(own.get("warning_rms"))
    return Levels(
        share * abort_peak if math.isnan(warning_peak) else warning_peak,
        abort_peak,
        share * abort_rms if math.isnan(warning_rms) else warning_rms,
        abort_rms,
    )


def _number(value: Any) -> float:
    good = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value) and value > 0
    return float(value) if good else math.nan


class TopicSignals:
    """The channels of one topic.

    Args:
        block: its first block.
    """

    def __init__(self, block: SampleBlock) -> None:
        count = len(block.channels)
        self.quantity, self.unit = block.quantity, block.unit
        self.channels, self.points = block.channels, block.points
        self.sample_rate = block.sample_rate
        self.strip = Strip(count, max(1, round(STRIP_SECONDS / STRETCHES * block.sample_rate)), STRETCHES)
        kept = min(_MOST_RECENT, round(_RECENT_SECONDS * block.sample_rate), _MEMORY_BYTES // (16 * count))
        self.recent = Recent(count, max(block.samples, kept))
        self.oscillator = block.oscillator
        self.oscillator_sample = block.first_sample
        self.flags = 0
        self._squares = np.full(count, np.nan)
        self._largest = np.zeros(count)

    def fits(self, block: SampleBlock) -> bool:
        """Whether a block has the same channels."""
        return block.channels == self.channels and block.sample_rate == self.sample_rate

    def add(self, block: SampleBlock) -> None:
        """Take a block; what is below the floor of its channel counts as zero, so that no axis has to reach there."""
        self._largest = np.fmax(self._largest, np.fmax.reduce(np.abs(block.data), axis=1))
        data = np.where(np.abs(block.data) < self.floor[:, np.newaxis], 0.0, block.data)
        self.strip.add(block.first_sample, data)
        self.recent.add(block.first_sample, data)
        self.oscillator, self.oscillator_sample = block.oscillator, block.first_sample
        self.flags = block.flags
        squares = np.mean(np.square(data), axis=1)
        share = min(1.0, block.samples / (_LEVEL_SECONDS * block.sample_rate))
        self._squares = np.where(np.isfinite(self._squares), self._squares + share * (squares - self._squares), squares)

    @property
    def floor(self) -> FloatArray:
        """What differs from rounding, of each channel in its unit."""
        return np.asarray(np.maximum(FLOOR_SHARE * self._largest, LEAST), dtype=np.float64)

    @property
    def rms(self) -> FloatArray:
        """Running rms of each channel."""
        root = np.sqrt(self._squares)
        return np.asarray(np.where(root < self.floor, 0.0, root), dtype=np.float64)

    @property
    def peak(self) -> FloatArray:
        """Largest magnitude of each channel in the last second."""
        stretches = max(1, round(_LEVEL_SECONDS * self.sample_rate / self.strip.length))
        _, low, high = self.strip.since(self.strip.newest - stretches)
        if not low.shape[1]:
            return np.full(len(self.channels), np.nan)
        return np.asarray(np.fmax.reduce(np.fmax(-low, high), axis=1), dtype=np.float64)

    def phase_at(self, sample: int) -> float:
        """Phase of the excitation at a sample in cycles; NaN where there is none."""
        oscillator: OscillatorPhase = self.oscillator
        if not oscillator.frequency_hz > 0.0:
            return math.nan
        time = (sample - self.oscillator_sample) / self.sample_rate
        return oscillator.cycles + time * (oscillator.frequency_hz + 0.5 * oscillator.rate_hz_s * time)
