"""Two close modes whose shape moves with the level, beside nonlinear modes that share no code with the bench."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from independent.epmc_of_masses import Masses
from scipy.interpolate import CubicSpline

from nmt_core.vocabulary import PointStatus
from nmt_extract.mode_identity import mode_verdict
from nmt_session import Session, plan_test

WINGS = """
name: wings
description: Two wings on a body with two close modes, a cubic spring at one wing
seed: 1
sample_rate_hz: 5000
structure:
  kind: chain
  masses_kg: [0.2, 2.0, 0.2]
  springs_n_m: [7120.0, 7120.0]
  dampers_ns_m: [0.22, 0.22]
  ground_springs_n_m: [0.0, 338000.0, 0.0]
local_elements:
  - {name: hardening, kind: cubic_spring, point: 1, stiffness_n_m3: 1.0e+7}
exciters:
  - {kind: force, point: 1, newton_per_volt: 0.04}
  - {kind: force, point: 3, newton_per_volt: 0.04}
sensors:
  - {quantity: force, point: 1}
  - {quantity: force, point: 3}
  - {quantity: acceleration, point: 1}
  - {quantity: acceleration, point: 2}
  - {quantity: acceleration, point: 3}
  - {quantity: voltage}
  - {quantity: voltage, exciter: 2}
limits: {voltage_v: 60, acceleration_m_s2: 2000, ramp_s: 0.1}
test: {mode: 1, levels: "0.05:6:8", ramp_s: 0.5, window_periods: 60, lock_timeout_s: 60}
extraction: {quantity: acceleration, harmonics: 7, linear_modes: 2}
pll: {}
"""
K, GROUND, C = 7120.0, 338000.0, 0.22
MASS = np.diag([0.2, 2.0, 0.2])
STIFFNESS = np.array([[K, -K, 0.0], [-K, 2 * K + GROUND, -K], [0.0, -K, K]])
DAMPING = np.array([[C, -C, 0.0], [-C, 2 * C, -C], [0.0, -C, C]])


@pytest.fixture(scope="module")
def rig(tmp_path_factory: Any) -> str:
    path = tmp_path_factory.mktemp("wings") / "wings.yaml"
    path.write_text(WINGS)
    return str(path)


def run(rig: str, levels: Any = None, **plan: Any) -> Any:
    test = plan_test(rig, levels, **plan)
    with Session(test, record=False) as session:
        return session.run().points, test


def test_every_level_of_a_mode_whose_shape_moves_is_that_of_the_nonlinear_mode(rig: str) -> None:
    """Frequencies within 0.1 %; damping within 1 %, what the judge lets a level that still settles be off by."""
    modes = Masses(MASS, DAMPING, STIFFNESS, np.array([1.0, 0.0, 0.0]), 1e7).modes(0, 0.01, 0.06)
    place = np.log([mode.amplitude for mode in modes])
    witness = CubicSpline(place, [(mode.omega, mode.damping_ratio) for mode in modes])
    assert modes[0].omega / (2 * np.pi) == pytest.approx(29.27, abs=0.01)
    points, _ = run(rig)
    assert len(points) == 8
    for point in points:
        assert point.status is PointStatus.OK
        assert "measures" not in point.reason
        omega, damping = witness(max(np.log(point.modal_amplitude), place[0]))
        assert point.omega_rad_s == pytest.approx(omega, rel=1e-4)
        assert point.damping_ratio == pytest.approx(damping, rel=1e-2)
    assert points[-1].mac < 0.9
    assert "Mode 2 at 30.029 Hz takes part by 3" in points[-1].reason


@pytest.mark.parametrize(("row", "gain", "words"), [(2, 1.1, "a1 measures 1.10"), (4, 0.9, "a3 measures 0.90")])
def test_a_gain_that_a_moving_shape_could_be_is_named_and_nothing_is_left_out(
    rig: str, row: int, gain: float, words: str
) -> None:
    points, _ = run(rig, [0.1, 0.3, 0.9, 1.8], overrides=[f"sensors.{row}.gain={gain}"])
    for point in points:
        assert point.status is PointStatus.OK
        assert point.reason.startswith(words)
        assert "3 points do not tell which, and nothing is left out" in point.reason
        assert abs(point.damping_ratio / 0.003 - 1.0) < 2.0 * point.damping_ratio_std / point.damping_ratio


def test_a_level_of_another_mode_is_named_as_what_it_is() -> None:
    points, test = run("frame", [1.0, 4.0], exciter=1, window_periods=40)
    for point in points:
        assert point.reason.startswith("The shape is that of mode 2 at 101.98 Hz rather than of mode 1 at 99.982 Hz")
    verdict = mode_verdict(points, test.used_linear)
    assert verdict.startswith("2 of 2 levels with values are mode 2 at 101.98 Hz under the name of mode 1")
