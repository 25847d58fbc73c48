"""Work survives the workers that do it."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable
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


@pytest.mark.campaign
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


_PARENT = """
import sys, time, os
from nmt_core.processes.workers import worked
from pathlib import Path

def slow(folder, number):
    (Path(folder) / str(number)).write_text(str(os.getpid()))
    time.sleep(600.0)

if __name__ == "__main__":
    list(worked(slow, [(sys.argv[1], 0), (sys.argv[1], 1)], 2, ""))
"""


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells a process that its parent died")
def test_workers_end_with_a_killed_parent(tmp_path: Path) -> None:
    (tmp_path / "parent.py").write_text(_PARENT, encoding="utf-8")
    marks = [tmp_path / "0", tmp_path / "1"]
    with subprocess.Popen([sys.executable, str(tmp_path / "parent.py"), str(tmp_path)]) as parent:
        _until(lambda: all(mark.exists() and mark.read_text() for mark in marks))
        parent.kill()
    _until(lambda: not any(_runs(int(mark.read_text())) for mark in marks))


def _until(condition: Callable[[], bool]) -> None:
    end = time.monotonic() + 60.0
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.05)


def _runs(pid: int) -> bool:
    try:
        state = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rsplit(")", 1)[1].split()[0]
    except FileNotFoundError:
        return False
    return state != "Z"
