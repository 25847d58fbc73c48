"""Settings of the phase-locked loop, one frozen object for loop, node and documentation."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Any

from nmt_core.errors import BenchError
from nmt_core.messages.linear_description import LinearDescription
from nmt_core.nodes.parameters import Parameter

# Settings that may be negative.
SIGNED_SETTINGS = frozenset({"phase_offset_rad", "loop_latency_s"})


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
        voltage_limit: sweep and stepped sine give a level up whose drive would need more, control of harmonics keeps
            drive and harmonics together below it, V; 0 = no limit.
        slew_limit: control of harmonics keeps drive and harmonics together below it, V/s; 0 = no limit.
        phase_offset_rad, loop_latency_s: φ₀ and τ of the phase the loop holds, arg F - arg v = φ₀ + ω τ, instead of 0;
            what a controller does whose channels are not matched in phase or time.
    """

    cutoff: float = 0.0
    harmonics: int = 7
    imaginary_part: float = 0.0
    proportional: float = 0.0
    integral: float = 0.0
    delay_margin: float = 0.25
    start_frequency_hz: float = 0.0
    guard_low: float = 0.4
    guard_high: float = 1.15
    phase_tolerance: float = math.radians(0.2)
    frequency_tolerance: float = 1.0e-4
    amplitude_tolerance: float = 2.0e-3
    scatter_limit: float = math.radians(10.0)
    dwell_periods: float = 10.0
    unlock_tolerance: float = math.radians(10.0)
    force_floor: float = 1.0e-4
    response_floor: float = 0.0
    latency_blocks: int = 0
    quiet_ramp: float = 0.5
    ramp_delay_periods: float = 0.0
    switch_off_periods: float = 1.0
    voltage_limit: float = 0.0
    slew_limit: float = 0.0
    phase_offset_rad: float = 0.0
    loop_latency_s: float = 0.0

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


_DESCRIPTIONS = {
    "cutoff": ("rad/s", "Cut-off of the adaptive filter; 0 = 0.15 of the target mode's frequency."),
    "harmonics": ("", "Harmonics the filter tracks besides the mean."),
    "imaginary_part": ("", "Imaginary part of the closed-form gains; 0 is the conservative choice."),
    "proportional": ("1/s", "Fixed proportional gain; 0 = closed form, scheduled with the measured damping."),
    "integral": ("1/s^2", "Fixed integral gain; 0 = as above."),
    "delay_margin": ("rad", "Largest closed-loop bandwidth times dead time."),
    "start_frequency_hz": ("Hz", "First frequency; 0 = linear frequency of the target mode."),
    "guard_low": ("", "Lower end of the guard band as a factor of the linear frequency."),
    "guard_high": ("", "Upper end of the guard band as a factor of the linear frequency."),
    "phase_tolerance": ("rad", "Largest mean phase error at lock."),
    "frequency_tolerance": ("", "Largest relative drift of the frequency over the dwell at lock."),
    "amplitude_tolerance": ("", "Largest relative drift of the response amplitude over the dwell at lock."),
    "scatter_limit": ("rad", "Largest standard deviation of the phase error at lock."),
    "dwell_periods": ("periods", "Time over which the lock criteria must hold."),
    "unlock_tolerance": ("rad", "Mean phase error over the dwell that ends a lock."),
    "force_floor": ("N", "Smallest force amplitude with a valid phase."),
    "response_floor": ("m or m/s^2", "Smallest response amplitude with a valid phase."),
    "latency_blocks": ("blocks", "Buffering between command and excitation."),
    "quiet_ramp": ("s", "Half-cosine to zero after a lost lock."),
    "ramp_delay_periods": ("periods", "Windows during the ramp so long after a level begins; 0 = after lock."),
    "switch_off_periods": ("periods", "Ring-down: half-cosine of the voltage to zero; at most 1."),
    "voltage_limit": ("V", "Sweep and stepped sine give a level up that would need more; 0 = no limit."),
    "slew_limit": ("V/s", "Control of harmonics keeps drive and harmonics below it; 0 = no limit."),
    "phase_offset_rad": ("rad", "Phase by which the held force leads the velocity; 0 = phase resonance."),
    "loop_latency_s": ("s", "Time by which the held force leads the velocity, besides the phase offset."),
}


def setting_parameters() -> tuple[Parameter, ...]:
    """The settings as node parameters; names, types and defaults are those of :class:`LoopSettings`."""
    return tuple(
        Parameter(
            item.name,
            item.default,  # type: ignore[arg-type]
            *_DESCRIPTIONS[item.name],
            low=None if item.name in SIGNED_SETTINGS else 0.0,
        )
        for item in fields(LoopSettings)
    )


def settings_from(values: dict[str, Any]) -> LoopSettings:
    """Settings from a mapping.

    Raises:
        BenchError: unknown name or a value that :class:`LoopSettings` refuses.
    """
    known = {item.name for item in fields(LoopSettings)}
    for name in values:
        if name not in known:
            raise BenchError(f"PLL setting '{name}' is not known; known are {', '.join(sorted(known))}.")
    return LoopSettings(**values)
