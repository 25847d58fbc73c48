"""Tests that are held out by name: no fit sees them, and the gap is that of these tests alone."""

from __future__ import annotations

import numpy as np
import pytest
from diagnose.linear_problem import observations_of
from diagnose.predicted_observations import chain, observations_of_model, real

from nmt_core.errors import BenchError
from nmt_diagnose.diagnose import diagnose_observations
from nmt_diagnose.diagnosis_settings import DiagnosisSettings
from nmt_diagnose.effects.library import library
from nmt_diagnose.ledger.held_out import splits
from nmt_diagnose.measurements.measurement import joined


def test_exactly_the_named_tests_are_held_out() -> None:
    parts = [observations_of(np.zeros(3), 1.0, tests=(name,)) for name in ("levels", "noise 1", "noise 2", "noises")]
    observations = joined(parts)
    (split,) = splits(observations, ["out/noise"])
    assert set(observations.rows.test[split.held_out]) == {1, 2}
    assert np.array_equal(split.fitted, ~split.held_out)
    assert split.name == "the test noise"


@pytest.mark.parametrize(("names", "sentence"), [(["wind"], "the tests are a, b"), (["a", "b"], "nothing to fit")])
def test_what_cannot_be_held_out_is_a_sentence(names: list[str], sentence: str) -> None:
    observations = joined([observations_of(np.zeros(3), 1.0, tests=(name,)) for name in ("a", "b")])
    with pytest.raises(BenchError, match=sentence):
        splits(observations, names)


@pytest.mark.campaign
def test_no_fit_sees_a_test_that_is_held_out() -> None:
    """The random test is of another rig: with it held out the estimate is that of the levels alone."""
    model = chain()
    truth = real(model, local_elements=[{"kind": "quadratic_drag", "point": 2, "drag_ns2_m2": 1.0}])
    odd = real(truth, structure={"masses_kg": [0.51, 0.3]})
    levels, other = (observations_of_model(rig, seed=2, drives=(0.1, 0.4, 0.8, 1.6)) for rig in (truth, odd))
    mixed = joined([levels.take(levels.rows.test == 0)])
    values = np.where(levels.rows.test == 0, levels.values, other.values)
    observations = type(levels)(levels.tests, levels.rows, values, levels.std, levels.floor)
    withheld = tuple(effect.name for effect in library() if effect.name not in ("air_drag", "cubic_stiffness"))
    settings = DiagnosisSettings(withheld=withheld, look_ahead=False, hold_out=("random",), matters={})
    outcome = diagnose_observations(model, observations, settings)
    alone = diagnose_observations(model, mixed, DiagnosisSettings(withheld=withheld, look_ahead=False, matters={}))
    found, wanted = outcome.diagnosis.ranking[0], alone.diagnosis.ranking[0]
    assert (found.effect, found.detail) == (wanted.effect, wanted.detail) == ("air_drag", "2")
    assert found.parameters["c2"].value == pytest.approx(wanted.parameters["c2"].value, rel=1e-2)
    assert outcome.diagnosis.inputs["held_out"] == ["the test random"]
    # The other rig's test fits neither model: that is the gap.
    assert outcome.diagnosis.gap.after > 3.0
