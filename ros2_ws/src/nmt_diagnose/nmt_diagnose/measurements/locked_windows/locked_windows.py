"""Locked windows of a run at phase resonance."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, TypeAlias

from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.measurements.measurement import Measurement

Terms: TypeAlias = tuple[tuple[complex, ...], ...]
"""Orders 1, 2, … of the drive of each exciter over the fundamental of the first."""

PURE_TONE: Terms = ((1.0 + 0.0j,),)
"""Terms of a sine at one exciter."""


@dataclass(frozen=True)
class LockedLevel:
    """One locked window.

    Attributes:
        index: level number in its plan.
        drive: fundamental of the drive voltage at the first exciter, V peak; its phase is the zero of all phases. NaN
            where it is not known.
        phase_error: measured arg F₁ − arg(iωψ_k,1) at the drive point, rad: where the loop stood; an input of the
            model.
        phase_error_std: its standard uncertainty, rad.
        frequency_hz: measured excitation frequency, Hz (start of the solution).
        start_s, stop_s: window on the clock of its bag, s.
        cycles_before: excitation periods since the start of the bag until the middle of the window.
        direction: +1 while the level rises, −1 while it falls.
        force_n: measured |F₁|, N: the given amplitude where the force is held.
        phase_lean: how far the loop may still have been off because it had not settled, rad.
        terms: what drove the structure, voltage of each exciter, or its force where that is held.
        amplitude_leans: of each channel of the test, how far its amplitude may still be from where it would have
            settled, its transient taken out, relative; empty = nowhere.
        fundamentals: |Y₁| of each channel of the test, in its unit; empty = not known.
    """

    index: int
    drive: float
    phase_error: float
    phase_error_std: float
    frequency_hz: float
    start_s: float
    stop_s: float
    cycles_before: float
    direction: int
    force_n: float = math.nan
    phase_lean: float = 0.0
    terms: Terms = PURE_TONE
    amplitude_leans: tuple[float, ...] = ()
    fundamentals: tuple[float, ...] = ()


@dataclass(frozen=True)
class LockedWindows(Measurement):
    """Locked windows of one run.

    Attributes:
        name: unique name of the test.
        drive_points: measurement point of each exciter; phase and amplitude of all refer to the first.
        response_channel: channel whose phase the loop controlled.
        channels: all recorded channels with harmonics.
        harmonics: highest order among the observables.
        held: ``voltage`` (drive known), or ``force`` (drive unknown, |F₁| taken as the given amplitude; the zero of all
            phases is then that of the measured F₁).
        levels: the windows, in time.
        commanded: the drive is the commanded voltage; else the recorded one.
    """

    WORDS: ClassVar[str] = "phase resonance, locked levels"

    name: str
    drive_points: tuple[int, ...]
    response_channel: str
    channels: tuple[MeasuredChannel, ...]
    harmonics: int
    held: str
    levels: tuple[LockedLevel, ...]
    commanded: bool = False

    @property
    def drive_point(self) -> int:
        """Point at which the loop holds its phase."""
        return self.drive_points[0]
