"""Stops behind a gap."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

from nmt_rig.model.element_uses import ElementEffect, LawForm
from nmt_rig.model.local_elements.element import ElementSection, LocalElement, Response
from nmt_rig.rig_section import NotNegative, Positive


def _effect(name: str, equation: str) -> ElementEffect:
    """A stop that is not reached does nothing: it begins at several gaps."""
    return ElementEffect(
        name, equation, "Kerschen et al., Mech. Syst. Signal Process. 20 (2006) 505",
        {"k": "stiffness_n_m", "gap": "gap_m"}, lambda k, a, w: k, 0.1, 0.05, starts=(0.1, 0.3, 0.5, 0.7, 0.9),
    )  # fmt: skip


@dataclass(frozen=True)
class UnilateralStop(LocalElement):
    """g = k max(w - gap, 0); gap in m, may be negative (preloaded)."""

    stiffness: float
    gap: float
    must_be_positive: ClassVar[tuple[str, ...]] = ("stiffness",)

    @staticmethod
    def next_branch(k: float, gap: float, branch: int, w: float, v: float, slider: float) -> int:
        """The branch that fits."""
        return 1 if w > gap else 0

    @staticmethod
    def frozen(k: float, gap: float, branch: int, w: float, v: float, slider: float) -> Response:
        """g and its tangents on a branch."""
        if branch == 0:
            return 0.0, 0.0, 0.0
        return k * (w - branch * gap), k, 0.0

    @staticmethod
    def piece(k: float, gap: float, branch: int, slider: float) -> tuple[float, float]:
        """Stiffness and constant on a branch."""
        if branch == 0:
            return 0.0, 0.0
        return k, -k * branch * gap

    @property
    def contacts(self) -> tuple[tuple[float, float, float], ...]:
        """One stop."""
        return ((self.stiffness, self.gap, 1.0),)


class UnilateralStopSection(ElementSection):
    """g = k max(w − gap, 0).

    Attributes:
        stiffness_n_m: k
        gap_m: gap; negative = preloaded
    """

    kind: Literal["unilateral_stop"]
    stiffness_n_m: Positive
    gap_m: float
    element: ClassVar = UnilateralStop
    effect: ClassVar = _effect("one_sided_stop", "k max(x − g, 0)")
    law: ClassVar = (LawForm("stop", "stop", "spring where {beyond}", lambda c, gap, _: (c, gap), "stop on one side"),)


@dataclass(frozen=True)
class TwoSidedGap(UnilateralStop):
    """g = k (w - gap) for w > gap, k (w + gap) for w < -gap, 0 between."""

    must_not_be_negative: ClassVar[tuple[str, ...]] = ("gap",)

    @staticmethod
    def next_branch(k: float, gap: float, branch: int, w: float, v: float, slider: float) -> int:
        """The branch that fits."""
        return int(w > gap) - int(w < -gap)

    @property
    def contacts(self) -> tuple[tuple[float, float, float], ...]:
        """Two stops."""
        return ((self.stiffness, self.gap, 1.0), (self.stiffness, self.gap, -1.0))


class TwoSidedGapSection(ElementSection):
    """Stops on both sides.

    Attributes:
        stiffness_n_m: stiffness of the stops
        gap_m: free play to each side
    """

    kind: Literal["two_sided_gap"]
    stiffness_n_m: Positive
    gap_m: NotNegative
    element: ClassVar = TwoSidedGap
    effect: ClassVar = _effect("two_sided_gap", "k (x ∓ g) beyond ±g")
    law: ClassVar = (LawForm("gap", "gap", "spring where |x| > {mm} mm", lambda c, gap, _: (c, gap), "clearance"),)


@dataclass(frozen=True)
class BacklashDamper(LocalElement):
    """Stops with damping behind a gap on both sides: |g| = max(e (k + λ ė), 0), e = |w| - gap (Hunt and Crossley).

    Stiffness k in N/m, damping λ in N s/m²; the force grows with the penetration e, so it does not jump at contact. It
    needs no branch; contact is located all the same.
    """

    stiffness: float
    damping: float
    gap: float
    must_be_positive: ClassVar[tuple[str, ...]] = ("stiffness",)
    must_not_be_negative: ClassVar[tuple[str, ...]] = ("damping", "gap")

    @staticmethod
    def response(k: float, damping: float, gap: float, w: float, v: float) -> Response:
        """g and its tangents."""
        side = 1.0 if w > 0.0 else -1.0
        e = side * w - gap
        stiffness = k + damping * side * v
        if e > 0.0 and stiffness > 0.0:
            return side * e * stiffness, stiffness, e * damping
        return 0.0, 0.0, 0.0

    @staticmethod
    def next_branch(k: float, damping: float, gap: float, branch: int, w: float, v: float, slider: float) -> int:
        """The branch that fits."""
        return int(w > gap) - int(w < -gap)


class BacklashDamperSection(ElementSection):
    """Spring and damper behind a gap to both sides: |g| = max(e (k + λ ė), 0), e = |w| − gap.

    Attributes:
        stiffness_n_m: k
        damping_ns_m2: λ; the force grows with the penetration, so it does not jump at contact
        gap_m: free play to each side
    """

    kind: Literal["backlash_damper"]
    stiffness_n_m: Positive
    damping_ns_m2: NotNegative
    gap_m: NotNegative
    element: ClassVar = BacklashDamper
    without_harmonic_balance: ClassVar = "its contacts are neither smooth nor linear"
    without_effect: ClassVar = "harmonic balance does not cover it"
    without_law: ClassVar = "two_sided_gap with a damper in contact stands for it"


AnyContact = UnilateralStopSection | TwoSidedGapSection | BacklashDamperSection
