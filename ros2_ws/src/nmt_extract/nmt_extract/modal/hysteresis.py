"""Damping ratio from the hysteresis loop of a joint between lumped masses (method, eq. 8).

For a chain m₁ –leaf spring– m₂ –joint– m₃ driven at m₁. It does not belong to the modal method: it needs the
masses and works for lumped systems only, so it serves as a check on them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.messages.modal_point import ModalPoint
from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_core.vocabulary import PointStatus

_SAMPLES = 4096


@dataclass(frozen=True)
class HysteresisLayout:
    """Where the masses of the chain are measured.

    Attributes:
        excited_point: measurement point of m₁, the driven mass.
        middle_point: of m₂, between leaf spring and joint.
        free_point: of m₃, beyond the joint.
        excited_mass_kg: m₁, kg.
        free_mass_kg: m₃, kg.
    """

    excited_point: int
    middle_point: int
    free_point: int
    excited_mass_kg: float
    free_mass_kg: float

    def __post_init__(self) -> None:
        for name in ("excited_mass_kg", "free_mass_kg"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0.0 < value < math.inf:
                raise BenchError(f"Hysteresis layout: '{name}' must be a mass above 0 kg, got {value!r}.")
        if len({self.excited_point, self.middle_point, self.free_point}) != 3:
            raise BenchError("Hysteresis layout: the three masses must be measured at three different points.")

    def to_mapping(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {name: getattr(self, name) for name in self.__dataclass_fields__}

    @classmethod
    def from_mapping(cls, values: Mapping[str, Any]) -> HysteresisLayout:
        """Build from parsed JSON.

        Raises:
            BenchError: a key is missing, unknown or a value not acceptable.
        """
        try:
            return cls(**values)
        except TypeError as error:
            raise BenchError(
                f"The hysteresis layout must name {', '.join(cls.__dataclass_fields__)} and nothing else."
            ) from error


@dataclass(frozen=True, eq=False)
class HysteresisLoop:
    """Joint loop and energies of one window.

    Attributes:
        relative_displacement: x₃ − x₂ over one period, m, shape ``(samples,)``.
        force: tangential force of the joint in the sense of a spring's restoring force, −m₃ẍ₃, N.
        dissipated_work: area of the loop, J a cycle.
        potential_energy: largest potential energy of joint and leaf spring, J.
    """

    relative_displacement: FloatArray
    force: FloatArray
    dissipated_work: float
    potential_energy: float

    @property
    def damping_ratio(self) -> float:
        """δ_hyst = W_diss / (4π E_pot,max)."""
        return self.dissipated_work / (4.0 * math.pi * self.potential_energy)


def hysteresis_loop(
    layout: HysteresisLayout,
    omega: float,
    accelerations: tuple[ComplexArray, ComplexArray, ComplexArray],
    force: ComplexArray,
) -> HysteresisLoop:
    """Loop of the joint from acceleration and force harmonics.

    The mean (n = 0) is left out: accelerometers do not see it. Integration is done harmonic by harmonic. The
    potential energy is taken along the loop's midline, which for a linear spring with a damper gives k x²/2
    exactly.

    Args:
        layout: masses.
        omega: fundamental frequency, rad/s.
        accelerations: harmonics 0..H of ẍ₁, ẍ₂, ẍ₃, m/s², shape ``(H + 1,)`` each.
        force: harmonics 0..H of the excitation force on m₁, N, shape ``(H + 1,)``.

    Returns:
        Loop, dissipated work and potential energy.

    Raises:
        BenchError: the masses do not move against each other.
    """
    first, middle, free = accelerations
    orders = np.arange(1, first.shape[0])
    twice_integrated = -1.0 / (orders * omega) ** 2
    relative = (free - middle)[1:] * twice_integrated
    stretch = (middle - first)[1:] * twice_integrated
    joint_force = -layout.free_mass_kg * free[1:]
    spring_force = layout.excited_mass_kg * first[1:] - force[1:]
    if not np.abs(relative[0]) > 0.0 or not np.abs(stretch[0]) > 0.0:
        raise BenchError("The masses do not move against each other, so they have no hysteresis loop.")
    # Area of the loop: ∮ f dx = π Σ n Im(f_n conj(x_n)).
    work = float(np.pi * (orders * (np.conj(relative) * joint_force).imag).sum())
    rotation = _rotation(orders.size)
    x_rel, f_t = (rotation @ relative).real, (rotation @ joint_force).real
    x_k, f_k = (rotation @ stretch).real, (rotation @ spring_force).real
    energy = _midline_energy(x_rel, f_t) + _midline_energy(x_k, f_k)
    return HysteresisLoop(x_rel, f_t, work, energy)


@cache
def _rotation(harmonics: int) -> ComplexArray:
    """exp(2πi n k / samples) of harmonics n = 1 … ``harmonics``, shape ``(samples, harmonics)``."""
    return np.asarray(np.exp(2j * np.pi * np.outer(np.arange(_SAMPLES) / _SAMPLES, np.arange(1, harmonics + 1))))


def loop_of_point(layout: HysteresisLayout, point: ModalPoint) -> HysteresisLoop | None:
    """Loop of a modal point, from its harmonics; None where it has none.

    The displacements ψ̃_n of the point take the place of accelerations, a_n = -(n ω̃)² ψ̃_n. Where the extraction
    took its shape from accelerometers, the loop is the one that gave ``hysteresis_damping``.
    """
    wanted = (layout.excited_point, layout.middle_point, layout.free_point)
    if point.status != PointStatus.OK or not set(wanted) <= set(point.points):
        return None
    orders = np.arange(point.harmonics + 1)
    square = -((orders * point.omega_rad_s) ** 2)
    rows = [point.points.index(number) for number in wanted]
    first, middle, free = (
        np.asarray(square * np.nan_to_num(point.shape_harmonics[:, row]), dtype=np.complex128) for row in rows
    )
    return hysteresis_loop(layout, point.omega_rad_s, (first, middle, free), point.force_harmonics)


def _midline_energy(displacement: FloatArray, force: FloatArray) -> float:
    """∫ f dx from 0 to the largest displacement, mean of the loading and the unloading branch, J."""
    peak = int(np.argmax(displacement))
    twice = np.concatenate((displacement, displacement)), np.concatenate((force, force))
    size = displacement.shape[0]
    away = twice[0][peak : peak + size], twice[1][peak : peak + size]
    back = twice[0][: peak + size + 1][::-1][: size + 1], twice[1][: peak + size + 1][::-1][: size + 1]
    return 0.5 * (_energy_to_zero(*away) + _energy_to_zero(*back))


def _energy_to_zero(displacement: FloatArray, force: FloatArray) -> float:
    below = np.flatnonzero(displacement <= 0.0)
    if below.shape[0] == 0:
        raise BenchError("A hysteresis loop that does not pass zero displacement cannot be evaluated.")
    end = int(below[0])
    x, f = displacement[: end + 1].copy(), force[: end + 1].copy()
    share = x[end - 1] / (x[end - 1] - x[end])
    f[end] = f[end - 1] + share * (f[end] - f[end - 1])
    x[end] = 0.0
    return float((0.5 * (f[1:] + f[:-1]) * (x[:-1] - x[1:])).sum())
