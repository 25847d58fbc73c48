"""Friction between two points."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from nmt_rig.model.element_uses import LawForm
from nmt_rig.model.local_elements.element import ElementSection, LocalElement, Response
from nmt_rig.rig_section import Positive

# A sticking element yields only above this multiple of its slip force: rounding must not toggle it at rest.
_YIELD = 1.0 + 1e-12


@dataclass(frozen=True)
class Jenkins(LocalElement):
    """Elastic Coulomb element: spring k_t in series with a slider that yields at μN (paper section 3).

    The one element with a memory, the position of its slider, which kernels move while it slips.
    """

    tangential_stiffness: float
    slip_force: float
    must_be_positive: ClassVar[tuple[str, ...]] = ("tangential_stiffness", "slip_force")

    @staticmethod
    def moved(k: float, slip: float, w: float, slider: float) -> Response:
        """g, ∂g/∂w and the slider's position after a step to w."""
        trial = k * (w - slider)
        if trial > slip:
            return slip, 0.0, w - slip / k
        if trial < -slip:
            return -slip, 0.0, w + slip / k
        return trial, k, slider

    @staticmethod
    def next_branch(k: float, slip: float, branch: int, w: float, v: float, slider: float) -> int:
        """The branch that fits."""
        if branch == 0:
            trial = k * (w - slider)
            if trial > slip * _YIELD:
                return 1
            if trial < -slip * _YIELD:
                return -1
            return 0
        if branch * v < 0.0:
            return 0
        return branch

    @staticmethod
    def frozen(k: float, slip: float, branch: int, w: float, v: float, slider: float) -> Response:
        """g and its tangents on a branch."""
        if branch == 0:
            return k * (w - slider), k, 0.0
        return branch * slip, 0.0, 0.0

    @staticmethod
    def piece(k: float, slip: float, branch: int, slider: float) -> tuple[float, float]:
        """Stiffness and constant on a branch."""
        if branch == 0:
            return k, -k * slider
        return 0.0, branch * slip

    @property
    def sliders(self) -> tuple[tuple[float, float], ...]:
        """One slider."""
        return ((self.tangential_stiffness, self.slip_force),)


class JenkinsSection(ElementSection):
    """Elastic Coulomb element: a spring in series with a slider.

    Attributes:
        tangential_stiffness_n_m: k_t, stiffness while it sticks
        slip_force_n: μN, force at which it slips
    """

    kind: Literal["jenkins"]
    tangential_stiffness_n_m: Positive
    slip_force_n: Positive
    element: ClassVar = Jenkins
    friction: ClassVar = True
    without_effect: ClassVar = (
        "clamp_friction and second_friction_contact of boundary_effects.py, with models without it"
    )
    law: ClassVar = (
        LawForm(
            "slider", "slider", "spring that slips at {mm} mm", lambda c, slip, _: (c, c * slip),
            "friction of a slider behind a spring",
        ),
    )  # fmt: skip


@dataclass(frozen=True)
class TanhFriction(LocalElement):
    """g = μN tanh(v / v0), smoothed Coulomb friction; slip_force in N, reference_velocity in m/s."""

    slip_force: float
    reference_velocity: float
    samples: ClassVar[tuple[int, int]] = (2048, 1024)  # no kink, but steep
    must_be_positive: ClassVar[tuple[str, ...]] = ("slip_force", "reference_velocity")

    @staticmethod
    def response(slip: float, reference: float, w: float, v: float) -> Response:
        """g and its tangents."""
        t = np.tanh(v / reference)
        return slip * t, 0.0, slip * (1.0 - t * t) / reference


class TanhFrictionSection(ElementSection):
    """g = μN tanh(v / v₀).

    Attributes:
        slip_force_n: μN
        reference_velocity_m_s: v₀
    """

    kind: Literal["tanh_friction"]
    slip_force_n: Positive
    reference_velocity_m_s: Positive
    element: ClassVar = TanhFriction
    friction: ClassVar = True
    without_effect: ClassVar = "second_friction_contact: a slider behind a stiff spring"
    law: ClassVar = (
        LawForm(
            "friction", "friction", "tanh(v / {size} m/s)", lambda c, v, _: (c, v), "dry friction", by_speed=True,
            starts=tuple(np.geomspace(1e-3, 0.3, 6)),
        ),
    )  # fmt: skip


