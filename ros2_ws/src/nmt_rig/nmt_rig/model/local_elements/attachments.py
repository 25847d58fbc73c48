"""Attachments: things at one direction of the structure with unknowns of their own.

An attachment sees the motion w = d · q and adds internal unknowns behind it: those with inertia, then those without
(first order). Its matrices, local elements and couplings are written in the coordinates [w, internal…].
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field, model_validator

from nmt_rig.model.couplings import BOUC_WEN, LUGRE, SLACK, YIELD, Coupling, coupling_parameters
from nmt_rig.model.element_uses import LawForm
from nmt_rig.model.local_elements.contacts import BacklashDamper
from nmt_rig.model.local_elements.element import ElementSection, LocalElement
from nmt_rig.model.local_elements.springs import QuadraticSpring
from nmt_rig.model.structure import Array, Structure
from nmt_rig.rig_section import NotNegative, Positive


@dataclass(frozen=True)
class Attachment(ABC):
    """Base of the attachments.

    Attributes:
        direction: (n,) direction d on the degrees of freedom of the structure.
    """

    direction: Array = field(repr=False)
    inertial: ClassVar[int] = 0

    @property
    def first_order(self) -> int:
        """Number of internal unknowns without inertia."""
        return 0

    @property
    def size(self) -> int:
        """Number of coordinates, w included."""
        return 1 + self.inertial + self.first_order

    @abstractmethod
    def matrices(self) -> tuple[Array, Array, Array]:
        """Mass, damping and stiffness (size, size) in [w, internal…]."""

    def elements(self) -> tuple[LocalElement, ...]:
        """Local elements with directions (size,)."""
        return ()

    def couplings(self) -> tuple[Coupling, ...]:
        """Couplings with columns and rows over [w, internal…]."""
        return ()

    @property
    def resting_stiffness(self) -> float:
        """Stiffness along d for small motions, N/m."""
        return 0.0

    @property
    def resting_damping(self) -> float:
        """Damping along d for small motions, N s/m."""
        return 0.0

    def _zeros(self) -> tuple[Array, Array, Array]:
        mass, damping, stiffness = (np.zeros((self.size, self.size)) for _ in range(3))
        return mass, damping, stiffness


class AttachmentSection(ElementSection):
    """Base of the sections of attachments; they stand on the side of the structure."""

    without_harmonic_balance: ClassVar = "it has unknowns of its own"
    without_effect: ClassVar = "harmonic balance does not cover it"
    without_law: ClassVar = "its force depends on unknowns of its own"
    in_forced_response: ClassVar[bool] = False  # whether harmonic balance covers it together with the exciter

    def elements(self, structure: Structure) -> tuple[LocalElement, ...]:
        """None of its elements is on the structure alone."""
        return ()

    def attachment(self, structure: Structure) -> Attachment:
        """The attachment.

        Raises:
            KeyError: as :meth:`direction`.
        """
        result: Attachment = self.element(self.direction(structure), *self.own_values())
        return result


@dataclass(frozen=True)
class BoucWen(Attachment):
    """Hysteretic spring g = k (a w + (1 - a) z) with ż = v (1 - |z / z_y|ⁿ (b sign(v z) + 1 - b)); z_y in m.

    For b = ½ and n → ∞ it becomes the Jenkins element of slip force k z_y (a = 0).
    """

    stiffness: float
    yield_displacement: float
    exponent: float = 1.0
    post_yield_ratio: float = 0.0
    shape: float = 0.5

    @property
    def first_order(self) -> int:
        """The hysteretic displacement z."""
        return 1

    def matrices(self) -> tuple[Array, Array, Array]:
        """Linear part: ż = v."""
        mass, damping, stiffness = self._zeros()
        stiffness[0, 0] = self.post_yield_ratio * self.stiffness
        stiffness[0, 1] = (1.0 - self.post_yield_ratio) * self.stiffness
        damping[1, 1], damping[1, 0] = 1.0, -1.0
        return mass, damping, stiffness

    def couplings(self) -> tuple[Coupling, ...]:
        """What takes z from the straight line."""
        parameters = coupling_parameters(self.yield_displacement, self.exponent, self.shape)
        return (Coupling(BOUC_WEN, np.array([0.0, 1.0]), *_velocity_and_state(), parameters),)

    @property
    def resting_stiffness(self) -> float:
        """k, N/m."""
        return self.stiffness


class BoucWenSection(AttachmentSection):
    """g = k (a w + (1 − a) z), ż = v (1 − |z / z_y|ⁿ (b sign(v z) + 1 − b)).

    Attributes:
        stiffness_n_m: k at rest
        yield_displacement_m: z_y, largest z
        exponent: n, sharpness of the yield
        post_yield_ratio: a, stiffness after yield by that at rest
        shape: b; ½ = straight unloading
    """

    kind: Literal["bouc_wen"]
    stiffness_n_m: Positive
    yield_displacement_m: Positive
    exponent: Annotated[float, Field(ge=1, le=20)] = 1.0
    post_yield_ratio: Annotated[float, Field(ge=0, le=1)] = 0.0
    shape: Annotated[float, Field(ge=0, le=1)] = 0.5
    element: ClassVar = BoucWen
    without_law: ClassVar = "sliders and bristles have its loops"


@dataclass(frozen=True)
class LuGre(Attachment):
    """Bristle friction g = σ₀ z + σ₁ ż + σ₂ v with ż = v - σ₀ |v| z / s(v), s = F_C + (F_S - F_C) exp(-(v / v_S)²)."""

    bristle_stiffness: float
    bristle_damping: float
    viscous_damping: float
    coulomb_force: float
    static_force: float
    stribeck_velocity: float

    @property
    def first_order(self) -> int:
        """The bristles' deflection z."""
        return 1

    def matrices(self) -> tuple[Array, Array, Array]:
        """Linear part: ż = v."""
        mass, damping, stiffness = self._zeros()
        stiffness[0, 1] = self.bristle_stiffness
        damping[0, 0] = self.bristle_damping + self.viscous_damping
        damping[1, 1], damping[1, 0] = 1.0, -1.0
        return mass, damping, stiffness

    def couplings(self) -> tuple[Coupling, ...]:
        """σ₀ |v| z / s(v), in the bristles' rate and through σ₁ in the force."""
        parameters = coupling_parameters(
            self.bristle_stiffness, self.coulomb_force, self.static_force, self.stribeck_velocity
        )
        return (Coupling(LUGRE, np.array([-self.bristle_damping, 1.0]), *_velocity_and_state(), parameters),)

    def sliding_force(self, v: Array) -> Array:
        """s(v), the bristles' force while they slide at a speed (m/s), N."""
        falling = (self.static_force - self.coulomb_force) * np.exp(-((v / self.stribeck_velocity) ** 2))
        return np.asarray(self.coulomb_force + falling)

    @property
    def resting_stiffness(self) -> float:
        """σ₀, N/m."""
        return self.bristle_stiffness

    @property
    def resting_damping(self) -> float:
        """σ₁ + σ₂, N s/m."""
        return self.bristle_damping + self.viscous_damping


