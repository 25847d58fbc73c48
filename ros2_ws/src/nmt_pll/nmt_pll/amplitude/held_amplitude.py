"""Holds the amplitude of a fundamental at a target while the frequency moves through a resonance.

Near a resonance of the structure the exciter sees a large motion, which takes most of its force: at constant voltage
the force drops out. Force F, voltage u and drive-point response a obey

    F = P u − Z a,

where P (N/V) is the force the exciter would give to a body at rest and Z its own dynamic stiffness, both of the
exciter alone and nearly constant over a sweep, while F/u and a/u change by an order of magnitude within seconds. A
controller that knows F/u only has to be slow next to the decay of the structure, because a step of the voltage moves
the force P/(F/u) times as far at once as in the end. One that knows P and Z has no such bound: it takes away in every
block what the change of the motion will do to the force, and the feedback has the dead time of the loop alone to
respect. P and Z are estimated along the sweep from the same phasors that the loop measures.
"""

from __future__ import annotations

import cmath
import math
from collections import deque

import numpy as np

from nmt_core.numerics.arrays import ComplexArray
from nmt_pll.thresholds import AMPLITUDE


class VoltageRecord:
    """The voltage as the adaptive filter would see it at the end of each block.

    The filter is a low-pass of cut-off ω_LP on every coefficient; phasors of one instant can be set against each
    other only if all of them have passed it.

    Args:
        cutoff: ω_LP, rad/s.
        block_duration: s.
        latency_blocks: blocks between a command and the block in which it is carried out.
    """

    STEPS = 16

    def __init__(self, cutoff: float, block_duration: float, latency_blocks: int) -> None:
        self._decay = math.exp(-cutoff * block_duration / self.STEPS)
        share = (np.arange(self.STEPS) + 0.5) / self.STEPS
        self._weights = (0.5 - 0.5 * np.cos(np.pi * share)).tolist()
        self._pending: deque[float] = deque([0.0] * latency_blocks)
        self._previous = 0.0
        self.value = 0.0

    def advance(self, command: float) -> float:
        """Filtered voltage (V) after the block that follows ``command``'s half-cosine of one block's length."""
        self._pending.append(command)
        target = self._pending.popleft()
        start, value, decay = self._previous, self.value, self._decay
        for weight in self._weights:
            value = decay * value + (1.0 - decay) * (start + (target - start) * weight)
        self._previous, self.value = target, value
        return value

    def clear(self) -> None:
        """Drive at rest."""
        for index in range(len(self._pending)):
            self._pending[index] = 0.0
        self._previous = self.value = 0.0


class ExciterEstimate:
    """P and Z of F = P u − Z a, tracked along the sweep.

    A Kalman filter whose state [P, Z] walks at random: the variance of P grows by ``drift``² a block, relative to its
    size, so that a slow change with the frequency is followed. Directions that the present motion does not distinguish
    keep what was learnt: the covariance never exceeds that of the start.
    An update weighs the noise of the sensors and a share of the force that no pair P, Z explains.

    Attributes:
        force_per_volt: P, N/V; 0 before the first estimate.
        stiffness: Z, N per unit of the response.
        force_noise: rms of the force phasor with the drive at rest, N.
        response_noise: rms of the response phasor with the drive at rest, unit of the response.
    """

    def __init__(self, drift: float = 5.0e-5, noise: float = 1.0e-3) -> None:
        self._drift = drift
        self._noise = noise
        self.force_per_volt = 0j
        self.stiffness = 0j
        self.force_noise = 0.0
        self.response_noise = 0.0
        self._covariance = np.zeros((2, 2), dtype=np.complex128)
        self._prior = np.zeros(2)

    def start(self, force: complex, voltage: float, response: complex) -> None:
        """First estimate: all of the force per volt is P; Z is within ± |F/a|."""
        self.force_per_volt = force / voltage
        self.stiffness = 0j
        self._prior = np.array([abs(force / voltage) ** 2, abs(force) ** 2 / max(abs(response) ** 2, 1e-300)])
        self._covariance = np.diag(self._prior).astype(np.complex128)

    def update(self, force: complex, voltage: float, response: complex) -> None:
        """Take in one block's phasors: N, V, unit of the response."""
        row: ComplexArray = np.array([voltage, -response], dtype=np.complex128)
        covariance = self._covariance
        covariance[0, 0] += (self._drift * abs(self.force_per_volt)) ** 2
        covariance[1, 1] += (self._drift * max(abs(self.stiffness), 0.01 * math.sqrt(self._prior[1]))) ** 2
        scale = np.minimum(1.0, np.sqrt(self._prior / np.maximum(covariance.diagonal().real, 1e-300)))
        covariance *= np.outer(scale, scale)
        spread = covariance @ row.conj()
        variance = float((row @ spread).real) + (self._noise * abs(force)) ** 2
        variance += self.force_noise**2 + (abs(self.stiffness) * self.response_noise) ** 2
        if not variance > 0.0:
            return
        gain = spread / variance
        error = force - (self.force_per_volt * voltage - self.stiffness * response)
        self.force_per_volt += complex(gain[0]) * error
        self.stiffness += complex(gain[1]) * error
        covariance -= np.outer(gain, spread.conj())
        self._covariance = 0.5 * (covariance + covariance.conj().T)


