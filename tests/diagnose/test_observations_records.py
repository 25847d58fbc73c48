"""Records and reduced tables as observations, through the import of other people's data."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from diagnose.oscillator_records import NATURAL_HZ, OMEGA, RATE, RATIO, RIG, band_noise, imported, rig_in
from scipy.signal import TransferFunction, cont2discrete, lfilter, lsim
from tiers import with_quick

from nmt_core.errors import BenchError
from nmt_core.numerics.arrays import FloatArray
from nmt_diagnose.diagnose import diagnose_bags
from nmt_diagnose.diagnosis_settings import DiagnosisSettings
from nmt_diagnose.ledger.diagnosis import Verdict
from nmt_diagnose.measurements.backbone_table import BackboneTable
from nmt_diagnose.measurements.driven_record import DrivenRecord, independent_values, spread_samples, white_noise
from nmt_diagnose.measurements.measurement import Observations
from nmt_diagnose.measurements.random_reading import noise_of_weak_lines
from nmt_diagnose.measurements.random_responses import RandomResponses
from nmt_diagnose.observations.observables import Part
from nmt_diagnose.observations.read_observations import read_observations
from nmt_record.exchange.imports.imported_run import read_import, write_import
from nmt_signals.band_limited import finer


def simulated(test: DrivenRecord, stiffness: float, damping: float, gain: float) -> FloatArray:
    """Response of one degree of freedom to a record's input, straight between its samples."""
    return oscillator(test.input, test.sample_rate, stiffness, damping, gain)


def oscillator(samples: FloatArray, rate: float, stiffness: float, damping: float, gain: float) -> FloatArray:
    top, bottom, _ = cont2discrete(([gain], [1.0, damping, stiffness]), 1.0 / rate, "foh")
    return np.asarray(lfilter(top[0], bottom, samples))


def predicted(observations: Observations, number: int, response: FloatArray) -> FloatArray:
    test = observations.tests[number]
    assert isinstance(test, DrivenRecord)
    mine = observations.rows.test == number
    index = np.round((observations.rows.time_s[mine] - test.start_s) * test.sample_rate).astype(int)
    return response[index]


def test_a_linear_record_leaves_the_noise(tmp_path: Path) -> None:
    rig = rig_in(tmp_path)
    u = band_noise(20_000, 1, 0.02)
    # Sixteen times finer in time, so that the truth does not depend on how samples are joined.
    fine = np.fft.irfft(np.fft.rfft(u), 16 * u.size) * 16.0
    response = oscillator(fine, 16.0 * RATE, OMEGA**2, 2.0 * RATIO * OMEGA, OMEGA**2)
    noise = 2e-3
    y = response[::16] + noise * np.random.default_rng(2).standard_normal(u.size)
    observations = read_observations([imported(tmp_path, u, y, [(0, 20_000)])], rig)
    test = observations.tests[0]
    assert isinstance(test, DrivenRecord)
    assert (observations.rows.part == Part.SAMPLE).all()
    assert observations.std[0] == pytest.approx(noise, rel=0.1)
    assert observations.floor[0] == pytest.approx(0.01 * y.std(), rel=0.02)
    # The noise of each sample is its own: as many rows as the motion has independent values, not decays of its mode.
    assert len(observations.rows) == pytest.approx(min(independent_values(y, RATE), 4000), rel=0.01)
    difference = observations.values - predicted(
        observations, 0, simulated(test, OMEGA**2, 2.0 * RATIO * OMEGA, OMEGA**2)
    )
    assert np.sqrt(np.mean((difference / observations.std) ** 2)) == pytest.approx(1.0, abs=0.1)
    levels = observations.rows.level
    assert (np.diff(levels) >= 0).all()
    bounds = test.segment_bounds / test.sample_rate + test.start_s
    assert ((observations.rows.time_s >= bounds[levels]) & (observations.rows.time_s < bounds[levels + 1])).all()


