"""Doubled and missing rows of imported data: found by the phase and by the rows, and not found where there are none."""

from __future__ import annotations

import numpy as np
import pytest
from record.foreign_data import RATE, recording, sidecar, write, write_csv

from nmt_core.errors import BenchError
from nmt_record.exchange.imports.imported_run import read_import
from nmt_record.exchange.judgement.row_continuity import doubled_blocks, phase_jump

OMEGA = 2 * np.pi * 21.7 / RATE


def sines(generator, samples=4000, noise=1e-3, drift=0.0, harmonic=0.1):
    """Three channels of one frequency that wanders by ``drift`` Hz, with a third harmonic."""
    walk = np.cumsum(generator.standard_normal(samples)) / np.sqrt(samples)
    phase = OMEGA * np.arange(samples) + 2 * np.pi * drift / RATE * np.cumsum(walk)
    return [
        size * (np.cos(phase + turn) + harmonic * np.cos(3 * phase)) + noise * generator.standard_normal(samples) + 0.3
        for size, turn in ((1.0, 0.0), (0.2, 1.0), (5.0, -1.5))
    ]


def with_rows(columns, row, count):
    """``count`` rows doubled before ``row``, or taken out from there on if negative."""
    if count > 0:
        return [np.concatenate((c[:row], c[row - count : row], c[row:])) for c in columns]
    return [np.concatenate((c[:row], c[row - count :])) for c in columns]


@pytest.mark.parametrize("count", [1, 2, 3, 7, 12, 25, 40, -1, -2, -9, -25])
def test_a_step_is_measured_in_rows_and_placed(count):
    generator = np.random.default_rng(abs(count))
    row = 1700
    jump = phase_jump(with_rows(sines(generator, drift=0.005), row, count), RATE)
    assert jump is not None
    assert jump.phase == pytest.approx(-count * OMEGA, rel=0.1, abs=0.02)
    assert jump.rows == pytest.approx(-count, rel=0.1, abs=0.4)
    assert abs(jump.sample - row) < RATE / 21.7


@pytest.mark.parametrize("seed", range(25))
def test_sound_data_have_no_step(seed):
    """Noise up to a tenth of the signal, a wandering frequency, strong harmonics, odd lengths."""
    generator = np.random.default_rng(seed)
    columns = sines(
        generator,
        samples=int(generator.integers(800, 20_000)),
        noise=10.0 ** generator.uniform(-6, -1),
        drift=generator.uniform(0.0, 0.05),
        harmonic=generator.uniform(0.0, 0.5),
    )
    assert phase_jump(columns, RATE) is None
    assert doubled_blocks(columns) == []


def test_a_step_of_one_sensor_is_not_one_of_the_rows():
    columns = sines(np.random.default_rng(5))
    columns[1][2000:] = -columns[1][2000:]
    assert phase_jump(columns, RATE) is None


def test_what_is_no_steady_sine_gives_no_answer():
    noise = [np.random.default_rng(6).standard_normal(3000) for _ in range(2)]
    assert phase_jump(noise, RATE) is None
    assert phase_jump([np.zeros(3000)], RATE) is None
    assert phase_jump([np.cos(OMEGA * np.arange(300))], RATE) is None  # three periods


def test_doubled_blocks_by_brute_force():
    generator = np.random.default_rng(7)
    for _ in range(40):
        columns = [generator.standard_normal(200) for _ in range(2)]
        size = int(generator.integers(2, 30))
        row = int(generator.integers(size, 200))
        assert doubled_blocks(with_rows(columns, row, size)) == [(row, size)]


def test_periodic_constant_and_coarse_signals_are_not_doubled():
    periodic = np.tile(np.random.default_rng(9).standard_normal(40), 20)
    assert doubled_blocks([periodic, periodic**2]) == []
    assert doubled_blocks([np.zeros(500), np.ones(500)]) == []
    time = np.arange(20_000)
    coarse = [np.round(100 * np.sin(OMEGA * time + turn)) for turn in (0.0, 1.0, 2.0)]
    assert doubled_blocks(coarse) == []
    assert doubled_blocks([np.array([1.0, 1.0, 2.0])]) == []


@pytest.mark.parametrize("count", [2, 3, 5, 9, 15, 25])
@pytest.mark.parametrize("start", [1500, 3400])
def test_a_csv_with_doubled_rows_in_a_window_is_refused(tmp_path, count, start):
    columns = with_rows(list(recording().values()), start, count)
    data = dict(zip(recording(), columns, strict=True))
    with pytest.raises(BenchError, match=rf"window of segment 1 .*the {count} rows from line {start + 2} of data\.csv"):
        read_import(write_csv(tmp_path, data))


@pytest.mark.parametrize("count", [-2, -13, 2, 13])
def test_rows_that_differ_by_rounding_are_found_by_the_phase(tmp_path, count):
    """A doubled block that was resampled or rounded otherwise is not an exact repetition."""
    columns = with_rows(list(recording(6.5).values()), 3000, count)
    if count > 0:
        generator = np.random.default_rng(8)
        columns = [column + 1e-9 * generator.standard_normal(column.size) for column in columns]
    with pytest.raises(
        BenchError, match=r"window of segment 1 .* the phase of the channels steps .* near sample \d+ of"
    ):
        read_import(write(tmp_path, sidecar(), dict(zip(recording(), columns, strict=True))))


def test_doubled_rows_outside_of_windows_are_noted(tmp_path):
    columns = with_rows(list(recording().values()), 500, 6)
    run = read_import(write(tmp_path, sidecar(), dict(zip(recording(), columns, strict=True))))
    assert any("Outside of the windows the 6 rows from sample 500" in note for note in run.notes)
