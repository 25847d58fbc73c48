"""Ratio of the force's harmonics to their fundamental that modal power needs.

A nonlinear mode of the extended periodic motion concept is driven by ξ M ẋ: each harmonic of the motion gets the power
P_n = ½ ξ (n ω)² ψ_nᴴ M ψ_n. One exciter cannot give the distribution, but it can give the power: with v_n the velocity
of the drive point, force F_n of the phase of v_n does it with the least force,

    F_n = 2 P_n v_n / |v_n|²,   P_n / P_1 = n² η_nᴴ η_n / (η_1ᴴ η_1),   η = Φ⁺ ψ.

Where the drive point hardly moves at n ω, that force would be as great as one likes; it is kept below a share of the
fundamental.
"""

from __future__ import annotations

import math

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_core.messages.linear_description import LinearDescription
from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_core.vocabulary import MOTIONS
from nmt_pll.force_control.force_targets import ForceTargets
from nmt_pll.thresholds import HARMONICS


def check_modes(linear: LinearDescription, where: str) -> None:
    """Refuse (BenchError) a linear description with fewer modes than the modal target needs."""
    modes = len(linear.frequencies_rad_s)
    least = HARMONICS.modal_target_modes
    if modes < least:
        raise BenchError(
            f"{where}: the target modal needs a linear description of {least} modes, this one has {modes}; use the "
            f"target force, or give extraction.linear_modes (or the linear test) {least} modes."
        )
    if len(linear.points) < least or linear.drive_point not in linear.points:
        raise BenchError(
            f"{where}: the target modal needs responses at {least} points, one of them the drive point "
            f"{linear.drive_point}; this linear description has points {', '.join(map(str, linear.points))}."
        )


class ModalPowerRatio(ForceTargets):
    """Targets of the harmonics of one exciter's force from the measured motion.

    Args:
        linear: linear description with three modes or more.
        rate: by which the ratio follows what is measured, 1/s; infinite = at once.

    Raises:
        BenchError: as `check_modes`.
    """

    def __init__(self, linear: LinearDescription, rate: float = math.inf) -> None:
        check_modes(linear, "The harmonics of the force")
        self.points = linear.points
        self._rate = rate
        self._drive = linear.points.index(linear.drive_point)
        self._to_modes: FloatArray = np.asarray(np.linalg.pinv(linear.shape_matrix), dtype=np.float64)
        self._ratio: ComplexArray | None = None

    def clear(self) -> None:
        """Forget what was measured."""
        self._ratio = None

    def targets(self, force: ComplexArray, response: ComplexArray, quantity: Quantity, duration: float) -> ComplexArray:
        """As of the base class; harmonics are zero where the exciter takes power out of the fundamental."""
        target = super().targets(force, response, quantity, duration)
        share = min(1.0, self._rate * duration)
        target[0, 1:] = self._harmonics(force[0], response, quantity, share)
        return target

    def _harmonics(self, force: ComplexArray, response: ComplexArray, quantity: Quantity, share: float) -> ComplexArray:
        """F_2* … F_H*, shape (H - 1,), where the ratio follows by a share of its deviation."""
        order = np.arange(1, force.size + 1)
        motion = response / (1j * order) ** MOTIONS[quantity]  # displacements, but for a factor they share
        velocity = 1j * order * motion[self._drive]
        modal = np.sum(np.abs(self._to_modes @ motion) ** 2, axis=0)
        fundamental = float((force[0] * velocity[0].conjugate()).real)
        if not (fundamental > 0.0 and modal[0] > 0.0):
            return np.zeros(force.size - 1, complex)
        power = fundamental * order**2 * modal / modal[0]
        ratio = (power * velocity / np.maximum(np.abs(velocity) ** 2, 1e-300) / force[0])[1:]
        ratio *= np.minimum(1.0, HARMONICS.largest_target_ratio / np.maximum(np.abs(ratio), 1e-300))
        before = np.zeros_like(ratio) if self._ratio is None else self._ratio
        self._ratio = before + share * (ratio - before)
        return np.asarray(self._ratio * force[0], dtype=np.complex128)
