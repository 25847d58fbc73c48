"""Headline, colour, sentences, tables and JSON of a diagnosis say the same: fifty mixed results compared."""

from __future__ import annotations

import io
import json
import math
from dataclasses import replace
from itertools import product
from typing import Any

import pytest
from rich.console import Console

from nmt_diagnose.effects.location import Cause, Explanation, Location
from nmt_diagnose.ledger.diagnosis import NULL, UNKNOWN, Diagnosis, Gap, PlaceShare, Ranked, Share, Value, Verdict
from nmt_diagnose.ledger.size import Objection
from nmt_diagnose.say.sentences import sentences
from nmt_diagnose.say.words import verdict_text
from nmt_report.diagnosis_report import probability_shares
from nmt_report.diagnosis_tables import ranking_table

EFFECTS = ("cubic_stiffness", "viscous_damping + mains_hum", "microslip")
LEFT = (Objection("run: frequency", "frequency", 0.004),)


def made(verdict: Verdict, adequate: bool, effect: str, p: float) -> Diagnosis:
    closed = Share(0.97 if adequate else 0.9, 0.85, 0.99)
    partial = verdict is Verdict.EFFECT and not adequate
    head = Ranked(
        effect, "structure", "7", p, (), {"k": Value(1.0, 0.1, "N/m³")}, closed, 9.0,
        adequate=adequate and verdict is Verdict.EFFECT, given_library=partial,
    )  # fmt: skip
    nan = math.nan
    gap = Gap(9.0, 1.0 if adequate else 3.7, 1.0, 12.0, closed.value, closed.low, closed.high, {}, ())
    quiet = verdict in (Verdict.NONE, Verdict.CALIBRATION)
    gap = replace(gap, closed=nan, low=nan, high=nan) if quiet else gap
    named = 0.02 if quiet or verdict is Verdict.UNKNOWN or partial else p
    probabilities = {NULL: 0.9 if quiet else 0.0, effect: named, UNKNOWN: 1.0 - named - (0.9 if quiet else 0.0)}
    head = head if verdict is Verdict.EFFECT else replace(head, probability=0.02)
    where = () if quiet else (PlaceShare("structure", "7", 1.0, 1.0),)
    explanation = Explanation(tuple(Cause(name, Location.at("structure", 7)) for name in effect.split(" + ")))
    said = sentences(verdict, where, (head,), explanation, gap, (), (), None, () if adequate else LEFT)
    return Diagnosis(
        verdict,
        said,
        where,
        (head,),
        probabilities,
        gap,
        (),
        (),
        {},
        adequate=adequate and verdict is not Verdict.UNKNOWN,
    )


CASES = [
    (verdict, adequate, effect, p)
    for verdict, adequate, effect, p in product(Verdict, (True, False), EFFECTS, (0.55, 0.97, 0.995))
    if verdict is not Verdict.UNKNOWN or not adequate
]


@pytest.mark.parametrize(("verdict", "adequate", "effect", "p"), CASES)
def test_nothing_contradicts(verdict: Verdict, adequate: bool, effect: str, p: float) -> None:
    found = made(verdict, adequate, effect, p)
    plain: dict[str, Any] = json.loads(json.dumps(found.to_mapping()))
    headline, colour = verdict_text(found)
    console = Console(file=io.StringIO(), width=200)
    console.print(ranking_table(found))
    table = console.file.getvalue()  # type: ignore[attr-defined]
    text = " ".join(found.sentences)
    partial = verdict is Verdict.EFFECT and not adequate
    names = effect.replace("_", " ")
    unnamed = plain["probabilities"][UNKNOWN]

    assert plain["verdict"] == verdict.value
    assert sum(share for _, _, share, _ in probability_shares(found)) == pytest.approx(1.0, abs=0.01)
    assert plain["adequate"] == (verdict is not Verdict.UNKNOWN and adequate)
    assert ("the model lacks" in headline) == (verdict is Verdict.EFFECT and adequate)
    assert ("The cause is" in text or "The most probable cause is" in text) == ("the model lacks" in headline)
    if "the model lacks" in headline:
        assert names in headline
        assert plain["ranking"][0]["probability"] > unnamed
        assert colour == "good"
    if partial:
        assert headline.startswith(names)
        assert headline.endswith("of the gap; 10.0 % is unexplained")
        assert f"acts like {names}" in text
        assert "among the effects of the library" in text
        assert "0.4 % of the frequency (run: frequency) remain that it does not explain" in text
        assert plain["ranking"][0]["given_library"] is True
        assert plain["ranking"][0]["adequate"] is False
        assert "among the library" in table
        assert "something not in the library acts, too" in table
        assert colour == "partly"
    else:
        assert not plain["ranking"][0]["given_library"]
        assert "among the library" not in table
    if verdict is Verdict.UNKNOWN:
        assert unnamed > plain["ranking"][0]["probability"]
        assert colour == "partly"
        assert "Nothing in the library explains all of it" in text


def test_what_stands_beside_a_partial_explanation_has_no_share_of_its_own() -> None:
    found = made(Verdict.EFFECT, False, "cubic_stiffness", 0.97)
    with_second = replace(found.ranking[0], effect="cubic_stiffness + power_law_damping", probability=0.96)
    other = replace(found.ranking[0], effect="quintic_stiffness", probability=0.03)
    found = replace(found, ranking=(found.ranking[0], with_second, other))
    shares = probability_shares(found)
    assert [text for text, *_ in shares] == ["cubic stiffness", "quintic stiffness"]
    assert sum(share for _, _, share, _ in shares) == pytest.approx(1.0)
    console = Console(width=200, file=io.StringIO())
    table = ranking_table(found)
    assert table is not None
    console.print(table)
    (line,) = (text for text in console.file.getvalue().splitlines() if "power law damping" in text)  # type: ignore[attr-defined]
    assert "within the first" in line
    assert "96" not in line


def test_there_are_fifty_cases() -> None:
    assert len(CASES) >= 50


@pytest.mark.parametrize(
    ("effect", "factor", "words"),
    [
        ("local_stiffness", 0.7, "the model is too stiff (the structure, point 7)"),
        ("local_stiffness", 1.3, "the model is too soft (the structure, point 7)"),
        ("local_mass", 0.7, "the model is too heavy (the structure, point 7)"),
        ("local_mass", 1.3, "the model is too light (the structure, point 7)"),
    ],
)
def test_a_region_is_off_to_the_side_of_its_factor(effect: str, factor: float, words: str) -> None:
    found = made(Verdict.EFFECT, True, effect, 0.99)
    (head,) = found.ranking
    head = replace(head, parameters={"factor": Value(factor, 0.01, "1")})
    assert verdict_text(replace(found, ranking=(head,)))[0] == words
    # Where stiffness and mass cannot be told apart neither side is known.
    either = replace(head, equivalents=("local_mass" if effect == "local_stiffness" else "local_stiffness",))
    assert verdict_text(replace(found, ranking=(either,)))[0].startswith("the model lacks")
