"""The best fit of an explanation from several places where it may begin."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from enum import StrEnum

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.numerics.arrays import FloatArray
from nmt_diagnose.effects.effect import Candidate
from nmt_diagnose.effects.parametrisation import Parametrisation
from nmt_diagnose.fit.candidate_starts import strength_position
from nmt_diagnose.fit.fitting import FIRST_LOOK, Data, FitError, FitResult, Start, fit
from nmt_diagnose.thresholds import THRESHOLDS


class StartName(StrEnum):
    """Where fits begin, as the ledger has it."""

    GIVEN = "model as given"
    MODES = "measured modes"
    BELIEVED = "model as given where its parameters are implausible"
    SCORE = "score test"
    SMALL = "small effect of the best"
    ELSEWHERE = "same effect at another place"
    LEADER = "model's parameters of the best"
    ALONE = "two effects without the weaker one"
    LAW = "law of held levels"
    LAW_GIVEN = "law of held levels, model as given"
    BEFORE = "diagnosis before"

    @property
    def weaker(self) -> str:
        """The same with the strength of an effect a fraction."""
        return f"{self}, weaker"


def evidence(found: FitResult) -> float:
    """What the best fit has the most of: ln evidence."""
    return found.log_evidence


def likelihood(found: FitResult) -> float:
    """The same where parameters may go where they do nothing, which evidence counts as a gain: −½ the cost."""
    return -0.5 * found.cost


def best_fit(
    data: Data,
    parametrisation: Parametrisation,
    starts: Iterable[Start],
    known: FitResult | None = None,
    value: Callable[[FitResult], float] = evidence,
    enough: Callable[[FitResult], bool] = lambda _: False,
    widen: bool = False,
) -> FitResult:
    """The best of the fits from some starts; one from which the model cannot be solved is passed over.

    Args:
        data: what fits work on.
        parametrisation: what θ means.
        starts: in the order in which they are tried.
        known: a fit that stands unless a start leads to a better one.
        value: of a fit; the larger the better.
        enough: whether the best so far needs no further start.
        widen: let the prior of strengths follow them, see :func:`widened`.

    Raises:
        FitError: no start leads to a fit, and none is known.
    """
    best, reason = known, "there is no start"
    for start in starts:
        try:
            found = fit(data, parametrisation, start)
            found = widened(data, found) if widen else found
        except (BenchError, ArithmeticError, np.linalg.LinAlgError) as error:
            reason = str(error)
            continue
        if best is None or value(found) > value(best):
            best = found
        if enough(best):
            break
    if best is None:
        raise FitError(reason)
    return best


def from_believed(data: Data, found: FitResult) -> FitResult:
    """A fit of the model alone, or a better one that starts with its implausible parameters at their given values.

    A resonance that is damped away leaves no trace in the rows, so no slope leads back to it.
    """
    far = np.abs(found.theta) > THRESHOLDS.comparison.credible_sigmas
    starts = [Start(StartName.BELIEVED, np.where(far, 0.0, found.theta), coarse=True)] if far.any() else []
    return best_fit(data, found.parametrisation, starts, found, likelihood)


def widened(data: Data, found: FitResult) -> FitResult:
    """The fit with the part of its strengths' prior that makes it most probable.

    Raises:
        FitError: the model has no solution there.
    """
    parametrisation = found.parametrisation
    spreads = []
    for k, candidate in enumerate(parametrisation.candidates):
        strengths = zip(found.theta[parametrisation.index_of(k)], candidate.effect.parameters, strict=True)
        spreads.append(spread_of(max(abs(float(value)) for value, p in strengths if p.kind == "strength")))
    if all(spread == parametrisation.spread(k) for k, spread in enumerate(spreads)):
        return found
    wider = replace(parametrisation, spreads=tuple(spreads))
    again = fit(data, wider, Start(found.start, found.theta, found, found.theta.size, effort=FIRST_LOOK))
    return again if again.log_evidence > found.log_evidence else found


def spread_of(strength: float) -> float:
    """The narrowest part of a strength's prior that does not hold it back."""
    return next(
        (
            spread
            for spread in THRESHOLDS.fits.strength_spreads
            if abs(strength) <= THRESHOLDS.search.wider_strength * THRESHOLDS.fits.strength_std * spread
        ),
        THRESHOLDS.fits.strength_spreads[-1],
    )


def spread_at(candidate: Candidate, theta: FloatArray) -> float:
    """The same of a candidate's parameters."""
    return spread_of(float(theta[strength_position(candidate)]))