@pytest.mark.parametrize("first", [0, 5000])
def test_samples_begin_with_a_record_unless_that_begins_in_motion(tmp_path: Path, first: int) -> None:
    """A record from rest has no initial state that is unknown; one cut in mid-motion loses its first decay times."""
    u = np.concatenate([np.zeros(20), band_noise(20_000, 1, 0.02)])
    y = oscillator(u, RATE, OMEGA**2, 2.0 * RATIO * OMEGA, OMEGA**2)
    y = y + 1e-4 * y.std() * np.random.default_rng(2).standard_normal(u.size)
    observations = read_observations([imported(tmp_path, u, y, [(first, u.size)])], rig_in(tmp_path))
    earliest = observations.rows.time_s.min() - first / RATE
    decay_s = 1.0 / (RATIO * OMEGA)
    assert earliest < decay_s if first == 0 else earliest > 3.0 * decay_s


def test_a_constant_input_is_no_record(tmp_path: Path) -> None:
    rig = rig_in(tmp_path)
    y = np.random.default_rng(1).standard_normal(4000)
    y[100] = np.nan
    with pytest.raises(BenchError, match=r"NaN"):
        read_observations([imported(tmp_path, band_noise(4000, 1, 0.1), y, [(0, 4000)])], rig)


def test_interpolation_is_exact_in_its_band() -> None:
    time = np.arange(2000) / 500.0
    fine = np.arange(8000) / 2000.0

    def signal(t: FloatArray) -> FloatArray:
        return np.asarray(np.sin(2 * np.pi * 60.0 * t + 0.3) + 0.5 * np.cos(2 * np.pi * 110.0 * t) + 0.2)

    result = finer(signal(time), 4, padding=400)
    np.testing.assert_allclose(result[::4], signal(time), atol=1e-9)
    assert np.abs(result - signal(fine))[800:-800].max() < 2e-3
    assert finer(signal(time), 1) is not result


def test_samples_are_spread_and_different() -> None:
    indices = spread_samples(100, 10_000, 500)
    assert indices.size == 500
    assert (np.diff(indices) > 0).all()
    assert indices[0] >= 100
    assert indices[-1] < 10_000
    # In step with no period: every phase of it is met.
    for period in (7, 16, 20, 64):
        counts = np.bincount(indices % period, minlength=period)
        assert counts.min() > 0.4 * counts.mean()
    np.testing.assert_array_equal(spread_samples(3, 6, 10), [3, 4, 5])


def test_noise_is_found_under_a_signal() -> None:
    generator = np.random.default_rng(5)
    signal = np.sin(2 * np.pi * 0.05 * np.arange(40_000)) * (1.0 + 0.3 * np.sin(0.001 * np.arange(40_000)))
    assert white_noise(signal + 0.01 * generator.standard_normal(40_000), 1.0) == pytest.approx(0.01, rel=0.15)


def table(folder: Path, kind: str, text: str, extra: str = "") -> Path:
    (folder / "table.csv").write_text(text, encoding="utf-8")
    unit = "mm" if kind == "backbone" else "m/N"
    (folder / "sidecar.yaml").write_text(
        "rig: oscillator\nfile: table.csv\nsegments:\n"
        f"  - {{kind: {kind}, unit: {unit}, point: 1, drive_point: 1{extra}}}\n",
        encoding="utf-8",
    )
    return write_import(read_import(folder / "sidecar.yaml"), folder / "bag", "oscillator", RIG, {})


def test_backbone_table(tmp_path: Path) -> None:
    bag = table(
        tmp_path,
        "backbone",
        "frequency_hz,amplitude,damping_ratio,damping_ratio_std\n68.6,1,0.047,0.001\n68.9,2,0.048,\n70.1,4,,\n",
    )
    observations = read_observations([bag], rig_in(tmp_path))
    test = observations.tests[0]
    assert isinstance(test, BackboneTable)
    assert test.amplitudes == pytest.approx([1e-3, 2e-3, 4e-3])
    frequency = observations.rows.part == Part.LOG_FREQUENCY
    assert np.exp(observations.values[frequency]) / (2 * np.pi) == pytest.approx([68.6, 68.9, 70.1])
    assert observations.values[~frequency] == pytest.approx([0.047, 0.048])
    assert observations.std[~frequency] == pytest.approx([0.001, 0.0])
    assert observations.floor[~frequency][1] == pytest.approx(0.05 * 0.048)


