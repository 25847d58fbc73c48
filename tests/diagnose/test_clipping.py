"""Samples that stand at a level, as a limiter or the end of a converter's range makes them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from diagnose.observation_bags import record, rig_with_noise, with_sensor

from nmt_core.numerics.arrays import FloatArray
from nmt_diagnose.effects.library import candidates
from nmt_diagnose.effects.parametrisation import Parametrisation
from nmt_diagnose.observations.observables import Part
from nmt_diagnose.observations.read_observations import read_observations
from nmt_diagnose.prediction.forward import Forward
from nmt_diagnose.prediction.operating_range import operating_range
from nmt_signals.channel_faults.clipping import clipping_level


def sine(noise: float, count: int = 20_000, seed: int = 1) -> FloatArray:
    result: FloatArray = np.cos(0.031 * np.arange(count)) + noise * np.random.default_rng(seed).standard_normal(count)
    return result


@pytest.mark.parametrize("level", [0.6, 0.97, 0.999])
@pytest.mark.parametrize("noise", [0.0, 1e-4, 1e-2])
def test_what_clips_puts_the_turning_points_into_one_value(level: float, noise: float) -> None:
    assert clipping_level(np.clip(sine(noise), -level, level)) == level
    assert clipping_level(np.clip(sine(noise), -2.0, level)) == level  # one end alone


def test_a_coarse_converter_at_the_end_of_its_range() -> None:
    step = 2.0**-7
    assert clipping_level(np.clip(step * np.round(sine(1e-3) / step), -0.75, 0.75)) == 0.75


@pytest.mark.parametrize("steps", [2.2, 5.4, 5.5, 20.0, 300.3, 32_767.2])
@pytest.mark.parametrize("noise", [0.0, 0.1, 1.0])
def test_turning_points_in_steps_are_no_clipping(steps: float, noise: float) -> None:
    for seed in range(20):
        assert clipping_level(np.round(steps * sine(0.0, seed=seed) + noise * sine(1.0, seed=seed))) == 0.0


def test_signals_that_repeat_exactly_are_no_clipping() -> None:
    period = np.cos(2.0 * np.pi * np.arange(40) / 40.0)
    assert clipping_level(np.tile(period, 200)) == 0.0
    assert clipping_level(np.tile(np.cos(2.0 * np.pi * (np.arange(40) + 0.5) / 40.0), 200)) == 0.0
    assert clipping_level(np.random.default_rng(4).standard_normal(100_000)) == 0.0
    assert clipping_level(np.zeros(100)) == 0.0


def test_a_channel_that_once_stood_still_is_not_clipped() -> None:
    held = sine(1e-3)
    held[5000:5300] = 1.2
    assert clipping_level(held) == 0.0


def test_a_clipped_channel_of_a_bag_is_where_the_search_begins(tmp_path: Path) -> None:
    model = rig_with_noise(noise=20.0, overrides=["local_elements=[]"])
    free = read_observations([record(tmp_path / "free", model, levels=(0.1, 0.2, 0.4), periods=40)], model)
    assert not np.any(free.rows.part == Part.LIMIT)
    assert not operating_range(model, free.tests, observations=free).limits
    amplitude = operating_range(model, free.tests).channels["x4"]
    rig = with_sensor(model, "x4", clip=0.98 * amplitude)
    bag = record(tmp_path / "run", rig, levels=(0.1, 0.2, 0.4), periods=40)
    observations = read_observations([bag], model)
    rows, names = observations.rows, [channel.name for channel in observations.tests[0].channels]  # type: ignore[union-attr]
    seen = rows.part == Part.LIMIT
    assert set(rows.channel[seen]) == {names.index("x4")}
    assert set(rows.level[seen]) == {2}
    assert observations.values[seen] == pytest.approx(1.0 / (0.98 * amplitude), rel=1e-6)
    forward = Forward(observations.tests, rows)
    assert np.all(forward.predict(model).values[seen] == 0.0)
    assert forward.predict(rig).values[seen] == pytest.approx(observations.values[seen])
    found = candidates(model, operating_range(model, observations.tests, observations=observations))
    own = {c.label: c for c in found}
    # One dimensionless strength is the depth that the samples show.
    start = Parametrisation(model, (), (own["clipping@x4"],)).rig(np.array([1.0]))
    assert start == with_sensor(model, "x4", clip=pytest.approx(0.98 * amplitude, rel=1e-6))
    assert Parametrisation(model, (), (own["clipping@x4"],)).reported(np.array([1.0]), 0) == {
        "level": (pytest.approx(0.98 * amplitude, rel=1e-6), "m")
    }
    # Samples that were looked at and show no step need no converter that has one.
    assert not [label for label in own if label.startswith("quantisation")]
    assert [c.label for c in candidates(model, operating_range(model, observations.tests)) if "quantis" in c.label]
    # What the model has, too, is not new.
    assert not np.any(read_observations([bag], rig).rows.part == Part.LIMIT)
