"""From observations to diagnosis.json: verdicts, and the keys that others rely on."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest
from diagnose.predicted_observations import chain, observations_of_model, real
from tiers import with_quick

from nmt_diagnose.diagnose import FAR_BEHIND, DiagnosisOutcome, diagnose_observations
from nmt_diagnose.diagnosis_settings import DiagnosisSettings
from nmt_diagnose.effects.library import library
from nmt_diagnose.ledger.diagnosis import Verdict
from nmt_rig.rig import Rig

MODEL = chain()
KNOWN = ("cubic_stiffness", "phase_offset", "viscous_damping")
KEYS = {
    "verdict": (),
    "where": ("place", "detail", "share", "p"),
    "ranking": ("effect", "place", "probability", "equivalents", "parameters", "closed"),
    "gap": ("before", "after", "floor", "closed", "low", "high", "per_observable", "held_out"),
    "next_test": ("test", "command", "separates", "expected_sigma"),
    "calibration": ("name", "start", "to", "std", "shared_std"),
    "inputs": ("bags", "tests", "held_out", "seed"),
}
PLACES = {
    "structure", "boundary", "joint", "exciter", "force_sensor", "response_sensor", "controller", "time",
}  # fmt: skip


def diagnosed(
    truth: Rig, known: tuple[str, ...] = KNOWN, look_ahead: bool = False, seed: int = 6, mains: bool = False
) -> DiagnosisOutcome:
    withheld = tuple(effect.name for effect in library() if effect.name not in known)
    observations = observations_of_model(truth, seed=seed, drives=(0.1, 0.2, 0.4, 0.8, 1.6), mains=mains)
    return diagnose_observations(MODEL, observations, DiagnosisSettings(withheld=withheld, look_ahead=look_ahead))


@pytest.fixture(scope="module")
def hardening() -> DiagnosisOutcome:
    return diagnosed(
        real(MODEL, local_elements=[{"kind": "cubic_spring", "point": 2, "stiffness_n_m3": 2e8}]), look_ahead=True
    )


def test_diagnosis_json_has_the_keys_of_the_contract(hardening: DiagnosisOutcome, tmp_path: Path) -> None:
    hardening.diagnosis.write(tmp_path / "diagnosis.json")
    found: dict[str, Any] = json.loads((tmp_path / "diagnosis.json").read_text(encoding="utf-8"))
    for key, inner in KEYS.items():
        items = found[key] if isinstance(found[key], list) else [found[key]]
        for item in items:
            assert set(inner) <= set(item if isinstance(item, dict) else {}), key
    assert found["verdict"] in {"none", "calibration", "effect", "unknown"}
    assert {item["place"] for item in found["where"]} <= PLACES
    assert sum(item["share"] for item in found["where"]) == pytest.approx(1.0, abs=0.02)
    first = found["ranking"][0]
    assert set(first["closed"]) == {"value", "low", "high"}
    for value in first["parameters"].values():
        assert set(value) == {"value", "std", "unit", "shared_std"}
        assert value["std"] > 0.0
    for item in found["gap"]["per_observable"].values():
        assert {"before", "after", "floor", "before_unit", "after_unit", "unit"} <= set(item)
    assert "NaN" not in (tmp_path / "diagnosis.json").read_text(encoding="utf-8")


def test_an_effect_is_named_placed_sized_and_closes_the_gap(hardening: DiagnosisOutcome) -> None:
    found = hardening.diagnosis
    assert found.verdict is Verdict.EFFECT
    first = found.ranking[0]
    assert (first.effect, first.detail) == ("cubic_stiffness", "2")
    assert first.parameters["k"].value == pytest.approx(2e8, abs=4.0 * first.parameters["k"].std)
    assert (found.where[0].place, found.where[0].detail) == ("structure", "2")
    assert found.gap.closed > 0.8
    assert found.gap.low <= found.gap.closed <= found.gap.high
    assert len(hardening.model.local_elements) == len(MODEL.local_elements) + 1
    assert "cubic stiffness at point 2" in found.sentences[1]
    assert "removes" in found.sentences[2]


def test_a_withheld_effect_is_unknown_and_changes_no_physics() -> None:
    truth = real(MODEL, local_elements=[{"kind": "cubic_spring", "point": 2, "stiffness_n_m3": 4e8}])
    outcome = diagnosed(truth, ("phase_offset", "viscous_damping"))
    found = outcome.diagnosis
    assert found.verdict is Verdict.UNKNOWN
    assert "cubic_stiffness" not in {item.effect for item in found.ranking}
    assert found.sentences[1].startswith("Nothing in the library explains")
    assert found.gap.before > 1.2
    assert found.probabilities["unknown"] > 0.5


@pytest.mark.parametrize("quadratic", with_quick([0.0, 3e5], 0.0))
def test_hum_of_a_channel_does_not_compete_with_a_cause(quadratic: float) -> None:
    """The line at 50 Hz stands out by hundreds of standard deviations; alone it is the effect, beside a spring not."""
    humming = [s.model_dump() | ({"hum_amplitude": 6e-4} if s.quantity == "force" else {}) for s in MODEL.sensors]
    spring = {"kind": "quadratic_spring", "point": 2, "stiffness_n_m2": quadratic}
    truth = real(MODEL, sensors=humming, local_elements=[spring] if quadratic else [])
    found = diagnosed(truth, ("quadratic_stiffness", "cubic_stiffness", "mains_hum"), mains=True).diagnosis
    assert found.verdict is Verdict.EFFECT
    assert found.ranking[0].effect == ("quadratic_stiffness" if quadratic else "mains_hum")
    assert found.ranking[0].probability > 0.9


def test_every_fitted_explanation_is_told_with_the_filter_that_took_it_out(hardening: DiagnosisOutcome) -> None:
    rows = hardening.diagnosis.candidates
    kept = [row for row in rows if not row["filter"]]
    assert {row["filter"] for row in rows} <= {"", FAR_BEHIND}
    assert kept[0]["label"] == "none"
    assert max(rows, key=lambda row: row["log_evidence"]) in kept


def test_a_rig_that_is_its_model_has_no_gap() -> None:
    outcome = diagnosed(MODEL)
    found = outcome.diagnosis
    assert found.verdict is Verdict.NONE
    assert outcome.model is MODEL
    assert found.where == ()
    assert found.next_test == ()
    assert 0.4 < found.gap.as_given < 1.2
    assert found.sentences[0].startswith("There is no gap")


def test_a_wrong_parameter_is_a_calibration() -> None:
    outcome = diagnosed(real(MODEL, exciter={"resistance_ohm": 3.0 * 1.05}))
    found = outcome.diagnosis
    assert found.verdict is Verdict.CALIBRATION
    moved = {item.name: item for item in found.calibration}["exciter.resistance_ohm"]
    assert moved.to == pytest.approx(3.15, abs=4.0 * moved.std)
    assert found.gap.before > 1.2 > found.gap.after
    assert not math.isnan(found.gap.closed)
    assert len(outcome.model.local_elements) == len(MODEL.local_elements)
    assert "resistance_ohm" in found.sentences[1]


@pytest.mark.campaign
def test_a_weaker_effect_beside_a_strong_one_is_named_or_warned_of() -> None:
    """A force gain of 4 % beside a cubic spring of hundreds of standard deviations bends the masses instead."""
    gains = [s.model_dump() | ({"gain": 1.04} if s.quantity == "force" else {}) for s in MODEL.sensors]
    spring = {"kind": "cubic_spring", "point": 2, "stiffness_n_m3": 2e9}
    outcome = diagnosed(real(MODEL, local_elements=[spring], sensors=gains), ("cubic_stiffness", "force_gain"))
    found = outcome.diagnosis
    first = found.ranking[0]
    assert found.verdict is Verdict.EFFECT
    assert "cubic_stiffness" in first.effect
    assert first.sigmas > 5.0
    if "force_gain" not in first.effect:
        strained = [sentence for sentence in found.warnings if "masses_kg" in sentence]
        assert strained or any("With force gain at channel f1 (g = 0.0" in sentence for sentence in found.sentences)
        assert set(found.warnings) <= set(found.sentences)
    assert first.converged
    assert found.gap.closed <= 1.0