@dataclass(frozen=True)
class WeakeningFriction(LocalElement):
    """g = μN tanh(v / v0) exp(−(v / vs)²), what dry friction has at low speed beyond that at high speed.

    slip_force in N, velocities in m/s. It takes power at every speed.
    """

    slip_force: float
    reference_velocity: float
    decay_velocity: float
    samples: ClassVar[tuple[int, int]] = (2048, 1024)  # no kink, but steep
    must_be_positive: ClassVar[tuple[str, ...]] = ("slip_force", "reference_velocity", "decay_velocity")

    @staticmethod
    def response(slip: float, reference: float, decay: float, w: float, v: float) -> Response:
        """g and its tangents."""
        t = np.tanh(v / reference)
        bump = slip * np.exp(-((v / decay) ** 2))
        return bump * t, 0.0, bump * ((1.0 - t * t) / reference - 2.0 * v * t / decay**2)


class WeakeningFrictionSection(ElementSection):
    """g = μN tanh(v / v₀) e^(−(v/v_s)²): part of dry friction that weakens with speed, with `tanh_friction`.

    Attributes:
        slip_force_n: μN, by which the force falls
        reference_velocity_m_s: v₀
        decay_velocity_m_s: v_s, over which it falls
    """

    kind: Literal["weakening_friction"]
    slip_force_n: Positive
    reference_velocity_m_s: Positive
    decay_velocity_m_s: Positive
    element: ClassVar = WeakeningFriction
    friction: ClassVar = True
    without_effect: ClassVar = "a law of held levels and of records: it says over which speed the force falls"
    law: ClassVar = (
        LawForm(
            "weakening friction", "friction", "tanh(v / {size} m/s) exp(−(v / {last} m/s)²)",
            lambda c, v, fall: (c, v, fall), "dry friction that weakens with speed", by_speed=True,
        ),
    )  # fmt: skip


@dataclass(frozen=True)
class StribeckBelt(LocalElement):
    """Friction on a belt that runs with v_b: g = f(v - v_b) - f(-v_b), forces in N, velocities in m/s.

    f(u) = (F_k + (F_s - F_k) exp(-|u| / v_s)) tanh(u / v_0), the Stribeck curve of kinetic force F_k, static force F_s
    and decay velocity v_s; v_0 = v_s / 20 smooths its step. The force at rest is part of the rest position, so that w
    counts from there. Where the curve falls the belt feeds the motion.

    Raises:
        ValueError: forces or velocities that are not positive, or a static force below the kinetic one.
    """

    kinetic: float
    static: float
    decay_velocity: float
    belt_velocity: float
    samples: ClassVar[tuple[int, int]] = (4096, 2048)  # no kink, but steep
    must_be_positive: ClassVar[tuple[str, ...]] = ("kinetic", "static", "decay_velocity", "belt_velocity")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.static < self.kinetic:
            raise ValueError(
                f"{type(self).__name__}: static must be at least the kinetic force {self.kinetic}, got {self.static}"
            )

    @staticmethod
    def response(kinetic: float, static: float, decay: float, belt: float, w: float, v: float) -> Response:
        """g and its tangents."""
        rest = (kinetic + (static - kinetic) * np.exp(-belt / decay)) * np.tanh(-20.0 * belt / decay)
        u = v - belt
        bump = (static - kinetic) * np.exp(-abs(u) / decay)
        t = np.tanh(20.0 * u / decay)
        side = 1.0 if u > 0.0 else -1.0
        slope = (kinetic + bump) * (1.0 - t * t) * 20.0 / decay - side * bump / decay * t
        return (kinetic + bump) * t - rest, 0.0, slope


class StribeckBeltSection(ElementSection):
    """Friction on a running belt: g = f(v − v_b) − f(−v_b), f(u) = (F_k + (F_s − F_k) e^(−|u|/v_s)) tanh(20 u/v_s).

    Attributes:
        kinetic_force_n: F_k, at high sliding velocity
        static_force_n: F_s, at the onset of sliding
        decay_velocity_m_s: v_s, over which the force falls
        belt_velocity_m_s: v_b
    """

    kind: Literal["stribeck_belt"]
    kinetic_force_n: Positive
    static_force_n: Positive
    decay_velocity_m_s: Positive
    belt_velocity_m_s: Positive
    element: ClassVar = StribeckBelt
    without_effect: ClassVar = "a belt is part of a rig: no one overlooks it"
    without_law: ClassVar = "it feeds the motion: no strength that is not negative makes it"


AnyFriction = JenkinsSection | TanhFrictionSection | WeakeningFrictionSection | StribeckBeltSection
