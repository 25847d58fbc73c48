"""What re-fitted explanations predict of data that they have not seen."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from nmt_core.arrays import BoolArray, FloatArray
from nmt_diagnose.effects.placement import Explanation
from nmt_diagnose.inference.fitted_model import FittedModel
from nmt_diagnose.inference.gap import Closed, closed, noise_floor
from nmt_diagnose.inference.held_out import Split
from nmt_diagnose.inference.problem import Problem
from nmt_diagnose.observations.observables import Observations

# Strength in standard deviations, and standard deviation over that of the prior, by which a parameter is told.
_TOLD = 2.0
_LEARNT = 0.5
_OPEN = 1.5  # scatter of a prediction over its noise, rms, from which on what is open of it counts

Refits = tuple[Split, FittedModel, Mapping[Explanation, FittedModel | None]]


def determined(fitted_model: FittedModel, base: FittedModel, held_out: BoolArray) -> bool:
    """Whether the rows of a fit tell what its effects do to the rows held out.

    Strengths have to be told, and shapes beyond their prior. Where nothing that matters to the rows held out is open,
    it is enough that the fit needs its effect: below the displacement at which all of a joint slips, its stiffness and
    that displacement make up for one another, and neither is told alone.

    Args:
        fitted_model: explanation fitted to some rows.
        base: the model without effect, fitted to the same rows.
        held_out: other rows, shape (m,).
    """
    own_fit = fitted_model.fit
    certain = bool(np.sqrt(np.mean(own_fit.predictive_std[held_out] ** 2)) <= _OPEN)
    gain = base.fit.chi_square + base.fit.penalty - own_fit.chi_square - own_fit.penalty
    needed = certain and len(fitted_model.candidates) == 1 and gain >= _TOLD**2
    parametrisation = own_fit.parametrisation
    for index, candidate in enumerate(fitted_model.candidates):
        own = parametrisation.index_of(index)
        share = own_fit.std[own] / parametrisation.prior_std[own]
        shapes = np.array([p.kind == "shape" for p in candidate.effect.parameters])
        if not needed and (fitted_model.strength(index) < _TOLD or np.any(share[shapes] > _LEARNT)):
            return False
    return True


class HeldOut:
    """Explanations re-fitted without what each split holds out.

    Residuals are divided by what noise and the open parameters of the model without effect make of a prediction, the
    same for all explanations: a split that leaves a parameter open does not count as a gap.

    Args:
        observations: the real side.
        refits: of each split: the split, the model without effect, and the explanations re-fitted.
        seed: of the bootstrap.
        repeated: repeats of the tests are part of the stated uncertainties, so that these are what noise leaves.
        judged: whitens what is left; None = as the fits do. Smooth errors of a model are noise to its fit, and part of
            the gap.
    """

    def __init__(
        self,
        observations: Observations,
        refits: Sequence[Refits],
        seed: int,
        repeated: bool = False,
        judged: Problem | None = None,
    ) -> None:
        self._observations, self._refits, self._seed, self._judged = observations, refits, seed, judged
        self._scale = [base.fit.predictive_std for _, base, _ in refits]
        self.floor = min(self._noise(), 1.0) if repeated else self._noise()

    def _left(self, fitted_model: FittedModel) -> FloatArray:
        """Whitened residual of a fit, shape (m,)."""
        found = fitted_model.fit
        return found.residual if self._judged is None else self._judged.residual(found.prediction)

    @property
    def splits(self) -> tuple[str, ...]:
        """What was held out, in words."""
        return tuple(split.name for split, _, _ in self._refits)

    def closed(self, explanation: Explanation, start: FloatArray | None = None) -> Closed:
        """Gap before and after an explanation; one without causes is the model with its parameters re-fitted.

        Only splits that tell the explanation's parameters count; NaN where none does.

        Args:
            explanation: one of those that were re-fitted.
            start: residual to start from, shape (m,); None = of the model without effect, re-fitted to each split.
        """
        pairs: list[tuple[FloatArray, FloatArray, BoolArray]] = []
        for (split, base, tops), scale in zip(self._refits, self._scale, strict=True):
            top = base if explanation == base.explanation else tops.get(explanation)
            if top is None:
                continue
            before = self._left(base) if start is None else start
            # A prediction is judged by what noise and its own open parameters leave of it.
            own = scale if top is base else np.maximum(scale, top.fit.predictive_std)
            pair = (before / scale, self._left(top) / own, split.held_out)
            # Without the test that shows an effect nothing can be predicted of it.
            if determined(top, base, split.held_out):
                pairs.append(pair)
        return closed(self._observations, pairs, self._seed, self.floor)

    def worse(self, shares: Mapping[Explanation, Closed], alike: float) -> dict[Explanation, float]:
        """By how many of its standard deviations each explanation predicts worse than the one that predicts best.

        The scatter is that of the difference from block to block, over the splits that tell the parameters of both; 0
        where there is none. Explanations that close the same share of the gap are not distinguished: models of named
        effects are right to some percent only, and anything added imitates the rest.

        Args:
            shares: what each explanation closes.
            alike: difference of shares up to which they are the same.
        """
        result = dict.fromkeys(shares, 0.0)
        for own, mine in shares.items():
            for competitor, theirs in shares.items():
                if competitor != own and theirs.value > mine.value + alike:
                    result[own] = max(result[own], self._distance(own, competitor))
        return result

    def _distance(self, own: Explanation, competitor: Explanation) -> float:
        pairs = []
        for (split, base, tops), scale in zip(self._refits, self._scale, strict=True):
            left, right = tops.get(own), tops.get(competitor)
            if left is None or right is None:
                continue
            if determined(left, base, split.held_out) and determined(right, base, split.held_out):
                # Both by the same measure, so that a prediction gains nothing by being uncertain.
                pairs.append((self._left(left) / scale, self._left(right) / scale, split.held_out))
        found = closed(self._observations, pairs, self._seed, self.floor).gain
        return max(0.0, found) if math.isfinite(found) else 0.0

    def pooled(
        self, null: FittedModel, best: FittedModel, start: FloatArray | None
    ) -> tuple[BoolArray, FloatArray, FloatArray]:
        """Rows that some split held out, and their residuals before and after, from the first split that did.

        Divided as the gap is; without any split the fitted rows and the residuals of the fits.
        """
        rows = np.zeros(len(self._observations.rows), dtype=bool)
        before, after = self._left(null).copy(), self._left(best).copy()
        for (split, base, tops), scale in zip(self._refits, self._scale, strict=True):
            top = base if best.explanation == base.explanation else tops.get(best.explanation)
            if top is None:
                continue
            new = split.held_out & ~rows
            before[new] = (self._left(base) if start is None else start)[new] / scale[new]
            after[new] = self._left(top)[new] / scale[new]
            rows |= split.held_out
        return (rows if rows.any() else null.fit.used), before, after

    def scale(self, rows: BoolArray) -> FloatArray:
        """What the residuals of some rows are divided by, from the first split that holds each out; 1 elsewhere."""
        result = np.ones(len(self._observations.rows))
        seen = np.zeros(result.size, dtype=bool)
        for (split, _, _), scale in zip(self._refits, self._scale, strict=True):
            new = split.held_out & ~seen
            result[new] = scale[new]
            seen |= split.held_out
        return result[rows]

    def _noise(self) -> float:
        """What noise leaves of the held-out rows, by the explanation that leaves the smoothest remainder."""
        total, count = 0.0, 0
        for (split, base, tops), scale in zip(self._refits, self._scale, strict=True):
            fits = [base, *(top for top in tops.values() if top is not None)]
            floors = [noise_floor(self._observations, self._left(item) / scale, split.held_out) for item in fits]
            size = int(split.held_out.sum())
            total += min(floors) ** 2 * size
            count += size
        return math.sqrt(total / count) if count else 1.0
