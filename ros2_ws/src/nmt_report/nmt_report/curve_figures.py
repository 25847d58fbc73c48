"""Figure of measured response curves: response over frequency, the unstable branch dashed."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from nmt_extract.curves.force_surface import surface_sentences
from nmt_extract.curves.response_curve import ResponseCurve, curve_sentences, is_of_curve, response_curves
from nmt_report.figure_parts import plot_panels, report_figure
from nmt_report.quantity_format import significant
from nmt_report.response_page import ResponsePage, html_figures
from nmt_report.run_data import RunReportData
from nmt_report.svg import ReportFigure, figure_style, level_colours

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes

    from nmt_rig.response_reference import ReferenceResponse
    from nmt_rig.rig import Rig


def curve_figure(data: RunReportData) -> ReportFigure | None:
    """Response at the drive point over frequency, by curve; force over frequency where the response was held."""
    if not is_of_curve(data.points):
        return None
    curves = response_curves(data.points)
    held = all(curve.holds_force for curve in curves)
    figure, axes = plot_panels((6.3, 4.0), left=0.12, right=0.97, bottom=0.13, top=0.97)
    for curve, colour in zip(curves, level_colours(len(curves)), strict=True):
        _draw(axes, curve, colour)
    axes.set_xlabel("frequency / Hz")
    axes.set_ylabel("response at the drive point / m" if held else "force / N")
    axes.legend(loc="best")
    words = curve_sentences(curves)
    if held:
        words.append("Filled marks: stable in open loop, or left open; open marks, dashed: not stable.")
    else:
        words = ["Force that holds the response, over frequency.", *words, *surface_sentences(curves)]
    if any(curve.gaps.any() for curve in curves):
        words.append("No line is drawn across what was not held.")
    caption = " ".join(words)
    return report_figure(figure, "response-curve", "Response curves", caption, wide=True)


def _draw(axes: Axes, curve: ResponseCurve, colour: tuple[float, float, float]) -> None:
    y = curve.response if curve.holds_force else curve.force
    label = f"{significant(curve.level)} {curve.level_unit}"
    unstable = curve.stable == 0.0
    for first, last in zip(range(y.size - 1), range(1, y.size), strict=True):
        if curve.gaps[first]:
            continue
        dashed = bool(unstable[first] or unstable[last])
        pair = [first, last]
        axes.plot(curve.frequency_hz[pair], y[pair], "--" if dashed else "-", color=colour, linewidth=0.9)
    axes.plot(curve.frequency_hz[~unstable], y[~unstable], "o", color=colour, markersize=3, label=label)
    axes.plot(curve.frequency_hz[unstable], y[unstable], "o", color=colour, markersize=3, markerfacecolor="white")
    for fold in curve.folds:
        axes.errorbar(fold.frequency_hz, fold.response, fold.response_std, fold.frequency_hz_std, "k+")
    axes.ticklabel_format(axis="x", useOffset=False)
    axes.set_ylim(bottom=0.0, top=max(axes.get_ylim()[1], 1.05 * float(np.max(y))))


def reference_sentences(responses: Sequence[ReferenceResponse]) -> list[str]:
    """Folds, largest response and stability of computed response curves, one sentence a curve."""
    lines = []
    for item in responses:
        folds = " and ".join(f"{fold[0]:.4f} Hz" for fold in item.folds)
        tip = int(np.argmax(item.response))
        inner = 0 < tip < item.response.size - 1
        largest = f"its {'tip' if inner else 'largest response'} is {item.response[tip]:.4g} m"
        lines.append(
            f"At {item.force:g} N the curve has {f'folds at {folds}' if folds else 'no fold'}; {largest} "
            f"{'near' if inner else 'at the end of the band,'} {item.frequency_hz[tip]:.4f} Hz, and "
            f"{int(np.sum(~item.stable))} of {item.stable.size} points are not stable."
        )
    return lines


def reference_curve_page(rig: Rig, responses: Sequence[ReferenceResponse]) -> str:
    """The page of computed response curves."""
    with figure_style():
        figure, axes = plot_panels((6.3, 4.0), left=0.12, right=0.97, bottom=0.13, top=0.97)
        for item, colour in zip(responses, level_colours(len(responses)), strict=True):
            for stable, look in ((True, "-"), (False, "--")):
                shown = np.where(item.stable == stable, item.response, np.nan)
                label = f"{significant(item.force)} N" if stable else None
                axes.plot(item.frequency_hz, shown, look, color=colour, label=label)
            axes.plot(item.folds[:, 0], item.folds[:, 1], "k+")
        axes.set_xlabel("frequency / Hz")
        axes.set_ylabel("response at the drive point / m")
        axes.legend(loc="best")
        caption = " ".join(reference_sentences(responses)) + " Dashed: not stable; crosses: folds."
        drawn = report_figure(figure, "response-curve", "Response curves", caption, wide=True)
    page = ResponsePage(
        kicker="Computed response curves",
        heading=rig.name,
        subtitle=rig.description,
        verdict=("Periodic responses of the rig's model under a pure force (harmonic balance)", "good"),
        notices=[],
        facts=[("Forces", ", ".join(f"{significant(item.force)} N" for item in responses))],
        sections=[("curves", "Response over frequency", html_figures([drawn]))],
        footer="Harmonic balance with continuation; stability by Floquet multipliers, with friction by the folds. SI.",
    )
    return page.html()
