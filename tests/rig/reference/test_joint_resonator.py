"""The joint resonator's figures, as docs/explanation/joint-resonator.md states them (paper, section 4)."""

from __future__ import annotations

import numpy as np
import pytest

from nmt_rig.linear_description import linear_description
from nmt_rig.reference import compute_reference, single_point_reference
from nmt_rig.rig import load_rig

TWO_PI = 2.0 * np.pi


def straight_lines(x, y):
    """Best continuous pair of straight lines: where they meet, and their slopes."""
    best = (np.inf, 0.0, np.zeros(3))
    for bend in np.arange(100.0, 700.0, 2.0):
        basis = np.column_stack([np.ones_like(x), x, np.maximum(x - bend, 0.0)])
        coefficients = np.linalg.lstsq(basis, y, rcond=None)[0]
        error = float(((basis @ coefficients - y) ** 2).sum())
        if error < best[0]:
            best = (error, float(bend), coefficients)
    _, bend, coefficients = best
    return bend, coefficients[1], coefficients[1] + coefficients[2]


@pytest.fixture(scope="module")
def rig():
    return load_rig("joint_resonator")


@pytest.fixture(scope="module")
def linear(rig):
    return linear_description(rig)


@pytest.fixture(scope="module")
def backbone(rig, linear):
    """EPMC over ω̃²q = 20 … 800 in equal steps, and 1830."""
    accelerations = np.append(np.linspace(20.0, 800.0, 79), 1830.0)
    return compute_reference(rig, 7, accelerations / linear.frequencies_rad_s[1] ** 2)


def test_linear_modes(linear):
    frequencies = np.array(linear.frequencies_rad_s) / TWO_PI
    assert frequencies[0] < 5.0
    assert frequencies[1] == pytest.approx(370.0, abs=0.01)
    assert 900.0 < frequencies[2] < 1500.0
    assert linear.damping_ratios[1] == pytest.approx(0.00101, rel=0.01)
    assert abs(linear.drive_point_shape) == pytest.approx(0.462, abs=0.001)


def test_a_fifth_of_the_strain_energy_is_in_the_joint(linear):
    shape = np.array(linear.shapes)[:, 1]
    share = 20.7594e6 * (shape[2] - shape[1]) ** 2 / linear.frequencies_rad_s[1] ** 2
    assert share == pytest.approx(0.2, abs=1e-3)


def test_sharp_bend_near_400(backbone):
    x = (backbone.omega_rad_s**2 * backbone.modal_amplitude)[:-1]
    bend, before, after = straight_lines(x, backbone.omega_rad_s[:-1])
    assert bend == pytest.approx(400.0, rel=0.1)
    assert after / before == pytest.approx(3.5, abs=0.4)
    bend, before, after = straight_lines(x, backbone.damping_ratio[:-1])
    assert bend == pytest.approx(400.0, rel=0.1)
    assert after / before == pytest.approx(6.4, abs=0.7)


def test_frequency_falls_slightly_below_the_bend(backbone, linear):
    x = backbone.omega_rad_s**2 * backbone.modal_amplitude
    below = backbone.omega_rad_s[x < 350.0]
    assert np.all(np.diff(below) < 1e-6 * below[0])
    assert below[-1] / linear.frequencies_rad_s[1] - 1.0 == pytest.approx(-0.00062, abs=0.0001)


def test_shape_hardly_changes(backbone, linear):
    phi = np.array(linear.shapes)[:, 1]
    shapes = backbone.backbone.normalised_shape[:, list(backbone.backbone.orders).index(1)]
    mac = np.abs(shapes @ phi) ** 2 / (phi @ phi) / (np.abs(shapes) ** 2).sum(axis=1)
    assert np.all(mac > 0.999)
    assert mac[-1] == pytest.approx(0.99936, abs=1e-4)
    assert mac[-1] < mac[40] < mac[0]


def test_levels_straddle_the_bend_and_reach_the_forces_of_the_sweeps(rig):
    low, high, count = rig.test.levels.split(":")
    reference = single_point_reference(rig, None, np.geomspace(float(low), float(high), int(count)), 5)
    mode = reference.mode
    x = mode.omega_rad_s**2 * mode.modal_amplitude
    assert len(reference.level) == 16
    assert reference.single_valued
    assert x[0] < 50.0
    assert 1600.0 < x[-1] < 2400.0
    for force, acceleration, frequency in ((14.65, 900.0, 368.5), (38.15, 1590.0, 366.8)):
        assert np.interp(force, mode.force_n, x) == pytest.approx(acceleration, rel=0.03)
        resonance = np.interp(force, mode.force_n, mode.omega_rad_s) / TWO_PI
        assert resonance == pytest.approx(frequency, abs=0.1)
    # The error of the method: what a perfect test with this shaker would measure, against the mode itself.
    exact = compute_reference(rig, 5, mode.modal_amplitude)
    assert np.all(np.abs(mode.omega_rad_s / exact.omega_rad_s - 1.0) < 1e-4)
    assert np.all(np.abs(mode.damping_ratio / exact.damping_ratio - 1.0) < 2e-3)


def test_few_harmonics_are_enough(rig, backbone):
    chosen = slice(0, None, 13)
    fine = compute_reference(rig, 20, backbone.modal_amplitude[chosen])
    assert backbone.omega_rad_s[chosen] == pytest.approx(fine.omega_rad_s, rel=2e-6)
    assert backbone.damping_ratio[chosen] == pytest.approx(fine.damping_ratio, rel=2e-4)
