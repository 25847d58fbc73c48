"""The third laboratory against closed forms: a free beam's frequencies, a decay, phase resonance, a cubic spring."""

from __future__ import annotations

import math

import numpy as np
import pytest

from nmt_laboratories.laboratory_three import DRIVEN, KINDS, RATE, Run, draw_case, free_beam

LENGTH, HEIGHT = 1.0, 0.008
WAVE = math.sqrt(2.05e11 / 7850.0 * HEIGHT**2 / 12.0)


def test_the_sum_of_polynomials_has_the_frequencies_of_a_free_beam() -> None:
    beam = free_beam(LENGTH, HEIGHT, 1e-5, 0.0, 0.0)
    omega = np.sqrt(np.maximum(beam.omega2, 0.0))
    roots = [4.730040745, 7.853204624, 10.995607838]  # cos λ cosh λ = 1
    assert omega[:2] == pytest.approx(0.0, abs=1e-2)
    assert omega[2:5] == pytest.approx([root**2 / LENGTH**2 * WAVE for root in roots], rel=1e-6)
    assert beam.ratio(2) == pytest.approx(0.5e-5 * omega[2], rel=1e-6)
    mass = 7850.0 * 0.03 * HEIGHT * LENGTH
    assert beam.shapes[0, 2] ** 2 == pytest.approx(4.0 / mass, rel=1e-6)  # ends move twice the rms


def test_no_mode_that_a_recording_may_show_is_left_out() -> None:
    # What a model of the whole beam has beyond them is no flexibility that a spring of 3e4 N/m would feel.
    for seed in range(4):
        beam = draw_case(seed)["beam"]
        omega = np.sqrt(beam.omega2)
        assert omega[-1] > 0.8 * math.pi * RATE
        left_out = beam.shapes[:, -1].max() ** 2 / omega[-1] ** 2
        assert 3e4 * left_out < 2e-3


@pytest.mark.campaign
def test_a_mode_decays_by_its_damping() -> None:
    beam = free_beam(LENGTH, HEIGHT, 3e-5, 0.0, 500.0)
    run = Run(beam)
    run.state[2] = 1e-3
    omega, zeta = math.sqrt(beam.omega2[2]), beam.ratio(2)
    seconds = 20.0 * 2.0 * math.pi / omega
    run._run(seconds, np.zeros(0), np.zeros(0), np.zeros(3))
    amplitude = math.hypot(run.state[2], run.state[2 + beam.omega2.size] / omega)
    assert amplitude == pytest.approx(1e-3 * math.exp(-zeta * omega * seconds), rel=3e-3)


def test_at_resonance_force_and_velocity_are_in_phase_and_a_cubic_spring_raises_the_frequency() -> None:
    beam = free_beam(LENGTH, HEIGHT, 5e-5, 0.0, 500.0)
    omega, zeta, phi = math.sqrt(beam.omega2[2]), beam.ratio(2), beam.shapes[:, 2]
    amplitude = 1e-3 / abs(phi[0])
    force = 2.0 * zeta * omega**2 * amplitude / abs(phi[DRIVEN - 1])
    settle = round(6.0 / (2.0 * math.pi * zeta))
    linear, drive, responses = Run(beam).resonance(force, omega, settle, 20)

    def lead(frequency: float, drive: np.ndarray, responses: np.ndarray) -> float:
        count = round(20 * 2.0 * math.pi / frequency * RATE)
        line = np.exp(-1j * frequency * np.arange(count) / RATE)
        ratio = (responses[-count:, 2] @ line) / (drive[-count:] @ line)  # of the acceleration at the driven point
        return math.degrees(float(np.angle(ratio)))

    assert lead(linear, drive, responses) == pytest.approx(90.0, abs=0.6)
    assert linear == pytest.approx(omega, rel=2e-3)
    # Averaging: Δω/ω = 3/8 k φ⁴ q² / ω².
    stiffness = 8.0 * 0.01 * omega**2 / (3.0 * phi[0] ** 4 * amplitude**2)
    found, drive, responses = Run(beam, KINDS["cubic"], 1, (stiffness,)).resonance(force, omega, settle, 20)
    assert lead(found, drive, responses) == pytest.approx(90.0, abs=0.6)
    assert found / linear - 1.0 == pytest.approx(0.01, rel=0.1)
