"""What is too weak to show so far: against draws of rigs, and what a further test tells against dense algebra."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from diagnose.linear_problem import FunctionModel, observations_of
from diagnose.predicted_observations import chain, observations_of_model, real

from nmt_core.kinds.request import TestRequest
from nmt_diagnose.ahead import ahead
from nmt_diagnose.ahead.ahead import Ahead
from nmt_diagnose.ahead.expected_rows import expected as expected_rows
from nmt_diagnose.ahead.hidden_effects import Growth, Hidden, chances
from nmt_diagnose.ahead.proposals import compared
from nmt_diagnose.chain.chain_columns import Chain
from nmt_diagnose.effects.library import candidates
from nmt_diagnose.fit.low_level_modes import LowLevelModes
from nmt_diagnose.fit.model_alone import free_parameters, model_alone
from nmt_diagnose.observations.observables import Part
from nmt_diagnose.prediction.forward import Forward
from nmt_diagnose.prediction.operating_range import operating_range
from nmt_diagnose.search.search import Search


def test_what_the_next_test_adds_is_its_share_of_the_range_of_strengths() -> None:
    """Draws of rigs of which some have an effect, of a strength that spreads evenly over decades."""
    rng, count = np.random.default_rng(3), 400_000
    none, too_weak, strengths = 0.6, 0.16, 3.0  # decades of strength
    acts = rng.random(count) > none
    decades = rng.random(count) * strengths
    weaker = np.array([1.0, 3.0, 12.0])[rng.integers(3, size=count)]
    more = np.array([1.0, 20.0, 60.0])[np.searchsorted([1.0, 3.0, 12.0], weaker)]
    # What shows in no test of a plan: of the rigs that show no gap at its end so many have an effect.
    never = too_weak / (1.0 - too_weak) * none
    never *= strengths / (1.0 - none)
    at_end = never  # decades, from the weakest
    shows_at_end = decades > at_end
    shows_now = decades > at_end + np.log10(more)
    shows_next = decades > at_end + np.log10(more) - np.log10(weaker)
    quiet = ~(acts & shows_now)
    found = chances(np.array([1.0, 3.0, 12.0]), np.array([1.0, 20.0, 60.0]))
    assert found.probability == pytest.approx(np.mean((acts & shows_at_end)[quiet]), abs=4e-3)
    assert found.next == pytest.approx(np.mean((acts & shows_next)[quiet]), abs=4e-3)
    ended = ~(acts & shows_at_end)
    assert np.mean(acts[ended]) == pytest.approx(0.16, abs=4e-3)


def test_information_is_the_mean_fall_of_entropy() -> None:
    hidden = Hidden(0.3, 0.12)

    def entropy(p: float) -> float:
        return -p * math.log(p) - (1.0 - p) * math.log(1.0 - p) if 0.0 < p < 1.0 else 0.0

    rng = np.random.default_rng(4)
    shows = rng.random(200_000) < hidden.next
    left = np.where(shows, 0.0, entropy((0.3 - 0.12) / 0.88))
    assert hidden.information == pytest.approx(entropy(0.3) - float(left.mean()), abs=2e-3)
    assert Hidden(0.0, 0.0).information == 0.0
    assert Hidden(0.2, 0.2).information == pytest.approx(entropy(0.2))
    assert Hidden(0.2, 0.0).information == pytest.approx(0.0)


@pytest.fixture
def problem(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """A linear model with two parameters, two errors of the chain at hand, one of which the further test has, too."""
    rng = np.random.default_rng(5)
    found: dict[str, Any] = {
        "J": rng.standard_normal((20, 2)), "U": rng.standard_normal((20, 2)), "J2": rng.standard_normal((7, 2)),
        "U2": rng.standard_normal((7, 2)), "w": rng.uniform(0.5, 2.0, 20), "sigma": 0.5, "prior": np.array([0.7, 2.0]),
    }  # fmt: skip

    class Future:
        def __init__(self, *_: Any) -> None:
            pass

        def predict(self, rig: Any, start: Any = None) -> Any:
            return FunctionModel(lambda t: found["J2"] @ t).predict(rig)

        def jacobian(self, *_: Any) -> np.ndarray:
            return np.asarray(found["J2"])

    chain = Chain(("gain of one", "phase of proposed"), found["U2"], np.zeros(2, dtype=bool))
    monkeypatch.setattr(ahead, "Forward", Future)
    monkeypatch.setattr(ahead, "linear_chain", lambda *_: chain)
    return found


def made(problem: dict[str, Any]) -> Ahead:
    parametrisation = SimpleNamespace(rig=lambda theta: theta, prior_std=problem["prior"])
    errors = SimpleNamespace(slopes=problem["U"], chain=np.zeros(2), weights=problem["w"])
    fit: Any = SimpleNamespace(theta=np.zeros(2), parametrisation=parametrisation, jacobian=problem["J"], errors=errors)
    return Ahead(fit, ("delay of one", "gain of one"), observations_of(np.zeros(7), problem["sigma"]))


def spread(problem: dict[str, Any]) -> np.ndarray:
    """What parameters, both errors at hand and the one of the test's own move in all 27 rows, over σ."""
    ahead_rows = np.column_stack([problem["J2"], np.zeros(7), problem["U2"]]) / problem["sigma"]
    return np.vstack([np.column_stack([problem["J"], problem["U"], np.zeros(20)]), ahead_rows])


