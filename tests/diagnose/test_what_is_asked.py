"""What an explanation asks of model and measuring chain: incredible parameters, errors that an effect stands in for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from diagnose.predicted_observations import chain, observations_of_model
from scipy.stats import norm

from nmt_diagnose.effects.library import candidates
from nmt_diagnose.inference.diagnose import free_parameters, model_alone
from nmt_diagnose.inference.low_level_modes import LowLevelModes
from nmt_diagnose.inference.search import FittedExplanation, Search
from nmt_diagnose.inference.size import differs, implausible_parameters
from nmt_diagnose.observations.channels.measuring_chain import MeasuringChain
from nmt_diagnose.prediction.operating_range import operating_range
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_rig.rig import Rig

MODEL = chain()


def searched(truth: Rig) -> tuple[Search, FittedExplanation]:
    """The search on recordings of a rig, and the fit of the model alone."""
    found = observations_of_model(truth, seed=3, drives=(0.1, 0.2, 0.4, 0.8, 1.6))
    observations = replace(found, chains=tuple(MeasuringChain() for _ in found.tests))
    parameters = free_parameters(MODEL, observations)
    everything = np.ones(len(observations.rows), dtype=bool)
    modes = LowLevelModes(observations, MODEL)
    _, _, null, data = model_alone(MODEL, observations, parameters, everything, modes)
    library = candidates(MODEL, operating_range(MODEL, observations.tests, observations=observations))
    return Search(data, MODEL, parameters, library), null


def moved(found: FittedExplanation, to: float) -> FittedExplanation:
    theta = np.zeros_like(found.fit.theta)
    theta[1] = to
    return FittedExplanation((), replace(found.fit, theta=theta))


def test_a_parameter_that_nobody_believes_is_named_with_its_distance() -> None:
    _, null = searched(MODEL)
    count = len(null.fit.parametrisation.calibration)
    edge = float(norm.isf(THRESHOLDS.comparison.incredible_probability / (2.0 * count)))  # Bonferroni
    assert edge > THRESHOLDS.comparison.credible_sigmas - 0.5
    assert implausible_parameters(moved(null, 0.99 * edge))[0] == ()
    (left,), chance = implausible_parameters(moved(null, -1.01 * edge))
    assert left.group == null.fit.parametrisation.calibration[1].name
    assert left.size == pytest.approx(1.01 * edge)
    assert 0.0 < chance < THRESHOLDS.comparison.incredible_probability
    assert left.sentence.endswith("standard deviations from what is believed of it")


def test_an_effect_stands_in_for_an_error_of_the_chain_that_nobody_believes() -> None:
    search, null = searched(MODEL)
    errors = null.fit.errors
    position = search.data.chain_names.index("delay x1")
    slope = errors.slopes[:, position]

    def taken(sigmas: float, column: np.ndarray) -> tuple[float, float] | None:
        own = np.zeros_like(errors.chain)
        own[position] = sigmas
        return search._instead_of_chain_error(replace(null.fit, errors=replace(errors, chain=own)), column)

    assert taken(20.0, -2.0 * slope) == pytest.approx((-10.0, 400.0))
    assert taken(-20.0, 0.5 * slope) == pytest.approx((-40.0, 400.0))
    assert taken(0.9 * THRESHOLDS.comparison.credible_sigmas, slope) is None
    other = np.random.default_rng(1).standard_normal(slope.size)
    assert taken(20.0, other) is None


def test_explanations_differ_by_what_matters_or_by_what_they_take_off_the_chain() -> None:
    search, null = searched(MODEL)
    never = {"frequency": 1.0, "damping": 1.0, "response": 1.0, "harmonics": 1.0}
    assert not differs(search.data, null, null, never)
    bent = moved(null, 2.0 * THRESHOLDS.comparison.credible_sigmas)
    assert differs(search.data, moved(null, 0.0), bent, never)
    assert not differs(search.data, bent, moved(null, 0.0), never)
