"""The abscissa of accelerations, ω̃² q: its uncertainty is that of draws."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from nmt_report.abscissa import abscissa_of


@pytest.mark.parametrize(("q_std", "omega_std"), [(0.01, 0.0), (0.0, 0.01), (0.01, 0.008)])
def test_uncertainty_of_an_acceleration(q_std: float, omega_std: float) -> None:
    draw, q, omega = np.random.default_rng(2), 2e-3, 140.0
    point = SimpleNamespace(
        modal_amplitude=q, modal_amplitude_std=q_std * q, omega_rad_s=omega, omega_rad_s_std=omega_std * omega
    )
    data = SimpleNamespace(rig={"extraction": {"quantity": "acceleration"}})
    value, std = abscissa_of(data).of_points([point])
    drawn = (omega * (1.0 + omega_std * draw.standard_normal(20_000))) ** 2
    drawn *= q * (1.0 + q_std * draw.standard_normal(20_000))
    assert value == pytest.approx([omega**2 * q])
    assert std == pytest.approx([np.std(drawn)], rel=0.03)
