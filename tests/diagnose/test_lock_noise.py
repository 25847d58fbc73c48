"""Noise of the loop: one error that a window's observables share."""

from __future__ import annotations

import numpy as np
import pytest
from diagnose.linear_problem import FunctionModel, observations_of
from diagnose.twin_observations import chain, observations_of_twin

from nmt_diagnose.inference.lock_noise import lock_nuisances
from nmt_diagnose.inference.problem import Nuisance, Problem
from nmt_diagnose.observations.observables import Part
from nmt_diagnose.twin.forward import Forward

LOOP = 4e-3


def test_whitening_is_the_dense_inverse_root() -> None:
    generator = np.random.default_rng(1)
    sigma = generator.uniform(0.5, 2.0, 7)
    groups = [(np.array([0, 2, 3]), 3.0), (np.array([4, 6]), 0.7)]
    covariance = np.diag(sigma**2)
    nuisances = []
    for rows, size in groups:
        direction = generator.standard_normal(rows.size)
        direction /= np.linalg.norm(direction)
        shared = np.zeros(7)
        shared[rows] = size * direction * sigma[rows]
        covariance += np.outer(shared, shared)
        nuisances.append(Nuisance(rows, direction, size))
    problem = Problem(observations_of(np.zeros(7), sigma), FunctionModel(lambda t: t), tuple(nuisances))
    left = generator.standard_normal((7, 3))
    whitened = problem.whitened(left)
    # Any root will do: products are what counts.
    assert np.allclose(whitened.T @ whitened, left.T @ np.linalg.solve(covariance, left))
    assert np.allclose(problem.whitened(left[:, 0]), whitened[:, 0])


@pytest.fixture(scope="module")
def wandering() -> tuple[float, float, np.ndarray]:
    """Spread of ln ω over its stated σ without the shared error, all whitened residuals with it."""
    model = chain()
    plain, white = [], []
    for seed in range(4):
        observations = observations_of_twin(model, seed=seed, random=False, lock_noise=LOOP)
        forward = Forward(observations.tests, observations.rows)
        prediction = forward.predict(model)
        nuisances = lock_nuisances(observations, model, prediction)
        assert len(nuisances) == len(observations.tests[0].levels)  # type: ignore[union-attr]
        frequency = observations.rows.part == Part.LOG_FREQUENCY
        plain.append(Problem(observations, forward).residual(prediction)[frequency])  # type: ignore[arg-type]
        white.append(Problem(observations, forward, nuisances).residual(prediction))  # type: ignore[arg-type]
    return float(np.std(plain)), float(np.max(np.abs(white))), np.concatenate(white)


def test_a_rig_that_is_its_own_model_whitens_to_one_though_its_loop_wanders(
    wandering: tuple[float, float, np.ndarray],
) -> None:
    plain, largest, white = wandering
    assert plain > 3.0
    assert np.sqrt(np.mean(white**2)) == pytest.approx(1.0, abs=0.06)
    assert largest < 5.0


def test_a_quiet_loop_shares_nothing() -> None:
    model = chain()
    observations = observations_of_twin(model, random=False, lock_noise=0.0)
    assert lock_nuisances(observations, model, Forward(observations.tests, observations.rows).predict(model)) == ()
