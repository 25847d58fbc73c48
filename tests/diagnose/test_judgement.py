"""From fits to probabilities, on fits of linear models whose evidences are known."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from types import SimpleNamespace

import numpy as np
import pytest
from diagnose.linear_problem import FunctionModel, Plain, observations_of

from nmt_diagnose.effects.effect import Candidate, Site
from nmt_diagnose.effects.library import effect_named
from nmt_diagnose.effects.placement import Placement
from nmt_diagnose.inference.confidence import RANGES, Confidence, Reliability, bounded
from nmt_diagnose.inference.confidence import confidence as frozen
from nmt_diagnose.inference.fit import fit
from nmt_diagnose.inference.fitted_model import FittedModel
from nmt_diagnose.inference.generic_source import SourceScore
from nmt_diagnose.inference.judgement import (
    Judgement,
    judge,
    with_held_out,
    with_prior_conflict,
    with_share_left,
    with_share_unexplained,
)
from nmt_diagnose.inference.physical_limits import beyond_limits, incredible
from nmt_diagnose.inference.problem import Problem
from nmt_diagnose.inference.scan import Direction, Score

CUBIC = Candidate(effect_named("cubic_stiffness"), Site(Placement.at("structure", 2), {"k": 1.0}, 2))
QUINTIC = Candidate(effect_named("quintic_stiffness"), Site(Placement.at("structure", 2), {"k": 1.0}, 2))
DRAG = Candidate(effect_named("air_drag"), Site(Placement.at("structure", 1), {"c2": 1.0}, 1))
JOINT = Placement("joint", detail="joint")
LIBRARY = (CUBIC, QUINTIC, DRAG)
ROWS = 50
_generator = np.random.default_rng(11)
A = _generator.standard_normal(ROWS)
A *= 8.0 / np.linalg.norm(A)
B = _generator.standard_normal(ROWS)
B -= A * (A @ B) / (A @ A)
B *= 8.0 / np.linalg.norm(B)
NOISE = _generator.standard_normal(ROWS)
# Evidences and priors as they are: what the features are worth is another matter.
PLAIN = replace(
    frozen(),
    equivalence=3.0,
    gap=Reliability(0.0, {"log_odds": 1.0}),
    unnamed=Reliability(0.0, {"unknown_odds": 1.0}),
    first=Reliability(0.0, {"margin": 1.0}),
)


def fitted_model(measured: np.ndarray, *explained: tuple[Candidate, np.ndarray], spread: float = 3.0) -> FittedModel:
    """The fit of an explanation with one column per effect."""
    matrix = np.column_stack([column for _, column in explained]) if explained else np.zeros((ROWS, 0))
    plain = Plain.of(len(explained), spread)
    problem = Problem(observations_of(measured, 1.0), FunctionModel(lambda t: matrix @ t))
    return FittedModel(tuple(c for c, _ in explained), fit(problem, plain, np.zeros(len(explained))))


def judged(measured: np.ndarray, sources: tuple[SourceScore, ...] = (), confidence: Confidence = PLAIN) -> Judgement:
    near = A + 0.02 * B
    singles = [
        fitted_model(measured, (CUBIC, A)),
        fitted_model(measured, (QUINTIC, near)),
        fitted_model(measured, (DRAG, B)),
    ]
    singles.sort(key=lambda item: -item.fit.log_evidence)
    pairs = [fitted_model(measured, (CUBIC, A), (QUINTIC, near))]
    return judge(fitted_model(measured), singles, pairs, sources, (), LIBRARY, confidence)


@pytest.mark.parametrize("size", [0.0, 0.3, 1.0, 3.0])
def test_probabilities_sum_to_one(size: float) -> None:
    source = SourceScore(JOINT, 2.0, 9.0, 2.0)
    found = judged(size * A + NOISE, sources=(source,))
    named = sum(group.probability for group in found.classes)
    assert found.none + found.unknown + named + found.by_label["other"] == pytest.approx(1.0)
    assert sum(found.by_label.values()) == pytest.approx(1.0)
    assert sum(found.places.values()) == pytest.approx(1.0)
    assert found.unknown > 0.0


def test_what_looks_alike_is_one_class_and_more_of_the_same_is_no_member() -> None:
    found = judged(2.0 * A + NOISE)
    first = found.classes[0]
    assert set(first.effects) == {("cubic_stiffness",), ("quintic_stiffness",)}
    pair = found.by_label["cubic_stiffness@2 + quintic_stiffness@2"]
    single = found.by_label["cubic_stiffness@2"] + found.by_label["quintic_stiffness@2"]
    assert first.probability == pytest.approx(pair + single)
    assert first.probability > 0.95
    assert next(iter(found.places)) == Placement.at("structure", 2)


def test_forms_of_an_effect_compete_and_share_a_label() -> None:
    stuck = Candidate(replace(CUBIC.effect, form="stuck"), CUBIC.site)
    assert stuck.cause != CUBIC.cause
    assert stuck.cause.same_but_for_form(CUBIC.cause)
    null, own, other = fitted_model(B), fitted_model(B, (CUBIC, A + B)), fitted_model(B, (stuck, B))
    found = judge(null, [other, own], [], (), (), (CUBIC, stuck), PLAIN)
    assert len(found.named) == 2
    assert found.by_label[CUBIC.label] == pytest.approx(sum(found.named.values()))
    assert found.classes[0].head.candidates == (stuck,)


def test_noise_is_none_and_an_effect_is_one() -> None:
    assert judged(NOISE).none > 0.5
    assert judged(NOISE).log_odds < 0.0
    found = judged(2.0 * B + NOISE)
    assert found.classes[0].effects == (("air_drag",),)
    assert found.classes[0].probability > 0.99
    assert found.log_odds > 50.0


def test_drag_that_no_air_has_is_not_named() -> None:
    """Power-law damping that fits a little worse is; within what air can do the better fit is."""
    law = Candidate(effect_named("power_law_damping"), Site(Placement.at("structure", 1), {"force": 1.0}, 1))
    measured = 8.0 * B + NOISE
    for limit, named in ((0.5, "power_law_damping"), (100.0, "air_drag")):
        drag = replace(DRAG, site=replace(DRAG.site, limits={"c2": limit}))
        fitted = fitted_model(measured, (drag, B))
        own = SimpleNamespace(
            values=lambda theta, _: {"c2": float(theta[0])}, index_of=lambda _: slice(0, 1), prior_std=np.array([3.0])
        )
        fitted = replace(fitted, fit=replace(fitted.fit, parametrisation=own))
        competing = [fitted, fitted_model(measured, (law, 0.95 * B + 0.05 * A))]
        found = judge(fitted_model(measured), competing, (), (), (), (drag, law), PLAIN)
        assert found.classes[0].head.effects == (named,)
        assert beyond_limits(fitted.candidates, fitted.fit) == pytest.approx(
            max(0.0, (fitted.fit.theta[0] - limit) / np.hypot(0.5 * limit, fitted.fit.std[0]))
        )
        score = Score(Direction(0, np.zeros(1), B, True), 8.0, 64.0, 4096.0, 8.0)
        assert incredible(drag, score) == (named != "air_drag")


def test_a_source_that_explains_more_than_all_names_is_unknown() -> None:
    measured = 0.5 * A + NOISE
    plain = judged(measured)
    found = judged(measured, sources=(SourceScore(JOINT, plain.log_odds + 20.0, 60.0, 3.0),))
    assert found.unknown > 0.99
    assert next(iter(found.places)) == JOINT
    assert found.features["unknown_odds"] > 10.0


def test_signs_beyond_what_was_seen_count_no_more() -> None:
    low, high = RANGES["leftover"]
    sign = Reliability(0.5, {"leftover": 2.0})
    assert sign.probability({"leftover": high + 50.0}) == sign.probability({"leftover": high})
    assert sign.probability({"leftover": -np.inf}) == sign.probability({"leftover": low})
    assert bounded("leftover", float("nan")) == low
    assert sign.probability({"leftover": 0.0}) == pytest.approx(1.0 / (1.0 + np.exp(-0.5)))


def test_reliabilities_move_probability_between_none_named_and_unnamed() -> None:
    measured = 0.5 * A + NOISE
    source = (SourceScore(JOINT, 2.0, 9.0, 2.0),)
    plain = judged(measured, source)
    doubtful = judged(measured, source, replace(PLAIN, gap=Reliability(0.0, {}), unnamed=Reliability(0.0, {})))
    assert doubtful.none == pytest.approx(0.5)
    assert doubtful.unknown == pytest.approx(0.25)
    assert doubtful.log_odds == plain.log_odds
    assert doubtful.unknown_odds == pytest.approx(0.0, abs=1e-6)
    # Among the named the order stays.
    assert [c.effects for c in doubtful.classes] == [c.effects for c in plain.classes]
    unsure = judged(measured, source, replace(PLAIN, first=Reliability(0.0, {})))
    named = 1.0 - unsure.none - unsure.unknown
    assert unsure.classes[0].probability == pytest.approx(0.5 * named)
    assert all(c.probability <= unsure.classes[0].probability for c in unsure.classes)


def test_two_effects_at_one_point_are_a_sign_of_their_own() -> None:
    pair = fitted_model(2.0 * A + 2.0 * B + NOISE, (CUBIC, A), (DRAG, B))
    singles = [fitted_model(2.0 * A + 2.0 * B + NOISE, (CUBIC, A))]
    plain = fitted_model(2.0 * A + 2.0 * B + NOISE)
    apart = judge(plain, singles, [pair], (), (), LIBRARY, PLAIN, pair)
    assert apart.features["second"] == 1.0
    assert apart.features["together"] == 0.0  # points 2 and 1
    near = replace(pair, candidates=(CUBIC, Candidate(DRAG.effect, Site(Placement.at("structure", 2), {"c2": 1.0}, 2))))
    library = (*LIBRARY, near.candidates[1])
    assert judge(plain, singles, [near], (), (), library, PLAIN, near).features["together"] == 1.0


def test_what_a_test_finds_and_chance_would_not_is_unnamed() -> None:
    plain = fitted_model(NOISE)
    often = judge(plain, [], [], (), (), LIBRARY, PLAIN, None, 1e-3)
    never = judge(plain, [], [], (), (), LIBRARY, PLAIN, None, 1e-12)
    assert often.log_odds < 0.0
    assert never.log_odds > 10.0
    assert never.unknown > 0.99


def test_what_little_is_left_of_a_gap_is_all_that_can_be_unnamed() -> None:
    source = (SourceScore(JOINT, 60.0, 9.0, 2.0),)
    plain = judged(1.0 * A + NOISE, source, replace(PLAIN, unnamed=Reliability(0.0, {})))
    found = with_share_left(plain, 0.02)
    assert found.unknown == pytest.approx(0.02 * plain.unknown)
    assert found.none == plain.none
    assert sum(found.by_label.values()) == pytest.approx(1.0)
    named = 1.0 - found.none - found.unknown
    assert found.classes[0].probability / plain.classes[0].probability == pytest.approx(
        named / (1.0 - plain.none - plain.unknown)
    )


def test_what_is_left_of_a_clear_gap_is_unnamed_at_least_in_proportion() -> None:
    source = (SourceScore(JOINT, 60.0, 9.0, 2.0),)
    plain = judged(1.0 * A + NOISE, source, replace(PLAIN, unnamed=Reliability(-1.0, {})))
    given_gap = plain.unknown / (1.0 - plain.none)
    assert with_share_unexplained(plain, 0.5 * given_gap) is plain
    found = with_share_unexplained(plain, 0.9)
    assert found.unknown == pytest.approx(0.9 * (1.0 - plain.none))
    assert found.none == plain.none
    assert sum(found.by_label.values()) == pytest.approx(1.0)
    assert found.classes[0].probability < plain.classes[0].probability


def test_parameters_that_nobody_believes_raise_the_alarm_where_nothing_else_does() -> None:
    confidence = replace(PLAIN, alarm=2.5)
    weak, strong = judged(0.1 * A + 0.2 * NOISE, confidence=confidence), judged(2.0 * A + NOISE, confidence=confidence)
    assert weak.log_odds < confidence.alarm < strong.log_odds
    assert with_prior_conflict(strong, 50.0, confidence) is strong
    assert with_prior_conflict(weak, 0.0, confidence) is weak
    found = with_prior_conflict(weak, 20.0, confidence)
    own = 20.0 + np.log(confidence.prior_unknown / confidence.prior_none)
    assert found.log_odds == pytest.approx(np.logaddexp(weak.log_odds, own))
    assert found.log_odds > confidence.alarm
    assert found.unknown > 0.99
    assert found.strained
    assert found.places == {}
    assert sum(found.by_label.values()) == pytest.approx(1.0)


def test_the_prior_of_a_pair_is_that_of_two_draws_in_any_order() -> None:
    """Two effects drawn one after the other, each kind as likely: a pair comes up in either order."""
    kinds = [candidate.effect.name for candidate in LIBRARY]
    wanted = {CUBIC.effect.name, DRAG.effect.name}
    draws = list(product(kinds, repeat=2))
    share = sum(set(draw) == wanted for draw in draws) / len(draws)
    measured = 2.0 * A + 0.5 * B + NOISE
    plain, single = fitted_model(measured), fitted_model(measured, (CUBIC, A))
    pair = fitted_model(measured, (CUBIC, A), (DRAG, B))
    even = replace(PLAIN, inexactness=0.0)
    found = judge(plain, [single], [pair], (), (), LIBRARY, even)
    expected = even.prior_pair * share / (even.prior_effect / len(kinds))
    assert -2.0 < found.features["margin"] < 8.0
    ratio = found.named[pair.explanation] / found.named[single.explanation]
    gain = pair.fit.log_evidence - single.fit.log_evidence
    assert np.log(ratio) == pytest.approx(np.log(expected) + gain)
    # Something unnamed behind a pair costs the pair first.
    behind = [
        judge(plain, [single], [pair], (), (), LIBRARY, even, best, 1e-30).features["unknown_odds"]
        for best in (pair, single)
    ]
    assert behind[0] - behind[1] == pytest.approx(np.log(expected) + gain)


def strong(first: float, second: float) -> tuple[FittedModel, list[FittedModel], FittedModel]:
    """The plain model, single explanations and the pair, of two effects of such strengths in standard deviations."""
    loose = lambda measured, *explained: fitted_model(measured, *explained, spread=1e5)  # noqa: E731
    measured = (first / 8.0) * A + (second / 8.0) * B + NOISE
    singles = [loose(measured, (CUBIC, A)), loose(measured, (DRAG, B))]
    return fitted_model(measured), singles, loose(measured, (CUBIC, A), (DRAG, B))


@pytest.mark.parametrize("sigma", [64.0, 512.0, 4096.0])
def test_a_pair_that_explains_everything_is_named_however_strong(sigma: float) -> None:
    plain, singles, pair = strong(sigma, sigma)
    assert pair.fit.chi_square < 2.0 * ROWS
    # As the diagnosis calls it where nothing is left behind the best explanation.
    found = judge(plain, singles, [pair], (), (), LIBRARY, frozen(), pair, 1.0)
    assert found.classes[0].head is pair
    assert found.unknown < 0.1
    assert found.classes[0].probability > 0.8


@pytest.mark.parametrize(("sigma", "second"), [(64.0, 16.0), (512.0, 32.0), (4096.0, 256.0)])
def test_a_weaker_second_effect_is_found_beside_a_strong_one(sigma: float, second: float) -> None:
    plain, singles, pair = strong(sigma, second)
    found = judge(plain, singles, [pair], (), (), LIBRARY, frozen(), pair, 1.0)
    assert found.classes[0].head is pair


def test_what_an_inexact_model_of_a_strong_effect_leaves_is_no_second_effect() -> None:
    # Three percent of an effect of 4096 standard deviations are 123 of them.
    plain, singles, pair = strong(4096.0, 100.0)
    found = judge(plain, singles, [pair], (), (), LIBRARY, frozen(), pair, 1.0)
    assert found.classes[0].head is singles[0]
    # Within the strengths that the share was learned on, all of it counts.
    plain, singles, pair = strong(64.0, 6.0)
    gain = pair.fit.log_evidence - singles[0].fit.log_evidence
    paid = 0.01 * (singles[0].fit.log_evidence - plain.fit.log_evidence)
    free = judge(plain, singles, [pair], (), (), LIBRARY, replace(frozen(), inexactness=0.0), pair, 1.0)
    held = judge(plain, singles, [pair], (), (), LIBRARY, replace(frozen(), inexactness=0.01), pair, 1.0)
    assert gain < paid
    assert free.classes[0].head is pair
    assert held.classes[0].head is singles[0]


def test_the_held_out_score_takes_part_in_the_ranking() -> None:
    plain = judged(2.0 * A + 0.6 * B + NOISE)
    first, second = plain.classes[0].head.explanation, plain.classes[1].head.explanation
    # Chance is no reason.
    assert with_held_out(plain, {first: 1.9, second: 0.0}) is plain
    found = with_held_out(plain, {first: 9.0, second: 0.0})
    assert found.classes[0].head.explanation == second
    assert (found.none, found.unknown) == (plain.none, plain.unknown)
    named = sum(group.probability for group in plain.classes)
    assert sum(group.probability for group in found.classes) == pytest.approx(named)
    assert sum(found.by_label.values()) == pytest.approx(1.0)


def test_what_was_not_compared_on_held_out_data_gains_nothing_by_it() -> None:
    plain = judged(2.0 * A + 0.6 * B + NOISE)
    first, *others = [group.head.explanation for group in plain.classes]
    assert others
    found = with_held_out(plain, {first: 30.0})
    before = {group.head.explanation: group.probability for group in plain.classes}
    after = {group.head.explanation: group.probability for group in found.classes}
    assert {e: after[e] for e in others} == {e: before[e] for e in others}
