"""Choice among columns, against closed forms and against every set of a small library."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import nnls
from scipy.signal import lfilter

from nmt_diagnose.choose.choice import ALPHA, Choice, Chosen
from nmt_diagnose.choose.space import Columns, Space

Array = NDArray[np.float64]
ROWS, GROUPS = 240, 12


def named(values: Array, term: str, **limits: float) -> Columns:
    return Columns("", term, values.reshape(len(values), -1), **limits)  # type: ignore[arg-type]


def space_of(left: Array, rng: np.random.Generator, floor: float = 0.02, **more: Array) -> Space:
    groups = np.repeat(np.arange(float(GROUPS)), ROWS // GROUPS)
    return Space(left, 0.05 * rng.standard_normal((ROWS, 3)), groups, 80.0, floor, **more)  # type: ignore[arg-type]


def criterion(space: Space, causes: list[Columns], count: int) -> float:
    """The criterion written out row by row, the nuisances' priors as rows of their own."""
    matrix = np.column_stack([space.nuisances, *(item.values for item in causes)])
    fixed = space.nuisances.shape[1]
    prior = np.eye(matrix.shape[1])[:fixed]

    def solved(rows: NDArray[np.bool_], variance: float) -> Array:
        weight = np.sqrt(space.independent / len(space.left) / variance)
        stacked = np.vstack([weight * matrix[rows], prior])
        return np.asarray(np.linalg.lstsq(stacked, np.r_[weight * space.left[rows], np.zeros(fixed)], rcond=None)[0])

    every = np.ones(len(space.left), dtype=bool)
    variance = max(float(np.mean(space.left**2)), space.floor**2)
    for _ in range(40):
        values = solved(every, variance)
        variance = max(float(np.mean((space.left - matrix @ values) ** 2)), space.floor**2)
    squares = 0.0
    for group in np.unique(space.groups):
        unseen = space.groups == group
        squares += float(np.sum((space.left - matrix @ solved(~unseen, variance))[unseen] ** 2))
    squares /= len(space.left)
    noise = max(squares, space.floor**2)
    price = 2.0 * np.log(count / ALPHA) * len(causes) + np.log(space.independent) * (matrix.shape[1] - fixed)
    return float(space.independent * (np.log(noise) + squares / noise) + np.sum(values[:fixed] ** 2) + price)


def mixed(seed: int) -> tuple[Space, list[Columns], set[str]]:
    """Eight columns that lean on each other, of which one to three are there."""
    rng = np.random.default_rng([17, seed])
    common = rng.standard_normal((ROWS, 3))
    columns = [
        named(common @ rng.standard_normal(3) + 0.6 * rng.standard_normal(ROWS), f"t{number}") for number in range(8)
    ]
    there = rng.choice(8, size=int(rng.integers(1, 4)), replace=False)
    left = 0.3 * rng.standard_normal(ROWS)
    for number in there:
        left = left + rng.choice([-1.0, 1.0]) * rng.uniform(0.4, 1.0) * columns[number].values[:, 0]
    return space_of(left, rng), columns, {f"t{number}" for number in there}


@pytest.mark.parametrize(
    "seeds", [(0, 10, 21), pytest.param(range(60), marks=pytest.mark.campaign)], ids=["few", "many"]
)
def test_the_best_of_all_sets_is_found(seeds: Sequence[int]) -> None:
    right = 0
    for seed in seeds:
        space, columns, there = mixed(seed)
        scores = {
            numbers: criterion(space, [columns[number] for number in numbers], len(columns))
            for size in range(5)
            for numbers in combinations(range(8), size)
        }
        best = min(scores, key=lambda numbers: scores[numbers])
        chosen = Choice(space).grow(columns, 4)
        assert {cause.term for cause in chosen.causes} == {f"t{number}" for number in best}, seed
        assert chosen.score == pytest.approx(scores[best], abs=0.1)
        right += {cause.term for cause in chosen.causes} == there
    assert right >= 0.9 * len(seeds)


def test_a_wrong_first_step_is_taken_back() -> None:
    """Dry and viscous friction: alone, friction with the root of speed takes more than either."""
    rng = np.random.default_rng(3)
    speed = 1.5 * np.sin(np.linspace(0.0, 40.0, ROWS)) * rng.uniform(0.3, 1.0, ROWS)
    shapes = {"dry": np.sign(speed), "viscous": speed, "root": np.sign(speed) * np.sqrt(np.abs(speed))}
    columns = [named(values, term) for term, values in shapes.items()]
    space = space_of(shapes["dry"] + shapes["viscous"] + 0.05 * rng.standard_normal(ROWS), rng)
    gains = Choice(space).gain(columns)
    assert np.argmax(gains) == 2
    chosen = Choice(space).grow(columns, 3)
    assert {cause.term for cause in chosen.causes} == {"dry", "viscous"}
    assert chosen.probability(("", "root")) < 0.05 < 0.9 < chosen.probability(("", "dry"))


