"""A speed that is logged late is named, and no friction is made of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from robots.simulated_joint import log_columns, robot_file

pytest.importorskip("mujoco", reason="mujoco is not installed: robots are not tested")

from nmt_robots.verdict.robot_diagnosis import diagnose_robot


def test_a_late_speed_is_the_fault_of_the_log(tmp_path: Path) -> None:
    columns = log_columns()
    columns["vel"] = np.vstack([np.repeat(columns["vel"][:1], 4, axis=0), columns["vel"][:-4]])
    np.savez(tmp_path / "log.npz", **columns)
    diagnosis = diagnose_robot(robot_file(tmp_path), tmp_path / "log.npz")
    (finding,) = [finding for finding in diagnosis.findings if finding.key == "velocity_late"]
    assert finding.size == pytest.approx(0.008, rel=0.1)
    # Damping by the derivative of the position explains the torque as well, and as nearly without a lag.
    derived = [reading for reading in (diagnosis.reading, *diagnosis.as_well) if reading.derived]
    assert min(abs(reading.command_lag_s + reading.torque_lag_s) for reading in derived) <= 0.001
    assert not any(abs(reading.command_lag_s + reading.torque_lag_s) > 0.005 for reading in diagnosis.as_well)
    assert not diagnosis.joints[0].differs
    assert {finding.key for finding in diagnosis.findings if finding.fault} == {"velocity_late"}
