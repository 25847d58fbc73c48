"""Figures of ``./nmt benchmark`` on a Dask scheduler: how much of its workers' time goes into work.

Two things are measured apart, since a benchmark has one machine. What scheduler and command cost as workers get more is
measured on simulated machines: workers that wait as long as a case would take need no core, so eight of them are eight
machines. What the cases of a study cost each other is measured on this machine, with more workers than cores.
"""

from __future__ import annotations

import math
import os
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from statistics import NormalDist
from typing import Any

import numpy as np

from nmt_benchmark.benchmark_figures import Figure
from nmt_core.errors import BenchError
from nmt_core.numerics.arrays import FloatArray
from nmt_core.processes.workers import worked

LIMIT_EFFICIENCY = 85.0
_FEW, _MANY = 2, 8
_WORKS = 320
# Times of the cases of a blind campaign, a hundred times as fast: lognormal, one in a hundred takes eight medians.
_MEDIAN, _SPREAD = 0.15, 0.9
_SEED = 11
_CASES = 24


def scheduler_figures(_: float) -> list[Figure]:
    """Efficiency of two and of eight workers on simulated machines, and of eight on this one."""
    names = [f"scheduler: efficiency of {n} workers, simulated machines" for n in (_FEW, _MANY)]
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    last = f"scheduler: {_MANY} workers over {_FEW} on {cores} cores, cases of a study"
    try:
        import distributed
    except ModuleNotFoundError:
        note = "Dask is not installed: pip install '.[dask]'"
        return [Figure(name, None, "%", LIMIT_EFFICIENCY, note) for name in (*names, last)]
    times = waiting_times(_WORKS)
    figures, spent = [], []
    for name, workers in zip(names, (_FEW, _MANY), strict=True):
        with _cluster(distributed, workers) as cluster:
            address = cluster.scheduler_address
            list(worked(_wait, [(0.0,)] * 4 * workers, 1, address))  # every worker has loaded this module
            begun = time.perf_counter()
            list(worked(_wait, [(float(seconds),) for seconds in times], 1, address))
            efficiency = 100.0 * float(times.sum()) / workers / (time.perf_counter() - begun)
            figures.append(_figure(name, efficiency))
            spent.append(_study_time(address))
    return [*figures, _figure(last, 100.0 * spent[0] / spent[1])]


def waiting_times(count: int) -> FloatArray:
    """Times of works as cases of a campaign have them, s, in no order, shape (count,)."""
    normal = NormalDist(math.log(_MEDIAN), _SPREAD)
    times = np.exp([normal.inv_cdf((number + 0.5) / count) for number in range(count)])
    return np.asarray(np.random.default_rng(_SEED).permutation(times), dtype=np.float64)


def _figure(name: str, value: float) -> Figure:
    return Figure.limited(name, value, "%", LIMIT_EFFICIENCY)


def _cluster(distributed: Any, workers: int) -> Any:
    return distributed.LocalCluster(
        n_workers=workers, threads_per_worker=1, processes=True, dashboard_address=None, silence_logs=50
    )


def _wait(seconds: float) -> float:
    time.sleep(seconds)
    return seconds


def _study_time(address: str) -> float:
    """s for cases of the noise study; a first turn loads what they need.

    Raises:
        BenchError: a case failed.
    """
    from nmt_study.case_store import CaseStore
    from nmt_study.study_runner import load_study, run_cases

    first = load_study("noise").cases(quick=True)[0]
    cases = [
        replace(first, name=f"{first.name}_{number}", overrides=(*first.overrides, f"seed={number}"))
        for number in range(_CASES)
    ]
    spent = 0.0
    with tempfile.TemporaryDirectory(prefix="nmt-benchmark-") as folder:
        for turn in ("first", "second"):
            begun = time.perf_counter()
            reports = run_cases("noise", cases, CaseStore(Path(folder) / turn, "noise"), 1, scheduler=address)
            spent = time.perf_counter() - begun
            for report in reports:
                if report.result is None:
                    raise BenchError(f"A case of the study failed over the scheduler: {report.failure}")
    return spent
