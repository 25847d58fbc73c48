"""Steps, starts from afar and delays of fits against closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from diagnose.predicted_observations import chain, observations_of_model, real
from scipy.stats import f as fisher

from nmt_diagnose.effects.calibration import calibration_parameters
from nmt_diagnose.effects.library import candidates
from nmt_diagnose.effects.parametrisation import Parametrisation
from nmt_diagnose.fit.candidate_starts import starts_of
from nmt_diagnose.fit.fitting import ChainErrors, Start, _normal, data_about, fit
from nmt_diagnose.fit.low_level_modes import LowLevelModes
from nmt_diagnose.fit.model_alone import free_parameters, model_alone
from nmt_diagnose.fit.noise import Groups, chance_of
from nmt_diagnose.ledger.comparison import source_locations
from nmt_diagnose.measurements.random_responses import RandomResponses
from nmt_diagnose.prediction.forward import Forward
from nmt_diagnose.prediction.lateness import delay_of, lateness
from nmt_diagnose.prediction.operating_range import operating_range
from nmt_diagnose.prediction.prediction_settings import PredictionSettings
from nmt_diagnose.search.search import Search

MODEL = chain()


def test_a_step_is_that_of_parameters_and_chain_together() -> None:
    """The chain need not stand exactly at its best: where it does nearly what θ does, the rest would mislead θ."""
    rng = np.random.default_rng(1)
    rows, own, errors = 60, 3, 4
    chain_slopes = 1e3 * rng.standard_normal((rows, errors))
    slopes = rng.standard_normal((rows, own))
    slopes[:, 0] = chain_slopes[:, 0] + 1e-2 * rng.standard_normal(rows)
    weights, left = rng.uniform(0.5, 2.0, rows), rng.standard_normal(rows)
    stands, theta, std = 1e-3 * rng.standard_normal(errors), rng.standard_normal(own), np.array([1.0, 2.0, 3.0])
    at = ChainErrors(stands, chain_slopes, left, weights, np.zeros(1), 0.0, np.zeros(rows))
    normal, gradient = _normal(slopes, at, theta, std)
    both = np.column_stack([slopes, chain_slopes])
    precision = np.concatenate([std**-2.0, np.ones(errors)])
    joint = both.T @ (weights[:, None] * both) + np.diag(precision)
    right = both.T @ (weights * left) - precision * np.concatenate([theta, stands])
    np.testing.assert_allclose(np.linalg.solve(normal, gradient), np.linalg.solve(joint, right)[:own], rtol=1e-5)


def test_a_fit_from_afar_arrives_where_one_from_nearby_does() -> None:
    truth = real(MODEL, local_elements=[{"kind": "cubic_spring", "point": 2, "stiffness_n_m3": 2e8}])
    observations = observations_of_model(truth, seed=6, drives=(0.1, 0.2, 0.4, 0.8, 1.6))
    given = Forward(observations.tests, observations.rows).predict(MODEL)
    data = data_about(observations, MODEL, given, np.isfinite(given.values))
    operating = operating_range(MODEL, observations.tests, observations=observations)
    cubic = next(
        own
        for own in candidates(MODEL, operating)
        if own.effect.name == "cubic_stiffness" and own.site.location.detail == "2"
    )
    own = Parametrisation(MODEL, calibration_parameters(MODEL), (cubic,), (100.0,))
    near, far = own.zero, own.zero
    near[-1] = 2e8 / cubic.site.scales["k"]
    far[-1] = 10.0 * near[-1]
    best = fit(data, own, Start("near", near))
    found = fit(data, own, Start("far", far, coarse=True))
    assert found.cost == pytest.approx(best.cost, abs=0.5)
    assert found.theta[-1] == pytest.approx(best.theta[-1], rel=1e-2)


def test_the_chance_of_a_scale_is_that_of_fishers_distribution() -> None:
    groups = Groups(np.array([0, 0, 1, 1]), ("one", "two"), np.array([6.0, 6.0]), np.zeros(2))
    counts = np.array([20.0, 20.0])
    assert chance_of(groups.tails(np.array([20.0, 20.0]), counts)) == pytest.approx(
        min(1.0, 2.0 * fisher.sf(1.0, 20, 6)), rel=1e-9
    )
    tails = groups.tails(np.array([20.0, 20.0 * 100.0]), counts)
    assert chance_of(tails) == pytest.approx(2.0 * fisher.sf(100.0, 20, 6))
    known = replace(groups, degrees=np.array([np.inf, np.inf]))
    assert chance_of(known.tails(np.array([1e6, 1e6]), counts)) == 1.0


@pytest.mark.parametrize("delay_s", [0.0, 1.8e-3, -6e-3])
def test_a_delay_of_many_turns_is_told_by_phases(delay_s: float) -> None:
    lines = np.linspace(20.0, 700.0, 300)
    noise = 0.3 * np.random.default_rng(2).standard_normal(lines.size)
    wrapped = np.angle(np.exp(1j * (2.0 * np.pi * lines * delay_s + noise)))
    assert delay_of(lines, wrapped) == pytest.approx(delay_s, abs=1.0 / (16.0 * 700.0))


def test_late_channels_are_effects_that_begin_there_and_no_modes() -> None:
    late = [sensor.model_dump() for sensor in MODEL.sensors]
    for sensor in late:
        if sensor["quantity"] == "acceleration":
            sensor["delay_s"] = 4e-3
    observations = observations_of_model(real(MODEL, sensors=late), seed=2, drives=(0.1, 0.4))
    found = {
        observations.tests[test].channels[channel].name: delay
        for (test, channel), delay in lateness(observations, MODEL).items()
        if isinstance(observations.tests[test], RandomResponses)
    }
    assert found
    highest = max(float(t.lines_hz.max()) for t in observations.tests if isinstance(t, RandomResponses))
    for name, delay in found.items():
        expected = 4e-3 if name.startswith("a") else 0.0
        assert delay == pytest.approx(expected, abs=1.0 / (8.0 * highest))
    modes = LowLevelModes(observations, MODEL)
    assert not modes.disordered
    assert not modes._lacking
    operating = operating_range(MODEL, observations.tests, observations=observations)
    skews = [own for own in candidates(MODEL, operating) if own.effect.name == "channel_skew"]
    begun = {
        own.site.location.channel: [start[0] * own.site.scales["tau"] for start in starts_of(own)] for own in skews
    }
    assert any(abs(value - 4e-3) < 1e-3 for values in begun.values() for value in values)


def test_what_the_harmonic_balance_leaves_out_is_part_of_the_uncertainty() -> None:
    healthy = observations_of_model(MODEL, noise=0.0, drives=(0.4, 1.6), random=False)
    operating = operating_range(MODEL, healthy.tests)
    stiffness, gap = 0.3 * operating.effective_stiffness(2), 0.7 * operating.displacement[2]
    stop = [{"kind": "unilateral_stop", "point": 2, "stiffness_n_m": stiffness, "gap_m": gap}]
    rig = real(MODEL, local_elements=stop)
    observations = observations_of_model(rig, noise=0.0, drives=(0.4, 1.6), random=False)
    given = Forward(observations.tests, observations.rows).predict(rig)
    fine = Forward(observations.tests, observations.rows, PredictionSettings(harmonics=27)).predict(rig)
    parameters = free_parameters(rig, observations)
    everything = np.ones(len(observations.rows), dtype=bool)
    seen = model_alone(rig, observations, parameters, everything, LowLevelModes(observations, rig))[0]
    change = np.abs(np.nan_to_num(fine.values - given.values))
    assert change.max() > 1e-6
    np.testing.assert_allclose(seen.floor, np.hypot(observations.floor, change), rtol=1e-3, atol=1e-9)


def test_sources_act_on_the_model_as_it_was_fitted() -> None:
    """The model as given has its resonances elsewhere: a drift without a name is that of temperature all the same."""
    stiffer = real(MODEL, structure={"springs_n_m": [1.15 * k for k in MODEL.structure.springs_n_m]})
    observations = observations_of_model(stiffer, seed=3, drives=(0.1, 0.4))
    tests = tuple(
        replace(t, start_s=20.0, stop_s=60.0) if isinstance(t, RandomResponses) else t for t in observations.tests
    )
    observations = replace(observations, tests=tests)
    everything, parameters = np.ones(len(observations.rows), dtype=bool), free_parameters(MODEL, observations)
    modes = LowLevelModes(observations, MODEL)
    _, _, null, data = model_alone(MODEL, observations, parameters, everything, modes)
    operating = operating_range(MODEL, tests, observations=observations)
    search = Search(data, MODEL, parameters, candidates(MODEL, operating))
    named = next(
        score.column
        for score in search.scores(null)
        if search.candidates[score.candidate].effect.name == "temperature_drift"
    )
    (place,) = (place for place in source_locations(data, null) if place.location.kind == "time")
    column = place.families[0][1][:, 0]
    assert column @ named > 0.999 * np.linalg.norm(column) * np.linalg.norm(named)
