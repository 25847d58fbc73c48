"""What a diagnosis says of the comparison, in the terms of ``diagnosis.json``."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from itertools import zip_longest
from typing import Any

import numpy as np

from nmt_core.numerics.arrays import FloatArray
from nmt_diagnose.chain.chain_columns import SharedDelay, scale_columns
from nmt_diagnose.diagnosis_settings import DiagnosisSettings
from nmt_diagnose.effects.location import Explanation, joined
from nmt_diagnose.fit.explanations import FittedExplanation
from nmt_diagnose.fit.fitting import Data, Metric
from nmt_diagnose.law.reading import LawReading
from nmt_diagnose.ledger.comparison import Comparison
from nmt_diagnose.ledger.diagnosis import NULL, Gap, PlaceShare, Ranked, Recalibrated, Share, Value
from nmt_diagnose.ledger.gap import ClosedShare
from nmt_diagnose.ledger.held_out import Split
from nmt_diagnose.ledger.size import is_demanded
from nmt_diagnose.measurements.measurement import Observations
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_rig.rig import Rig

# Explanations that are reported.
_RANKED_EXPLANATIONS = 8


def ranked_rows(
    data: Data, comparison: Comparison, shares: Mapping[Explanation, ClosedShare], partial: bool = False
) -> tuple[Ranked, ...]:
    """The leading explanations, the most probable first, with parameters and shares of the gap that they close.

    Args:
        data: what was fitted.
        comparison: of the explanations.
        shares: of the gap that some of them close.
        partial: state probabilities among the explanations of the library alone.
    """
    result = []
    for group in comparison.classes[:_RANKED_EXPLANATIONS]:
        head = group.head
        share = shares.get(head.explanation)
        locations = head.explanation.locations
        result.append(
            Ranked(
                effect=joined(cause.effect for cause in head.explanation.causes),
                place=head.explanation.kinds,
                detail=joined(location.detail for location in locations if location.detail),
                probability=group.given_library if partial else group.probability,
                equivalents=tuple(joined(member.effects) for member in group.members[1:]),
                parameters=parameters(data, head),
                closed=Share(share.value, share.low, share.high) if share else Share(*[math.nan] * 3),
                sigmas=head.sigmas,
                converged=head.fit.converged,
                adequate=group.adequate and not (partial and group is comparison.classes[0]),
                given_library=partial,
                places=dict(sorted(group.places.items(), key=lambda item: -item[1])),
            )
        )
    return tuple(result)


def too_small_row(
    data: Data,
    null: FittedExplanation,
    named: Sequence[FittedExplanation],
    comparison: Comparison,
    close: Callable[[FittedExplanation], ClosedShare],
) -> tuple[Ranked, float] | None:
    """An effect that the recordings demand and that changes less than what matters; None without one.

    Args:
        data: what was fitted.
        null: the model alone.
        named: explanations, among them those that these recordings cannot distinguish from it.
        comparison: of them.
        close: how much of the gap an explanation closes on held-out data.

    Returns:
        The effect, and the residual of held-out data with it, rms over σ; NaN where no split determines it.
    """
    small = comparison.small
    if small is None or not is_demanded(small, null):
        return None
    explanation = small.fitted
    least = small.fit.log_evidence + math.log(THRESHOLDS.verdict.as_likely_share)
    near = [other for other in named if not other.stated and other.fit.log_evidence > least]
    effects = {other.fitted.effects for other in (small, *near)}
    # An explanation that only adds an effect to one that they cannot distinguish from it says nothing new.
    alike = [
        names
        for names in effects
        if not any(set(other) < set(names) for other in effects) and names != explanation.effects
    ]
    share = close(small)
    row = Ranked(
        effect=joined(cause.effect for cause in explanation.causes),
        place=explanation.kinds,
        detail=joined(location.detail for location in explanation.locations if location.detail),
        probability=comparison.small_probability,
        equivalents=tuple(sorted(map(joined, alike))),
        parameters=parameters(data, small),
        closed=Share(share.value, share.low, share.high),
        sigmas=small.sigmas,
        converged=small.fit.converged,
    )
    return row, share.after


def covariance_with_scale(data: Data, found: FittedExplanation) -> FloatArray:
    """Covariance of θ with what the gains of the channels whose amplitudes are given would move it by, (n, n)."""
    fitted = found.fit
    columns = scale_columns(data.observations, fitted.parametrisation.rig(fitted.theta), fitted.prediction)
    if not columns.shape[1]:
        return fitted.covariance
    weights = fitted.errors.weights
    chain = Metric(fitted.errors.slopes, np.ones(fitted.errors.chain.size), weights)
    moved = fitted.covariance @ (
        chain.project(fitted.jacobian)[0].T @ (weights[:, None] * data.slopes(columns, fitted.errors.values))
    )
    return np.asarray(fitted.covariance + moved @ moved.T)


def shared_covariance(found: FittedExplanation) -> FloatArray:
    """Part of the covariance of θ that comes from the priors of the model's parameters, (n, n).

    The estimate is Σ (JᵀR⁻¹ y + P⁻¹ θ₀), so that an error of θ₀, of covariance P = 1, moves it by Σ θ₀ and has the
    covariance Σ P⁻¹ Σ. The priors of the measuring chain are not the model's.
    """
    parametrisation = found.fit.parametrisation
    believed = [k for k, each in enumerate(parametrisation.calibration) if not isinstance(each, SharedDelay)]
    moved = found.fit.covariance[:, believed]
    return np.asarray(moved @ moved.T)


def parameters(data: Data, found: FittedExplanation) -> dict[str, Value]:
    """Reported parameters with standard uncertainties, carried through to first order (GUM, 5.2)."""
    parametrisation, theta = found.fit.parametrisation, found.fit.theta
    full_covariance, full_shared = covariance_with_scale(data, found), shared_covariance(found)
    result: dict[str, Value] = {}
    named = found.stated or range(len(found.candidates))
    for index in named:
        candidate = found.candidates[index]
        factors = np.flatnonzero([p.path == candidate.effect.factor for p in parametrisation.calibration])
        selected = np.concatenate([factors, np.arange(theta.size)[parametrisation.index_of(index)]])
        covariance, shared = (each[np.ix_(selected, selected)] for each in (full_covariance, full_shared))
        for name, (value, unit) in parametrisation.reported(theta, index).items():
            slopes = np.empty(selected.size)
            for position, k in enumerate(selected):
                moved = theta.copy()
                step = 0.1 * found.fit.std[k]
                moved[k] += step
                slopes[position] = (parametrisation.reported(moved, index)[name][0] - value) / step
            known = bool(np.all(np.isfinite(slopes)))
            variance, common = (float(slopes @ part @ slopes) if known else math.inf for part in (covariance, shared))
            label = f"{candidate.label}.{name}" if len(named) > 1 else name
            result[label] = Value(value, math.sqrt(max(variance, 0.0)), unit, math.sqrt(max(common, 0.0)))
    return result


def is_located(gap: Gap, law: LawReading | None) -> bool:
    """Whether places of an unknown gap are reported: an effect bridges a third of it, or a law is stated.

    If every explanation leaves most of a gap, the best of them does not locate it.
    """
    lawful = law is not None and law.is_stated
    return lawful or gap.bridged >= THRESHOLDS.verdict.nearest_closed_share


def place_rows(comparison: Comparison, explained: Mapping[str, float]) -> tuple[PlaceShare, ...]:
    """Probability of each place, and the share of the gap that a source there can account for."""
    kinds: dict[str, float] = {}
    details: dict[str, dict[str, float]] = {}
    for location, p in comparison.places.items():
        kinds[location.kind] = kinds.get(location.kind, 0.0) + p
        by_detail = details.setdefault(location.kind, {})
        by_detail[location.detail] = by_detail.get(location.detail, 0.0) + p
    weights = {kind: max(explained.get(kind, 0.0), 0.0) * p for kind, p in kinds.items()}
    total = sum(weights.values())
    result = []
    for kind, p in sorted(kinds.items(), key=lambda item: -item[1]):
        if p > THRESHOLDS.verdict.least_location_probability:
            best = max(details[kind].values())
            detail = joined(
                sorted(
                    what for what, q in details[kind].items() if what and q > THRESHOLDS.verdict.as_likely_share * best
                )
            )
            result.append(PlaceShare(kind, detail, weights[kind] / total if total > 0.0 else p, p))
    return tuple(result)


def calibration_rows(found: FittedExplanation) -> tuple[Recalibrated, ...]:
    """The model's own parameters before and after; those of the measuring chain are none of them."""
    result = []
    shared = np.sqrt(np.diag(shared_covariance(found)))
    for k, parameter in enumerate(found.fit.parametrisation.calibration):
        if isinstance(parameter, SharedDelay):
            continue
        theta, std = float(found.fit.theta[k]), float(found.fit.std[k])
        value = parameter.at(theta)
        scale = abs(value + parameter.offset) * parameter.std
        result.append(
            Recalibrated(
                parameter.name, parameter.value, value, scale * std, parameter.unit, parameter.std,
                theta / std if std > 0.0 else 0.0, scale * float(shared[k]),
            )
        )  # fmt: skip
    return tuple(result)


