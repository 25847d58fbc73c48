"""Discretised Iwan joint: a distribution of slip displacements, as Jenkins elements side by side.

Segalman's four-parameter joint (J. Appl. Mech. 72, 2005) has sliders with the density of stiffness
ρ(φ) = R φ^χ up to the slip displacement φ_max, and a Dirac share S there: tangential stiffness K_T, slip force F_S,
exponent χ and β = S / (stiffness of the power law). Here the power law may also start at an onset φ_min > 0, below
which everything sticks: this gives the sharp bend between sticking and micro-slip that the paper's section 4 reports.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, fields
from typing import Literal

import numpy as np

from nmt_rig.model.local_elements import Jenkins, LinearSpring, LocalElement
from nmt_rig.model.structure import Array

Partition = Literal["stiffness", "ratio"]

_FINEST = 1e-4  # φ / φ_max from which on parts have equal ratios


@dataclass(frozen=True)
class IwanJoint:
    """Parameters of one joint.

    Attributes:
        tangential_stiffness: K_T, stiffness of all sliders together while they stick, N/m.
        slip_force: F_S, force of all sliders together while they slip, N.
        exponent: χ > -1 of the power law.
        stiffness_ratio: β ≥ 0, stiffness of the sliders at φ_max by that of the power law.
        onset_ratio: φ_min / φ_max in [0, 1); 0 = Segalman's distribution.
        sliders: number of sliders that stand for the power law; one more for the share at φ_max where β > 0.
        remaining_stiffness: linear spring beside the sliders, N/m.
        partition: parts of the power law that a slider each stands for. ``stiffness``: of equal stiffness, best near
            φ_max. ``ratio``: of equal ratio of slip displacements over four decades, equally good at all amplitudes.

    Raises:
        ValueError: a parameter that is not finite or not within its range.
    """

    tangential_stiffness: float
    slip_force: float
    exponent: float = 0.0
    stiffness_ratio: float = 0.0
    onset_ratio: float = 0.0
    sliders: int = 12
    remaining_stiffness: float = 0.0
    partition: Partition = "stiffness"

    def __post_init__(self) -> None:
        for entry in fields(self):
            if entry.name != "partition" and not np.isfinite(getattr(self, entry.name)):
                raise ValueError(f"Iwan joint: {entry.name} must be finite, got {getattr(self, entry.name)}")
        for name in ("tangential_stiffness", "slip_force", "sliders"):
            if not getattr(self, name) > 0:
                raise ValueError(f"Iwan joint: {name} must be positive, got {getattr(self, name)}")
        for name in ("stiffness_ratio", "remaining_stiffness"):
            if not getattr(self, name) >= 0:
                raise ValueError(f"Iwan joint: {name} must not be negative, got {getattr(self, name)}")
        if not self.exponent > -1:
            raise ValueError(f"Iwan joint: exponent must be greater than -1, got {self.exponent}")
        if not 0 <= self.onset_ratio < 1:
            raise ValueError(f"Iwan joint: onset_ratio must be in [0, 1), got {self.onset_ratio}")

    @property
    def largest_slip_displacement(self) -> float:
        """φ_max, displacement at which all sliders slip, m.

        From F_S = ∫ φ ρ dφ; for φ_min = 0 it is Segalman's F_S (1 + β) / (K_T (β + (χ + 1) / (χ + 2))).
        """
        return (
            self.slip_force
            * (1.0 + self.stiffness_ratio)
            / (self.tangential_stiffness * (self.stiffness_ratio + self._mean_ratio(self.onset_ratio, 1.0)))
        )

    def slider_table(self) -> tuple[Array, Array]:
        """Stiffness (N/m) and slip displacement (m) of each slider, ascending.

        The power law is cut into parts; each slips at the mean of its part, so that K_T and F_S are met exactly.
        """
        power = self.exponent + 1.0
        low = self.onset_ratio**power
        continuous = self.tangential_stiffness / (1.0 + self.stiffness_ratio)
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

    def elements(self, direction: Array) -> tuple[LocalElement, ...]:
        """Jenkins elements, and the remaining spring if there is one, along one direction."""
        sliders: tuple[LocalElement, ...] = tuple(
            Jenkins(direction, float(stiffness), float(stiffness * displacement))
            for stiffness, displacement in zip(*self.slider_table(), strict=True)
        )
        if self.remaining_stiffness == 0.0:
            return sliders
        return (*sliders, LinearSpring(direction, self.remaining_stiffness))

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
