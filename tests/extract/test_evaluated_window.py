"""The uncertainty of a frequency at which a loop held a phase, against repetitions; one in table and diagnosis."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from diagnose.observation_bags import record, rig_with_noise

from nmt_diagnose.observations.observables import Part
from nmt_diagnose.observations.read_observations import read_observations
from nmt_extract.judgement.uncertainty import jackknife
from nmt_extract.modal.evaluated_window import EvaluatedWindow, resonance_std
from nmt_extract.offline import extract_bag

RATE, PERIODS, SETTLING = 12, 80, 60
DAMPING, GAIN, NOISE = 0.01, 0.3, 0.05


def held_window(seed: int) -> EvaluatedWindow:
    """Force and velocity of a resonance at 1 Hz, whose frequency a loop moves by the phase that it measures.

    The phase by which the velocity lags behind the force is that of the frequency, (f − 1)/δ; the loop measures it
    with noise, period by period.
    """
    random, frequency, start = np.random.default_rng(seed), 1.0, 0.0
    cycles, velocity = [], []
    for _ in range(SETTLING + PERIODS):
        phase = (frequency - 1.0) / DAMPING
        here = start + frequency * np.arange(RATE) / RATE
        moved = np.cos(2.0 * np.pi * here - phase) + NOISE * random.normal(size=RATE)
        measured = -float(np.angle(np.exp(-2j * np.pi * here) @ moved))
        cycles.append(here)
        velocity.append(moved)
        start += frequency
        frequency -= GAIN * DAMPING * measured
    known = np.concatenate(cycles[SETTLING:])
    data = np.stack((np.cos(2.0 * np.pi * known), np.concatenate(velocity[SETTLING:])))
    return EvaluatedWindow.of(known, start - known[0], data, RATE, 2, 10)


def test_the_uncertainty_of_a_held_frequency_is_its_scatter() -> None:
    """The model is solved at the measured phase: what remains is what that phase does not tell of the frequency."""
    remains, stated, by_phase = [], [], []
    for seed in range(150):
        window = held_window(seed)
        phases = np.angle(window.sets[:, 0, 1] * np.conj(window.sets[:, 1, 1]))
        frequency, std = float(window.frequencies_hz[0]), jackknife(phases[1:], float(phases[0]))
        remains.append(math.log(frequency) - DAMPING * phases[0])
        by_phase.append(DAMPING * std)
        stated.append(resonance_std(window.frequency_std() / frequency, DAMPING, std))
    scatter = float(np.std(remains, ddof=1))
    assert np.sqrt(np.mean(np.square(stated))) == pytest.approx(scatter, rel=0.2)
    assert np.sqrt(np.mean(np.square(by_phase))) < 0.8 * scatter


def test_table_and_diagnosis_state_one_uncertainty_of_a_frequency(tmp_path: Path) -> None:
    """The table counts the phase error that the loop left, too; the model of a diagnosis is solved at that phase."""
    rig = rig_with_noise(noise=1e4)
    folder = record(tmp_path / "run", rig, levels=(0.1, 0.3), periods=60)
    observations = read_observations([folder], rig)
    rows = observations.rows
    stds = observations.std[rows.part == Part.LOG_FREQUENCY]
    points = extract_bag(folder).points
    assert len(points) == stds.size == 2
    for point, std in zip(points, stds, strict=True):
        table = point.frequency_hz_std / point.frequency_hz
        assert table == pytest.approx(math.hypot(std, point.damping_ratio * point.phase_error), rel=0.02)
        assert std > 1e-6
