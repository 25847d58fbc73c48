"""``study.csv``: every case and level with its reference values and errors, and the summary of a study."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from nmt_core.files.whole_file import csv_text
from nmt_core.vocabulary import PointStatus
from nmt_report.columns import status_text

_MEASURED = (
    "omega_rad_s",
    "damping_ratio",
    "modal_amplitude",
    "force_n",
    "pbmif",
    "gamma_force",
    "gamma_acceleration",
    "mac",
    "phase_error",
)
_TIMES = ("periods", "time_to_lock_s", "overshoot", "phase_scatter")

COLUMNS = (
    "study",
    "case",
    "exciter_point",
    "joint_stiffness_n_m",
    "loop",
    "strategy",
    "labels",
    "level_index",
    "level",
    "status",
    "reason",
    *(name + suffix for name in _MEASURED for suffix in ("", "_std")),
    "participation_1",
    "participation_1_phase_deg",
    "participation_2",
    "participation_2_phase_deg",
    "epmc_omega_rad_s",
    "epmc_damping_ratio",
    "epmc_single_valued",
    "omega_error_epmc",
    "damping_error_epmc",
    "single_point_omega_rad_s",
    "single_point_damping_ratio",
    "single_point_modal_amplitude",
    "single_point_single_valued",
    "omega_error_single_point",
    "damping_error_single_point",
    "amplitude_error_single_point",
    "window_periods",
    *_TIMES,
)
"""Columns of ``study.csv``. Errors are relative; ``_epmc``: of the method, ``_single_point``: of the test."""


@dataclass(frozen=True)
class SummaryRow:
    """Largest errors of one case; NaN where there is nothing to compare.

    Attributes:
        case: title of the case.
        locked: levels that gave a modal point.
        levels: levels of the plan.
        epmc: largest |error| of ω̃ and δ̃ against the EPMC, where that is single-valued.
        single_point: the same against the single-point reference, at the same drive voltage.
        periods: mean of the periods per level.
        note: why a reference is missing, or what failed.
    """

    case: str
    locked: int
    levels: int
    epmc: tuple[float, float]
    single_point: tuple[float, float]
    periods: float
    note: str


def level_rows(study: str, result: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Rows of the table of one case's result; keys are :data:`COLUMNS`."""
    from nmt_study.case import StudyCase

    case = StudyCase.from_mapping(result["case"])
    labels = "; ".join(f"{key}={value}" for key, value in case.labels.items())
    rows = []
    for level in result["levels"]:
        row: dict[str, Any] = dict.fromkeys(COLUMNS)
        row.update(
            study=study,
            case=case.name,
            exciter_point=case.exciter,
            joint_stiffness_n_m=case.joint_stiffness if case.rig == "beam" else None,
            loop=case.loop,
            strategy=case.strategy,
            labels=labels,
            level_index=level["level_index"],
            level=level["level"],
            status=status_text(level["status"]),
            reason=level["reason"],
            window_periods=level["window_periods"],
        )
        for name in _MEASURED:
            row[name], row[f"{name}_std"] = level.get(name), level.get(f"{name}_std")
        for name in _TIMES:
            row[name] = level.get(name)
        if level["status"] == PointStatus.OK:
            _compare(row, level, result)
        rows.append(row)
    return rows


def _compare(row: dict[str, Any], level: Mapping[str, Any], result: Mapping[str, Any]) -> None:
    real, imag = level["participation_real"], level["participation_imag"]
    for mode in range(min(2, len(real))):
        value = complex(real[mode], imag[mode])
        row[f"participation_{mode + 1}"] = abs(value)
        row[f"participation_{mode + 1}_phase_deg"] = math.degrees(math.atan2(value.imag, value.real))
    omega, damping, q = (level[name] for name in ("omega_rad_s", "damping_ratio", "modal_amplitude"))
    epmc = result["epmc"]
    if not epmc["failure"]:
        expected = at_amplitude(epmc, q)
        if expected is not None:
            row["epmc_omega_rad_s"], row["epmc_damping_ratio"] = expected
            row["epmc_single_valued"] = not any(low <= q <= high for low, high in epmc["folds"])
            row["omega_error_epmc"] = omega / expected[0] - 1.0
            row["damping_error_epmc"] = damping / expected[1] - 1.0
    single = result["single_point"]
    reference = single["levels"]
    if result["case"]["strategy"] == "ramp" and not single["failure"]:
        _compare_on_curve(row, level, single)
        return
    index = level["level_index"]
    if not single["failure"] and reference["omega_rad_s"][index] is not None:
        row["single_point_single_valued"] = single["single_valued"]
        for name, error in (("omega_rad_s", "omega"), ("damping_ratio", "damping"), ("modal_amplitude", "amplitude")):
            row[f"single_point_{name}"] = reference[name][index]
            row[f"{error}_error_single_point"] = level[name] / reference[name][index] - 1.0


