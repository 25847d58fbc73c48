"""Learns from diagnosed development cases how reliable the features of a diagnosis are."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import minimize

from nmt_blind.campaign.score import development_cases
from nmt_blind.campaign.scored_case import ScoredCase
from nmt_blind.campaign.statistics import ReliabilityDiagram, area_under_roc, reliability
from nmt_core.arrays import FloatArray
from nmt_core.errors import BenchError
from nmt_core.hardened import read_json
from nmt_core.whole_file import write_whole
from nmt_diagnose.inference.confidence import bounded

_RIDGE = 0.5
_FEWEST = 20

_Limits = tuple[float | None, float | None]
_LIMITS: dict[int, _Limits] = {1: (0.0, None), -1: (None, 0.0), 0: (None, None)}

Asked = Callable[[ScoredCase], "bool | None"]
"""Whether a case is one; None = the question is not about it."""


@dataclass(frozen=True)
class Question:
    """A question that a reliability answers.

    Attributes:
        name: key in ``confidence.json``.
        answer: of a case whose truth is known.
        features: what is learned from, and the sign that each weight must have (0 = any): more of an odds must not make
            the answer less probable, whatever few cases say.
    """

    name: str
    answer: Asked
    features: dict[str, int]


@dataclass(frozen=True)
class Learned:
    """What was learned for a question.

    Attributes:
        name: of the question.
        bias, weights: of the reliability.
        cases: that it was asked of; share: of those with the answer yes.
        error: expected calibration error on the same cases, each left out in its tenth.
        area: under the curve of right and false answers, likewise.
    """

    name: str
    bias: float
    weights: dict[str, float]
    cases: int
    share: float
    error: float
    area: float


def _gap(case: ScoredCase) -> bool | None:
    return case.kind != "null"


def _unnamed(case: ScoredCase) -> bool | None:
    # Where no named explanation was fitted a gap has no name whatever the features say.
    asked = case.kind != "null" and case.answer.alarm and case.answer.ranking
    return case.unknown if asked else None


def _first(case: ScoredCase) -> bool | None:
    if not (case.known and case.answer.alarm and case.answer.ranking):
        return None
    return case.answer.first(case.truth)


QUESTIONS = (
    Question("gap", _gap, {"log_odds": 1}),
    Question("unnamed", _unnamed, {"unknown_odds": 1, "leftover": 1, "second": 0, "together": 1, "sigmas": 0}),
    Question("first", _first, {"margin": 1, "leftover": -1, "second": 0, "together": -1, "equivalents": 0}),
)


def calibrate(folders: Sequence[Path], file: Path, target: Path, keep: float = 0.0) -> tuple[Learned, ...]:
    """Learn all reliabilities and write them into a copy of a calibration.

    Args:
        folders: diagnosed development campaigns.
        file: the calibration whose priors and thresholds are kept.
        target: file to write.
        keep: how firmly its weights are kept, as the inverse variance of a normal prior about them; 0 = these cases
            alone count.

    Raises:
        BenchError: no development campaign, too few cases, or a negative ``keep``.
    """
    if not keep >= 0.0:
        raise BenchError(f"Present weights cannot be kept {keep:g} firmly; give 0 or more.")
    cases = [case for folder in folders for case in development_cases(folder) if case.details.get("features")]
    try:
        values = read_json(file, "calibration")
    except BenchError as error:
        raise BenchError(f"The calibration {file} cannot be read ({error}).") from error
    learned = tuple(learn(q, cases, _before(values, q) if keep > 0.0 else None, keep) for q in QUESTIONS)
    for item in learned:
        weights = {name: round(weight, 4) for name, weight in item.weights.items()}
        values[item.name] = {"bias": round(item.bias, 4), "weights": weights}
    write_whole(target, json.dumps(values, indent=2) + "\n")
    return learned


def _before(values: dict[str, Any], question: Question) -> FloatArray:
    """Bias and weights of a question in a calibration, (1 + features,)."""
    own = values[question.name]
    return np.array([float(own["bias"]), *(float(own["weights"].get(name, 0.0)) for name in question.features)])


def learn(
    question: Question, cases: Sequence[ScoredCase], before: FloatArray | None = None, keep: float = 0.0
) -> Learned:
    """Logistic regression with a small ridge, or with a normal prior about weights that were learned before.

    Args:
        question: what is learned.
        cases: whose truth is known.
        before: bias and weights, (1 + features,); None = none.
        keep: inverse variance of that prior.

    Raises:
        BenchError: too few cases that the question is about.
    """
    answers = [question.answer(case) for case in cases]
    asked = [case for case, answer in zip(cases, answers, strict=True) if answer is not None]
    y = np.array([float(answer) for answer in answers if answer is not None])
    if y.size < _FEWEST or not 0.0 < y.mean() < 1.0:
        raise BenchError(
            f"Only {y.size} development cases tell about '{question.name}', or all tell the same; diagnose more."
        )
    x = np.array([_row(case, question) for case in asked])
    limits = [_LIMITS[sign] for sign in question.features.values()]
    weights = _fitted(x, y, limits, before, keep)
    # Each tenth judged by what the others teach.
    stated = np.empty(y.size)
    for part in np.array_split(np.random.default_rng(0).permutation(y.size), 10):
        others = np.setdiff1d(np.arange(y.size), part)
        stated[part] = _probability(x[part], _fitted(x[others], y[others], limits, before, keep))
    found: ReliabilityDiagram = reliability(list(stated), [bool(value) for value in y], equal=True)
    area = area_under_roc(list(stated[y > 0.5]), list(stated[y < 0.5]))
    named = dict(zip(question.features, (float(w) for w in weights[1:]), strict=True))
    return Learned(question.name, float(weights[0]), named, y.size, float(y.mean()), found.error, area)


def _row(case: ScoredCase, question: Question) -> list[float]:
    features = case.details["features"]
    # A feature that is not finite has no number in the file: it is the lowest of its range.
    values = {name: features.get(f"feature:{name}") for name in question.features}
    return [bounded(name, -np.inf if value is None else float(value)) for name, value in values.items()]


def _probability(x: FloatArray, weights: FloatArray) -> FloatArray:
    result: FloatArray = 1.0 / (1.0 + np.exp(-np.clip(weights[0] + x @ weights[1:], -30.0, 30.0)))
    return result


def _fitted(
    x: FloatArray, y: FloatArray, limits: Sequence[_Limits], before: FloatArray | None = None, keep: float = 0.0
) -> FloatArray:
    start = np.zeros(x.shape[1] + 1) if before is None else before
    ridge = np.append(0.0, np.full(x.shape[1], _RIDGE)) if before is None else np.full(x.shape[1] + 1, keep)

    def loss(weights: FloatArray) -> tuple[float, FloatArray]:
        p = np.clip(_probability(x, weights), 1e-12, 1.0 - 1e-12)
        away = ridge * (weights - start)
        value = -float(y @ np.log(p) + (1.0 - y) @ np.log(1.0 - p)) + 0.5 * float((weights - start) @ away)
        return value, np.append((p - y).sum(), x.T @ (p - y)) + away

    bounds = [_LIMITS[0], *limits]
    result: FloatArray = minimize(loss, start.copy(), jac=True, method="L-BFGS-B", bounds=bounds).x
    return result
