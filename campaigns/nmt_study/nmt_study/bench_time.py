"""Accuracy against bench time for four ways to test; 16 levels of the virtual beam driven at point 2."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from nmt_core.vocabulary import PointStatus
from nmt_report.figure_parts import plot_panels, report_figure
from nmt_report.svg import RED, ReportFigure
from nmt_study.case import StudyCase
from nmt_study.noise import noise_overrides
from nmt_study.study import Finding, Result, StudyOutput
from nmt_study.study_figures import COLOURS, MARKERS, percent
from nmt_study.study_table import level_rows, summary_row

TITLE = "Bench time"
LINEAR_FREQUENCY_HZ = 22.19
TARGET_PERIODS, TARGET_OMEGA, TARGET_DAMPING = 50.0, 1e-3, 3e-2

_STATIONARY = {"frequency_tolerance": 1.0, "amplitude_tolerance": 1.0}
_NLTEST = {
    **_STATIONARY,
    "phase_tolerance": math.radians(1.0),
    "scatter_limit": math.radians(1.0),
    "dwell_periods": 20.0,
}
_QUICK = {"dwell_periods": 5.0}

WAYS: dict[str, dict[str, Any]] = {
    "paper": {"title": "paper's loop, 11 s wait", "loop": "paper", "ramp": 0.5, "windows": (50, 200)},
    "nltest": {"title": "1° for 20 periods", "loop_values": _NLTEST, "ramp": 0.5, "windows": (20, 50, 100)},
    "stepped": {"title": "stepped (default)", "ramp": 0.5, "windows": (20, 50, 200)},
    "quick": {"title": "stepped, quick", "loop_values": _QUICK, "ramp": 0.1, "windows": (5, 10, 20)},
    "ramp": {"title": "ramp, balance of power", "strategy": "ramp", "ramp": 0.0, "windows": (20, 30, 40)},
}


def cases(quick: bool) -> list[StudyCase]:
    """Every way with several window lengths, without noise and with the low noise of the paper's table."""
    levels = tuple(float(f"{v:.6g}") for v in np.geomspace(0.05, 1.5, 4 if quick else 16))
    chosen = []
    for way, values in WAYS.items():
        for window in values["windows"][:1] if quick else values["windows"]:
            for noise in (0.0,) if quick else (0.0, 1.0):
                chosen.append(
                    StudyCase(
                        name=f"{way}_{window}" + ("_noise" if noise else ""),
                        title=f"{values['title']}, {window} periods" + (", noise" if noise else ""),
                        exciter=2,
                        levels=levels,
                        overrides=noise_overrides(noise),
                        loop=values.get("loop", "adaptive"),
                        loop_values=values.get("loop_values", {}),
                        extract_values=values.get("extract_values", {}),
                        strategy=values.get("strategy", "stepped"),
                        window_periods=window,
                        ramp=values["ramp"] or window / LINEAR_FREQUENCY_HZ,
                        epmc=False,
                        labels={"way": way, "window": window, "noise": "low" if noise else "none"},
                    )
                )
    return chosen


def show(results: Sequence[Result]) -> StudyOutput:
    """Figures and findings."""
    return StudyOutput([_accuracy_figure(results), _loop_figure(results)], list(_findings(results)), _REMARKS)


_REMARKS = (
    "Periods per level: excitation periods from the start of a level to that of the next, everything included, mean of "
    "16 levels from 0.05 to 1.5 V. Errors: largest over the levels, against the single-point reference.",
    "“1° for 20 periods” uses the default loop with the rule that mean and scatter of the phase error stay within 1° "
    "over 20 periods, and no other condition; the published tool works on hardware with its own loop.",
    "“ramp”: windows during ramps that last as long as the windows; the amplitude lags behind the voltage, so errors "
    "are taken at the measured q. In slip damping comes out low in proportion to the rate: hysteresis stores less "
    "than an elastic mode of growing amplitude.",
    "“quick”: default criteria over a dwell of 5 periods and ramps of 0.1 s.",
)


