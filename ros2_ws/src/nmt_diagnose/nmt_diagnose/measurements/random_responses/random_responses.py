"""Frequency responses of a low-level random test."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

from nmt_core.numerics.arrays import FloatArray
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.measurements.measurement import Driven


@dataclass(frozen=True)
class RandomResponses(Driven):
    """Frequency responses of a low-level random test, referred to the voltage (or, without one, to the force).

    Attributes:
        name: unique name.
        drive_point: measurement point of the exciter.
        channels: response channels, in the order of the observables.
        reference: ``voltage`` or ``force``.
        lines_hz: frequency lines that became observables, Hz, shape (lines,).
        resolution_hz: spacing of the lines of the estimator, Hz.
        window: ``none``: the expected estimate is the response at the line itself;
            ``hann``: the expected estimate at a line is the response averaged over the neighbouring lines with the
            weights of |W|² (1/6, 2/3, 1/6 in spacings of ``resolution_hz``).
        drive_rms: rms of the reference, V or N.
        start_s, stop_s: on the clock of its bag, s.
        drive_hold_hz: rate at which the drive went straight from sample to sample, Hz; infinite where it did not. The
            observables are responses to the samples of the drive then: smaller by sinc², and with images of the drive
            around multiples of that rate.
        resting_points: measurement points of further exciters, whose drive is taken out of the responses.
        other_rms: rms of their drive, which moves the structure too, V; empty = nothing.
    """

    WORDS: ClassVar[str] = "random, frequency response"

    name: str
    drive_point: int
    channels: tuple[MeasuredChannel, ...]
    reference: str
    lines_hz: FloatArray
    resolution_hz: float
    window: str
    drive_rms: float
    start_s: float
    stop_s: float
    drive_hold_hz: float = math.inf
    resting_points: tuple[int, ...] = ()
    other_rms: tuple[float, ...] = ()
