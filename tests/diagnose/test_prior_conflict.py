"""Parameters of the model that are far from what is believed of them, against the ratio of two normal densities."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from scipy.stats import norm

from nmt_diagnose.inference.confidence import confidence
from nmt_diagnose.inference.fitted_model import FittedModel
from nmt_diagnose.inference.prior_conflict import prior_conflict


def model(theta: list[float], stds: list[float] | None = None) -> FittedModel:
    """What is asked of a fit: parameters in prior standard deviations, and how large these are."""
    calibration = [SimpleNamespace(std=std) for std in stds or [0.05] * len(theta)]
    fitted = SimpleNamespace(theta=np.array([*theta, 40.0]), parametrisation=SimpleNamespace(calibration=calibration))
    return cast(FittedModel, cast(Any, SimpleNamespace(fit=fitted)))


def test_it_is_the_best_ratio_of_densities_without_the_farthest() -> None:
    theta = np.array([7.7, -5.1, 5.1, 5.0, -2.4, 0.1])
    rest = theta[1:]

    def less(log_factor: float) -> float:
        return float(np.sum(norm.logpdf(rest) - norm.logpdf(rest, scale=math.exp(log_factor))))

    best = minimize_scalar(less, bounds=(0.0, 4.0), method="bounded", options={"xatol": 1e-9})
    assert prior_conflict(model(list(theta))) == pytest.approx(-best.fun, rel=1e-6)
    assert prior_conflict(model(list(theta))) > 20.0


@pytest.mark.parametrize("theta", [[], [9.0], [30.0, 0.5, -0.5, 0.2], [1.0, -1.2, 0.8]])
def test_one_that_is_far_off_and_ordinary_ones_are_believed(theta: list[float]) -> None:
    assert prior_conflict(model(theta)) < 0.1


def test_what_is_a_guess_does_not_count() -> None:
    assert prior_conflict(model([5.0, 5.0, 5.0, 0.1], [0.2, 0.2, 0.3, 0.05])) == 0.0
    assert prior_conflict(model([5.0, 5.0, 5.0, 0.1], [0.1, 0.1, 0.1, 0.05])) > 10.0


def test_healthy_models_hardly_ever_reach_the_alarm() -> None:
    draws = np.random.default_rng(4).standard_normal((20_000, 10))
    conflicts = np.array([prior_conflict(model(list(draw))) for draw in draws])
    least = confidence().alarm - math.log(confidence().prior_unknown / confidence().prior_none)
    assert np.mean(conflicts > least) < 1e-3
