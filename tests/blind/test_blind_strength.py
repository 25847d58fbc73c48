"""What a σ is: the closed form where everything is linear, and the prior alone where a parameter imitates an effect."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from nmt_blind.cases import strength, strength_curve
from nmt_blind.cases.injected_effects import INJECTED_EFFECTS
from nmt_blind.cases.laboratory import TrialError
from nmt_blind.cases.strength import Observed, Sensitivity
from nmt_blind.cases.strength_curve import climbed, curve, value_at

ROWS = 60
LEVEL = np.repeat(np.arange(12.0), 5)
NOISE = np.linspace(0.5, 2.0, ROWS)
_generator = np.random.default_rng(4)
COLUMNS = _generator.standard_normal((ROWS, 3)) * (6.0, 2.0, 0.5)


def observed(values: np.ndarray) -> Observed:
    return Observed(values, NOISE, LEVEL)


def sensitivity(columns: np.ndarray = COLUMNS) -> Sensitivity:
    """One whose tests are arithmetic: nothing is played."""
    own = Sensitivity.__new__(Sensitivity)
    own.base, own._nuisance = observed(np.zeros(ROWS)), columns
    own.model = None  # type: ignore[assignment]
    # The first column is a parameter of the model, in prior standard deviations; the others are of the lock.
    own._made = [lambda deviation: deviation, *[None] * (columns.shape[1] - 1)]  # type: ignore[list-item, return-value]
    own._late, own.relative, own._leads = [], [], []
    own.bench = type("Bench", (), {"levels": tuple(range(12))})()  # type: ignore[assignment]
    return own


@pytest.fixture(autouse=True)
def one_parameter(monkeypatch: pytest.MonkeyPatch) -> None:
    """An edit of the model is the shift of its parameter."""
    monkeypatch.setattr(strength, "with_edits", lambda model, edits: edits[0])


def test_where_all_is_linear_it_is_the_generalised_distance(monkeypatch: pytest.MonkeyPatch) -> None:
    own = sensitivity()
    monkeypatch.setattr(own, "observe", lambda shift: observed(COLUMNS[:, 0] * shift), raising=False)
    for scale in (0.1, 1.0, 3.0):
        difference = scale * _generator.standard_normal(ROWS)
        covariance = np.diag(NOISE**2) + COLUMNS @ COLUMNS.T
        exact = math.sqrt(difference @ np.linalg.solve(covariance, difference))
        assert own.sigma_of(observed(difference)) == pytest.approx(exact, rel=1e-9)


def test_what_a_parameter_imitates_costs_its_prior_however_curved(monkeypatch: pytest.MonkeyPatch) -> None:
    direction = COLUMNS[:, 0] * 50.0

    def play(shift: float) -> Observed:
        return observed(direction * math.expm1(0.15 * shift) / 0.15)

    own = sensitivity(np.column_stack([direction, COLUMNS[:, 1:]]))
    monkeypatch.setattr(own, "observe", play, raising=False)
    found = own.sigma_of(play(6.0))
    assert found == pytest.approx(6.0, rel=0.02)
    # A linear estimate would take the curvature for more.
    assert own.linear(play(6.0))[1] > 1.3 * found


def test_a_resonance_that_moved_by_more_than_its_width_is_a_shift_all_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    levels = np.concatenate([np.arange(12.0), np.full(81, -1.0)])
    noise = np.concatenate([np.full(12, 3e-5), np.full(81, 0.02)])
    lines = np.linspace(0.98, 1.02, 81)

    def play(shift: float) -> Observed:
        frequency = math.exp(0.005 * shift)  # a prior standard deviation is two and a half times the half width
        peak = 1.0 / (1.0 - (lines / frequency) ** 2 + 2j * 0.002 * lines / frequency)
        return Observed(np.concatenate([np.full(12, math.log(frequency)), np.abs(peak)]), noise, levels)

    own = sensitivity(np.zeros((93, 1)))
    own.base = play(0.0)
    own._nuisance = ((play(0.01).values - play(-0.01).values) / 0.02)[:, np.newaxis]
    monkeypatch.setattr(own, "observe", play, raising=False)
    assert own.linear(play(0.7))[1] > 100.0
    rungs, trouble = climbed(own, play, 0.7, 5.0)
    assert trouble == "as strong as it can be"
    assert rungs[0].value < 0.05  # it begins where everything is linear
    assert rungs[-1].value == pytest.approx(5.0)
    for rung in rungs:
        assert rung.sigma == pytest.approx(rung.value, rel=0.01)


def test_strong_effects_are_bounded_without_a_search(monkeypatch: pytest.MonkeyPatch) -> None:
    """A curved shift imitates an effect but for a part of its own: from 256 σ on no strength takes more than a few."""
    direction, own_part = COLUMNS[:, 0] * 50.0, np.zeros(ROWS)
    own_part[7] = 200.0 * NOISE[7]
    played = []

    def play(shift: float, value: float = 0.0) -> Observed:
        played.append(shift)
        return observed(direction * math.expm1(0.15 * shift) / 0.15 + own_part * value)

    own = sensitivity(np.column_stack([direction, COLUMNS[:, 1:]]))
    monkeypatch.setattr(own, "observe", play, raising=False)
    begun: list[int] = []

    def truth(value: float) -> Observed:
        begun.append(len(played))
        return play(value, value)

    rungs, _ = climbed(own, truth, 0.01, 1e3)
    assert rungs[-1].sigma >= 4096.0
    exact = np.linalg.norm(own_part / NOISE)
    strong = [rung for before, rung in itertools.pairwise(rungs) if before.sigma >= strength_curve.SEARCHED]
    assert strong
    for rung in rungs:
        least = 0.5 * exact * rung.value  # the other shifts take some of it
        assert rung.sigma >= least
    for rung in rungs[: -len(strong)]:
        assert rung.sigma <= 1.1 * math.hypot(exact * rung.value, rung.value)
    ends = [*begun[1:], len(played)]
    assert max(end - start for start, end in zip(begun[-len(strong) :], ends[-len(strong) :], strict=True)) <= 4


def test_products_of_signatures_are_the_generalised_ones_where_all_is_linear(monkeypatch: pytest.MonkeyPatch) -> None:
    own = sensitivity()
    monkeypatch.setattr(own, "observe", lambda shift: observed(COLUMNS[:, 0] * shift), raising=False)
    differences = _generator.standard_normal((2, ROWS))
    signatures = [
        own.signature(observed(difference), own.settled(observed(difference), own.shifted(observed(difference))).made)
        for difference in differences
    ]
    metric = np.linalg.inv(np.diag(NOISE**2) + COLUMNS @ COLUMNS.T)
    gram = np.array([[one @ other for other in signatures] for one in signatures])
    np.testing.assert_allclose(gram, differences @ metric @ differences.T, rtol=1e-6)


def flat_effect(own: Sensitivity, monkeypatch: pytest.MonkeyPatch, most: float = math.inf) -> Any:
    """An effect of which a strength of 1 is four standard deviations, half of it a parameter's; tests fail beyond."""

    def played(value: float) -> Observed:
        if value > most:
            raise TrialError("only 3 levels locked")
        values = np.zeros(ROWS)
        values[7] = 4.0 * NOISE[7] * value
        return observed(values + COLUMNS[:, 0] * 0.01 * value)

    monkeypatch.setattr(own, "observe", lambda shift: observed(COLUMNS[:, 0] * shift), raising=False)
    monkeypatch.setattr(own, "played", played)
    object.__setattr__(own, "operating", None)
    own.rig = type("R", (), {"caution": 1.0})()  # type: ignore[assignment]
    truth = INJECTED_EFFECTS["response_gain"]
    return replace(truth, changes=lambda at, value: value, first=lambda _: 0.001, largest=math.inf)


