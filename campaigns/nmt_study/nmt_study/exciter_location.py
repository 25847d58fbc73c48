"""Influence of the exciter's location (paper, section 3.1)."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np

from nmt_report.figure_parts import plot_panels, report_figure
from nmt_report.svg import ReportFigure
from nmt_study.case import StudyCase
from nmt_study.case_reference import levels_for_amplitudes
from nmt_study.study import Finding, Result, StudyOutput
from nmt_study.study_figures import (
    COLOURS,
    Q_LABEL,
    backbone_figures,
    draw_points,
    error_figures,
    finish_q,
    log_q,
    measured,
    participation,
    percent,
    plot_axes,
    title_of,
)
from nmt_study.study_table import level_rows, summary_row

TITLE = "Influence of the exciter location"
POINTS = (2, 4, 5, 6)
AMPLITUDES = (3e-5, 6e-4)
_TALL = (6.3, 4.6)
_MARGINS = {"left": 0.125, "right": 0.975, "bottom": 0.12, "top": 0.96, "hspace": 0.12}


def cases(quick: bool) -> list[StudyCase]:
    """One test for each drive point, over the same range of modal amplitudes."""
    amplitudes = np.geomspace(*AMPLITUDES, 3 if quick else 12)
    return [
        StudyCase(
            name=f"point_{point}",
            title=f"point {point}",
            exciter=point,
            levels=levels_for_amplitudes((), point, amplitudes),
            window_periods=20 if quick else 200,
            labels={"exciter": point},
        )
        for point in ((2, 6) if quick else POINTS)
    ]


def show(results: Sequence[Result]) -> StudyOutput:
    """Figures and findings."""
    figures = backbone_figures("exciter", results, "drive points")
    figures += [_participation_figure(result) for result in results if result["case"]["exciter"] in (2, 6)]
    figures.append(_pbmif_figure(results))
    figures.append(_gamma_figure(results))
    figures.append(error_figures("exciter", results, lambda r: level_rows("exciter_location", r), "drive points"))
    return StudyOutput(figures, list(_findings(results)))


def _participation_figure(result: Result) -> ReportFigure:
    point = result["case"]["exciter"]
    q = measured(result, "modal_amplitude")
    figure, (magnitude, phase) = plot_panels(_TALL, 2, 1, {"sharex": True, "height_ratios": (2, 1)}, **_MARGINS)
    epmc = result["epmc"]
    for mode in range(2):
        gamma = participation(result, mode)
        draw_points(magnitude, mode, q, np.abs(gamma), f"linear mode {mode + 1}")
        draw_points(phase, mode, q, np.degrees(np.angle(gamma)), "")
        if not epmc["failure"]:
            reference = (
                np.array(epmc["participation_real"])[:, mode] + 1j * np.array(epmc["participation_imag"])[:, mode]
            )
            magnitude.plot(epmc["modal_amplitude"], np.abs(reference), color=COLOURS[mode], linewidth=1.0)
    magnitude.set_yscale("log")
    magnitude.set_ylabel(r"$|\Gamma|$")
    magnitude.legend(loc="best")
    phase.set_ylabel(r"$\arg\Gamma$ / °")
    phase.set_ylim(-195, 195)
    phase.set_yticks((-180, -90, 0, 90, 180))
    phase.set_xlabel(Q_LABEL)
    log_q(phase, [q])
    caption = f"Participation of the linear modes, drive at point {point}; lines: EPMC."
    name = f"participation-{point}"
    return report_figure(figure, name, f"Modal participation, point {point}", caption)


def _pbmif_figure(results: Sequence[Result]) -> ReportFigure:
    figure, axes = plot_axes()
    for k, result in enumerate(results):
        curve = result["single_point"]["curve"]
        if curve:
            axes.plot(curve["modal_amplitude"], curve["pbmif"], color=COLOURS[k], linewidth=0.9, linestyle=":")
        draw_points(axes, k, measured(result, "modal_amplitude"), measured(result, "pbmif"), title_of(result))
    axes.set_ylabel("PBMIF")
    finish_q(axes, [measured(result, "modal_amplitude") for result in results])
    caption = "Power-based mode indicator |P|/S; dotted: the single-point reference."
    return report_figure(figure, "pbmif", "PBMIF", caption)


def _gamma_figure(results: Sequence[Result]) -> ReportFigure:
    figure, panels = plot_panels(_TALL, 2, 1, {"sharex": True}, **_MARGINS)
    names = (("gamma_force", r"$\gamma_F$"), ("gamma_acceleration", r"$\gamma_A$"))
    for axes, (name, label) in zip(panels, names, strict=True):
        for k, result in enumerate(results):
            curve = result["single_point"]["curve"]
            if curve:
                axes.plot(curve["modal_amplitude"], curve[name], color=COLOURS[k], linewidth=0.9, linestyle=":")
            draw_points(axes, k, measured(result, "modal_amplitude"), measured(result, name), title_of(result))
        axes.set_ylabel(label)
    panels[0].legend(loc="best")
    panels[1].set_xlabel(Q_LABEL)
    log_q(panels[1], [measured(result, "modal_amplitude") for result in results])
    caption = "Fundamental content of force and drive-point acceleration; dotted: the single-point reference."
    return report_figure(figure, "gamma", "Fundamental content", caption)


def _findings(results: Sequence[Result]) -> Iterator[Finding]:
    rows = {r["case"]["exciter"]: level_rows("exciter_location", r) for r in results}
    summary = {r["case"]["exciter"]: summary_row(r, rows[r["case"]["exciter"]]) for r in results}
    omega = {point: row.epmc[0] for point, row in summary.items()}
    damping = {point: row.epmc[1] for point, row in summary.items()}
    yield Finding(
        "The results agree well with the numerical reference for all drive points.",
        "largest distance to EPMC "
        + ", ".join(f"point {p}: f̃ {percent(omega[p])}, δ̃ {percent(damping[p])}" for p in summary),
        all(value < 0.01 for value in omega.values()),
    )
    near = [p for p in (2, 4) if p in summary]
    far = [p for p in (5, 6) if p in summary]
    if near and far:
        rms = {p: _rms(row["damping_error_epmc"] for row in rows[p]) for p in summary}
        yield Finding(
            "With the exciter at points 5 or 6 the accuracy is slightly lower.",
            "root mean square of the distance of δ̃ to EPMC "
            + ", ".join(f"point {p}: {percent(rms[p])}" for p in rms)
            + f"; best at point {min(rms, key=lambda p: rms[p])}",
            min(rms[p] for p in far) > max(rms[p] for p in near),
        )
    second = {p: max(row["participation_2"] or 0.0 for row in rows[p]) for p in summary}
    yield Finding(
        "The contribution of the second mode is negligible.",
        "largest |Γ₂| " + ", ".join(f"point {p}: {value:.3f}" for p, value in second.items()),
        max(second.values()) < 0.1,
    )
    lowest = {p: min(row["pbmif"] for row in rows[p] if row["pbmif"] is not None) for p in summary}
    if 6 in lowest and len(lowest) > 1:
        yield Finding(
            "The PBMIF deviates considerably from one at point 6.",
            "lowest PBMIF " + ", ".join(f"point {p}: {value:.4f}" for p, value in lowest.items()),
            lowest[6] == min(lowest.values()),
        )
    gamma = {p: min(row["gamma_force"] for row in rows[p] if row["gamma_force"] is not None) for p in summary}
    ordered = [gamma[p] for p in sorted(gamma)]
    yield Finding(
        "Higher harmonics of the force are stronger the nearer the shaker is to the free end.",
        "lowest γ_F " + ", ".join(f"point {p}: {value:.4f}" for p, value in gamma.items()),
        all(a >= b for a, b in pairwise(ordered)),
    )


def _rms(values: object) -> float:
    numbers = [value for value in values if value is not None]  # type: ignore[attr-defined]
    return math.sqrt(sum(value**2 for value in numbers) / len(numbers)) if numbers else math.nan
