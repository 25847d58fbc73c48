"""The rules of the verdict: each decides at its limit, and each is why some explanation is not stated."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from functools import cache
from typing import Any

import pytest
from diagnose.predicted_observations import chain, observations_of_model, real
from tiers import with_quick

from nmt_core.errors import BenchError
from nmt_diagnose.diagnose import diagnose_observations
from nmt_diagnose.diagnosis_settings import DiagnosisSettings
from nmt_diagnose.effects.library import library
from nmt_diagnose.ledger.diagnosis import Verdict
from nmt_diagnose.ledger.row import Facts
from nmt_diagnose.ledger.rules import RULES, rule_named, rulings_of, verdict_of
from nmt_diagnose.ledger.why import why
from nmt_diagnose.observations.channels.measuring_chain import MeasuringChain
from nmt_rig.rig import Rig

MODEL = chain()
# Facts of an explanation just on either side of the limit of each rule: passed, failed.
EDGES: dict[str, tuple[Facts, Facts]] = {
    "promising": (Facts(promised=6.1), Facts(promised=5.9)),
    "promising beside others": (
        Facts(promised=20.1, promised_least=20.0), Facts(promised=19.9, promised_least=20.0)
    ),
    "near": (Facts(behind=39.0), Facts(behind=41.0)),
    "near beside others": (Facts(behind=9.0, behind_most=10.0), Facts(behind=11.0, behind_most=10.0)),
    "needed": (Facts(left_without=1.01), Facts(left_without=0.99)),
    "within": (Facts(left_within=1.01), Facts(left_within=0.99)),
    "matters": (Facts(change=1.01), Facts(change=0.99)),
    "comparable": (Facts(modes=0), Facts(modes=1)),
    "comparable in units": (Facts(factors=0), Facts(factors=1)),
    "gap": (Facts(log_odds=1.6), Facts(log_odds=1.4)),
    "predicts": (Facts(worse=0.9), Facts(worse=1.1)),
    "left": (Facts(left=0.99), Facts(left=1.0)),
    # One per cent that any of ten parameters is as far off: 0.05 % on either side.
    "credible": (Facts(pull=3.28, parameters=10), Facts(pull=3.3, parameters=10)),
    "credible as a part": (Facts(pull=9.9, part=True), Facts(pull=10.1, part=True)),
    "single": (Facts(laws=1), Facts(laws=2)),
    "likely": (Facts(probability=0.31, rival=0.3), Facts(probability=0.29, rival=0.3)),
    "likely as a part": (Facts(among_library=0.91, part=True), Facts(among_library=0.89, part=True)),
    "closes": (Facts(closed=0.81), Facts(closed=0.79)),
    "closes with two": (Facts(closed=0.96, effects=2), Facts(closed=0.94, effects=2)),
}  # fmt: skip
LEADER = Facts(worse=0.0, left=0.2, pull=1.0, parameters=5, laws=1, probability=0.9, rival=0.1, among_library=0.95)
WITH_GAP = Facts(log_odds=9.0, left_without=0.0)


def test_there_are_at_most_thirteen_rules_and_each_has_its_edge() -> None:
    assert len(RULES) <= 13
    assert len({rule.name for rule in RULES}) == len(RULES)
    assert {name.split()[0] for name in EDGES} == {rule.name for rule in RULES}
    for rule in RULES:
        assert rule.sentence[0].isupper(), rule.name
        assert rule.sentence.endswith("."), rule.name


@pytest.mark.parametrize("name", EDGES)
def test_a_rule_decides_at_its_limit(name: str) -> None:
    rule = rule_named(name.split()[0])
    passed, failed = EDGES[name]
    assert rule(passed).passed
    assert not rule(failed).passed


@pytest.mark.parametrize(
    ("alone", "leader", "verdict"),
    [
        (replace(WITH_GAP, log_odds=1.4), LEADER, Verdict.NONE),
        (replace(WITH_GAP, log_odds=1.4, left_without=2.0, change=2.0), LEADER, Verdict.CALIBRATION),
        (replace(WITH_GAP, log_odds=1.4, left_without=0.9, change=2.0), LEADER, Verdict.NONE),
        (replace(WITH_GAP, log_odds=1.4, left_without=2.0, change=0.9), LEADER, Verdict.NONE),
        (replace(WITH_GAP, modes=1), LEADER, Verdict.UNKNOWN),
        (WITH_GAP, None, Verdict.UNKNOWN),
        (WITH_GAP, LEADER, Verdict.EFFECT),
        (WITH_GAP, replace(LEADER, worse=1.1), Verdict.UNKNOWN),
        (WITH_GAP, replace(LEADER, left=2.0), Verdict.UNKNOWN),
        (WITH_GAP, replace(LEADER, left=2.0, closed=0.85), Verdict.EFFECT),
        (WITH_GAP, replace(LEADER, laws=2, closed=0.85, effects=2), Verdict.UNKNOWN),
        (WITH_GAP, replace(LEADER, laws=2, closed=0.97, effects=2), Verdict.EFFECT),
        (WITH_GAP, replace(LEADER, pull=9.0, closed=0.85), Verdict.EFFECT),
        (WITH_GAP, replace(LEADER, pull=11.0, closed=0.85), Verdict.UNKNOWN),
        (WITH_GAP, replace(LEADER, left=2.0, closed=0.85, among_library=0.5), Verdict.UNKNOWN),
        (WITH_GAP, replace(LEADER, probability=0.1, rival=0.9, closed=0.5), Verdict.UNKNOWN),
    ],
)
def test_the_rules_make_a_verdict(alone: Facts, leader: Facts | None, verdict: Verdict) -> None:
    assert verdict_of(alone, leader) is verdict


def test_a_part_is_asked_after_the_whole() -> None:
    rulings = rulings_of(replace(LEADER, left=2.0, closed=0.5, log_odds=9.0))
    assert [it.rule for it in rulings if not it.passed] == ["left", "closes"]
    assert [it.rule for it in rulings if it.part] == ["closes", "likely", "credible"]


@cache
def ledger(case: str) -> dict[str, Any]:
    """Ledger of a diagnosis, as it is read back."""
    spring = {"kind": "cubic_spring", "point": 2, "stiffness_n_m3": 4e8}
    friction = {"kind": "jenkins", "point": 1, "tangential_stiffness_n_m": 2000.0, "slip_force_n": 0.3}
    known: tuple[str, ...] = ("cubic_stiffness", "quintic_stiffness", "response_gain", "viscous_damping")
    truth: Rig = real(MODEL, local_elements=[spring])
    if case == "friction withheld":
        truth, known = real(MODEL, local_elements=[spring, friction]), ("cubic_stiffness", "response_gain")
    if case == "weak":
        truth = real(MODEL, local_elements=[{**spring, "stiffness_n_m3": 3e7}])
    withheld = tuple(effect.name for effect in library() if effect.name not in known)
    observations = observations_of_model(truth, seed=6, drives=(0.1, 0.2, 0.4, 0.8, 1.6))
    if case == "weak":
        observations = replace(observations, chains=tuple(MeasuringChain() for _ in observations.tests))
    found = diagnose_observations(MODEL, observations, DiagnosisSettings(withheld=withheld, look_ahead=False))
    written: dict[str, Any] = json.loads(json.dumps(found.diagnosis.to_mapping()))
    return {"verdict": written["verdict"], **written["ledger"]}


def test_what_is_stated_has_a_row_with_all_that_was_asked() -> None:
    found = ledger("cubic")
    (row,) = [row for row in found["rows"] if row["stated"]]
    assert row["label"] == "cubic_stiffness@2"
    assert row["failed"] == ""
    assert sum(it["share"] for it in row["left"]) == pytest.approx(1.0)
    assert set(row["parameters"]) >= {"exciter.resistance_ohm"}
    assert row["apart"]["none"] > 50.0
    assert row["predicted"]["closed"] > 0.8
    assert row["evidence"] > 100.0
    assert [it["rule"] for it in row["effects"]["cubic_stiffness@2"]] == ["needed", "within", "matters"]
    first, *others = why(found, "cubic-stiffness@2")
    assert first == "cubic_stiffness@2: stated"
    assert any(line.split()[0] == "leaves" for line in others)
    assert why(found, "none")[0].startswith("none: not stated: rule gap, ")


def reasons(found: dict[str, Any]) -> dict[str, str]:
    """Label of an explanation that is not stated by the rule that kept it from that."""
    labels = {row["failed"]: row["label"] for row in found["rows"] if row["failed"] and row["label"] != "none"}
    return labels | {it["ruling"]["rule"]: it["label"] for it in found["promises"]}


@pytest.mark.parametrize(
    ("case", "rule"),
    with_quick([
        ("cubic", "promising"), ("cubic", "near"), ("cubic", "likely"), ("friction withheld", "closes"),
        ("weak", "needed"),
    ], ("cubic", "promising"), ("cubic", "near"), ("cubic", "likely"), ("weak", "needed")),
)  # fmt: skip
def test_why_an_explanation_is_not_stated(case: str, rule: str, capsys: pytest.CaptureFixture[str]) -> None:
    found = ledger(case)
    by_rule = reasons(found)
    assert rule in by_rule, (found["verdict"], by_rule)
    lines = why(found, by_rule[rule])
    with capsys.disabled():
        print("", *lines, sep="\n")
    assert f"rule {rule}, " in lines[0]
    assert lines[1].strip().startswith(rule_named(rule).sentence)


def test_a_wrong_name_is_told_with_the_nearest() -> None:
    with pytest.raises(BenchError, match="cubic_stiffness"):
        why(ledger("cubic"), "cubic_stifness@2")
    with pytest.raises(BenchError, match=r"cubic_stiffness@9 was looked at; the nearest are cubic_stiffness@"):
        why(ledger("cubic"), "cubic_stiffness@9")


def test_numbers_that_were_not_asked_pass() -> None:
    asked = [rule for rule in RULES if rule.name != "closes"]
    assert all(rule(Facts()).passed for rule in asked)
    assert math.isnan(rule_named("likely")(Facts()).number)
    assert not rule_named("closes")(Facts()).passed  # nothing held out says that it closes anything
