"""Cases of a study and of a blind check over a Dask scheduler: as on one machine, and a killed worker costs none."""

from __future__ import annotations

import json
import os
import signal
import threading
import time
from pathlib import Path
from typing import Any

import pytest
from blind.blind_campaign import make

from nmt_study.case import StudyCase
from nmt_study.case_store import CaseStore
from nmt_study.study_runner import run_cases

distributed = pytest.importorskip("distributed")
pytestmark = pytest.mark.filterwarnings("ignore")


def small_case(level: float) -> StudyCase:
    return StudyCase(
        name=f"level_{level:g}".replace(".", "_"),
        title="small",
        exciter=2,
        levels=(level,),
        overrides=(),
        loop="adaptive",
        window_periods=5,
        timeout=10.0,
        labels={"noise": "none", "force_psd": 0.0},
    )


def a_cluster() -> Any:
    return distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=True, dashboard_address=None, silence_logs=50
    )


def kill_first_worker(cluster: Any, killed: list[int]) -> None:
    """Kill the worker once it works on something."""
    with distributed.Client(cluster.scheduler_address) as client:
        while not any(client.processing().values()):
            time.sleep(0.01)
        time.sleep(0.1)
        killed.append(int(next(iter(cluster.workers.values())).process.pid))
        os.kill(killed[0], signal.SIGKILL)


def timeless(path: Path) -> Any:
    """What is kept of a case, without how long it took."""
    values = json.loads(path.read_text())
    for key in ("wall_time_s", "case_time_s", "real_time_factor"):
        del values["run"][key]
    return values


@pytest.mark.campaign
def test_a_killed_worker_costs_no_case_of_a_study(tmp_path: Path) -> None:
    cases = [small_case(0.2), small_case(0.3)]
    here = CaseStore(tmp_path / "here", "noise")
    run_cases("noise", cases, here, 1)
    there = CaseStore(tmp_path / "there", "noise")
    killed: list[int] = []
    with a_cluster() as cluster:
        killer = threading.Thread(target=kill_first_worker, args=(cluster, killed))
        killer.start()
        reports = run_cases("noise", cases, there, 1, scheduler=cluster.scheduler_address)
        killer.join()
    assert len(killed) == 1
    assert [report.failure for report in reports] == ["", ""]
    for case in cases:
        name = f"cases/{case.name}.json"
        assert timeless(tmp_path / "there" / name) == timeless(tmp_path / "here" / name)


@pytest.mark.campaign
def test_a_killed_worker_costs_no_case_of_a_blind_check(tmp_path: Path) -> None:
    here = make(tmp_path / "here")
    killed: list[int] = []
    with a_cluster() as cluster:
        killer = threading.Thread(target=kill_first_worker, args=(cluster, killed))
        killer.start()
        there = make(tmp_path / "there", scheduler=cluster.scheduler_address)
        killer.join()
    assert len(killed) == 1
    # The trail is a hash over the hashes of all bags.
    assert there.trail == here.trail