def test_frequency_response_table(tmp_path: Path) -> None:
    frequency = np.linspace(20.0, 120.0, 400)
    response = 1.0 / (OMEGA**2 - (2 * np.pi * frequency) ** 2 + 2j * RATIO * OMEGA * 2 * np.pi * frequency)
    lines = "".join(f"{f},{h.real},{h.imag}\n" for f, h in zip(frequency, response, strict=True))
    bag = table(tmp_path, "frf", "frequency_hz,real,imag\n" + lines)
    observations = read_observations([bag], rig_in(tmp_path))
    test = observations.tests[0]
    assert isinstance(test, RandomResponses)
    assert (test.reference, test.window, test.drive_rms) == ("force", "none", 0.0)
    assert test.lines_hz.size <= 160
    picked = np.interp(test.lines_hz, frequency, np.log(np.abs(response)))
    assert observations.values[observations.rows.part == Part.LOG_MAGNITUDE] == pytest.approx(picked)
    near = np.sum(np.abs(test.lines_hz - NATURAL_HZ) < 3.0) / 6.0
    assert near > 2.0 * np.sum(test.lines_hz > 100.0) / 20.0
    assert any("no uncertainties" in note for note in observations.notes)


@pytest.mark.parametrize("noise", [0.0, 1e-7, 1e-6])
def test_noise_is_read_off_weak_lines(noise: float) -> None:
    """Receptances from 2e-6 m/N to a peak of 1e-4; about the antiresonance they go smoothly through zero."""
    frequency = np.linspace(20.0, 220.0, 401)
    omega = 2.0 * np.pi * frequency
    response = sum(
        1.0 / ((2 * np.pi * f) ** 2 - omega**2 + 4j * np.pi * f * 0.005 * omega) for f in (NATURAL_HZ, 2.5 * NATURAL_HZ)
    )
    random = np.random.default_rng(5)
    scattered = response + noise * (random.standard_normal(401) + 1j * random.standard_normal(401))
    assert noise_of_weak_lines(frequency, scattered) == pytest.approx(noise, rel=0.2, abs=2e-9)
    assert noise_of_weak_lines(frequency[:12], scattered[:12]) == 0.0


@pytest.mark.parametrize("scatter", [0.0, 3e-3, 1.2e-2])
def test_a_table_without_uncertainties_scatters_about_its_course(tmp_path: Path, scatter: float) -> None:
    amplitude = np.linspace(0.1, 3.0, 40)
    generator = np.random.default_rng(2)
    frequency = 68.6 * np.sqrt(1.0 + 0.5 * amplitude**2) * np.exp(scatter * generator.standard_normal(40))
    rows = "".join(f"{f!r},{a!r}\n" for f, a in zip(frequency.tolist(), amplitude.tolist(), strict=True))
    bag = table(tmp_path, "backbone", "frequency_hz,amplitude\n" + rows)
    observations = read_observations([bag], rig_in(tmp_path))
    # Of a smooth course nothing is left but what tables of others are trusted to.
    assert observations.sigma == pytest.approx(np.full(40, max(scatter, 1e-3)), rel=0.25)
    assert any("no uncertainties are given" in note for note in observations.notes)


def test_a_damping_of_nothing_is_known_to_a_share_of_the_models(tmp_path: Path) -> None:
    """A limit cycle has none: what its damping is known to is a share of that of the mode, 4.7 %."""
    bag = table(tmp_path, "backbone", "frequency_hz,amplitude,damping_ratio\n68.6,1,0\n68.7,2,0\n")
    observations = read_observations([bag], rig_in(tmp_path))
    damping = observations.rows.part == Part.DAMPING
    assert observations.values[damping] == pytest.approx([0.0, 0.0])
    assert observations.sigma[damping] == pytest.approx(np.full(2, 0.05 * RATIO), rel=1e-3)
    assert any("limit cycle" in note for note in observations.notes)


