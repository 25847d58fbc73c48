from __future__ import annotations

import csv
import io
import math

import numpy as np
import pytest
from study.synthetic_result import perfect_result

from nmt_study.case import StudyCase
from nmt_study.study_table import COLUMNS, at_amplitude, level_rows, study_csv, summary_row


@pytest.fixture(scope="module")
def result():
    return perfect_result(StudyCase("x", "case x", 2, (0.2, 0.5, 1.0), harmonics=5), lost=(1,))


def test_errors_are_relative_to_each_reference(result):
    levels = [dict(level) for level in result["levels"]]
    levels[2]["omega_rad_s"] *= 1.01
    levels[2]["damping_ratio"] *= 0.95
    row = level_rows("s", {**result, "levels": levels})[2]
    assert row["omega_error_single_point"] == pytest.approx(0.01)
    assert row["damping_error_single_point"] == pytest.approx(-0.05)
    expected = at_amplitude(result["epmc"], row["modal_amplitude"])
    assert row["omega_error_epmc"] == pytest.approx(row["omega_rad_s"] / expected[0] - 1.0)
    assert row["damping_error_epmc"] == pytest.approx(row["damping_ratio"] / expected[1] - 1.0)


def test_a_level_without_a_lock_has_no_values_but_a_reason(result):
    row = level_rows("s", result)[1]
    assert row["status"] == "not locked"
    assert row["reason"]
    assert all(row[name] is None for name in COLUMNS if "error" in name)


def test_table_reads_back(result):
    rows = level_rows("s", result)
    read = list(csv.DictReader(io.StringIO(study_csv(rows))))
    assert tuple(read[0]) == COLUMNS
    assert float(read[0]["omega_rad_s"]) == rows[0]["omega_rad_s"]
    assert read[1]["omega_rad_s"] == ""
    assert read[0]["epmc_single_valued"] == "1"


def test_summary_takes_the_worst_level_and_only_single_valued_ones(result):
    levels = [dict(level) for level in result["levels"]]
    levels[0]["omega_rad_s"] *= 1.002
    levels[2]["omega_rad_s"] *= 0.99
    changed = {**result, "levels": levels}
    row = summary_row(changed, level_rows("s", changed))
    assert (row.locked, row.levels) == (2, 3)
    assert row.single_point[0] == pytest.approx(0.01, rel=1e-6)
    assert row.note.startswith("1 not locked: made up")
    q = levels[2]["modal_amplitude"]
    folded = {**changed, "epmc": {**changed["epmc"], "folds": [[0.9 * q, 1.1 * q]]}}
    assert summary_row(folded, level_rows("s", folded)).epmc[0] == pytest.approx(0.002, abs=2e-4)
    none = {
        **result,
        "epmc": {"failure": "none", "folds": []},
        "single_point": {**result["single_point"], "failure": "no"},
    }
    row = summary_row(none, level_rows("s", none))
    assert all(math.isnan(value) for value in (*row.epmc, *row.single_point))
    assert "no EPMC: none" in row.note


def test_epmc_is_not_extrapolated(result):
    grid = result["epmc"]["modal_amplitude"]
    assert at_amplitude(result["epmc"], 0.99 * grid[0]) is None
    assert at_amplitude(result["epmc"], grid[-1])[0] == pytest.approx(result["epmc"]["omega_rad_s"][-1])
    assert np.isfinite(at_amplitude(result["epmc"], grid[0])).all()
