"""What a report says of control of the force's harmonics."""

from __future__ import annotations

import numpy as np

from nmt_core.messages.modal_point import ModalPoint
from nmt_core.vocabulary import PointStatus
from nmt_report.run_data import ReferenceCurve, RunReportData
from nmt_report.run_page import harmonics_notes, harmonics_table, worst_deviation

REFERENCE = ReferenceCurve("EPMC", np.array([0.5, 4.0]), np.array([100.0, 100.0]), np.array([0.02, 0.02]))


def point(index: int, level: float, q: float, damping: float, control: int, content: float) -> ModalPoint:
    return ModalPoint(
        index,
        PointStatus.OK,
        "",
        level,
        "V",
        omega_rad_s=100.0,
        damping_ratio=damping,
        modal_amplitude=q,
        force_harmonics=np.array([0.0, 1.0, 0.0, content]),
        harmonics=3,
        harmonics_control=control,
        gamma_force=0.99,
        pbmif=0.98,
    )


def data(worst: float = 0.0199, **fields) -> RunReportData:
    points = [
        point(0, 0.1, 1.0, 0.018, 0, 0.05),
        point(1, 0.1, 1.0, 0.02, 9, 0.001),
        point(2, 0.2, 2.0, worst, 1, 0.002),
        ModalPoint(3, PointStatus.REJECTED, "gap", 0.3, "V"),
    ]
    return RunReportData(points, 1e4, reference=REFERENCE, **fields)


def test_the_table_has_a_row_for_each_level_with_values():
    table = harmonics_table(data())
    cells = [row.cells for row in table.rows]
    assert [row[2] for row in cells] == ["none", "2 to 9", "auto"]
    assert cells[1][3:5] == ["0.100", "5.000"]
    assert cells[1][8] == "+11.111"
    assert cells[0][7:] == cells[2][7:] == ["—", "—"]
    assert len(table.columns) == len(cells[0])


def test_a_run_without_control_has_no_table_and_no_notes():
    plain = RunReportData(data().points[:1], 1e4, reference=REFERENCE)
    assert harmonics_table(plain) is None
    assert harmonics_notes(plain) == []


def test_levels_for_comparison_do_not_count_as_deviation():
    assert worst_deviation(data())[1] == 0.0199 / 0.02 - 1.0
    plain = RunReportData(data().points[:1], 1e4, reference=REFERENCE)
    assert worst_deviation(plain)[1] == 0.018 / 0.02 - 1.0


def test_what_was_given_up_and_what_is_left_is_said():
    words = {2: "phase error 0.1 deg; force harmonics up to 9 within 0.1 %; harmonic 5 given up: no room"}
    notes = harmonics_notes(data(lock_words=words))
    assert "Level 3: harmonic 5 given up: no room." in notes
    assert not any("one exciter" in note for note in notes)
    left = harmonics_notes(data(worst=0.018))
    assert any("place of the one exciter" in note for note in left)
