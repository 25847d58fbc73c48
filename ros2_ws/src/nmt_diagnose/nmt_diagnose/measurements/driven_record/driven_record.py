"""Records of any excitation."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from nmt_core.numerics.arrays import FloatArray
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.measurements.measurement import Driven


@dataclass(frozen=True)
class DrivenRecord(Driven):
    """Any excitation: the model is driven by the measured input.

    Attributes:
        name: unique name.
        drive_point: measurement point of the exciter.
        sample_rate: of the input, Hz: that of the recording or a whole multiple of it, so fine that the input may be
            taken as straight from sample to sample.
        input_channel: measured input (voltage, or force).
        input: samples as they were recorded, shape (n,), V or N.
        channels: response channels, in the order of the observables.
        segment_bounds: first input sample of each scored segment and the end of the last, shape (segments + 1,).
        start_s: time of the first sample on the clock of its bag, s: an observable of time t is sample
            (t − start_s) · sample_rate of the input.
        zeros: standard deviation of the zero of the input and of each channel, shape (1 + channels,), in their units;
            empty = they have none. The observables are without the mean of their channel, which is part of its zero.
        limits: magnitude at which the samples of each channel stay again and again, shape (channels,), in their units;
            0 = nowhere; empty = not looked at.
        head: first samples of the channels, without the same mean, shape (channels, h); empty = it begins at rest.
        head_stride: samples of the input from one of these to the next.
        begins_in_motion: whether the model may not start at rest.
    """

    WORDS: ClassVar[str] = "record, driven by the measured input"

    name: str
    drive_point: int
    sample_rate: float
    input_channel: MeasuredChannel
    input: FloatArray
    channels: tuple[MeasuredChannel, ...]
    segment_bounds: FloatArray
    start_s: float = 0.0
    zeros: FloatArray = field(default_factory=lambda: np.zeros(0))
    limits: FloatArray = field(default_factory=lambda: np.zeros(0))
    head: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    head_stride: int = 1
    begins_in_motion: bool = False
