"""Accounts of cases whose truth is known."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from diagnose.predicted_observations import chain, observations_of_model, real

from nmt_blind.campaign import explain
from nmt_blind.campaign.explain import account, follows, measured_strengths, parameters_of
from nmt_diagnose.diagnosis_settings import DiagnosisSettings
from nmt_diagnose.effects.library import candidates, library
from nmt_diagnose.effects.parametrisation import Parametrisation
from nmt_diagnose.prediction.operating_range import operating_range

MODEL = chain()
KNOWN = ("cubic_stiffness", "viscous_damping", "second_friction_contact")
SETTINGS = DiagnosisSettings(withheld=tuple(effect.name for effect in library() if effect.name not in KNOWN))


def entry(value: float) -> dict[str, object]:
    effect = {"name": "cubic_stiffness", "detail": "2", "figures": {"k": value}}
    return {"case": "0001", "effects": [effect], "edits": [], "withheld": ""}


def test_a_strong_effect_is_found_and_its_truth_costs_no_more_than_the_winner() -> None:
    truth = real(MODEL, local_elements=[{"kind": "cubic_spring", "point": 2, "stiffness_n_m3": 2e8}])
    observations = observations_of_model(truth, seed=6, drives=(0.1, 0.4, 1.6))
    found = account(MODEL, observations, SETTINGS, entry(2e8))
    assert found.winner == "cubic_stiffness@2"
    assert found.follows == "found"
    null, winner, true = found.costs
    assert true == pytest.approx(winner, abs=1.0)
    assert found.sigma == pytest.approx(math.sqrt(null - true))
    assert found.sigma > 5.0
    for name, (_, at_winner, at_truth) in found.scales.items():
        assert at_winner == pytest.approx(at_truth, abs=0.05), name


def test_true_figures_become_the_parameters_that_are_reported_as_them() -> None:
    observations = observations_of_model(MODEL, drives=(0.1, 0.4))
    every = candidates(MODEL, operating_range(MODEL, observations.tests, observations=observations))
    contact = next(own for own in every if own.effect.name == "second_friction_contact")
    figures = {"kt": 120.0, "slip_force": 0.03}
    theta = parameters_of(contact, MODEL, figures)
    reported = Parametrisation(MODEL, (), (contact,)).reported(theta, 0)
    assert {name: reported[name][0] for name in figures} == pytest.approx(figures, rel=1e-6)


@pytest.mark.parametrize(
    ("costs", "evidence", "sigma", "scale", "answer"),
    [
        ((100.0, 60.0, 40.0), (10.0, 20.0), 7.7, 1.0, "search"),
        ((100.0, 60.0, 40.0), (30.0, 20.0), 7.7, 1.0, "priors"),
        ((100.0, 30.0, 60.0), (30.0, 10.0), 6.3, 3.0, "physics"),
        ((100.0, 95.0, 96.0), (1.0, 1.0), 2.0, 1.0, "information"),
        ((100.0, 95.0, math.nan), (1.0, 1.0), math.nan, 1.0, "physics"),
    ],
)
def test_what_a_miss_comes_from(
    costs: tuple[float, ...], evidence: tuple[float, ...], sigma: float, scale: float, answer: str
) -> None:
    assert follows(False, True, costs, evidence, sigma, [1.0, scale]) == answer


def test_a_healthy_case_that_is_called_healthy_is_no_miss() -> None:
    assert follows(True, False, (1.0, 1.0, 1.0), (0.0, 0.0), 0.0, [1.0]) == "healthy"


def test_strengths_are_measured_by_the_noise_of_the_recordings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    truth = real(MODEL, local_elements=[{"kind": "cubic_spring", "point": 2, "stiffness_n_m3": 2e8}])
    observations = observations_of_model(truth, seed=6, drives=(0.1, 0.2, 0.4, 0.8, 1.6))
    monkeypatch.setattr(explain, "_recorded", lambda folder, case, settings: (MODEL, observations))
    told: list[str] = []
    unknown = {**entry(1.0), "case": "0002", "effects": [{"name": "no_such_effect", "detail": ""}]}
    healthy = {**entry(1.0), "case": "0003", "effects": []}
    cases = {"cases": [entry(2e8), unknown, healthy]}

    def measured() -> dict[str, float]:
        return measured_strengths(tmp_path, cases, progress=lambda done, total, case: told.append(case))

    found = measured()
    assert set(found) == {"0001"}
    assert found["0001"] == pytest.approx(account(MODEL, observations, SETTINGS, entry(2e8)).sigma, rel=0.05)
    assert told == ["0001", "0002"]
    # Once measured they are kept.
    assert measured() == found
    assert told == ["0001", "0002"]
    # Another program measures with another noise.
    monkeypatch.setattr(explain, "diagnosis_digest", lambda: "another")
    monkeypatch.setattr(explain, "measured_strength", lambda folder, entry: 7.0)
    assert measured() == {"0001": 7.0, "0002": 7.0}
