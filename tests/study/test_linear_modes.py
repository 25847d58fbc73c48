from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from nmt_extract.modal.quantities import modal_quantities
from nmt_study.linear_modes import amplitude_and_damping, distorted

RNG = np.random.default_rng(1)
PHI = RNG.standard_normal((4, 2))


def test_amplitude_and_damping_are_those_of_the_extraction():
    shape = (PHI @ np.array([[3e-4], [2e-6j]]))[:, 0]
    force = np.array([0.0, 0.4 + 0.1j])
    omega = 139.0
    points = [
        SimpleNamespace(
            shape_harmonics=np.array([np.zeros(4), shape]),
            active_power=0.5 * (1j * omega * shape[0] * np.conj(force[1])).real,
            omega_rad_s=omega,
        )
    ]
    q, damping = amplitude_and_damping(points, PHI)
    drive = np.array([[0.0, shape[0]]])
    expected = modal_quantities(np.array([omega]), force[None, None], drive[:, None], drive, shape[None], PHI, 0)
    assert q == pytest.approx(expected.modal_amplitude)
    assert damping == pytest.approx(expected.damping_ratio)
    scaled_q, scaled_damping = amplitude_and_damping(points, 1.1 * PHI)
    assert scaled_q == pytest.approx(q / 1.1)
    assert scaled_damping == pytest.approx(1.21 * damping)


def test_errors_have_the_stated_size():
    rng = np.random.default_rng(2)
    ratios = [np.linalg.norm(distorted(PHI, 0.05, rng) - PHI) / np.linalg.norm(PHI) for _ in range(400)]
    assert np.sqrt(np.mean(np.square(ratios))) == pytest.approx(0.05, rel=0.05)
