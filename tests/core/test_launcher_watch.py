"""A program that started nodes and was stopped is complained of after a while, and only then."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

import pytest

from nmt_core.nodes.launcher_watch import LAUNCHER, LauncherWatch
from nmt_core.processes.process_watch import state_of


def wait_for(process: int, state: str) -> None:
    end = time.monotonic() + 20.0
    while state_of(process) != state:
        assert time.monotonic() < end
        time.sleep(0.01)


def test_a_stopped_program_is_complained_of_until_it_goes_on() -> None:
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as program:
        watch = LauncherWatch(program.pid, longest=2.0)
        assert watch.complaint(0.0) == ""
        os.kill(program.pid, signal.SIGSTOP)
        wait_for(program.pid, "T")
        assert [watch.complaint(now) for now in (1.0, 2.9)] == ["", ""]
        assert watch.complaint(3.1) == f"The program that started the nodes (process {program.pid}) is stopped."
        os.kill(program.pid, signal.SIGCONT)
        wait_for(program.pid, "S")
        assert watch.complaint(4.0) == ""
        program.communicate(b"\n")
    assert watch.complaint(9.0) == ""  # one that has ended is others' business


@pytest.mark.parametrize("value", [None, "1", "no number"])
def test_only_the_parent_counts(value: str | None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "getppid", lambda: 4242)  # in a container it may be process 1
    if value is None:
        monkeypatch.delenv(LAUNCHER, raising=False)
    else:
        monkeypatch.setenv(LAUNCHER, value)
    assert LauncherWatch().process is None
    monkeypatch.setenv(LAUNCHER, "4242")
    assert LauncherWatch().process == 4242
