"""Runs the cases of a study over the cores of the machine, or over machines; keeps each as soon as it is finished."""

from __future__ import annotations

import importlib
import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from nmt_core.errors import BenchError
from nmt_core.processes.workers import worked
from nmt_study import STUDIES
from nmt_study.case import StudyCase
from nmt_study.case_store import CaseStore


@dataclass(frozen=True)
class CaseReport:
    """What became of a case: its result, or why there is none."""

    case: StudyCase
    result: dict[str, Any] | None
    failure: str


def load_study(name: str) -> Any:
    """The module of a study.

    Raises:
        BenchError: there is no such study.
    """
    if name not in STUDIES:
        raise BenchError(f"There is no study '{name}'; choose one of {', '.join(STUDIES)} or all.")
    return importlib.import_module(STUDIES[name][0])


def run_cases(
    study: str,
    cases: Iterable[StudyCase],
    store: CaseStore,
    jobs: int,
    bags: Path | None = None,
    on_done: Callable[[CaseReport], None] = lambda _: None,
    scheduler: str = "",
) -> list[CaseReport]:
    """Run the cases that have no result yet.

    Each case runs in a worker process, its bench in a ROS domain of its own.

    Args:
        study: name of the study.
        cases: all its cases.
        store: where results are kept.
        jobs: worker processes; 1 = in this process.
        bags: folder that gets the bag of each case; None = bags are not kept.
        on_done: called with each case as it ends.
        scheduler: address of a Dask scheduler in place of worker processes; its workers must see the folder of the
            bags, if these are kept. A case whose worker dies is given to another one.

    Returns:
        The cases that were run, in the order in which they ended.

    Raises:
        BenchError: the scheduler does not answer, or the workers die again and again.
    """
    todo = store.missing(cases)
    reports: list[CaseReport] = []

    kept = None if bags is None else bags.absolute()
    for report in worked(_run_one, [(study, case, kept) for case in todo], jobs, scheduler):
        if report.result is not None:
            store.save(report.case, report.result)
        reports.append(report)
        on_done(report)
    return reports


def _run_one(study: str, case: StudyCase, bags: Path | None) -> CaseReport:
    from nmt_study.case_runner import run_case

    # The bench shares the cores with its siblings.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    module = load_study(study)
    keep = bags / case.name if bags is not None else None
    try:
        return CaseReport(case, run_case(case, keep, getattr(module, "evaluate", None)), "")
    except Exception as error:
        # One case that fails must not take the others with it; it is reported and may be run again.
        return CaseReport(
            case, None, f"{type(error).__name__}: {error}" if not isinstance(error, BenchError) else str(error)
        )
