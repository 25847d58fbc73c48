"""Friction between two points."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

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

    @staticmethod
    def margin(k: float, slip: float, branch: int, w: float, slider: float) -> float:
        """Way to the onset of slip."""
        return slip / k - abs(w - slider)

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


AnyFriction = JenkinsSection | TanhFrictionSection
