"""One locked window as a level of its run."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeAlias

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
