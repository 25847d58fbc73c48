"""What follows from the orders of a window in a secondary resonance.

Orders and lags are those of :mod:`nmt_core.messages.secondary_resonance`. Harmonics count in the base frequency Ω/ν,
so that the force has the order ν and the resonant part of the response the order k. Modal frequency, amplitude, shape
and MAC are those of the order k. The force feeds another order than the one in resonance, so that damping follows from
the power balance over all of them: with one ξ for every order

    P = Σ_n ½ Re(v_n F̄_n) = ½ ξ Σ_n (n ω_b)² q_n²,    δ̃ = ξ / (2 k ω_b),

which is the paper's equation for ξ where one order alone vibrates.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.messages.secondary_resonance import SecondaryResonance
from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_extract.modal.quantities import ModalQuantities, energy


@dataclass(frozen=True, eq=False)
class SecondaryQuantities(ModalQuantities):
    """What follows from the orders of a secondary resonance; ``omega`` is the base frequency ω_b, rad/s.

    ``shape`` and ``coordinates`` are those of the order k. Powers are over all orders, ``gamma_force`` and
    ``gamma_acceleration`` the content of the orders ν and k, ``phase_error`` is (θ − its value at resonance) / ν, of a
    hardening or a softening spring, whichever is nearer.

    Attributes:
        resonance: k:ν.
        sizes: q_n = |Φ⁺ψ_n|, m√kg, shape ``(sets, H)``.
    """

    resonance: SecondaryResonance
    sizes: FloatArray

    @property
    def orders(self) -> tuple[int, int]:
        """k and ν."""
        return self.resonance[:2]

    @cached_property
    def active_power(self) -> FloatArray:
        """P over all orders, W."""
        return np.asarray(self._power.sum(axis=1))

    @cached_property
    def self_excitation(self) -> FloatArray:
        """ξ = 2 P / Σ (n ω_b q_n)², rad/s."""
        speed = np.multiply.outer(self.omega, np.arange(1, self.force.shape[-1] + 1)) * self.sizes
        return np.asarray(2.0 * self.active_power / (speed**2).sum(axis=1))

    @cached_property
    def damping_ratio(self) -> FloatArray:
        """δ̃ = ξ / (2 k ω_b)."""
        return np.asarray(self.self_excitation / (2.0 * self.resonance.response_order * self.omega))

    @cached_property
    def phase_error(self) -> FloatArray:
        """Deviation of the resonant order's phase, rad."""
        k, nu, lag = self.resonance
        displacement = self.velocity[:, 0, k - 1] / 1j
        angle = self.force[:, 0, nu - 1] ** k * np.conj(displacement) ** nu * np.exp(-1j * lag)
        return np.asarray((np.remainder(np.angle(angle) + 0.5 * np.pi, np.pi) - 0.5 * np.pi) / nu)


def secondary_quantities(
    resonance: SecondaryResonance,
    base: FloatArray,
    force: ComplexArray,
    drive: ComplexArray,
    drive_acceleration: ComplexArray,
    shapes: ComplexArray,
    linear_shapes: FloatArray,
    target_mode: int,
) -> SecondaryQuantities:
    """Powers, damping, amplitude and indicators of the orders of a window.

    Args:
        resonance: k:ν.
        base: ω_b, rad/s, shape ``(sets,)``.
        force: F_n of every exciter, N, shape ``(sets, exciters, H + 1)``.
        drive: displacements at their points, m, same shape.
        drive_acceleration: at the drive point, m/s², shape ``(sets, H + 1)``.
        shapes: ψ_n at the points of Φ, m, shape ``(sets, points, H + 1)``.
        linear_shapes: mass-normalised Φ, 1/√kg, shape ``(points, modes)``.
        target_mode: index of the mode under test.

    Raises:
        BenchError: force or resonant response vanish.
    """
    k = resonance.response_order
    coordinates = np.einsum("mp,spn->snm", np.linalg.pinv(linear_shapes), shapes[:, :, 1:])
    values = SecondaryQuantities(
        omega=base,
        force=force[..., 1:],
        velocity=1j * np.multiply.outer(base, np.arange(1, force.shape[-1]))[:, np.newaxis] * drive[..., 1:],
        drive_acceleration=drive_acceleration[:, 1:],
        shape=shapes[:, :, k],
        linear_shape=linear_shapes[:, target_mode],
        coordinates=coordinates[:, k - 1],
        resonance=resonance,
        sizes=np.sqrt(energy(coordinates)),
    )
    drives = np.abs(values.velocity[:, 0, k - 1])
    if not (np.all(values.modal_amplitude > 0.0) and np.all(values.force_n > 0.0) and np.all(drives > 0.0)):
        raise BenchError("No force, or no response in the resonant order, was measured; check sensors and drive.")
    return values
