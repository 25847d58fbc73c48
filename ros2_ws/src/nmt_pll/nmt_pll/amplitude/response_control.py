"""Holds the amplitude of the response, also where the force falls while the response grows.

With the phase held, the amplitude a of a mode obeys ȧ = −δ (a − g u) around a point of its backbone: a step of the
voltage u arrives with the decay δ of structure and exciter. An integral controller of a bandwidth above δ swings with
it, and where the force that phase resonance needs falls with the amplitude (beyond a fold over the force, as in an
internal resonance) the plant by itself runs away, because at constant voltage only the branches outside are stable. A
proportional part puts both right: with

    ln u = I + (ω_c / δ) e,   dI/dt = (ω_c / δ) z e,   e = ln(target / a),   z = max(δ, ω_c / 4)

the closed loop has the poles of s² + (δ' + ω_c) s + ω_c z. δ' is the decay at this point of the backbone: δ where the
amplitude is proportional to the voltage, negative beyond a fold. At a fold (δ' = 0) it is damped critically, and it is
stable as long as the amplitude would run away more slowly than ω_c.
"""

from __future__ import annotations

import math

from nmt_pll.thresholds import AMPLITUDE


class ResponseController:
    """Proportional and integral control of ln u; the target glides to a new level.

    Attributes:
        target: where the amplitude is to be now, unit of the response.
    """

    def __init__(self) -> None:
        self.target = 0.0
        self._log_voltage = 0.0
        self._from = 0.0
        self._since = 0.0
        self._glide = 0.0

    def start(self, voltage: float) -> None:
        """Take a voltage (V) as the integral part; the target begins anew at what is measured."""
        self._log_voltage = math.log(max(voltage, 1e-12))
        self.target = 0.0

    def aim(self, glide: float) -> None:
        """Go to another level within ``glide`` seconds from the next update on."""
        self._from, self._since, self._glide = self.target, 0.0, glide

    def update(
        self,
        level: float,
        measured: float,
        bandwidth: float,
        decay: float,
        duration: float,
        phase_error: float = 0.0,
        limit: float = math.inf,
    ) -> float:
        """New drive voltage after ``duration`` seconds.

        Args:
            level: amplitude to be held in the end, unit of the response.
            measured: present amplitude.
            bandwidth: ω_c, rad/s.
            decay: δ of structure and exciter, rad/s.
            duration: s.
            phase_error: deviation from the held phase, rad; while it is large the target waits, because with the
                amplitude of a strongly nonlinear mode its frequency moves, too.
            limit: largest voltage, V.

        Returns:
            V.
        """
        if measured <= 0.0 or level <= 0.0:
            return min(math.exp(self._log_voltage), limit)
        if self._from <= 0.0:
            self._from = min(max(measured, 0.5 * level), level)
            self.target = self._from
        if max(abs(math.log(self.target / measured)), abs(phase_error)) < AMPLITUDE.waiting_error:
            self._since += duration
        share = min(self._since / self._glide, 1.0) if self._glide > 0.0 else 1.0
        self.target = self._from * (level / self._from) ** (0.5 - 0.5 * math.cos(math.pi * share))
        error = math.log(self.target / measured)
        gain = min(bandwidth / decay, AMPLITUDE.largest_rate_ratio)
        step = (
            gain
            * max(decay, 0.25 * bandwidth)
            * duration
            * min(max(error, -AMPLITUDE.largest_integrated_error), AMPLITUDE.largest_integrated_error)
        )
        highest = math.log(limit) if limit < math.inf else math.inf
        self._log_voltage = min(self._log_voltage + step, highest)
        part = min(max(gain * error, -AMPLITUDE.largest_proportional_log), AMPLITUDE.largest_proportional_log)
        return min(math.exp(self._log_voltage + part), limit)
