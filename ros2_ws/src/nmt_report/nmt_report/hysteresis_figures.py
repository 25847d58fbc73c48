"""Figure of the joint's hysteresis loops, one colour a level."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure

from nmt_extract.modal.hysteresis import HysteresisLayout, loop_of_point
from nmt_report.shape_figures import level_bar
from nmt_report.shown_levels import MOST_CURVES, shown_note, spread_evenly
from nmt_report.svg import INK, ReportFigure, level_colours, svg_text

if TYPE_CHECKING:
    from nmt_report.run_data import RunReportData


def hysteresis_figure(data: RunReportData) -> ReportFigure | None:
    """Joint force over relative displacement, and the residual without the secant stiffness; None without a chain."""
    values = (data.run.get("extraction") or {}).get("hysteresis")
    if not values:
        return None
    layout = HysteresisLayout.from_mapping(values)
    points = spread_evenly(data.good_points, MOST_CURVES)
    loops = [loop_of_point(layout, point) for point in points]
    if not loops or any(loop is None for loop in loops):
        return None
    figure = Figure(figsize=(12.9, 4.6))
    left, right = figure.subplots(1, 2)
    figure.subplots_adjust(left=0.062, right=0.925, bottom=0.13, top=0.9, wspace=0.16)
    for loop, colour in zip(loops, level_colours(len(points)), strict=True):
        if loop is None:
            continue
        displacement = np.append(loop.relative_displacement, loop.relative_displacement[0])[::16]
        force = np.append(loop.force, loop.force[0])[::16]
        left.plot(1e6 * displacement, force, color=colour, linewidth=1.1)
        reach = float(np.abs(displacement).max())
        secant = float(np.dot(displacement, force) / np.dot(displacement, displacement))
        rest = 100.0 * (force - secant * displacement) / (secant * reach)
        right.plot(displacement / reach, rest, color=colour, linewidth=1.1)
    for axes in (left, right):
        axes.axhline(0.0, color=INK, linewidth=0.6)
        axes.axvline(0.0, color=INK, linewidth=0.6)
    left.set_title("joint force over relative displacement")
    left.set_xlabel(r"$x_\mathrm{rel}$ / µm")
    left.set_ylabel(r"$f_\mathrm{t}$ / N")
    right.set_title("the same without the secant stiffness, each loop by its own size")
    right.set_xlabel(r"$x_\mathrm{rel}\,/\,\max|x_\mathrm{rel}|$")
    right.set_ylabel(r"$(f_\mathrm{t} - k\,x_\mathrm{rel})\,/\,(k\,\max|x_\mathrm{rel}|)$ / %")
    level_bar(figure, points, (0.945, 0.13, 0.011, 0.77))
    caption = Markup(
        "Hysteresis loops of the joint: force −<i>m</i><sub>3</sub><i>ẍ</i><sub>3</sub> over "
        "<i>x</i><sub>3</sub> − <i>x</i><sub>2</sub>, integrated in the frequency domain. Their area gives "
        "δ<sub>hyst</sub>. The data are in hysteresis.csv."
    ) + shown_note(len(points), len(data.good_points))
    label = "Hysteresis loops of the joint at every level"
    return ReportFigure("hysteresis", "Hysteresis loops", caption, svg_text(figure, "hysteresis", label), wide=True)
