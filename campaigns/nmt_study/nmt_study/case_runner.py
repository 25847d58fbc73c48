"""Runs one case in a session of this process and puts measurement and references into one plain mapping."""

from __future__ import annotations

import shutil
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from nmt_core.errors import BenchError
from nmt_core.files.plain_json import plain_json
from nmt_core.messages.modal_point import MEASURED, ModalPoint
from nmt_core.vocabulary import PointStatus, ResultCode
from nmt_study.case import StudyCase

Evaluation = Callable[[StudyCase, Path], dict[str, Any]]
"""Further evaluation of a case's bag; what it returns is kept under ``extra``, its ``levels`` in place of the run's."""


def run_case(case: StudyCase, keep_bag: Path | None = None, evaluation: Evaluation | None = None) -> dict[str, Any]:
    """Run a case in this process.

    Args:
        case: the case.
        keep_bag: folder to move the bag to; None = it is not kept.
        evaluation: further evaluation of the bag.

    Returns:
        ``run``, ``linear``, ``levels`` (one mapping each), ``epmc``, ``single_point`` and ``extra``, all
        plain values; NaN is None.

    Raises:
        BenchError: the case is refused, or the run did not end as planned.
    """
    from nmt_session import Session, plan_test
    from nmt_study.case_reference import epmc_at, single_point_at
    from nmt_study.case_timing import level_timings

    began = time.monotonic()
    folder = Path(tempfile.mkdtemp(prefix="nmt-case-"))
    try:
        plan = plan_test(
            case.rig,
            **case.planned,
            run_id=case.name,
            node_values={
                "pll": {"loop": case.loop, **case.loop_values},
                "extract": dict(case.extract_values),
                # With an interval given, blocks stay as the rig has them: cases are compared block by block.
                "sequencer": {"tick_blocks": 5},
            },
        )
        with Session(plan, folder) as session:
            result = session.run()
        if result.code != ResultCode.SUCCEEDED or result.bag is None or result.bag_state != "closed":
            raise BenchError(f"The run ended with {result.code.name}: {result.message}")
        timings = level_timings(result.bag, plan.rig.sample_rate_hz, plan.rig.block_samples)
        levels: list[dict[str, Any]] = []
        for point in sorted(result.points, key=lambda item: item.level_index):
            levels.append({**level_mapping(point), **timings.get(point.level_index, {})})
        extra = evaluation(case, result.bag) if evaluation is not None else {}
        # Other tests than phase resonance have no modal points; their evaluation gives the levels.
        levels = extra.pop("levels", levels)
        if keep_bag is not None:
            keep_bag.parent.mkdir(parents=True, exist_ok=True)
            shutil.rmtree(keep_bag, ignore_errors=True)
            shutil.move(str(result.bag), keep_bag)
        run = {
            "message": result.message,
            "bench_time_s": result.bench_time,
            "wall_time_s": result.wall_time,
            "real_time_factor": result.real_time_factor,
        }
        linear = session.plan.run["linear"]
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    amplitudes = [row["modal_amplitude"] for row in levels if row["status"] == int(PointStatus.OK)]
    measured: dict[str, Any] = {
        "run": run,
        "linear": linear,
        "levels": levels,
        "single_point": single_point_at(case),
        "epmc": epmc_at(case, amplitudes) if case.epmc else {"failure": "not asked for", "folds": []},
        "extra": extra,
    }
    measured["run"]["case_time_s"] = time.monotonic() - began
    plain: dict[str, Any] = plain_json(measured)
    return plain


def level_mapping(point: ModalPoint) -> dict[str, Any]:
    """A modal point as plain values, without its harmonics."""
    row: dict[str, Any] = {
        "level_index": point.level_index,
        "level": point.level,
        "status": int(point.status),
        "reason": point.reason,
        "window_periods": point.window_periods,
        "participation_real": [float(value.real) for value in point.participation],
        "participation_imag": [float(value.imag) for value in point.participation],
    }
    for name in MEASURED:
        row[name] = getattr(point, name)
        row[f"{name}_std"] = getattr(point, f"{name}_std")
    return row
