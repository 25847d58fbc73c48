"""Work over several processes: the same results in the same order, whatever happens to a helper."""

from __future__ import annotations

import multiprocessing
import os

import numpy as np
import pytest
from diagnose.twin_observations import chain, observations_of_twin, real

from nmt_core.errors import BenchError
from nmt_diagnose.effects.calibration import calibration_parameters
from nmt_diagnose.effects.library import candidates, library
from nmt_diagnose.inference.explanation_fits import ExplanationFits
from nmt_diagnose.inference.fitted_model import FittedModel
from nmt_diagnose.inference.model_comparison import ModelComparison
from nmt_diagnose.inference.problem import Problem
from nmt_diagnose.inference.workers import Workers
from nmt_diagnose.twin.forward import Forward
from nmt_diagnose.twin.operating_range import operating_range

HERE = os.getpid()


def power(exponent: int, base: int) -> int:
    return int(base**exponent)


def where(_: int, item: int) -> tuple[int, int]:
    return item, os.getpid()


def refused(limit: int, item: int) -> int:
    if item > limit:
        raise BenchError(f"{item} is too large.")
    return item


def fatal_elsewhere(home: int, item: int) -> int:
    if os.getpid() != home:
        os._exit(3)
    return -item


@pytest.mark.parametrize("jobs", [1, pytest.param(3, marks=pytest.mark.campaign)])
def test_results_come_in_the_order_of_the_items(jobs: int) -> None:
    others = set(multiprocessing.active_children())
    with Workers(jobs) as workers:
        assert workers.map(power, 3, list(range(20))) == [k**3 for k in range(20)]
        assert workers.map(power, 2, [7]) == [49]
        assert workers.map(power, 2, []) == []
    assert set(multiprocessing.active_children()) <= others


def test_the_longest_work_begins_first_and_results_stay_in_order() -> None:
    begun: list[int] = []
    with Workers(1) as workers:
        assert workers.map(power, 2, [3, 1, 5, 4], begun.append, weight=float) == [9, 1, 25, 16]
    assert begun == [5, 4, 3, 1]


def test_helpers_take_part() -> None:
    begun: list[int] = []
    with Workers(2) as workers:
        # Long enough for a helper to be there.
        for _ in range(200):
            found = workers.map(where, 0, list(range(50)), begun.append)
            assert [item for item, _ in found] == list(range(50))
            if len({process for _, process in found}) == 2:
                break
        else:
            pytest.fail("no helper ever did anything")
    assert sorted(begun[-50:]) == list(range(50))


@pytest.mark.parametrize("jobs", [1, 2])
def test_the_first_error_is_raised(jobs: int) -> None:
    with Workers(jobs) as workers, pytest.raises(BenchError, match=r"5 is too large\."):
        workers.map(refused, 4, list(range(9)))


def test_work_of_a_helper_that_dies_is_done_all_the_same() -> None:
    with Workers(2) as workers:
        for _ in range(3):
            assert workers.map(fatal_elsewhere, HERE, list(range(30))) == [-k for k in range(30)]


@pytest.mark.campaign
def test_contests_give_the_same_bits_for_any_number_of_processes() -> None:
    model = chain()
    cubic = {"kind": "cubic_spring", "point": 2, "stiffness_n_m3": 2.0e8}
    observations = observations_of_twin(real(model, local_elements=[cubic]), seed=1, drives=(0.1, 0.8, 1.6))
    known = ("air_drag", "cubic_stiffness", "phase_offset", "clipping")
    withheld = tuple(effect.name for effect in library() if effect.name not in known)
    found = candidates(model, operating_range(model, observations.tests), withheld)
    outcomes: list[list[FittedModel]] = []
    for jobs in (1, 3):
        with Workers(jobs) as workers:
            problem = Problem(observations, Forward(observations.tests, observations.rows))
            comparison = ModelComparison(
                ExplanationFits(problem, model, calibration_parameters(model), found), workers=workers
            )
            null = comparison.fits.null()
            singles = comparison.singles(null, comparison.scan(null))
            outcomes.append([*singles, *comparison.pairs(singles)])
    one, *others = outcomes
    assert len(one) > 2
    for other in others:
        assert [own.explanation for own in other] == [own.explanation for own in one]
        for left, right in zip(one, other, strict=True):
            np.testing.assert_array_equal(left.fit.theta, right.fit.theta)
            np.testing.assert_array_equal(left.fit.jacobian, right.fit.jacobian)
            np.testing.assert_array_equal(left.fit.residual, right.fit.residual)
            assert left.fit.log_evidence == right.fit.log_evidence


def test_an_effect_of_the_library_goes_to_another_process_as_itself() -> None:
    """Two of them are micro-slip: in a model with a joint, and in one without."""
    import pickle

    for own in library():
        assert pickle.loads(pickle.dumps(own)) is own
