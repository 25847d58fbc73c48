"""Where the parameters of a candidate are looked at first, dimensionless as fits have them."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product

import numpy as np

from nmt_core.numerics.arrays import FloatArray
from nmt_diagnose.effects.effect import Candidate, EffectParameter

# A shape without a grid of its own is looked at within a factor of two.
_SHAPE_STARTS = (0.5, 1.0, 2.0)


def strength_position(candidate: Candidate) -> int:
    """Position of the strength among the parameters of a candidate."""
    return next(k for k, p in enumerate(candidate.effect.parameters) if p.kind == "strength")


def strength_parameter(candidate: Candidate) -> EffectParameter:
    """Strength of a candidate."""
    return candidate.effect.parameters[strength_position(candidate)]


def at_strength(candidate: Candidate, start: FloatArray, strength: float) -> FloatArray:
    """A start with another strength, (parameters,)."""
    result = start.copy()
    result[strength_position(candidate)] = strength
    return result


def at_zero(candidate: Candidate, start: FloatArray) -> FloatArray:
    """A start without strength, (parameters,)."""
    return at_strength(candidate, start, 0.0)


def _dimensionless(candidate: Candidate, values: Mapping[str, float]) -> FloatArray:
    """Parameters (parameters,) of values in their units."""
    scaled = [(p.kind, values[p.name] / candidate.site.scales[p.name]) for p in candidate.effect.parameters]
    return np.array([np.log(value) if kind == "shape" else value for kind, value in scaled])


def starts_of(candidate: Candidate) -> list[FloatArray]:
    """Dimensionless parameters to look at, (parameters,) each.

    Those of its site where that has some; else all combinations of the grids, a strength without grid at zero.
    """
    if candidate.site.begun:
        return [_dimensionless(candidate, values) for values in candidate.site.begun]
    grids: list[tuple[float, ...]] = []
    for parameter in candidate.effect.parameters:
        if parameter.kind == "shape":
            grids.append(tuple(float(np.log(value)) for value in parameter.grid or _SHAPE_STARTS))
        else:
            begun = [
                value / candidate.site.scales[parameter.name] for value in candidate.site.starts.get(parameter.name, ())
            ]
            grids.append((*(parameter.grid or (0.0,)), *begun))
    return [np.array(values) for values in product(*grids)]
