"""Under which conditions a set of observations was recorded: all that a model needs to predict it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np

from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_core.vocabulary import MOTIONS, ROTATION_UNITS


@dataclass(frozen=True)
class MeasuredChannel:
    """A recorded channel.

    Attributes:
        name: channel name, for example ``f2``, ``x4``, ``a2``, ``u``.
        quantity: what it measures.
        point: measurement point, 0 for voltage and current.
        ideal: it is the motion or force itself, whatever sensors the rig has.
        turns: an angle stands for its displacement, a torque for its force.
    """

    name: str
    quantity: Quantity
    point: int
    ideal: bool = False
    turns: bool = field(default=False, compare=False)

    @property
    def unit(self) -> str:
        """SI unit."""
        return ROTATION_UNITS.get(self.quantity, self.quantity.unit) if self.turns else self.quantity.unit


class Driven:
    """A test that names the point of its exciter, and those of further ones that it sees at rest."""

    drive_point: int
    resting_points: tuple[int, ...] = ()

    @property
    def drive_points(self) -> tuple[int, ...]:
        """Measurement point of each exciter."""
        return (self.drive_point, *self.resting_points)


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
class PhaseResonanceTest:
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


@dataclass(frozen=True)
class RandomTest(Driven):
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


@dataclass(frozen=True)
class SteppedSineTest(Driven):
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


@dataclass(frozen=True)
class RingDownTest(Driven):
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


@dataclass(frozen=True)
class RecordTest(Driven):
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


@dataclass(frozen=True)
class ImposedMotionTest(RecordTest):
    """A record whose motion was imposed: the model is moved as measured, and force and further responses follow.

    The input is the recorded motion of the drive point in its unit; the observables keep their means.

    Attributes:
        motion: displacement, velocity and acceleration of the drive point at the samples of the input, shape (3, n),
            m, m/s, m/s².
        gain_std: relative standard uncertainty of the gain of the motion and of each channel.
        frequency_hz: middle frequency of the motion, rms velocity over rms displacement, Hz.
        size: half of what the displacement spans, m.
        force_n: largest measured force, N.
    """

    motion: FloatArray = field(default_factory=lambda: np.zeros((3, 0)))
    gain_std: float = 0.0
    frequency_hz: float = math.nan
    size: float = math.nan
    force_n: float = math.nan

    def with_zero(self, steps: float) -> FloatArray:
        """The motion with the zero of its sensor off by so many standard deviations, shape (3, n)."""
        order = MOTIONS[self.input_channel.quantity]
        moved = self.motion.copy()
        time = np.arange(self.input.size) / self.sample_rate
        for row in range(order + 1):
            moved[row] += steps * self.zeros[0] * time ** (order - row) / math.factorial(order - row)
        return moved

    def with_gain(self, steps: float) -> FloatArray:
        """The motion larger by so many standard deviations of its gain, shape (3, n)."""
        return self.motion * (1.0 + steps * self.gain_std)


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

    name: str
    drive_point: int
    channel: MeasuredChannel
    amplitudes: FloatArray
    noise_degrees: float = math.inf


Test = PhaseResonanceTest | RandomTest | SteppedSineTest | RingDownTest | RecordTest | BackboneTable
