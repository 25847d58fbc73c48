"""Simpler methods on the same cases: least χ², BIC, sparse regression, a classifier of features."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from scipy.optimize import minimize

from nmt_blind.campaign.scored_case import Answer, EffectSet, ScoredCase, effect_set
from nmt_core.numerics.arrays import FloatArray

_UNKNOWN: EffectSet = frozenset({"unknown"})
_NONE: EffectSet = frozenset()
_RIDGE = 1.0


def _singles(ranking: Sequence[EffectSet]) -> tuple[frozenset[EffectSet], ...]:
    """Each set of effects once, no equivalents."""
    listed: list[EffectSet] = []
    for effects in ranking:
        if effects and effects not in listed:
            listed.append(effects)
    return tuple(frozenset({effects}) for effects in listed)


def _fits(case: ScoredCase) -> list[tuple[EffectSet, float, int, int]]:
    """Effects, χ², added parameters and rows of all fits."""
    return [
        (
            frozenset() if entry["effect"] == "none" else effect_set(entry["effect"]),
            float(entry["chi_square"]),
            int(entry["parameters"]),
            int(entry.get("rows", 1)),
        )
        for entry in case.details.get("candidates", ())
        if entry.get("chi_square") is not None
    ]


def least_chi_square(case: ScoredCase) -> Answer:
    """The explanation with the smallest χ², whatever it costs; it always finds a gap."""
    fits = sorted(_fits(case), key=lambda fit: fit[1])
    null = next((fit[1] for fit in fits if not fit[0]), math.nan)
    named = [fit for fit in fits if fit[0]]
    if not named:
        return Answer(False, -math.inf, ())
    return Answer(named[0][1] < null, null - named[0][1], _singles([fit[0] for fit in named]))


def bayesian_information(case: ScoredCase) -> Answer:
    """Least χ² + k ln m (Schwarz, 1978); the model without effect competes."""
    fits = sorted(((fit[0], fit[1] + fit[2] * math.log(max(fit[3], 2))) for fit in _fits(case)), key=lambda fit: fit[1])
    null = next((value for effects, value in fits if not effects), math.nan)
    named = [fit for fit in fits if fit[0]]
    if not named:
        return Answer(False, -math.inf, ())
    return Answer(named[0][1] < null, null - named[0][1], _singles([fit[0] for fit in named]))


def sparse_regression(case: ScoredCase) -> Answer:
    """Ensemble SINDy on the samples (see ensemble_sindy.py)."""
    found = case.sindy.get("terms", ())
    ranking = _singles([effect_set(str(entry["effect"])) for entry in found])
    return Answer(bool(found), float(case.sindy.get("score", 0.0)), ranking)


def feature_vector(case: ScoredCase, names: Sequence[str]) -> FloatArray:
    """Features on a scale that tames large ones, signs kept; 0 where there is none."""
    features: dict[str, Any] = case.details.get("features", {})
    values = [features.get(name) for name in names]
    numbers = np.array([float(v) if isinstance(v, int | float) and math.isfinite(v) else 0.0 for v in values])
    result: FloatArray = np.sign(numbers) * np.log1p(np.abs(numbers))
    return result


class FeatureClassifier:
    """Multinomial logistic regression with a ridge, on the features of a diagnosis.

    Args:
        cases: development cases with their truth; nothing else is learned from.
    """

    def __init__(self, cases: Sequence[ScoredCase]) -> None:
        self.names = sorted({name for case in cases for name in case.details.get("features", {})})
        self.classes = sorted({_label(case) for case in cases}, key=sorted)
        x = np.array([feature_vector(case, self.names) for case in cases]).reshape(len(cases), len(self.names))
        self._mean, self._scale = x.mean(axis=0), x.std(axis=0) + 1e-9
        y = np.array([self.classes.index(_label(case)) for case in cases])
        self._weights = self._learn((x - self._mean) / self._scale, y)

    def _learn(self, x: FloatArray, y: np.ndarray[Any, np.dtype[np.int64]]) -> FloatArray:
        x = np.hstack([x, np.ones((x.shape[0], 1))])
        shape = (x.shape[1], len(self.classes))
        hot = np.eye(shape[1])[y]

        def loss(flat: FloatArray) -> tuple[float, FloatArray]:
            w = flat.reshape(shape)
            p, log_p = _softmax(x @ w)
            penalty = w.copy()
            penalty[-1] = 0.0
            value = -float((hot * log_p).sum()) + 0.5 * _RIDGE * float((penalty**2).sum())
            return value, (x.T @ (p - hot) + _RIDGE * penalty).ravel()

        start = np.zeros(shape[0] * shape[1])
        result: FloatArray = minimize(loss, start, jac=True, method="L-BFGS-B", options={"maxiter": 300}).x
        return result.reshape(shape)

    def __call__(self, case: ScoredCase) -> Answer:
        """What it says of a case."""
        x = np.append((feature_vector(case, self.names) - self._mean) / self._scale, 1.0)
        p = _softmax(x[np.newaxis] @ self._weights)[0][0]
        order = np.argsort(-p)
        by_class = {self.classes[k]: float(p[k]) for k in order}
        none = by_class.get(_NONE, 0.0)
        ranking = [self.classes[k] for k in order if self.classes[k] not in (_NONE, _UNKNOWN)]
        best = self.classes[order[0]]
        return Answer(best != _NONE, 1.0 - none, _singles(ranking), by_class.get(_UNKNOWN, 0.0))


def _label(case: ScoredCase) -> EffectSet:
    if case.kind == "null":
        return _NONE
    return _UNKNOWN if case.unknown else case.truth if case.single else frozenset({sorted(case.truth)[0]})


def _softmax(z: FloatArray) -> tuple[FloatArray, FloatArray]:
    log_p = z - z.max(axis=1, keepdims=True)
    log_p = log_p - np.log(np.exp(log_p).sum(axis=1, keepdims=True))
    return np.exp(log_p), log_p


Method = Callable[[ScoredCase], Answer]

PLAIN_METHODS: dict[str, Method] = {
    "least χ²": least_chi_square,
    "BIC": bayesian_information,
    "ensemble SINDy": sparse_regression,
}
