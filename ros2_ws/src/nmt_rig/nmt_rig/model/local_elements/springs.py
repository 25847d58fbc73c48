"""Springs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

from nmt_rig.model.local_elements.element import ElementSection, LocalElement, Response


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


AnySpring = LinearSpringSection | QuadraticSpringSection | CubicSpringSection | QuinticSpringSection
