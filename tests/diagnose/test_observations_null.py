"""A rig that is its own model: observables of the time-domain plant against the prediction whiten to one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from diagnose.observation_bags import record, rig_with_noise

from nmt_core.numerics.arrays import FloatArray
from nmt_core.vocabulary import TestKind
from nmt_diagnose.measurements.measurement import Observations
from nmt_diagnose.observations.observables import Part
from nmt_diagnose.observations.read_observations import notes_together, read_observations
from nmt_diagnose.prediction.forward import Forward
from nmt_diagnose.prediction.prediction_settings import PredictionSettings
from nmt_rig.rig import Rig

# The prediction refines the mesh at least twice; so does the plant here.
MESH = ["structure.mesh_refinement=2"]
ORDERS = 15


def whitened(observations: Observations, rig: Rig) -> FloatArray:
    values = Forward(observations.tests, observations.rows, PredictionSettings(harmonics=ORDERS)).predict(rig).values
    difference = observations.values - values
    angles = np.isin(observations.rows.part, (Part.PHASE, Part.PHASE_ERROR))
    difference[angles] = (difference[angles] + np.pi) % (2.0 * np.pi) - np.pi
    return np.asarray(difference / observations.sigma)


@pytest.mark.parametrize("noise", [30.0])
def test_locked_windows_of_a_slipping_joint(tmp_path: Path, noise: float) -> None:
    rig = rig_with_noise(noise=noise, overrides=MESH)
    observations = read_observations([record(tmp_path / "run", rig, periods=60)], rig)
    z = whitened(observations, rig)
    assert np.isfinite(z).all()
    # Harmonics are as far off as stated; the others no further.
    harmonics = np.isin(observations.rows.part, (Part.REAL, Part.IMAG))
    assert 0.8 < np.sqrt(np.mean(z[harmonics] ** 2)) < 1.2
    assert np.sqrt(np.mean(z**2)) < 1.15
    assert np.abs(z).max() < 6.0


def test_random_test_of_a_sticking_joint(tmp_path: Path) -> None:
    rig = rig_with_noise(noise=5.0, overrides=MESH)
    observations = read_observations([record(tmp_path / "run", rig, TestKind.RANDOM, (0.05,), duration=10.0)], rig)
    z = whitened(observations, rig)
    assert z.size > 400
    assert np.sqrt(np.mean(z**2)) == pytest.approx(1.0, abs=0.1)


def test_notes_that_differ_by_the_recording_alone_are_one() -> None:
    notes = ("a: recorded on rig 'x'", "b: recorded on rig 'x'", "a: recorded on rig 'x'", "b: 2 levels", "No name")
    assert notes_together(notes) == ("a, b: recorded on rig 'x'", "b: 2 levels", "No name")
