"""What control of harmonics has done, told from made-up points of a known backbone."""

from __future__ import annotations

import math

import numpy as np
import pytest

from nmt_core.messages.modal_point import ModalPoint
from nmt_core.vocabulary import PointStatus
from nmt_extract.modal.harmonics_indicators import (
    HARMONICS_COLUMNS,
    any_control,
    comparison_of,
    force_content,
    indicators,
)
from nmt_extract.modal.table import COLUMNS, read_csv, read_json, write_csv, write_json


def point(index: int, level: float, q: float, error=(0.0, 0.0), control=9, content=0.0, **fields) -> ModalPoint:
    """A point on ω̃ = 100 q^-0.1, δ̃ = 0.02 q^0.7 with relative errors of both."""
    return ModalPoint(
        index,
        PointStatus.OK,
        "",
        level,
        "V",
        omega_rad_s=100.0 * q**-0.1 * (1 + error[0]),
        damping_ratio=0.02 * q**0.7 * (1 + error[1]),
        modal_amplitude=q,
        force_harmonics=np.array([0.0, 2.0, 0.0, 2.0 * content, 0.0]),
        harmonics=4,
        harmonics_control=control,
        **fields,
    )


RUN = [
    point(0, 0.1, 1.05, error=(0.001, -0.05), control=0, content=0.06),
    point(1, 0.1, 1.0, content=0.001),
    point(2, 0.2, 2.0, content=0.002),
    point(3, 0.4, 3.9, error=(-0.002, 0.02), control=0, content=0.08),
    point(4, 0.4, 4.0, content=0.003),
]


def test_movement_is_told_at_the_amplitude_of_the_window_without_control():
    told = indicators(RUN)
    assert told[1].damping_moved == pytest.approx(1 / 0.95 - 1, rel=1e-9)
    assert told[1].frequency_moved == pytest.approx(1 / 1.001 - 1, rel=1e-6)
    assert told[4].damping_moved == pytest.approx(1 / 1.02 - 1, rel=1e-9)
    assert told[1].force_harmonics == pytest.approx(0.001)
    assert told[1].force_harmonics_without == pytest.approx(0.06)
    for other in (0, 2, 3):
        assert math.isnan(told[other].damping_moved)
        assert math.isnan(told[other].force_harmonics_without)
    assert [each.harmonics_control for each in told] == [0, 9, 9, 0, 9]


def test_without_a_neighbour_nothing_is_carried():
    told = indicators(RUN[:2])
    assert told[1].damping_moved == pytest.approx(0.02 / (0.02 * 1.05**0.7 * 0.95) - 1)


def test_a_comparison_is_the_level_right_before_at_the_same_amplitude():
    assert comparison_of(RUN, 1) is RUN[0]
    assert comparison_of(RUN, 2) is None
    assert comparison_of(RUN, 0) is None
    failed = ModalPoint(0, PointStatus.REJECTED, "gap", 0.1, "V")
    assert comparison_of([failed, RUN[1]], 1) is None
    assert math.isnan(force_content(failed))
    assert indicators([failed])[0].harmonics_control == 0


def test_columns_are_there_with_control_only(tmp_path):
    write_csv(RUN, tmp_path / "with.csv")
    columns = read_csv(tmp_path / "with.csv")
    assert tuple(columns) == (*COLUMNS, *HARMONICS_COLUMNS)
    assert columns["harmonics_control"] == [0.0, 9.0, 9.0, 0.0, 9.0]
    assert columns["damping_moved"][1] == indicators(RUN)[1].damping_moved
    without = [RUN[0], RUN[3]]
    assert not any_control(without)
    write_csv(without, tmp_path / "without.csv")
    assert tuple(read_csv(tmp_path / "without.csv")) == COLUMNS


def test_json_keeps_the_control_and_reads_files_from_before_it(tmp_path):
    write_json(RUN, tmp_path / "modal.json")
    points, _ = read_json(tmp_path / "modal.json")
    assert all(mine.identical(other) for mine, other in zip(RUN, points, strict=True))
    write_json(RUN[:1], tmp_path / "modal.json")
    assert "harmonics_control" not in (tmp_path / "modal.json").read_text()
    assert read_json(tmp_path / "modal.json")[0][0].identical(RUN[0])
