"""Discretised Iwan joint: a distribution of slip displacements, as Jenkins elements side by side.

Segalman's four-parameter joint (J. Appl. Mech. 72, 2005) has sliders with the density of stiffness
ρ(φ) = R φ^χ up to the slip displacement φ_max, and a Dirac share S there: tangential stiffness K_T, slip force F_S,
exponent χ and β = S / (stiffness of the power law). Here the power law may also start at an onset φ_min > 0, below
which everything sticks: this gives the sharp bend between sticking and micro-slip that the paper's section 4 reports.
"""

from __future__ import annotations

import itertools
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from nmt_rig.model.local_elements.element import ElementSection, LocalElement
from nmt_rig.model.local_elements.friction import Jenkins
from nmt_rig.model.local_elements.springs import LinearSpring
from nmt_rig.model.structure import Array, Structure
from nmt_rig.rig_section import NotNegative, Positive

Partition = Literal["stiffness", "ratio"]

_FINEST = 1e-4  # φ / φ_max from which on parts have equal ratios


class IwanSection(ElementSection):
    """Joint with micro-slip: Jenkins elements side by side whose slip displacements follow a power law.

    Attributes:
        tangential_stiffness_n_m: K_T, all sliders together while they stick
        slip_force_n: F_S, all sliders together while they slip
        exponent: χ of the density of stiffness over slip displacement, R φ^χ
        stiffness_ratio: β, stiffness of the sliders at the largest slip displacement by that of the power law
        onset_ratio: smallest by largest slip displacement; 0 = Segalman's distribution
        sliders: sliders that stand for the power law; one more where β > 0
        partition: what the sliders have in common: equal `stiffness`, or an equal `ratio` of slip displacements over
            four decades
        remaining_stiffness_n_m: linear spring parallel to the sliders
    """

    kind: Literal["iwan"]
    tangential_stiffness_n_m: Positive
    slip_force_n: Positive
    exponent: Annotated[float, Field(gt=-1)] = 0.0
    stiffness_ratio: NotNegative = 0.0
    onset_ratio: Annotated[float, Field(ge=0, lt=1)] = 0.0
    sliders: Annotated[int, Field(ge=1, le=200)] = 12
    partition: Partition = "stiffness"
    remaining_stiffness_n_m: NotNegative = 0.0
    friction: ClassVar = True
    without_effect: ClassVar = "microslip of boundary_effects.py, in place of a slider or of a spring of the model"
    without_law: ClassVar = "sliders side by side have its force"
    not_calibrated: ClassVar = ("sliders", "partition")

    @property
    def largest_slip_displacement(self) -> float:
        """φ_max, displacement at which all sliders slip, m.

        From F_S = ∫ φ ρ dφ; for φ_min = 0 it is Segalman's F_S (1 + β) / (K_T (β + (χ + 1) / (χ + 2))).
        """
        return (
            self.slip_force_n
            * (1.0 + self.stiffness_ratio)
            / (self.tangential_stiffness_n_m * (self.stiffness_ratio + self._mean_ratio(self.onset_ratio, 1.0)))
        )

    def slider_table(self) -> tuple[Array, Array]:
        """Stiffness (N/m) and slip displacement (m) of each slider, ascending.

        The power law is cut into parts; each slips at the mean of its part, so that K_T and F_S are met exactly.
        Parts of equal stiffness are best near φ_max, parts of equal ratio equally good at all amplitudes.
        """
        power = self.exponent + 1.0
        low = self.onset_ratio**power
        continuous = self.tangential_stiffness_n_m / (1.0 + self.stiffness_ratio)
        if self.partition == "stiffness":
            edges = (low + (1.0 - low) * np.arange(self.sliders + 1) / self.sliders) ** (1.0 / power)
            stiffness = [continuous / self.sliders] * self.sliders
        else:
            edges = self._edges_of_equal_ratio()
            stiffness = [float(part) for part in continuous * np.diff(edges**power) / (1.0 - low)]
        ratios = [self._mean_ratio(float(a), float(b)) for a, b in itertools.pairwise(edges)]
        if self.stiffness_ratio > 0.0:
            ratios.append(1.0)
            stiffness.append(self.stiffness_ratio * continuous)
        return np.array(stiffness), self.largest_slip_displacement * np.array(ratios)

    def elements(self, structure: Structure) -> tuple[LocalElement, ...]:
        """Jenkins elements, and the remaining spring if there is one.

        Raises:
            KeyError: as :meth:`direction`.
            ValueError: a value out of its range, where the section was made without validation.
        """
        self.model_validate(self.model_dump())
        direction = self.direction(structure)
        elements: list[LocalElement] = [
            Jenkins(direction, float(stiffness), float(stiffness * displacement))
            for stiffness, displacement in zip(*self.slider_table(), strict=True)
        ]
        if self.remaining_stiffness_n_m != 0.0:
            elements.append(LinearSpring(direction, self.remaining_stiffness_n_m))
        return tuple(elements)

    def _edges_of_equal_ratio(self) -> Array:
        if self.onset_ratio >= _FINEST:
            return np.geomspace(self.onset_ratio, 1.0, self.sliders + 1)
        if self.sliders == 1:
            return np.array([self.onset_ratio, 1.0])
        return np.concatenate(([self.onset_ratio], np.geomspace(_FINEST, 1.0, self.sliders)))

    def _mean_ratio(self, low: float, high: float) -> float:
        """Mean of φ / φ_max over the power law between two ratios."""
        power = self.exponent + 1.0
        share = (high ** (power + 1.0) - low ** (power + 1.0)) / (high**power - low**power)
        return float(power / (power + 1.0) * share)
