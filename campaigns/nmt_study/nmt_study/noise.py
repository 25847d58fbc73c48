"""Robustness against measurement noise (paper, section 3.2)."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from nmt_core.vocabulary import PointStatus
from nmt_study.case import StudyCase
from nmt_study.case_reference import case_rig
from nmt_study.signal_noise import window_signal_to_noise
from nmt_study.study import Finding, Result, StudyOutput
from nmt_study.study_figures import backbone_figures, error_figures, percent
from nmt_study.study_table import level_rows, summary_row

TITLE = "Robustness against measurement noise"
CORRELATION_TIME = 1e-5
FORCE_PSD, DISPLACEMENT_PSD = 2e-9, 4.5e-16
NOISE = (("none", 0.0), ("low", 1.0), ("high", 10.0), ("high x 10", 100.0), ("high x 100", 1000.0))
PAPER_SNR = {"low": ((14.5, 39.1), (11.2, 31.2)), "high": ((4.8, 33.0), (0.8, 20.7))}
"""SNR in dB of the paper's table: force, displacement; each at low and high vibration levels."""
LEVELS = (0.29, 3.0)


def cases(quick: bool) -> list[StudyCase]:
    """The two noise levels of the table, one and two decades more, and none; default loop and the paper's."""
    levels = tuple(float(f"{v:.5g}") for v in np.geomspace(*LEVELS, 3 if quick else 8))
    chosen = []
    for loop in ("adaptive",) if quick else ("adaptive", "paper"):
        for label, factor in NOISE:
            if (quick and label in ("none", "high x 10")) or (loop == "paper" and label in ("none", "low")):
                continue
            chosen.append(
                StudyCase(
                    name=f"{loop}_{label.replace(' ', '_')}",
                    title=f"noise {label}" + ("" if loop == "adaptive" else ", paper's loop"),
                    exciter=2,
                    levels=levels,
                    overrides=noise_overrides(factor),
                    loop=loop,
                    window_periods=30 if quick else 200,
                    timeout=10.0 if quick else 20.0,
                    labels={"noise": label, "force_psd": FORCE_PSD * factor},
                )
            )
    return chosen


def noise_overrides(factor: float) -> tuple[str, ...]:
    """Sensor noise of the table's low level times a factor, on force and displacements of the beam's rig file."""
    if factor == 0.0:
        return ()
    texts = []
    for index in range(5):
        psd = (FORCE_PSD if index == 0 else DISPLACEMENT_PSD) * factor
        texts += [
            f"sensors.{index}.noise_psd={psd:.6g}",
            f"sensors.{index}.noise_correlation_time_s={CORRELATION_TIME:g}",
        ]
    return tuple(texts)


def evaluate(case: StudyCase, bag: Path) -> dict[str, Any]:
    """Measured signal-to-noise ratios of the windows."""
    rig = case_rig(case)
    if not case.overrides:
        return {}
    return {"snr_db": window_signal_to_noise(bag, rig.drive_point, rig.extraction.harmonics)}


def show(results: Sequence[Result]) -> StudyOutput:
    """Figures and findings."""
    shown = [r for r in results if any(row["status"] == PointStatus.OK for row in r["levels"])]
    figures = backbone_figures("noise", shown, "noise levels")
    figures.append(error_figures("noise", shown, lambda r: level_rows("noise", r), "noise levels"))
    return StudyOutput(figures, list(_findings(results)), [_NOTE])


_NOTE = (
    "Noise: variance = PSD / correlation time (0.01 ms), the convention that gives the table's 14 dB at 0.1 N; values "
    "held for less than a sampling interval are independent from sample to sample. The table's displacement SNR "
    "depends on the vibration levels the authors chose, which the text does not give."
)


def _findings(results: Sequence[Result]) -> Iterator[Finding]:
    for result in results:
        label, loop = result["case"]["labels"]["noise"], result["case"]["loop"]
        snr = result["extra"].get("snr_db") or {}
        if label in PAPER_SNR and snr and loop == "adaptive":
            paper = PAPER_SNR[label]
            texts = []
            for k, name in enumerate(("force", "displacement")):
                values = [entry[name] for entry in snr.values()]
                texts.append(f"{name} {values[0]:.1f} to {values[-1]:.1f} dB (paper {paper[k][0]} to {paper[k][1]} dB)")
            low = next(entry["force"] for entry in snr.values())
            yield Finding(
                f"SNR at the {label} noise level as in the table.", "; ".join(texts), abs(low - paper[0][0]) < 3.0
            )
    by_label = {
        r["case"]["labels"]["noise"]: summary_row(r, level_rows("noise", r))
        for r in results
        if r["case"]["loop"] == "adaptive"
    }
    table = [row for label, row in by_label.items() if label in PAPER_SNR]
    if table:
        omega = max(row.single_point[0] for row in table)
        damping = max(row.single_point[1] for row in table)
        yield Finding(
            "The results are highly robust against the noise levels of the table.",
            f"largest error of the test with both of them: ω̃ {percent(omega)}, δ̃ {percent(damping)}",
            omega < 1e-3 and damping < 0.02,
        )
    for result in results:
        label = result["case"]["labels"]["noise"]
        snr = result["extra"].get("snr_db") or {}
        if label == "high x 10" and snr and result["case"]["loop"] == "adaptive":
            first = next(iter(snr.values()))
            yield Finding(
                "One decade more: negative SNR of the displacement.",
                f"displacement SNR at the lowest level that locked: {first['displacement']:.1f} dB",
                first["displacement"] < 0.0,
            )
        if label == "high x 100":
            yield _failure_finding(result) if result["case"]["loop"] == "paper" else _honesty_finding(result)


def _failure_finding(result: Result) -> Finding:
    rows = result["levels"]
    lost = [row for row in rows if row["status"] != PointStatus.OK]
    which = f" (levels {', '.join(str(row['level_index'] + 1) for row in lost)})" if lost else ""
    return Finding(
        "Two decades more: the paper's PLL does not lock.",
        f"{len(lost)} of {len(rows)} levels not locked and reported as such{which}",
        2 * len(lost) > len(rows),
    )


def _honesty_finding(result: Result) -> Finding:
    """Whether what the default loop still locks states its own uncertainty truthfully."""
    rows = [row for row in level_rows("noise", result) if row["damping_error_single_point"] is not None]
    lost = len(result["levels"]) - len(rows)
    distances = [
        abs(row["damping_ratio"] - row["single_point_damping_ratio"]) / row["damping_ratio_std"] for row in rows
    ]
    largest = max(distances, default=math.nan)
    error = max((abs(row["damping_error_single_point"]) for row in rows), default=math.nan)
    return Finding(
        "Two decades more: what the default loop still locks states its uncertainty truthfully.",
        f"{lost} of {len(result['levels'])} levels not locked; largest error of δ̃ among the others {percent(error)}, "
        f"at most {largest:.1f} of its standard uncertainties",
        not rows or largest < 4.0,
    )
