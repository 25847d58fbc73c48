"""Figures of shapes and harmonics, one colour a level."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from nmt_report.quantity_format import significant
from nmt_report.run_data import RunReportData
from nmt_report.shown_levels import MOST_CURVES, shown_note, spread_evenly
from nmt_report.svg import MUTED, ReportFigure, level_colours, svg_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from nmt_core.messages.modal_point import ModalPoint


def shape_figure(data: RunReportData) -> ReportFigure | None:
    """|φ̃₁| and its phase at the response points, levels coloured, with the linear mode for comparison."""
    points = spread_evenly(data.good_points, MOST_CURVES)
    if not points or len(points[0].points) == 0:
        return None
    figure = Figure(figsize=(6.3, 4.5))
    magnitude, phase = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    figure.subplots_adjust(left=0.12, right=0.85, bottom=0.12, top=0.96, hspace=0.12)
    colours = level_colours(len(points))
    for point, colour in zip(points, colours, strict=True):
        numbers = np.asarray(point.points)
        order = np.argsort(numbers)
        shape = np.asarray(point.normalised_shape)
        # The phase is counted from the largest component, so that an in-phase shape lies at 0°.
        turned = shape * np.exp(-1j * np.angle(shape[np.argmax(np.abs(shape))]))
        magnitude.plot(numbers[order], np.abs(shape)[order], "o-", color=colour, linewidth=1.0)
        phase.plot(numbers[order], np.degrees(np.angle(turned))[order], "o-", color=colour, linewidth=1.0)
    if data.linear is not None:
        numbers = np.asarray(data.linear.points)
        order = np.argsort(numbers)
        linear = np.abs(data.linear.shape_matrix[:, data.linear.target_mode])
        magnitude.plot(
            numbers[order],
            linear[order],
            linestyle=(0, (4, 2)),
            color=MUTED,
            linewidth=1.2,
            marker="_" if len(numbers) == 1 else None,  # a line of one point would not be seen
            markersize=16.0,
            label="linear mode",
        )
        magnitude.legend(loc="best")
    magnitude.set_ylabel(r"$|\tilde\varphi_1|$ / kg$^{-1/2}$")
    magnitude.set_ylim(bottom=0.0)
    phase.set_ylabel("phase / °")
    largest = max((abs(float(value)) for line in phase.lines for value in np.atleast_1d(line.get_ydata())), default=0.0)
    if largest > 60.0:
        phase.set_ylim(-195, 195)
        phase.set_yticks((-180, -90, 0, 90, 180))
    else:
        phase.set_ylim(-max(1.3 * largest, 1.0), max(1.3 * largest, 1.0))
    phase.set_xlim(numbers.min() - 0.5, numbers.max() + 0.5)
    phase.set_xlabel("measurement point")
    phase.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    level_bar(figure, points, (0.88, 0.12, 0.022, 0.84))
    caption = (
        "Mass-normalised fundamental shape φ̃₁ at the measurement points, one line a level; phase relative "
        "to the largest component." + shown_note(len(points), len(data.good_points))
    )
    label = "Magnitude and phase of the modal shape at the measurement points"
    return ReportFigure("shapes", "Shape φ̃₁", caption, svg_text(figure, "shapes", label))


def harmonics_figure(data: RunReportData) -> ReportFigure | None:
    """Harmonics of force and drive-point displacement relative to the fundamental, one bar a level."""
    known = [point for point in data.good_points if point.harmonics > 1]  # of a released motion the fundamental alone
    points = spread_evenly(known or data.good_points, MOST_CURVES)
    if not points or len(points[0].force_harmonics) < 2 or not abs(points[0].force_harmonics[1]) > 0.0:
        return None
    figure = Figure(figsize=(12.9, 3.9))
    left, right = figure.subplots(1, 2)
    figure.subplots_adjust(left=0.062, right=0.925, bottom=0.15, top=0.9, wspace=0.16)
    force = [np.abs(np.asarray(point.force_harmonics)) for point in points]
    response = [np.abs(drive_point_harmonics(point, data)) for point in points]
    _bars(left, force, r"force $|F_n|\,/\,|F_1|$")
    _bars(right, response, r"displacement $|\psi_n|\,/\,|\psi_1|$")
    level_bar(figure, points, (0.945, 0.15, 0.011, 0.75))
    caption = (
        "Harmonics relative to the fundamental at each level (low to high, left to right within a group): "
        "excitation force, and displacement at the drive point." + shown_note(len(points), len(data.good_points))
    )
    label = "Harmonics of force and drive-point displacement at every level"
    return ReportFigure("harmonics", "Harmonics", caption, svg_text(figure, "harmonics", label), wide=True)


def drive_point_harmonics(point: ModalPoint, data: RunReportData) -> Any:
    """Displacement harmonics ψ_n (m) at the drive point, else at the point that moves most."""
    shapes = np.asarray(point.shape_harmonics)
    numbers = list(point.points)
    drive = data.linear.drive_point if data.linear is not None else -1
    column = numbers.index(drive) if drive in numbers else int(np.argmax(np.abs(shapes[1])))
    return shapes[:, column]


def level_bar(figure: Figure, points: list[ModalPoint], place: tuple[float, float, float, float]) -> None:
    """A colour scale of the levels at ``place`` (left, bottom, width, height of the figure)."""
    count = len(points)
    axes = figure.add_axes(place)
    scale = ScalarMappable(Normalize(-0.5, count - 0.5), ListedColormap(level_colours(count)))
    shown = np.unique(np.linspace(0, count - 1, min(count, 8)).round().astype(int))
    bar = figure.colorbar(scale, cax=axes, ticks=shown)
    bar.ax.set_yticklabels([significant(points[index].level, 3) for index in shown])
    bar.ax.set_title(f"level / {points[0].level_unit.replace('^2', '²')}", fontsize=8, fontweight="normal", loc="left")
    bar.ax.minorticks_off()
    bar.ax.tick_params(length=0, labelsize=8)
    bar.outline.set_visible(False)


def _bars(axes: Axes, harmonics: list[Any], title: str) -> None:
    count = len(harmonics)
    orders = harmonics[0].size - 1
    width = 0.82 / count
    floor = 1e-7
    for index, (values, colour) in enumerate(zip(harmonics, level_colours(count), strict=True)):
        relative = np.maximum(values[1:] / values[1], floor)
        place = np.arange(1, orders + 1) - 0.41 + (index + 0.5) * width
        axes.bar(place, relative - floor, width * 0.92, bottom=floor, color=colour, linewidth=0)
    axes.set_yscale("log")
    lowest = min(float(np.min(values[1:] / values[1])) for values in harmonics)
    axes.set_ylim(10.0 ** np.floor(np.log10(max(lowest, 1e-6))), 2.0)
    axes.set_xticks(range(1, orders + 1))
    axes.set_xlabel("harmonic $n$")
    axes.grid(False, axis="x")
    axes.set_title(title, y=1.0)
