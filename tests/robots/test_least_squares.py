"""Coefficients that may not be negative, of many right-hand sides at once."""

from __future__ import annotations

import numpy as np
import pytest

from nmt_robots.mechanics.least_squares import solve_many, solve_normal


def test_many_right_hand_sides_are_solved_as_each_alone() -> None:
    rng = np.random.default_rng(3)
    matrix, right = rng.standard_normal((50, 5)), rng.standard_normal((50, 200))
    gram, moments = matrix.T @ matrix, matrix.T @ right
    never = np.array([True, True, True, False, False])
    alone = np.column_stack([solve_normal(gram, moments[:, number], never)[0] for number in range(200)])
    assert np.count_nonzero(alone == 0.0) > 100
    assert solve_many(gram, moments, never) == pytest.approx(alone, abs=1e-12)
