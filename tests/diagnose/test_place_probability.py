"""Probability of the place of an effect, of a model whose mode shapes are off by some per cent."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from nmt_diagnose.effects.location import Cause, Explanation, Location
from nmt_diagnose.ledger.comparison import Hypotheses
from nmt_diagnose.ledger.diagnosis import Ranked, Share
from nmt_diagnose.say.sentences import place_words
from nmt_diagnose.thresholds import THRESHOLDS

ROWS = 12
LEFT = np.random.default_rng(3).standard_normal(ROWS)
ALONG = np.random.default_rng(4).standard_normal(ROWS)
ALONG /= np.linalg.norm(ALONG)


def found(residual: np.ndarray, point: int = 0) -> Any:
    """An explanation by one effect at a point, or the model alone, that leaves so much in units of the noise."""
    causes = (Cause("cubic_stiffness", Location.at("structure", point)),) if point else ()
    candidate = SimpleNamespace(
        effect=SimpleNamespace(name="cubic_stiffness"),
        site=SimpleNamespace(location=Location.at("structure", point), limits={}),
    )
    own = SimpleNamespace(calibration=(), prior_std=np.zeros(0), values=lambda theta, index: {})
    errors = SimpleNamespace(residual=residual, weights=np.ones(ROWS), chain=np.zeros(0))
    evidence = -0.5 * float(residual @ residual)
    fit = SimpleNamespace(theta=np.zeros(0), parametrisation=own, errors=errors, log_evidence=evidence, promised=0.0)
    explanation = Explanation(causes)
    return SimpleNamespace(
        candidates=(candidate,) * len(causes), stated=tuple(range(len(causes))), fit=fit, explanation=explanation,
        effects=explanation.effects,
    )  # fmt: skip


def placed(apart: float, size: float, far: bool = False) -> dict[str, float]:
    """Probabilities of two points whose fits differ by so much, of an effect of such a size, both over the noise."""
    null, here, there = found(LEFT + size * ALONG), found(LEFT, 4), found(LEFT + apart * ALONG, 7)
    lag = -2.0 * (there.fit.log_evidence - here.fit.log_evidence)
    named, behind = ([here], [(there, lag)]) if far else ([here, there], [])
    everything = Hypotheses(None, null, named, [here.candidates[0]], [], [], behind)  # type: ignore[arg-type]
    return {it.explanation.place: p for it, p in everything._placed(("cubic_stiffness",))}


@pytest.mark.parametrize("far", [False, True])
@pytest.mark.parametrize(("apart", "size"), [(3.0, 10.0), (6.0, 200.0), (20.0, 900.0)])
def test_places_are_weighed_as_with_the_covariance_of_the_model_s_form(apart: float, size: float, far: bool) -> None:
    """Against the density of a normal distribution whose variance is larger along the difference of the two fits."""
    off = THRESHOLDS.comparison.place_form_std * size
    density = multivariate_normal(np.zeros(ROWS), np.eye(ROWS) + off**2 * np.outer(ALONG, ALONG))
    odds = math.exp(density.logpdf(LEFT + apart * ALONG) - density.logpdf(LEFT))
    shares = placed(apart, size, far)
    assert shares["7"] / shares["4"] == pytest.approx(odds, rel=1e-9)
    assert sum(shares.values()) == pytest.approx(1.0)


def test_a_small_effect_has_the_place_that_noise_leaves_it() -> None:
    assert placed(10.0, 1.0)["4"] > 0.999999
    assert placed(10.0, 1000.0)["4"] < 0.7


def test_likely_places_are_told_with_their_probabilities() -> None:
    head = Ranked(
        "cubic_stiffness", "structure", "4", 0.9, (), {}, Share(0.9, 0.8, 1.0), 9.0,
        places={"4": 0.6, "7": 0.36, "9": 0.04},
    )  # fmt: skip
    assert place_words(head) == "; its place: point 4 (60 %), point 7 (36 %)"
