"""Closed-form gains of the phase controller (Hippold et al. 2024)."""

from __future__ import annotations

from dataclasses import dataclass

from nmt_core.errors import BenchError
from nmt_core.messages.linear_description import LinearDescription
from nmt_pll.thresholds import CURVE


@dataclass(frozen=True, slots=True)
class ControllerGains:
    """Gains of ω = ω_start + k_p ε + k_i ∫ε dt with the phase error ε in rad.

    Attributes:
        proportional: k_p, 1/s.
        integral: k_i, 1/s².
    """

    proportional: float
    integral: float

    def scaled(self, share: float) -> ControllerGains:
        """Gains of a loop that is slower by a factor, with the same shape of its answer."""
        return ControllerGains(share * self.proportional, share**2 * self.integral)

    def on_slope(self, slope: float, decay: float) -> ControllerGains:
        """Gains at a point of a response curve at which the lag answers as (s + δ) / (s² + 2 δ s + D), D = δ dω/dϑ.

        The slow poles are those of (2 δ + k_p) s² + (D + k_p δ + k_i) s + k_i δ. Where the lag hardly moves with the
        frequency (D > 0), the slowest would be −k_i δ / (D + k_p δ + k_i); between the folds (D < 0) they would swing.
        With k_i (1 + |D| / (k_p δ + k_i)) they do neither. Between the folds the plant has less gain at the crossover
        ω = k_p, by 1 + |D| / k_p². Both factors have their bounds in `CURVE`, for filter and dead time.

        Args:
            slope: dω/dϑ of the frequency over the lag at the held amplitude, rad/s a rad.
            decay: δ of the structure, rad/s.
        """
        d = decay * slope
        boost = 1.0 + abs(d) / (self.proportional * decay + self.integral)
        if d >= 0.0:
            return ControllerGains(self.proportional, self.integral * min(boost, CURVE.largest_boost))
        gain = min(1.0 - d / self.proportional**2, CURVE.largest_gain)
        return ControllerGains(self.proportional * gain, self.integral * min(boost, CURVE.largest_boost))


@dataclass(frozen=True, slots=True)
class LoopPlant:
    """The linear quantities that the closed form needs.

    Attributes:
        structure_decay: δ_s = ζ_s ω_s of the structure without exciter, rad/s.
        plant_decay: δ_p = ζ_p ω_p (1 + μ) with the exciter attached, rad/s.
        mass_ratio: μ = φ_ex² m_ex, 1.
    """

    structure_decay: float
    plant_decay: float
    mass_ratio: float

    @classmethod
    def from_values(
        cls,
        structure_frequency: float,
        structure_damping: float,
        plant_frequency: float,
        plant_damping: float,
        drive_point_shape: float,
        moving_mass: float,
    ) -> LoopPlant:
        """From modal values: frequencies in rad/s, damping ratios, φ_ex in 1/√kg, m_ex in kg.

        Raises:
            BenchError: a frequency or damping ratio is not positive, or the mass is negative.
        """
        if min(structure_frequency, structure_damping, plant_frequency, plant_damping) <= 0 or moving_mass < 0:
            raise BenchError(
                "Controller gains need positive frequencies and damping ratios of structure and plant and a "
                "moving mass that is not negative; check the linear description."
            )
        mu = drive_point_shape**2 * moving_mass
        return cls(structure_damping * structure_frequency, plant_damping * plant_frequency * (1.0 + mu), mu)

    @classmethod
    def from_description(cls, linear: LinearDescription) -> LoopPlant:
        """From a linear description's target mode; raises as :meth:`from_values`."""
        return cls.from_values(
            linear.frequencies_rad_s[linear.target_mode],
            linear.damping_ratios[linear.target_mode],
            linear.plant_frequency_rad_s,
            linear.plant_damping_ratio,
            linear.drive_point_shape,
            linear.moving_mass_kg,
        )


def closed_form_gains(plant: LoopPlant, cutoff: float, imaginary_part: float = 0.0) -> ControllerGains:
    """Gains that put the three poles of the linearised loop at ω_LP (λ_R, λ_R ± i λ_I).

    Args:
        plant: linear quantities.
        cutoff: ω_LP of the adaptive filter, rad/s.
        imaginary_part: λ_I; 0 is the conservative choice.

    Returns:
        k_p in 1/s and k_i in 1/s².

    Raises:
        BenchError: the cut-off is not positive.
    """
    if not cutoff > 0:
        raise BenchError(f"The cut-off of the adaptive filter must be positive, got {cutoff} rad/s.")
    d = plant.plant_decay / cutoff
    real_part = -(d + 1.0) / 3.0
    ratio = plant.structure_decay / plant.plant_decay
    proportional = ratio * (3.0 * real_part**2 + imaginary_part**2 - d) * cutoff / (1.0 + plant.mass_ratio)
    integral = ratio * (-real_part * (real_part**2 + imaginary_part**2)) * cutoff**2 / (1.0 + plant.mass_ratio)
    return ControllerGains(proportional, integral)
