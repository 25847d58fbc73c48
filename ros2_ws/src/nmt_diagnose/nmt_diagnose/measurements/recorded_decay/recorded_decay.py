"""Free decays: frequency and damping over amplitude."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from nmt_core.numerics.arrays import FloatArray
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.measurements.measurement import Driven


@dataclass(frozen=True)
class RecordedDecay(Driven):
    """Free decay after switch-off or impact: frequency and decay rate of a response over its amplitude.

    Attributes:
        name: unique name.
        drive_point: measurement point of the exciter (it stays attached, at zero volts).
        channel: response channel that the amplitudes are of.
        amplitudes: fundamental amplitude in the channel's unit at which the observables stand, shape (k,), falling.
        frequency_hz: at the smallest amplitude, Hz; it tells the mode.
        others: further response channels; magnitude and phase of their fundamentals stand relative to the first one's.
        resting_points: measurement points of further exciters, at zero volts too.
    """

    WORDS: ClassVar[str] = "ring-down"

    name: str
    drive_point: int
    channel: MeasuredChannel
    amplitudes: FloatArray
    frequency_hz: float
    others: tuple[MeasuredChannel, ...] = ()
    resting_points: tuple[int, ...] = ()

    @property
    def channels(self) -> tuple[MeasuredChannel, ...]:
        """All channels, in the order of the observables."""
        return (self.channel, *self.others)
