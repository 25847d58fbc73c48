"""Each recording left out in turn: whether the others agree without it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from nmt_core.arrays import BoolArray
from nmt_diagnose.effects.placement import joined
from nmt_diagnose.inference.diagnosis import LeftOut
from nmt_diagnose.inference.fitted_model import FittedModel, rms_left
from nmt_diagnose.inference.hypotheses import NULL
from nmt_diagnose.observations.observables import Observations

# Rms of what is left from which recordings do not fit together; by how much less is left without the one that is to
# blame, and by how much more without any other.
_TOO_MUCH = 1.3
_WITHOUT = 0.75
_OTHERS = 1.3
# Rms below which a recording that was left out shows no gap that could be closed.
_NO_GAP = 1.5


@dataclass(frozen=True)
class Recording:
    """One recording of the real side.

    Attributes:
        path: as it was given.
        rows: its observables, shape (m,).
    """

    path: str
    rows: BoolArray


def recordings(observations: Observations) -> list[Recording]:
    """The recordings that observables come from; empty where the observations do not say."""
    found = []
    for (path, _), origin in zip(observations.inputs, observations.origins, strict=False):
        numbers = [k for k, test in enumerate(observations.tests) if test.name in origin.tests]
        rows = np.isin(observations.rows.test, numbers)
        if rows.any():
            found.append(Recording(path, rows))
    return found


def left_out(recording: Recording, refits: Sequence[FittedModel | None]) -> LeftOut | None:
    """What the others say without one recording.

    Args:
        recording: the one.
        refits: the model without effect first, then the explanations, re-fitted to the other recordings.

    Returns:
        None where the model without effect has no fit.
    """
    base = refits[0]
    if base is None:
        return None
    competing = [own for own in refits if own is not None]
    logs = np.array([own.fit.log_evidence for own in competing])
    shares = np.exp(logs - logs.max())
    best = int(np.argmax(logs))
    leader = competing[best]
    before, after = (_rms(own, recording.rows) for own in (base, leader))
    # Noise alone leaves 1: below that nothing more is explained.
    closed = (before - max(after, 1.0)) / (before - 1.0) if leader is not base and before > _NO_GAP else math.nan
    return LeftOut(
        recording.path,
        joined(leader.effects) or NULL,
        float(shares[best] / shares.sum()),
        rms_left(leader),
        closed,
    )


def contradiction(found: Sequence[LeftOut], together: float) -> str:
    """A sentence on the recording that contradicts the others; empty where they agree, or none can be named.

    Args:
        found: of each recording, what the others say without it.
        together: rms of what the best explanation of all recordings leaves.
    """
    if len(found) < 2 or not together > _TOO_MUCH:
        return ""
    ordered = sorted(found, key=lambda item: item.left)
    if len(found) == 2:
        if ordered[1].left < _WITHOUT * together:
            names = " and ".join(item.recording for item in found)
            return f"{names} contradict each other: each alone can be explained, both together cannot."
        return ""
    first, second = ordered[:2]
    if first.left < _WITHOUT * together and second.left > _OTHERS * first.left:
        return (
            f"{first.recording} contradicts the other recordings: without it {first.left:.1f} standard deviations are "
            f"left instead of {together:.1f}, without any other {second.left:.1f} or more; check what made it."
        )
    return ""


def _rms(fitted_model: FittedModel, rows: BoolArray) -> float:
    own = rows & np.isfinite(fitted_model.fit.residual)
    if not own.any():
        return math.nan
    values = fitted_model.fit.residual[own] / fitted_model.fit.predictive_std[own]
    return float(np.sqrt(np.mean(values**2)))
