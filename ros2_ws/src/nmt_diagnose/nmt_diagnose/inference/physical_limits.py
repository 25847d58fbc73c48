"""Parameters beyond what physics allows: drag that no air has."""

from __future__ import annotations

import math
from collections.abc import Sequence

from nmt_diagnose.effects.effect import Candidate
from nmt_diagnose.inference.fit import Fit
from nmt_diagnose.inference.scan import Score

# Relative standard deviation of a limit: of a drag coefficient, for example.
_KNOWN = 0.5
_INCREDIBLE = 3.0


def beyond_limits(candidates: Sequence[Candidate], found: Fit) -> float:
    """By how many standard deviations the worst parameter of fitted effects lies beyond what physics allows; 0 within.

    Args:
        candidates: the effects, in the order of the fit's parametrisation.
        found: their fit.
    """
    worst, parametrisation = 0.0, found.parametrisation
    for index, candidate in enumerate(candidates):
        if not candidate.site.limits:
            continue
        values = parametrisation.values(found.theta, index)
        std = found.std[parametrisation.index_of(index)]
        for own, parameter in zip(std, candidate.effect.parameters, strict=True):
            limit, scale = candidate.site.limits.get(parameter.name), candidate.site.scales[parameter.name]
            if limit is not None:
                worst = max(worst, _beyond(abs(values[parameter.name]), float(own) * scale, limit))
    return worst


def incredible(candidate: Candidate, score: Score) -> bool:
    """Whether a candidate would have to lie far beyond what physics allows to do what a scan makes of it."""
    for parameter in candidate.effect.parameters:
        limit = candidate.site.limits.get(parameter.name)
        if limit is not None and parameter.kind == "strength" and score.sigmas:
            value = abs(score.strength) * candidate.site.scales[parameter.name]
            return _beyond(value, value / abs(score.sigmas), limit) > _INCREDIBLE
    return False


def _beyond(value: float, std: float, limit: float) -> float:
    return max(0.0, (value - limit) / math.hypot(_KNOWN * limit, std))
