"""Springs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from nmt_rig.model.element_uses import ElementEffect, LawForm
from nmt_rig.model.local_elements.element import ElementSection, LocalElement, Response
from nmt_rig.rig_section import Positive

_RAISED = str.maketrans("23456789", "²³⁴⁵⁶⁷⁸⁹")


def spring_effect(name: str, power: int, share: float, drawn_share: float, even: float = 0.0) -> ElementEffect:
    """The effect of a spring whose force is a power of the displacement, with the key ``stiffness_n_m<power>``."""
    return ElementEffect(
        name, f"k x{power}".translate(_RAISED), "Nayfeh and Mook, Nonlinear Oscillations (1979)",
        {"k": f"stiffness_n_m{power}"}, lambda k, a, w: k / a ** (power - 1), share, drawn_share,
        signed=True, even=even,
    )  # fmt: skip


def power_term(power: int) -> tuple[LawForm]:
    """The term of a law of such a spring."""
    return (LawForm("power", "polynomial", "x{power}", lambda c, *_: (c,), exponent=float(power), signed=True),)


@dataclass(frozen=True)
class LinearSpring(LocalElement):
    """g = k w; stiffness in N/m."""

    stiffness: float
    degree: ClassVar[int] = 1

    @staticmethod
    def response(k: float, w: float, v: float) -> Response:
        """g and its tangents."""
        return k * w, k, 0.0


class LinearSpringSection(ElementSection):
    """g = k w.

    Attributes:
        stiffness_n_m: k
    """

    kind: Literal["linear_spring"]
    stiffness_n_m: float
    element: ClassVar = LinearSpring
    effect: ClassVar = ElementEffect(
        "added_stiffness", "k x", "Ewins, Modal Testing (2000)", {"k": "stiffness_n_m"}, lambda k, a, w: k, 0.03, 0.03,
        signed=True, equivalents={
            "second_friction_contact": "higher levels, at which the contact slips",
            "clamp_compliance": "several modes in a random test",
        },
    )  # fmt: skip
    without_law: ClassVar = "a linear force is an error of the modes"


@dataclass(frozen=True)
class QuadraticSpring(LocalElement):
    """g = k2 w²; stiffness in N/m²."""

    stiffness: float
    degree: ClassVar[int] = 2

    @staticmethod
    def response(k: float, w: float, v: float) -> Response:
        """g and its tangents."""
        return k * w * w, 2.0 * k * w, 0.0


class QuadraticSpringSection(ElementSection):
    """g = k₂ w².

    Attributes:
        stiffness_n_m2: k₂
    """

    kind: Literal["quadratic_spring"]
    stiffness_n_m2: float
    element: ClassVar = QuadraticSpring
    effect: ClassVar = spring_effect("quadratic_stiffness", 2, 0.05, 0.01, even=4.0)
    law: ClassVar = power_term(2)


@dataclass(frozen=True)
class CubicSpring(LocalElement):
    """g = k3 w³; stiffness in N/m³."""

    stiffness: float
    degree: ClassVar[int] = 3

    @staticmethod
    def response(k: float, w: float, v: float) -> Response:
        """g and its tangents."""
        return k * w * w * w, 3.0 * k * w * w, 0.0


class CubicSpringSection(ElementSection):
    """g = k₃ w³.

    Attributes:
        stiffness_n_m3: k₃; negative softens
    """

    kind: Literal["cubic_spring"]
    stiffness_n_m3: float
    element: ClassVar = CubicSpring
    effect: ClassVar = spring_effect("cubic_stiffness", 3, 0.02, 0.01)
    law: ClassVar = power_term(3)


@dataclass(frozen=True)
class QuinticSpring(LocalElement):
    """g = k5 w⁵; stiffness in N/m⁵."""

    stiffness: float
    degree: ClassVar[int] = 5

    @staticmethod
    def response(k: float, w: float, v: float) -> Response:
        """g and its tangents."""
        w2 = w * w
        return k * w2 * w2 * w, 5.0 * k * w2 * w2, 0.0


class QuinticSpringSection(ElementSection):
    """g = k₅ w⁵.

    Attributes:
        stiffness_n_m5: k₅
    """

    kind: Literal["quintic_spring"]
    stiffness_n_m5: float
    element: ClassVar = QuinticSpring
    effect: ClassVar = spring_effect("quintic_stiffness", 5, 0.02, 0.01)
    law: ClassVar = power_term(5)


@dataclass(frozen=True)
class Cogging(LocalElement):
    """g = F (sin(2π w / λ + φ) − sin φ), a force that repeats with the position; F in N, λ in m, φ in rad.

    One harmonic of the cogging of a motor or of a gear's mesh; without its force at rest, which is a preload.
    """

    force: float
    period: float
    phase: float
    must_be_positive: ClassVar = ("period",)

    @staticmethod
    def response(force: float, period: float, phase: float, w: float, v: float) -> Response:
        """g and its tangents."""
        rate = 2.0 * np.pi / period
        turn = rate * w + phase
        return force * (np.sin(turn) - np.sin(phase)), force * rate * np.cos(turn), 0.0


class CoggingSection(ElementSection):
    """g = F (sin(2π w / λ + φ) − sin φ): one harmonic of a force that repeats with the position.

    Attributes:
        force_n: F
        period_m: λ, way from one wave to the next
        phase_rad: φ
    """

    kind: Literal["cogging"]
    force_n: float
    period_m: Positive
    phase_rad: float = 0.0
    element: ClassVar = Cogging
    without_harmonic_balance: ClassVar = "its force has as many waves in a period as the motion passes"
    without_effect: ClassVar = "a period has too many starts; it is read as a law of records"
    law: ClassVar = (
        LawForm(
            "cogging", "cogging", "sin(2π (x / {mm} mm + {last}))",
            lambda c, period, turn: (c, period, 2.0 * np.pi * turn), "cogging", signed=True, of_records=True,
        ),
    )  # fmt: skip


AnySpring = LinearSpringSection | CubicSpringSection | QuinticSpringSection | QuadraticSpringSection | CoggingSection
