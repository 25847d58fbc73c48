"""Noise of a measured force goes through the structure: what the linear test then states covers the truth."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import butter, sosfilt
from tiers import with_quick

from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import FloatArray
from nmt_extract.linear.identification import linear_test
from nmt_extract.linear.results import LinearTest, LinearTestSettings
from nmt_record.windows.segments import Signals

RATE = 1024.0
MASSES = np.array([1.2, 0.8])
STIFFNESS = np.array([[150e3, -90e3], [-90e3, 90e3]])
DAMPING = 0.8 * np.diag(MASSES) + 8e-6 * STIFFNESS
SQUARES, VECTORS = np.linalg.eigh(STIFFNESS / np.sqrt(np.outer(MASSES, MASSES)))
SHAPES = VECTORS / np.sqrt(MASSES)[:, np.newaxis]
OMEGA = np.sqrt(SQUARES)
RATIOS = 0.4 / OMEGA + 4e-6 * OMEGA


def hits(seconds: float) -> FloatArray:
    """A hit of 50 N every 8 s."""
    force = np.zeros(round(seconds * RATE))
    for start in np.arange(1.0, seconds - 4.0, 8.0):
        first = round(start * RATE)
        force[first : first + 8] = 50.0 * np.sin(np.pi * np.arange(8) / 8) ** 2
    return force


def shaken(seconds: float, seed: int) -> FloatArray:
    """Random force."""
    noise = np.random.default_rng(seed).normal(size=round(seconds * RATE))
    return np.asarray(sosfilt(butter(4, 0.5, output="sos"), noise))


def answer(force: FloatArray) -> FloatArray:
    """Accelerations of both masses to a force on the second, from rest, shape ``(2, samples)``."""
    size = 2 * force.size  # silence behind it: nothing comes round
    omega = 2 * np.pi * np.fft.rfftfreq(size, 1 / RATE)
    dynamic = STIFFNESS - np.multiply.outer(omega**2, np.diag(MASSES)) + 1j * np.multiply.outer(omega, DAMPING)
    motion = np.linalg.solve(dynamic, np.array([0.0, 1.0])[:, np.newaxis])[:, :, 0]
    spectrum = -(omega[:, np.newaxis] ** 2) * motion * np.fft.rfft(force, size)[:, np.newaxis]
    spectrum[-1] = 0.0
    return np.fft.irfft(spectrum, size, axis=0)[: force.size].T


def evaluated(force: FloatArray, force_noise: float, response_noise: float, seed: int) -> LinearTest:
    rng = np.random.default_rng(seed)
    moved = answer(force)
    channels = {
        "f2": force + force_noise * rng.normal(size=force.size),
        **{f"a{p}": moved[p - 1] + response_noise * rng.normal(size=force.size) for p in (1, 2)},
    }
    kinds = {"f2": Quantity.FORCE, "a1": Quantity.ACCELERATION, "a2": Quantity.ACCELERATION}
    signals = Signals(RATE, 0, channels, {}, {"f2": 2, "a1": 1, "a2": 2}, kinds, None, (), 0)
    return linear_test(signals, LinearTestSettings((2,), Quantity.ACCELERATION, (10.0, 120.0)))


def scores(test: LinearTest) -> FloatArray:
    """Errors over stated standard uncertainties: frequency, damping, shape at the drive point; of both modes."""
    return np.array(
        [
            [
                (mode.omega - OMEGA[r]) / (2 * np.pi * mode.frequency_std),
                (mode.damping_ratio - RATIOS[r]) / mode.damping_std,
                (abs(mode.drive_shape) - abs(SHAPES[1, r])) / mode.drive_shape_std,
            ]
            for r, mode in enumerate(test.modes)
        ]
    )


@pytest.mark.parametrize(
    ("drive", "force_noise", "response_noise"),
    with_quick(
        [("hits", 0.05, 0.02), ("hits", 0.0, 0.02), ("shaken", 0.02, 0.02), ("shaken", 0.0, 0.05)],
        ("hits", 0.05, 0.02),
        ("shaken", 0.02, 0.02),
    ),
)
def test_stated_uncertainties_cover(drive: str, force_noise: float, response_noise: float) -> None:
    found = []
    for seed in range(8):
        force = hits(44.0) if drive == "hits" else shaken(88.0, 100 + seed)
        found.append(scores(evaluated(force, force_noise, response_noise, seed)))
    scatter = np.sqrt(np.mean(np.square(found), axis=(0, 1)))
    assert np.all(scatter < 1.5)
    assert np.all(scatter > 0.4)
    assert np.abs(found).max() < 3.5
