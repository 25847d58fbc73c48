"""Increasing influence of the nonlinearity (paper, section 3.4): stiffer joints, locks on the second mode."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.vocabulary import PointStatus
from nmt_report.figure_parts import report_figure
from nmt_report.svg import MUTED, ReportFigure
from nmt_rig.model.linear_modes import sticking_modes
from nmt_rig.rig import load_rig
from nmt_rig.rig_model import build_structure
from nmt_study.case import JOINT_KEY, StudyCase
from nmt_study.case_reference import levels_for_amplitudes
from nmt_study.case_timing import loop_history
from nmt_study.study import Finding, Result, StudyOutput
from nmt_study.study_figures import (
    COLOURS,
    backbone_figures,
    error_figures,
    linear_frequency,
    percent,
    plot_axes,
    title_of,
)
from nmt_study.study_table import level_rows, summary_row

TITLE = "Increasing influence of the nonlinearity"
AMPLITUDES = (1e-5, 1e-3)
LOW_STIFFNESSES = (8e3, 20e3, 50e3, 100e3)
HIGH_STIFFNESSES = (200e3, 500e3)
PAPER_GAIN = 30.0 * math.pi
FROM_BELOW = (0.1, 0.3, 0.6, 1.5, 5.0)
FROM_ABOVE = (5.0, 3.5, 2.5, 1.8, 1.3, 1.0, 0.85, 0.7)


def cases(quick: bool) -> list[StudyCase]:
    """Point 2 with moderate joints, point 6 with stiff ones, and the locks on the second mode."""
    periods = 20 if quick else 200
    count = 3 if quick else 10
    chosen = [_upwards(stiffness, 2, periods, count) for stiffness in ((20e3,) if quick else LOW_STIFFNESSES[:3])]
    if not quick:
        chosen += [_downwards(stiffness, periods) for stiffness in (100e3, *HIGH_STIFFNESSES)]
    chosen += [_upwards(stiffness, 6, periods, count) for stiffness in ((500e3,) if quick else HIGH_STIFFNESSES)]
    for loop in ("paper", "adaptive"):
        for stiffness in (500e3,) if quick else (100e3, *HIGH_STIFFNESSES):
            chosen.append(_from_first_mode(stiffness, loop, periods, FROM_BELOW[-1:] if quick else FROM_BELOW))
    return chosen


def _override(stiffness: float) -> tuple[str, ...]:
    return (f"{JOINT_KEY}={stiffness:g}",)


def _upwards(stiffness: float, point: int, periods: int, count: int) -> StudyCase:
    overrides = _override(stiffness)
    try:
        levels = levels_for_amplitudes(overrides, point, np.geomspace(*AMPLITUDES, count))
    except BenchError:
        levels = tuple(np.geomspace(0.05, 10.0, count).round(4).tolist())
    return StudyCase(
        name=f"point_{point}_kt_{stiffness / 1e3:g}",
        title=f"{stiffness / 1e3:g} kN/m, point {point}",
        exciter=point,
        levels=levels,
        overrides=overrides,
        window_periods=periods,
        harmonics=21,
        labels={"joint": f"{stiffness / 1e3:g} kN/m", "group": f"point {point}"},
    )


def start_near_slip() -> dict[str, float]:
    """Loop settings that start a little above the frequency of full slip."""
    structure = build_structure(load_rig("beam"))
    slipping = float(sticking_modes(structure, (), 1).frequencies[0])
    return {"start_frequency_hz": 1.05 * slipping / (2.0 * math.pi)}


def _downwards(stiffness: float, periods: int) -> StudyCase:
    """From the highest level down, started near the frequency of full slip: there the mode can be driven at point 2."""
    return StudyCase(
        name=f"point_2_kt_{stiffness / 1e3:g}_from_above",
        title=f"{stiffness / 1e3:g} kN/m, point 2, from above",
        exciter=2,
        levels=FROM_ABOVE,
        overrides=_override(stiffness),
        loop_values=start_near_slip(),
        window_periods=periods,
        harmonics=21,
        labels={"joint": f"{stiffness / 1e3:g} kN/m", "group": "point 2"},
    )


def _from_first_mode(stiffness: float, loop: str, periods: int, levels: Sequence[float]) -> StudyCase:
    which = "paper's loop" if loop == "paper" else "default loop"
    return StudyCase(
        name=f"point_2_kt_{stiffness / 1e3:g}_{loop}_from_first_mode",
        title=f"{stiffness / 1e3:g} kN/m, {which} from mode 1",
        exciter=2,
        levels=tuple(levels),
        overrides=_override(stiffness),
        loop=loop,
        loop_values={"paper_gain": PAPER_GAIN} if loop == "paper" else {},
        window_periods=min(periods, 100),
        # The paper's loop moves by some 20 rad/s in a second and is a long way from home.
        timeout=90.0 if loop == "paper" else 20.0,
        epmc=False,
        labels={"joint": f"{stiffness / 1e3:g} kN/m", "group": "started at mode 1"},
    )


def evaluate(case: StudyCase, bag: Path) -> dict[str, Any]:
    """Course of the frequency where a lock on another mode is looked for."""
    return {"history": loop_history(bag, 600)} if _is_mode_hunt(case.name) else {}


def _is_mode_hunt(name: str) -> bool:
    return name.endswith("from_first_mode")


def show(results: Sequence[Result]) -> StudyOutput:
    """Figures and findings."""
    tests = [r for r in results if not _is_mode_hunt(r["case"]["name"])]
    hunts = [r for r in results if _is_mode_hunt(r["case"]["name"])]
    low = [r for r in tests if r["case"]["exciter"] == 2]
    high = [r for r in tests if r["case"]["exciter"] == 6]
    figures = []
    if low:
        figures += backbone_figures("kt-2", low, "joints, drive at point 2", epmc_of_each=True)
    if high:
        figures += backbone_figures("kt-6", high, "joints, drive at point 6", epmc_of_each=True)
    figures += [_history_figure(result) for result in hunts]
    figures.append(error_figures("kt", tests, lambda r: level_rows("joint_stiffness", r), "joints"))
    return StudyOutput(figures, list(_findings(tests, hunts)), _REMARKS)


_REMARKS = (
    "With the identified cross-section the drive point 2 has no phase resonance of mode 1 in the sticking range from "
    "100 kN/m on: residual flexibility of the other modes covers the weak first mode there. The mode is reached from "
    "the slipping range instead, level by level downwards.",
    "Where the EPMC backbone folds over q (from 50 kN/m on), its first crossing is given; folded ranges do not count "
    "in the summary.",
)


def _history_figure(result: Result) -> ReportFigure:
    name = result["case"]["name"].replace("_", "-")
    history = result["extra"]["history"]
    time = np.array(history["time_s"], dtype=np.float64)
    omega = np.array([math.nan if v is None else v for v in history["omega_rad_s"]], dtype=np.float64)
    figure, axes = plot_axes(3.6)
    axes.plot(time, omega, color=COLOURS[0], linewidth=1.1)
    for mode, frequency in enumerate(result["linear"]["frequencies_rad_s"][:2]):
        axes.axhline(frequency, color=MUTED, linewidth=0.9, linestyle=(0, (4, 3)))
        axes.annotate(
            f"linear mode {mode + 1}",
            (0.995, frequency),
            xycoords=("axes fraction", "data"),
            xytext=(0, 2),
            textcoords="offset points",
            ha="right",
            fontsize=8,
            color=MUTED,
        )
    locked = np.array(history["state"]) == 3
    axes.plot(time[locked], omega[locked], ".", color=COLOURS[2], markersize=3.5, label="locked")
    axes.set_ylim(bottom=0.0)
    axes.set_xlabel("bench time / s")
    axes.set_ylabel(r"excitation frequency $\Omega$ / (rad/s)")
    axes.legend(loc="best")
    caption = f"Excitation frequency over the run: {title_of(result)}; gaps: the drive is off after a lost lock."
    return report_figure(figure, name, f"Course of the frequency: {title_of(result)}", caption)


def _findings(tests: Sequence[Result], hunts: Sequence[Result]) -> Iterator[Finding]:
    for result in tests:
        row = summary_row(result, level_rows("joint_stiffness", result))
        highest = max((r["damping_ratio"] for r in result["levels"] if r["status"] == PointStatus.OK), default=math.nan)
        lowest = min((r["omega_rad_s"] for r in result["levels"] if r["status"] == PointStatus.OK), default=math.nan)
        shift = 1.0 - lowest / linear_frequency(result)
        yield Finding(
            f"{row.case}: modal properties can be extracted.",
            f"{row.locked} of {row.levels} levels; damping up to {percent(highest, 3)}, frequency down by "
            f"{percent(shift, 3)}; error of the test ω̃ {percent(row.single_point[0])}, δ̃ "
            f"{percent(row.single_point[1])}; of the method (single-valued range) ω̃ {percent(row.epmc[0])}, δ̃ "
            f"{percent(row.epmc[1])}",
            row.locked > 0,
        )
    for result in hunts:
        first, second = (result["linear"]["frequencies_rad_s"] + [math.nan])[:2]
        good = [r for r in result["levels"] if r["status"] == PointStatus.OK]
        elsewhere = [r for r in good if r["omega_rad_s"] > 1.2 * first]
        lost = len(result["levels"]) - len(good)
        reason = next((r["reason"].rstrip(".") for r in result["levels"] if r["status"] != PointStatus.OK), "none")
        if result["case"]["loop"] == "paper":
            yield Finding(
                f"{title_of(result)}: the loop locks on the second mode although started at the first.",
                f"{len(elsewhere)} of {len(result['levels'])} levels locked far above mode 1"
                + (f", at {elsewhere[-1]['omega_rad_s']:.0f} rad/s" if elsewhere else "")
                + f" (linear modes: {first:.0f}, {second:.0f} rad/s); {lost} levels not locked",
                bool(elsewhere),
            )
        else:
            yield Finding(
                f"{title_of(result)}: the guard band keeps a lock on another mode from being reported.",
                f"{lost} of {len(result['levels'])} levels refused ({reason}); {len(elsewhere)} locked above mode 1",
                not elsewhere,
            )
