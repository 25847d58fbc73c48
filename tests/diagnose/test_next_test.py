"""Which test would decide: expected distances against dense algebra, and silence where nothing is open."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from diagnose.linear_problem import FunctionModel, Plain, observations_of
from diagnose.test_judgement import CUBIC, DRAG
from diagnose.twin_tests import chain

from nmt_diagnose.inference import next_test
from nmt_diagnose.inference.fit import fit
from nmt_diagnose.inference.fitted_model import FittedModel
from nmt_diagnose.inference.judgement import ExplanationClass
from nmt_diagnose.inference.next_test import Proposal, next_tests
from nmt_diagnose.inference.problem import Problem

RIG = chain()
SIGMA = 0.5


class Linear(Plain):
    """A parametrisation whose rig says which explanation it is of."""

    def rig(self, theta: np.ndarray) -> Any:
        return (self.names[0], np.asarray(theta, dtype=float))


def fitted(candidate: Any, column: np.ndarray, measured: np.ndarray) -> FittedModel:
    """An explanation y = column θ, fitted to what has been measured."""
    plain = Plain(np.array([3.0]), np.array([-np.inf]), (candidate.label,))
    problem = Problem(observations_of(measured, 1.0), FunctionModel(lambda t: column * t[0]))
    result = fit(problem, plain, np.zeros(1))
    return FittedModel((candidate,), replace(result, parametrisation=Linear(plain.prior_std, plain.lower, plain.names)))


@pytest.fixture
def future(monkeypatch: pytest.MonkeyPatch) -> dict[str, np.ndarray]:
    """Columns of the two explanations in a test that has not been made; the twin predicts by them."""
    generator = np.random.default_rng(3)
    columns = {CUBIC.label: generator.standard_normal(6), DRAG.label: generator.standard_normal(6)}

    class Future:
        def __init__(self, *_: Any) -> None:
            pass

        def predict(self, rig: Any, start: Any = None) -> Any:
            name, theta = rig
            return FunctionModel(lambda t: columns[name] * t[0]).predict(theta)

        def jacobian(self, parametrisation: Any, theta: Any, prediction: Any, which: Any = None) -> np.ndarray:
            return columns[parametrisation.names[0]][:, None]

    monkeypatch.setattr(next_test, "Forward", Future)
    return columns


def competing() -> list[FittedModel]:
    generator = np.random.default_rng(4)
    column = generator.standard_normal(20)
    measured = 2.0 * column + generator.standard_normal(20)
    return [fitted(CUBIC, column, measured), fitted(DRAG, column + 0.1 * generator.standard_normal(20), measured)]


def proposal() -> Proposal:
    return Proposal("a test", "./nmt run", observations_of(np.zeros(6), SIGMA))


def expected(future: dict[str, np.ndarray], a: FittedModel, b: FittedModel) -> float:
    """√(Δᵀ (σ² + J C Jᵀ)⁻¹ Δ) with a true and b adapting."""
    ja, jb = future[a.explanation.label], future[b.explanation.label]
    gap = ja * a.fit.theta[0] - jb * b.fit.theta[0]
    spread = SIGMA**2 * np.eye(6) + np.outer(jb, jb) * b.fit.covariance[0, 0]
    return float(np.sqrt(gap @ np.linalg.solve(spread, gap)))


def test_the_expected_distance_is_that_of_dense_algebra(
    future: dict[str, np.ndarray], monkeypatch: pytest.MonkeyPatch
) -> None:
    a, b = competing()
    least = min(expected(future, a, b), expected(future, b, a))
    assert least > 3.0
    monkeypatch.setattr(next_test, "proposals", lambda rig, observations: [proposal()])
    classes = [ExplanationClass(a, (a,), 0.6), ExplanationClass(b, (b,), 0.3)]
    (found,) = next_tests(RIG, observations_of(np.zeros(20), 1.0), a, classes, None)  # type: ignore[arg-type]
    assert found.expected_sigma == pytest.approx(least, rel=1e-6)
    assert found.separates == ("cubic_stiffness", "air_drag")
    # Members of one class are distinguished just so.
    (same,) = next_tests(RIG, observations_of(np.zeros(20), 1.0), a, [ExplanationClass(a, (a, b), 0.95)], None)  # type: ignore[arg-type]
    assert same == found


def test_a_test_that_cannot_tell_is_not_proposed(
    future: dict[str, np.ndarray], monkeypatch: pytest.MonkeyPatch
) -> None:
    a, b = competing()
    future[DRAG.label] = future[CUBIC.label] * a.fit.theta[0] / b.fit.theta[0]
    monkeypatch.setattr(next_test, "proposals", lambda rig, observations: [proposal()])
    classes = [ExplanationClass(a, (a, b), 0.9)]
    assert next_tests(RIG, observations_of(np.zeros(20), 1.0), a, classes, None) == ()  # type: ignore[arg-type]


def test_one_sure_explanation_needs_no_further_test(monkeypatch: pytest.MonkeyPatch) -> None:
    def never(*_: Any) -> Any:
        raise AssertionError("nothing is left to distinguish")

    monkeypatch.setattr(next_test, "proposals", never)
    a, b = competing()
    classes = [ExplanationClass(a, (a,), 0.97), ExplanationClass(b, (b,), 0.01)]
    assert next_tests(RIG, observations_of(np.zeros(20), 1.0), a, classes, None) == ()  # type: ignore[arg-type]
    assert next_tests(RIG, observations_of(np.zeros(20), 1.0), a, [], None) == ()  # type: ignore[arg-type]
