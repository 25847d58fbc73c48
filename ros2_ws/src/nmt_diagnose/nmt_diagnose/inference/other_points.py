"""Where else the best effect may act.

Points that move nearly alike tell an effect alike, and the fit at one of them may end in an optimum of its own: the
gap of a stop that is closed everywhere, say. What is learned of the effect at the best point serves the others: its
strength and shape are dimensionless, referred to the motion and the stiffness of the point at which it acts.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from nmt_diagnose.inference.fitted_model import FittedModel

if TYPE_CHECKING:
    from nmt_diagnose.inference.model_comparison import ModelComparison

# Logarithm of evidence over the model alone, from which it is worth asking where else the effect may be.
_PLACED = 50.0


def at_other_points(
    comparison: ModelComparison, base: FittedModel, singles: Sequence[FittedModel]
) -> list[FittedModel]:
    """The best explanation's effect fitted at all other points, from its parameters at the best one.

    Args:
        comparison: fits them.
        base: what the explanations were added to.
        singles: explanations by one effect, best first.

    Returns:
        Those that use the same rows and come near the best; none where that explains little or acts at no point.
    """
    if not singles:
        return []
    best = singles[0]
    cause = best.explanation.causes[0]
    if cause.placement.channel or best.fit.log_evidence - base.fit.log_evidence < _PLACED:
        return []
    numbers = [
        number
        for number, candidate in enumerate(comparison.fits.candidates)
        if (candidate.cause.effect, candidate.cause.form) == (cause.effect, cause.form)
        and candidate.cause.placement != cause.placement
    ]
    found = comparison.started([(number, best.fit.theta) for number in numbers])
    least = best.fit.log_evidence - comparison.fits.settings.close
    return [own for own in found if own.fit.log_evidence >= least and not (best.fit.used & ~own.fit.used).any()]