def test_a_gain_is_that_of_least_squares_without_the_nuisances() -> None:
    rng = np.random.default_rng(5)
    column, left = rng.standard_normal((2, ROWS))
    groups = np.repeat(np.arange(float(GROUPS)), ROWS // GROUPS)
    bare = Space(left, np.zeros((ROWS, 0)), groups, 80.0, 2.0)
    expected = 80.0 / ROWS / 4.0 * (column @ left) ** 2 / (column @ column)
    assert Choice(bare).gain([named(column, "one")]) == pytest.approx([expected])
    # A nuisance that costs nothing takes its own column whole.
    taken = Space(left, 1e6 * column[:, None], groups, 80.0, 2.0)
    assert Choice(taken).gain([named(column, "one")])[0] < 1e-3 * expected


def test_a_nuisance_within_its_prior_is_no_cause() -> None:
    rng = np.random.default_rng(7)
    column = rng.standard_normal(ROWS)
    groups = np.repeat(np.arange(float(GROUPS)), ROWS // GROUPS)
    noise = 0.02 * rng.standard_normal(ROWS)
    for size, causes in ((1.5, 0), (9.0, 1)):
        space = Space(0.1 * size * column + noise, 0.1 * column[:, None], groups, 80.0, 0.02)
        assert len(Choice(space).grow([named(column, "one")], 2).causes) == causes


def test_what_lies_below_the_noise_is_no_cause() -> None:
    rng = np.random.default_rng(9)
    column = rng.standard_normal(ROWS)
    for size, causes in ((0.2, 0), (1.2, 1)):
        space = space_of(size * column, rng, floor=1.0)
        assert len(Choice(space).grow([named(column, "one")], 2).causes) == causes


def test_coefficients_beyond_their_limits_are_not_chosen() -> None:
    rng = np.random.default_rng(11)
    column = rng.standard_normal(ROWS)
    space = space_of(-column, rng)
    for limits, causes in (
        ({}, 1), ({"lowest": 0.0}, 0), ({"lowest": -0.5}, 0), ({"smallest": 1.5}, 0), ({"smallest": 0.5}, 1),
    ):  # fmt: skip
        assert len(Choice(space).grow([named(column, "one", **limits)], 2).causes) == causes


def test_a_target_is_not_explained_by_making_it_small() -> None:
    """Half of the target is left over by a wrong factor, and all of it by chance."""
    rng = np.random.default_rng(13)
    target = rng.standard_normal(ROWS)
    other = rng.standard_normal(ROWS)
    part = Columns("", "factor", target[:, None], of_target=True)
    noise = 0.05 * rng.standard_normal(ROWS)
    half = space_of(0.5 * target + noise, rng, target=target)
    assert [cause.term for cause in Choice(half).grow([part], 2).causes] == ["factor"]
    mixed_up = space_of(target + 0.3 * other, rng, target=target + other)
    scaled = Columns("", "factor", (target + other)[:, None], of_target=True)
    assert Choice(mixed_up).gain([scaled])[0] > 10.0
    assert Choice(mixed_up).grow([scaled], 2).causes == ()


def test_equal_columns_share_their_probability_and_stand_for_each_other() -> None:
    rng = np.random.default_rng(15)
    first, second, other = rng.standard_normal((3, ROWS))
    columns = [named(first, "a"), named(second, "b"), named(2.0 * first, "c"), named(other, "d")]
    space = space_of(first + 0.5 * second + 0.1 * rng.standard_normal(ROWS), rng)
    chosen = Choice(space).grow(columns, 3, alike=6.0)
    assert [cause.term for cause in chosen.causes] == ["a", "b"]
    assert chosen.instead == (("", "c"),)
    assert chosen.probability(("", "a")) == pytest.approx(0.5, abs=0.02)


def test_coefficients_that_are_not_negative_are_those_of_nonnegative_least_squares() -> None:
    """Of three that lean on each other the best fit of either sign has a negative one."""
    rng = np.random.default_rng(19)
    common = rng.standard_normal(ROWS)
    values = np.column_stack([common + 0.3 * rng.standard_normal(ROWS) for _ in range(3)])
    left = values @ np.array([1.0, 0.8, -0.7]) + 0.2 * rng.standard_normal(ROWS)
    groups = np.repeat(np.arange(float(GROUPS)), ROWS // GROUPS)
    space = Space(left, np.zeros((ROWS, 0)), groups, 80.0, 0.02)
    assert np.linalg.lstsq(values, left, rcond=None)[0].min() < -0.1
    chosen = Choice(space).grow([Columns("", "grid", values, signed=np.zeros(3, bool))], 1)
    assert chosen.judged[0].values / np.sqrt(np.mean(values**2, axis=0)) == pytest.approx(nnls(values, left)[0])
    # A coefficient at its limit costs nothing.
    two = Choice(space).grow([Columns("", "grid", values[:, :2], signed=np.zeros(2, bool))], 1)
    assert chosen.score == pytest.approx(two.score, abs=0.5)
    assert Choice(space).gain([Columns("", "grid", -values, signed=np.zeros(3, bool))]) == pytest.approx([0.0])


class Knee(Columns):
    """Saturation at a number that is moved; it may follow a measured channel."""

    def __init__(self, x: Array, at: float, channel: Array | None = None) -> None:
        values = np.clip(x, -at, at)[:, None]
        super().__init__("", "knee", values if channel is None else np.hstack([values, values * channel[:, None]]))
        object.__setattr__(self, "parts", (x, at, channel))

    @property
    def reaches(self) -> list[tuple[float, float]]:
        return [(-0.5, 0.5)]

    def moved(self, number: int, log_factor: float) -> Knee:
        x, at, channel = self.parts  # type: ignore[attr-defined]
        return Knee(x, at * float(np.exp(log_factor)), channel)

    def following(self) -> list[Knee]:
        x, at, channel = self.parts  # type: ignore[attr-defined]
        return [Knee(x, at, CHANNEL)] if channel is None else []


CHANNEL = np.sin(np.arange(ROWS))


@pytest.mark.parametrize("follows", [0.0, 0.4])
def test_numbers_in_columns_move_to_where_the_fit_is_best_and_channels_are_followed_where_they_tell(
    follows: float,
) -> None:
    rng = np.random.default_rng(23)
    x = 2.0 * rng.standard_normal(ROWS)
    left = np.clip(x, -0.83, 0.83) * (1.0 + follows * CHANNEL) + 0.02 * rng.standard_normal(ROWS)
    library = [Knee(x, 0.6), Knee(x, 1.2), named(x, "line")]
    (cause,) = Choice(space_of(left, rng)).grow(library, 3).causes
    assert isinstance(cause, Knee)
    _, at, channel = cause.parts  # type: ignore[attr-defined]
    assert at == pytest.approx(0.83, rel=0.02)
    assert (channel is not None) == bool(follows)


def test_rows_are_counted_by_what_a_fit_leaves() -> None:
    """A first-order process with a correlation of 0.8 has 1/9 of its rows; groups at the ends are in every fit."""
    rng = np.random.default_rng(29)
    noise = rng.standard_normal(20000)
    values = lfilter([1.0], [1.0, -0.8], noise)
    groups = np.repeat(np.arange(5.0), 4000)
    space = Space(values, np.zeros((20000, 0)), groups, np.nan, 1.0, series=[np.arange(20000)])
    assert space.independent_by(values) == pytest.approx(20000 / 9.0, rel=0.1)
    step = np.where(groups == 4.0, 1.0, 0.0)[:, None]
    left = noise + 10.0 * step[:, 0]
    inner = Space(left, np.zeros((20000, 0)), groups, 20000.0, 1.0, ends=(0.0, 4.0))
    every = Space(left, np.zeros((20000, 0)), groups, 20000.0, 1.0)
    chosen = [Choice(space).grow([Columns("", "step", step)], 1) for space in (inner, every)]
    # No other group tells the size of a step that the last one alone has.
    assert every_unseen(chosen[1]) > 3.0 > every_unseen(chosen[0])


def every_unseen(chosen: Chosen) -> float:
    """Criterion of the set that has a cause over the rows, without what the cause costs."""
    held = next(item for item in chosen.judged if item.numbers)
    return float(held.score - 2.0 * np.log(1.0 / ALPHA) - np.log(20000.0)) / 20000.0


def test_columns_are_asked_by_place_and_term() -> None:
    column = np.ones((ROWS, 1))
    library = [Columns(place, term, column) for place in ("p", "q") for term in ("s", "t", "u")]
    space = Space(column[:, 0], np.zeros((ROWS, 0)), np.zeros(ROWS), 80.0, 1.0, library=library)
    assert [item.key for item in space.columns("p", ("s", "u"))] == [("p", "s"), ("p", "u")]
    assert len(space.columns()) == 6
