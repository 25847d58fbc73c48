"""The modal properties of one level, with their uncertainties: the record of ``nmt_msgs/ModalPoint``."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields

import numpy as np

from nmt_core.messages.modal_quantity import Powers, TableColumn, measured, quantities_of
from nmt_core.numerics.arrays import ComplexArray
from nmt_core.vocabulary import PointStatus

COMPLEX = ("force_harmonics", "shape_harmonics", "normalised_shape", "participation", "exciter_forces")
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
    leads by about +90°. What each measured quantity is, its unit and where it is shown stands with its field and in
    :data:`QUANTITIES`. A new one goes behind the others, so that ``modal.csv`` keeps the order of its columns.

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
        harmonics: H.
        points: measurement points of the columns of ``shape_harmonics``.
        force_harmonics: F_n, N, shape ``(H + 1,)``.
        shape_harmonics: ψ̃_n, m, shape ``(H + 1, points)``; row 0 is NaN where accelerometers do not see it.
        normalised_shape: φ̃₁, 1/√kg, shape ``(points,)``.
        participation: Γ, shape ``(modes,)``.
        harmonics_control: harmonics 2 to this one of the force were controlled; 0 = none, 1 = as many as could be.
        response_order, force_order: k and ν of a secondary resonance; values are those of the order k, n counts in
            ``frequency_hz`` / k, see :mod:`nmt_core.messages.secondary_resonance`; 0 = phase resonance.
        held_phase: phase by which the loop let the force lead the velocity of the drive point, rad; 0 = phase
            resonance. At other phases ``frequency_hz`` is that of the excitation.
        parameter: what was held next to the amplitude, a :class:`~nmt_core.vocabulary.CurveParameter`.
        exciter_points: measurement points of several exciters, the first's first; empty = one exciter.
        exciter_forces: F_jn of several exciters, N, one exciter's 0..H after the other's; the powers are those of
            all.
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
    frequency_hz: float = measured(
        "Hz",
        "modal frequency f̃ = ω̃/2π",
        csv=True,
        from_harmonics=False,
        axis="modal frequency / Hz",
    )
    frequency_hz_std: float = math.nan
    omega_rad_s: float = measured(
        "rad/s",
        "modal frequency ω̃",
        csv=True,
        from_harmonics=False,
        axis="modal frequency / (rad/s)",
        column=TableColumn("f̃", unit="Hz", factor=0.5 / math.pi, rank=1, live=True),
    )
    omega_rad_s_std: float = math.nan
    damping_ratio: float = measured(
        "1",
        "modal damping ratio δ̃",
        csv=True,
        powers=Powers(force=1, drive=1, shape=-2),
        axis="modal damping ratio",
        column=TableColumn("δ̃", unit="%", factor=100.0, decimals=3, rank=1, live=True),
    )
    damping_ratio_std: float = math.nan
    modal_amplitude: float = measured(
        "m√kg",
        "modal amplitude q",
        csv=True,
        powers=Powers(shape=1),
        axis="modal amplitude / (m√kg)",
        column=TableColumn("q", "<i>q</i>", unit="m√kg", scaled=True, rank=1, live=True),
    )
    modal_amplitude_std: float = math.nan
    self_excitation: float = measured(
        "rad/s", "factor ξ of the artificial negative damping", powers=Powers(force=1, drive=1, shape=-2)
    )
    self_excitation_std: float = math.nan
    force_n: float = measured(
        "N",
        "amplitude of the fundamental of the force, |F₁|",
        csv=True,
        powers=Powers(force=1),
        axis="force / N",
        column=TableColumn("|F₁|", "|<i>F</i><sub>1</sub>|", unit="N", rank=2, live=True),
    )
    force_n_std: float = math.nan
    active_power: float = measured(
        "W",
        "active power P₁ of the fundamental; positive when the exciter feeds the structure",
        powers=Powers(force=1, drive=1),
    )
    active_power_std: float = math.nan
    apparent_power: float = measured("W", "apparent power S over all harmonics", powers=Powers(force=1, drive=1))
    apparent_power_std: float = math.nan
    pbmif: float = measured(
        "1",
        "mode indicator |P|/S over all harmonics",
        csv=True,
        powers=Powers(force=1, drive=1),
        second_order=True,
        axis="PBMIF",
        panel="PBMIF",
        column=TableColumn("PBMIF", rank=2, live=True),
    )
    pbmif_std: float = math.nan
    gamma_force: float = measured(
        "1",
        "fundamental content of the force",
        csv=True,
        powers=Powers(force=1),
        second_order=True,
        axis="fundamental content of the force",
        panel=r"$\gamma_F$ (force)",
        column=TableColumn("γ_F", "γ<sub><i>F</i></sub>", rank=4),
    )
    gamma_force_std: float = math.nan
    gamma_acceleration: float = measured(
        "1",
        "fundamental content of the drive-point acceleration",
        csv=True,
        powers=Powers(drive=1),
        second_order=True,
        axis="fundamental content of the acceleration",
        panel=r"$\gamma_A$ (acceleration)",
        column=TableColumn("γ_A", "γ<sub><i>A</i></sub>", rank=5),
    )
    gamma_acceleration_std: float = math.nan
    mac: float = measured(
        "1",
        "correlation of the fundamental shape with the linear mode shape",
        csv=True,
        powers=Powers(shape=1),
        second_order=True,
        axis="MAC",
        panel="MAC",
        column=TableColumn("MAC", decimals=5, rank=3, live=True),
    )
    mac_std: float = math.nan
    phase_error: float = measured(
        "rad", "arg F₁ − arg(iω̃ψ̃_k,1), deviation of the force from the phase of the velocity at the drive point"
    )
    phase_error_std: float = math.nan
    hysteresis_damping: float = measured(
        "1",
        "damping ratio from hysteresis loops, δ_hyst; NaN where the rig has no such evaluation",
        from_harmonics=False,
        column=TableColumn(
            "δ_hyst",
            "δ<sub>hyst</sub>",
            unit="%",
            factor=100.0,
            decimals=3,
            optional=True,
            after="damping_ratio",
            rank=1,
        ),
    )
    hysteresis_damping_std: float = math.nan
    floquet_growth: float = measured(
        "1/s",
        "largest real part of the Floquet exponents of the orbit in open loop; NaN where the drive was not perturbed",
        from_harmonics=False,
        column=TableColumn("Re λ", "Re <i>λ</i>", unit="1/s", optional=True, rank=2),
    )
    floquet_growth_std: float = math.nan
    floquet_frequency: float = measured(
        "rad/s", "size of the imaginary part of these exponents; 0 = they are real", from_harmonics=False
    )
    floquet_frequency_std: float = math.nan
    floquet_second_growth: float = measured("1/s", "the other real part of these exponents", from_harmonics=False)
    floquet_second_growth_std: float = math.nan
    harmonics: int = 0
    points: tuple[int, ...] = ()
    force_harmonics: ComplexArray = field(default_factory=_empty)
    shape_harmonics: ComplexArray = field(default_factory=_empty_rows)
    normalised_shape: ComplexArray = field(default_factory=_empty)
    participation: ComplexArray = field(default_factory=_empty)
    harmonics_control: int = 0
    response_order: int = 0
    force_order: int = 0
    exciter_points: tuple[int, ...] = ()
    exciter_forces: ComplexArray = field(default_factory=_empty)
    held_phase: float = 0.0
    parameter: int = 0

    def __post_init__(self) -> None:
        for name in COMPLEX:
            array = np.array(getattr(self, name), dtype=np.complex128)
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    @property
    def excitation_frequency_hz(self) -> float:
        """Ω/2π, Hz: ν/k times the modal frequency in a secondary resonance, else the modal frequency."""
        return self.frequency_hz * (self.force_order or 1) / (self.response_order or 1)

    @property
    def excitation_frequency_hz_std(self) -> float:
        """Repeatability of ``excitation_frequency_hz``, Hz."""
        return self.frequency_hz_std * (self.force_order or 1) / (self.response_order or 1)

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


QUANTITIES = tuple(quantities_of(ModalPoint))
"""The measured quantities in the order of the record."""

MEASURED = tuple(quantity.name for quantity in QUANTITIES)
"""Names of the measured quantities; each has a companion ``<name>_std``."""

EVALUATED = tuple(quantity.name for quantity in QUANTITIES if quantity.from_harmonics)
"""Names of the quantities that are evaluated for the window and for each of its parts."""

ANGLES = tuple(quantity.name for quantity in QUANTITIES if quantity.unit == "rad")
"""Names of those of which whole turns do not count."""
