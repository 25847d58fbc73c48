"""Reliabilities learned from cases whose truth is known: as often right as they say, on made-up features."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nmt_blind.campaign.calibrate import QUESTIONS, calibrate, learn
from nmt_blind.campaign.scored_case import ScoredCase, scored_case
from nmt_core.errors import BenchError
from nmt_diagnose.inference.confidence import CONFIDENCE_FILE, Reliability, confidence

GAP, UNNAMED, FIRST = QUESTIONS


def case(kind: str, features: dict[str, Any], truth: str = "", said: str = "", verdict: str = "effect") -> ScoredCase:
    effects = [{"name": truth, "place": "structure", "sigma": 8.0}] if truth else []
    entry = {"case": "0001", "kind": kind, "shifted": False, "withheld": "", "effects": effects}
    diagnosis = {
        "verdict": verdict,
        "ranking": [{"effect": said, "place": "structure", "probability": 0.5}] if said else [],
        "features": {f"feature:{name}": value for name, value in features.items()},
    }
    return scored_case(entry, {"diagnosis": diagnosis})


def gap_cases(count: int, slope: float, bias: float) -> list[ScoredCase]:
    generator = np.random.default_rng(5)
    odds = generator.uniform(-3.0, 3.0, count)
    yes = generator.random(count) < 1.0 / (1.0 + np.exp(-(bias + slope * odds)))
    return [
        case("effect" if y else "null", {"log_odds": x}, "air_drag" if y else "")
        for x, y in zip(odds, yes, strict=True)
    ]


def test_a_known_law_is_found_again() -> None:
    found = learn(GAP, gap_cases(4000, 1.3, 0.6))
    assert found.weights["log_odds"] == pytest.approx(1.3, abs=0.15)
    assert found.bias == pytest.approx(0.6, abs=0.12)
    assert found.error < 0.04
    assert 0.75 < found.area < 0.95


def test_a_sign_never_counts_against_what_it_stands_for() -> None:
    cases = gap_cases(400, -1.0, 0.0)  # the truth runs the wrong way
    assert learn(GAP, cases).weights["log_odds"] == 0.0


def test_what_was_learned_before_is_kept_as_firmly_as_asked() -> None:
    cases, before = gap_cases(100, 1.3, 0.6), np.array([0.2, 0.4])
    alone = learn(GAP, cases)
    strict = learn(GAP, cases, before, 1e9)
    assert (strict.bias, strict.weights["log_odds"]) == pytest.approx((0.2, 0.4), abs=1e-6)
    away = [abs(learn(GAP, cases, before, keep).weights["log_odds"] - 0.4) for keep in (0.5, 20.0, 1e3)]
    assert away == sorted(away, reverse=True)
    assert learn(GAP, cases, np.zeros(2), 1e-3).weights["log_odds"] == pytest.approx(
        alone.weights["log_odds"], abs=0.15
    )


def test_a_gap_without_any_named_explanation_teaches_nothing_about_names() -> None:
    nameless = case("open", {}, "lugre_joint", verdict="unknown")
    assert UNNAMED.answer(nameless) is None


def test_infinite_odds_are_the_lowest_of_their_range() -> None:
    cases = gap_cases(200, 1.3, 0.6)
    plain = learn(GAP, [*cases, case("null", {"log_odds": -3.0})])
    assert learn(GAP, [*cases, case("null", {"log_odds": None})]).bias == plain.bias


def test_questions_ask_the_cases_they_are_about() -> None:
    named = case("effect", {}, "air_drag", "air_drag")
    wrong = case("effect", {}, "air_drag", "microslip")
    quiet = case("effect", {}, "air_drag", verdict="none")
    odd = case("open", {}, "lugre_joint", "microslip")
    plain = case("null", {}, verdict="none")
    assert [GAP.answer(c) for c in (named, odd, plain)] == [True, True, False]
    assert [UNNAMED.answer(c) for c in (named, odd, plain, quiet)] == [False, True, None, None]
    assert [FIRST.answer(c) for c in (named, wrong, quiet, odd, plain)] == [True, False, None, None, None]


def test_too_few_cases_are_refused() -> None:
    with pytest.raises(BenchError, match="Only 3 development cases"):
        learn(GAP, gap_cases(3, 1.0, 0.0))


@pytest.mark.parametrize("keep", [-1.0, float("nan")])
def test_a_negative_firmness_is_refused(tmp_path: Path, keep: float) -> None:
    with pytest.raises(BenchError, match="give 0 or more"):
        calibrate([], CONFIDENCE_FILE, tmp_path / "confidence.json", keep)


def test_sealed_campaigns_teach_nothing(tmp_path: Path) -> None:
    (tmp_path / "seal.json").write_text(json.dumps({"purpose": "sealed"}), encoding="utf-8")
    with pytest.raises(BenchError, match="Only development cases"):
        calibrate([tmp_path], CONFIDENCE_FILE, tmp_path / "confidence.json")
    assert not (tmp_path / "confidence.json").exists()


def test_the_frozen_calibration_has_a_reliability_for_each_question() -> None:
    frozen = confidence()
    for question in QUESTIONS:
        found: Reliability = getattr(frozen, question.name)
        assert set(found.weights) <= set(question.features)
        for name, sign in question.features.items():
            assert sign * found.weights.get(name, 0.0) >= 0.0
