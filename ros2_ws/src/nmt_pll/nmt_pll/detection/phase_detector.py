"""Adaptive Fourier filter: tracks the harmonics of several channels against a known phase."""

from __future__ import annotations

import cmath
import math

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_core.numerics.kernels import njit


@njit(cache=True)
def _track(coefficients: ComplexArray, data: FloatArray, cycles: float, step: float, bend: float, gain: float) -> None:
    """Update ``coefficients`` (channels, harmonics + 1) sample by sample; phase k: cycles + step k + bend k²."""
    channels, samples = data.shape
    harmonics = coefficients.shape[1]
    rotation = np.empty(harmonics, dtype=np.complex128)
    for k in range(samples):
        angle = 2.0 * np.pi * (cycles + k * (step + bend * k))
        base = complex(np.cos(angle), np.sin(angle))
        rotation[0] = 1.0
        for n in range(1, harmonics):
            rotation[n] = rotation[n - 1] * base
        for i in range(channels):
            estimate = coefficients[i, 0].real
            for n in range(1, harmonics):
                estimate += coefficients[i, n].real * rotation[n].real - coefficients[i, n].imag * rotation[n].imag
            error = data[i, k] - estimate
            coefficients[i, 0] += 0.5 * gain * error
            for n in range(1, harmonics):
                coefficients[i, n] += gain * error * rotation[n].conjugate()


class AdaptiveFourierFilter:
    """Complex Fourier coefficients of every channel, updated each sample.

    With x̂ = Re Σ c_n e^{inθ} the update is c_n += 2 ω_LP Δt e^{−inθ} (x − x̂) for n ≥ 1 and half of that for the mean:
    to first order a low-pass of cut-off ω_LP on each coefficient. Modelling the harmonics 0..H keeps them from
    rippling the fundamental's phase.

    Args:
        channels: number of channels.
        harmonics: H, highest harmonic tracked.
        cutoff: ω_LP, rad/s.
        sample_rate: Hz.

    Raises:
        BenchError: the filter would be unstable at this cut-off and sample rate, or H < 1.
    """

    def __init__(self, channels: int, harmonics: int, cutoff: float, sample_rate: float) -> None:
        if harmonics < 1:
            raise BenchError(f"The adaptive filter needs at least the first harmonic, got {harmonics}.")
        gain = 2.0 * cutoff / sample_rate
        if not 0.0 < gain * (harmonics + 0.5) < 1.0:
            raise BenchError(
                f"The adaptive filter is not stable with {harmonics} harmonics, cut-off {cutoff:g} rad/s and "
                f"{sample_rate:g} Hz; lower the cut-off or the number of harmonics."
            )
        self.cutoff = cutoff
        self.sample_rate = sample_rate
        self.coefficients: ComplexArray = np.zeros((channels, harmonics + 1), dtype=np.complex128)
        self._gain = gain

    def process(self, data: FloatArray, cycles: float, frequency_hz: float, rate_hz_s: float = 0.0) -> ComplexArray:
        """Take in one block.

        Args:
            data: shape ``(channels, samples)``.
            cycles: phase at the first sample, cycles.
            frequency_hz: frequency at the first sample, Hz.
            rate_hz_s: rate of change of the frequency, Hz/s.

        Returns:
            The coefficients after the last sample, shape ``(channels, H + 1)``; do not keep, they change in place.
        """
        if data.shape[0] != self.coefficients.shape[0]:
            raise ValueError(f"expected {self.coefficients.shape[0]} channels, got {data.shape[0]}")
        step = frequency_hz / self.sample_rate
        bend = 0.5 * rate_hz_s / self.sample_rate**2
        _track(self.coefficients, data, cycles, step, bend, self._gain)
        return self.coefficients

    def reset(self) -> None:
        """Forget everything."""
        self.coefficients[:] = 0.0


def phase_error(force: complex, response: complex, velocity_lead: float) -> float:
    """Deviation from phase resonance, positive below resonance.

    Args:
        force: complex fundamental of the force, N.
        response: complex fundamental of the drive-point response.
        velocity_lead: phase by which velocity leads that response: π/2 for displacement, −π/2 for acceleration, 0 for
            velocity; rad.

    Returns:
        ε = arg(velocity) − arg(force) in (−π, π]; the loop raises the frequency when it is positive.
    """
    turned = response * force.conjugate() * cmath.rect(1.0, velocity_lead)
    return math.atan2(turned.imag, turned.real)  # cmath.phase raises where the result underflows
