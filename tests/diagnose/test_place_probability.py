"""Probability of the place of an effect, of a model whose mode shapes are off by some per cent."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from nmt_diagnose.effects.location import Cause, Explanation, Location
from nmt_diagnose.ledger.comparison import Comparison, EquivalentClass, Hypotheses, by_plain_effect
from nmt_diagnose.ledger.diagnosis import Ranked, Share
from nmt_diagnose.ledger.gap import ClosedShare
from nmt_diagnose.ledger.size import IMITATION
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


def pair(residual: np.ndarray) -> Any:
    """The effect at point 4 with a damping at point 1 beside it, of equal strengths."""
    made = found(residual, 4)
    damping = Cause("viscous_damping", Location.at("structure", 1))
    made.explanation = Explanation((*made.explanation.causes, damping))
    made.effects = made.explanation.effects
    beside = SimpleNamespace(
        effect=SimpleNamespace(name="viscous_damping"), site=SimpleNamespace(location=damping.location, limits={})
    )
    made.candidates = (*made.candidates, beside)
    made.stated, made.strength = (0, 1), lambda member: 5.0
    return made


def test_an_effect_of_a_pair_that_was_fitted_at_one_place_is_no_surer_of_it_than_by_itself() -> None:
    null, here, there = found(LEFT + 900.0 * ALONG), found(LEFT + 3.0 * ALONG, 4), found(LEFT + 6.0 * ALONG, 7)
    both = pair(LEFT)
    known = [here.candidates[0], both.candidates[1]]
    for single in (here, there):
        single.strength = lambda member: 5.0
    everything = Hypotheses(None, null, [here, there, both], known, [], [], [])  # type: ignore[arg-type]
    alone = {location.detail: p for location, p in everything.located(here.effects)}
    together = {location.detail: p for location, p in everything.located(both.effects)}
    assert 0.3 < alone["7"] < 0.7
    assert together == pytest.approx({"4": 0.5 * alone["4"], "7": 0.5 * alone["7"], "1": 0.5})
    # Where the effect was not fitted by itself the pair has the place at which it was.
    by_itself = Hypotheses(None, null, [both], known, [], [], [])  # type: ignore[arg-type]
    assert {location.detail: p for location, p in by_itself.located(both.effects)} == {"4": 0.5, "1": 0.5}


def test_likely_places_are_told_with_their_probabilities() -> None:
    head = Ranked(
        "cubic_stiffness", "structure", "4", 0.9, (), {}, Share(0.9, 0.8, 1.0), 9.0,
        places={"4": 0.6, "7": 0.36, "9": 0.04},
    )  # fmt: skip
    assert place_words(head) == "; its place: point 4 (60 %), point 7 (36 %)"


@pytest.mark.parametrize(("rise", "effects"), [(8.0, 1), (80.0, 2)])
def test_what_is_too_small_to_matter_has_only_the_effects_that_the_evidence_demands(rise: float, effects: int) -> None:
    """Evidence of a second effect that is less than what one effect needs to be stated says nothing of it."""
    null, single, both = found(LEFT), found(LEFT, 4), pair(LEFT)
    for number, made in enumerate((single, both)):
        made.fitted, made.stated, made.fit.log_evidence = made.explanation, (), 100.0 + rise * number
    everything = Hypotheses(None, null, [single, both], list(both.candidates), [], [])  # type: ignore[arg-type]
    small = everything.small
    assert small is not None
    assert len(small.candidates) == effects


@pytest.mark.parametrize(("alone", "first"), [(0.995, 1), (0.97, 2)])
def test_an_effect_that_closes_as_much_as_it_and_another_is_the_answer(alone: float, first: int) -> None:
    """Two laws that may imitate a third are passed over for one that leaves nothing and closes the gap alone."""
    single, both = found(LEFT, 4), pair(LEFT)
    single.explanation = Explanation(both.explanation.causes[:1])
    classes = (EquivalentClass((both,), 0.3, 1.0, (IMITATION,)), EquivalentClass((single,), 0.0, 0.0))
    before = Comparison(0.0, 0.7, classes, {}, 50.0, {"unknown": 0.7, both.explanation.label: 0.3})
    shares = {
        it.head.explanation: ClosedShare(9.0, 1.0, 1.0, p, p, p) for it, p in zip(classes, (1.0, alone), strict=True)
    }
    after = by_plain_effect(before, shares, lambda one, other: False)
    assert len(after.classes[0].head.stated) == first
    assert (after.classes[0].probability, after.unknown) == ((1.0, 0.0) if first == 1 else (0.3, 0.7))


@pytest.mark.parametrize("alike", [True, False])
def test_a_second_effect_that_says_nothing_takes_no_probability_off_the_first(alike: bool) -> None:
    """Two laws that may imitate a third count as the one of them that does as much alone."""
    single, both = found(LEFT, 4), pair(LEFT)
    single.explanation = Explanation(both.explanation.causes[:1])
    everything = Hypotheses(None, found(LEFT), [single, both], list(both.candidates), [], [])  # type: ignore[arg-type]
    everything._left = lambda it: 0.0 if it is single else math.log(1.0 / 3.0)  # type: ignore[method-assign]
    everything._alike = lambda one, other: alike  # type: ignore[method-assign]
    assert everything._left_by_simplest(both) == pytest.approx(0.0 if alike else math.log(1.0 / 3.0))
    assert everything._left_by_simplest(single) == 0.0
