"""Steps of converters in the samples, and what the prediction makes of noise at a clipping level."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from diagnose.observation_bags import record, rig_with_noise, with_sensor

from nmt_diagnose.effects.library import candidates
from nmt_diagnose.observations.observables import Part
from nmt_diagnose.observations.read_observations import read_observations
from nmt_diagnose.prediction.converter import expected_clipped
from nmt_diagnose.prediction.forward import Forward
from nmt_diagnose.prediction.influence import Source
from nmt_diagnose.prediction.operating_range import operating_range
from nmt_signals.channel_faults.converter_faults import converter_step


@pytest.mark.parametrize(("step", "offset", "kind"), [
    (0.03, 0.0, np.float64), (7e-4, 0.123456, np.float64), (7e-4, 0.123456, np.float32), (1.7, 40.0, np.float64),
])  # fmt: skip
def test_the_step_of_a_staircase(step: float, offset: float, kind: type) -> None:
    generator = np.random.default_rng(1)
    smooth = 9.0 * np.cos(0.031 * np.arange(20_000)) + 0.01 * generator.standard_normal(20_000)
    samples = (offset + step * np.round(smooth / step)).astype(kind).astype(np.float64)
    assert converter_step(samples) == pytest.approx(step, rel=1e-4)


def test_smooth_samples_have_no_step() -> None:
    generator = np.random.default_rng(2)
    smooth = np.cos(0.031 * np.arange(20_000)) + 1e-3 * generator.standard_normal(20_000)
    assert converter_step(smooth) == 0.0
    assert converter_step(np.clip(smooth, -0.8, 0.8)) == 0.0
    assert converter_step(np.zeros(100)) == 0.0


def test_a_coarse_channel_of_a_bag_is_named_and_the_twin_knows_its_step(tmp_path: Path) -> None:
    model = rig_with_noise(noise=20.0, overrides=["local_elements=[]"])
    step = 3e-6
    rig = with_sensor(model, "x4", bits=16, range=step * 2.0**15)
    bag = record(tmp_path / "run", rig, levels=(0.1, 0.2, 0.4), periods=40)
    observations = read_observations([bag], model)
    rows, names = observations.rows, [channel.name for channel in observations.tests[0].channels]  # type: ignore[union-attr]
    seen = rows.part == Part.STEP
    assert set(rows.channel[seen]) == {names.index("x4")}
    assert observations.values[seen] == pytest.approx(step, rel=1e-6)
    assert [note for note in observations.notes if "x4 is recorded in steps of 3e-06 m" in note]
    forward = Forward(observations.tests, rows)
    assert np.all(forward.predict(model).values[seen] == 0.0)
    assert forward.predict(rig).values[seen] == pytest.approx(step)
    found = {c.label: c for c in candidates(model, operating_range(model, observations.tests))}["quantisation@x4"]
    changed = found.effect.apply(model, found.site, {"lsb": step})
    assert forward.predict(changed).values[seen] == pytest.approx(step)
    columns, _ = forward.influence(model, forward.predict(model), Source("response_sensor", channel="x4"))
    assert np.isfinite(columns).all()
    assert np.all(np.any(columns[seen], axis=1))
    # A converter that the model has, too, is not new.
    assert not np.any(read_observations([bag], rig).rows.part == Part.STEP)


def test_mean_of_clipped_noise() -> None:
    values, noise = np.array([-1.3, -0.9, 0.0, 0.7, 0.95, 1.02, 1.6]), 0.1
    drawn = np.random.default_rng(3).standard_normal(400_000) * noise
    mean = [np.clip(value + drawn, -1.0, 1.0).mean() for value in values]
    assert expected_clipped(values, 1.0, noise) == pytest.approx(mean, abs=6e-4)
    assert expected_clipped(values, 1.0, 0.0) == pytest.approx(np.clip(values, -1.0, 1.0))
