"""The fewest answers that hold 95 %: which, in which order, and what stands in them beside what is named."""

from __future__ import annotations

import math

import pytest

from nmt_diagnose.ledger.credible_answers import credible_answers
from nmt_diagnose.ledger.diagnosis import Answer, Ranked, Share, Verdict

NOT_TRIED = Share(math.nan, math.nan, math.nan)
KINDRED = ("cubic_stiffness", "quintic_stiffness")


def ranked(effect: str, probability: float, *equivalents: str) -> Ranked:
    return Ranked(effect, "structure", "7", probability, equivalents, {}, NOT_TRIED, 20.0)


def test_the_fewest_answers_hold_95_per_cent() -> None:
    ranking = [ranked("cubic_stiffness", 0.6, "quintic_stiffness")]
    probabilities = {
        "none": 0.02, "cubic_stiffness@7": 0.4, "quintic_stiffness@7": 0.2, "unknown": 0.36, "two_sided_gap@3": 0.02,
    }  # fmt: skip
    first, second = credible_answers(Verdict.EFFECT, True, ranking, probabilities)
    assert first == Answer("effect", KINDRED, pytest.approx(0.6))
    assert second == Answer("unknown", (), 0.36)
    assert first.probability + second.probability > 0.95
    probabilities |= {"unknown": 0.34, "two_sided_gap@3": 0.04}
    assert len(credible_answers(Verdict.EFFECT, True, ranking, probabilities)) == 3


def test_places_and_order_of_two_effects_make_no_other_answer() -> None:
    ranking = [ranked("second_friction_contact + mains_hum", 0.9)]
    probabilities = {
        "second_friction_contact@6 + mains_hum@a2": 0.5, "mains_hum@a2 + second_friction_contact@7": 0.4, "none": 0.1,
    }  # fmt: skip
    first, second = credible_answers(Verdict.EFFECT, True, ranking, probabilities)
    assert first == Answer("effect", ("mains_hum + second_friction_contact",), pytest.approx(0.9))
    assert second.kind == "none"


def test_without_a_gap_anything_may_act_that_is_too_weak() -> None:
    probabilities = {"none": 0.84, "unknown": 0.0, "preload_loss@time": 0.16}
    for verdict in (Verdict.NONE, Verdict.CALIBRATION):
        none, weak = credible_answers(verdict, True, (), probabilities)
        assert (none.kind, weak.kind, weak.effects) == ("none", "too_weak", ())
        assert weak.probability == pytest.approx(0.16)


def test_a_partial_explanation_leaves_room_for_what_the_library_lacks() -> None:
    ranking = [ranked("cubic_stiffness", 0.97), ranked("two_sided_gap", 0.03)]
    probabilities = {"none": 0.0, "unknown": 1.0, "cubic_stiffness@7": 1e-9}
    named = 0.44
    unnamed, cubic = credible_answers(Verdict.EFFECT, False, ranking, probabilities)
    assert unnamed == Answer("unknown", (), pytest.approx(1.0 - named))
    assert cubic == Answer("effect", ("cubic_stiffness",), pytest.approx(0.97 * named))