class ForceHolder:
    """Drive voltage that keeps the force's fundamental at its target.

    Each block: Δu |P| cos ψ = κ (F* − |F|) + Re(e^{−i arg F} Z Δa), ψ the angle between P and F. With exact P and Z the
    error of the next block is 1 − κ of this one's plus Z times the second difference of the motion. κ is half of the
    value that damps the loop of integrator, adaptive filter and dead time critically, κ_c = (1 − √p)/(1 + √p), p =
    exp(−ω_LP Δt), divided by 1 + 2 blocks of latency. Where P and F are at right angles (between the resonances of the
    structure with and without exciter) a change of the voltage only turns the force; the step then fades out and a slow
    multiplicative integral, which acts at all times, remains.

    Args:
        cutoff: ω_LP of the adaptive filter, rad/s.
        block_duration: s.
        latency_blocks: blocks of buffering between command and excitation.
    """

    def __init__(self, cutoff: float, block_duration: float, latency_blocks: int) -> None:
        root = math.exp(-0.5 * cutoff * block_duration)
        self.feedback = AMPLITUDE.feedback_gain_share * (1.0 - root) / (1.0 + root) / (1.0 + 2.0 * latency_blocks)
        self.slow = AMPLITUDE.slow_correction_share * self.feedback / AMPLITUDE.feedback_gain_share
        self.exciter = ExciterEstimate()
        self.record = VoltageRecord(cutoff, block_duration, latency_blocks)
        self._response: complex | None = None
        self._quiet: list[tuple[float, float]] = []

    def clear(self) -> None:
        """Drive at rest."""
        self.record.clear()
        self.exciter = ExciterEstimate()
        self._response = None
        self._quiet = []

    def listen(self, force: complex, response: complex) -> None:
        """Take in a block's phasors with the drive at rest: noise."""
        self._quiet = [*self._quiet[1 - AMPLITUDE.noise_blocks :], (abs(force) ** 2, abs(response) ** 2)]
        force_power, response_power = np.mean(self._quiet, axis=0)
        self.exciter.force_noise = math.sqrt(force_power)
        self.exciter.response_noise = math.sqrt(response_power)

    def observe(self, force: complex, response: complex, voltage: float) -> complex:
        """Take in a block's phasors and the voltage commanded during it; Z Δa, the force the motion has taken, N."""
        filtered = self.record.advance(voltage)
        if self.exciter.force_per_volt == 0 and filtered > 0.0:
            if abs(force) >= AMPLITUDE.start_noise_ratio * self.exciter.force_noise:
                self.exciter.start(force, filtered, response)
        elif filtered > 0.0:
            self.exciter.update(force, filtered, response)
        previous, self._response = self._response, response
        return self.exciter.stiffness * (response - previous) if previous is not None else 0j

    def voltage(self, present: float, target: float, force: complex, taken: complex) -> float:
        """Voltage for the next block.

        Args:
            present: V.
            target: force amplitude, N.
            force: complex fundamental, N.
            taken: answer of ``observe``, N.
        """
        size = abs(force)
        if size == 0.0 or target <= 0.0:
            return present
        direction = force.conjugate() / size
        blocked = abs(self.exciter.force_per_volt)
        cosine = max(0.0, (self.exciter.force_per_volt * direction).real / blocked) if blocked else 0.0
        inverse = cosine / (cosine**2 + 0.02) / blocked if blocked else 0.0
        step = inverse * (self.feedback * (target - size) + (direction * taken).real)
        step += self.slow * present * math.log(target / size)
        limit = AMPLITUDE.largest_log_step * present
        return present + min(max(step, -limit), limit)


class ResponseHolder:
    """Drive voltage that keeps the response's amplitude at its target: a multiplicative integral.

    The response follows the voltage with the decay of the plant, without the force's large direct path, so that one
    bandwidth, well below dead time and filter, serves all frequencies.
    """

    def __init__(self, cutoff: float, block_duration: float, latency_blocks: int) -> None:
        dead_time = (0.5 + latency_blocks) * block_duration + 1.0 / cutoff
        self.gain = min(0.1 * block_duration / dead_time, 0.1)

    def voltage(self, present: float, target: float, response: complex) -> float:
        """Voltage for the next block (V) with the response's complex fundamental at a target amplitude."""
        size = abs(response)
        if size == 0.0 or target <= 0.0:
            return present
        return present * math.exp(
            min(max(self.gain * math.log(target / size), -AMPLITUDE.largest_log_step), AMPLITUDE.largest_log_step)
        )


def turn(value: complex, reference: complex) -> float:
    """Angle from ``reference`` to ``value``, rad in (−π, π]; 0 if either vanishes."""
    product = value * reference.conjugate()
    return cmath.phase(product) if product != 0 else 0.0
