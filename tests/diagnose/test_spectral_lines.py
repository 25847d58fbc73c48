"""Lines of the mains beside the harmonics of locked windows."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from diagnose.observation_bags import record, rig_with_noise
from numpy.typing import NDArray
from tiers import with_quick

from nmt_core.numerics.arrays import FloatArray
from nmt_diagnose.effects.library import candidates
from nmt_diagnose.ledger.size import large_lines
from nmt_diagnose.observations.observables import Part
from nmt_diagnose.observations.read_observations import read_observations
from nmt_diagnose.prediction.forward import Forward
from nmt_diagnose.prediction.influence import Source
from nmt_diagnose.prediction.operating_range import operating_range
from nmt_signals.channel_faults.mains_lines import mains_line

RATE = 2000.0


def window(
    seed: int, seconds: float, hum: float = 0.0, hz: float = 50.0, frequency: float = 21.0
) -> tuple[FloatArray, FloatArray]:
    """Phase and two channels: three orders of a frequency that wanders, noise of 1, and a line in the second."""
    generator = np.random.default_rng(seed)
    time = np.arange(round(seconds * RATE)) / RATE
    cycles = frequency * (time + 1e-4 * np.sin(3.0 * time))
    shape = 40.0 * np.cos(2.0 * np.pi * cycles) + 7.0 * np.cos(6.0 * np.pi * cycles + 1.0)
    data = np.stack((shape, 0.3 * shape)) + generator.standard_normal((2, time.size))
    data[1] += hum * np.cos(2.0 * np.pi * hz * time + seed)
    return cycles, data


def found(windows: list[tuple[FloatArray, FloatArray]], hz: float = 50.0) -> NDArray[np.float64]:
    """Amplitudes and standard uncertainties (2, windows, channels)."""
    lines = [mains_line(cycles, data, RATE, 5, hz) for cycles, data in windows]
    return np.array([[line.amplitudes for line in lines if line], [line.std for line in lines if line]])


@pytest.mark.court(not_said="hum")
@pytest.mark.parametrize("seconds", with_quick([2.0, 10.0], 2.0))
def test_windows_without_a_line_scatter_about_zero_as_stated(seconds: float) -> None:
    amplitudes, std = found([window(seed, seconds) for seed in range(40)])
    z = amplitudes / std
    assert z.shape == (40, 2)
    assert np.sqrt(np.mean(z**2)) == pytest.approx(1.0, abs=0.2)
    assert abs(z.mean()) < 0.25
    assert np.abs(z).max() < 4.5


@pytest.mark.court(said="hum")
@pytest.mark.parametrize("hz", [50.0, 60.0])
def test_a_line_of_any_phase_is_found_in_its_channel(hz: float) -> None:
    # A wandering mains: 0.04 Hz beside its nominal frequency.
    amplitudes, std = found([window(seed, 5.0, hum=0.3, hz=hz + 0.04) for seed in range(8)], hz)
    assert np.mean(amplitudes[:, 1]) == pytest.approx(0.3, rel=0.1)
    assert np.all(amplitudes[:, 1] > 5.0 * std[:, 1])
    assert np.all(amplitudes[:, 0] < 4.0 * std[:, 0])


@pytest.mark.court(not_said="hum")
def test_a_harmonic_at_the_mains_hides_it() -> None:
    cycles, data = window(1, 2.0, frequency=25.2)
    assert mains_line(cycles, data, RATE, 5, 50.0) is None
    assert mains_line(cycles, data, RATE, 5, 60.0) is not None


def test_a_humming_channel_of_a_bag_is_named_and_the_twin_knows_its_line(tmp_path: Path) -> None:
    model = rig_with_noise(noise=20.0, overrides=["local_elements=[]", "sample_rate_hz=10000"])
    index = next(k for k, sensor in enumerate(model.sensors) if model.sensor_channel(sensor) == "x4")
    sensors = list(model.sensors)
    sensors[index] = sensors[index].model_copy(update={"hum_amplitude": 2e-7, "hum_hz": 60.0})
    rig = model.model_copy(update={"sensors": sensors})
    observations = read_observations([record(tmp_path / "run", rig, levels=(0.1, 0.2, 0.4), periods=40)], model)
    rows, names = observations.rows, [channel.name for channel in observations.tests[0].channels]  # type: ignore[union-attr]
    line, own = rows.part == Part.LINE, rows.channel == names.index("x4")
    assert [note for note in observations.notes if "60 Hz" in note]
    assert sorted({float(hz) for hz in rows.frequency_hz[line & own]}) == [50.0, 60.0]
    # It is as large as a harmonic that matters where it is more than a thousandth of the median level's fundamental.
    middle = observations.tests[0].levels[1].fundamentals[names.index("x4")]  # type: ignore[union-attr]
    share = float(np.median(observations.values[line & own & (rows.frequency_hz == 60.0)])) / middle
    assert share == pytest.approx(2e-7 / middle, rel=0.1)
    assert (
        np.flatnonzero(large_lines(observations, 0.5 * share)).tolist()
        == np.flatnonzero(line & own & (rows.frequency_hz == 60.0)).tolist()
    )
    assert not large_lines(observations, 2.0 * share).any()
    # The other mains is observed where it is, and only there.
    assert set(rows.frequency_hz[line & ~own]) == {50.0}
    forward = Forward(observations.tests, rows)
    hum = {c.label: c for c in candidates(model, operating_range(model, observations.tests)) if "hum" in c.label}
    own_hum = hum["mains_hum@x4 at 60 Hz"]
    changed = own_hum.effect.apply(model, own_hum.site, {"amplitude": 2e-7})
    seen = line & own & (rows.frequency_hz == 60.0)
    values = forward.predict(changed).values
    assert np.all(np.abs(values - observations.values)[line] < 4.0 * observations.sigma[line])
    assert np.all(observations.values[seen] > 4.0 * observations.sigma[seen])
    # A source at another place does not touch the line, and none makes rows undefined.
    prediction = forward.predict(model)
    touched = {
        name: forward.influence(model, prediction, source)[0]
        for name, source in (
            ("x4", Source("response_sensor", channel="x4")),
            ("x2", Source("response_sensor", channel="x2")),
            ("point 4", Source("structure", 4)),
        )
    }
    assert all(np.isfinite(columns).all() for columns in touched.values())
    assert np.any(touched["x4"][seen])
    assert not np.any(touched["x2"][seen])
    assert not np.any(touched["point 4"][line])


def test_an_order_that_is_folded_onto_the_line_is_no_line() -> None:
    # The 50th order of 39 Hz, 1950 Hz, comes down to 50 Hz at 2000 samples a second.
    assert mains_line(*window(1, 10.0, frequency=39.0), RATE, 5, 50.0) is None
    assert mains_line(*window(1, 10.0, frequency=38.0), RATE, 5, 50.0) is not None