def _compare_on_curve(row: dict[str, Any], level: Mapping[str, Any], single: Mapping[str, Any]) -> None:
    """During a ramp the amplitude lags behind the voltage: the reference is taken at the measured amplitude."""
    curve = single["curve"]
    place, known = math.log(level["modal_amplitude"]), np.log(curve["modal_amplitude"])
    if not known[0] <= place <= known[-1] or np.any(np.diff(known) <= 0.0):
        return
    row["single_point_single_valued"] = single["single_valued"]
    row["single_point_modal_amplitude"] = level["modal_amplitude"]
    for name, error in (("omega_rad_s", "omega"), ("damping_ratio", "damping")):
        expected = float(np.interp(place, known, curve[name]))
        row[f"single_point_{name}"] = expected
        row[f"{error}_error_single_point"] = level[name] / expected - 1.0


def at_amplitude(epmc: Mapping[str, Any], q: float) -> tuple[float, float] | None:
    """EPMC ω̃ (rad/s) and δ̃ at a modal amplitude, None outside the computed range."""
    grid = epmc["modal_amplitude"]
    if not grid[0] * (1 - 1e-9) <= q <= grid[-1] * (1 + 1e-9):
        return None
    return (
        float(np.interp(math.log(q), np.log(grid), epmc["omega_rad_s"])),
        float(np.interp(math.log(q), np.log(grid), epmc["damping_ratio"])),
    )


def summary_row(result: Mapping[str, Any], rows: Sequence[Mapping[str, Any]]) -> SummaryRow:
    """Largest errors of a case from its table rows."""
    good = [row for row in rows if row["status"] == status_text(PointStatus.OK)]
    notes = []
    failed = [row for row in rows if row["status"] != status_text(PointStatus.OK)]
    if failed:
        reason = failed[0]["reason"].removeprefix("The level did not lock: ").rstrip(".")
        notes.append(f"{len(failed)} {failed[0]['status']}: {reason}")
    if result["epmc"]["failure"] and result["epmc"]["failure"] != "not asked for":
        notes.append(f"no EPMC: {result['epmc']['failure']}")
    if result["case"].get("test", "phase_resonance") != "phase_resonance":
        pass  # A perfect phase resonance test is not a reference for another kind at the same level.
    elif result["case"].get("harmonics_control"):
        pass  # Nor is one with a sine of voltage for a test with control of harmonics.
    elif result["single_point"]["failure"]:
        notes.append(f"no single-point reference: {result['single_point']['failure']}")
    elif any(row["single_point_omega_rad_s"] is None for row in good):
        notes.append("the single-point reference folds before the highest level")
    periods = [row["periods"] for row in good if row["periods"] is not None]
    return SummaryRow(
        case=result["case"]["title"],
        locked=len(good),
        levels=len(rows),
        epmc=(
            _largest(row["omega_error_epmc"] for row in good if row["epmc_single_valued"]),
            _largest(row["damping_error_epmc"] for row in good if row["epmc_single_valued"]),
        ),
        single_point=(
            _largest(row["omega_error_single_point"] for row in good),
            _largest(row["damping_error_single_point"] for row in good),
        ),
        periods=float(np.mean(periods)) if periods else math.nan,
        note="; ".join(notes),
    )


def _largest(values: Iterable[float | None]) -> float:
    finite = [abs(value) for value in values if value is not None and math.isfinite(value)]
    return max(finite) if finite else math.nan


def study_csv(rows: Iterable[Mapping[str, Any]]) -> str:
    """The table as CSV; missing values are empty, numbers read back to the same bits."""
    return csv_text([COLUMNS, *([_cell(row[name]) for name in COLUMNS] for row in rows)])


def _cell(value: Any) -> str:
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return ""
    if isinstance(value, bool):
        return "1" if value else "0"
    return repr(value) if isinstance(value, float) else str(value)
