"""A command or a loop that is late or early is neither friction, armature nor gain."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from robots.simulated_joint import log_columns, robot_file
from scipy.signal import lfilter
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


def test_drives_that_follow_the_speed_of_the_command_are_not_early(tmp_path: Path) -> None:
    columns = log_columns(damping=0.6)
    # kp (c − q) + kd (c' − v) is the law of the simulated drive for a command c that is its own, low-passed by kd / kp.
    share = 0.002 / (0.002 + float(columns["kd"][0] / columns["kp"][0]))
    drive, first = columns["des_pos"][:, 0], columns["des_pos"][0, 0]
    columns["des_pos"] = (first + lfilter([share], [1.0, share - 1.0], drive - first))[:, None]
    np.savez(tmp_path / "log.npz", **columns)
    diagnosis = diagnose_robot(robot_file(tmp_path), tmp_path / "log.npz")
    assert "command_speed" in {finding.key for finding in diagnosis.findings}
    assert not any(finding.fault for finding in diagnosis.findings)
    (viscous,) = [term for term in diagnosis.joints[0].terms if term.key == "viscous"]
    assert viscous.differs
    assert viscous.value == pytest.approx(0.6, abs=2.0 * viscous.std)


@pytest.mark.parametrize(("lag_s", "measured", "words"), [
    (-0.012, True, "logged torque is 12 ± 0 ms late"), (0.012, True, "logged torque is 12 ± 0 ms early"),
    (0.012, False, "whole control loop) is 12 ± 0 ms late"),
])  # fmt: skip
def test_a_measured_torque_that_acted_before_its_row_was_logged_late(lag_s: float, measured: bool, words: str) -> None:
    lags = np.arange(-10, 11) * 0.002
    readings = tuple(Reading(torque_lag_s=round(float(lag), 6)) for lag in lags)
    relative = 1e-3 + 0.01 * ((lags - lag_s) / 0.01) ** 2
    scores = ReadingScores(readings, relative, np.tile(relative[:, None], 4), np.tile(relative[:, None], 2), 0.002)
    (finding,) = reading_findings(scores, 0.002, measured=measured)
    assert words in finding.sentence
    assert ("kp" in finding.sentence) is not measured
