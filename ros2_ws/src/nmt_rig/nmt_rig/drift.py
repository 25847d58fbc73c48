"""Slow changes with bench time: slip forces and stiffness, in steps of fixed length whatever the block length."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from nmt_core.messages.blocks import OscillatorPhase
from nmt_core.numerics.arrays import FloatArray
from nmt_rig.model.assembly import ElectromechanicalSystem
from nmt_rig.model.time_integration import TimeIntegrator
from nmt_rig.rig import Rig
from nmt_rig.rig_model import build_structure

# Bench time of one step, s: within it nothing changes.
STEP_S = 0.02
# Smallest remaining share of a slip force: it must stay positive.
_SMALLEST_SHARE = 1e-6
# The stiffness changes in relative steps of this size, to the nearest: frequencies are right within a quarter of it.
_STIFFNESS_STEP = 4e-6


class Drift:
    """Factors since the start: (1 + a t) (1 + b N) on slip forces, 1 + c t on the structure's stiffness.

    t is the bench time and N the number of periods of the drive since the start of the test, both at the start of the
    present step of ``STEP_S``; periods count while the oscillator runs with a frequency.
    """

    def __init__(self, rig: Rig) -> None:
        self._rig = rig
        self._rates = rig.drift
        self.active = any(value != 0.0 for value in self._rates.model_dump().values())
        self._rate = rig.sample_rate_hz * (1.0 + rig.clock_error)
        self._step = max(1, round(STEP_S * rig.sample_rate_hz))
        self._sample = 0
        self._cycles = 0.0
        self._base: ElectromechanicalSystem | None = None
        self._stiffness: FloatArray = np.zeros((0, 0))

    def advance(
        self,
        integrator: TimeIntegrator,
        inputs: FloatArray,
        phase: OscillatorPhase,
    ) -> FloatArray:
        """Integrate a block, with the drift up to each of its steps.

        Args:
            integrator: of the rig.
            inputs: (exciters, n + 1) as for `TimeIntegrator.advance`.
            phase: oscillator phase at the block's first sample.

        Returns:
            (outputs, n).

        Raises:
            IntegrationError: the motion is not finite any more.
        """
        if self._base is None:
            self._base = integrator.system
            n = self._base.structure_size
            self._stiffness = np.zeros_like(self._base.stiffness)
            self._stiffness[:n, :n] = build_structure(self._rig).stiffness
        n = inputs.shape[1] - 1
        parts = []
        done = 0
        while done < n:
            into = (self._sample + done) % self._step
            if into == 0:
                self._apply(integrator, (self._sample + done) / self._rate, self._cycles_at(phase, done))
            length = min(n - done, self._step - into)
            parts.append(integrator.advance(inputs[:, done : done + length + 1]))
            done += length
        self._cycles = self._cycles_at(phase, n)
        self._sample += n
        return np.concatenate(parts, axis=1) if parts else integrator.advance(inputs)

    def _cycles_at(self, phase: OscillatorPhase, samples: int) -> float:
        """Periods of the drive until so many samples into the block."""
        if math.isnan(phase.frequency_hz):
            return self._cycles
        t = samples / self._rig.sample_rate_hz
        return self._cycles + phase.frequency_hz * t + 0.5 * phase.rate_hz_s * t * t

    def _apply(self, integrator: TimeIntegrator, time: float, cycles: float) -> None:
        assert self._base is not None
        rates = self._rates
        share = (1.0 + rates.slip_force_per_s * time) * (1.0 + rates.slip_force_per_cycle * cycles)
        share = max(share, _SMALLEST_SHARE)
        change = _STIFFNESS_STEP * round(rates.stiffness_per_s * time / _STIFFNESS_STEP)
        integrator.change(
            replace(
                self._base,
                stiffness=self._base.stiffness + change * self._stiffness,
                elements=tuple(element.with_slip_force(share) for element in self._base.elements),
            )
        )
