"""How much rows scatter about their neighbours bounds the noise that no gap may be denied by."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from diagnose.predicted_observations import chain, observations_of_model
from moved_threshold import moved_threshold

from nmt_core.numerics.arrays import FloatArray
from nmt_diagnose.fit.noise import groups_of, sigma_of
from nmt_diagnose.ledger.row_scatter import RowScatter, row_scatter
from nmt_diagnose.observations.observables import Part
from nmt_diagnose.prediction.forward import Forward

MODEL = chain()


def looked(noise: float, shift: float = 0.0, drives: tuple[float, ...] = ()) -> dict[str, float]:
    """Largest scales by group: so many times the stated noise, and a misfit that all fundamentals share."""
    drives = drives or tuple(np.geomspace(0.02, 1.6, 16))
    observations = observations_of_model(MODEL, seed=4, noise=noise, drives=drives)
    predicted = Forward(observations.tests, observations.rows).predict(MODEL).values
    shared = shift * (observations.rows.part == Part.LOG_MAGNITUDE) * np.log(observations.rows.amplitude)
    observations = replace(observations, values=observations.values + shared)
    sigma = sigma_of(observations)
    groups = groups_of(observations, np.zeros(sigma.size))
    largest = row_scatter(observations, predicted, sigma).largest_scale(groups.of, len(groups.names))
    return dict(zip(groups.names, map(float, largest), strict=True))


@pytest.mark.parametrize("noise", [1.0, 3.0])
def test_the_bound_holds_the_noise_that_is_there_and_little_more(noise: float) -> None:
    for shift in (0.0, 0.05):
        largest = looked(noise, shift)
        for name in ("levels: fundamental", "levels: harmonics", "random: lines of x1"):
            if name in largest:
                assert noise**2 <= largest[name] < 4.0 * noise**2, (name, shift)


def test_noise_that_is_smaller_than_stated_has_the_bound_of_what_is_stated() -> None:
    assert looked(0.2)["levels: fundamental"] == 1.0


def test_few_rows_bound_nothing() -> None:
    assert np.isinf(looked(1.0, drives=(0.1, 0.4))["levels: frequency"])


def decides(name: str) -> object:
    if name == "scatter_fewest_rows":
        rows = RowScatter(*(np.array([1.0, 1.0, 1.0, np.nan, 1.0, 1.0]) for _ in range(2)))
        return np.isfinite(rows.largest_scale(np.array([0, 0, 0, 0, 1, 1]), 2)).tolist()
    squares: FloatArray = np.full(30, 2.0)
    bound = RowScatter(squares, squares).largest_scale(np.zeros(30, dtype=np.int64), 1)[0]
    return 4.0 < bound < 6.0


@pytest.mark.parametrize("name", ["scatter_fewest_rows", "scatter_probability"])
def test_a_threshold_of_the_scatter_decides(name: str) -> None:
    before = decides(name)
    value = {"scatter_fewest_rows": 3, "scatter_probability": 0.05}[name]
    with moved_threshold(f"noise.{name}", value):
        assert decides(name) == before
    for other in (4, 2) if name == "scatter_fewest_rows" else (0.5, 1e-6):
        with moved_threshold(f"noise.{name}", other):
            assert decides(name) != before
