"""Scatter from level to level of imported runs."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from diagnose.test_amplitude_scales import backbone
from diagnose.twin_observations import chain, observations_of_twin

from nmt_diagnose.inference.scatter import scatter_floor
from nmt_diagnose.observations.conditions import SteppedSineTest
from nmt_diagnose.observations.measuring_chain import MeasuringChain
from nmt_diagnose.observations.observables import Observations, Part, Rows


@pytest.fixture(scope="module")
def observations() -> Observations:
    found = observations_of_twin(chain(), random=False, drives=np.linspace(0.1, 1.6, 40))
    return replace(found, chains=(MeasuringChain(),))


def noise(observations: Observations, seed: int) -> np.ndarray:
    return np.asarray(observations.sigma * np.random.default_rng(seed).standard_normal(len(observations.rows)))


def test_noise_as_stated_is_no_scatter(observations: Observations) -> None:
    for seed in range(10):
        assert not scatter_floor(observations, noise(observations, seed)).any()


def test_scatter_is_found_in_its_kind_at_its_size(observations: Observations) -> None:
    rows, draw = observations.rows, np.random.default_rng(3)
    magnitude = rows.part == Part.LOG_MAGNITUDE
    scatter = 1e-2 * draw.standard_normal(len(rows)) * magnitude
    # A gain and a slope over the level are no scatter.
    difference = noise(observations, 4) + scatter + magnitude * (0.05 + 0.1 * rows.amplitude)
    found = scatter_floor(observations, difference)
    assert found[magnitude] == pytest.approx(1e-2, rel=0.3)
    assert not found[~magnitude].any()


def test_scatter_that_is_not_ordinary_is_bounded(observations: Observations) -> None:
    magnitude = observations.rows.part == Part.LOG_MAGNITUDE
    difference = 0.3 * np.random.default_rng(5).standard_normal(len(observations.rows)) * magnitude
    assert np.max(scatter_floor(observations, difference)) == 0.02


def test_a_table_scatters_about_its_neighbours() -> None:
    """Stated a tenth of what is there; a course that bends, as an effect that is not named yet would, is none."""
    plain = backbone(1.0)
    amplitudes = np.geomspace(1e-5, 1e-3, 24)
    rows = Rows(*(np.resize(getattr(plain.rows, name), 24) for name in Rows.__dataclass_fields__))
    rows = replace(rows, amplitude=amplitudes, level=np.arange(24))
    observations = Observations(plain.tests, rows, np.zeros(24), np.full(24, 5e-4), np.zeros(24))
    bend = 0.02 * (amplitudes / amplitudes.max()) ** 0.5
    sizes = []
    for seed in range(20):
        scatter = 5e-3 * np.random.default_rng(seed).standard_normal(24)
        sizes.append(float(np.max(scatter_floor(observations, bend + scatter))))
        assert not scatter_floor(observations, bend + 0.1 * scatter).any()
    assert np.sqrt(np.mean(np.square(sizes))) == pytest.approx(5e-3, rel=0.15)


def test_a_noise_that_was_only_estimated_follows_what_is_left() -> None:
    """The same scatter, 1.3 times the noise: too little to doubt what is stated, enough to correct an estimate."""
    plain = backbone(1.0)
    rows = Rows(*(np.resize(getattr(plain.rows, name), 24) for name in Rows.__dataclass_fields__))
    rows = replace(rows, amplitude=np.geomspace(1e-5, 1e-3, 24), level=np.arange(24))
    raised: dict[float, list[float]] = {}
    for degrees in (math.inf, 7.0):
        test = replace(plain.tests[0], noise_degrees=degrees)
        observations = Observations((test,), rows, np.zeros(24), np.full(24, 5e-3), np.zeros(24))
        for seed in range(40):
            scatter = 6.5e-3 * np.random.default_rng(seed).standard_normal(24)
            raised.setdefault(degrees, []).append(float(np.max(scatter_floor(observations, scatter))))
    assert np.count_nonzero(raised[math.inf]) < 4
    assert math.hypot(5e-3, math.sqrt(np.mean(np.square(raised[7.0])))) == pytest.approx(6.5e-3, rel=0.05)


def test_the_own_simulator_has_none(observations: Observations) -> None:
    difference = np.random.default_rng(6).standard_normal(len(observations.rows))
    assert not scatter_floor(replace(observations, chains=()), difference).any()
    assert not scatter_floor(replace(observations, chains=(None,)), difference).any()


def sweeps(noise: float, drawn: float, seed: int, effect: float = 0.0) -> tuple[Observations, np.ndarray]:
    """Four sweeps of 34 lines whose stated and drawn noise differ; an effect shifts their resonance by a half width."""
    lines = np.linspace(0.96, 1.04, 34)
    plain = backbone(1.0)
    base = {"channels": (plain.tests[0].channel,), "reference": "force", "held": "force"}
    tests = tuple(
        SteppedSineTest(
            name=f"sweep {k}", drive_point=1, lines_hz=lines, levels=np.ones(34), measured=np.ones((34, 1), complex),
            noise=np.full(34, noise), direction=0, **base,
        )
        for k in range(4)
    )  # fmt: skip
    part = np.tile(np.repeat([int(Part.LOG_MAGNITUDE), int(Part.PHASE)], 34), 4)
    count = part.size
    rows = Rows(
        np.repeat(np.arange(4), 68), np.tile(np.arange(34), 8), np.zeros(count, int), np.ones(count, int), part,
        np.zeros(count), np.tile(lines, 8), np.ones(count),
    )  # fmt: skip
    response, moved = (1.0 / (1.0 - (lines / f) ** 2 + 0.02j * lines / f) for f in (1.0, 1.0 + 0.01 * effect))
    change = np.log(moved / response)
    left = np.tile(np.concatenate([change.real, change.imag]), 4)
    draw = np.random.default_rng(seed)
    observations = Observations(tests, rows, np.zeros(count), np.full(count, noise), np.zeros(count))
    return observations, left + drawn * draw.standard_normal(count)


def test_lines_of_sweeps_that_scatter_as_stated_have_no_more() -> None:
    for seed in range(20):
        assert not scatter_floor(*sweeps(2e-3, 2e-3, seed)).any()


@pytest.mark.campaign
def test_lines_of_sweeps_that_had_not_settled() -> None:
    found = [scatter_floor(*sweeps(2e-3, 4e-3, seed)) for seed in range(20)]
    more = math.sqrt(4e-3**2 - 2e-3**2)
    assert np.mean([size.max() for size in found]) == pytest.approx(more, rel=0.1)
    assert all(size.min() == size.max() for size in found)
    assert scatter_floor(*sweeps(2e-3, 0.1, 1)).max() == 0.02


def test_a_resonance_that_an_effect_shifts_is_no_scatter() -> None:
    for seed in range(10):
        assert scatter_floor(*sweeps(2e-3, 2e-3, seed, effect=0.5)).max() < 1e-3
