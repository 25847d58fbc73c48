"""The chain's motion is built backwards from a prescribed joint motion: every energy has a closed form."""

from __future__ import annotations

import math

import numpy as np
import pytest
from extract.synthetic import Stream, extract, linear_description, lock_event

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_extract.extraction_settings import ExtractionSettings
from nmt_extract.modal.hysteresis import HysteresisLayout, hysteresis_loop

OMEGA = 2.0 * math.pi * 370.0
M1, M2, M3 = 3.0, 1.2, 2.1
LEAF, JOINT = 4.0e6, 2.5e7
LAYOUT = HysteresisLayout(1, 2, 3, M1, M3)


def chain(relative: np.ndarray, joint_force: np.ndarray, leaf_damper: float = 0.0):
    """Accelerations, excitation force and stretch for given harmonics of x₃ − x₂ and of the joint force."""
    derivative = 1j * OMEGA * np.arange(relative.shape[0])
    square = np.where(derivative == 0.0, 1.0, derivative**2)
    x3 = -joint_force / (M3 * square)
    x2 = x3 - relative
    spring_force = joint_force - M2 * square * x2
    stretch = spring_force / (LEAF + leaf_damper * derivative)
    x1 = x2 - stretch
    force = M1 * square * x1 - spring_force
    return tuple(square * x for x in (x1, x2, x3)), force, stretch


def test_linear_joint_with_damper():
    """W = π d ω X², E = ½ k₁ X₁² + ½ k₂ X₂²."""
    damper = 150.0
    relative = np.array([0.0, 2e-6 * np.exp(0.4j)])
    accelerations, force, stretch = chain(relative, (JOINT + 1j * OMEGA * damper) * relative)
    loop = hysteresis_loop(LAYOUT, OMEGA, accelerations, force)
    work = math.pi * damper * OMEGA * 4e-12
    energy = 0.5 * JOINT * 4e-12 + 0.5 * LEAF * abs(stretch[1]) ** 2
    assert loop.dissipated_work == pytest.approx(work, rel=1e-9)
    assert loop.potential_energy == pytest.approx(energy, rel=1e-5)
    assert loop.damping_ratio == pytest.approx(work / (4.0 * math.pi * energy), rel=1e-5)


def test_single_degree_of_freedom_limit_gives_its_damping_ratio():
    """The leaf spring is not strained: joint and m₃ are an oscillator at resonance, δ_hyst = d/(2 m₃ ω₀)."""
    omega = math.sqrt(JOINT / M3)
    damper = 2.0 * 0.01 * M3 * omega
    relative = np.array([0.0, 1e-6])
    joint_force = (JOINT + 1j * omega * damper) * relative
    a3 = -joint_force / M3
    a2 = a3 + omega**2 * relative
    a1 = a2 * (1.0 - 1e-6)
    loop = hysteresis_loop(LAYOUT, omega, (a1, a2, a3), M1 * a1)
    assert loop.damping_ratio == pytest.approx(0.01, rel=1e-4)


def test_elastic_coulomb_joint():
    """W = 4 μN (X - μN/k_t), and the midline of the slipping element stores (μN)²/k_t."""
    stiffness, limit, amplitude = 2.0e7, 30.0, 6e-6
    samples = 1 << 14
    displacement = amplitude * np.cos(2.0 * np.pi * np.arange(samples) / samples)
    slider = displacement[0] - limit / stiffness
    friction = np.empty(samples)
    for _ in range(2):  # the first period is the transient
        for k in range(samples):
            slider = min(max(slider, displacement[k] - limit / stiffness), displacement[k] + limit / stiffness)
            friction[k] = stiffness * (displacement[k] - slider)
    harmonics = 200
    spectrum = np.fft.rfft(friction)[: harmonics + 1] * 2.0 / samples
    spectrum[0] = 0.0
    relative = np.zeros(harmonics + 1, dtype=complex)
    relative[1] = amplitude
    accelerations, force, stretch = chain(relative, JOINT * relative + spectrum)
    loop = hysteresis_loop(LAYOUT, OMEGA, accelerations, force)
    assert loop.dissipated_work == pytest.approx(4.0 * limit * (amplitude - limit / stiffness), rel=1e-5)
    angle = np.linspace(0.0, 2.0 * np.pi, 20001)
    orders = np.arange(harmonics + 1)
    stretched = (np.exp(1j * np.outer(angle, orders)) @ stretch).real.max()
    energy = 0.5 * JOINT * amplitude**2 + limit**2 / stiffness + 0.5 * LEAF * stretched**2
    assert loop.potential_energy == pytest.approx(energy, rel=1e-3)


