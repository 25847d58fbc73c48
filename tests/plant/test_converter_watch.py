"""A converter's clock and delay are watched: what moves is said, what does not is not."""

from __future__ import annotations

import os

import numpy as np
import pytest

from nmt_plant.converters.converter_watch import ClockWatch, DelayWatch
from nmt_plant.real_time import LatenessHistogram, computer_settings, read_histogram

RATE, BLOCK = 10_000.0, 200


def clock_of(ppm, seconds=60.0, seed=1):
    """Reports that come late by chance, now and then by much."""
    watch = ClockWatch(RATE)
    random = np.random.default_rng(seed)
    for n in range(int(seconds * RATE / BLOCK)):
        late = random.exponential(1e-3) + (0.05 if random.random() < 0.02 else 0.0)
        watch.add(100.0 + n * BLOCK / (RATE * (1.0 + 1e-6 * ppm)) + late, n * BLOCK)
    return watch


@pytest.mark.parametrize("ppm", [50.0, -50.0, 400.0])
def test_a_clock_that_is_off_is_found_and_said(ppm):
    watch = clock_of(ppm)
    assert watch.ppm == pytest.approx(ppm, abs=10.0)
    assert f"ppm {'fast' if ppm > 0 else 'slow'}" in watch.sentence


@pytest.mark.parametrize("seed", range(5))
def test_a_good_clock_is_not_accused_although_reports_come_late(seed):
    assert clock_of(0.0, seed=seed).sentence == ""


def test_a_short_time_says_nothing():
    assert np.isnan(clock_of(50.0, seconds=10.0).ppm)


def delays_of(ppm, delay=0.3, noise=1e-4, jump=0.0):
    watch = DelayWatch(RATE)
    random = np.random.default_rng(2)
    for n in range(20 * 50):
        at = np.arange(n * BLOCK, (n + 1) * BLOCK)
        late = delay + 1e-6 * ppm * at + (jump if n > 500 else 0.0)
        drive = np.cos(2 * np.pi * 22.0 * at / RATE)
        seen = 0.9 * np.cos(2 * np.pi * 22.0 * (at - late) / RATE) + noise * random.standard_normal(BLOCK)
        watch.add(drive, seen, 22.0)
    return watch


def test_two_clocks_are_found_by_the_delay_that_moves():
    watch = delays_of(50.0)
    assert watch.drift == pytest.approx(50e-6 * RATE * 19.5, rel=0.1)
    assert "differ by 50 ppm" in watch.sentence or "differ by 49 ppm" in watch.sentence


def test_a_jump_of_two_samples_is_found():
    assert delays_of(0.0, jump=2.0).drift == pytest.approx(2.0, abs=0.2)


def test_one_clock_is_not_accused():
    assert delays_of(0.0, noise=1e-3).sentence == ""


def test_another_frequency_begins_anew():
    watch = DelayWatch(RATE)
    for n in range(200):
        frequency, late = (22.0, 0.0) if n < 100 else (30.0, 5.0)
        at = np.arange(n * BLOCK, (n + 1) * BLOCK)
        watch.add(
            np.cos(2 * np.pi * frequency * at / RATE), np.cos(2 * np.pi * frequency * (at - late) / RATE), frequency
        )
    assert watch.sentence == ""


def test_what_of_the_computer_decides_about_real_time_is_told(tmp_path):
    assert "frequency governor not known" in computer_settings(tmp_path)
    for number, governor in enumerate(("powersave", "performance")):
        folder = tmp_path / f"cpu{number}" / "cpufreq"
        folder.mkdir(parents=True)
        (folder / "scaling_governor").write_text(f"{governor}\n")
    assert "frequency governor performance/powersave" in computer_settings(tmp_path)
    assert computer_settings(tmp_path).startswith(f"{len(os.sched_getaffinity(0))} core")


def test_a_histogram_of_lateness_is_read_as_it_was_written():
    histogram = LatenessHistogram(0.01)
    for late in (0.0, 0.0004, 0.0005, 0.003, 0.3):
        histogram.add(late)
    assert read_histogram(histogram.text) == [("< 0.5 ms", 2), ("< 1 ms", 1), ("< 5 ms", 1), ("later", 1)]
    assert read_histogram("") == []
