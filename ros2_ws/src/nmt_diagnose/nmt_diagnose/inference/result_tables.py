"""What a diagnosis says of its judgement: ranking, places, parameters, inputs and features."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import zip_longest
from typing import Any

import numpy as np

from nmt_core.arrays import FloatArray
from nmt_diagnose.effects.effect import Candidate
from nmt_diagnose.effects.placement import Explanation, joined
from nmt_diagnose.inference.confidence import confidence_digest
from nmt_diagnose.inference.diagnosis import (
    PlaceShare,
    Ranked,
    Recalibrated,
    Share,
    Value,
    Verdict,
)
from nmt_diagnose.inference.diagnosis_settings import DiagnosisSettings
from nmt_diagnose.inference.fitted_model import FittedModel
from nmt_diagnose.inference.gap import Closed
from nmt_diagnose.inference.generic_source import SourceScore
from nmt_diagnose.inference.held_out import Split
from nmt_diagnose.inference.hypotheses import NULL
from nmt_diagnose.inference.judgement import (
    Judgement,
)
from nmt_diagnose.inference.motion_scale import covariance_with_scale
from nmt_diagnose.inference.prior_conflict import prior_conflict
from nmt_diagnose.inference.problem import Problem
from nmt_diagnose.inference.scan import Score
from nmt_diagnose.observations.observables import Observations
from nmt_rig.rig import Rig

_RANKED = 8
# Share of the likeliest detail's probability from which another is named beside it: odds of three to one say little.
_AS_LIKELY = 1.0 / 3.0


def ranked(judgement: Judgement, shares: Mapping[Explanation, Closed], problem: Problem) -> tuple[Ranked, ...]:
    """The leading explanations, most probable first, with their parameters and the shares of the gap they close."""
    result = []
    for group in judgement.classes[:_RANKED]:
        head = group.head
        placements = head.explanation.placements
        share = shares.get(head.explanation)
        result.append(
            Ranked(
                effect=joined(cause.effect for cause in head.explanation.causes),
                place=head.explanation.kinds,
                detail=joined(placement.detail for placement in placements if placement.detail),
                probability=group.probability,
                equivalents=tuple(joined(effects) for effects in group.effects[1:]),
                parameters=_parameters(head, covariance_with_scale(problem, head.fit)),
                closed=Share(share.value, share.low, share.high) if share else Share(*[math.nan] * 3),
                sigmas=head.sigmas,
                converged=head.fit.converged,
            )
        )
    return tuple(result)


def place_shares(judgement: Judgement, sources: Sequence[SourceScore], verdict: Verdict) -> tuple[PlaceShare, ...]:
    """Where the gap lies: probability of each place, and what a source there can account for."""
    if verdict in (Verdict.NONE, Verdict.CALIBRATION):
        return ()
    by_place: dict[str, float] = {}
    details: dict[str, dict[str, float]] = {}
    for placement, p in judgement.places.items():
        kind, own = placement.kind, details.setdefault(placement.kind, {})
        by_place[kind] = by_place.get(kind, 0.0) + p
        own[placement.detail] = own.get(placement.detail, 0.0) + p
    explained: dict[str, float] = {}
    for source in sources:
        size = max(0.0, source.explained - source.degrees_of_freedom)
        kind = source.placement.kind
        explained[kind] = max(explained.get(kind, 0.0), size)
    weights = {place: explained.get(place, 0.0) * p for place, p in by_place.items()}
    total = sum(weights.values())
    return tuple(
        PlaceShare(place, _likeliest(details[place]), weights[place] / total if total > 0.0 else p, p)
        for place, p in sorted(by_place.items(), key=lambda item: -item[1])
        if p > 0.005
    )


def recalibrated(best: FittedModel, problem: Problem) -> tuple[Recalibrated, ...]:
    """The model's own parameters, before and after a fit."""
    parametrisation = best.fit.parametrisation
    whole = np.sqrt(np.diag(covariance_with_scale(problem, best.fit)))
    result = []
    for k, parameter in enumerate(parametrisation.calibration):
        theta, std = float(best.fit.theta[k]), float(whole[k])
        value = parameter.at(theta)
        result.append(
            Recalibrated(
                parameter.name,
                parameter.value,
                value,
                abs(value + parameter.offset) * parameter.std * std * best.fit.scatter,
                parameter.unit,
                parameter.std,
                theta / std if std > 0.0 else 0.0,
            )
        )
    return tuple(result)