def test_time_origin_does_not_matter():
    relative = np.array([0.0, 2e-6, 0.0, 1e-7])
    accelerations, force, _ = chain(relative, (JOINT + 4e5j) * relative)
    turned = np.exp(0.83j * np.arange(4))
    first = hysteresis_loop(LAYOUT, OMEGA, accelerations, force)
    second = hysteresis_loop(LAYOUT, OMEGA, tuple(a * turned for a in accelerations), force * turned)
    assert second.dissipated_work == pytest.approx(first.dissipated_work, rel=1e-12)
    assert second.damping_ratio == pytest.approx(first.damping_ratio, rel=1e-4)


def test_rigid_motion_is_refused():
    still = np.array([0.0, 1.0 + 0.0j])
    with pytest.raises(BenchError, match="do not move against each other"):
        hysteresis_loop(LAYOUT, OMEGA, (still, still, still), still)


@pytest.mark.parametrize(
    "values",
    [
        {"excited_point": 1},
        {"excited_point": 1, "middle_point": 1, "free_point": 3, "excited_mass_kg": 1.0, "free_mass_kg": 1.0},
        {"excited_point": 1, "middle_point": 2, "free_point": 3, "excited_mass_kg": -1.0, "free_mass_kg": 1.0},
        {"excited_point": 1, "middle_point": 2, "free_point": 3, "excited_mass_kg": 1.0, "free_mass_kg": math.nan},
    ],
)
def test_malformed_layouts_are_refused(values):
    with pytest.raises(BenchError):
        HysteresisLayout.from_mapping(values)


def test_layout_survives_json_values():
    assert HysteresisLayout.from_mapping(LAYOUT.to_mapping()) == LAYOUT


def test_a_modal_point_carries_it_if_the_rig_declares_it():
    relative = np.array([0.0, 2e-6, 0.0, 1e-7])
    accelerations, force, _ = chain(relative, (JOINT + 4e5j) * relative)
    # At phase resonance at the drive point, which is where the force acts.
    force = force * np.exp(1j * (np.angle(accelerations[0][1]) - 0.5 * np.pi - np.angle(force[1])))
    rows = np.array([*accelerations, accelerations[2]])
    stream = Stream(force, rows, samples=4000, frequencies=(370.0,), quantity=Quantity.ACCELERATION, noise=1e-4)
    layout = HysteresisLayout(2, 4, 5, M1, M3)
    topics = ("force", "acceleration")
    lock = lock_event(0, 3000, 111, frequency_hz=370.0)
    shapes = np.column_stack([rows[:, 1].real / np.abs(rows[:, 1]).max(), [1.0, -1.0, 1.0, -1.0]])
    linear = linear_description(shapes)
    point = extract(stream, lock, linear=linear, settings=ExtractionSettings(topics=topics, hysteresis=layout))
    expected = hysteresis_loop(LAYOUT, OMEGA, accelerations, force).damping_ratio
    assert point.hysteresis_damping == pytest.approx(expected, rel=1e-2)
    assert 0.0 < point.hysteresis_damping_std < 0.01 * expected
    assert math.isnan(extract(stream, lock, settings=ExtractionSettings(topics=topics)).hysteresis_damping)
