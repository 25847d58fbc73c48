"""Frequency responses at held amplitudes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.measurements.measurement import Driven


@dataclass(frozen=True)
class SteppedResponses(Driven):
    """Frequency responses at an amplitude that was held while the frequency was stepped.

    Attributes:
        name: unique name.
        drive_point: measurement point of the exciter.
        channels: response channels, in the order of the observables; the first is the one whose amplitude the model is
            given.
        reference: what the responses are divided by: ``force``, ``base`` (acceleration of a shaking table) or
            ``voltage``.
        held: what had the given amplitude: ``force``, ``base``, ``voltage``, or ``response`` (the first channel).
        lines_hz: frequencies that became observables, Hz, ascending, shape (lines,).
        levels: amplitude of what was held at each line, in its SI unit, shape (lines,).
        measured: measured responses, shape (lines, channels): they say how large the motion was and on which branch.
        noise: relative standard uncertainty of each line's magnitude and phase (rad), shape (lines,).
        direction: +1 while the frequency rose, −1 while it fell, 0 where it is not known.
        growth: ∂ ln R / ∂ ln s of the reference R over the first channel's amplitude s, by which an error of s counts,
            shape (lines,); None = 1, that of a linear rig.
        moved: ln of the amplitude about which an error of s counts to first order, over the measured one, shape
            (lines,); None = 0.
        scale: true over recorded amplitude of the first channel.
        noise_degrees: degrees of freedom of the variance that the noise was estimated as; infinite where it is stated.
        phase_known: whether the responses have a phase; else they are magnitudes, and no observable is a phase.
        imposed: whether the motion of the drive point was a sine, and the force what it takes; else the force was one.
    """

    WORDS: ClassVar[str] = "frequency response at a held amplitude"

    name: str
    drive_point: int
    channels: tuple[MeasuredChannel, ...]
    reference: str
    held: str
    lines_hz: FloatArray
    levels: FloatArray
    measured: ComplexArray
    noise: FloatArray
    direction: int = 0
    growth: ComplexArray | None = None
    moved: FloatArray | None = None
    scale: float = 1.0
    noise_degrees: float = math.inf
    phase_known: bool = True
    imposed: bool = False

    @property
    def amplitudes(self) -> FloatArray:
        """Amplitude of the first channel at each line, in its unit; NaN where only the voltage is known, (lines,)."""
        if self.held == "response":
            return self.levels
        if self.held == self.reference:
            return np.asarray(np.abs(self.measured[:, 0]) * self.levels, dtype=np.float64)
        return np.full(self.levels.shape, math.nan)
