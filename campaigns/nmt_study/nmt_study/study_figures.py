"""Figures of studies: properties over modal amplitude for several cases, with their references."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure

from nmt_core.numerics.arrays import FloatArray
from nmt_core.vocabulary import PointStatus
from nmt_report.backbone_figures import decade_ticks
from nmt_report.figure_parts import plot_panels, report_figure
from nmt_report.quantity_format import significant
from nmt_report.svg import BLUE, GREEN, INK, MUTED, ORANGE, RED, ReportFigure, svg_text
from nmt_study.study import Result

if TYPE_CHECKING:
    from matplotlib.axes import Axes


Q_LABEL = r"modal amplitude $q$ / (m$\sqrt{\mathrm{kg}}$)"
COLOURS = (BLUE, ORANGE, GREEN, RED, "#6b4fa0", "#2a8c98", "#9a7b1c", MUTED)
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*")
_SIZE = (6.3, 4.4)


def title_of(result: Result) -> str:
    """How the case is called."""
    return str(result["case"]["title"])


def measured(result: Result, name: str) -> FloatArray:
    """One value for each level that gave a modal point."""
    rows = [row for row in result["levels"] if row["status"] == PointStatus.OK]
    values = [row.get(name) for row in rows]
    return np.array([math.nan if value is None else value for value in values], dtype=np.float64)


def participation(result: Result, mode: int) -> Any:
    """Γ of a linear mode (from 0) for each level that gave a modal point; complex."""
    rows = [row for row in result["levels"] if row["status"] == PointStatus.OK]
    return np.array([complex(r["participation_real"][mode], r["participation_imag"][mode]) for r in rows])


def linear_frequency(result: Result) -> float:
    """Linear frequency of the target mode, rad/s."""
    linear = result["linear"]
    return float(linear["frequencies_rad_s"][linear["target_mode"]])


def backbone_figures(
    prefix: str, results: Sequence[Result], what: str, epmc_of_each: bool = False
) -> list[ReportFigure]:
    """ω̃* and δ̃ over q for several cases, with EPMC.

    Args:
        prefix: anchor of the figures.
        results: cases in their order.
        what: what distinguishes the cases, for titles.
        epmc_of_each: the cases have different structures, so each has its own EPMC; else one is drawn.
    """
    figures = []
    for name, title, label, factor in (
        ("omega_rad_s", "Natural frequency", r"$\tilde\omega^* = \tilde\omega / \omega_1$", None),
        ("damping_ratio", "Damping ratio", r"$\tilde\delta$ / %", 100.0),
    ):
        figure, axes = plot_axes()
        drawn = False
        for k, result in enumerate(results):
            scale = 1.0 / linear_frequency(result) if factor is None else factor
            epmc = result["epmc"]
            if not epmc["failure"] and (epmc_of_each or not drawn):
                colour = COLOURS[k % len(COLOURS)] if epmc_of_each else INK
                axes.plot(
                    epmc["modal_amplitude"],
                    scale * np.array(epmc[name]),
                    color=colour,
                    linewidth=1.2,
                    label=None if epmc_of_each else "EPMC (harmonic balance)",
                )
                drawn = True
            curve = result["single_point"]["curve"]
            if curve:
                axes.plot(
                    curve["modal_amplitude"],
                    scale * np.array(curve[name]),
                    color=COLOURS[k % len(COLOURS)],
                    linewidth=0.9,
                    linestyle=(0, (1.5, 1.5)),
                )
        for k, result in enumerate(results):
            scale = 1.0 / linear_frequency(result) if factor is None else factor
            draw_points(axes, k, measured(result, "modal_amplitude"), scale * measured(result, name), title_of(result))
        axes.set_ylabel(label)
        if factor is not None:
            axes.set_ylim(bottom=0.0)
        finish_q(axes, [measured(result, "modal_amplitude") for result in results])
        caption = (
            f"{title} over modal amplitude for {what}: points are measured, full lines the EPMC reference, "
            "dotted lines what a perfect single-point test would measure."
        )
        key = "omega" if factor is None else "damping"
        figures.append(report_figure(figure, f"{prefix}-{key}", f"{title}: {what}", caption))
    return figures


def error_figures(prefix: str, results: Sequence[Result], rows: Callable[[Result], Any], what: str) -> ReportFigure:
    """Relative errors of ω̃ and δ̃ against the single-point reference and the EPMC over q.

    Args:
        prefix: anchor of the figure.
        results: cases in their order.
        rows: table rows of a result.
        what: what distinguishes the cases.
    """
    figure, panels = plot_panels(
        (6.3, 5.4), 2, 2, {"sharex": True}, left=0.12, right=0.98, bottom=0.2, top=0.94, hspace=0.16, wspace=0.3
    )
    columns = (("single_point", "error of the test"), ("epmc", "error of the method"))
    for column, (reference, title) in enumerate(columns):
        for line, (quantity, symbol, floor) in enumerate(
            (
                ("omega", r"$|\Delta\tilde\omega|/\tilde\omega$ / %", 1e-5),
                ("damping", r"$|\Delta\tilde\delta|/\tilde\delta$ / %", 1e-4),
            )
        ):
            axes = panels[line][column]
            for k, result in enumerate(results):
                good = [row for row in rows(result) if row[f"{quantity}_error_{reference}"] is not None]
                q = np.array([row["modal_amplitude"] for row in good])
                error = np.array([100.0 * abs(row[f"{quantity}_error_{reference}"]) for row in good])
                draw_points(axes, k, q, np.maximum(error, floor), title_of(result), size=3.2)
            axes.set_yscale("log")
            if reference == "single_point":
                limit = 0.1 if quantity == "omega" else 2.0
                axes.axhline(limit, color=RED, linewidth=0.9, linestyle=(0, (4, 3)))
            axes.set_ylabel(symbol)
            if line == 0:
                axes.set_title(title)
    q_all = [measured(result, "modal_amplitude") for result in results]
    for axes in panels[1]:
        axes.set_xlabel(Q_LABEL)
        log_q(axes, q_all)
    handles, labels = panels[0][0].get_legend_handles_labels()
    # As many columns as the longest label leaves room for.
    legend_columns = max(1, min(4, 90 // (max(map(len, labels), default=1) + 5)))
    figure.subplots_adjust(bottom=0.12 + 0.035 * math.ceil(len(labels) / legend_columns))
    figure.legend(handles, labels, loc="lower center", ncols=legend_columns)
    caption = Markup(
        "Relative errors at each level. Left: distance to the single-point reference at the same drive voltage, "
        "the error of the test (dashed: 0.1 % and 2 %). Right: distance to EPMC at the same <i>q</i>, the error of "
        "the method."
    )
    return ReportFigure(
        f"{prefix}-errors",
        f"Errors: {what}",
        caption,
        svg_text(figure, f"{prefix}-errors", "Errors over modal amplitude"),
    )


def plot_axes(height: float = _SIZE[1]) -> tuple[Figure, Axes]:
    """A figure with one set of axes."""
    return plot_panels((_SIZE[0], height), left=0.125, right=0.975, bottom=0.13, top=0.96)


def draw_points(axes: Axes, k: int, x: Any, y: Any, label: str, size: float = 4.2) -> None:
    """Points of the k-th case in its colour and marker."""
    axes.plot(
        x,
        y,
        linestyle="none",
        marker=MARKERS[k % len(MARKERS)],
        markersize=size,
        color=COLOURS[k % len(COLOURS)],
        label=label,
    )


def finish_q(axes: Axes, amplitudes: Sequence[Any]) -> None:
    """Logarithmic axis of q with its label, and the legend."""
    axes.set_xlabel(Q_LABEL)
    log_q(axes, amplitudes)
    axes.legend(loc="best")


def log_q(axes: Axes, amplitudes: Sequence[Any]) -> None:
    """Logarithmic axis over all amplitudes."""
    axes.set_xscale("log")
    good = np.concatenate([np.asarray(q, dtype=np.float64) for q in amplitudes] or [np.empty(0)])
    good = good[np.isfinite(good) & (good > 0)]
    if good.size:
        axes.set_xlim(good.min() / 1.5, good.max() * 1.5)
    decade_ticks(axes.xaxis, *axes.get_xlim())


def percent(value: float, digits: int = 2) -> str:
    """A ratio as a percentage."""
    return f"{significant(100.0 * value, digits)} %"
