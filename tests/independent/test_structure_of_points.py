"""The structure of several points: its witnesses, and where a diagnosis of its recordings finds a force."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from nmt_diagnose.ledger.diagnosis import Verdict
from nmt_laboratories.structure_of_points import Drawn, diagnosed, drawn, leaves_noise_only, responses


def linear() -> Drawn:
    return drawn("healthy", np.random.default_rng(7))


def test_linear_responses_are_those_of_the_modes() -> None:
    own = linear()
    lines = own.frequencies_hz[0] * np.array([0.95, 0.999, 1.0, 1.002, 1.1])
    omega = 2.0 * np.pi * lines[:, None, None]
    natural = 2.0 * np.pi * own.frequencies_hz
    modal = own.shapes * own.shapes[own.driven - 1]
    expected = (modal / (natural**2 - omega**2 + 2j * own.ratios * natural * omega)).sum(axis=2)
    assert responses(own, 1.0, lines) == pytest.approx(expected, rel=2e-3)


@pytest.mark.campaign
def test_a_cubic_spring_stiffens_the_mode_by_its_own_motion() -> None:
    """ω² = ω₁² + ¾ k₃ φ⁴ q² for a spring at a point with the shape φ, other modes far away."""
    own = linear()
    phi, omega = own.shapes[own.local - 1, 0], 2.0 * np.pi * own.frequencies_hz[0]
    amplitude = 1e-4
    cubic = 0.02 * omega**2 / (0.75 * phi**4 * amplitude**2)
    expected = own.frequencies_hz[0] * np.sqrt(1.02)
    force = amplitude * 2.0 * own.ratios[0] * omega**2 / abs(own.shapes[own.driven - 1, 0])
    stiff = replace(own, terms=np.array([cubic, 0.0, 0.0, 0.0, 1.0]))
    lines = np.linspace(0.97, 1.005, 71) * expected
    found = np.abs(responses(stiff, float(force), lines)[:, own.driven - 1])
    assert lines[np.argmax(found)] == pytest.approx(expected, rel=3e-3)


def test_a_slider_that_sticks_is_a_spring() -> None:
    own = drawn("slider", np.random.default_rng(8))
    frequencies, shapes = leaves_noise_only(own)
    assert frequencies[0] > own.frequencies_hz[0]
    stuck = replace(own, slider=(own.slider[0], 1e6 * own.slider[1]))
    lines = frequencies[0] * np.array([0.99, 1.0, 1.01])
    omega, natural = 2.0 * np.pi * lines[:, None, None], 2.0 * np.pi * frequencies
    modal = shapes * shapes[own.driven - 1]
    expected = (modal / (natural**2 - omega**2 + 2j * own.ratios * natural * omega)).sum(axis=2)
    assert responses(stuck, 1e-3, lines) == pytest.approx(expected, rel=0.03)


@pytest.mark.campaign
def test_a_structure_whose_shapes_are_known_to_a_hundredth_is_healthy(tmp_path: Path) -> None:
    found, _ = diagnosed(tmp_path, "healthy", 6, count=20)
    assert found.verdict in (Verdict.NONE, Verdict.CALIBRATION)


@pytest.mark.campaign
def test_a_damper_is_found_where_it_is(tmp_path: Path) -> None:
    found, own = diagnosed(tmp_path, "damping", 3, count=16)
    assert found.verdict is Verdict.EFFECT
    first = found.ranking[0]
    assert first.effect == "amplitude_damping"
    assert str(own.local) in first.detail.split()
