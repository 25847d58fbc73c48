"""Motion and unknown force of a chain under two forces, against an integration that shares no code."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

from nmt_core.messages.blocks import Quantity
from nmt_diagnose.law.driven_plant import DrivenPlant, unknown_motion
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.prediction.prediction_settings import PredictionSettings
from nmt_diagnose.prediction.rig_parts import rig_parts
from nmt_rig.model.fourier_basis import FourierBasis
from nmt_rig.rig import validate_rig
from nmt_rig.rig_file import RigDocument

RATE, SAMPLES, NOISE = 1000.0, 6000, 2e-6
MASSES, SPRING, GROUND, LOSS = (1.0, 1.2), 9e3, 4e3, 2e-4
RIG = validate_rig(RigDocument("test", {
    "name": "two_masses",
    "structure": {
        "kind": "chain", "masses_kg": [*MASSES], "springs_n_m": [SPRING], "ground_springs_n_m": [GROUND, 0.0],
        "dampers_ns_m": [LOSS * SPRING], "ground_dampers_ns_m": [LOSS * GROUND, 0.0],
    },
    "exciter": {"kind": "force", "point": 1},
    "sensors": [
        {"quantity": "force", "point": "drive"},
        {"quantity": "displacement", "point": 1}, {"quantity": "displacement", "point": 2},
    ],
    "extraction": {"linear_modes": 2},
}, {}))  # fmt: skip


def plant() -> DrivenPlant:
    channels = [MeasuredChannel(f"x{point}", Quantity.DISPLACEMENT, point) for point in (1, 2)]
    settings = PredictionSettings()
    parts = rig_parts(RIG, channels, FourierBasis.up_to(1), settings, ideal_force=True)
    return DrivenPlant.of(parts, [(1, 0), (2, 0)], np.arange(2), RATE, 1, settings)


def integrated(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Displacements and velocities (4, n) of both masses from rest under forces that are linear between samples."""
    stiffness = np.array([[GROUND + SPRING, -SPRING], [-SPRING, SPRING]])
    inverse = np.diag(1.0 / np.array(MASSES))
    a = np.block([[np.zeros((2, 2)), np.eye(2)], [-inverse @ stiffness, -LOSS * inverse @ stiffness]])
    b = np.vstack((np.zeros((2, 2)), inverse))
    turn, drive, out, through, _ = cont2discrete((a, b, np.eye(4), np.zeros((4, 2))), 1.0 / RATE, "foh")
    poles, shapes = np.linalg.eig(turn)
    drives = np.linalg.solve(shapes, drive) @ np.array([first, second])
    states = [lfilter([0.0, 1.0], [1.0, -pole], row) for pole, row in zip(poles, drives, strict=True)]
    return np.real(out @ shapes @ np.array(states)) + through @ np.array([first, second])


def forces() -> tuple[np.ndarray, np.ndarray]:
    """A measured force at the first mass, N, and a slower one at the second that no channel measures."""
    random = np.random.default_rng(4)
    measured = 3.0 * np.convolve(random.standard_normal(SAMPLES), np.ones(8) / 8.0, "same")
    seconds = np.arange(SAMPLES) / RATE
    unknown = 1.5 * np.sin(2.0 * np.pi * 7.0 * seconds) * np.sin(np.pi * seconds / seconds[-1])
    measured[0] = 0.0
    return measured, unknown


def test_the_answer_to_a_force_is_that_of_another_integration() -> None:
    model, (measured, unknown) = plant(), forces()
    places = model.parts.coordinates + np.arange(2)
    drives = (model.coordinates, (measured, 0.0 * unknown)), (places[1], (0.0 * measured, unknown))
    for number, (first, second) in drives:
        expected, speeds = np.split(integrated(first, second), 2)
        found = model.answer(number, first + second, np.arange(SAMPLES))
        np.testing.assert_allclose(found, expected, atol=1e-6 * np.abs(expected).max())
        x, v, _ = model.motion_under(number, first + second)
        np.testing.assert_allclose(x[places], expected, atol=1e-6 * np.abs(expected).max())
        np.testing.assert_allclose(v[places], speeds, atol=1e-6 * np.abs(speeds).max())


def test_an_unknown_force_and_its_motion_lie_within_their_uncertainties() -> None:
    model, (measured, unknown) = plant(), forces()
    place = model.parts.coordinates + 1
    noise = NOISE * np.random.default_rng(5).standard_normal((2, SAMPLES))
    left = integrated(measured, unknown)[:2] + noise - model.answer(model.coordinates, measured, np.arange(SAMPLES))
    found = unknown_motion(model, [place], left, np.full(2, NOISE), float(np.std(measured)), 5.0)
    added = integrated(0.0 * measured, unknown)
    inside = slice(200, -200)
    errors = (found.x[place] - added[1])[inside]
    assert np.std(errors) == pytest.approx(found.x_std, rel=0.3)
    assert found.x_std < 0.6 * NOISE
    assert np.std((found.force - unknown)[inside]) < 2.0 * found.force_std < 0.4 * np.std(unknown)
