"""Settings of the paper's phase-locked loop, as node parameters and as one frozen object."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace

from nmt_core.errors import BenchError
from nmt_core.messages.linear_description import LinearDescription
from nmt_core.settings import setting
from nmt_pll.loop_settings import SIGNED_SETTINGS, LoopSettings


@dataclass(frozen=True)
class PaperSettings:
    """Published parameters of the paper's loop (appendix) and the rule for waiting; the structure is
    inferred.

    Attributes:
        gain: K, rad/s. 2π for the joint of 8 kN/m, 30π for stiffer ones, 20π in the paper's experiment.
        pole: a of the low-pass 1/(s + a), rad/s.
        zero: b of the controller K (s + b)/s, rad/s.
        centre_frequency_hz: ω_m / 2π, where the oscillator starts and is centred, Hz; 0 = linear frequency of
            the target mode.
        closing_time: for which the first level's frequency is held after its ramp, s.
        waiting_time: from the start of a level to its window, s.
        dwell_periods: last part of the waiting time over which the phase error is averaged, periods.
        phase_tolerance: largest mean phase error at which lock is reported, rad.
        scatter_limit: largest standard deviation of the phase error at lock, rad.
        unlock_tolerance: mean phase error over the dwell that ends a lock, rad.
        force_floor: smallest force amplitude with a valid phase, N.
        response_floor: smallest response amplitude with a valid phase, unit of the response.
        quiet_ramp: half-cosine to zero after a lost lock, s.
        phase_offset_rad, loop_latency_s: φ₀ and τ of the phase the loop holds, arg F - arg v = φ₀ + ω τ.
    """

    gain: float = setting(2.0 * math.pi, "K of the paper's loop.", unit="rad/s", low=0.0)
    pole: float = setting(2.0 * math.pi, "a of its low-pass 1/(s + a).", unit="rad/s", low=0.0)
    zero: float = setting(math.pi, "b of its controller K (s + b)/s.", unit="rad/s", low=0.0)
    centre_frequency_hz: float = setting(
        0.0, "Centre of its oscillator; 0 = linear frequency of the target mode.", unit="Hz", low=0.0
    )
    closing_time: float = setting(1.0, "Hold of the first frequency before the loop closes.", unit="s", low=0.0)
    waiting_time: float = setting(11.0, "From the start of a level to its window.", unit="s", low=0.0)
    dwell_periods: float = setting(
        20.0, "End of the waiting time over which the phase error is averaged.", unit="periods", low=0.0
    )
    phase_tolerance: float = setting(
        math.radians(1.0), "Largest mean phase error at which it reports lock.", unit="rad", low=0.0
    )
    unlock_tolerance: float = setting(math.radians(10.0), "Mean phase error that ends a lock.", unit="rad", low=0.0)
    scatter_limit: float = math.radians(10.0)
    force_floor: float = 1.0e-4
    response_floor: float = 0.0
    quiet_ramp: float = 0.5
    phase_offset_rad: float = 0.0
    loop_latency_s: float = 0.0

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            if item.name in SIGNED_SETTINGS:
                if not math.isfinite(value):
                    raise BenchError(f"Setting '{item.name}' of the paper's loop must be finite, got {value}.")
            elif not math.isfinite(value) or value < 0:
                raise BenchError(
                    f"Setting '{item.name}' of the paper's loop must be finite and not negative, got {value}."
                )
        for name in (
            "gain",
            "pole",
            "zero",
            "dwell_periods",
            "phase_tolerance",
            "scatter_limit",
            "unlock_tolerance",
        ):
            if getattr(self, name) <= 0:
                raise BenchError(f"Setting '{name}' of the paper's loop must be positive.")

    def combined_with(self, loop: LoopSettings) -> PaperSettings:
        """These settings with the floors, the ramp and the held phase of the adaptive loop, which both loops share."""
        return replace(self, **{name: getattr(loop, name) for name in _SHARED})

    def held_lead(self, angular_frequency: float) -> float:
        """Phase by which force leads velocity where the loop rests, rad, at ω in rad/s."""
        return self.phase_offset_rad + angular_frequency * self.loop_latency_s

    def centre_frequency(self, linear: LinearDescription) -> float:
        """ω_m in rad/s."""
        return 2.0 * math.pi * self.centre_frequency_hz or linear.frequencies_rad_s[linear.target_mode]


_SHARED = ("scatter_limit", "force_floor", "response_floor", "quiet_ramp", "phase_offset_rad", "loop_latency_s")
