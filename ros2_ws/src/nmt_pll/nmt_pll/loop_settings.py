"""Settings of the phase-locked loop, one frozen object for loop, node and documentation."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

from nmt_core.errors import BenchError
from nmt_core.messages.linear_description import LinearDescription
from nmt_core.settings import parameters_of, setting


@dataclass(frozen=True)
class LoopSettings:
    """How the loop detects phase, controls frequency and judges lock. Zero where noted means "derive from the rig".

    Attributes:
        cutoff: ω_LP of the adaptive filter, rad/s; 0 = 0.15 of the target mode's frequency.
        harmonics: harmonics the filter tracks besides the mean.
        imaginary_part: λ_I of the closed-form gains; 0 is the conservative choice.
        proportional, integral: fixed gains k_p (1/s) and k_i (1/s²); 0 = closed form, scheduled with the measured
            damping.
        delay_margin: largest closed-loop bandwidth times dead time, rad.
        start_frequency_hz: first frequency, Hz; 0 = linear frequency of the target mode.
        guard_low, guard_high: frequency band around the target mode, as factors of its linear frequency.
        phase_tolerance: largest mean phase error at lock, rad.
        frequency_tolerance: largest relative drift of the frequency over the dwell, 1.
        amplitude_tolerance: largest relative drift of the response amplitude over the dwell, 1.
        scatter_limit: largest standard deviation of the phase error at lock, rad.
        dwell_periods: periods over which all of these must hold.
        unlock_tolerance: mean phase error over the dwell that ends a lock, rad.
        force_floor: smallest force amplitude with a valid phase, N.
        response_floor: smallest response amplitude with a valid phase, unit of the response.
        latency_blocks: blocks of buffering between command and excitation.
        quiet_ramp: half-cosine to zero after a lost lock, s.
        ramp_delay_periods: a level that follows a locked one opens its window so many periods after it begins, while
            its ramp goes on, without the lock criteria; 0 = wait for them.
        switch_off_periods: RING_DOWN: half-cosine of the voltage to zero, excitation periods; at most one.
        voltage_limit: a level of a controlled amplitude whose drive would need more is given up, control of harmonics
            keeps drive and harmonics together below it, V; 0 = no limit.
        slew_limit: control of harmonics keeps drive and harmonics together below it, V/s; 0 = no limit.
        phase_offset_rad, loop_latency_s: φ₀ and τ of the phase the loop holds, arg F - arg v = φ₀ + ω τ, instead of 0;
            what a controller does whose channels are not matched in phase or time.
        mac_limit, pbmif_limit: with several exciters, least MAC of the response with the linear target mode and least
            generalised PBMIF at lock.
    """

    cutoff: float = setting(
        0.0, "Cut-off of the adaptive filter; 0 = 0.15 of the target mode's frequency.", unit="rad/s", low=0.0
    )
    harmonics: int = setting(7, "Harmonics the filter tracks besides the mean.", low=0.0)
    imaginary_part: float = setting(
        0.0, "Imaginary part of the closed-form gains; 0 is the conservative choice.", low=0.0
    )
    proportional: float = setting(
        0.0, "Fixed proportional gain; 0 = closed form, scheduled with the measured damping.", unit="1/s", low=0.0
    )
    integral: float = setting(0.0, "Fixed integral gain; 0 = as above.", unit="1/s^2", low=0.0)
    delay_margin: float = setting(0.25, "Largest closed-loop bandwidth times dead time.", unit="rad", low=0.0)
    start_frequency_hz: float = setting(
        0.0, "First frequency; 0 = linear frequency of the target mode.", unit="Hz", low=0.0
    )
    guard_low: float = setting(0.4, "Lower end of the guard band as a factor of the linear frequency.", low=0.0)
    guard_high: float = setting(1.15, "Upper end of the guard band as a factor of the linear frequency.", low=0.0)
    phase_tolerance: float = setting(math.radians(0.2), "Largest mean phase error at lock.", unit="rad", low=0.0)
    frequency_tolerance: float = setting(
        1.0e-4, "Largest relative drift of the frequency over the dwell at lock.", low=0.0
    )
    amplitude_tolerance: float = setting(
        2.0e-3, "Largest relative drift of the response amplitude over the dwell at lock.", low=0.0
    )
    scatter_limit: float = setting(
        math.radians(10.0), "Largest standard deviation of the phase error at lock.", unit="rad", low=0.0
    )
    dwell_periods: float = setting(10.0, "Time over which the lock criteria must hold.", unit="periods", low=0.0)
    unlock_tolerance: float = setting(
        math.radians(10.0), "Mean phase error over the dwell that ends a lock.", unit="rad", low=0.0
    )
    force_floor: float = setting(1.0e-4, "Smallest force amplitude with a valid phase.", unit="N", low=0.0)
    response_floor: float = setting(0.0, "Smallest response amplitude with a valid phase.", unit="m or m/s^2", low=0.0)
    latency_blocks: int = setting(0, "Buffering between command and excitation.", unit="blocks", low=0.0)
    quiet_ramp: float = setting(0.5, "Half-cosine to zero after a lost lock.", unit="s", low=0.0)
    ramp_delay_periods: float = setting(
        0.0, "Windows during the ramp begin so long after the level; 0 = after lock.", unit="periods", low=0.0
    )
    switch_off_periods: float = setting(
        1.0, "Ring-down: half-cosine of the voltage to zero; at most 1.", unit="periods", low=0.0
    )
    voltage_limit: float = setting(
        0.0, "Levels of controlled amplitude beyond it are given up; 0 = none.", unit="V", low=0.0
    )
    slew_limit: float = setting(0.0, "Bound of drive and harmonics; 0 = none.", unit="V/s", low=0.0)
    phase_offset_rad: float = setting(0.0, "Phase lead of the force over the velocity.", unit="rad")
    loop_latency_s: float = setting(0.0, "Time lead of the force over the velocity.", unit="s")
    mac_limit: float = setting(0.8, "Several exciters: least MAC with the target mode at lock.", low=0.0)
    pbmif_limit: float = setting(0.9, "Several exciters: least generalised PBMIF at lock; at most 1.", low=0.0)

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            if item.name in SIGNED_SETTINGS:
                if not math.isfinite(value):
                    raise BenchError(f"PLL setting '{item.name}' must be finite, got {value}.")
            elif not math.isfinite(value) or value < 0:
                raise BenchError(f"PLL setting '{item.name}' must be finite and not negative, got {value}.")
        if not self.guard_low < 1.0 < self.guard_high:
            raise BenchError("The PLL's guard band must contain the target mode: guard_low < 1 < guard_high.")
        for name in ("phase_tolerance", "dwell_periods", "unlock_tolerance", "quiet_ramp", "delay_margin"):
            if getattr(self, name) <= 0:
                raise BenchError(f"PLL setting '{name}' must be positive.")
        for name in ("mac_limit", "pbmif_limit"):
            if getattr(self, name) > 1.0:
                raise BenchError(f"PLL setting '{name}' must be at most 1, got {getattr(self, name):g}.")
        if self.switch_off_periods > 1.0:
            raise BenchError(
                f"PLL setting 'switch_off_periods' must be at most 1 period, got {self.switch_off_periods:g}."
            )
        if (self.proportional > 0) != (self.integral > 0):
            raise BenchError("Give both fixed PLL gains, proportional and integral, or none of them.")

    def held_lead(self, angular_frequency: float) -> float:
        """Phase by which force leads velocity where the loop rests, rad, at ω in rad/s."""
        return self.phase_offset_rad + angular_frequency * self.loop_latency_s

    def resolved_cutoff(self, linear: LinearDescription) -> float:
        """ω_LP in rad/s."""
        return self.cutoff or 0.15 * linear.frequencies_rad_s[linear.target_mode]


SIGNED_SETTINGS = frozenset(item.name for item in parameters_of(LoopSettings) if item.low is None)
"""Settings that may be negative."""


def settings_from(values: Mapping[str, Any]) -> LoopSettings:
    """Settings from a mapping.

    Raises:
        BenchError: unknown name or a value that :class:`LoopSettings` refuses.
    """
    known = {item.name for item in fields(LoopSettings)}
    for name in values:
        if name not in known:
            raise BenchError(f"PLL setting '{name}' is not known; known are {', '.join(sorted(known))}.")
    return LoopSettings(**values)
