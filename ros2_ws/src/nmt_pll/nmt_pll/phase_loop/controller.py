"""Frequency and amplitude controllers of the loop."""

from __future__ import annotations

import math

from nmt_pll.loop_settings import LoopSettings
from nmt_pll.phase_loop.gains import ControllerGains, LoopPlant, closed_form_gains
from nmt_pll.thresholds import PHASE


class GainSchedule:
    """Gains for the damping that the structure has right now.

    The closed form holds for the linear regime. With friction the structure's decay δ_s grows by a factor of ten
    over the level range, and the loop gain, which is inverse to it, shrinks by the same factor. The drive point
    itself tells the present decay, so the closed form is evaluated with it. A sampled loop has dead time; where the
    exciter damps so strongly that the closed form would ask for more bandwidth than the dead time allows, an
    integral controller of the allowed bandwidth, with the slower lag cancelled, takes its place.

    Args:
        plant: linear quantities of the loop.
        settings: loop settings.
        cutoff: ω_LP, rad/s.
        dead_time: mean delay between measurement and its effect, s.
    """

    def __init__(self, plant: LoopPlant, settings: LoopSettings, cutoff: float, dead_time: float) -> None:
        self.plant = plant
        self.cutoff = cutoff
        self.settings = settings
        self.bandwidth_limit = settings.delay_margin / dead_time

    def gains(self, structure_decay: float) -> ControllerGains:
        """Gains at a present decay of the structure (rad/s); never below the linear one."""
        if self.settings.proportional > 0:
            return ControllerGains(self.settings.proportional, self.settings.integral)
        decay, total = self._present(structure_decay)
        if (total + self.cutoff) / 3.0 <= self.bandwidth_limit:
            present = LoopPlant(decay, total, self.plant.mass_ratio)
            return closed_form_gains(present, self.cutoff, self.settings.imaginary_part)
        integral = self.bandwidth_limit * decay / (1.0 + self.plant.mass_ratio)
        return ControllerGains(integral / min(self.cutoff, total), integral)

    @property
    def amplitude_bandwidth(self) -> float:
        """Bandwidth of the amplitude controller, rad/s: slow next to the phase loop."""
        return PHASE.amplitude_bandwidth_share * self.bandwidth_limit

    def force_bandwidth(self, structure_decay: float) -> float:
        """Bandwidth of the amplitude controller that holds the force, rad/s, at a present decay of the structure.

        At resonance the force follows the voltage with the gain (s + δ_s)/(s + δ_p): a step of the voltage first
        moves the force δ_p/δ_s times as far as in the end. The loop stays slow if its bandwidth times that ratio
        does, or if its gain stays below one beyond δ_s.
        """
        decay, total = self._present(structure_decay)
        limit = self.amplitude_bandwidth
        return min(limit, decay * max(0.5, limit / total))

    def plant_decay(self, structure_decay: float) -> float:
        """Decay of structure and exciter at a present decay of the structure, rad/s."""
        return self._present(structure_decay)[1]

    def _present(self, structure_decay: float) -> tuple[float, float]:
        """Decay of the structure, never below the linear one, and of the plant, rad/s."""
        decay = max(structure_decay, self.plant.structure_decay)
        total = self.plant.plant_decay + (decay - self.plant.structure_decay) * (1.0 + self.plant.mass_ratio)
        return decay, total


class FrequencyController:
    """PI controller ω = ω_I + k_p ε with clamped output and integrator.

    Args:
        start: initial angular frequency, rad/s.
        low, high: bounds of the angular frequency, rad/s.
    """

    def __init__(self, start: float, low: float, high: float) -> None:
        self.low = low
        self.high = high
        self.integrator = start
        self.output = start

    def reset(self, frequency: float) -> None:
        """Start again from an angular frequency, rad/s."""
        self.integrator = self.output = min(max(frequency, self.low), self.high)

    def update(self, error: float, gains: ControllerGains, duration: float) -> float:
        """One step; returns the new angular frequency in rad/s.

        The integrator stops at the bounds (anti-windup): it leaves them as soon as the error changes sign.
        """
        self.integrator = min(max(self.integrator + gains.integral * error * duration, self.low), self.high)
        self.output = min(max(self.integrator + gains.proportional * error, self.low), self.high)
        return self.output

    def shift(self, change: float) -> None:
        """Move integrator and output by a change of the frequency that is known beforehand, rad/s."""
        self.integrator = min(max(self.integrator + change, self.low), self.high)
        self.output = min(max(self.output + change, self.low), self.high)

    @property
    def at_bound(self) -> bool:
        """True while the integrator rests on a bound."""
        return self.integrator <= self.low or self.integrator >= self.high


class AmplitudeController:
    """Holds a measured amplitude by a multiplicative integral law on the drive voltage.

    ln u moves with rate ``bandwidth`` times ln(target / measured), so that one setting serves every level; the rate is
    limited to keep the drive from jumping while the measurement is still small.

    Args:
        bandwidth: rad/s.
        limit: largest drive voltage, V.
    """

    def __init__(self, bandwidth: float, limit: float = math.inf) -> None:
        self.bandwidth = bandwidth
        self.limit = limit

    def update(self, voltage: float, target: float, measured: float, duration: float) -> float:
        """New drive voltage in V after ``duration`` seconds with ``measured`` at ``target``."""
        if measured <= 0.0 or target <= 0.0:
            return voltage
        step = self.bandwidth * duration * math.log(target / measured)
        return min(voltage * math.exp(min(max(step, -0.2), 0.2)), self.limit)