def test_one_bag_that_cannot_be_used_is_left_out(tmp_path: Path) -> None:
    folders = [tmp_path / name for name in ("good", "bad")]
    for folder in folders:
        folder.mkdir()
    good = table(folders[0], "backbone", "frequency_hz,amplitude\n68.6,1\n68.9,2\n")
    volts = band_noise(1000, 1, 0.1)
    np.savez(folders[1] / "data.npz", u=volts, f=volts**2)
    (folders[1] / "sidecar.yaml").write_text(
        f"rig: oscillator\nsample_rate: {RATE!r}\nfile: data.npz\nchannels:\n"
        "  - {column: u, quantity: voltage, unit: V}\n  - {column: f, quantity: force, unit: N, point: 1}\n"
        "segments:\n  - {kind: record, start: 0.0, stop: 1.5}\n",
        encoding="utf-8",
    )
    bad = write_import(read_import(folders[1] / "sidecar.yaml"), folders[1] / "bag", "oscillator", RIG, {})
    observations = read_observations([good, bad], rig_in(tmp_path))
    assert len(observations.rows) == 2
    (note,) = [note for note in observations.notes if "no response channel" in note]
    assert note.startswith("bad is left out: ")
    with pytest.raises(BenchError, match="no response channel"):
        read_observations([bad], rig_in(tmp_path))


def test_table_of_another_rig(tmp_path: Path) -> None:
    bag = table(tmp_path, "backbone", "frequency_hz,amplitude\n370.0,1\n369.0,2\n")
    with pytest.raises(BenchError, match="no mode of the model"):
        read_observations([bag], rig_in(tmp_path))


def test_silverbox(data_folder: Path, tmp_path: Path) -> None:
    """A linear model leaves 14 mV on the held-out arrow, a cubic spring 0.42 mV (README of the data)."""
    path = data_folder / "silverbox" / "SNLS80mV.csv"
    if not path.is_file():
        pytest.skip(f"the Silverbox data ({path}) is not on this machine")
    raw = np.genfromtxt(path, delimiter=",", skip_header=1, usecols=(0, 1))
    raw = raw[np.isfinite(raw).all(axis=1)]
    assert raw.shape == (131_072, 2)
    spans = [(0, 40_000), (40_580, 56_964), (57_500, 73_884)]
    observations = read_observations([imported(tmp_path, raw[:, 0], raw[:, 1], spans)], rig_in(tmp_path))
    arrow = observations.tests[0]
    assert isinstance(arrow, DrivenRecord)
    assert [test.name[-1] for test in observations.tests] == ["1", "2", "3"]
    # Values near those of the literature; no fit here.
    response = simulated(arrow, 1.908e5, 43.3, 1.886e5)
    mine = observations.rows.test == 0
    left = observations.values[mine] - predicted(observations, 0, response)
    left -= left.mean()  # zeros of input and output
    assert 1e3 * np.sqrt(np.mean(left**2)) == pytest.approx(14.0, abs=2.0)
    # The start of the arrow is small, so nearly linear.
    early = left[: left.size // 8]
    assert np.sqrt(np.mean(early**2)) < 0.25 * np.sqrt(np.mean(left**2))
    assert 0.3e-3 < observations.sigma[mine][0] < 0.8e-3


@pytest.mark.parametrize(("late_s", "gain"), with_quick([(0.0, 1.0), (150e-6, 1.02), (-300e-6, 0.98)], (150e-6, 1.02)))
def test_a_late_voltage_or_one_of_another_gain_is_the_measuring_chain(tmp_path: Path, late_s: float, gain: float):
    rng = np.random.default_rng(3)
    finer = 8
    time_s = np.arange(int(6.0 * RATE) * finer) / (RATE * finer)

    def swept(at: FloatArray) -> FloatArray:
        return np.asarray(0.1 * np.sin(2.0 * math.pi * (20.0 * at + 10.0 * at**2)))

    oscillator = TransferFunction([OMEGA**2], [1.0, 2.0 * RATIO * OMEGA, OMEGA**2])
    motion = lsim(oscillator, swept(time_s), time_s)[1][::finer]
    times = time_s[::finer]
    voltage = gain * swept(np.maximum(times - late_s, 0.0)) + 1e-5 * rng.standard_normal(times.size)
    bag = imported(tmp_path, voltage, motion + 1e-5 * rng.standard_normal(times.size), [(50, times.size - 50)])
    found = diagnose_bags(rig_in(tmp_path), [bag], settings=DiagnosisSettings(look_ahead=False)).diagnosis
    assert found.verdict in (Verdict.NONE, Verdict.CALIBRATION)
    assert found.features["feature:log_odds"] < 0.0
