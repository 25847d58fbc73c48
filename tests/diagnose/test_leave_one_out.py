"""One recording that contradicts the others is named, and none where they agree."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from diagnose.twin_observations import chain, observations_of_twin, real

from nmt_diagnose.effects.calibration import calibration_parameters
from nmt_diagnose.effects.library import candidates, library
from nmt_diagnose.inference.diagnosis import LeftOut
from nmt_diagnose.inference.explanation_fits import ExplanationFits
from nmt_diagnose.inference.fitted_model import rms_left
from nmt_diagnose.inference.leave_one_out import contradiction, left_out, recordings
from nmt_diagnose.inference.model_comparison import ModelComparison
from nmt_diagnose.inference.problem import Problem
from nmt_diagnose.observations.observables import Observations, joined
from nmt_diagnose.observations.origin import Origin
from nmt_diagnose.twin.forward import Forward
from nmt_diagnose.twin.operating_range import operating_range
from nmt_rig.rig import Rig

MODEL = chain()
CUBIC = {"kind": "cubic_spring", "point": 2, "stiffness_n_m3": 2.0e8}


def recording(name: str, rig: Rig, seed: int) -> Observations:
    found = observations_of_twin(rig, seed=seed, drives=(0.1, 0.8, 1.6))
    tests = tuple(replace(test, name=f"{name} {k}") for k, test in enumerate(found.tests))
    origin = Origin("unknown", tests=tuple(test.name for test in tests))
    return replace(found, tests=tests, inputs=((name, "0"),), origins=(origin,))


def without_each(parts: Sequence[Observations]) -> tuple[list[LeftOut], float]:
    observations = joined(parts)
    withheld = tuple(effect.name for effect in library() if effect.name != "cubic_stiffness")
    problem = Problem(observations, Forward(observations.tests, observations.rows))
    found = candidates(MODEL, operating_range(MODEL, observations.tests), withheld)
    comparison = ModelComparison(ExplanationFits(problem, MODEL, calibration_parameters(MODEL), found))
    null = comparison.fits.null()
    heads = comparison.singles(null, comparison.scan(null))[:2]
    items = recordings(observations)
    assert [item.path for item in items] == [part.inputs[0][0] for part in parts]
    assert np.array_equal(np.sum([item.rows for item in items], axis=0), np.ones(len(observations.rows)))
    each = [left_out(item, comparison.all_refits([(own, ~item.rows) for own in (null, *heads)])) for item in items]
    return [item for item in each if item is not None], min(rms_left(own) for own in (null, *heads))


@pytest.mark.campaign
def test_recordings_of_one_rig_agree() -> None:
    found, together = without_each(
        [recording(name, real(MODEL, local_elements=[CUBIC]), k) for k, name in enumerate("abc")]
    )
    assert together == pytest.approx(1.0, abs=0.15)
    assert [item.leader for item in found] == ["cubic_stiffness"] * 3
    for item in found:
        assert item.probability > 0.9
        assert 0.9 < item.closed <= 1.0
    assert contradiction(found, together) == ""


def test_a_recording_of_another_rig_is_named() -> None:
    parts = [recording(name, real(MODEL, local_elements=[CUBIC]), k) for k, name in enumerate("abc")]
    parts[1] = recording("stranger", MODEL, 7)
    found, together = without_each(parts)
    sentence = contradiction(found, together)
    assert sentence.startswith("stranger contradicts the other recordings")
    own = next(item for item in found if item.recording == "stranger")
    assert own.leader == "cubic_stiffness"
    assert own.left == pytest.approx(1.0, abs=0.2)


def test_two_that_contradict_each_other_are_both_named() -> None:
    alone = [LeftOut(name, "none", 1.0, 1.0, math.nan) for name in "ab"]
    assert contradiction(alone, 5.0).startswith("a and b contradict each other")
    assert contradiction(alone, 1.2) == ""
    assert contradiction([alone[0], replace(alone[1], left=4.0)], 5.0) == ""
    assert contradiction(alone[:1], 5.0) == ""
