"""Where the parameters of a candidate are looked at first, dimensionless as fits have them."""

from __future__ import annotations

from itertools import product

import numpy as np

from nmt_core.arrays import FloatArray
from nmt_diagnose.effects.effect import Candidate, EffectParameter
from nmt_diagnose.inference.fitted_model import FittedModel

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


def starts_of(candidate: Candidate) -> list[FloatArray]:
    """Dimensionless parameters to look at, (parameters,) each.

    All combinations of the grids; a strength without grid is at zero.
    """
    grids: list[tuple[float, ...]] = []
    for parameter in candidate.effect.parameters:
        if parameter.kind == "shape":
            grids.append(tuple(float(np.log(value)) for value in parameter.grid or _SHAPE_STARTS))
        else:
            grids.append(parameter.grid or (0.0,))
    return [np.array(values) for values in product(*grids)]


def other_shapes(fitted_model: FittedModel) -> list[FloatArray]:
    """θ with the shapes of one effect after another at each combination of its grid."""
    result = []
    for number, candidate in enumerate(fitted_model.candidates):
        shapes = [k for k, parameter in enumerate(candidate.effect.parameters) if parameter.kind == "shape"]
        own = np.arange(fitted_model.fit.theta.size)[fitted_model.fit.parametrisation.index_of(number)][shapes]
        for start in {tuple(start[shapes]) for start in starts_of(candidate)} if shapes else ():
            theta = fitted_model.fit.theta.copy()
            theta[own] = start
            result.append(theta)
    return sorted(result, key=lambda theta: tuple(theta))
