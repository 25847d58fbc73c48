"""Control of the force's harmonics: how much of the method's error it takes away, and what PBMIF and γ_F tell of it.

The paper names uncontrolled harmonics of the force as a limit of the method, and uses PBMIF as an indicator of how well
a mode is isolated. Here the same levels are tested with a sine of voltage, with the force's harmonics at zero, and with
the harmonics that modal power needs.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.numerics.arrays import FloatArray
from nmt_report.figure_parts import plot_panels, report_figure
from nmt_report.svg import INK, ReportFigure
from nmt_study.case import JOINT_KEY, StudyCase
from nmt_study.case_reference import levels_for_amplitudes
from nmt_study.joint_stiffness import FROM_ABOVE, start_near_slip
from nmt_study.study import Finding, Result, StudyOutput, StudyTable
from nmt_study.study_figures import COLOURS, Q_LABEL, draw_points, log_q, measured, percent
from nmt_study.study_table import level_rows, summary_row

TITLE = "Control of the force harmonics"
POINTS = (2, 4, 5, 6)
STIFFNESSES = (8e3, 20e3, 100e3)
TARGETS = ("off", "force", "modal")
AMPLITUDES = (3e-5, 8e-4)
_LEAST = 1e-5  # 1 - PBMIF and 1 - γ_F that are told from nothing
_LEAST_ERROR = 3e-4
_MARKS = {"off": 0, "force": 1, "modal": 2}


def cases(quick: bool) -> list[StudyCase]:
    """Every drive point and joint with each target, at the same voltages."""
    points, stiffnesses = ((2,), STIFFNESSES[:1]) if quick else (POINTS, STIFFNESSES)
    count, periods = (4, 20) if quick else (12, 60)
    return [
        _case(point, stiffness, target, levels, periods)
        for stiffness in stiffnesses
        for point in points
        for levels in [_levels(point, stiffness, count)]
        for target in TARGETS
    ]


def _overrides(stiffness: float) -> tuple[str, ...]:
    return (f"{JOINT_KEY}={stiffness:g}", "extraction.linear_modes=3")


def _levels(point: int, stiffness: float, count: int) -> tuple[float, ...]:
    if point == 2 and stiffness >= 100e3:
        return FROM_ABOVE  # no phase resonance of mode 1 there while the joint sticks
    try:
        return levels_for_amplitudes(_overrides(stiffness), point, np.geomspace(*AMPLITUDES, count))
    except BenchError:
        return tuple(np.geomspace(0.05 if point == 2 else 0.3, 10.0, count).round(4).tolist())


def _case(point: int, stiffness: float, target: str, levels: tuple[float, ...], periods: int) -> StudyCase:
    controlled = target != "off"
    return StudyCase(
        name=f"point_{point}_kt_{stiffness / 1e3:g}_{target}",
        title=f"{stiffness / 1e3:g} kN/m, point {point}, {target}",
        exciter=point,
        levels=levels,
        overrides=_overrides(stiffness),
        harmonics_control="auto" if controlled else 0,
        harmonics_target=target if controlled else "force",
        window_periods=periods,
        loop_values=start_near_slip() if levels == FROM_ABOVE else {},
        harmonics=21,
        labels={"joint": f"{stiffness / 1e3:g} kN/m", "exciter": point, "target": target},
    )


@dataclass(frozen=True)
class Rule:
    """log₁₀|error of δ̃| = intercept + slope log₁₀(1 − indicator), fitted by least squares.

    Attributes:
        slope, intercept: of the line.
        scatter: standard deviation about it, decades.
        correlation: coefficient of both logarithms.
        count: number of windows.
    """

    slope: float
    intercept: float
    scatter: float
    correlation: float
    count: int


def fitted_rule(missing: Sequence[float] | FloatArray, error: Sequence[float] | FloatArray) -> Rule | None:
    """The rule of errors over what an indicator lacks to one; None for fewer than three windows.

    Args:
        missing: 1 - PBMIF or 1 - γ_F, shape (k,).
        error: |relative error of δ̃|, shape (k,).
    """
    x, y = np.asarray(missing, dtype=np.float64), np.asarray(error, dtype=np.float64)
    use = np.isfinite(x) & np.isfinite(y) & (x > _LEAST) & (y > _LEAST_ERROR)
    if np.count_nonzero(use) < 3 or np.ptp(x[use]) == 0.0:
        return None
    x, y = np.log10(x[use]), np.log10(y[use])
    slope, intercept = np.polyfit(x, y, 1)
    scatter = float(np.std(y - (intercept + slope * x), ddof=2))
    correlation = float(np.corrcoef(x, y)[0, 1]) if np.ptp(y) > 0.0 else math.nan
    return Rule(float(slope), float(intercept), scatter, correlation, int(x.size))


def show(results: Sequence[Result]) -> StudyOutput:
    """Figures, table and findings."""
    figures = [_error_figure(joint, group) for joint, group in _by_joint(results).items()]
    figures.append(_indicator_figure(results))
    return StudyOutput(figures, list(_findings(results)), _REMARKS, tables=[_table(results)])


_REMARKS = (
    "Target force: harmonics of the force at zero. Target modal: each harmonic gets the power that the extended "
    "periodic motion concept asks for, in the phase of the drive point's velocity, from three linear modes.",
    "Errors are those of the method against EPMC at the same modal amplitude, where EPMC is single-valued.",
    "With harmonics at their targets what is left comes from the place of the one exciter, whose fundamental drives "
    "the other modes as well.",
)


def _by_joint(results: Sequence[Result]) -> dict[str, list[Result]]:
    groups: dict[str, list[Result]] = {}
    for result in results:
        groups.setdefault(str(result["case"]["labels"]["joint"]), []).append(result)
    return groups


def _target(result: Result) -> str:
    return str(result["case"]["labels"]["target"])


def _rows(result: Result) -> list[dict[str, Any]]:
    return [row for row in level_rows("harmonic_control", result) if row["epmc_single_valued"]]


def _error_figure(joint: str, group: Sequence[Result]) -> ReportFigure:
    points = sorted({int(result["case"]["exciter"]) for result in group})
    figure, panels = plot_panels(
        (6.3, 1.7 * len(points) + 1.2), len(points), 1, {"sharex": True, "squeeze": False},
        left=0.125, right=0.975, bottom=0.14, top=0.97, hspace=0.14,
    )  # fmt: skip
    panels = np.asarray(panels).reshape(-1)
    for axes, point in zip(panels, points, strict=True):
        for result in group:
            if int(result["case"]["exciter"]) != point:
                continue
            rows = _rows(result)
            error = [max(100.0 * abs(row["damping_error_epmc"]), 1e-2) for row in rows]
            name = _target(result)
            draw_points(axes, _MARKS[name], np.array([row["modal_amplitude"] for row in rows]), np.array(error), name)
        axes.set_yscale("log")
        axes.set_ylabel(f"point {point}: " + r"$|\Delta\tilde\delta|/\tilde\delta$ / %")
    panels[0].legend(loc="best", ncols=3)
    panels[-1].set_xlabel(Q_LABEL)
    log_q(panels[-1], [measured(result, "modal_amplitude") for result in group])
    anchor = "harmonics-" + joint.split()[0].replace(".", "-")
    caption = f"Error of the damping ratio against EPMC, joint of {joint}: sine of voltage (off) and both targets."
    return report_figure(figure, anchor, f"Error of damping, {joint}", caption)


def _indicators(results: Sequence[Result], name: str, target: str) -> tuple[FloatArray, FloatArray]:
    """What an indicator lacks to one, and |error of δ̃|, of all windows with a target."""
    rows = [row for result in results if _target(result) == target for row in _rows(result)]
    missing = np.array([1.0 - row[name] for row in rows], dtype=np.float64)
    error = np.array([abs(row["damping_error_epmc"]) for row in rows], dtype=np.float64)
    return missing, error


def _indicator_figure(results: Sequence[Result]) -> ReportFigure:
    figure, panels = plot_panels((6.3, 3.4), 1, 2, {"sharey": True}, left=0.11, right=0.98, bottom=0.16, top=0.97)
    for axes, name, label in zip(panels, ("pbmif", "gamma_force"), ("1 − PBMIF", r"$1 - \gamma_F$"), strict=True):
        for target in TARGETS:
            missing, error = _indicators(results, name, target)
            axes.plot(
                np.maximum(missing, _LEAST), np.maximum(100.0 * error, 100.0 * _LEAST_ERROR), "o",
                color=COLOURS[_MARKS[target]], markersize=3.2, label=target,
            )  # fmt: skip
            rule = fitted_rule(missing, error)
            if rule is not None and target == "off":
                x = np.geomspace(max(float(missing.min()), _LEAST), float(missing.max()), 20)
                axes.plot(x, 100.0 * 10.0 ** (rule.intercept + rule.slope * np.log10(x)), color=INK, linewidth=0.9)
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_xlabel(label)
    panels[0].set_ylabel(r"$|\Delta\tilde\delta|/\tilde\delta$ / %")
    panels[0].legend(loc="best")
    caption = (
        "Error of the damping ratio against EPMC over what PBMIF and the fundamental content of the force lack to one, "
        "all windows of all cases; lines: rule fitted to the cases without control."
    )
    return report_figure(figure, "harmonics-indicators", "Do PBMIF and γ_F tell the accuracy?", caption)


def _table(results: Sequence[Result]) -> StudyTable:
    """Largest error of each drive point and joint by target."""
    rows = []
    for joint, group in _by_joint(results).items():
        for point in sorted({int(result["case"]["exciter"]) for result in group}):
            cells = [f"{joint}, point {point}"]
            for target in TARGETS:
                found = [r for r in group if r["case"]["exciter"] == point and _target(r) == target]
                row = summary_row(found[0], level_rows("harmonic_control", found[0])) if found else None
                cells += ["—"] * 3 if row is None else [
                    f"{row.locked}/{row.levels}", percent(row.epmc[0]), percent(row.epmc[1]),
                ]  # fmt: skip
            rows.append(cells)
    columns = [("Case", "")]
    for target in TARGETS:
        columns += [(f"{target}: levels", ""), (f"{target}: ω̃", ""), (f"{target}: δ̃", "")]
    return StudyTable(
        "Largest error against EPMC", columns, rows, "Levels: those that gave a modal point, of those of the plan."
    )


def _worst(results: Sequence[Result], target: str, joint: float) -> float:
    """Largest |error of δ̃| of all drive points with a joint (N/m)."""
    errors = [
        abs(row["damping_error_epmc"])
        for result in results
        if _target(result) == target and StudyCase.from_mapping(result["case"]).joint_stiffness == joint
        for row in _rows(result)
    ]
    return max(errors, default=math.nan)


def _findings(results: Sequence[Result]) -> Iterator[Finding]:
    for joint in sorted({StudyCase.from_mapping(result["case"]).joint_stiffness for result in results}):
        off, force, modal = (_worst(results, target, joint) for target in TARGETS)
        yield Finding(
            f"{joint / 1e3:g} kN/m: with the force's harmonics at zero damping is nearer to the nonlinear mode.",
            f"largest error of δ̃ {percent(off)} without control, {percent(force)} with the target force, "
            f"{percent(modal)} with the target modal",
            None if math.isnan(off) or math.isnan(force) else force < off,
        )
    for name, word in (("pbmif", "PBMIF"), ("gamma_force", "γ_F")):
        missing, error = _indicators(results, name, "off")
        rule = fitted_rule(missing, error)
        if rule is None:
            continue
        controlled = np.concatenate([_indicators(results, name, target)[1] for target in TARGETS[1:]])
        lacking = np.concatenate([_indicators(results, name, target)[0] for target in TARGETS[1:]])
        other = fitted_rule(lacking, controlled)
        with_control = "" if other is None else (
            f"; with control correlation {other.correlation:.2f}, scatter {other.scatter:.2f} decades"
        )  # fmt: skip
        yield Finding(
            f"{word} tells the accuracy of damping.",
            f"without control |Δδ̃|/δ̃ ≈ {10.0**rule.intercept:.2g} (1 − {word})^{rule.slope:.2f}, correlation "
            f"{rule.correlation:.2f}, scatter {rule.scatter:.2f} decades ({rule.count} windows){with_control}",
            rule.correlation > 0.7 and rule.scatter < 0.3,
        )
