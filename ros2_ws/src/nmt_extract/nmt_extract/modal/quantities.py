"""What follows from the harmonics of a window: powers, damping, amplitude, indicators (method, eqs. 3 to 7)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.numerics.arrays import ComplexArray, FloatArray


def energy(values: ComplexArray) -> FloatArray:
    """Σ |x|² over the last axis."""
    return np.asarray((values.real**2 + values.imag**2).sum(axis=-1), dtype=np.float64)


def estimated_mass(shapes: FloatArray) -> FloatArray:
    """Mass matrix from linear mode shapes: M_exp = (Φᵀ)⁺ Φ⁺ (paper, eq. for M_exp; method, eq. 4).

    Args:
        shapes: mass-normalised Φ, 1/√kg, shape ``(points, modes)``.

    Returns:
        kg, shape ``(points, points)``; symmetric, of the rank of Φ.

    Examples:
        Two masses of 2 and 0.5 kg, whose shapes are known completely; of one mode alone the rank is one:

        >>> shapes = np.array([[0.5, 0.5], [1.0, -1.0]])
        >>> estimated_mass(shapes).diagonal().round(9)
        array([2. , 0.5])
        >>> int(np.linalg.matrix_rank(estimated_mass(shapes[:, :1])))
        1
    """
    inverse = np.linalg.pinv(shapes)
    return np.asarray(inverse.T @ inverse, dtype=np.float64)


@dataclass(frozen=True, eq=False)
class ModalQuantities:
    """What follows from harmonics; every array leads with the axis ``sets``: the window and its variants.

    Each quantity of :data:`nmt_core.messages.modal_point.EVALUATED` is a property of its name, SI units, shape
    ``(sets,)`` (method, eqs. 3 to 7). Powers are positive when the exciter feeds the structure, so ``force`` is the
    force of the exciter on the structure.

    Attributes:
        omega: ω̃, rad/s, shape ``(sets,)``.
        force: F_n of every exciter without n = 0, the first's first, N, shape ``(sets, exciters, H)``.
        velocity: iωnψ̃_k,n at their points without n = 0, m/s, same shape. Powers are those of all exciters, S is the
            sum of each one's: |P|/S is 1 where each exciter is in phase resonance at its own point.
        drive_acceleration: acceleration harmonics at the drive point without n = 0, m/s², shape ``(sets, H)``.
        shape: fundamental ψ̃₁ at the points of Φ, m, shape ``(sets, points)``.
        linear_shape: of the mode under test, 1/√kg, shape ``(points,)``.
        coordinates: modal coordinates Φ⁺ψ̃₁, m√kg, shape ``(sets, modes)``.
    """

    omega: FloatArray
    force: ComplexArray
    velocity: ComplexArray
    drive_acceleration: ComplexArray
    shape: ComplexArray
    linear_shape: FloatArray
    coordinates: ComplexArray

    @property
    def orders(self) -> tuple[int, int]:
        """Orders of response and force that are in resonance."""
        return 1, 1

    @cached_property
    def modal_amplitude(self) -> FloatArray:
        """q = |Φ⁺ψ̃₁|, m√kg."""
        return np.asarray(np.sqrt(energy(self.coordinates)))

    @cached_property
    def force_n(self) -> FloatArray:
        """Resonant order of the first exciter's force, |F₁|, N."""
        return np.asarray(np.abs(self.force[:, 0, self.orders[1] - 1]))

    @cached_property
    def _power(self) -> FloatArray:
        """P_n, W, shape ``(sets, H)``."""
        return np.asarray(0.5 * (self.velocity * self.force.conj()).real.sum(axis=1))

    @cached_property
    def active_power(self) -> FloatArray:
        """P₁, W."""
        return self._power[:, 0]

    @cached_property
    def apparent_power(self) -> FloatArray:
        """S over all harmonics, W."""
        return np.asarray(0.5 * np.sqrt(energy(self.velocity) * energy(self.force)).sum(axis=1))

    @cached_property
    def self_excitation(self) -> FloatArray:
        """ξ = 2 P₁ / (ω̃ q)², rad/s."""
        return np.asarray(2.0 * self.active_power / (self.omega * self.modal_amplitude) ** 2)

    @cached_property
    def damping_ratio(self) -> FloatArray:
        """δ̃ = ξ / (2 ω̃)."""
        return np.asarray(self.self_excitation / (2.0 * self.omega))

    @cached_property
    def pbmif(self) -> FloatArray:
        """|P| / S over all harmonics."""
        return np.asarray(np.abs(self._power.sum(axis=1)) / self.apparent_power)

    @cached_property
    def gamma_force(self) -> FloatArray:
        """Resonant order over rms of all harmonics of the force, of all exciters together."""
        fundamental = np.abs(self.force[:, :, self.orders[1] - 1])
        return np.asarray(np.sqrt((fundamental * fundamental).sum(axis=1)) / np.sqrt(energy(self.force).sum(axis=1)))

    @cached_property
    def gamma_acceleration(self) -> FloatArray:
        """Resonant order over rms of all harmonics of the drive-point acceleration."""
        acceleration = self.drive_acceleration
        return np.asarray(np.abs(acceleration[:, self.orders[0] - 1]) / np.sqrt(energy(acceleration)))

    @cached_property
    def mac(self) -> FloatArray:
        """|φᵀψ̃₁|² / (φᵀφ · |ψ̃₁|²)."""
        linear = self.linear_shape
        return np.asarray(
            np.abs((linear * self.shape).sum(axis=1)) ** 2 / ((linear * linear).sum() * energy(self.shape))
        )

    @cached_property
    def phase_error(self) -> FloatArray:
        """Phase of the first force before the velocity at its point, rad."""
        return np.asarray(np.angle(self.force[:, 0, 0] * self.velocity[:, 0, 0].conj()))

    @cached_property
    def normalised_shape(self) -> ComplexArray:
        """φ̃₁ = ψ̃₁ / q, 1/√kg, shape ``(sets, points)``."""
        return np.asarray(self.shape / self.modal_amplitude[:, np.newaxis])

    @cached_property
    def participation(self) -> ComplexArray:
        """Γ = Φ⁺φ̃₁, shape ``(sets, modes)``."""
        return np.asarray(self.coordinates / self.modal_amplitude[:, np.newaxis])


