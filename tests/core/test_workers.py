"""Work survives the workers that do it."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest

from nmt_core.errors import BenchError
from nmt_core.processes.workers import worked


def fragile(folder: str, number: int) -> int:
    """Kills its worker the first time that one of the works is begun."""
    mark = Path(folder) / f"{number}"
    first = not mark.exists()
    mark.touch()
    if first and number == 2:
        os._exit(1)
    return number * number


@pytest.mark.filterwarnings("ignore")
def test_a_killed_worker_costs_no_result(tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=True, dashboard_address=None, silence_logs=50
    ) as cluster:
        work = [(str(tmp_path), number) for number in range(4)]
        found = sorted(worked(fragile, work, 1, cluster.scheduler_address))
    assert found == [0, 1, 4, 9]


def test_work_that_kills_every_worker_is_a_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    distributed = pytest.importorskip("distributed")

    class Killed:
        def result(self) -> None:
            raise distributed.KilledWorker("work", None, 4)

    class Client:
        def __enter__(self) -> Client:
            return self

        def __exit__(self, *_: object) -> None:
            pass

        def submit(self, *_: Any, **__: Any) -> Killed:
            return Killed()

    monkeypatch.setattr(distributed, "Client", lambda *_, **__: Client())
    monkeypatch.setattr(distributed, "as_completed", lambda futures: futures)
    with pytest.raises(BenchError, match="died over and over"):
        list(worked(fragile, [("", 1)], 1, "tcp://127.0.0.1:1"))


def test_a_scheduler_that_does_not_answer_is_a_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    distributed = pytest.importorskip("distributed")

    def nobody(*_: Any, **__: Any) -> None:
        raise OSError("timed out")

    monkeypatch.setattr(distributed, "Client", nobody)
    with pytest.raises(BenchError, match="does not answer"):
        list(worked(fragile, [("", 1)], 1, "tcp://127.0.0.1:1"))