LEFT_SHARE = 0.01
"""Of the force of weakening bristles that high speeds leave; without it they would not hold on to anything there."""


def _bristles(c: float, reach: float, fall: float) -> tuple[float, ...]:
    """Bristles of stiffness c that slide at a deflection, which weakens over a speed where one is stated."""
    return c, 0.0, 0.0, c * reach * (LEFT_SHARE if fall else 1.0), c * reach, fall or 1.0


class LuGreSection(AttachmentSection):
    """g = σ₀ z + σ₁ ż + σ₂ v, ż = v − σ₀ |v| z / s(v), s = F_C + (F_S − F_C) exp(−(v / v_S)²).

    Attributes:
        bristle_stiffness_n_m: σ₀
        bristle_damping_ns_m: σ₁
        viscous_damping_ns_m: σ₂
        coulomb_force_n: F_C
        static_force_n: F_S, not smaller than F_C
        stribeck_velocity_m_s: v_S
    """

    kind: Literal["lugre"]
    bristle_stiffness_n_m: Positive
    bristle_damping_ns_m: NotNegative = 0.0
    viscous_damping_ns_m: NotNegative = 0.0
    coulomb_force_n: Positive
    static_force_n: Positive
    stribeck_velocity_m_s: Positive
    element: ClassVar = LuGre
    without_law: ClassVar = ""
    law: ClassVar = (
        LawForm(
            "bristle", "bristle", "bristles that slide at {mm} mm", _bristles, "friction of a slider behind a spring"
        ),
        LawForm(
            "weakening bristle", "weakening bristle", "bristles that slide at {mm} mm exp(−(v / {last} m/s)²)",
            _bristles, "dry friction that weakens with speed",
        ),
    )  # fmt: skip

    @model_validator(mode="after")
    def _static_is_larger(self) -> LuGreSection:
        if self.static_force_n < self.coulomb_force_n:
            raise ValueError("static_force_n must not be smaller than coulomb_force_n")
        return self