def _accuracy_figure(results: Sequence[Result]) -> ReportFigure:
    figure, panels = plot_panels((9.6, 4.4), 1, 2, left=0.08, right=0.985, bottom=0.29, top=0.94, wspace=0.24)
    ways = list(dict.fromkeys(result["case"]["labels"]["way"] for result in results))
    for axes, column, target, label in (
        (panels[0], 0, TARGET_OMEGA, r"largest error of $\tilde\omega$ / %"),
        (panels[1], 1, TARGET_DAMPING, r"largest error of $\tilde\delta$ / %"),
    ):
        for k, way in enumerate(ways):
            for noise in ("none", "low"):
                rows = [
                    _summary(r)
                    for r in results
                    if r["case"]["labels"]["way"] == way and r["case"]["labels"]["noise"] == noise
                ]
                rows = sorted((row for row in rows if row.locked), key=lambda row: row.periods)
                if not rows:
                    continue
                axes.plot(
                    [row.periods for row in rows],
                    [max(1e-5, 100.0 * row.single_point[column]) for row in rows],
                    linestyle="-" if noise == "none" else (0, (1.5, 1.5)),
                    marker=MARKERS[k],
                    markersize=5.0,
                    markerfacecolor=COLOURS[k] if noise == "none" else "white",
                    color=COLOURS[k],
                    linewidth=0.8,
                    label=_way_title(way) + ("" if noise == "none" else ", low noise"),
                )
        axes.axhline(100.0 * target, color=RED, linewidth=0.9, linestyle=(0, (4, 3)))
        axes.axvline(TARGET_PERIODS, color=RED, linewidth=0.9, linestyle=(0, (4, 3)))
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_xticks([20, 50, 100, 200, 500], ["20", "50", "100", "200", "500"])
        axes.minorticks_off()
        axes.set_xlabel("periods per level")
        axes.set_ylabel(label)
    caption = (
        "Accuracy against periods per level; each way with several window lengths. Dashed: the target of 50 periods, "
        "0.1 % and 3 %. Open markers: sensor noise of the paper's low level."
    )
    return report_figure(figure, "bench-time", "Accuracy against bench time", caption, True, legend=4, fontsize=7.5)


def _loop_figure(results: Sequence[Result]) -> ReportFigure:
    """The loops side by side: time to lock, overshoot, residual phase error of each level."""
    figure, panels = plot_panels((9.6, 3.9), 1, 3, left=0.07, right=0.985, bottom=0.27, top=0.94, wspace=0.33)
    chosen = [r for r in results if r["case"]["labels"]["noise"] == "none"]
    last = {r["case"]["labels"]["way"]: r for r in chosen}
    columns = (
        ("time_to_lock_s", 1.0, "time to lock / s", 1e-2),
        ("overshoot", 100.0, "frequency overshoot / %", 1e-5),
        ("phase_error", math.degrees(1.0), "residual phase error / °", 1e-5),
    )
    for axes, (name, factor, label, floor) in zip(panels, columns, strict=True):
        for k, (way, result) in enumerate(last.items()):
            rows = [r for r in result["levels"] if r["status"] == PointStatus.OK and r.get(name) is not None]
            axes.plot(
                [r["level"] for r in rows],
                [max(floor, abs(factor * r[name])) for r in rows],
                marker=MARKERS[k],
                markersize=4.0,
                linewidth=0.7,
                color=COLOURS[k],
                label=_way_title(way),
            )
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_xlabel("level / V")
        axes.set_ylabel(label)
    caption = (
        "The loops on the same levels: time from the start of a level to its lock, overshoot, residual phase error."
    )
    return report_figure(figure, "loops", "Loops side by side", caption, True, legend=4)


def _ramp_finding(result: Result) -> Finding:
    rows = [r for r in level_rows("bench_time", result) if r["damping_error_single_point"] is not None]
    good = [
        r
        for r in rows
        if abs(r["omega_error_single_point"]) <= TARGET_OMEGA and abs(r["damping_error_single_point"]) <= TARGET_DAMPING
    ]
    omega = float(np.median([abs(r["omega_error_single_point"]) for r in rows]))
    damping = float(np.median([abs(r["damping_error_single_point"]) for r in rows]))
    return Finding(
        f"{_summary(result).case}: accuracy of windows without waiting.",
        f"{_summary(result).periods:.1f} periods per level; {len(good)} of {len(rows)} levels within 0.1 % and 3 %; "
        f"median error ω̃ {percent(omega)}, δ̃ {percent(damping)}",
        len(good) == len(rows),
    )


def _way_title(way: str) -> str:
    return str(WAYS[way]["title"])


def _summary(result: Result) -> Any:
    return summary_row(result, level_rows("bench_time", result))


def _findings(results: Sequence[Result]) -> Iterator[Finding]:
    for result in results:
        row = _summary(result)
        if row.locked < row.levels:
            text = f"{row.locked} of {row.levels} levels: {row.note}"
            yield Finding(row.case, text, False)
    ours = [r for r in results if r["case"]["labels"]["way"] in ("quick", "ramp")]
    rows = [_summary(r) for r in ours if r["case"]["labels"]["noise"] == "none"]
    rows = [
        row
        for row in rows
        if row.locked == row.levels and row.single_point[0] <= TARGET_OMEGA and row.single_point[1] <= TARGET_DAMPING
    ]
    yield from [_ramp_finding(r) for r in ours if r["case"]["labels"]["way"] == "ramp"]
    best = min(rows, key=lambda row: row.periods) if rows else None
    yield Finding(
        "At most 50 periods per level at 0.1 % of ω̃ and 3 % of δ̃.",
        f"{best.case}: {best.periods:.1f} periods per level, ω̃ {percent(best.single_point[0])}, δ̃ "
        f"{percent(best.single_point[1])}"
        if best
        else "no way meets it",
        best is not None and best.periods <= TARGET_PERIODS,
    )