def test_a_curve_goes_from_weak_to_strong(monkeypatch: pytest.MonkeyPatch) -> None:
    own = sensitivity(1e-3 * COLUMNS)
    found, signature = curve(own, flat_effect(own, monkeypatch), None, {"points": [[16.0, 64.0]]})  # type: ignore[arg-type]
    values, sigmas = np.array(found["points"]).T
    assert found["trouble"] == ""
    assert sigmas == pytest.approx(4.0 * values, rel=1e-2)
    assert sigmas[0] <= 12.0
    assert sigmas[-1] >= 4096.0
    assert signature is not None
    assert np.linalg.norm(signature) == pytest.approx(4.0 * found["compared"]["value"], rel=1e-2)


def test_only_what_grows_in_proportion_is_compared_from_afar(monkeypatch: pytest.MonkeyPatch) -> None:
    own = sensitivity(1e-3 * COLUMNS)
    effect = flat_effect(own, monkeypatch)
    monkeypatch.setattr(strength_curve, "COMPARED", 0.1)
    assert curve(own, effect, None)[1] is not None  # type: ignore[arg-type]
    found, signature = curve(own, replace(effect, proportional=False), None)  # type: ignore[arg-type]
    assert signature is None
    assert "compared" not in found


def test_a_curve_ends_where_the_tests_end_and_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    own = sensitivity(1e-3 * COLUMNS)
    found, _ = curve(own, flat_effect(own, monkeypatch, most=300.0), None)  # type: ignore[arg-type]
    assert "only 3 levels locked" in found["trouble"]
    values = [value for value, _ in found["points"]]
    assert 200.0 < max(values) <= 300.0
    # What lies beyond is not made up.
    assert value_at(found, 4096.0) is None
    assert value_at(found, 64.0) == pytest.approx(16.0, rel=0.01)


def test_a_rig_that_cannot_be_tested_with_an_effect_has_no_strengths(monkeypatch: pytest.MonkeyPatch) -> None:
    own = sensitivity(1e-3 * COLUMNS)
    found, signature = curve(own, flat_effect(own, monkeypatch, most=0.0), None)  # type: ignore[arg-type]
    assert (found["points"], signature) == ([], None)
    assert found["trouble"] == "only 3 levels locked"
