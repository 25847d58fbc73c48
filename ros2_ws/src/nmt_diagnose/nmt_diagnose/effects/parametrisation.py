"""Dimensionless parameters θ of a fit, and the rigs they stand for."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import accumulate
from math import exp, log

import numpy as np

from nmt_core.key_units import of_rotation
from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import FloatArray
from nmt_core.vocabulary import ROTATION_UNITS
from nmt_diagnose.effects.calibration import CalibrationParameter
from nmt_diagnose.effects.effect import Candidate, EffectParameter, Reported, Site
from nmt_diagnose.effects.rig_edit import value_at
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_rig.rig import Rig

# Beyond this a shape is as good as anywhere: keeps trial steps of a fit finite.
_LARGEST_LOG_SHAPE = 20.0


@dataclass(frozen=True)
class Parametrisation:
    """θ = [calibration parameters, then the parameters of each candidate].

    Calibration: value · exp(std θ), prior N(0, 1). Strength: scale · θ, prior a mixture of N(0, (3 s)²) with weights
    1/s over the spreads s = 1, 10, 100, of which each parametrisation takes one; one that cannot be negative is absent
    for θ ≤ 0. Shape: scale · exp(θ), prior N(0, 1), or wider where a shape is free over decades.

    Attributes:
        base: the model as given.
        calibration: parameters of the model that are free.
        candidates: effects that are added.
        spreads: of the strengths of each candidate; 1 for those beyond the end.
    """

    base: Rig
    calibration: tuple[CalibrationParameter, ...]
    candidates: tuple[Candidate, ...] = ()
    spreads: tuple[float, ...] = ()

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Name of each entry of θ."""
        return (
            *(parameter.name for parameter in self.calibration),
            *(f"{candidate.label}.{p.name}" for candidate, p in self._effect_parameters),
        )

    @cached_property
    def _effect_parameters(self) -> tuple[tuple[Candidate, EffectParameter], ...]:
        return tuple((candidate, p) for candidate in self.candidates for p in candidate.effect.parameters)

    @property
    def size(self) -> int:
        """Number of parameters n."""
        return len(self.calibration) + len(self._effect_parameters)

    @cached_property
    def prior_std(self) -> FloatArray:
        """Prior standard deviations of θ, (n,)."""
        return np.array(
            [1.0] * len(self.calibration)
            + [
                THRESHOLDS.fits.strength_std * self.spread(index)
                if p.kind == "strength"
                else p.std or THRESHOLDS.fits.shape_std
                for index, candidate in enumerate(self.candidates)
                for p in candidate.effect.parameters
            ]
        )

    def spread(self, candidate: int) -> float:
        """Spread of the strengths of a candidate."""
        return self.spreads[candidate] if candidate < len(self.spreads) else 1.0

    @property
    def log_prior(self) -> float:
        """ln of the weight of its part of the prior, up to a constant."""
        return -sum(log(value) for value in self.spreads)

    @cached_property
    def lower(self) -> FloatArray:
        """Lower bounds of θ, (n,): 0 for strengths that cannot be negative, or less what the model itself has there."""
        return np.array(
            [-np.inf] * len(self.calibration) + [candidate.lower(p) for candidate, p in self._effect_parameters]
        )

    @property
    def zero(self) -> FloatArray:
        """θ of the model as given, (n,)."""
        return np.zeros(self.size)

    def index_of(self, candidate: int) -> slice:
        """Entries of θ of one candidate."""
        return slice(self._ends[candidate], self._ends[candidate + 1])

    @cached_property
    def _ends(self) -> tuple[int, ...]:
        sizes = [len(self.calibration), *(len(c.effect.parameters) for c in self.candidates)]
        return tuple(accumulate(sizes))

    def values(self, theta: FloatArray, candidate: int) -> dict[str, float]:
        """Parameters of a candidate, in their units."""
        added = self.candidates[candidate]
        return {
            p.name: _value(p, added.site.scales[p.name], float(entry), added.lower(p))
            for p, entry in zip(added.effect.parameters, theta[self.index_of(candidate)], strict=True)
        }

    def rig(self, theta: FloatArray) -> Rig:
        """Rig of parameters θ; the base itself at zero."""
        rig = self._calibrated(theta[: len(self.calibration)])
        for index, candidate in enumerate(self.candidates):
            rig = candidate.effect.apply(rig, candidate.site, self.values(theta, index))
        return rig

    def _calibrated(self, theta: FloatArray) -> Rig:
        """The base with its own parameters at θ: what changed since the last call is changed."""
        if not theta.any():
            return self.base
        known, rig = self._last[0]
        for parameter, before, entry in zip(self.calibration, known, theta, strict=True):
            if entry != before:
                rig = parameter.moved(rig, float(before), float(entry))
        self._last[0] = (np.array(theta), rig)
        return rig

    @cached_property
    def _last(self) -> list[tuple[FloatArray, Rig]]:
        return [(np.zeros(len(self.calibration)), self.base)]

    def reported(self, theta: FloatArray, candidate: int) -> Reported:
        """Parameters that a candidate is reported by, with units."""
        added = self.candidates[candidate]
        site, factor = added.site, added.effect.factor
        if factor:
            site = replace(site, reference=site.reference * float(value_at(self.rig(theta), factor)))
        return {
            name: (value, _unit_at(unit, site, self.base))
            for name, (value, unit) in added.effect.reported(site, self.values(theta, candidate)).items()
        }


def _unit_at(unit: str, site: Site, rig: Rig) -> str:
    """Unit at a site: of its channel, or out of alternatives for displacement and rotation, or time and periods."""
    if unit == "channel":
        quantity = Quantity[rig.sensors[site.index].quantity.upper()]
        return quantity.unit if rig.coordinate == "length" else ROTATION_UNITS.get(quantity, quantity.unit)
    found = unit.split(" or ")
    if len(found) == 1:
        return unit if rig.coordinate == "length" else of_rotation(unit)
    rotation, periods = site.option == "rotation", site.option == "slip_force_per_cycle"
    exact = [u for u in found if ("rad" in u) == rotation and ("period" in u) == periods]
    return exact[0] if exact else found[0]


def _value(parameter: EffectParameter, scale: float, theta: float, lower: float) -> float:
    if parameter.kind == "shape":
        return scale * exp(min(max(theta, -_LARGEST_LOG_SHAPE), _LARGEST_LOG_SHAPE))
    return scale * max(theta, lower)
