"""Windows in which the drive has harmonics of its own are judged with that in mind."""

from __future__ import annotations

import numpy as np
import pytest

from nmt_core.messages.linear_description import LinearDescription
from nmt_extract.extractor import Extractor
from nmt_extract.judgement.channel_history import ChannelHistory
from nmt_extract.judgement.force_judge import DriveState, force_gain
from nmt_session import Session, plan_test
from nmt_signals.channel_faults import clipping

LINEAR = LinearDescription(
    "test", 2, 0, (2, 4), (139.0,), (0.005,), ((0.4,), (1.4,)), 0.4, 140.0, 0.04, 0.043, 0.3, 2e-4
)


def state(gain: float, driven: bool) -> DriveState:
    """A window whose force harmonics are all ``gain`` times what the exciter's impedance makes of the motion."""
    velocity = np.array([0.0, 0.03, 0.0, 0.002j, 0.0, 0.001])
    force = np.array([0.0, 0.5, 0.0, -0.02 * 0.002j * 1e3 * gain, 0.0, -0.02 * 0.001 * 1e3 * gain])
    small = np.full(6, 1e-9)
    return DriveState(139.0, complex(np.nan), force, velocity, small, small, driven)


def test_harmonics_of_the_drive_are_no_change_of_the_force_gain():
    before, after = state(1.0, False), state(2.5, False)
    assert force_gain(after, [before], LINEAR) == pytest.approx(2.5)
    assert force_gain(after._replace(driven=True), [before], LINEAR) is None
    assert force_gain(after, [before._replace(driven=True)], LINEAR) is None


def test_extraction_knows_the_levels_with_control():
    extractor = Extractor(LINEAR)
    extractor.add_level(0, 0.1, "V")
    extractor.add_level(1, 0.1, "V", 9)
    extractor.add_level(2, 0.0, "V", 9)  # the end of the excitation is not a level
    assert extractor.history.driven == {1: 9}
    assert ChannelHistory().driven == {}


def test_the_crest_of_a_force_that_is_held_to_a_sine_is_not_judged(monkeypatch):
    """Little harmonics beyond the controlled ones may fill the crest up; of a sine nothing can have been cut off."""
    judged: list[float] = []
    true = clipping.flat_top

    def watched(values, samples_per_period):
        judged.append(float(np.ptp(values)) / 2.0)
        return true(values, samples_per_period)

    monkeypatch.setattr(clipping, "flat_top", watched)
    forces = {}
    for control in (0, 9):
        judged.clear()
        plan = plan_test("beam", [0.3308], window_periods=20, harmonics_control=control)
        with Session(plan, record=False) as session:
            (point,) = session.run().points
        assert point.reason == ""
        forces[control] = any(abs(peak / point.force_n - 1.0) < 0.1 for peak in judged)
    assert forces == {0: True, 9: False}


def test_points_say_what_was_controlled():
    plan = plan_test("beam", [0.2, 0.3308], window_periods=20, harmonics_control=9, levels_without=(0,))
    with Session(plan, record=False) as session:
        points = session.run().points
    assert [point.harmonics_control for point in points] == [0, 9]
    assert all(point.harmonics == 9 for point in points)


def test_noise_of_the_response_is_no_change_of_the_force_gain():
    """Where the joint sticks F is a small difference of K u and Z v, which noise of v must not pass for knowledge."""
    noise = [f"sensors.0.{key}" for key in ("noise_psd=2e-9", "noise_correlation_time_s=1e-5")]
    for sensor in range(1, 5):
        noise += [f"sensors.{sensor}.{key}" for key in ("noise_psd=4.5e-16", "noise_correlation_time_s=1e-5")]
    levels = [0.05, 0.073, 0.1065, 0.1554, 0.2267, 0.3308, 0.4827]
    plan = plan_test("beam", levels, overrides=noise, window_periods=200)
    with Session(plan, record=False) as session:
        points = session.run().points
    assert [point.reason for point in points] == [""] * len(levels)
