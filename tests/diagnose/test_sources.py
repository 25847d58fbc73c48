"""Sources without a name: they say where, whatever it is."""

from __future__ import annotations

from typing import Any

import pytest
from diagnose.twin_observations import chain, observations_of_twin, real

from nmt_diagnose.effects.calibration import calibration_parameters
from nmt_diagnose.inference.explanation_fits import ExplanationFits
from nmt_diagnose.inference.generic_source import SourceScore
from nmt_diagnose.inference.model_comparison import ModelComparison
from nmt_diagnose.inference.problem import Problem
from nmt_diagnose.inference.sources import generic_sources, places
from nmt_diagnose.twin.forward import Forward
from nmt_rig.rig import Rig

MODEL = chain()


def found(truth: Rig) -> list[SourceScore]:
    """Sources on top of the re-fitted model, best first."""
    observations = observations_of_twin(truth, seed=4, drives=(0.1, 0.4, 0.8, 1.6))
    forward = Forward(observations.tests, observations.rows)
    problem = Problem(observations, forward)  # type: ignore[arg-type]
    null = ModelComparison(ExplanationFits(problem, MODEL, calibration_parameters(MODEL), ())).fits.null()
    rig = null.fit.parametrisation.rig(null.fit.theta)
    own = places(forward, rig, null.fit.prediction, problem)  # type: ignore[arg-type]
    return sorted(generic_sources(null.fit, own), key=lambda score: -score.gain)


@pytest.mark.parametrize(
    ("change", "place", "detail"),
    [
        ({"local_elements": [{"kind": "quadratic_spring", "point": 1, "stiffness_n_m2": 3e5}]}, "structure", "1"),
        ({"sensors": {"quantity": "displacement", "gain": 1.02}}, "response_sensor", "x1"),
        ({"pll": {"phase_offset_rad": 0.03}}, "controller", ""),
    ],
)
def test_a_source_is_found_where_it_is(change: dict[str, Any], place: str, detail: str) -> None:
    if "sensors" in change:
        values = change.pop("sensors")
        own = [s.model_copy(update=values) if s.quantity == values["quantity"] else s for s in MODEL.sensors]
        truth = MODEL.model_copy(update={"sensors": own})
    else:
        truth = real(MODEL, **change)
    first, second, *_ = found(truth)
    assert (first.placement.kind, first.placement.detail) == (place, detail)
    assert first.gain > max(10.0, second.gain + 3.0)
    assert first.explained > first.degrees_of_freedom


def test_noise_has_no_source() -> None:
    assert max(score.gain for score in found(MODEL)) < 2.0
