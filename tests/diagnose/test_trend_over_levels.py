"""What is left at one end of the levels and not at the others is not noise, whatever its scale."""

from __future__ import annotations

import numpy as np
import pytest

from nmt_diagnose.fit.noise import Groups

LEVELS, DRAWS = 10, 4000


def chances(residual: np.ndarray) -> np.ndarray:
    """Probability that there is no trend over the levels of each row of residuals, (draws, levels)."""
    draws, levels = residual.shape
    of = np.repeat(np.arange(draws), levels)
    rank = np.tile(np.arange(levels), draws)
    names = tuple(map(str, range(draws)))
    groups = Groups(of, names, np.full(draws, 6.0), np.zeros(draws), rank)
    return groups.trends(residual.ravel(), np.ones(of.size, dtype=bool))


def noise(seed: int, levels: int = LEVELS) -> np.ndarray:
    """Residuals whose scale has the prior that is assumed of it: s² is inverse-gamma with 6 degrees of freedom."""
    generator = np.random.default_rng(seed)
    scale = np.sqrt(6.0 / generator.chisquare(6.0, (DRAWS, 1)))
    return scale * generator.standard_normal((DRAWS, levels))


@pytest.mark.parametrize("chance", [0.05, 0.01, 0.001])
def test_noise_of_any_scale_has_a_trend_no_more_often_than_it_says(chance: float) -> None:
    found = float(np.mean(chances(noise(1)) < chance))
    assert found < chance + 2.0 * np.sqrt(chance / DRAWS)
    assert found > 0.2 * chance  # the ends overlap, so it is less


def test_levels_at_one_end_that_stand_out_are_found() -> None:
    """Damping of a contact above its clearance: 4 and 6 standard deviations at the two highest of ten levels."""
    residual = noise(2) / np.sqrt(np.mean(noise(2) ** 2, axis=1, keepdims=True))
    residual[:, -2:] += (4.0, 6.0)
    assert np.mean(chances(residual) < 0.01) > 0.95
    assert np.mean(chances(residual[:, ::-1]) < 0.01) > 0.95


def test_all_levels_alike_have_no_trend() -> None:
    assert np.all(chances(np.full((1, LEVELS), 30.0)) > 0.05)


def test_few_levels_have_no_trend() -> None:
    assert np.all(np.isnan(chances(noise(3, 4))))
    assert np.all(np.isfinite(chances(noise(3, 5))))
