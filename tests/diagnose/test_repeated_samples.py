"""Samples that a converter lost are seen where the signal is steep; flats and coarse steps are not taken for them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from diagnose.observation_bags import record, rig_with_noise, with_sensor

from nmt_core.numerics.arrays import FloatArray
from nmt_diagnose.observations.observables import Part
from nmt_diagnose.observations.read_observations import read_observations
from nmt_diagnose.prediction.forward import Forward
from nmt_signals.channel_faults.converter_faults import repeated_share

SIZE = 20_000


def _tone(noise: float = 1e-3) -> FloatArray:
    generator = np.random.default_rng(4)
    time = np.arange(SIZE) / 5000.0
    return np.asarray(np.sin(2 * np.pi * 115.0 * time) + noise * generator.standard_normal(SIZE), dtype=np.float64)


def _losing(samples: FloatArray, share: float) -> FloatArray:
    lost = np.random.default_rng(5).random(samples.size) < share
    lost[0] = False
    result = samples.copy()
    for k in np.flatnonzero(lost):
        result[k] = result[k - 1]
    return result


@pytest.mark.parametrize("share", [0.003, 0.02, 0.2])
def test_the_share_of_lost_samples_is_found(share: float) -> None:
    assert repeated_share(_losing(_tone(), share)) == pytest.approx(share, rel=0.35)


def test_a_few_lost_samples_show_over_all_windows() -> None:
    whole = _losing(_tone(), 0.0006)
    windows = np.split(whole[: 10 * (SIZE // 10)], 10)
    assert repeated_share(*windows) == pytest.approx(0.0006, rel=0.6)
    assert max(repeated_share(window) for window in windows[:3]) < 0.01
    healthy = np.split(_tone()[: 10 * (SIZE // 10)], 10)
    assert repeated_share(*healthy) == 0.0
    assert repeated_share(*healthy[:9], _losing(healthy[9], 0.05)) == 0.0, "one window alone"


def test_lost_samples_of_a_random_signal_are_found() -> None:
    samples = np.random.default_rng(6).standard_normal(SIZE)
    assert repeated_share(_losing(samples, 0.01)) == pytest.approx(0.01, rel=0.35)


@pytest.mark.parametrize(
    "samples",
    [
        _tone(),
        _tone(0.0),
        np.clip(_tone(), -0.5, 0.5),
        np.round(_tone() * 20.0) / 20.0,
        np.zeros(SIZE),
        np.random.default_rng(7).standard_normal(SIZE),
    ],
    ids=["healthy", "without noise", "clipped", "coarse", "zero", "random"],
)
def test_what_lost_nothing_is_left_alone(samples: FloatArray) -> None:
    assert repeated_share(samples) == 0.0


@pytest.mark.parametrize("noise", [0.2, 0.5, 1.0, 2.0])
@pytest.mark.parametrize("amplitude", [3.0, 10.0, 30.0, 100.0, 1000.0])
def test_steps_of_a_converter_lose_nothing(amplitude: float, noise: float) -> None:
    """Amplitudes and noise in steps: what noise repeats at steep places it also moves by one step."""
    for seed in range(20):
        samples = amplitude * _tone(0.0) + noise * np.random.default_rng(seed).standard_normal(SIZE)
        assert repeated_share(np.round(samples)) == 0.0


def test_samples_that_a_converter_with_steps_lost_are_found() -> None:
    samples = np.round(20_000.0 * _tone())
    assert repeated_share(_losing(samples, 0.005)) == pytest.approx(0.005, rel=0.35)


def test_lost_samples_of_a_bag_are_an_observable_that_a_healthy_model_does_not_explain(tmp_path: Path) -> None:
    model = rig_with_noise(noise=20.0, overrides=["local_elements=[]"])
    rig = with_sensor(model, "a2", dropped_fraction=0.02)
    bag = record(tmp_path / "run", rig, levels=(0.1, 0.2, 0.4), periods=40)
    observations = read_observations([bag], model)
    rows, names = observations.rows, [channel.name for channel in observations.tests[0].channels]  # type: ignore[union-attr]
    seen = rows.part == Part.REPEATS
    assert set(rows.channel[seen]) == {names.index("a2")}
    assert set(rows.level[seen]) == {0, 1, 2}
    assert observations.values[seen] == pytest.approx(0.02, rel=0.5)
    # All levels together say it once, with ten standard deviations.
    assert np.linalg.norm(observations.values[seen] / observations.sigma[seen]) == pytest.approx(10.0)
    assert np.all(Forward(observations.tests, rows).predict(model).values[seen] == 0.0)
