"""Order of the levels: upwards, downwards, up and down again. Any hysteresis would be the extraction's own."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from nmt_core.vocabulary import PointStatus
from nmt_sequencer.level_plan import directed
from nmt_study.case import StudyCase
from nmt_study.study import Finding, Result, StudyOutput
from nmt_study.study_figures import backbone_figures, error_figures, percent
from nmt_study.study_table import level_rows

TITLE = "Order of the levels"


def cases(quick: bool) -> list[StudyCase]:
    """The same levels in three orders."""
    levels = [float(f"{v:.5g}") for v in np.geomspace(0.05, 1.5, 3 if quick else 12)]
    names = {"up": "upwards", "down": "downwards", "both": "up and down"}
    return [
        StudyCase(
            name=direction,
            title=title,
            exciter=2,
            levels=tuple(directed(levels, direction)),
            window_periods=20 if quick else 200,
            labels={"order": title},
        )
        for direction, title in names.items()
        if not (quick and direction == "both")
    ]


def show(results: Sequence[Result]) -> StudyOutput:
    """Figures and findings."""
    figures = backbone_figures("levels", results, "orders of the levels")
    figures.append(error_figures("levels", results, lambda r: level_rows("levels", r), "orders of the levels"))
    omega, damping = _largest_difference(results)
    finding = Finding(
        "A friction-damped beam has one steady state a level: the order of the levels does not matter.",
        f"largest difference between any two windows of a level: ω̃ {percent(omega)}, δ̃ {percent(damping)}",
        omega < 1e-4 and damping < 5e-3,
    )
    return StudyOutput(figures, [finding])


def _largest_difference(results: Sequence[Result]) -> tuple[float, float]:
    """Largest relative spread of ω̃ and δ̃ among all windows of the same level."""
    passages: dict[float, list[tuple[float, float]]] = {}
    for result in results:
        for row in result["levels"]:
            if row["status"] == PointStatus.OK:
                passages.setdefault(row["level"], []).append((row["omega_rad_s"], row["damping_ratio"]))
    spreads = [np.ptp(np.array(values), axis=0) / np.mean(values, axis=0) for values in passages.values()]
    worst = np.max(spreads, axis=0)
    return float(worst[0]), float(worst[1])
