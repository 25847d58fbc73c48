"""Step 4: the compiled numerical kernels are cached.

They need the requirements and the sources but no built workspace. Where both are to be made, the kernels are compiled
while the workspace is built. What a first test needs is compiled by two processes, which the set-up waits for. Two more
compile the others, of the diagnosis above all, at low priority; they go on in the background when the set-up is done. A
command that computes much with them waits for that; any other that meets one under way waits for this one
(``nmt_core.numerics.kernels``), so that none is compiled twice.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import re
import shlex
import signal
import subprocess
import sys
import time
from functools import partial
from typing import Any

from .environment import command_environment, prepend
from .places import ROOT, STATE_FOLDER, VENV_PYTHON, WARM_UP, WORKSPACE
from .programs import StepRunner, end_group
from .progress import Progress
from .stamps import packages

FIRST = ("test", "reference")
"""Parts of ``nmt_bench.warm_up`` that a first test needs, a process each."""
LATER = ("responses", "records")
"""Parts that are compiled at low priority, in the background in the end."""
LATER_LOCK = os.path.join(STATE_FOLDER, "kernels.lock")
LATER_LOG = os.path.join(STATE_FOLDER, "log", "kernels-later.log")
PATIENT = ("test", "blind", "study", "benchmark")
"""Commands that compute with the kernels of the background, or beside which it would get no processor."""


class KernelCompilation:
    """Compiles the numerical kernels of a first test into their cache; without it that test is slower.

    Starts at once, beside whatever else runs. What an older set-up has cached is read where its formulas are the same.

    Args:
        state: source of ROS 2 and version of Python.
        guard: the set-up's lock.
    """

    def __init__(self, state: dict[str, Any], guard: int) -> None:
        end_later()
        self._parts: list[tuple[StepRunner, subprocess.Popen[bytes]]] = []
        if os.path.isfile(WARM_UP):
            environment = _environment(state)
            for part in FIRST:
                runner = StepRunner(f"kernels-{part}", None, guard)
                self._parts.append((runner, runner.start(_command(part), environment, WORKSPACE)))
            start_later(state)

    def finish(self, progress: Progress) -> None:
        """Wait for the kernels of a first test; a failure is a note and no more."""
        for runner, process in self._parts:
            runner.progress = progress
            if not runner.finish(process, partial(_how_far_is, runner), may_fail=True):
                progress.break_line()
                log = os.path.relpath(runner.log, ROOT)
                sys.stderr.write(f"note: the kernels could not be compiled beforehand ({log} says why)\n")
                end_later()
                return

    def end(self) -> None:
        """End the compilation for a first test if it is still under way."""
        for _, process in self._parts:
            if process.poll() is None:
                end_group(process)


def start_later(state: dict[str, Any]) -> None:
    """Compile the other kernels in the background; the programs hold a lock as long as they are at work."""
    with open(LATER_LOCK, "a+") as lock, open(LATER_LOG, "wb") as log:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return
        # By a shell that ends at once: it is no child of the command that this process becomes.
        programs = "".join(f"{shlex.join(_command(part))} & " for part in LATER)
        process = subprocess.Popen(
            ["sh", "-c", programs], stdin=subprocess.DEVNULL, stdout=log, stderr=subprocess.STDOUT,
            cwd=WORKSPACE, env=_environment(state), start_new_session=True, pass_fds=(lock.fileno(),),
        )  # fmt: skip
        process.wait()
        lock.truncate(0)
        lock.write(str(process.pid))


def end_later() -> None:
    """End the compilation in the background: another begins."""
    with contextlib.suppress(OSError, ValueError), open(LATER_LOCK) as lock:
        for wanted in (signal.SIGTERM, signal.SIGKILL):
            if not _held(lock):
                return
            os.killpg(int(lock.read()), wanted)
            lock.seek(0)
            end = time.monotonic() + 5.0
            while _held(lock) and time.monotonic() < end:
                time.sleep(0.05)


def wait_for_later() -> None:
    """Wait for the compilation in the background, with a line that says how far it is."""
    with contextlib.suppress(FileNotFoundError), open(LATER_LOCK) as lock:
        if not _held(lock):
            return
        progress = Progress(1, 1, "numerical kernels")
        while _held(lock):
            progress.show(later_progress())
            time.sleep(0.2)
        progress.done()


def later_progress() -> str:
    """How far the compilation in the background is, "3 of 8"; empty where none is under way."""
    with contextlib.suppress(OSError), open(LATER_LOCK) as lock, open(LATER_LOG, errors="replace") as log:
        if _held(lock):
            return _how_far(log.read())
    return ""


def _how_far_is(runner: StepRunner) -> str:
    return _how_far(runner.text())


def _how_far(log: str) -> str:
    steps = re.findall(r"^\d+ of \d+.*$", log, re.M)
    return steps[-1] if steps else ""


def _held(lock: Any) -> bool:
    try:
        fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    fcntl.flock(lock, fcntl.LOCK_UN)
    return False


def _command(part: str) -> list[str]:
    return [VENV_PYTHON, "-m", "nmt_bench.warm_up", part]


def _environment(state: dict[str, Any]) -> dict[str, str]:
    environment = command_environment(state)
    prepend(environment, "PYTHONPATH", list(packages().values()))
    # Every node is a process: without the byte code of what is imported here each would compile its libraries.
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    return environment
