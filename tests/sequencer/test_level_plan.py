"""Plans of levels: notations, spacings, directions, refusals."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nmt_core.errors import BenchError
from nmt_sequencer.level_plan import MAX_LEVELS, check_levels, directed, parse_levels, spaced_levels

positive = st.floats(1e-9, 1e6)


@pytest.mark.parametrize(
    ("text", "levels"),
    [
        ("0.1:10:3", [0.1, 1.0, 10.0]),
        ("0.1:10:3:geometric", [0.1, 1.0, 10.0]),
        ("1:3:5:linear", [1.0, 1.5, 2.0, 2.5, 3.0]),
        (" 1 : 3 : 2 : linear ", [1.0, 3.0]),
        ("10:0.1:3", [10.0, 1.0, 0.1]),
        ("0.7:1.5:1", [0.7]),
        ("0.5", [0.5]),
        ("0.5,0.2, 1e-1", [0.5, 0.2, 0.1]),
        ("2,2", [2.0, 2.0]),
    ],
)
def test_notations(text, levels):
    assert parse_levels(text) == pytest.approx(levels, rel=1e-12)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "'' is not a number; write 'a:b:n'"),
        ("a,b", "'a' is not a number"),
        ("1,,2", "'' is not a number"),
        ("1:2", "are not a plan: write 'a:b:n'"),
        ("1:2:3:4:5", "are not a plan"),
        ("1:2:3:cubic", "are not a plan"),
        ("1:x:3", "'x' is not a number"),
        ("1:2:x", "number of levels must be a whole number from 1 to 1000"),
        ("1:2:0", "number of levels must be a whole number"),
        ("1:2:-3", "number of levels must be a whole number"),
        ("1:2:2.5", "number of levels must be a whole number"),
        ("1:2:1001", "number of levels must be a whole number"),
        ("1:2:²", "number of levels must be a whole number"),
        ("1:2:" + "9" * 5000, "number of levels must be a whole number"),
        ("0:1:5", "every level must be positive and finite, got 0.0"),
        ("-1:1:5", "every level must be positive and finite, got -1.0"),
        ("1:nan:5", "every level must be positive and finite, got nan"),
        ("1:inf:5", "every level must be positive and finite, got inf"),
        ("0,5", "decimals have a point"),
        ("0.1,0,5", "decimals have a point"),
        ("1,5:3:4", "decimals have a point"),
        ("0.1,0", "every level must be positive and finite, got 0.0"),
        ("0.1,-2", "every level must be positive and finite, got -2.0"),
        ("1e999", "every level must be positive and finite, got inf"),
        (",".join(["1"] * 1001), "a plan needs 1 to 1000 levels, got 1001"),
    ],
)
def test_refusals_name_the_text_and_the_mistake(text, words):
    with pytest.raises(BenchError) as caught:
        parse_levels(text)
    assert words in str(caught.value)
    assert str(caught.value).startswith("Levels")


@given(st.text(max_size=30) | st.from_regex(r"[0-9.:,eE+-]{0,20}", fullmatch=True))
def test_any_text_is_a_plan_or_is_refused(text):
    try:
        levels = parse_levels(text)
    except BenchError:
        return
    assert 1 <= len(levels) <= MAX_LEVELS
    assert all(math.isfinite(level) and level > 0 for level in levels)


@given(positive, positive, st.integers(2, 60), st.sampled_from(["geometric", "linear"]))
def test_spacing_is_even_and_ends_are_exact(first, last, count, spacing):
    levels = spaced_levels(first, last, count, spacing)
    assert len(levels) == count
    assert (levels[0], levels[-1]) == (first, last)
    steps = np.diff(np.log(levels) if spacing == "geometric" else levels)
    rounding = 1e-13 if spacing == "geometric" else 1e-15 * max(first, last)
    np.testing.assert_allclose(steps, steps.mean(), rtol=1e-9, atol=2.0 * rounding)


def test_an_unknown_spacing_is_refused():
    with pytest.raises(BenchError, match="Spacing 'cubic' is not known; use geometric or linear"):
        spaced_levels(1.0, 2.0, 3, "cubic")


def test_an_empty_plan_is_refused():
    with pytest.raises(BenchError, match="Plan: a plan needs 1 to 1000 levels, got 0"):
        check_levels([], "Plan")


@given(st.lists(positive, min_size=1, max_size=20, unique=True))
def test_directions(levels):
    up, down, both = (directed(levels, direction) for direction in ("up", "down", "both"))
    assert up == sorted(levels)
    assert down == up[::-1]
    assert both == up + down[1:]
    assert both.count(max(levels)) == 1


def test_an_unknown_direction_is_refused():
    with pytest.raises(BenchError, match="Direction 'sideways' is not known; use up, down, both"):
        directed([1.0], "sideways")
