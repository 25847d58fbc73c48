"""Hypotheses that compete: no gap, parameters, one effect, two effects, something unnamed; and their probabilities."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

from nmt_core.arrays import FloatArray
from nmt_diagnose.effects.placement import Placement
from nmt_diagnose.inference.fit import Fit
from nmt_diagnose.inference.fitted_model import FittedModel

NULL, UNKNOWN, OTHER = "none", "unknown", "other"
"""Keys of ``diagnosis.json`` beside the labels of explanations: none, something unnamed, named ones not competing."""


class Kind(Enum):
    """What a hypothesis says."""

    NONE = "none"
    NAMED = "named"
    UNNAMED = "unnamed"


@dataclass(frozen=True)
class Hypothesis:
    """One hypothesis.

    Attributes:
        kind: nothing is missing, something with a name is, or something without one.
        log_evidence: ln Z, relative to the same rows for all.
        log_prior: ln of its prior probability.
        fitted_model: the fitted explanation; None for something unnamed.
        placement: where something unnamed lies; None if that is not told.
    """

    kind: Kind
    log_evidence: float
    log_prior: float
    fitted_model: FittedModel | None = None
    placement: Placement | None = None

    @property
    def placements(self) -> tuple[Placement, ...]:
        """Where it lies; empty if that is not told, or nothing is missing."""
        if self.fitted_model is not None:
            return self.fitted_model.explanation.placements
        return () if self.placement is None else (self.placement,)


def probabilities(hypotheses: Sequence[Hypothesis]) -> FloatArray:
    """Posterior probabilities, as evidence and priors have them.

    Returns:
        shape (hypotheses,), sum 1.
    """
    logs = np.array([item.log_prior + item.log_evidence for item in hypotheses])
    weights = np.exp(logs - logs.max())
    result: FloatArray = weights / weights.sum()
    return result


def equivalent(left: Fit, right: Fit, limit: float = 3.0) -> bool:
    """Whether two fitted models predict the same data within ``limit`` standard deviations (Euclidean distance)."""
    both = left.used & right.used & np.isfinite(left.residual) & np.isfinite(right.residual)
    distance = float(np.linalg.norm(left.residual[both] - right.residual[both]))
    return distance < limit


def equivalence_classes(fits: Sequence[Fit], limit: float = 3.0) -> list[list[int]]:
    """Groups of fits that the data cannot distinguish, each around its best member.

    Args:
        fits: fits, best first.
        limit: distance in standard deviations.

    Returns:
        Indices, best member of each class first.
    """
    left = list(range(len(fits)))
    classes = []
    while left:
        head = left[0]
        members = [head] + [k for k in left[1:] if equivalent(fits[head], fits[k], limit)]
        classes.append(members)
        left = [k for k in left if k not in members]
    return classes
