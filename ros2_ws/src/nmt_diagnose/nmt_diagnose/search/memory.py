"""What a diagnosis leaves to the next one of the same model and rig, which has more recordings.

Recordings are read once. Explanations that competed are fitted from where they stood. One that was far behind on the
recordings before cannot catch up as long as the best of those that competed leaves noise only on all of them: it is
not fitted again, and a gap for which the library was searched is not searched for anew. Where the best one leaves more,
the whole search is repeated.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from nmt_core.numerics.arrays import FloatArray
from nmt_diagnose.effects.effect import Candidate
from nmt_diagnose.effects.location import Cause, Explanation
from nmt_diagnose.fit.best_fit import StartName, spread_at
from nmt_diagnose.fit.explanations import FittedExplanation, best_of
from nmt_diagnose.fit.fitting import ON_THE_WAY, Data, FitResult, Start
from nmt_diagnose.measurements.measurement import Observations
from nmt_diagnose.search.law_starts import parameters_at
from nmt_diagnose.search.search import Search
from nmt_diagnose.thresholds import THRESHOLDS


@dataclass(frozen=True)
class Remembered:
    """An explanation that competed.

    Attributes:
        causes: its effects at their places.
        values: of the parameters of each, by name, in their units: scales follow the motion of the recordings.
        parameters: of the model and its chain by name, dimensionless.
    """

    causes: tuple[Cause, ...]
    values: tuple[Mapping[str, float], ...]
    parameters: Mapping[str, float]


@dataclass
class Memory:
    """What is remembered.

    Attributes:
        readings: observations of a recording by its name and digest.
        near: explanations that competed.
        far: explanations that were fitted and lay far behind the best.
        searched: the library was searched for everything that the earlier recordings showed.
    """

    readings: dict[tuple[str, str], Observations] = field(default_factory=dict)
    near: tuple[Remembered, ...] = ()
    far: frozenset[Explanation] = frozenset()
    searched: bool = False

    def keep(
        self, named: Sequence[FittedExplanation], left_out: Sequence[FittedExplanation], searched: bool = False
    ) -> None:
        """Remember explanations.

        Args:
            named: those that competed.
            left_out: those that did not.
            searched: there was a gap, and the library was searched for it.
        """
        self.searched = searched
        if not named:
            self.near, self.far = (), frozenset()
            return
        least = max(explanation.fit.log_evidence for explanation in named) - THRESHOLDS.search.far_behind_log_evidence
        near = [explanation for explanation in named if explanation.fit.log_evidence > least][
            : THRESHOLDS.search.finalists
        ]
        self.near = tuple(
            Remembered(
                tuple(candidate.cause for candidate in explanation.candidates),
                tuple(
                    explanation.fit.parametrisation.values(explanation.fit.theta, k)
                    for k in range(len(explanation.candidates))
                ),
                dict(
                    zip(
                        (p.name for p in explanation.fit.parametrisation.calibration),
                        explanation.fit.theta,
                        strict=False,
                    )
                ),
            )
            for explanation in near
        )
        self.far = (self.far | {explanation.fitted for explanation in (*named, *left_out)}) - {
            explanation.fitted for explanation in near
        }

    def begun(
        self, search: Search, null: FittedExplanation, about: Callable[[FitResult], Data]
    ) -> list[FittedExplanation]:
        """The explanations that competed, fitted to the data of a search; the best first.

        Args:
            search: fits them.
            null: the model alone.
            about: data with the chain about a fit. Where the best leaves more than noise about the model alone and
                about itself, there are none.
        """
        if self.near:
            search.tell(f"fitting {len(self.near)} explanations from where they stood")
        found = best_of(
            [one for explanation in self.near if (one := fitted_again(search, null, explanation)) is not None]
        )
        if not found or search.leaves_noise_only(found[0]):
            return found
        first = found[0].fit
        near = Search(about(first), search.rig, search.parameters, ())
        again = near.best(first.parametrisation, [Start(first.start, first.theta, first)])
        return found if again is not None and near.leaves_noise_only(again) else []


def fitted_again(search: Search, null: FittedExplanation, remembered: Remembered) -> FittedExplanation | None:
    """A remembered explanation fitted to new rows from where it stood; None where the rig has no such place."""
    candidates: list[Candidate] = []
    added: list[FloatArray] = []
    for cause, values in zip(remembered.causes, remembered.values, strict=True):
        candidate = next((candidate for candidate in search.candidates if candidate.cause == cause), None)
        theta = None if candidate is None else parameters_at(candidate, values)
        if candidate is None or theta is None or not np.all(np.isfinite(theta)):
            return None
        candidates.append(candidate)
        added.append(theta)
    spreads = [spread_at(candidate, theta) for candidate, theta in zip(candidates, added, strict=True)]
    parametrisation = search.parametrisation(candidates, spreads)
    held = [remembered.parameters.get(parameter.name, 0.0) for parameter in parametrisation.calibration]
    start = Start(StartName.BEFORE, np.concatenate([held, *added]), null.fit.prediction, effort=ON_THE_WAY)
    found = search.best(parametrisation, [start], widen=True)
    return found if found is not None and math.isfinite(found.fit.log_evidence) else None
