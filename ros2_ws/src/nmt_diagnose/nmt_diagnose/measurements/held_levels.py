"""Levels of a test: locked windows, and held levels as complex amplitudes of force and motion.

Locked windows, stepped sines, decays and tables all say these.


Each line of a stepped sine is a steady state under a known force: lines about a resonance at several forces are levels.

A decay and a table give frequency and damping ratio over amplitude. They are levels of the fundamental alone at which
the modal force 2iζω²q would act: that of phase resonance, and of a decay to first order in the damping.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TypeAlias

from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.observations.channels.measuring_chain import MeasuringChain

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
class HeldLevels:
    """Levels of one test, ascending motion.

    Attributes:
        name: of the test.
        drive_points: measurement point of each exciter.
        over_base: the force is the acceleration of a base.
        alone: fundamentals alone tell a law, whatever shaker stays attached.
        recorded: channels of the test, where forces are among them.
        numbers: of each level in the plan of the test, (L,).
        omega: angular frequency, rad/s, (L,).
        force: harmonics 0 … H of the measured force of each exciter, N, or of the acceleration of the base, m/s²,
            (E, L, H + 1); order 0 is 0.
        force_std: standard uncertainties of their fundamentals, N, (E, L).
        ratio, ratio_std: damping ratio of each level in the place of the force, and what frequency and damping are
            uncertain by together, (L,); None where the force is measured.
        channels: of the responses, C.
        motion: harmonics of the displacements, m, (L, C, H + 1); order 0 is 0, NaN where a channel was not used.
        motion_std: their standard uncertainties, m, (L, C, H + 1).
        chain: tolerances of the measuring chain; None = it measures as the rig file says.
    """

    name: str
    drive_points: tuple[int, ...]
    numbers: tuple[int, ...]
    omega: FloatArray
    force: ComplexArray
    force_std: FloatArray
    channels: tuple[MeasuredChannel, ...]
    motion: ComplexArray
    motion_std: FloatArray
    chain: MeasuringChain | None
    ratio: FloatArray | None = None
    ratio_std: FloatArray | None = None
    over_base: bool = False
    alone: bool = False
    recorded: tuple[MeasuredChannel, ...] = ()

    @property
    def count(self) -> int:
        """Number of levels L."""
        return int(self.omega.size)

    @property
    def harmonics(self) -> int:
        """Highest order H."""
        return int(self.motion.shape[2]) - 1

    def take(self, kept: list[int]) -> HeldLevels:
        """Some of the levels."""
        return replace(
            self, numbers=tuple(self.numbers[k] for k in kept), omega=self.omega[kept], force=self.force[:, kept],
            force_std=self.force_std[:, kept], motion=self.motion[kept], motion_std=self.motion_std[kept],
            ratio=None if self.ratio is None else self.ratio[kept],
            ratio_std=None if self.ratio_std is None else self.ratio_std[kept],
        )  # fmt: skip
