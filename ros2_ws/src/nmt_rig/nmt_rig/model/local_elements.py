"""Local elements: friction, springs, stops and drag that act along one direction of the structure.

An element has a direction d (n,): it sees w = d · q and ẇ = d · q̇, and acts on the structure as
-d g(w, ẇ, memory). Time integration and harmonic balance share the compiled functions of this file. To them
an element is its integer `kind`, its `parameters` (PARAMETER_COUNT floats, unused ones zero) and, for the
Jenkins element, one number of memory: the position of the slider.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from typing import Any, ClassVar, TypeVar, cast

import numpy as np

from nmt_rig.model.structure import Array

PARAMETER_COUNT = 4

JENKINS = 1
CUBIC_SPRING = 2
QUINTIC_SPRING = 3
QUADRATIC_SPRING = 4
UNILATERAL_STOP = 5
TWO_SIDED_GAP = 6
QUADRATIC_DRAG = 7
LINEAR_SPRING = 8
LINEAR_DAMPER = 9
TANH_FRICTION = 10
EDDY_BRAKE = 11
BACKLASH_DAMPER = 12
AMPLITUDE_DAMPER = 13
POWER_LAW_DAMPER = 14

_Function = TypeVar("_Function", bound=Callable[..., Any])


def compiled(function: _Function) -> _Function:
    """numba.njit with an on-disk cache, typed as the function it compiles."""
    import numba

    return cast(_Function, numba.njit(cache=True)(function))


@dataclass(frozen=True)
class LocalElement:
    """Base of the local elements.

    Attributes:
        direction: (n,) direction d on the degrees of freedom it acts on, w = d · q.

    Raises:
        ValueError: a parameter that is not finite or not within its range.
    """

    direction: Array = field(repr=False)
    kind: ClassVar[int] = 0
    must_be_positive: ClassVar[tuple[str, ...]] = ()
    must_not_be_negative: ClassVar[tuple[str, ...]] = ()

    def __post_init__(self) -> None:
        for entry in fields(self):
            if entry.name == "direction":
                continue
            value = getattr(self, entry.name)
            if not np.isfinite(value):
                raise ValueError(f"{type(self).__name__}: {entry.name} must be finite, got {value}")
            if entry.name in self.must_be_positive and not value > 0:
                raise ValueError(f"{type(self).__name__}: {entry.name} must be positive, got {value}")
            if entry.name in self.must_not_be_negative and not value >= 0:
                raise ValueError(f"{type(self).__name__}: {entry.name} must not be negative, got {value}")

    @property
    def parameters(self) -> Array:
        """(PARAMETER_COUNT,) parameters in the order of the class, zeros behind."""
        values = [float(getattr(self, entry.name)) for entry in fields(self) if entry.name != "direction"]
        result = np.zeros(PARAMETER_COUNT)
        result[: len(values)] = values
        return result

    @property
    def linear_stiffness(self) -> float:
        """∂g/∂w at rest (the Jenkins element sticks), N/m."""
        return 0.0

    @property
    def linear_damping(self) -> float:
        """∂g/∂ẇ at rest, N s/m."""
        return 0.0

    def along(self, direction: Array) -> LocalElement:
        """The same element on another direction."""
        return replace(self, direction=direction)


@dataclass(frozen=True)
class Jenkins(LocalElement):
    """Elastic Coulomb element: spring k_t in series with a slider that yields at μN (paper section 3)."""

    tangential_stiffness: float
    slip_force: float
    kind: ClassVar[int] = JENKINS
    must_be_positive: ClassVar[tuple[str, ...]] = ("tangential_stiffness", "slip_force")

    @property
    def linear_stiffness(self) -> float:
        """k_t, N/m."""
        return float(self.tangential_stiffness)


@dataclass(frozen=True)
class CubicSpring(LocalElement):
    """g = k3 w³; stiffness in N/m³."""

    stiffness: float
    kind: ClassVar[int] = CUBIC_SPRING


@dataclass(frozen=True)
class QuinticSpring(LocalElement):
    """g = k5 w⁵; stiffness in N/m⁵."""

    stiffness: float
    kind: ClassVar[int] = QUINTIC_SPRING


@dataclass(frozen=True)
class QuadraticSpring(LocalElement):
    """g = k2 w²; stiffness in N/m²."""

    stiffness: float
    kind: ClassVar[int] = QUADRATIC_SPRING


@dataclass(frozen=True)
class UnilateralStop(LocalElement):
    """g = k max(w - gap, 0); gap in m, may be negative (preloaded)."""

    stiffness: float
    gap: float
    kind: ClassVar[int] = UNILATERAL_STOP
    must_be_positive: ClassVar[tuple[str, ...]] = ("stiffness",)

    @property
    def linear_stiffness(self) -> float:
        """Stiffness where the stop is preloaded, N/m."""
        return float(self.stiffness) if self.gap < 0 else 0.0


@dataclass(frozen=True)
class TwoSidedGap(LocalElement):
    """g = k (w - gap) for w > gap, k (w + gap) for w < -gap, 0 between."""

    stiffness: float
    gap: float
    kind: ClassVar[int] = TWO_SIDED_GAP
    must_be_positive: ClassVar[tuple[str, ...]] = ("stiffness",)
    must_not_be_negative: ClassVar[tuple[str, ...]] = ("gap",)


@dataclass(frozen=True)
class QuadraticDrag(LocalElement):
    """g = c2 ẇ |ẇ|; c2 in N s²/m²."""

    drag: float
    kind: ClassVar[int] = QUADRATIC_DRAG


@dataclass(frozen=True)
class LinearSpring(LocalElement):
    """g = k w."""

    stiffness: float
    kind: ClassVar[int] = LINEAR_SPRING

    @property
    def linear_stiffness(self) -> float:
        """k, N/m."""
        return float(self.stiffness)


@dataclass(frozen=True)
class LinearDamper(LocalElement):
    """g = c ẇ."""

    damping: float
    kind: ClassVar[int] = LINEAR_DAMPER

    @property
    def linear_damping(self) -> float:
        """c, N s/m."""
        return float(self.damping)


@dataclass(frozen=True)
class TanhFriction(LocalElement):
    """g = μN tanh(ẇ / v0), smoothed Coulomb friction; slip_force in N, reference_velocity in m/s."""

    slip_force: float
    reference_velocity: float
    kind: ClassVar[int] = TANH_FRICTION
    must_be_positive: ClassVar[tuple[str, ...]] = ("slip_force", "reference_velocity")

    @property
    def linear_damping(self) -> float:
        """μN / v0, N s/m."""
        return float(self.slip_force / self.reference_velocity)


@dataclass(frozen=True)
class EddyBrake(LocalElement):
    """g = c ẇ / (1 + (ẇ / v_c)²): the force of an eddy-current brake falls beyond its critical velocity (m/s)."""

    damping: float
    critical_velocity: float
    kind: ClassVar[int] = EDDY_BRAKE
    must_be_positive: ClassVar[tuple[str, ...]] = ("critical_velocity",)

    @property
    def linear_damping(self) -> float:
        """c, N s/m."""
        return float(self.damping)


@dataclass(frozen=True)
class BacklashDamper(LocalElement):
    """Stops with damping behind a gap on both sides: |g| = max(e (k + λ ė), 0), e = |w| - gap (Hunt and Crossley).

    Stiffness k in N/m, damping λ in N s/m²; the force grows with the penetration e, so it does not jump at contact.
    """

    stiffness: float
    damping: float
    gap: float
    kind: ClassVar[int] = BACKLASH_DAMPER
    must_be_positive: ClassVar[tuple[str, ...]] = ("stiffness",)
    must_not_be_negative: ClassVar[tuple[str, ...]] = ("damping", "gap")


@dataclass(frozen=True)
class AmplitudeDamper(LocalElement):
    """g = c w² ẇ; damping that grows with the square of the amplitude, c in N s/m³.

    The nonlinear term of the van der Pol equation; of its kind is the damping of large bending of slender beams
    (Zaitsev et al., Nonlinear Dyn. 67 (2012) 859).
    """

    damping: float
    kind: ClassVar[int] = AMPLITUDE_DAMPER


@dataclass(frozen=True)
class PowerLawDamper(LocalElement):
    """g = c |ẇ|ᵖ sgn ẇ; coefficient c in N (s/m)ᵖ, exponent p ≥ 1 (Ruzicka and Derby 1971, section 2).

    At p = 1 a linear damper, at p = 2 quadratic drag.

    Raises:
        ValueError: an exponent below 1, whose tangent at rest is infinite.
    """

    coefficient: float
    exponent: float
    kind: ClassVar[int] = POWER_LAW_DAMPER

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.exponent < 1.0:
            raise ValueError(f"{type(self).__name__}: exponent must be at least 1, got {self.exponent}")

    @property
    def linear_damping(self) -> float:
        """c where p = 1, else 0, N s/m."""
        return float(self.coefficient) if self.exponent == 1.0 else 0.0


@compiled
def element_response(kind: int, p: Array, w: float, v: float, slider: float) -> tuple[float, float, float, float]:
    """Force and tangents of one element at relative displacement w (m) and velocity v (m/s).

    Args:
        kind: code of the element.
        p: (PARAMETER_COUNT,) parameters.
        w, v: present relative displacement and velocity.
        slider: memory of a Jenkins element, its slider's position before this step (m); others ignore it.

    Returns:
        g (N), ∂g/∂w (N/m), ∂g/∂ẇ (N s/m), slider after the step (m).
    """
    if kind == 1:
        trial = p[0] * (w - slider)
        if trial > p[1]:
            return p[1], 0.0, 0.0, w - p[1] / p[0]
        if trial < -p[1]:
            return -p[1], 0.0, 0.0, w + p[1] / p[0]
        return trial, p[0], 0.0, slider
    if kind == 2:
        return p[0] * w * w * w, 3.0 * p[0] * w * w, 0.0, slider
    if kind == 3:
        w2 = w * w
        return p[0] * w2 * w2 * w, 5.0 * p[0] * w2 * w2, 0.0, slider
    if kind == 4:
        return p[0] * w * w, 2.0 * p[0] * w, 0.0, slider
    if kind == 5:
        if w > p[1]:
            return p[0] * (w - p[1]), p[0], 0.0, slider
        return 0.0, 0.0, 0.0, slider
    if kind == 6:
        if w > p[1]:
            return p[0] * (w - p[1]), p[0], 0.0, slider
        if w < -p[1]:
            return p[0] * (w + p[1]), p[0], 0.0, slider
        return 0.0, 0.0, 0.0, slider
    if kind == 7:
        return p[0] * v * abs(v), 0.0, 2.0 * p[0] * abs(v), slider
    if kind == 8:
        return p[0] * w, p[0], 0.0, slider
    if kind == 9:
        return p[0] * v, 0.0, p[0], slider
    if kind == 10:
        t = np.tanh(v / p[1])
        return p[0] * t, 0.0, p[0] * (1.0 - t * t) / p[1], slider
    if kind == 11:
        ratio = v / p[1]
        share = 1.0 / (1.0 + ratio * ratio)
        return p[0] * v * share, 0.0, p[0] * share * share * (1.0 - ratio * ratio), slider
    if kind == 12:
        side = 1.0 if w > 0.0 else -1.0
        e = side * w - p[2]
        stiffness = p[0] + p[1] * side * v
        if e > 0.0 and stiffness > 0.0:
            return side * e * stiffness, stiffness, e * p[1], slider
        return 0.0, 0.0, 0.0, slider
    if kind == 13:
        return p[0] * w * w * v, 2.0 * p[0] * w * v, p[0] * w * w, slider
    if kind == 14:
        size = abs(v)
        tangent = p[0] * size ** (p[1] - 1.0)
        return tangent * v, 0.0, p[1] * tangent, slider
    return 0.0, 0.0, 0.0, slider


@compiled
def element_stored_energy(kind: int, p: Array, w: float, slider: float) -> float:
    """Elastic energy (J) of one element at relative displacement w; 0 for purely dissipative ones."""
    energy = 0.0
    if kind == 1:
        e = w - slider
        energy = 0.5 * p[0] * e * e
    elif kind == 2:
        energy = 0.25 * p[0] * w * w * w * w
    elif kind == 3:
        energy = p[0] * w * w * w * w * w * w / 6.0
    elif kind == 4:
        energy = p[0] * w * w * w / 3.0
    elif kind == 5:
        e = max(w - p[1], 0.0)
        energy = 0.5 * p[0] * e * e
    elif kind == 6:
        e = max(abs(w) - p[1], 0.0)
        energy = 0.5 * p[0] * e * e
    elif kind == 8:
        energy = 0.5 * p[0] * w * w
    elif kind == 12:
        e = max(abs(w) - p[2], 0.0)
        energy = 0.5 * p[0] * e * e
    return energy
