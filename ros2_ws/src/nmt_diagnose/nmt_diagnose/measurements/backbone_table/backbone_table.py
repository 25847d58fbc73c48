"""Backbones that someone else has reduced."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

from nmt_core.numerics.arrays import FloatArray
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.measurements.measurement import Driven


@dataclass(frozen=True)
class BackboneTable(Driven):
    """A backbone reduced by someone else: frequency (and damping ratio) over response amplitude at the drive point.

    Attributes:
        name: unique name.
        drive_point: measurement point of the exciter.
        channel: response channel of the amplitudes.
        amplitudes: shape (k,).
        noise_degrees: degrees of freedom of the variance that the noise of frequencies was estimated as; infinite where
            it is stated.
    """

    WORDS: ClassVar[str] = "backbone table"

    name: str
    drive_point: int
    channel: MeasuredChannel
    amplitudes: FloatArray
    noise_degrees: float = math.inf

    @property
    def channels(self) -> tuple[MeasuredChannel, ...]:
        """The channel of the amplitudes."""
        return (self.channel,)
