from dataclasses import replace

import numpy as np
import pytest
from diagnose.linear_problem import FunctionModel, Plain, observations_of
from scipy.stats import multivariate_normal

from nmt_diagnose.effects.placement import Placement
from nmt_diagnose.inference.fit import fit
from nmt_diagnose.inference.generic_source import source_score
from nmt_diagnose.inference.problem import Problem
from nmt_diagnose.inference.scan import Direction, Projector, scores


def _setting(seed=4):
    generator = np.random.default_rng(seed)
    calibration = generator.standard_normal((60, 4))
    effect = generator.standard_normal(60) + 0.8 * calibration[:, 0]
    measured = calibration @ generator.standard_normal(4) + 0.9 * effect + generator.standard_normal(60)
    problem = Problem(observations_of(measured, 1.0), FunctionModel(lambda t: calibration @ t[:4]))
    return calibration, effect, measured, fit(problem, Plain.of(4), np.zeros(4))


def test_score_equals_a_refit_with_the_effect():
    calibration, effect, measured, null = _setting()
    (score,) = scores(null, [Direction(0, np.zeros(1), effect, True)])
    both = np.column_stack([calibration, effect])
    plain = Plain(np.array([1.0, 1.0, 1.0, 1.0, 1e6]), np.full(5, -np.inf), ("a", "b", "c", "d", "e"))
    full = fit(
        Problem(observations_of(measured, 1.0), FunctionModel(lambda t: both @ t)), plain, np.zeros(5), steps=200
    )
    fall = null.chi_square + null.penalty - full.chi_square - full.penalty
    assert score.gain == pytest.approx(fall, rel=1e-3)
    assert score.strength == pytest.approx(full.theta[4], rel=1e-3)
    assert score.sigmas == pytest.approx(full.theta[4] / full.std[4], rel=1e-3)


def test_a_fit_that_stopped_short_scores_as_one_that_did_not():
    calibration, effect, _, null = _setting()
    likeness = calibration[:, 0] + 1e-3 * effect
    directions = [Direction(0, np.zeros(1), effect, True), Direction(1, np.zeros(1), 300.0 * likeness, True)]
    short = 0.05 * np.array([1.0, -0.5, 0.2, 0.7])
    early = replace(null, theta=null.theta + short, residual=null.residual - calibration @ short)
    whole, cut = ({s.direction.candidate: s for s in scores(item, directions)} for item in (null, early))
    for k in range(2):
        assert cut[k].gain == pytest.approx(whole[k].gain, rel=1e-6, abs=1e-6)
    assert source_score(early, effect[:, None], Placement.at("structure", 1)).gain == pytest.approx(
        source_score(null, effect[:, None], Placement.at("structure", 1)).gain, rel=1e-6
    )


def test_a_parameter_at_its_bound_stays_there():
    generator = np.random.default_rng(12)
    calibration, effect = generator.standard_normal((60, 2)), generator.standard_normal(60)
    measured = -3.0 * calibration[:, 0] + generator.standard_normal(60)
    plain = Plain(np.array([3.0, 3.0]), np.array([0.0, -np.inf]), ("strength", "b"))
    bound = fit(Problem(observations_of(measured, 1.0), FunctionModel(lambda t: calibration @ t)), plain, np.zeros(2))
    assert bound.theta[0] == 0.0
    assert np.allclose(bound.settled_residual(), bound.residual, atol=0.05)
    (score,) = scores(bound, [Direction(0, np.zeros(1), effect, True)])
    assert np.isfinite(score.gain)


def test_what_the_calibration_imitates_scores_nothing_and_wrong_signs_are_refused():
    calibration, effect, _, null = _setting()
    wide = Plain(np.full(4, 1e3), np.full(4, -np.inf), ("a", "b", "c", "d"))
    loose = fit(
        Problem(observations_of(null.residual, 1.0), FunctionModel(lambda t: calibration @ t)), wide, np.zeros(4)
    )
    inside, _ = sorted(
        scores(loose, [Direction(0, np.zeros(1), calibration[:, 1], True), Direction(1, np.zeros(1), effect, True)]),
        key=lambda score: score.direction.candidate,
    )
    assert inside.gain < 0.05
    assert inside.reach < 0.01
    (wrong,) = scores(null, [Direction(0, np.zeros(1), -effect, False)])
    assert wrong.gain == 0.0
    assert wrong.reach > 1.0


def test_generic_source_is_the_ratio_of_two_marginal_likelihoods():
    calibration, effect, measured, null = _setting()
    columns = np.column_stack([effect, np.random.default_rng(9).standard_normal(60)])
    base = np.eye(60) + calibration @ calibration.T
    # The unit of the sources' size: what the stronger column leaves after the calibration took its part.
    columns /= np.sqrt(np.max(np.diag(columns.T @ np.linalg.inv(base) @ columns)))
    # Same data seen from the other side: evidence of y − calibration, marginalised, with and without the source.
    sizes = np.geomspace(0.3, 300.0, 13)
    without = multivariate_normal(np.zeros(60), base).logpdf(measured)
    logs = [
        multivariate_normal(np.zeros(60), base + tau**2 * columns @ columns.T).logpdf(measured) - without
        for tau in sizes
    ]
    assert source_score(null, 7.0 * columns, Placement.at("structure", 1)).gain == pytest.approx(
        np.log(np.mean(np.exp(logs))), abs=5e-3
    )


def test_projector_without_parameters_is_the_plain_product():
    vector = np.arange(5.0)
    assert Projector(np.zeros((5, 0)), np.zeros(0)).inner(vector, vector) == 30.0
