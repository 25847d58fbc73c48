"""One record for each small message of the bench; fields, units and the meaning of NaN as in ``nmt_msgs``.

Blocks of samples are in :mod:`nmt_core.messages.blocks`, modal points in :mod:`nmt_core.messages.modal_point`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from nmt_core.vocabulary import (
    OutputState,
    RecordKind,
    ResultCode,
    RunPhase,
    SteeringAct,
    StopCause,
    TestKind,
    Waveform,
)


class DriveTerm(NamedTuple):
    """A term of a periodic drive next to its fundamental at exciter 1; ``nmt_msgs/Drive``.

    Attributes:
        exciter: which exciter, from 1.
        order: harmonic number n, from 1.
        value: complex amplitude of Re value exp(i n θ): over the drive's amplitude, or V.
        relative: whether it is over the drive's amplitude, which it then follows; else V, of exciter 1 only.
    """

    exciter: int
    order: int
    value: complex
    relative: bool = True


class DriveCommand(NamedTuple):
    """What the oscillator shall do; ``nmt_msgs/Drive``.

    Attributes:
        waveform: OFF, SINE, RANDOM or SWEEP.
        frequency_hz: Hz, positive for SINE and SWEEP.
        amplitude: V peak (SINE, SWEEP), V rms (RANDOM).
        ramp: s, half-cosine from the present amplitude; 0 = at once. The same amplitude again does not
            restart it.
        apply_at_sample: first block that starts at or after this sample; 0 = next block.
        based_on_sample: last sample the command was computed from.
        band_low_hz, band_high_hz: band edges of RANDOM.
        rate_hz_s, frequency_end_hz: rate of SWEEP and where it holds.
        terms: what every exciter gets next to the fundamental at exciter 1. An absolute term of order 1 turns the
            fundamental and changes its size. Of RANDOM rms over the amplitude, each exciter with a noise of its own.
    """

    waveform: Waveform
    frequency_hz: float = 0.0
    amplitude: float = 0.0
    ramp: float = 0.0
    apply_at_sample: int = 0
    based_on_sample: int = 0
    band_low_hz: float = 0.0
    band_high_hz: float = 0.0
    rate_hz_s: float = 0.0
    frequency_end_hz: float = 0.0
    terms: tuple[DriveTerm, ...] = ()


class LoopStatus(NamedTuple):
    """State of the loop after a block; ``nmt_msgs/Frequency``."""

    last_sample: int
    level_index: int
    level_sequence: int
    state: int
    frequency_hz: float
    phase_error: float
    force_amplitude: float
    response_amplitude: float
    response_unit: str
    drive_amplitude: float
    flags: int = 0
    reason: str = ""


@dataclass(frozen=True, slots=True)
class LevelCommand:
    """One level for the loop to work on; ``nmt_msgs/Level``.

    ``amplitude`` of a RANDOM test is the rms of the voltage (V); ``duration`` (s) is the length of its window, of
    RING_DOWN that of the free decay; ``frequency_hz`` is the start of a SWEEP that goes to ``frequency_end_hz``.
    ``control`` is a :class:`~nmt_core.vocabulary.ControlKind`, or a number that the loop refuses; harmonics 2 to
    ``harmonics_control`` of the force are controlled (0 = none, 1 = as many as can be), ``harmonics_target`` is a
    :class:`~nmt_core.vocabulary.HarmonicsTarget`. ``response_order`` and ``force_order`` say which secondary resonance
    (:mod:`nmt_core.messages.secondary_resonance`), ``release`` is the response amplitude of its release (0 = none).
    ``held_phase`` is the phase by which the force leads the velocity of the drive point where the phase loop holds it,
    rad (0 = phase resonance). ``perturbation`` is the rms of a multisine that changes the drive within the window, over
    its amplitude (0 = none). ``parameter`` is a :class:`~nmt_core.vocabulary.CurveParameter`: what a point of a
    response curve is held by; SECANT holds the phase plus ``phase_per_response`` ln(response / ``held_response``), rad.
    """

    sequence: int
    index: int
    amplitude: float
    apply_at_sample: int
    ramp: float
    control: int = 1
    frequency_hz: float = 0.0
    window_periods: int = 0
    timeout: float = 0.0
    test: TestKind = TestKind.PHASE_RESONANCE
    band_low_hz: float = 0.0
    band_high_hz: float = 0.0
    rate_hz_s: float = 0.0
    frequency_end_hz: float = 0.0
    duration: float = 0.0
    harmonics_control: int = 0
    harmonics_target: int = 0
    response_order: int = 0
    force_order: int = 0
    release: float = 0.0
    held_phase: float = 0.0
    perturbation: float = 0.0
    held_response: float = 0.0
    phase_per_response: float = 0.0
    parameter: int = 0


@dataclass(frozen=True, slots=True)
class LockEvent:
    """The loop is locked; these samples are to be captured and extracted; ``nmt_msgs/LockEvent``.

    Attributes:
        level_index: level number in the plan, from 0.
        level: the level's target amplitude, in ``level_unit``.
        level_unit: V, N, m or m/s^2.
        sample: sample at which lock was confirmed.
        frequency_hz: commanded frequency at the lock, Hz; NaN if not known (imported data).
        phase_error: rad, at the lock; NaN if not known.
        window_first_sample: first sample of the window.
        window_samples: number of samples of the window.
        window_periods: whole excitation periods in the window; 0 = as many as the samples hold.
        test: kind of test.
        time_ns: bench time of ``sample``, ns.
        response_order, force_order: k and ν of a secondary resonance; 0 = none.
        held_phase: phase by which the held force leads the velocity of the drive point, rad.
        perturbation: rms of the multisine that changes the drive within the window, over its amplitude; 0 = none.
        parameter: what is held next to the amplitude, a :class:`~nmt_core.vocabulary.CurveParameter`.
    """

    level_index: int
    level: float
    level_unit: str
    sample: int
    frequency_hz: float
    phase_error: float
    window_first_sample: int
    window_samples: int
    window_periods: int
    test: TestKind = TestKind.PHASE_RESONANCE
    time_ns: int = 0
    response_order: int = 0
    force_order: int = 0
    held_phase: float = 0.0
    perturbation: float = 0.0
    parameter: int = 0

    @property
    def window_end(self) -> int:
        """Index of the sample after the window."""
        return self.window_first_sample + self.window_samples


@dataclass(frozen=True, slots=True)
class RunState:
    """State of a run; ``nmt_msgs/RunState``.

    Attributes:
        run_id: empty = no run yet.
        phase: of the run.
        level_index, level_count: present level, from 0, and levels in the plan.
        level: target amplitude of the present level.
        progress: fraction of the plan done, 0..1.
        sample: newest sample the sequencer has seen.
        horizon_sample: a plant in lockstep produces no sample at or beyond this one.
        result_code: UNKNOWN while running.
        reason: why the run ended or paused; empty while running.
        time_ns: bench time of ``sample``, ns.
    """

    run_id: str
    phase: RunPhase
    level_index: int
    level_count: int
    level: float
    progress: float
    sample: int
    horizon_sample: int
    result_code: ResultCode
    reason: str
    time_ns: int = 0


@dataclass(frozen=True, slots=True)
class Steering:
    """An act of steering, taken into a run or refused when its time came; ``nmt_msgs/Steering``.

    Attributes:
        sequence: counts the acts of a run from 1.
        run_id: run that was steered.
        act: what was asked for.
        level_index: level it is about, from 0.
        sample: first sample after those that were known when it was decided.
        apply_at_sample: samples before this one are not affected by it.
        taken: False if it came too late and changed nothing.
        levels: levels of the whole plan after the act, in the unit of the plan's control.
        frequencies_hz: one per level, Hz; empty = the plan gives none.
        source: who asked.
        reason: why it was not taken; empty if it was.
        time_ns: bench time of ``sample``, ns.
    """

    sequence: int
    run_id: str
    act: SteeringAct
    level_index: int
    sample: int
    apply_at_sample: int
    taken: bool
    levels: tuple[float, ...]
    frequencies_hz: tuple[float, ...]
    source: str
    reason: str
    time_ns: int = 0


@dataclass(frozen=True, slots=True)
class DriveStop:
    """A stop of the drive, its arrival at zero, or its release; ``nmt_msgs/DriveStop``.

    Attributes:
        sample: first sample of the next block when this was said.
        cause: what stopped the drive; RELEASED: it is not stopped any more.
        output: what the output does as far as the plant knows.
        reason: one sentence; empty for RELEASED.
        time_ns: bench time of ``sample``, ns.
    """

    sample: int
    cause: StopCause
    output: OutputState
    reason: str = ""
    time_ns: int = 0


@dataclass(frozen=True, slots=True)
class SignalLevels:
    """Levels of the signals over a tenth of a second; ``nmt_msgs/Monitor``.

    Attributes:
        last_sample: last of the samples that the numbers are about.
        frequency_hz: of the excitation, Hz; 0 = none, NaN = not known.
        drive_point: peak and rms at the drive point for each quantity from FORCE on; NaN where the rig has none.
        channels: names of all channels, separated by commas, in the order of the quantities.
        peak: largest magnitude of each channel in its unit.
        rms: of each channel in its unit.
        flags: of all blocks that the numbers are about, see :class:`nmt_core.messages.blocks.BlockFlag`.
        time_ns: bench time of ``last_sample``, ns.
    """

    last_sample: int
    frequency_hz: float
    drive_point: tuple[tuple[float, float], ...]
    channels: str
    peak: tuple[float, ...]
    rms: tuple[float, ...]
    flags: int = 0
    time_ns: int = 0


@dataclass(frozen=True, slots=True)
class RunRecord:
    """Start or stop record of a run; ``nmt_msgs/RunRecord``.

    Attributes:
        kind: START or STOP.
        run_json: run id, plan, parameters, versions; the stop record adds exit status and counts.
        rig_yaml: the rig file as used; empty in the stop record.
        time_ns: bench time, ns; 0 = before the first sample.
    """

    kind: RecordKind
    run_json: str
    rig_yaml: str = ""
    time_ns: int = 0
