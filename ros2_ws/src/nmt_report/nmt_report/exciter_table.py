"""Table of the forces of several exciters: how large each is and how far from phase resonance at its own point."""

from __future__ import annotations

import math

import numpy as np
from markupsafe import Markup

from nmt_core.messages.linear_description import LinearDescription
from nmt_core.messages.modal_point import ModalPoint
from nmt_core.vocabulary import PointStatus
from nmt_report.html_page import PageColumn, Row, Table
from nmt_report.quantity_format import plain, significant
from nmt_report.run_data import RunReportData

_COLUMNS = (
    PageColumn("Level", kind="text"),
    PageColumn("Exciter at point"),
    PageColumn(Markup("|F<sub>1</sub>|"), "N"),
    PageColumn("over the first's"),
    PageColumn("force against its velocity", "°"),
    PageColumn(Markup("√Σ|F<sub>n</sub>|² / |F<sub>1</sub>|"), "%"),
    PageColumn("Share of the power", "%"),
)


def exciter_fact(linear: LinearDescription) -> tuple[str, str]:
    """Where the exciters are, with a label."""
    if len(linear.exciter_points) < 2:
        return "Exciter", f"at point {linear.drive_point}"
    first, *others = linear.exciter_points
    return "Exciters", f"at points {', '.join(map(str, (first, *others)))}; the first is the reference"


def exciter_table(data: RunReportData) -> Table | None:
    """Forces of every exciter at every level; none in a run with one exciter."""
    rows = [
        Row(cells)
        for point in data.points
        if point.exciter_points and point.status == PointStatus.OK
        for cells in _cells(point)
    ]
    return Table(_COLUMNS, rows, heading="Forces of the exciters") if rows else None


def _cells(point: ModalPoint) -> list[list[object]]:
    forces = point.exciter_forces.reshape(len(point.exciter_points), -1)
    rows = [point.points.index(at) for at in point.exciter_points]
    velocities = 1j * point.omega_rad_s * point.shape_harmonics[1, rows]
    powers = 0.5 * (forces[:, 1] * velocities.conj()).real
    cells: list[list[object]] = []
    for number, at in enumerate(point.exciter_points):
        fundamental = forces[number, 1]
        angle = float(np.angle(fundamental * velocities[number].conj()))
        harmonic_share = float(np.linalg.norm(forces[number, 2:]) / abs(fundamental))
        cells.append(
            [
                point.level_index + 1,
                at,
                significant(abs(fundamental)),
                plain(abs(fundamental) / abs(forces[0, 1]), 4),
                plain(math.degrees(angle), 2),
                plain(100.0 * harmonic_share, 3),
                plain(100.0 * float(powers[number] / powers.sum()), 2),
            ]
        )
    return cells
