"""A command or a loop that is late or early is neither friction, armature nor gain."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from robots.simulated_joint import log_columns, robot_file
from tiers import with_quick

pytest.importorskip("mujoco", reason="mujoco is not installed: robots are not tested")

from nmt_robots.log_faults.drive import reading_findings
from nmt_robots.mechanics.readings import Reading
from nmt_robots.mechanics.shared_reading import ReadingScores
from nmt_robots.verdict.robot_diagnosis import diagnose_robot

LAGS = (-0.03, -0.02, -0.012, -0.006, 0.006, 0.012, 0.02, 0.03)
CASES = [(lag, gain, more) for lag in LAGS for gain in (1.0, 1.1) for more in (0.0, 0.4)]


@pytest.mark.parametrize(("lag", "gain", "more"), with_quick(CASES, (0.03, 1.1, 0.0)))
def test_a_lag_is_claimed_as_no_mechanics(tmp_path: Path, lag: float, gain: float, more: float) -> None:
    columns = log_columns(lag_s=max(lag, 0.0), coulomb=0.5 + more)
    if lag < 0.0:  # the log has each command later than the drive
        rows = round(-lag * 500.0)
        first = np.repeat(columns["des_pos"][:1], rows, axis=0)
        columns["des_pos"] = np.vstack([first, columns["des_pos"][:-rows]])
    columns["kp"] = columns["kp"] / gain
    np.savez(tmp_path / "log.npz", **columns)
    diagnosis = diagnose_robot(robot_file(tmp_path), tmp_path / "log.npz")
    reading = diagnosis.reading
    if gain == 1.0:
        assert reading.command_lag_s + reading.torque_lag_s == pytest.approx(lag, abs=0.007)
    claimed = {term.key for term in diagnosis.joints[0].terms if term.differs}
    assert claimed <= ({"coulomb"} if more else set())
    if gain == 1.0:
        assert not any(finding.fault and finding.key == "gain" for finding in diagnosis.findings)


def test_a_lag_at_the_limit_is_not_stated() -> None:
    lags = np.arange(-4, 5) * 0.01
    readings = tuple(Reading(torque_lag_s=round(float(lag), 6)) for lag in lags)
    relative = 0.01 + 0.1 * (0.05 - lags)
    scores = ReadingScores(readings, relative, np.tile(relative[:, None], 4), relative[:, None], 0.002)
    assert scores.is_beyond
    assert scores.best.torque_lag_s == pytest.approx(0.03)
    (finding,) = reading_findings(scores, 0.002)
    assert finding.key == "lag_beyond"
    assert not np.isfinite(finding.size)
    assert all(abs(reading.torque_lag_s) < 0.04 for reading in scores.fit_as_well())
