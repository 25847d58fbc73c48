"""The modal properties of one level, with their uncertainties: the record of ``nmt_msgs/ModalPoint``."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields

import numpy as np

from nmt_core.numerics.arrays import ComplexArray
from nmt_core.vocabulary import PointStatus

EVALUATED = (
    "damping_ratio",
    "modal_amplitude",
    "self_excitation",
    "force_n",
    "active_power",
    "apparent_power",
    "pbmif",
    "gamma_force",
    "gamma_acceleration",
    "mac",
    "phase_error",
)
"""Names of the quantities that ``modal_quantities`` evaluates for the window and for each of its parts."""

MEASURED = ("frequency_hz", "omega_rad_s", *EVALUATED, "hysteresis_damping")
"""Names of the measured quantities; each has a companion ``<name>_std``."""

COMPLEX = ("force_harmonics", "shape_harmonics", "normalised_shape", "participation")
"""Names of the complex arrays."""


def _empty() -> ComplexArray:
    return np.empty(0, dtype=np.complex128)


def _empty_rows() -> ComplexArray:
    return np.empty((0, 0), dtype=np.complex128)


@dataclass(frozen=True, eq=False)
class ModalPoint:
    """Modal properties of one locked window (paper, sections 2.2 and 2.3), or why there are none.

    ``<name>_std`` is the standard uncertainty of ``<name>``; NaN = could not be estimated. All measured
    values of a point whose status is not ``OK`` are NaN and its arrays are empty. The time origin of the
    complex arrays is chosen so that the target mode's participation is real and positive; the force then
    leads by about +90°.

    Attributes:
        level_index: level number in the plan.
        status: what became of the level.
        reason: one sentence why there are no values, or which channels were left out of them and why; else empty.
        level: target amplitude, in ``level_unit``.
        level_unit: V, N, m or m/s^2.
        time_ns: bench time of the last sample of the window, ns.
        window_first_sample: first sample of the window.
        window_samples: number of samples.
        window_periods: whole periods.
        frequency_hz: locked excitation frequency, Hz.
        omega_rad_s: modal frequency ω̃, rad/s.
        damping_ratio: δ̃, 1.
        modal_amplitude: q, m√kg.
        self_excitation: ξ, rad/s.
        force_n: fundamental force amplitude |F₁|, N.
        active_power: P₁, W; positive when the exciter feeds the structure.
        apparent_power: S over all harmonics, W.
        pbmif: |P|/S over all harmonics, 1.
        gamma_force: fundamental content of the force, 1.
        gamma_acceleration: fundamental content of the drive-point acceleration, 1.
        mac: correlation of the fundamental shape with the linear mode shape, 1.
        phase_error: arg F₁ − arg(iω̃ψ̃_k,1), deviation of force from velocity phase at the drive point, rad.
        hysteresis_damping: δ_hyst, 1; NaN where the rig has no such evaluation.
        harmonics: H.
        points: measurement points of the columns of ``shape_harmonics``.
        force_harmonics: F_n, N, shape ``(H + 1,)``.
        shape_harmonics: ψ̃_n, m, shape ``(H + 1, points)``; row 0 is NaN where accelerometers do not see it.
        normalised_shape: φ̃₁, 1/√kg, shape ``(points,)``.
        participation: Γ, shape ``(modes,)``.
        harmonics_control: harmonics 2 to this one of the force were controlled; 0 = none, 1 = as many as could be.
    """

    level_index: int
    status: PointStatus
    reason: str
    level: float
    level_unit: str
    time_ns: int = 0
    window_first_sample: int = 0
    window_samples: int = 0
    window_periods: int = 0
    frequency_hz: float = math.nan
    frequency_hz_std: float = math.nan
    omega_rad_s: float = math.nan
    omega_rad_s_std: float = math.nan
    damping_ratio: float = math.nan
    damping_ratio_std: float = math.nan
    modal_amplitude: float = math.nan
    modal_amplitude_std: float = math.nan
    self_excitation: float = math.nan
    self_excitation_std: float = math.nan
    force_n: float = math.nan
    force_n_std: float = math.nan
    active_power: float = math.nan
    active_power_std: float = math.nan
    apparent_power: float = math.nan
    apparent_power_std: float = math.nan
    pbmif: float = math.nan
    pbmif_std: float = math.nan
    gamma_force: float = math.nan
    gamma_force_std: float = math.nan
    gamma_acceleration: float = math.nan
    gamma_acceleration_std: float = math.nan
    mac: float = math.nan
    mac_std: float = math.nan
    phase_error: float = math.nan
    phase_error_std: float = math.nan
    hysteresis_damping: float = math.nan
    hysteresis_damping_std: float = math.nan
    harmonics: int = 0
    points: tuple[int, ...] = ()
    force_harmonics: ComplexArray = field(default_factory=_empty)
    shape_harmonics: ComplexArray = field(default_factory=_empty_rows)
    normalised_shape: ComplexArray = field(default_factory=_empty)
    participation: ComplexArray = field(default_factory=_empty)
    harmonics_control: int = 0

    def __post_init__(self) -> None:
        for name in COMPLEX:
            array = np.array(getattr(self, name), dtype=np.complex128)
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    def identical(self, other: ModalPoint) -> bool:
        """Whether all fields agree bit for bit (NaN equals NaN)."""
        for item in fields(self):
            mine, theirs = getattr(self, item.name), getattr(other, item.name)
            if isinstance(mine, np.ndarray):
                if mine.shape != theirs.shape or mine.tobytes() != theirs.tobytes():
                    return False
            elif isinstance(mine, float) and math.isnan(mine):
                if not math.isnan(theirs):
                    return False
            elif mine != theirs:
                return False
        return True