def candidate_row(
    found: FittedExplanation, null: FittedExplanation, data: Data, dropped_by: str = ""
) -> dict[str, Any]:
    """A fitted explanation as ``diagnosis.json`` has it.

    Args:
        found: the explanation.
        null: the model alone, fitted to the same.
        data: what was fitted.
        dropped_by: filter that took it out of the comparison; empty where it competes.
    """
    fitted = found.fit
    small = [candidate.cause.label for k, candidate in enumerate(found.candidates) if k in found.small]
    return {
        "label": found.fitted.label,
        "effect": joined(found.fitted.effects) or NULL,
        "place": found.fitted.kinds,
        "small": small,
        "filter": dropped_by,
        "chi_square": float(fitted.errors.residual @ fitted.errors.residual),
        "penalty": float(np.sum((fitted.theta / fitted.parametrisation.prior_std) ** 2)),
        "cost": fitted.cost,
        "rows": int(data.used.sum()),
        "parameters": int(fitted.theta.size - null.fit.theta.size),
        "log_evidence": fitted.log_evidence - null.fit.log_evidence,
        "sigmas": found.sigmas,
        "converged": fitted.converged,
    }


def inputs(
    observations: Observations, rig: Rig, splits: Sequence[Split], settings: DiagnosisSettings
) -> dict[str, Any]:
    """What a diagnosis was made of, as ``diagnosis.json`` has it."""
    tests = []
    for number, test in enumerate(observations.tests):
        selected = observations.rows.test == number
        tests.append(
            {
                "name": test.name,
                "kind": test.WORDS,
                "drive_point": test.drive_point,
                "levels": int(np.unique(observations.rows.level[selected]).size),
                "observables": int(selected.sum()),
            }
        )
    return {
        "bags": [
            {"path": path, "sha256": digest, **({} if origin is None else {"origin": origin.to_mapping()})}
            for (path, digest), origin in zip_longest(observations.inputs, observations.origins)
        ],
        "tests": tests,
        "held_out": [split.words(observations) for split in splits],
        "model": rig.name,
        "withheld": list(settings.withheld),
        "seed": settings.seed,
    }
