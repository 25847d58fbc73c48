"""The linear test judges its channels: what no passive structure does is a sentence, what one does is none."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from tiers import with_quick

from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import FloatArray
from nmt_core.threshold import thresholds_of
from nmt_extract.judgement.thresholds import THRESHOLDS
from nmt_extract.linear.identification import linear_test
from nmt_extract.linear.results import LinearTest, LinearTestSettings
from nmt_record.windows.segments import Signals

RATE, SECONDS = 512.0, 64.0
BAND = (5.0, 120.0)
SAMPLES = round(RATE * SECONDS)


class Structure:
    """A chain of masses between two walls.

    Attributes:
        mass, damping, stiffness: matrices, kg, N s/m, N/m.
    """

    def __init__(self, masses: FloatArray, springs: FloatArray, dampers: FloatArray) -> None:
        self.mass = np.diag(masses)
        self.stiffness, self.damping = chain(springs), chain(dampers)
        squares, vectors = np.linalg.eigh(self.stiffness / np.sqrt(np.outer(masses, masses)))
        self.frequency_hz = np.sqrt(squares) / (2 * np.pi)
        self.shapes = vectors / np.sqrt(masses)[:, np.newaxis]

    def answer(self, forces: dict[int, FloatArray]) -> FloatArray:
        """Accelerations to forces on points, periodic, shape ``(points, samples)``."""
        omega = 2 * np.pi * np.fft.rfftfreq(SAMPLES, 1 / RATE)
        dynamic = self.stiffness - np.multiply.outer(omega**2, self.mass) + 1j * np.multiply.outer(omega, self.damping)
        load = np.zeros((omega.size, len(self.mass), 1), dtype=np.complex128)
        for point, force in forces.items():
            load[:, point - 1, 0] = np.fft.rfft(force)
        motion = np.linalg.solve(dynamic, load)[:, :, 0]
        return np.fft.irfft(-(omega[:, np.newaxis] ** 2) * motion, SAMPLES, axis=0).T


def chain(values: FloatArray) -> FloatArray:
    """Matrix of springs or dampers from wall to wall."""
    return np.diag(values[:-1] + values[1:]) - np.diag(values[1:-1], 1) - np.diag(values[1:-1], -1)


def two_masses() -> Structure:
    return Structure(np.array([1.2, 0.8]), np.array([60e3, 90e3, 0.0]), np.array([2.0, 1.0, 1.0]))


def any_structure(seed: int) -> Structure:
    """Three masses with dampers that follow no spring."""
    rng = np.random.default_rng(seed)
    springs = rng.uniform(2e4, 9e4, 4)
    return Structure(rng.uniform(0.5, 2.0, 3), springs, rng.uniform(0.2, 30.0, 4) * rng.integers(0, 2, 4) + 1.0)


def record(
    structure: Structure, seed: int, points: tuple[int, ...] = (2,), noise: float = 0.01
) -> dict[str, FloatArray]:
    rng = np.random.default_rng(seed)
    omega = np.fft.rfftfreq(SAMPLES, 1 / RATE)
    forces = {}
    for point in points:
        spectrum = np.fft.rfft(rng.normal(size=SAMPLES)) / (1 + (omega / 200.0) ** 8)
        forces[point] = np.fft.irfft(spectrum, SAMPLES)
    moved = structure.answer(forces)
    channels = {f"f{point}": force for point, force in forces.items()}
    channels.update({f"a{row + 1}": values for row, values in enumerate(moved)})
    return {name: values + noise * values.std() * rng.normal(size=SAMPLES) for name, values in channels.items()}


def evaluated(channels: dict[str, FloatArray], **asked: Any) -> LinearTest:
    points = {name: int(name[1:]) for name in channels}
    kinds = {name: Quantity.FORCE if name[0] == "f" else Quantity.ACCELERATION for name in channels}
    signals = Signals(RATE, 0, channels, {}, points, kinds, None, (), 0)
    exciters = tuple(points[name] for name in channels if name[0] == "f")
    return linear_test(signals, LinearTestSettings(exciters, Quantity.ACCELERATION, BAND, **asked))


def findings(test: LinearTest) -> list[str]:
    return [remark for remark in test.remarks if remark.startswith("Channel")]


def filtered(values: FloatArray, factor: Any) -> FloatArray:
    """Values through a frequency response of f in Hz."""
    frequency = np.fft.rfftfreq(values.size, 1 / RATE)
    frequency[0] = 1e-9
    return np.fft.irfft(np.fft.rfft(values) * factor(frequency), values.size)


def late(seconds: float) -> Any:
    return lambda f: np.exp(-2j * np.pi * f * seconds)


def high_pass(corner: float) -> Any:
    return lambda f: (1j * f / corner) / (1 + 1j * f / corner)


def low_pass(corner: float) -> Any:
    return lambda f: 1 / (1 + 1j * f / corner)


@pytest.mark.court(said="linear")
@pytest.mark.parametrize("seed", with_quick(range(10), 0))
def test_a_healthy_record_has_no_finding(seed: int) -> None:
    structure = any_structure(seed)
    points = (2,) if seed % 2 else (1, 3)
    test = evaluated(record(structure, seed, points), modes=3)
    assert findings(test) == []


@pytest.mark.court(not_said="linear")
@pytest.mark.parametrize(
    ("channel", "fault", "sentence"),
    [
        ("f2", late(0.002), r"Channels f2 and a2 .*f2 is late by (1\.9|2|2\.0)\d* ms \(delay_s: 0\.00(19|20|2)"),
        ("a2", late(0.002), r"Channels f2 and a2 .*a2 is late by (1\.9|2|2\.0)\d* ms \(delay_s: 0\.00(19|20|2)"),
        ("a1", late(0.002), r"Channel a1 is turned by -.*a2 at the drive point.*late by (1\.9|2|2\.0)\d* ms"),
        ("a2", high_pass(5.0), r"Channels f2 and a2 .*a2 passes a high pass \(AC coupling\) at (4\.9|5|5\.0)\d* Hz"),
        ("f2", high_pass(5.0), r"Channels f2 and a2 .*f2 passes a high pass \(AC coupling\) at (4\.9|5|5\.0)\d* Hz"),
        ("a1", high_pass(8.0), r"Channel a1 is turned by .*AC coupled at (7\.9|8|8\.0)\d* Hz"),
        ("a2", low_pass(150.0), r"Channels f2 and a2 .*a2 passes a low pass at 1[45]\d Hz"),
    ],
)  # fmt: skip
def test_what_no_passive_structure_does_is_named(channel: str, fault: Any, sentence: str) -> None:
    structure = two_masses()
    channels = record(structure, 1)
    channels[channel] = filtered(channels[channel], fault)
    test = evaluated(channels)
    found = findings(test)
    assert len(found) == 1
    assert re.search(sentence, found[0]), found[0]
    # Frequency and damping are right, and the stated uncertainty of the shapes covers what the fault did to them.
    for mode in test.modes:
        number = int(np.argmin(np.abs(structure.frequency_hz - mode.frequency_hz)))
        true = np.abs(structure.shapes[:, number])
        assert mode.frequency_hz == pytest.approx(structure.frequency_hz[number], rel=2e-3)
        assert np.all(np.abs(np.abs(mode.shape) - true) < 2.5 * mode.shape_std + 2e-3 * true)
        assert abs(abs(mode.drive_shape) - true[1]) < 2.5 * mode.drive_shape_std + 2e-3 * true[1]


def test_hum_is_named() -> None:
    channels = record(two_masses(), 2)
    time = np.arange(SAMPLES) / RATE
    assert findings(evaluated(channels)) == []
    channels["a1"] = channels["a1"] + 0.1 * channels["a1"].std() * np.sin(2 * np.pi * 50.02 * time)
    (sentence,) = findings(evaluated(channels))
    assert sentence.startswith("Channel a1 has a line at 50 Hz that no force makes, about ")


def faulty(channel: str, fault: Any, noise: float = 0.001) -> dict[str, FloatArray]:
    channels = record(two_masses(), 3, noise=noise)
    return {**channels, channel: filtered(channels[channel], fault)}


def humming(share: float) -> dict[str, FloatArray]:
    channels = record(two_masses(), 3)
    time = np.arange(SAMPLES) / RATE
    return {**channels, "a1": channels["a1"] + share * channels["a1"].std() * np.sin(2 * np.pi * 50.02 * time)}


CASES: dict[str, tuple[Callable[[], dict[str, FloatArray]], float]] = {
    "active_phase_deg": (lambda: faulty("f2", late(4e-4)), 10.0),
    "active_share": (lambda: faulty("f2", late(2e-3)), 9.0),
    "deviations": (lambda: faulty("f2", late(5e-4), 0.02), 10.0),
    "phase_deg": (lambda: faulty("a1", late(1e-3)), 10.0),
    "strong_share": (lambda: faulty("a1", late(2e-3)), 10.0),
    "fewest_lines": (lambda: faulty("f2", late(2e-3)), 10000),
    "hum_ratio": (lambda: humming(0.1), 1e6),
    "hum_share": (lambda: humming(0.1), 200.0),
    "hum_resolution_hz": (lambda: humming(0.1), 0.05),
}
"""By threshold: a record in which a channel is named, and the factor with which it is not."""


@pytest.mark.parametrize("name", CASES)
def test_a_threshold_decides(name: str) -> None:
    make, factor = CASES[name]
    channels, value = make(), getattr(THRESHOLDS.linear, name)
    (sentence,) = findings(evaluated(channels))
    try:
        object.__setattr__(THRESHOLDS.linear, name, factor * value)
        # Where the force is not named the response beside it may be: it differs from the one at the drive point.
        assert all(found.split()[:2] != sentence.split()[:2] for found in findings(evaluated(channels)))
    finally:
        object.__setattr__(THRESHOLDS.linear, name, value)


def test_every_threshold_states_unit_and_reason_and_has_such_a_case() -> None:
    entries = {path.rpartition(".")[2]: entry for path, _, entry in thresholds_of(THRESHOLDS.linear)}
    assert entries.keys() == CASES.keys()
    for name, entry in entries.items():
        assert entry.metadata["unit"]
        assert entry.metadata["reason"].endswith(".")
        assert entry.metadata["test"].endswith(f"::test_a_threshold_decides[{name}]")