def inputs(
    observations: Observations, rig: Rig, splits: Sequence[Split], settings: DiagnosisSettings
) -> dict[str, Any]:
    """What a diagnosis was made of, as ``diagnosis.json`` has it."""
    tests = []
    for number, test in enumerate(observations.tests):
        mine = observations.rows.test == number
        tests.append(
            {
                "name": test.name,
                "kind": type(test).__name__,
                "drive_point": test.drive_point,
                "levels": int(np.unique(observations.rows.level[mine]).size),
                "observables": int(mine.sum()),
            }
        )
    return {
        "bags": [
            {"path": path, "sha256": digest, **({} if origin is None else {"origin": origin.to_mapping()})}
            for (path, digest), origin in zip_longest(observations.inputs, observations.origins)
        ],
        "tests": tests,
        "held_out": [split.name for split in splits],
        "model": rig.name,
        "withheld": list(settings.withheld),
        "seed": settings.seed,
        "confidence_sha256": confidence_digest(),
    }


def candidate_entry(fitted_model: FittedModel, null: FittedModel) -> dict[str, Any]:
    """A fitted explanation as ``diagnosis.json`` has it."""
    return {
        "label": fitted_model.explanation.label,
        "effect": joined(fitted_model.effects) or NULL,
        "place": fitted_model.explanation.kinds,
        "chi_square": fitted_model.fit.chi_square,
        "penalty": fitted_model.fit.penalty,
        "rows": int(fitted_model.fit.used.sum()),
        "parameters": int(fitted_model.fit.theta.size - null.fit.theta.size),
        "log_evidence": fitted_model.fit.log_evidence - null.fit.log_evidence,
        "sigmas": fitted_model.sigmas,
        "converged": fitted_model.fit.converged,
    }


def feature_table(
    judgement: Judgement,
    null: FittedModel,
    singles: Sequence[FittedModel],
    pairs: Sequence[FittedModel],
    scan: Sequence[Score],
    sources: Sequence[SourceScore],
    leftovers: Sequence[SourceScore],
    as_given: FloatArray,
    chance: float,
    candidates: Sequence[Candidate],
) -> dict[str, float]:
    """Numbers from which verdicts follow; baselines are trained on them."""
    used = null.fit.used & np.isfinite(as_given)
    best = singles[0].fit if singles else null.fit
    found = {
        "rows": float(null.fit.used.sum()),
        "chi_square_given": float(as_given[used] @ as_given[used]),
        "chi_square_null": null.fit.chi_square,
        "penalty_null": null.fit.penalty,
        "prior_conflict": prior_conflict(null),
        "chi_square_best": best.chi_square,
        "log_evidence_best": best.log_evidence - null.fit.log_evidence,
        "log_evidence_second": singles[1].fit.log_evidence - null.fit.log_evidence if len(singles) > 1 else 0.0,
        "log_evidence_pair": pairs[0].fit.log_evidence - null.fit.log_evidence if pairs else 0.0,
        "scan_best": scan[0].gain if scan else 0.0,
        "source_best": max((source.gain for source in sources), default=0.0),
        "leftover_best": max((source.gain for source in leftovers), default=0.0),
        "none": judgement.none,
        "unknown": judgement.unknown,
        "chance": chance,
        **{f"feature:{name}": value for name, value in judgement.features.items()},
    }
    for name in dict.fromkeys(candidates[score.direction.candidate].effect.name for score in scan):
        gains = [s.gain for s in scan if candidates[s.direction.candidate].effect.name == name]
        found[f"scan:{name}"] = max(gains)
    for source in sources:
        key = f"source:{source.placement.kind}"
        found[key] = max(found.get(key, -math.inf), source.gain)
    return found


def _likeliest(details: dict[str, float]) -> str:
    """The likeliest detail of a place, or several where the data do not tell one from the other."""
    best = max(details.values())
    return joined(sorted(what for what, p in details.items() if what and p > _AS_LIKELY * best))


def _parameters(fitted_model: FittedModel, whole: FloatArray) -> dict[str, Value]:
    """Reported parameters of a fitted model with standard uncertainties, carried through to first order (GUM, 5.2).

    Args:
        fitted_model: the explanation.
        whole: covariance of its fit, shape (n, n).
    """
    parametrisation = fitted_model.fit.parametrisation
    theta, std = fitted_model.fit.theta, fitted_model.fit.std
    result: dict[str, Value] = {}
    several = len(fitted_model.candidates) > 1
    for index, candidate in enumerate(fitted_model.candidates):
        own = parametrisation.index_of(index)
        covariance = whole[own, own]
        for name, (value, unit) in parametrisation.reported(theta, index).items():
            slopes = np.empty(own.stop - own.start)
            for position, k in enumerate(range(own.start, own.stop)):
                moved = theta.copy()
                moved[k] += 0.1 * std[k]
                slopes[position] = (parametrisation.reported(moved, index)[name][0] - value) / (0.1 * std[k])
            # Parameters of one effect go together: a softer joint that slips earlier does nearly the same.
            variance = float(slopes @ covariance @ slopes) if np.all(np.isfinite(slopes)) else math.inf
            result[f"{candidate.label}.{name}" if several else name] = Value(
                value, math.sqrt(max(variance, 0.0)) * fitted_model.fit.scatter, unit
            )
    return result
