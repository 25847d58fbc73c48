"""Results of cases as a perfect test would have given them: measured values are those of the single-point reference."""

from __future__ import annotations

import json
from typing import Any

from nmt_core.messages.modal_point import MEASURED
from nmt_core.vocabulary import PointStatus
from nmt_rig.linear_description import linear_description
from nmt_study.case import StudyCase
from nmt_study.case_reference import case_rig, epmc_at, single_point_at


def perfect_result(case: StudyCase, lost: tuple[int, ...] = ()) -> dict[str, Any]:
    single = single_point_at(case)
    levels = []
    for index, volts in enumerate(case.levels):
        row: dict[str, Any] = {"level_index": index, "level": volts, "window_periods": case.window_periods}
        for name in MEASURED:
            row[name] = row[f"{name}_std"] = None
        if index in lost or single["failure"] or single["levels"]["omega_rad_s"][index] is None:
            row.update(status=int(PointStatus.NOT_LOCKED), reason="The level did not lock: made up.")
            row.update(participation_real=[], participation_imag=[])
        else:
            row.update({name: single["levels"][name][index] for name in single["levels"] if name in row})
            row.update({f"{name}_std": 1e-4 * abs(row[name]) for name in single["levels"] if name in row})
            row.update(
                status=int(PointStatus.OK),
                reason="",
                level=volts,
                mac=1.0,
                phase_error=1e-4,
                participation_real=single["levels"]["participation_real"][index],
                participation_imag=single["levels"]["participation_imag"][index],
            )
        row.update(periods=60.0, duration_s=3.0, time_to_lock_s=1.0, overshoot=1e-3, phase_scatter=1e-4)
        levels.append(row)
    amplitudes = [row["modal_amplitude"] for row in levels if row["modal_amplitude"] is not None]
    result = {
        "case": case.to_mapping(),
        "run": {
            "message": "made up",
            "bench_time_s": 10.0,
            "wall_time_s": 1.0,
            "real_time_factor": 10.0,
            "case_time_s": 2.0,
        },
        "linear": json.loads(linear_description(case_rig(case)).to_json()),
        "levels": levels,
        "single_point": single,
        "epmc": epmc_at(case, amplitudes) if case.epmc else {"failure": "not asked for", "folds": []},
        "extra": {},
    }
    return json.loads(json.dumps(result))