@dataclass(frozen=True)
class SlackSlider(Attachment):
    """Spring k with a slack g in series with a slider of slip force F: k (z ∓ g) beyond ±g, |z| up to g + F / k.

    z is the deflection behind the slider. Loops narrow to no force where the slack is crossed.
    """

    stiffness: float
    slip_force: float
    slack: float

    @property
    def first_order(self) -> int:
        """The deflection z."""
        return 1

    @property
    def reach(self) -> float:
        """Largest z, m."""
        return self.slack + self.slip_force / self.stiffness

    def matrices(self) -> tuple[Array, Array, Array]:
        """Linear part: ż = v."""
        mass, damping, stiffness = self._zeros()
        damping[1, 1], damping[1, 0] = 1.0, -1.0
        return mass, damping, stiffness

    def couplings(self) -> tuple[Coupling, ...]:
        """The slip in the rate of z, and the force of the spring on w."""
        still = np.zeros((2, 2))
        of_state = np.array([[0.0, 1.0], [0.0, 0.0]])
        return (
            Coupling(YIELD, np.array([0.0, 1.0]), *_velocity_and_state(), coupling_parameters(self.reach)),
            Coupling(SLACK, np.array([1.0, 0.0]), of_state, still, coupling_parameters(self.stiffness, self.slack)),
        )

    def force(self, z: Array) -> Array:
        """Force at a deflection, N."""
        return np.asarray(self.stiffness * np.sign(z) * np.maximum(np.abs(z) - self.slack, 0.0))

    @property
    def resting_stiffness(self) -> float:
        """k without slack, N/m."""
        return 0.0 if self.slack else self.stiffness


class SlackSliderSection(AttachmentSection):
    """k (z ∓ g) beyond ±g, where a slider takes what the deflection z has beyond g + F / k: friction with backlash.

    Attributes:
        tangential_stiffness_n_m: k, beyond the slack
        slip_force_n: F, force at which it slips
        slack_m: g, free play to each side
    """

    kind: Literal["slack_slider"]
    tangential_stiffness_n_m: Positive
    slip_force_n: Positive
    slack_m: NotNegative
    element: ClassVar = SlackSlider
    without_law: ClassVar = ""
    law: ClassVar = (
        LawForm(
            "slack slider", "slider", "spring that slips at {mm} mm, slack up to {last} of it",
            lambda c, slip, share: (c, c * slip * (1.0 - share), slip * share), "friction with pinched loops",
        ),
    )  # fmt: skip


def _velocity_and_state() -> tuple[Array, Array]:
    """Rows of (v, z) over [w, z]: displacements, velocities."""
    return np.array([[0.0, 0.0], [0.0, 1.0]]), np.array([[1.0, 0.0], [0.0, 0.0]])


# Distance of the ladder's rates, and how far they reach beyond the band, both as natural logarithms of rates.
_LADDER_STEP = 0.75
_LADDER_MARGIN = 4.0


@dataclass(frozen=True)
class FractionalDamper(Attachment):
    """g = c dᵅw/dtᵅ in a band, as Maxwell elements side by side (internal unknowns: their middle points).

    From sᵅ = sin(απ)/π ∫ pᵅ⁻¹ s / (s + p) dp by the trapezoidal rule over ln p, which converges exponentially; the
    rates beyond the ladder act as a spring (slow ones) and a damper (fast ones). Error in the band: below 1e-3.
    """

    coefficient: float
    order: float
    low: float
    high: float

    def ladder(self) -> tuple[Array, Array, float, float]:
        """Rates p (1/s) and stiffness (N/m) of the Maxwell elements, spring (N/m) and damper (N s/m) next to them."""
        a = self.order
        h = _LADDER_STEP
        start = math.log(self.low) - _LADDER_MARGIN
        count = math.ceil((math.log(self.high) + _LADDER_MARGIN - start) / h) + 1
        rates = np.exp(start + h * np.arange(count))
        weight = self.coefficient * math.sin(a * math.pi) / math.pi * h
        # The sums beyond both ends are geometric.
        spring = weight * float(rates[0]) ** a / math.expm1(a * h)
        damper = weight * float(rates[-1]) ** (a - 1.0) / math.expm1((1.0 - a) * h)
        return rates, weight * rates**a, spring, damper

    @property
    def first_order(self) -> int:
        """Middle points of the Maxwell elements."""
        return int(self.ladder()[0].size)

    def matrices(self) -> tuple[Array, Array, Array]:
        """k_i (w - y_i) = k_i / p_i ẏ_i for each element."""
        mass, damping, stiffness = self._zeros()
        rates, springs, spring, damper = self.ladder()
        stiffness[0, 0] = spring + springs.sum()
        stiffness[0, 1:] = stiffness[1:, 0] = -springs
        damping[0, 0] = damper
        index = np.arange(1, self.size)
        stiffness[index, index] = springs
        damping[index, index] = springs / rates
        return mass, damping, stiffness


