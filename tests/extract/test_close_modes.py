"""Two close modes whose shape moves with the level, beside nonlinear modes that share no code with the bench."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from independent.epmc_of_masses import Masses
from scipy.interpolate import CubicSpline
from tiers import with_quick

from nmt_core.vocabulary import PointStatus
from nmt_extract.judgement.channel_history import ChannelHistory
from nmt_extract.modal.mode_identity import mode_verdict
from nmt_extract.modal.point import modal_point
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


@pytest.fixture(scope="module")
def windows(rig: str) -> Any:
    """Windows of one recording, and the points that were extracted of them while it ran."""
    found = []

    def keep(*arguments: Any) -> Any:
        found.append(arguments[:3])
        return modal_point(*arguments)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("nmt_extract.extractor.modal_point", keep)
        points, _ = run(rig)
    return found, points


def points_with(windows: Any, row: int, gain: float, **changes: Any) -> Any:
    """Points of the windows with one channel's samples times a gain, and with changes of the linear description."""
    history = ChannelHistory()
    points = []
    for window, linear, settings in windows:
        data = window.data.copy()
        data[row] *= gain
        points.append(modal_point(replace(window, data=data), replace(linear, **changes), settings, history))
    return points


@pytest.mark.parametrize("gain", with_quick([0.9, 1.1], 1.1))
@pytest.mark.parametrize("name", ["a1", "a2", "a3"])
def test_a_gain_beside_a_shape_that_moves_is_named_at_every_level(windows: Any, name: str, gain: float) -> None:
    found, healthy = windows
    names = [channel.name for channel in found[0][0].channels]
    points = points_with(found, names.index(name), gain)
    for index, (point, right) in enumerate(zip(points, healthy, strict=True)):
        by = f"{index + 1} levels up to this one" if index else "this level"
        assert point.status is PointStatus.OK
        assert point.reason.startswith(
            f"{name} measures {gain:.2f} times what the other channels say, by the linear modes of the model and {by}: "
            "its gain is off, and its values are divided by this."
        )
        assert not any(f"{other} measures" in point.reason for other in names if other != name)
        assert "do not tell" not in point.reason
        assert point.omega_rad_s == right.omega_rad_s
        assert point.damping_ratio == pytest.approx(right.damping_ratio, rel=2e-3)
        assert point.modal_amplitude == pytest.approx(right.modal_amplitude, rel=2e-3)
        assert point.damping_ratio_std > 1e-3 * point.damping_ratio
        assert point.modal_amplitude_std >= right.modal_amplitude_std
    assert "Mode 2 at 30.029 Hz takes part by 3" in points[-1].reason


@pytest.mark.campaign
def test_a_run_with_a_gain_meets_the_nonlinear_mode_all_the_same(rig: str) -> None:
    """The loop measures by the same channel."""
    modes = Masses(MASS, DAMPING, STIFFNESS, np.array([1.0, 0.0, 0.0]), 1e7).modes(0, 0.01, 0.06)
    place = np.log([mode.amplitude for mode in modes])
    omega = CubicSpline(place, [mode.omega for mode in modes])
    points, _ = run(rig, [0.1, 0.9, 6.0], overrides=["sensors.4.gain=0.9"])
    for point in points:
        assert point.status is PointStatus.OK
        assert point.reason.startswith("a3 measures 0.90 times")
        assert point.omega_rad_s == pytest.approx(omega(max(np.log(point.modal_amplitude), place[0])), rel=1e-4)


def test_windows_without_a_gain_give_the_points_of_the_run(windows: Any) -> None:
    found, healthy = windows
    for point, right in zip(points_with(found, 2, 1.0), healthy, strict=True):
        assert (point.damping_ratio, point.modal_amplitude, point.reason) == (
            right.damping_ratio, right.modal_amplitude, right.reason,
        )  # fmt: skip


@pytest.mark.parametrize(("name", "gain", "words"), [("a1", 1.1, "a1 measures 1.10"), ("a3", 0.9, "a3 measures 0.90")])
def test_where_shapes_are_not_known_well_nobody_can_tell_and_nothing_is_left_out(
    windows: Any, name: str, gain: float, words: str
) -> None:
    """Shapes of a test with 8 % of uncertainty: the near mode may be mixed into the target's by as much."""
    found, healthy = windows
    names = [channel.name for channel in found[0][0].channels]
    stds = tuple(tuple(0.08 * max(map(abs, row)) for _ in row) for row in found[0][1].shapes)
    points = points_with(found[:6], names.index(name), gain, source="test", shape_stds=stds)
    for point, right in zip(points, healthy, strict=False):
        assert point.status is PointStatus.OK
        assert point.reason.startswith(words)
        assert "3 points do not tell which, and nothing is left out" in point.reason
        assert abs(point.damping_ratio - right.damping_ratio) < 2.0 * point.damping_ratio_std


def test_a_gain_that_the_shapes_of_the_test_have_too_is_not_seen(windows: Any) -> None:
    found, _ = windows
    shapes = tuple(tuple(1.1 * value for value in row) if k == 0 else row for k, row in enumerate(found[0][1].shapes))
    points = points_with(found, 2, 1.1, source="test", shapes=shapes)
    assert not any("measures" in point.reason for point in points)


def test_a_level_of_another_mode_is_named_as_what_it_is() -> None:
    points, test = run("frame", [1.0, 4.0], exciter=1, window_periods=40)
    for point in points:
        assert point.reason.startswith("The shape is that of mode 2 at 101.98 Hz rather than of mode 1 at 99.982 Hz")
    verdict = mode_verdict(points, test.used_linear)
    assert verdict.startswith("2 of 2 levels with values are mode 2 at 101.98 Hz under the name of mode 1")