def modal_quantities(
    omega: FloatArray,
    force: ComplexArray,
    drive_displacement: ComplexArray,
    drive_acceleration: ComplexArray,
    shape: ComplexArray,
    linear_shapes: FloatArray,
    target_mode: int,
) -> ModalQuantities:
    """Powers, damping, amplitude and mode indicators of harmonics.

    Args:
        omega: ω̃, rad/s, shape ``(sets,)``.
        force: F_n of every exciter, N, shape ``(sets, exciters, H + 1)``.
        drive_displacement: ψ̃_k,n at their points, m, same shape.
        drive_acceleration: acceleration harmonics at the drive point, m/s², shape ``(sets, H + 1)``.
        shape: fundamental ψ̃₁ at the points of Φ, m, shape ``(sets, points)``.
        linear_shapes: mass-normalised Φ, 1/√kg, shape ``(points, modes)``.
        target_mode: index of the mode under test.

    Returns:
        The quantities, SI units.

    Raises:
        BenchError: force or response vanish.
    """
    orders = np.arange(1, force.shape[-1])
    values = ModalQuantities(
        omega=omega,
        force=force[..., 1:],
        velocity=1j * orders * omega[:, np.newaxis, np.newaxis] * drive_displacement[..., 1:],
        drive_acceleration=drive_acceleration[:, 1:],
        shape=shape,
        linear_shape=linear_shapes[:, target_mode],
        coordinates=(np.linalg.pinv(linear_shapes) * shape[:, np.newaxis, :]).sum(axis=2),
    )
    # Phase and amplitude of nothing are meaningless; rounding of zero signals stays far below.
    drive = np.abs(values.velocity[:, 0, 0])
    if not (np.all(values.modal_amplitude > 0.0) and np.all(values.force_n > 0.0) and np.all(drive > 0.0)):
        raise BenchError("No force or no response was measured at the excitation frequency; check sensors and drive.")
    return values