def test_how_far_an_effect_reaches_is_that_of_all_recordings_together(problem: dict[str, Any]) -> None:
    """By the covariance of all rows: noise, and what parameters and chain spread them by before any measurement."""
    rng = np.random.default_rng(6)
    now, further = rng.standard_normal((20, 1)), rng.standard_normal((7, 1))
    rows = np.array([True, True, False, True, True, True, False])
    columns, prior = spread(problem), np.concatenate([problem["prior"] ** 2, np.ones(3)])
    noise = np.concatenate([1.0 / problem["w"], np.ones(7)])
    every = np.vstack([now, further])

    def reach(used: np.ndarray) -> float:
        covariance = np.diag(noise[used]) + (columns[used] * prior) @ columns[used].T
        return float(np.sqrt((every[used].T @ np.linalg.solve(covariance, every[used]))[0, 0]))

    found = made(problem)
    assert found.reach(now, further, None)[0] == pytest.approx(reach(np.arange(20)))
    used = np.concatenate([np.arange(20), 20 + np.flatnonzero(rows)])
    assert found.reach(now, further, rows)[0] == pytest.approx(reach(used))


def test_a_difference_counts_beyond_what_parameters_and_chain_may_still_do(problem: dict[str, Any]) -> None:
    """Their covariance after the recordings at hand, by dense algebra."""
    change = np.random.default_rng(7).standard_normal(7)
    columns, prior = spread(problem), np.concatenate([problem["prior"] ** 2, np.ones(3)])
    at_hand = columns[:20]
    after = np.linalg.inv(np.diag(1.0 / prior) + (at_hand.T * problem["w"]) @ at_hand)
    covariance = np.eye(7) + columns[20:] @ after @ columns[20:].T
    expected = float(np.sqrt(change @ np.linalg.solve(covariance, change)))
    assert made(problem).apart(change, np.ones(7, dtype=bool)) == pytest.approx(expected)


def test_what_is_small_matters_from_the_level_where_draws_of_its_strength_do() -> None:
    """A cubic spring of known uncertainty: by the nonlinear prediction with each drawn strength, level by level."""
    model = chain()
    spring = {"kind": "cubic_spring", "point": 2, "stiffness_n_m3": 1e9}
    observations = observations_of_model(real(model, local_elements=[spring]), seed=4, drives=(0.1, 0.2, 0.3))
    modes, free = LowLevelModes(observations, model), free_parameters(model, observations)
    parameters = [it for it in free if it.name.startswith("exciter.")]  # they hardly take a part of it
    used = np.ones(len(observations.rows), dtype=bool)
    observations, _, null, data = model_alone(model, observations, parameters, used, modes)
    known = candidates(model, operating_range(model, observations.tests, observations=observations))
    search = Search(data, model, parameters, [it for it in known if it.label.startswith("cubic_stiffness@2")])
    found = search.singles(null, search.scores(null))[0]
    fitted, position = found.fit, found.fit.theta.size - 1
    asked = TestRequest(levels=(0.4, 0.6, 0.8, 1.6))
    left = compared(expected_rows(asked, model, observations), asked)
    wanted = {"frequency": 2e-3, "damping": 9.0, "response": 9.0, "harmonics": 9.0}
    alone = Ahead(null.fit, data.chain_names, left)
    growth = Growth(found, 0.9, left, alone, wanted)
    rng, forward = np.random.default_rng(5), Forward(left.tests, left.rows)
    frequency = left.rows.part == Part.LOG_FREQUENCY

    def moved(strength: float) -> np.ndarray:
        theta = fitted.theta.copy()
        theta[position] = strength
        return forward.predict(fitted.parametrisation.rig(theta)).values[frequency]

    base = alone.base.values[frequency]
    draws = fitted.theta[position] + fitted.std[position] * rng.standard_normal(60)
    matters = np.array([np.abs(moved(value) - base) > wanted["frequency"] for value in draws])
    shares = matters.mean(axis=0)
    assert shares[0] < 0.2 < 0.8 < shares[-1]
    for level, share in enumerate(shares):
        rows = left.rows.level <= level
        assert growth.matters(rows) == pytest.approx(0.9 * share, abs=0.13)
    assert growth.levels(1) == 1 + int(np.argmax(shares > 0.5 * shares[-1]))
    assert growth.levels(3) == max(3, growth.levels(1))
    # What does not matter anywhere asks for no more levels than a third.
    assert Growth(found, 0.9, left, alone, dict.fromkeys(wanted, 9.0)).levels(2) == 2
