"""Dampers whose force has no corners."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from nmt_rig.model.element_uses import ElementEffect, LawForm
from nmt_rig.model.local_elements.element import ElementSection, LocalElement, Response
from nmt_rig.rig_section import NotNegative, Positive


@dataclass(frozen=True)
class LinearDamper(LocalElement):
    """g = c v; damping in N s/m."""

    damping: float
    degree: ClassVar[int] = 1

    @staticmethod
    def response(c: float, w: float, v: float) -> Response:
        """g and its tangents."""
        return c * v, 0.0, c


class LinearDamperSection(ElementSection):
    """g = c v.

    Attributes:
        damping_ns_m: c
    """

    kind: Literal["linear_damper"]
    damping_ns_m: float
    element: ClassVar = LinearDamper
    effect: ClassVar = ElementEffect(
        "viscous_damping", "c v", "linear damper", {"c": "damping_ns_m"}, lambda k, a, w: k / w, 0.005, 0.002,
        equivalents={"structural_damping": "several modes in a random test"},
    )  # fmt: skip
    without_law: ClassVar = "a linear force is an error of the modes"


@dataclass(frozen=True)
class QuadraticDrag(LocalElement):
    """g = c2 v |v|; c2 in N s²/m²."""

    drag: float
    samples: ClassVar[tuple[int, int]] = (1024, 256)  # a kink in the second derivative

    @staticmethod
    def response(c: float, w: float, v: float) -> Response:
        """g and its tangents."""
        return c * v * abs(v), 0.0, 2.0 * c * abs(v)


class QuadraticDragSection(ElementSection):
    """g = c₂ v |v|.

    Attributes:
        drag_ns2_m2: c₂
    """

    kind: Literal["quadratic_drag"]
    drag_ns2_m2: float
    element: ClassVar = QuadraticDrag
    effect: ClassVar = ElementEffect(
        "air_drag", "c₂ v |v|, |c₂| ≤ ½ ρ C_d A",
        "Baker, Woolam and Young, Int. J. Mech. Sci. 9 (1967) 743; Keulegan and Carpenter, "
        "J. Res. Natl. Bur. Stand. 60 (1958) 423",
        {"c2": "drag_ns2_m2"}, lambda k, a, w: k / (w**2 * a), 0.005, 0.002,
    )  # fmt: skip
    without_law: ClassVar = "the term of power_law_damper has its exponent, too"


@dataclass(frozen=True)
class AmplitudeDamper(LocalElement):
    """g = c w² v; damping that grows with the square of the amplitude, c in N s/m³.

    The nonlinear term of the van der Pol equation; of its kind is the damping of large bending of slender beams
    (Zaitsev et al., Nonlinear Dyn. 67 (2012) 859).
    """

    damping: float
    degree: ClassVar[int] = 3

    @staticmethod
    def response(c: float, w: float, v: float) -> Response:
        """g and its tangents."""
        return c * w * w * v, 2.0 * c * w * v, c * w * w


class AmplitudeDamperSection(ElementSection):
    """g = c w² v: damping that grows with the square of the amplitude (van der Pol type).

    Attributes:
        damping_ns_m3: c
    """

    kind: Literal["amplitude_damper"]
    damping_ns_m3: float
    element: ClassVar = AmplitudeDamper
    effect: ClassVar = ElementEffect(
        "amplitude_damping", "c x² v", "Zaitsev et al., Nonlinear Dyn. 67 (2012) 859", {"c": "damping_ns_m3"},
        lambda k, a, w: k / (w * a**2), 0.02, 0.005,
    )  # fmt: skip
    law: ClassVar = (
        LawForm(
            "amplitude", "amplitude damping", "|x|{power} v", lambda c, *_: (c,), "damping that grows with amplitude",
            exponent=2.0,
        ),
    )  # fmt: skip


@dataclass(frozen=True)
class PolynomialDamper(LocalElement):
    """g = (c0 + c2 w² + c4 w⁴) v; damping that depends on the displacement, c0 in N s/m, c2 in N s/m³, c4 in N s/m⁵.

    With c0 < 0 < c2 that of the van der Pol equation; with c2 < 0 < c0, c4 a rest that is stable next to a limit cycle
    (subcritical Hopf bifurcation).
    """

    constant: float
    square: float
    fourth: float
    degree: ClassVar[int] = 5

    @staticmethod
    def response(c0: float, c2: float, c4: float, w: float, v: float) -> Response:
        """g and its tangents."""
        w2 = w * w
        damping = c0 + w2 * (c2 + w2 * c4)
        return damping * v, 2.0 * w * (c2 + 2.0 * c4 * w2) * v, damping


class PolynomialDamperSection(ElementSection):
    """g = (c₀ + c₂ w² + c₄ w⁴) v: negative where it feeds the motion.

    Attributes:
        damping_ns_m: c₀; below zero the rest is unstable (van der Pol with c₂ above zero)
        damping_ns_m3: c₂; below zero, with the others above, a limit cycle around a stable rest
        damping_ns_m5: c₄
    """

    kind: Literal["polynomial_damper"]
    damping_ns_m: float
    damping_ns_m3: float = 0.0
    damping_ns_m5: float = 0.0
    element: ClassVar = PolynomialDamper
    without_effect: ClassVar = "a sum: viscous_damping and amplitude_damping are its parts"
    without_law: ClassVar = "a sum: amplitude_damper has its term"


@dataclass(frozen=True)
class PowerLawDamper(LocalElement):
    """g = c |v|ᵖ sgn v; coefficient c in N (s/m)ᵖ, exponent p ≥ 1 (Ruzicka and Derby 1971, section 2).

    At p = 1 a linear damper, at p = 2 quadratic drag.

    Raises:
        ValueError: an exponent below 1, whose tangent at rest is infinite.
    """

    coefficient: float
    exponent: float
    samples: ClassVar[tuple[int, int]] = (2048, 512)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.exponent < 1.0:
            raise ValueError(f"{type(self).__name__}: exponent must be at least 1, got {self.exponent}")

    @staticmethod
    def response(c: float, p: float, w: float, v: float) -> Response:
        """g and its tangents."""
        tangent = c * abs(v) ** (p - 1.0)
        return tangent * v, 0.0, p * tangent


class PowerLawDamperSection(ElementSection):
    """g = c |v|ᵖ sgn v.

    Attributes:
        coefficient_n_sp_mp: c, N sᵖ/mᵖ
        exponent: p; 1 = linear damper, 2 = quadratic drag
    """

    kind: Literal["power_law_damper"]
    coefficient_n_sp_mp: float
    exponent: Annotated[float, Field(ge=1, le=10)]
    element: ClassVar = PowerLawDamper
    not_calibrated: ClassVar = ("exponent",)
    effect: ClassVar = ElementEffect(
        "power_law_damping", "F (|v|/v₀)ᵖ sgn v, p = 1 + excess, v₀ the largest speed",
        "Ruzicka and Derby, Influence of Damping in Vibration Isolation (1971)",
        {"force": "coefficient_n_sp_mp", "excess": "exponent"}, lambda k, a, w: k * a, 0.005, 0.002, starts=(0.5, 2.0),
    )  # fmt: skip
    law: ClassVar = (
        LawForm(
            "speed", "drag", "|v|{power} sgn v", lambda c, p, _: (c, p), "damping that grows with speed",
            "N (s/m)^{exponent}", starts=(1.5, 2.0, 3.0),
            effect=lambda c, p: ("air_drag", {"c2": c}) if p == 2.0 else None,
        ),
    )  # fmt: skip


@dataclass(frozen=True)
class EddyBrake(LocalElement):
    """g = c v / (1 + (v / v_c)²): the force of an eddy-current brake falls beyond its critical velocity (m/s).

    At v ≤ 100 v_c its harmonics of order n fall at least as exp(−n / 100), so that 1024 samples leave errors of 4e-5.
    """

    damping: float
    critical_velocity: float
    samples: ClassVar[tuple[int, int]] = (2048, 1024)
    must_be_positive: ClassVar[tuple[str, ...]] = ("critical_velocity",)

    @staticmethod
    def response(c: float, critical: float, w: float, v: float) -> Response:
        """g and its tangents."""
        ratio = v / critical
        share = 1.0 / (1.0 + ratio * ratio)
        return c * v * share, 0.0, c * share * share * (1.0 - ratio * ratio)


class EddyBrakeSection(ElementSection):
    """g = c v / (1 + (v / v_c)²).

    Attributes:
        damping_ns_m: c
        critical_velocity_m_s: v_c, where the force is largest
    """

    kind: Literal["eddy_brake"]
    damping_ns_m: NotNegative
    critical_velocity_m_s: Positive
    element: ClassVar = EddyBrake
    not_calibrated: ClassVar = ("critical_velocity_m_s",)
    without_effect: ClassVar = "the law has its term"
    law: ClassVar = (
        LawForm(
            "brake", "brake", "v / (1 + (v / {size} m/s)²)", lambda c, v, _: (c, v), "damping that falls with speed",
            by_speed=True, starts=tuple(np.geomspace(0.05, 1.0, 8)),
        ),
    )  # fmt: skip


AnyDamper = (
    QuadraticDragSection
    | AmplitudeDamperSection
    | PolynomialDamperSection
    | PowerLawDamperSection
    | EddyBrakeSection
    | LinearDamperSection
)
