"""Control laws for a structure that feeds its own motion, in the frame of the response.

Amplitude a and phase of the motion obey, averaged over a period,

    ȧ / a = -σ(a) + u,    u = φ² F_r / (2 ω a),

with σ = δ̃ ω̃ of structure and exciter, of either sign, φ the target mode at the drive point and F_r the force in phase
with the velocity. So u (1/s), the rate at which the force makes the motion grow, is what the laws give: a force in
proportion to the velocity. The force at right angles to the velocity only shifts the frequency, and is brought to zero.

A law may use a share of the rate 1/τ, τ the dead time from a measured phasor to the force that answers it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from nmt_core.errors import BenchError
from nmt_core.messages.linear_description import LinearDescription
from nmt_pll.thresholds import SELF_EXCITED


@dataclass(frozen=True, slots=True)
class SelfExcitedPlant:
    """What the laws need to know of structure and exciter.

    Attributes:
        omega: of the target mode, rad/s.
        rate_per_force: φ²/(2 ω), 1/s for a force of 1 N at a displacement of 1 m, moving mass of the exciter included.
        force_per_volt: of an exciter whose table is held, N/V.
        growth: -σ at rest, of structure and exciter, 1/s.
        dead_time: τ, s.
    """

    omega: float
    rate_per_force: float
    force_per_volt: float
    growth: float
    dead_time: float

    @classmethod
    def of(cls, linear: LinearDescription, dead_time: float) -> SelfExcitedPlant:
        """From a linear description.

        At resonance the force is that of a held table times δ_s/δ_p, the decay of the structure over that of structure
        and exciter.

        Raises:
            BenchError: the description does not say what force a volt gives, or the structure's decay is zero.
        """
        omega = linear.frequencies_rad_s[linear.target_mode]
        decay = linear.damping_ratios[linear.target_mode] * omega
        mass_ratio = linear.drive_point_shape**2 * linear.moving_mass_kg
        together = linear.plant_damping_ratio * linear.plant_frequency_rad_s * (1.0 + mass_ratio)
        force = abs(linear.force_per_volt * together / decay) if decay else math.nan
        if not 0.0 < force < math.inf or not linear.drive_point_shape:
            raise BenchError(
                "A self-excited test needs force per volt, damping ratios that are not zero and the shape at the drive "
                "point; complete the linear description."
            )
        gain = linear.drive_point_shape**2 / (2.0 * omega * (1.0 + mass_ratio))
        return cls(omega, gain, force, -together / (1.0 + mass_ratio), dead_time)

    @property
    def holds_amplitude(self) -> bool:
        """Whether a motion that grows at rest as fast as this one can be held at an amplitude through the dead time."""
        return self.growth * self.dead_time <= SELF_EXCITED.held_growth

    @property
    def damping_rate(self) -> float:
        """Rate u of damping feedback, 1/s, negative: what it takes away and the growth at rest next to it."""
        return (
            -min(
                SELF_EXCITED.amplitude_rate + max(self.growth * self.dead_time, 0.0), SELF_EXCITED.largest_damping_rate
            )
            / self.dead_time
        )

    @property
    def tracking_rate(self) -> float:
        """Rate at which the oscillator follows the phase of the response, 1/s."""
        return SELF_EXCITED.phase_tracking_rate / self.dead_time

    @property
    def quadrature_rate(self) -> float:
        """Rate at which the force at right angles to the velocity is taken back, 1/s."""
        return SELF_EXCITED.quadrature_rate / self.dead_time


class AmplitudeLaw:
    """Rate u that brings the amplitude to a target: u = r + k ln(target / a), ṙ = k² / 4 ln(target / a).

    The integral r is a velocity feedback; the proportional part keeps amplitudes that would run away. Without it, what
    is left is velocity feedback alone, whose gain is adapted slowly: it settles only where the damping ratio grows with
    the amplitude, and bears more dead time.

    Args:
        plant: of the loop.
        proportional: False for velocity feedback alone.

    Attributes:
        rate: k of the law with the proportional part, 1/s.
        feedback: r, 1/s.
    """

    def __init__(self, plant: SelfExcitedPlant, proportional: bool = True) -> None:
        rate = SELF_EXCITED.amplitude_rate / plant.dead_time
        self.rate = rate
        self._rate = rate if proportional else 0.0
        slow = SELF_EXCITED.feedback_adaption_rate / plant.dead_time
        self._integral = SELF_EXCITED.integral_rate_ratio * rate**2 if proportional else 0.25 * slow**2
        self._bounds = (
            -SELF_EXCITED.largest_damping_rate / plant.dead_time,
            SELF_EXCITED.largest_feeding_rate / plant.dead_time,
        )
        self.feedback = 0.0

    def reset(self, feedback: float = 0.0) -> None:
        """Begin with a velocity feedback, 1/s."""
        self.feedback = feedback

    def update(self, amplitude: float, target: float, duration: float, free: bool = True) -> float:
        """Rate u (1/s) for the next block.

        Args:
            amplitude, target: of the response, positive.
            duration: s, of a block.
            free: whether the drive could give what was asked for last; else the integral waits.
        """
        error = math.log(target / amplitude)
        low, high = self._bounds
        if free and low < self.feedback + self._rate * error < high:
            self.feedback += (
                self._integral
                * min(max(error, -SELF_EXCITED.largest_integrated_log_error), SELF_EXCITED.largest_integrated_log_error)
                * duration
            )
        return min(max(self.feedback + self._rate * error, low), high)
