"""What figures of several pages begin and end with."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from matplotlib.figure import Figure

from nmt_report.svg import ReportFigure, svg_text


def plot_panels(
    size: tuple[float, float], rows: int = 1, columns: int = 1, grid: Mapping[str, Any] | None = None, **margins: float
) -> tuple[Figure, Any]:
    """A figure of a size in inches with a grid of axes; ``grid``: as of `Figure.subplots`, margins as shares of it."""
    figure = Figure(figsize=size)
    panels = figure.subplots(rows, columns, **(grid or {}))
    figure.subplots_adjust(**margins)
    return figure, panels


def report_figure(
    figure: Figure,
    name: str,
    title: str,
    caption: str,
    wide: bool = False,
    label: str = "",
    legend: int = 0,
    **look: Any,
) -> ReportFigure:
    """A figure for the report.

    Args:
        figure: drawn.
        name: anchor on the page.
        title: heading.
        caption: below it.
        wide: whether it takes the width of the page.
        label: what the figure shows for readers who do not see it; empty = its caption.
        legend: columns of a legend of the first axes, below all axes; 0 = none.
        **look: of the legend.
    """
    if legend:
        handles, labels = figure.axes[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="lower center", ncols=legend, **look)
    return ReportFigure(name, title, caption, svg_text(figure, name, label or caption), wide)