class FractionalDamperSection(AttachmentSection):
    """g = c dᵅw/dtᵅ in a band, within 0.1 %, as a ladder of Maxwell elements.

    Attributes:
        coefficient_n_sa_m: c, N sᵅ/m
        order: α
        low_hz: lower end of the band
        high_hz: upper end of the band
    """

    kind: Literal["fractional_damper"]
    coefficient_n_sa_m: Positive
    order: Annotated[float, Field(gt=0, lt=1)] = 0.5
    low_hz: Positive = 0.1
    high_hz: Positive = 10_000.0
    element: ClassVar = FractionalDamper
    without_law: ClassVar = "a linear force is an error of the modes"
    in_forced_response: ClassVar = True

    @model_validator(mode="after")
    def _band(self) -> FractionalDamperSection:
        if self.low_hz >= self.high_hz:
            raise ValueError("low_hz must be smaller than high_hz")
        return self


@dataclass(frozen=True)
class TunedMassQuadratic(Attachment):
    """Oscillator m ÿ + 2ζω₀ m ẏ + m ω₀² y + κ w² = 0 whose energy κ w² y acts back on the structure with 2 κ w y.

    w² y = ((w + y)³ - (w - y)³ - 2 y³) / 6: three quadratic springs.
    """

    mass: float
    frequency: float
    damping_ratio: float
    coupling: float
    inertial: ClassVar[int] = 1

    def matrices(self) -> tuple[Array, Array, Array]:
        """The oscillator; linearly it does not touch the structure."""
        mass, damping, stiffness = self._zeros()
        mass[1, 1] = self.mass
        damping[1, 1] = 2.0 * self.damping_ratio * self.frequency * self.mass
        stiffness[1, 1] = self.mass * self.frequency**2
        return mass, damping, stiffness

    def elements(self) -> tuple[LocalElement, ...]:
        """Quadratic springs along w + y, w - y and y."""
        return (
            QuadraticSpring(np.array([1.0, 1.0]), 0.5 * self.coupling),
            QuadraticSpring(np.array([1.0, -1.0]), -0.5 * self.coupling),
            QuadraticSpring(np.array([0.0, 1.0]), -self.coupling),
        )


class TunedMassQuadraticSection(AttachmentSection):
    """Oscillator y with the coupling energy κ w² y: m ÿ + 2ζω₀ m ẏ + m ω₀² y + κ w² = 0, g = 2 κ w y.

    Attributes:
        mass_kg: m
        frequency_hz: ω₀ / 2π; near twice the mode's frequency for a 1:2 resonance
        damping_ratio: ζ
        coupling_n_m2: κ
    """

    kind: Literal["tuned_mass_quadratic"]
    mass_kg: Positive
    frequency_hz: Positive
    damping_ratio: NotNegative = 0.0
    coupling_n_m2: float
    element: ClassVar = TunedMassQuadratic
    in_forced_response: ClassVar = True


@dataclass(frozen=True)
class RattlingMass(Attachment):
    """Loose mass y: it strikes where |w - y| exceeds the gap, and viscous friction carries it in between."""

    mass: float
    gap: float
    contact_stiffness: float
    contact_damping: float
    friction: float
    inertial: ClassVar[int] = 1

    def matrices(self) -> tuple[Array, Array, Array]:
        """Mass and friction."""
        mass, damping, stiffness = self._zeros()
        mass[1, 1] = self.mass
        damping[:] = self.friction * np.array([[1.0, -1.0], [-1.0, 1.0]])
        return mass, damping, stiffness

    def elements(self) -> tuple[LocalElement, ...]:
        """Contact along w - y."""
        return (BacklashDamper(np.array([1.0, -1.0]), self.contact_stiffness, self.contact_damping, self.gap),)

    @property
    def resting_damping(self) -> float:
        """Friction, N s/m."""
        return self.friction


class RattlingMassSection(AttachmentSection):
    """Loose mass y that strikes where |w − y| exceeds its gap (contact as `backlash_damper`).

    Attributes:
        mass_kg: mass
        gap_m: free play to each side
        contact_stiffness_n_m: k of the contact
        contact_damping_ns_m2: λ of the contact
        friction_ns_m: viscous friction that carries the mass between strokes
    """

    kind: Literal["rattling_mass"]
    mass_kg: Positive
    gap_m: Positive
    contact_stiffness_n_m: Positive
    contact_damping_ns_m2: NotNegative = 0.0
    friction_ns_m: NotNegative = 0.0
    element: ClassVar = RattlingMass


AnyAttachment = (
    BoucWenSection
    | LuGreSection
    | SlackSliderSection
    | FractionalDamperSection
    | TunedMassQuadraticSection
    | RattlingMassSection
)
