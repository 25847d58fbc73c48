"""What a σ is: the closed form where everything is linear, and the prior alone where a parameter imitates an effect."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from nmt_blind.cases import strength
from nmt_blind.cases.injected_effects import INJECTED_EFFECTS
from nmt_blind.cases.laboratory import TrialError
from nmt_blind.cases.strength import Observed, Sensitivity

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
    own._late = []
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
    linear, _ = own._fitted(play(6.0), own.base.values, np.zeros(3))[1:]
    assert linear > 1.3 * found


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
    linear = own._fitted(play(0.7), own.base.values, np.zeros(1))[1]
    assert own.sigma_of(play(0.7)) == pytest.approx(0.7, rel=0.05)
    assert linear > 100.0


def test_cosines_leave_out_what_parameters_take() -> None:
    own = sensitivity()
    own_mark, other = _generator.standard_normal((2, ROWS))
    plain = np.column_stack([own_mark, other])
    metric = np.linalg.inv(np.eye(ROWS) + (COLUMNS / NOISE[:, None]) @ (COLUMNS / NOISE[:, None]).T)
    np.testing.assert_allclose(own.products(plain), plain.T @ metric @ plain, rtol=1e-9)


def test_a_former_curve_is_where_the_search_starts(monkeypatch: pytest.MonkeyPatch) -> None:
    own = sensitivity()
    tried: list[float] = []

    def sigmas(edits: Any, refine: bool) -> tuple[float, float, Any]:
        tried.append(edits)
        # Parameters take half of what a linear estimate says.
        return (4.0 if refine else 8.0) * float(edits), 8.0 * float(edits), np.array([float(edits)])

    truth = INJECTED_EFFECTS["response_gain"]
    monkeypatch.setattr(own, "sigmas", sigmas)
    object.__setattr__(own, "operating", None)
    flat = replace(truth, edits=lambda rig, operating, spot, value: value, guess=lambda *_: 0.001, largest=math.inf)
    own.rig = type("R", (), {"caution": 1.0})()  # type: ignore[assignment]
    curve, mark = own.curve(flat, None, {"points": [[4.0, 16.0], [16.0, 64.0]], "proportional": True})  # type: ignore[arg-type]
    assert tried[0] == pytest.approx(16.0)
    assert curve == {"points": [[2.0, 8.0], [16.0, 64.0], [1024.0, 4096.0]], "proportional": True, "trouble": ""}
    # The nearest to where signatures are compared; farther ones do only of what grows in proportion.
    assert mark == pytest.approx([2.0])
    other = own.curve(replace(flat, proportional=False), None, {"points": [[16.0, 64.0]]})[1]  # type: ignore[arg-type]
    assert other == pytest.approx([2.0])
    monkeypatch.setattr(strength, "COMPARED", 1.0)
    assert own.curve(flat, None, {"points": [[16.0, 64.0]]})[1] == pytest.approx([2.0])  # type: ignore[arg-type]
    assert own.curve(replace(flat, proportional=False), None, {"points": [[16.0, 64.0]]})[1] is None  # type: ignore[arg-type]


def test_a_curve_ends_where_the_tests_end_and_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    own = sensitivity()

    def sigmas(edits: Any, refine: bool) -> tuple[float, float, Any]:
        if edits > 300.0:
            raise TrialError("only 3 levels locked")
        return 4.0 * float(edits), 4.0 * float(edits), np.zeros(1)

    truth = INJECTED_EFFECTS["cubic_stiffness"]
    monkeypatch.setattr(own, "sigmas", sigmas)
    object.__setattr__(own, "operating", None)
    flat = replace(truth, edits=lambda rig, operating, spot, value: value, guess=lambda *_: 10.0)
    own.rig = type("R", (), {"caution": 1.0})()  # type: ignore[assignment]
    curve, _ = own.curve(flat, None)  # type: ignore[arg-type]
    assert "only 3 levels locked" in curve["trouble"]
    values = [value for value, _ in curve["points"]]
    assert 100.0 < max(values) <= 300.0
    # What lies beyond is not made up.
    assert strength.value_at(curve, 4096.0) is None
    assert strength.value_at(curve, 64.0) == pytest.approx(16.0, rel=0.01)
